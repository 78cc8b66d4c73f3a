//! Where the time of the OpenCL chain goes: microseconds per image of one batched evaluation, and
//! of each kernel.
//!
//! `cargo bench --bench device_chain -- [samples pixels batch]`, all devices, both precisions. Not
//! a criterion bench: the question is the profile of one call, and each sample moves the
//! coefficients.

#[cfg(not(feature = "opencl"))]
fn main() {
    println!("built without OpenCL: nothing to measure");
}

#[cfg(feature = "opencl")]
fn main() -> cophase::Result<()> {
    let numbers: Vec<usize> = std::env::args().filter_map(|a| a.parse().ok()).collect();
    let cases = match numbers[..] {
        [samples, pixels, batch] => vec![(samples, pixels, batch)],
        _ => vec![(120, 240, 192), (120, 96, 192), (108, 88, 192)],
    };
    let devices = cophase::device::devices()?;
    if let Some(advice) = cophase::device::advice(&devices) {
        println!("{advice}");
    }
    for info in devices {
        println!("{info}");
        for precision in [cophase::device::Precision::F32, cophase::device::Precision::F64] {
            if info.supports(precision) {
                let device = cophase::device::Device::open(&info, false)?;
                println!("    {precision}: {:.1?}", cophase::device::Peak::measure(&device, precision)?);
            }
        }
        for &(samples, pixels, batch) in &cases {
            for edges in [scene::Edges::Grey, scene::Edges::BandLimited] {
                let layout = scene::keck_like(samples, pixels, edges);
                let single = measure(&info, cophase::device::Precision::F32, &layout, batch, edges)?;
                if info.f64 {
                    let double = measure(&info, cophase::device::Precision::F64, &layout, batch, edges)?;
                    let apart = |a: &[f64], b: &[f64]| {
                        let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
                        norm(&mut a.iter().zip(b).map(|(a, b)| a - b)) / norm(&mut b.iter().copied())
                    };
                    println!(
                        "    f32 against f64: objective {:.1e}, gradient {:.1e} (relative 2-norms)",
                        apart(&single.objective, &double.objective),
                        apart(&single.gradient, &double.gradient)
                    );
                }
            }
        }
    }
    Ok(())
}

#[cfg(feature = "opencl")]
fn measure(
    info: &cophase::device::DeviceInfo,
    precision: cophase::device::Precision,
    layout: &cophase::imaging::gpu::GpuLayout,
    batch: usize,
    edges: scene::Edges,
) -> cophase::Result<cophase::imaging::gpu::GpuEvaluation> {
    use cophase::imaging::gpu::{GpuChain, GpuPhotometry};
    use std::time::Instant;

    let active: Vec<usize> = (0..batch).collect();
    let coefficients = |seed: usize| -> Vec<f64> {
        (0..batch * layout.modes.len()).map(|i| 100.0 * ((i * 7919 + seed * 104_729) as f64).sin()).collect()
    };
    let (mut walls, mut processor) = (Vec::new(), Vec::new());
    let (mut profile, mut first) = (Vec::new(), None);
    // Once without events, for the wall clock, once with them, for the profile.
    for timed in [false, true] {
        let device = cophase::device::Device::open(info, timed)?;
        let mut chain = GpuChain::new(&device, precision, layout, batch)?;
        let pixels = batch * layout.pixels * layout.pixels;
        let data: Vec<f32> = (0..pixels)
            .map(|i| {
                48.0 + 1e4
                    * (-((i % (layout.pixels * layout.pixels)) as f32 / (layout.pixels * layout.pixels) as f32 - 0.5)
                        .powi(2)
                        * 400.0)
                        .exp()
            })
            .collect();
        chain.load(&data, &vec![1.0f32; pixels], &vec![GpuPhotometry::FitBoth; batch])?;
        first = Some(chain.evaluate(&active, &coefficients(0))?);
        device.take_timings()?;
        for sample in 1..=if timed { 5 } else { 15 } {
            let c = coefficients(sample);
            let (start, busy) = (Instant::now(), processor_seconds());
            std::hint::black_box(chain.evaluate(&active, &c)?);
            if !timed {
                walls.push(start.elapsed().as_secs_f64() * 1e6 / batch as f64);
                processor.push((processor_seconds() - busy) * 1e6 / batch as f64);
            }
        }
        profile = device.take_timings()?;
    }
    walls.sort_by(f64::total_cmp);
    processor.sort_by(f64::total_cmp);
    println!(
        "n {} m {} modes {} illuminated {} entries {} batch {batch} {precision} {edges:?}: min {:.1} median {:.1} max {:.1} us per image; processor time min {:.1} median {:.1}",
        layout.samples,
        layout.pixels,
        layout.modes.len(),
        layout.illuminated.len(),
        layout.segment_index.len(),
        walls[0],
        walls[walls.len() / 2],
        walls[walls.len() - 1],
        processor[0],
        processor[processor.len() / 2]
    );
    for stage in profile {
        let us = stage.device_time.as_secs_f64() * 1e6 / (5 * batch) as f64;
        let fastest = stage.fastest.as_secs_f64() * 1e6 * (stage.launches / 5) as f64 / batch as f64;
        println!("    {:<18} mean {us:7.2}, fastest launch {fastest:7.2} us per image", stage.kernel);
    }
    first.ok_or_else(|| cophase::Error::Internal("nothing was measured".into()))
}

/// Seconds that all threads of this process have run: what other programs on the machine do not
/// change.
#[cfg(feature = "opencl")]
fn processor_seconds() -> f64 {
    let mut now = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the pointer is to a timespec of our own.
    unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &mut now) };
    now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
}

#[cfg(feature = "opencl")]
mod scene {
    use cophase::imaging::gpu::{GpuColour, GpuLayout, GpuMode};
    use std::collections::BTreeMap;
    use std::f64::consts::PI;

    /// How a segment's weights fall off at its edge.
    #[derive(Debug, Clone, Copy)]
    pub enum Edges {
        /// The fraction of a sample that is glass.
        Grey,
        /// A windowed sinc, 10 samples either way: about 6 segments reach each sample, as in a
        /// band-limited pupil.
        BandLimited,
    }

    /// 36 hexagons in three rings, 66 smooth modes, q = 2: the cost of Keck, not its optics.
    pub fn keck_like(samples: usize, pixels: usize, edges: Edges) -> GpuLayout {
        let segments = hexagons(samples, edges);
        let mut lists: BTreeMap<usize, Vec<(usize, f64)>> = BTreeMap::new();
        for (s, weights) in segments.iter().enumerate() {
            for &(index, weight) in weights {
                lists.entry(index).or_default().push((s, weight));
            }
        }
        let illuminated: Vec<usize> = lists.keys().copied().collect();
        let mut layout = GpuLayout {
            samples,
            pixels,
            colours: vec![GpuColour {
                samples_per_lambda_over_d: 2.0,
                wavelength_nm: 1650.0,
                intensity_scale: 1e-8,
                diversity_turns: illuminated.iter().map(|&i| 1e-4 * ((i % samples) as f64 - 60.0).powi(2)).collect(),
            }],
            pixel_terms: None,
            smooth: (0..66)
                .map(|j| {
                    illuminated
                        .iter()
                        .map(|&i| ((i % samples) as f64 * 0.01 * j as f64 + i as f64 * 1e-4).cos())
                        .collect()
                })
                .collect(),
            illuminated,
            segments: segments.len(),
            segment_start: vec![0],
            segment_index: Vec::new(),
            segment_weight: Vec::new(),
            segment_slopes: None,
            modes: (0..36).map(GpuMode::Segment).chain((0..66).map(GpuMode::Smooth)).collect(),
            free_phase: false,
            free_wavelength_nm: 1650.0,
        };
        for list in lists.values() {
            layout.segment_index.extend(list.iter().map(|e| e.0));
            layout.segment_weight.extend(list.iter().map(|e| e.1));
            layout.segment_start.push(layout.segment_index.len());
        }
        layout
    }

    /// `(flat index, weight)` of each segment.
    fn hexagons(samples: usize, edges: Edges) -> Vec<Vec<(usize, f64)>> {
        const FINE: usize = 8;
        // Seven hexagons of width sqrt(3) r across the grid, corners of the outer ring inside.
        let side = (samples * FINE) as f64 / (7.1 * 3f64.sqrt());
        let reach = match edges {
            Edges::Grey => 0.5,
            Edges::BandLimited => 10.0,
        };
        let tap = |t: f64| match edges {
            Edges::Grey => f64::from(t.abs() < 0.5),
            Edges::BandLimited if t == 0.0 => 1.0,
            Edges::BandLimited => (PI * t).sin() / (PI * t) * (0.5 + 0.5 * (PI * t / 10.0).cos()),
        };
        let mut segments = Vec::new();
        for (a, b) in (-3i32..=3).flat_map(|a| (-3i32..=3).map(move |b| (a, b))) {
            if (a + b).abs() > 3 || (a, b) == (0, 0) {
                continue;
            }
            let centre = (samples * FINE) as f64 / 2.0;
            let (cx, cy) =
                (centre + side * 1.5 * f64::from(a), centre + side * 3f64.sqrt() * f64::from(2 * b + a) / 2.0);
            let inside = |x: f64, y: f64| {
                let (x, y) = ((x - cx).abs(), (y - cy).abs());
                y <= side * 3f64.sqrt() / 2.0 && 3f64.sqrt() * x + y <= 3f64.sqrt() * side
            };
            let margin = side + reach * FINE as f64 + FINE as f64;
            let range = |c: f64| {
                let low = ((c - margin) / FINE as f64).max(0.0) as usize;
                low..(((c + margin) / FINE as f64) as usize + 1).min(samples)
            };
            let taps = |j: usize| {
                let middle = (j as f64 + 0.5) * FINE as f64;
                let low = (middle - reach * FINE as f64).max(0.0) as usize;
                let high = ((middle + reach * FINE as f64) as usize).min(samples * FINE);
                (low..high)
                    .map(|f| (f as f64 + 0.5, tap((f as f64 + 0.5 - middle) / FINE as f64) / FINE as f64))
                    .collect::<Vec<_>>()
            };
            let mut weights = Vec::new();
            for y in range(cy) {
                for x in range(cx) {
                    let (rows, columns) = (taps(y), taps(x));
                    let weight: f64 = rows
                        .iter()
                        .map(|&(fy, wy)| wy * columns.iter().filter(|c| inside(c.0, fy)).map(|c| c.1).sum::<f64>())
                        .sum();
                    if weight.abs() > 1e-5 {
                        weights.push((y * samples + x, weight));
                    }
                }
            }
            segments.push(weights);
        }
        segments
    }
}

//! The device against sums written out one by one in f64.

use num_complex::Complex64;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

use super::*;
use crate::device::tests::test_devices;
use crate::device::{Build, Device, FftPlan, Precision};

/// A small asymmetric scene that hits every corner of the packing: extents that fill no vector, dark rows and blocks,
/// segments that overlap with weights of either sign, a mode that nothing uses.
fn scene() -> GpuLayout {
    let (n, segments, smooth): (usize, _, _) = (18, 5, 7);
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let lit: Vec<usize> = (0..n * n)
        .filter(|i| {
            let (y, x) = (i / n, i % n);
            // Dark: an edge, two corners, and on the axis a whole row and a hole, which no block may forget.
            let hole = y.abs_diff(8).min(y.abs_diff(9)) < 3 && x.abs_diff(8).min(x.abs_diff(9)) < 4;
            !matches!(y, 8 | 9)
                && !hole
                && y > 1
                && x < 17
                && (y + x) < 29
                && !(x < 5 && y > 9)
                && random.random::<f64>() < 0.9
        })
        .collect();
    let mut uniform = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
    let (mut segment_start, mut segment_index, mut segment_weight) = (vec![0], Vec::new(), Vec::new());
    for (p, index) in lit.iter().enumerate() {
        for s in 0..1 + p % 3 {
            segment_index.push((index / 70 + s) % segments);
            segment_weight.push(if s == 0 { uniform(0.5, 1.0) } else { uniform(-0.2, 0.2) });
        }
        segment_start.push(segment_index.len());
    }
    let diversity_turns = lit.iter().map(|_| uniform(-3.0, 3.0)).collect();
    let smooth: Vec<Vec<f64>> = (0..smooth).map(|_| lit.iter().map(|_| uniform(-1.5, 1.5)).collect()).collect();
    let mut modes: Vec<GpuMode> = (0..segments).map(GpuMode::Segment).collect();
    modes.splice(2..2, (0..smooth.len() - 1).rev().map(GpuMode::Smooth));
    GpuLayout {
        samples: n,
        pixels: 22,
        samples_per_lambda_over_d: 1.3,
        wavelength_nm: 1650.0,
        intensity_scale: 2.5e-5,
        lit,
        diversity_turns,
        smooth,
        segments,
        segment_start,
        segment_index,
        segment_weight,
        segment_slopes: None,
        modes,
        free_phase: false,
    }
}

/// The same with some segments that tilt, one of them along one axis only.
fn tilted_scene() -> GpuLayout {
    let mut layout = scene();
    let mut random = ChaCha8Rng::seed_from_u64(8);
    let mut slopes = || layout.segment_index.iter().map(|_| 4.0 * random.random::<f64>() - 2.0).collect();
    layout.segment_slopes = Some((slopes(), slopes()));
    layout.modes.splice(4..4, [GpuMode::Tilt(2), GpuMode::Tip(0), GpuMode::Tip(2), GpuMode::Tilt(4), GpuMode::Tip(4)]);
    layout
}

/// The same with a phase of its own at each lit sample.
fn free_scene() -> GpuLayout {
    GpuLayout { free_phase: true, ..scene() }
}

/// A free phase of up to half a turn either way for each of `images`; none where the layout has none.
fn free_phases(layout: &GpuLayout, images: usize, random: &mut impl Rng) -> Vec<f64> {
    let count = if layout.free_phase { images * layout.lit.len() } else { 0 };
    (0..count).map(|_| random.random::<f64>() - 0.5).collect()
}

/// A free phase is to its image what the diversity is to all.
fn with_free(layout: &GpuLayout, free: &[f64]) -> GpuLayout {
    let free = free.iter().copied().chain(std::iter::repeat(0.0));
    GpuLayout {
        diversity_turns: layout.diversity_turns.iter().zip(free).map(|(d, f)| d + f).collect(),
        ..layout.clone()
    }
}

/// Images that the scene could have made, with bad pixels (one of them NaN) and uneven weights.
struct Images {
    data: Vec<f64>,
    weights: Vec<f64>,
    photometry: Vec<GpuPhotometry>,
}

fn images(layout: &GpuLayout, count: usize, random: &mut impl Rng) -> Images {
    let size = layout.pixels * layout.pixels;
    let (mut data, mut weights, mut photometry) = (Vec::new(), Vec::new(), Vec::new());
    for image in 0..count {
        let truth = coefficients(layout, 1, random);
        let (_, psf) = field_and_psf(layout, &truth);
        for (i, h) in psf.iter().enumerate() {
            let bad = (i + image) % 53 == 0;
            data.push(if bad { f64::NAN } else { 4e4 * h + 12.0 + random.random::<f64>() * 20.0 });
            weights.push(if bad { 0.0 } else { 0.2 + random.random::<f64>() });
        }
        photometry.push(match image % 3 {
            0 => GpuPhotometry::FitBoth,
            1 => GpuPhotometry::FitFlux { background_e: 15.0 },
            _ => GpuPhotometry::Known { flux_e: 3.7e4, background_e: 20.0 },
        });
    }
    assert_eq!(data.len(), count * size);
    Images { data, weights, photometry }
}

fn coefficients(layout: &GpuLayout, images: usize, random: &mut impl Rng) -> Vec<f64> {
    (0..images * layout.modes.len()).map(|_| 150.0 * (random.random::<f64>() - 0.5)).collect()
}

/// Pupil: P, a and E = a P at each lit sample, and the PSF: the definition, sum by sum.
fn field_and_psf(layout: &GpuLayout, coefficients: &[f64]) -> (Vec<[Complex64; 3]>, Vec<f64>) {
    let pupil = pupil(layout, coefficients);
    let psf = focal(layout, &pupil).iter().map(|u| layout.intensity_scale * u.norm_sqr()).collect();
    (pupil, psf)
}

fn turn(t: f64) -> Complex64 {
    Complex64::from_polar(1.0, TAU * t)
}

/// How much of `mode` there is, turns.
fn amount(layout: &GpuLayout, coefficients: &[f64], mode: GpuMode) -> f64 {
    layout.modes.iter().zip(coefficients).filter(|(m, _)| **m == mode).map(|(_, c)| c / layout.wavelength_nm).sum()
}

fn slope(layout: &GpuLayout, entry: usize) -> (f64, f64) {
    layout.segment_slopes.as_ref().map_or((0.0, 0.0), |(x, y)| (x[entry], y[entry]))
}

/// The phasor of each entry's segment where the entry is.
fn stands(layout: &GpuLayout, coefficients: &[f64]) -> Vec<Complex64> {
    let poses: Vec<[f64; 3]> = (0..layout.segments)
        .map(|s| [GpuMode::Segment(s), GpuMode::Tip(s), GpuMode::Tilt(s)].map(|m| amount(layout, coefficients, m)))
        .collect();
    let stand = |(e, &s): (usize, &usize)| {
        let ([c, t, u], (x, y)) = (poses[s], slope(layout, e));
        turn(c + t * x + u * y)
    };
    layout.segment_index.iter().enumerate().map(stand).collect()
}

fn pupil(layout: &GpuLayout, coefficients: &[f64]) -> Vec<[Complex64; 3]> {
    let amount = |mode: GpuMode| amount(layout, coefficients, mode);
    let stands = stands(layout, coefficients);
    let smooth: Vec<f64> = (0..layout.smooth.len()).map(|j| amount(GpuMode::Smooth(j))).collect();
    (0..layout.lit.len())
        .map(|p| {
            let psi = layout.diversity_turns[p] + layout.smooth.iter().zip(&smooth).map(|(b, y)| b[p] * y).sum::<f64>();
            let a: Complex64 = (layout.segment_start[p]..layout.segment_start[p + 1])
                .map(|e| stands[e] * layout.segment_weight[e])
                .sum();
            [turn(psi), a, a * turn(psi)]
        })
        .collect()
}

/// exp(-2 pi i step (x u + y v)) of a lit sample and a pixel.
fn kernel(layout: &GpuLayout, sample: usize, pixel: usize) -> Complex64 {
    let (n, m) = (layout.samples, layout.pixels);
    let centre = |i: usize| i as f64 - (n as f64 - 1.0) / 2.0;
    let axis = |i: usize| i as f64 - m as f64 / 2.0;
    let turns = centre(sample % n) * axis(pixel % m) + centre(sample / n) * axis(pixel / m);
    Complex64::from_polar(1.0, -TAU * turns / (n as f64 * layout.samples_per_lambda_over_d))
}

fn focal(layout: &GpuLayout, pupil: &[[Complex64; 3]]) -> Vec<Complex64> {
    (0..layout.pixels * layout.pixels)
        .map(|pixel| layout.lit.iter().zip(pupil).map(|(&sample, p)| p[2] * kernel(layout, sample, pixel)).sum())
        .collect()
}

struct Answer {
    objective: f64,
    flux: f64,
    background: f64,
    gradient: Vec<f64>,
    /// Derivative by the phase of each lit sample, per turn.
    slopes: Vec<f64>,
}

fn reference(layout: &GpuLayout, coefficients: &[f64], d: &[f64], w: &[f64], photometry: GpuPhotometry) -> Answer {
    let pupil = pupil(layout, coefficients);
    let u = focal(layout, &pupil);
    let h: Vec<f64> = u.iter().map(|u| layout.intensity_scale * u.norm_sqr()).collect();
    let good = || (0..h.len()).filter(|&i| w[i] > 0.0);
    let (flux, background) = match photometry {
        GpuPhotometry::Known { flux_e, background_e } => (flux_e, background_e),
        GpuPhotometry::FitFlux { background_e } => {
            let top: f64 = good().map(|i| w[i] * h[i] * (d[i] - background_e)).sum();
            (top / good().map(|i| w[i] * h[i] * h[i]).sum::<f64>(), background_e)
        }
        GpuPhotometry::FitBoth => {
            // About the weighted means: the well-conditioned form of the normal equations.
            let weight: f64 = good().map(|i| w[i]).sum();
            let mean = |f: &[f64]| good().map(|i| w[i] * f[i]).sum::<f64>() / weight;
            let (mh, md) = (mean(&h), mean(d));
            let top: f64 = good().map(|i| w[i] * (h[i] - mh) * (d[i] - md)).sum();
            let flux = top / good().map(|i| w[i] * (h[i] - mh).powi(2)).sum::<f64>();
            (flux, md - flux * mh)
        }
    };
    let r: Vec<f64> = (0..h.len()).map(|i| if w[i] > 0.0 { flux * h[i] + background - d[i] } else { 0.0 }).collect();
    let k = TAU / layout.wavelength_nm;
    // dJ/dE* at each lit sample, through the adjoint sum.
    let bar: Vec<Complex64> = layout
        .lit
        .iter()
        .map(|&sample| {
            (0..h.len())
                .map(|i| u[i] * kernel(layout, sample, i).conj() * (2.0 * layout.intensity_scale * flux * w[i] * r[i]))
                .sum()
        })
        .collect();
    let stands = stands(layout, coefficients);
    let segment = |s: usize, along: &dyn Fn(usize) -> f64| {
        let each = |p: usize| {
            (layout.segment_start[p]..layout.segment_start[p + 1])
                .filter(|&e| layout.segment_index[e] == s)
                .map(|e| along(e) * layout.segment_weight[e] * (stands[e].conj() * pupil[p][0].conj() * bar[p]).im)
                .sum::<f64>()
        };
        2.0 * k * (0..bar.len()).map(each).sum::<f64>()
    };
    let slopes: Vec<f64> = pupil.iter().zip(&bar).map(|(p, bar)| 2.0 * TAU * (p[2].conj() * bar).im).collect();
    let gradient = layout.modes.iter().map(|mode| match *mode {
        GpuMode::Smooth(j) => layout.smooth[j].iter().zip(&slopes).map(|(b, d)| b * d / layout.wavelength_nm).sum(),
        GpuMode::Segment(s) => segment(s, &|_| 1.0),
        GpuMode::Tip(s) => segment(s, &|e| slope(layout, e).0),
        GpuMode::Tilt(s) => segment(s, &|e| slope(layout, e).1),
    });
    let objective = (0..h.len()).map(|i| w[i] * r[i] * r[i]).sum();
    Answer { objective, flux, background, gradient: gradient.collect(), slopes }
}

#[test]
fn the_reference_agrees_with_its_own_finite_differences() {
    [scene(), tilted_scene()].iter().for_each(differences_in);
}

fn differences_in(layout: &GpuLayout) {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let images = images(layout, 3, &mut random);
    let size = layout.pixels * layout.pixels;
    let c = coefficients(layout, 1, &mut random);
    for image in 0..3 {
        let range = image * size..(image + 1) * size;
        let at = |c: &[f64]| {
            reference(layout, c, &images.data[range.clone()], &images.weights[range.clone()], images.photometry[image])
        };
        let answer = at(&c);
        let scale = answer.gradient.iter().fold(0.0f64, |a, g| a.max(g.abs()));
        for k in 0..c.len() {
            // A step of 1e-5 wave: the cubic term of the difference is (2 pi 1e-5)^2 ~ 4e-9 of the gradient, the rounding
            // 1e-16 J/(step g) ~ 1e-10.
            let step = 0.0165;
            let shifted =
                |by: f64| at(&c.iter().enumerate().map(|(i, v)| v + if i == k { by } else { 0.0 }).collect::<Vec<_>>());
            let difference = (shifted(step).objective - shifted(-step).objective) / (2.0 * step);
            assert!((difference - answer.gradient[k]).abs() < 1e-6 * scale, "{k}: {difference} {}", answer.gradient[k]);
        }
    }
}

/// Every build that a device may be given.
fn builds(device: &Device) -> Vec<Build> {
    let mut builds = Vec::new();
    for precision in [Precision::F32, Precision::F64] {
        if device.info().supports(precision) {
            builds.extend([1, 4, 8, 16].map(|vector| Build { precision, vector, fft: None }));
        }
    }
    builds
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
    norm(&mut a.iter().zip(b).map(|(a, b)| a - b)) / norm(&mut b.iter().copied())
}

#[test]
fn psfs_agree_with_the_direct_sum() {
    let layout = scene();
    let mut random = ChaCha8Rng::seed_from_u64(2);
    let c = coefficients(&layout, 6, &mut random);
    let wanted: Vec<f64> = c.chunks_exact(layout.modes.len()).flat_map(|c| field_and_psf(&layout, c).1).collect();
    let peak = wanted.iter().fold(0.0f64, |a, h| a.max(*h));
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        for build in builds(&device) {
            let psf = GpuChain::with_build(&device, build, &layout, 3).unwrap().psf(&c).unwrap();
            let worst = psf.iter().zip(&wanted).fold(0.0f64, |a, (h, w)| a.max((h - w).abs())) / peak;
            // f32: 250 samples whose phases err by a few 1e-7 rad each (turns of up to 4 in 24 bits, times 2 pi) and
            // whose signs are random: 1e-7 of the field at the peak, twice that of its square; 10 of it allowed.
            let allowed = if build.precision == Precision::F32 { 2e-6 } else { 1e-12 };
            println!("{build:?}: PSF within {worst:.1e} of the peak");
            assert!(worst < allowed, "{build:?}: {worst:e} of the peak");
        }
    }
}

#[test]
fn objective_gradient_and_photometry_agree_with_the_direct_sum() {
    // Out of order, one of them twice, and more than the chain has room for: it goes in two rounds.
    let active = [4, 0, 5, 2, 2, 1, 3];
    for layout in [scene(), tilted_scene(), free_scene()] {
        agreement_in(&layout, &active, builds);
    }
}

/// A whole image of the least that there is a plan for.
fn whole_scene() -> GpuLayout {
    GpuLayout { pixels: 64, samples_per_lambda_over_d: 64.0 / 18.0, free_phase: true, ..scene() }
}

#[test]
fn the_fft_agrees_with_the_direct_sum() {
    let builds = |device: &Device| {
        let precisions = [Precision::F32, Precision::F64].into_iter().filter(|&p| device.info().supports(p));
        precisions.map(|precision| Build { precision, vector: 4, fft: FftPlan::new(64, 9) }).collect()
    };
    agreement_in(&whole_scene(), &[1, 0], builds);
}

fn agreement_in(layout: &GpuLayout, active: &[usize], builds: impl Fn(&Device) -> Vec<Build>) {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let count = active.iter().max().unwrap() + 1;
    let images = images(layout, count, &mut random);
    let size = layout.pixels * layout.pixels;
    let c = coefficients(layout, active.len(), &mut random);
    let free = free_phases(layout, active.len(), &mut random);
    let lit = free.len() / active.len();
    let wanted: Vec<Answer> = (active.iter().zip(c.chunks_exact(layout.modes.len())).enumerate())
        .map(|(k, (&i, c))| {
            let (range, layout) = (i * size..(i + 1) * size, with_free(layout, &free[k * lit..(k + 1) * lit]));
            reference(&layout, c, &images.data[range.clone()], &images.weights[range], images.photometry[i])
        })
        .collect();
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        for build in builds(&device) {
            let mut chain = GpuChain::with_build(&device, build, layout, count).unwrap();
            // The second evaluation finds every scratch array dirty.
            chain.load(&images.data, &images.weights, &images.photometry).unwrap();
            let all: Vec<usize> = (0..count).collect();
            chain.evaluate(&all, &coefficients(layout, count, &mut random)).unwrap();
            let mut slopes = vec![f64::NAN; free.len()];
            let found = chain.evaluate_free(active, &c, &free, &mut slopes).unwrap();
            // Sums of 500 pixels and 250 samples of terms that err by 1e-7 (f32) or 1e-16 each: some 1e-6 or 1e-15 where
            // signs are random. Residuals here are of the order of the image, so nothing cancels.
            let [close, closer] = if build.precision == Precision::F32 { [1e-5, 1e-5] } else { [1e-12, 1e-11] };
            for (i, wanted) in wanted.iter().enumerate() {
                let gradient = &found.gradient[i * layout.modes.len()..(i + 1) * layout.modes.len()];
                let slopes = &slopes[i * lit..(i + 1) * lit];
                let errors = [
                    (found.objective[i] / wanted.objective - 1.0).abs(),
                    (found.flux_e[i] / wanted.flux - 1.0).abs(),
                    (found.background_e[i] - wanted.background).abs() / wanted.flux.abs() * 22.0,
                    distance(gradient, &wanted.gradient),
                    if layout.free_phase { distance(slopes, &wanted.slopes) } else { 0.0 },
                ];
                if i == 0 {
                    println!("{build:?}: objective, flux, background, gradient, slopes within {errors:?}");
                }
                assert!(errors[..3].iter().all(|e| *e < close), "{build:?} image {i}: {errors:?}");
                assert!(errors[3..].iter().all(|e| *e < closer), "{build:?} image {i}: {errors:?}");
            }
        }
    }
}

#[test]
fn a_faint_star_on_a_bright_background_keeps_its_digits() {
    let layout = scene();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let size = layout.pixels * layout.pixels;
    let c = coefficients(&layout, 3, &mut random);
    let images = images(&layout, 3, &mut random);
    // 300 electrons of star on 50,000 per pixel: in f32 the data themselves would be rounded by 0.004.
    let data: Vec<f64> = images.data.iter().map(|d| 5e4 + d / 130.0).collect();
    let photometry = [
        GpuPhotometry::FitBoth,
        GpuPhotometry::FitFlux { background_e: 5e4 + 0.1 },
        GpuPhotometry::Known { flux_e: 290.0, background_e: 5e4 },
    ];
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        let mut chain = GpuChain::new(&device, Precision::F32, &layout, 3).unwrap();
        chain.load(&data, &images.weights, &photometry).unwrap();
        let found = chain.evaluate(&[0, 1, 2], &c).unwrap();
        for (i, c) in c.chunks_exact(layout.modes.len()).enumerate() {
            let range = i * size..(i + 1) * size;
            let wanted = reference(&layout, c, &data[range.clone()], &images.weights[range], photometry[i]);
            let gradient = &found.gradient[i * layout.modes.len()..(i + 1) * layout.modes.len()];
            let errors = [
                (found.objective[i] / wanted.objective - 1.0).abs(),
                (found.flux_e[i] / wanted.flux - 1.0).abs(),
                distance(gradient, &wanted.gradient),
            ];
            println!("{info}: image {i} within {errors:?}");
            // As for a bright star; without the offset the flux alone would be wrong by some 1e-3.
            assert!(errors.iter().all(|e| *e < 1e-5), "image {i}: {errors:?}");
        }
    }
}

#[test]
fn an_image_alone_and_in_a_crowd_gives_the_same() {
    [scene(), tilted_scene(), free_scene()].iter().for_each(crowd_in);
}

fn crowd_in(layout: &GpuLayout) {
    let mut random = ChaCha8Rng::seed_from_u64(4);
    let images = images(layout, 3, &mut random);
    let c = coefficients(layout, 3, &mut random);
    let modes = layout.modes.len();
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        for build in builds(&device) {
            // So many that every processor goes through focus.cl, in several tiles; one goes stage by stage.
            let crowd: Vec<usize> = (0..3).cycle().take(2 * info.compute_units as usize + 37).collect();
            let mut chain = GpuChain::with_build(&device, build, layout, crowd.len()).unwrap();
            chain.load(&images.data, &images.weights, &images.photometry).unwrap();
            let all: Vec<f64> = crowd.iter().flat_map(|&i| c[i * modes..(i + 1) * modes].to_vec()).collect();
            let free = free_phases(layout, 3, &mut random);
            let lit = free.len() / 3;
            let all_free: Vec<f64> = crowd.iter().flat_map(|&i| free[i * lit..(i + 1) * lit].to_vec()).collect();
            let mut slopes = vec![f64::NAN; all_free.len()];
            let together = chain.evaluate_free(&crowd, &all, &all_free, &mut slopes).unwrap();
            // The same sums in the same order; only where the compiler fuses a product into a sum may differ: a few
            // roundings, far below the errors of the test above.
            let close = if build.precision == Precision::F32 { 1e-6 } else { 1e-14 };
            for (i, &image) in crowd.iter().enumerate() {
                let mut slopes_alone = vec![f64::NAN; lit];
                let (own, own_free) = (&c[image * modes..(image + 1) * modes], &free[image * lit..(image + 1) * lit]);
                let alone = chain.evaluate_free(&[image], own, own_free, &mut slopes_alone).unwrap();
                let objective = (together.objective[i] / alone.objective[0] - 1.0).abs();
                let gradient = distance(&together.gradient[i * modes..(i + 1) * modes], &alone.gradient);
                let slopes = if lit > 0 { distance(&slopes[i * lit..(i + 1) * lit], &slopes_alone) } else { 0.0 };
                let apart = objective.max(gradient).max(slopes);
                assert!(apart < close, "{build:?} image {i}: {objective:e} {gradient:e} {slopes:e}");
            }
        }
    }
}

#[test]
fn memory_is_what_the_formula_says_and_tiles_follow_from_it() {
    let whole = whole_scene();
    for info in test_devices() {
        let device = Device::open(&info, false).unwrap();
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let plain = [scene(), tilted_scene(), free_scene()];
        for (layout, fft) in
            [(&plain[0], None), (&plain[1], None), (&plain[2], None), (&whole, FftPlan::new(64, 9)), (&whole, None)]
        {
            let own = |build: &Build| *build == Build::for_device(&info, build.precision);
            for build in builds(&device).into_iter().filter(|b| own(b) || (b.vector == 1 && fft.is_none())) {
                let build = Build { fft, ..build };
                let capacity = 41;
                let mut chain = GpuChain::with_build(&device, build, layout, capacity).unwrap();
                // Not a byte beside: the sum over the buffers is taken where they are made.
                assert_eq!(chain.bytes(), device.allocated_bytes(), "{build:?}");

                // Less memory: smaller tiles, the same numbers.
                let images = images(layout, 3, &mut random);
                let data: Vec<usize> = (0..capacity).map(|i| i % 3).collect();
                let c = coefficients(layout, capacity, &mut random);
                chain.load(&images.data, &images.weights, &images.photometry).unwrap();
                let wanted = chain.evaluate(&data, &c).unwrap();
                let bytes = chain.bytes();
                drop(chain);
                assert_eq!(device.allocated_bytes(), 0);
                let mut least = bytes;
                while let Ok(chain) = GpuChain::with_memory(&device, build, layout, capacity, least - 1) {
                    assert!(chain.bytes() < least && chain.bytes() == device.allocated_bytes(), "{build:?}");
                    least = chain.bytes();
                }
                let mut small = GpuChain::with_memory(&device, build, layout, capacity, least).unwrap();
                assert!(small.bytes() < bytes);
                small.load(&images.data, &images.weights, &images.photometry).unwrap();
                let found = small.evaluate(&data, &c).unwrap();
                // As between an image alone and in a crowd.
                let close = if build.precision == Precision::F32 { 1e-6 } else { 1e-14 };
                assert!(distance(&found.gradient, &wanted.gradient) < close, "{build:?}");
                let refusal = GpuChain::with_memory(&device, build, layout, capacity, 1000).unwrap_err().to_string();
                assert!(refusal.contains("1000") && refusal.contains("41 images"), "{refusal}");
            }
        }
    }
}

#[test]
fn a_chain_may_move_to_another_thread() {
    fn moves<T: Send>() {}
    moves::<GpuChain>();
}

#[test]
fn bad_input_is_named() {
    let Some(info) = test_devices().into_iter().next() else { return };
    let device = Device::open(&info, false).unwrap();
    let layout = scene();
    let new = |layout: &GpuLayout| GpuChain::new(&device, Precision::F32, layout, 2).map(|_| ());
    assert!(new(&layout).is_ok());
    type Change = fn(&mut GpuLayout);
    let broken: [(&str, Change); 9] = [
        ("17", |l| l.samples = 17),
        ("0 image pixels", |l| l.pixels = 0),
        ("wavelength_nm", |l| l.wavelength_nm = f64::NAN),
        ("diversity_turns", |l| l.diversity_turns.truncate(3)),
        ("twice", |l| l.lit[1] = l.lit[0]),
        ("outside a pupil", |l| l.lit[0] = 18 * 18),
        ("segment 9", |l| l.segment_index[3] = 9),
        ("segment weight", |l| l.segment_weight[0] = f64::INFINITY),
        ("smooth mode 7", |l| l.modes[0] = GpuMode::Smooth(7)),
    ];
    for (word, change) in broken {
        let mut layout = layout.clone();
        change(&mut layout);
        let message = new(&layout).unwrap_err().to_string();
        assert!(message.contains(word), "`{message}` names {word}");
    }

    let mut chain = GpuChain::new(&device, Precision::F32, &layout, 2).unwrap();
    let size = layout.pixels * layout.pixels;
    let fit = GpuPhotometry::FitBoth;
    assert!(chain.load(&vec![1.0f32; size], &vec![1.0f32; size - 1], &[fit]).is_err());
    assert!(chain.load(&vec![1.0; 3 * size], &vec![1.0; 3 * size], &[fit; 3]).is_err());
    assert!(chain.load(&vec![f64::NAN; size], &vec![1.0; size], &[fit]).is_err());
    assert!(chain.load(&vec![1.0; size], &vec![-1.0; size], &[fit]).is_err());
    chain.load(&vec![1.0; size], &vec![1.0; size], &[fit]).unwrap();
    let zeros = vec![0.0; layout.modes.len()];
    assert!(chain.evaluate(&[0], &zeros).is_ok());
    assert!(chain.evaluate(&[1], &zeros).is_err());
    assert!(chain.evaluate(&[0], &zeros[1..]).is_err());
    assert!(chain.evaluate(&[0], &vec![f64::INFINITY; layout.modes.len()]).is_err());
    assert!(chain.evaluate(&[], &[]).unwrap().objective.is_empty());
}

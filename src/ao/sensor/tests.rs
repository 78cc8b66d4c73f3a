use super::*;
use crate::scene::Scene;
use crate::telescope::Telescope;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

struct Bench {
    scene: Scene,
    pupil: Pupil,
    footprint: Footprint,
    sensor: Sensor,
}

fn bench(settings: &[(&str, &str)]) -> Bench {
    let scene = Scene::preset("keck-onsky").unwrap().with(settings).unwrap();
    let telescope = Telescope::new(&scene).unwrap();
    let part = scene.wavefront_sensor.as_ref().unwrap();
    let samples = part.lenslets_across * part.samples_per_lenslet;
    let pupil = telescope.pupil_on(Grid::new(samples, telescope.pupil.grid.width_m()).unwrap()).unwrap();
    let footprint = Footprint::new(&pupil);
    let lenslets = Lenslets::new(part, &pupil, scene.directory()).unwrap();
    let sensor = Sensor::new(part, lenslets, &pupil, &footprint).unwrap();
    Bench { pupil, footprint, sensor, scene }
}

fn full(bench: &Bench) -> Vec<usize> {
    let light = &bench.sensor.lenslets.light;
    (0..light.len()).filter(|&i| light[i] > 0.999).collect()
}

const DETECTORS: [&str; 3] = ["quad-cell", "pixels", "geometric"];

#[test]
fn the_preset_has_the_subapertures_of_at_least_half_light() {
    // Counted by an independent program on the same segments.
    assert_eq!(bench(&[]).sensor.slopes(), 2 * 248);
}

#[test]
fn a_known_tilt_is_measured_in_mas_by_every_detector() {
    for detector in DETECTORS {
        let mut bench = bench(&[("wavefront_sensor.detector", detector)]);
        let mut slopes = vec![0.0; bench.sensor.slopes()];
        for mas in [-8.0, 0.0, 4.0] {
            let map = tilt(mas, &bench.pupil.grid, &bench.footprint);
            bench.sensor.measure(&map, None, &mut slopes).unwrap();
            for i in full(&bench) {
                // 8 mas is a thirtieth of λ/d: a sine's third-order term is below 1 % of it.
                // Crosstalk is rounding.
                assert!((f64::from(slopes[i]) - mas).abs() < 0.08, "{detector} {mas}: {}", slopes[i]);
                assert!(slopes[248 + i].abs() < 2e-2, "{detector} {mas}: {}", slopes[248 + i]);
            }
        }
    }
}

#[test]
fn the_quad_cell_is_the_half_planes_of_the_padded_transform() {
    // Two pixels a side form a quad cell by the transform: centre of gravity (R − L)/2/(R + L).
    let mut cell = bench(&[]);
    let mut camera = bench(&[("wavefront_sensor.detector", "pixels"), ("wavefront_sensor.pixels_per_lenslet", "2")]);
    let mut map = cell.footprint.zeros();
    for (i, out) in map.iter_mut().enumerate() {
        *out = 150.0 * ((i * i % 4177) as f32 * 0.01).sin() + 0.3 * (i % 240) as f32;
    }
    let (mut closed, mut transformed) = (vec![0.0; 496], vec![0.0; 496]);
    let noiseless = |detector: &mut Detector, out: &mut [f32]| detector.raw_slopes(&map, None, out);
    noiseless(&mut cell.sensor.detector, &mut closed);
    noiseless(&mut camera.sensor.detector, &mut transformed);
    for (closed, transformed) in closed.iter().zip(&transformed) {
        // Sums of 144 products in single precision, of order 1: some 1e-6.
        assert!((closed - 2.0 * transformed).abs() < 1e-5, "{closed} {transformed}");
    }
    assert!(closed.iter().any(|s| s.abs() > 0.1), "the test needs large signals");
}

#[test]
fn the_signs_of_both_axes_follow_the_convention() {
    for detector in DETECTORS {
        let mut bench = bench(&[("wavefront_sensor.detector", detector)]);
        let (grid, stride) = (bench.pupil.grid, bench.footprint.stride());
        let mut map = bench.footprint.zeros();
        for y in 0..grid.samples() {
            for x in 0..grid.samples() {
                map[y * stride + x] = (10.0 * grid.coordinate_m(x) - 25.0 * grid.coordinate_m(y)) as f32;
            }
        }
        let mut slopes = vec![0.0; bench.sensor.slopes()];
        bench.sensor.measure(&map, None, &mut slopes).unwrap();
        let i = full(&bench)[7];
        assert!((f64::from(slopes[i]) / (10.0 * MAS_PER_NM_M) - 1.0).abs() < 0.01, "{detector}");
        assert!((f64::from(slopes[248 + i]) / (-25.0 * MAS_PER_NM_M) - 1.0).abs() < 0.01, "{detector}");
    }
}

#[test]
fn a_field_stop_keeps_small_slopes_and_loses_spots_outside() {
    let camera = [("wavefront_sensor.detector", "pixels"), ("wavefront_sensor.pixels_per_lenslet", "12")];
    let whole = bench(&camera);
    let stopped = bench(&[camera.as_slice(), &[("wavefront_sensor.field_pixels", "4")]].concat());
    // A pixel is λ/d, 640 nm over a lenslet of 0.5625 m: a slope of 1138 nm/m, or 235 mas.
    let (pixel_nm_m, i) = (640.0 / 0.5625, full(&whole)[7]);
    let [mut whole, mut stopped] = [whole, stopped].map(|mut bench| {
        move |pixels: f64| {
            let (grid, stride) = (bench.pupil.grid, bench.footprint.stride());
            let mut map = bench.footprint.zeros();
            for y in 0..grid.samples() {
                for x in 0..grid.samples() {
                    map[y * stride + x] = (pixels * pixel_nm_m * grid.coordinate_m(x)) as f32;
                }
            }
            let mut slopes = vec![0.0; bench.sensor.slopes()];
            bench.sensor.measure(&map, None, &mut slopes).unwrap();
            f64::from(slopes[i]) / (pixel_nm_m * MAS_PER_NM_M)
        }
    });
    // Slopes are calibrated with the stop, so that a small one is right with both.
    for slope in [whole(0.05), stopped(0.05)] {
        assert!((slope / 0.05 - 1.0).abs() < 0.02, "{slope}");
    }
    // Four pixels from the centre the spot is outside of the stop, which ends two pixels from it.
    let (seen, lost) = (whole(4.0), stopped(4.0));
    assert!((seen / 4.0 - 1.0).abs() < 0.1 && lost < 0.75 * seen, "{seen} {lost}");
}

/// RMS noise of a full subaperture's slopes of a flat wavefront, mas.
fn noise_mas(settings: &[(&str, &str)]) -> f64 {
    let mut bench = bench(settings);
    let part = bench.scene.wavefront_sensor.clone().unwrap();
    let pitch_m = bench.sensor.lenslets.pitch_m;
    let mut light = GuideStar::new(&part, pitch_m, 1.0 / 1054.0, ChaCha8Rng::seed_from_u64(3));
    let (flat, mut slopes) = (bench.footprint.zeros(), vec![0.0; 496]);
    let used = full(&bench);
    let (mut square, mut count) = (0.0, 0.0);
    for _ in 0..40 {
        bench.sensor.measure(&flat, Some(&mut light), &mut slopes).unwrap();
        square += used.iter().map(|&i| f64::from(slopes[i]).powi(2)).sum::<f64>();
        count += used.len() as f64;
    }
    (square / count).sqrt()
}

#[test]
fn photon_noise_falls_as_root_of_light_and_read_noise_as_light() {
    let quiet = ("wavefront_sensor.read_noise_e", "0.0");
    // 82,500, 825 and 8.25 electrons: normal above 100, drawn photon by photon below.
    let [bright, medium, faint] =
        ["4.0", "9.0", "14.0"].map(|r| noise_mas(&[quiet, ("wavefront_sensor.star_magnitude_r", r)]));
    // 40 frames of about 150 subapertures: known to 1 %.
    assert!((medium / bright / 10.0 - 1.0).abs() < 0.05, "{bright} {medium}");
    // With 8 photons the mean of 1/N exceeds 1/(mean N) by some 20 %, and so does the noise, by
    // half of it or more.
    assert!((1.0..1.5).contains(&(faint / medium / 10.0)), "{medium} {faint}");
    let dark = ("wavefront_sensor.photon_noise", "false");
    let read = |e: &str, r: &str| {
        noise_mas(&[dark, ("wavefront_sensor.read_noise_e", e), ("wavefront_sensor.star_magnitude_r", r)])
    };
    assert!((read("4.0", "4.0") / read("0.4", "4.0") / 10.0 - 1.0).abs() < 0.05);
    assert!((read("0.4", "6.5") / read("0.4", "4.0") / 10.0 - 1.0).abs() < 0.05);
}

#[test]
fn photon_noise_of_the_quad_cell_is_that_of_counting() {
    // The signal's standard deviation is 1/√N; its scale turns it into mas.
    let unit_mas = f64::from(bench(&[]).sensor.unit_mas);
    let quiet = [("wavefront_sensor.read_noise_e", "0.0")];
    let electrons = 4.01e12 / 368.0 * 10f64.powf(-1.6) * 0.5625f64.powi(2) / 1054.0;
    let expected = unit_mas / electrons.sqrt();
    // 6,000 draws: 1 % of the standard deviation; full subapertures hold up to 0.1 % less than all
    // light.
    assert!((noise_mas(&quiet) / expected - 1.0).abs() < 0.05);
    // The cell's response to a small tilt: Σ 2(n−D)D/(n² sin(πD/2n))·(2π·pitch/λ/n) per nm/m.
    let n = 12.0;
    let gain: f64 = (1..12)
        .step_by(2)
        .map(f64::from)
        .map(|d| 2.0 * (n - d) * d / (n * n * (std::f64::consts::PI * d / (2.0 * n)).sin()))
        .sum();
    let per_nm_m = gain * std::f64::consts::TAU * 0.5625 / n / 640.0;
    assert!((unit_mas * per_nm_m / MAS_PER_NM_M - 1.0).abs() < 1e-3);
}

#[test]
fn maps_of_another_size_are_refused() {
    let mut bench = bench(&[]);
    assert!(bench.sensor.measure(&[0.0; 7], None, &mut [0.0; 496]).is_err());
    let map = bench.footprint.zeros();
    assert!(bench.sensor.measure(&map, None, &mut [0.0; 3]).is_err());
}

#[test]
fn shifted_lenslets_measure_the_shifted_wavefront() {
    for detector in DETECTORS {
        let mut calibrated = bench(&[("wavefront_sensor.detector", detector)]);
        let shifted = bench(&[
            ("wavefront_sensor.detector", detector),
            ("wavefront_sensor.shift_subapertures", "[0.1, -0.3]"),
            ("wavefront_sensor.slope_gain", "0.9"),
        ]);
        let part = shifted.scene.wavefront_sensor.as_ref().unwrap();
        let mut now = shifted.sensor.with_changes(part, &shifted.pupil, &shifted.footprint).unwrap();
        // W = a·(x² + y²): its slope grows by 2a per metre, so a shift of s adds 2a·s to every
        // slope.
        let (grid, a) = (calibrated.pupil.grid, 20.0);
        let mut map = calibrated.footprint.zeros();
        for (i, out) in map.iter_mut().enumerate() {
            let (y, x) = (i / calibrated.footprint.stride(), i % calibrated.footprint.stride());
            if x < grid.samples() {
                *out = (a * (grid.coordinate_m(x).powi(2) + grid.coordinate_m(y).powi(2))) as f32;
            }
        }
        let slopes = calibrated.sensor.slopes();
        let (mut before, mut after) = (vec![0.0; slopes], vec![0.0; slopes]);
        calibrated.sensor.measure(&map, None, &mut before).unwrap();
        now.measure(&map, None, &mut after).unwrap();
        let gained = [0.1, -0.3].map(|shift| 2.0 * a * shift * 0.5625 * MAS_PER_NM_M);
        let both: Vec<usize> = full(&calibrated).into_iter().filter(|&i| now.lenslets().light[i] > 0.999).collect();
        // Subapertures without a gap between segments, before and after the shift.
        assert!(both.len() > 50, "{} of {}", both.len(), full(&calibrated).len());
        for i in both {
            for (axis, gained) in gained.into_iter().enumerate() {
                let at = axis * 248 + i;
                let (before, after) = (f64::from(before[at]), f64::from(after[at]) / 0.9);
                // Slopes of up to 60 mas, a quarter of λ/d: the cell's third-order term takes up to
                // a tenth of a difference of up to 3 mas.
                assert!((after - before - gained).abs() < 0.3, "{detector} {at}: {before} {after} {gained}");
            }
        }
    }
}

#[test]
fn turned_and_magnified_lenslets_measure_along_their_own_axes() {
    for detector in DETECTORS {
        let turned = bench(&[
            ("wavefront_sensor.detector", detector),
            ("wavefront_sensor.rotation_deg", "3.0"),
            ("wavefront_sensor.magnification", "1.02"),
        ]);
        let part = turned.scene.wavefront_sensor.as_ref().unwrap();
        let mut now = turned.sensor.with_changes(part, &turned.pupil, &turned.footprint).unwrap();
        let (grid, stride, tilt_nm_m) = (turned.pupil.grid, turned.footprint.stride(), 30.0);
        let mut map = turned.footprint.zeros();
        for (i, out) in map.iter_mut().enumerate().filter(|(i, _)| i % stride < grid.samples()) {
            *out = (tilt_nm_m * grid.coordinate_m(i % stride)) as f32;
        }
        let mut slopes = vec![0.0; now.slopes()];
        now.measure(&map, None, &mut slopes).unwrap();
        // A lenslet at p sees W(m·R·p), whose gradient along its axes is m·Rᵀ·∇W.
        let (sin, cos) = 3f64.to_radians().sin_cos();
        let expected = [cos, -sin].map(|part| 1.02 * part * tilt_nm_m * MAS_PER_NM_M);
        let whole = (0..248).filter(|&i| now.lenslets().light[i] > 0.999).collect::<Vec<_>>();
        // All subapertures that neither a gap nor the edge crosses.
        assert!(whole.len() > 40, "{}", whole.len());
        for i in whole {
            for (axis, expected) in expected.into_iter().enumerate() {
                // Interpolation of a tilt is exact; amplitudes that are interpolated beside a gap
                // move the spot by a thousandth.
                assert!((f64::from(slopes[axis * 248 + i]) - expected).abs() < 0.02, "{detector} {i} {axis}");
            }
        }
    }
}

//! Science camera of the AO simulation.

use super::system::{NO_ERRORS_NO_NOISE, NO_TURBULENCE, map, simulator, square};
use cophase::ao::{Simulator, View, strehl_on_axis};
use std::f64::consts::TAU;

/// View in focus, without static aberrations.
fn unaberrated(simulator: &Simulator) -> View {
    let view = View::from_scene(&simulator.scene().image);
    View { segments: false, ncpa: false, diversity: false, ..view }
}

#[test]
fn the_psf_contains_the_light_of_its_field() {
    let simulator = simulator(&[]);
    let psf = simulator.camera(unaberrated(&simulator)).unwrap().psf(&simulator.footprint().zeros());
    let sum: f64 = psf.iter().map(|&v| f64::from(v)).sum();
    // 120 λ/D across: the edges of the segments diffract 0.3 to 1 % of the light beyond it, and the
    // sum stays below 1.
    assert!((0.985..1.0).contains(&sum), "{sum}");
    // The peak of the perfect PSF is on the axis, pixel [M/2, M/2].
    let (peak, _) = psf.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
    assert_eq!(peak, (120, 120));
}

#[test]
fn fft_and_matrix_transform_give_the_same_image() {
    let simulator = simulator(&[]);
    let residual = map(simulator.footprint(), |y, x| 90.0 * ((y * 7 + x * 3) as f32 * 0.05).sin());
    let image = |spacing: f64| {
        let view = View {
            samples_per_lambda_over_d: spacing,
            rows: 96,
            columns: 64,
            ..View::from_scene(&simulator.scene().image)
        };
        simulator.camera(view).unwrap().psf(&residual)
    };
    // 240 × (2 + 1e-9) is not a whole number of samples, so the camera uses a matrix in place of
    // the FFT.
    let (fft, matrix) = (image(2.0), image(2.0 + 1e-9));
    let peak = fft.iter().copied().fold(0.0, f32::max);
    // Single precision: two sums of 240 terms.
    assert!(fft.iter().zip(&matrix).all(|(a, b)| (a - b).abs() < 2e-5 * peak));
}

#[test]
fn a_rectangular_frame_is_the_middle_of_a_square_one() {
    let simulator = simulator(&[]);
    let residual = map(simulator.footprint(), |y, x| 90.0 * ((y * 7 + x * 3) as f32 * 0.05).sin());
    for spacing in [2.0, 2.03] {
        let view = View { samples_per_lambda_over_d: spacing, ..View::from_scene(&simulator.scene().image) };
        let image = |rows, columns| simulator.camera(View { rows, columns, ..view }).unwrap().psf(&residual);
        let (square, frame) = (image(96, 96), image(96, 40));
        // A pixel is the same sum in both.
        assert_eq!(frame, square.slice(ndarray::s![.., 28..68]));
        assert_eq!(image(40, 96), square.slice(ndarray::s![28..68, ..]));
    }
}

#[test]
fn wavefront_growing_along_x_moves_the_spot_along_columns() {
    let simulator = simulator(&[]);
    let grid = simulator.pupil().grid;
    // 5 λ/D along x and −3 along y, at 2 pixels per λ/D.
    let nm_m = 2168.6 / grid.width_m();
    let residual =
        map(simulator.footprint(), |y, x| ((5.0 * grid.coordinate_m(x) - 3.0 * grid.coordinate_m(y)) * nm_m) as f32);
    let psf = simulator.camera(unaberrated(&simulator)).unwrap().psf(&residual);
    let (peak, _) = psf.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap();
    assert_eq!(peak, (120 - 6, 120 + 10));
}

#[test]
fn loop_and_artificial_source_images_agree_without_turbulence() {
    // Without turbulence and with a flat mirror the image equals that of `source`, which has code
    // and a grid of its own.
    let settings = [NO_TURBULENCE.as_slice(), &NO_ERRORS_NO_NOISE, &[("aberrations.truth_samples", "960")]].concat();
    let simulator = simulator(&settings);
    let scene = simulator.scene();
    let psf = simulator.camera(View::from_scene(&scene.image)).unwrap().psf(simulator.segments_nm());
    let camera = cophase::source::Camera::new(scene, simulator.telescope()).unwrap();
    let expected = camera.psf(simulator.truth()).unwrap();
    let peak = expected.iter().copied().fold(0.0, f64::max);
    let worst = psf.iter().zip(&expected).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max);
    // Both low-pass the edges, on 240 and on 960 samples; they differ by 0.06 % of the peak.
    assert!(worst < 1.5e-3 * peak, "{}", worst / peak);
}

#[test]
fn strehl_on_the_axis_agrees_with_the_image_and_with_marechal() {
    let simulator = simulator(&[]);
    let footprint = simulator.footprint();
    let residual = map(footprint, |y, x| 100.0 * ((y as f32 * 0.21).sin() + (x as f32 * 0.17).cos()));
    let mut camera = simulator.camera(unaberrated(&simulator)).unwrap();
    let (aberrated, perfect) = (camera.psf(&residual), camera.psf(&footprint.zeros()));
    let image = f64::from(aberrated[[120, 120]] / perfect[[120, 120]]);
    let axis = strehl_on_axis(footprint, &residual, 2168.6);
    // The camera's field is a sum over 57,600 samples in single precision.
    assert!((image / axis - 1.0).abs() < 1e-4, "{image} {axis}");
    let rms = simulator.pupil().rms(square(footprint, &residual).view()).unwrap();
    let marechal = (-(TAU * rms / 2168.6).powi(2)).exp();
    // σ = 0.29 rad: the next cumulant is of order σ⁴/12 = 6e-4, times the excess kurtosis.
    assert!((axis / marechal - 1.0).abs() < 3e-3, "{axis} {marechal}");
}

#[test]
fn an_image_wider_than_the_sampling_allows_is_refused() {
    let simulator = simulator(&[]);
    let view = View { rows: 600, ..View::from_scene(&simulator.scene().image) };
    assert!(simulator.camera(view).is_err());
}

#[test]
#[ignore = "merge: 9 s"]
fn broad_filter_image_is_the_mean_over_its_wavelengths() {
    let simulator = simulator(&[]);
    let view = View { rows: 128, columns: 128, ..View::from_scene(&simulator.scene().image) };
    let segments_nm = simulator.segments_nm().to_vec();
    let broad = simulator.camera(View { bandwidth_fraction: 0.2, ..view }).unwrap().psf(&segments_nm);
    let mut mean = ndarray::Array2::<f32>::zeros((128, 128));
    for i in 0..120 {
        let stretch = 1.0 + 0.2 * ((f64::from(i) + 0.5) / 120.0 - 0.5);
        let monochromatic = View {
            wavelength_nm: view.wavelength_nm * stretch,
            samples_per_lambda_over_d: view.samples_per_lambda_over_d * stretch,
            ..view
        };
        mean += &(simulator.camera(monochromatic).unwrap().psf(&segments_nm) / 120.0);
    }
    let peak = mean.iter().copied().fold(0.0, f32::max);
    let worst = broad.iter().zip(&mean).map(|(a, b)| (a - b).abs() / peak).fold(0.0, f32::max);
    println!("broad against the mean of many: {worst:e} of the peak");
    // Rounding in single precision is 1.2e-5; the error of the midpoint rule is 3e-5 at 60
    // wavelengths, a quarter of it at 120.
    assert!(worst < 4e-5);
    let narrow = simulator.camera(view).unwrap().psf(&segments_nm);
    assert!(broad.iter().zip(&narrow).any(|(a, b)| (a - b).abs() > 0.05 * peak), "the filter must matter");
}

#[test]
#[ignore = "merge: 9 s"]
fn a_filter_curve_is_the_mean_over_its_photons() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("k.txt");
    // Of transmission (λ/λ₀ − 0.9)/0.2 from 0.9 to 1.1 λ₀.
    let lambda_nm = simulator(&[]).scene().image.wavelength_nm;
    std::fs::write(&path, format!("{} 0\n{} 1\n", 0.9 * lambda_nm, 1.1 * lambda_nm)).unwrap();
    let simulator = simulator(&[("image.filter_file", path.to_str().unwrap())]);
    let view = View { rows: 128, columns: 128, ..View::from_scene(&simulator.scene().image) };
    let segments_nm = simulator.segments_nm().to_vec();
    let broad = simulator.camera(view).unwrap().psf(&segments_nm);
    let mut mean = ndarray::Array2::<f32>::zeros((128, 128));
    for i in 0..120 {
        let place = (f64::from(i) + 0.5) / 120.0;
        let stretch = 0.9 + 0.2 * place;
        let monochromatic = View {
            wavelength_nm: view.wavelength_nm * stretch,
            samples_per_lambda_over_d: view.samples_per_lambda_over_d * stretch,
            spectrum: false,
            ..view
        };
        mean += &(simulator.camera(monochromatic).unwrap().psf(&segments_nm) * (2.0 * place / 120.0) as f32);
    }
    let peak = mean.iter().copied().fold(0.0, f32::max);
    let worst = broad.iter().zip(&mean).map(|(a, b)| (a - b).abs() / peak).fold(0.0, f32::max);
    println!("curve against the mean of many: {worst:e} of the peak");
    // As of a flat filter above; the faint end of the curve that is left out is within the first
    // step.
    assert!(worst < 4e-5);
}

#[test]
fn the_real_maps_of_keck_are_read() {
    let places = ["../shared/data", "../../shared/data"].map(std::path::Path::new);
    let Some(data) = places.into_iter().find(|place| place.is_dir()) else {
        println!("skipped: Keck's maps are not found (../shared/data)");
        return;
    };
    let data = data.canonicalize().unwrap();
    let file = |name: &str| format!("{:?}", data.join(name).display().to_string());
    let (subapertures, actuators) = (file("keckValidSubapMap.txt"), file("keckValidActuatorMap.txt"));
    let simulator = simulator(&[
        ("wavefront_sensor.subaperture_file", &subapertures),
        ("mirror.actuator_file", &actuators),
        ("control.filtered_modes", "20"),
    ]);
    // The map marks 304 subapertures; those outside the preset's pupil have no slope.
    let used = simulator.lenslets().subapertures.len();
    assert!((260..=304).contains(&used), "{used}");
    assert_eq!(simulator.influence().len(), 349);
}

//! The mirror as it was measured: influence functions from a file.

use crate::full_phase::{exposures_apart, sky};
use cophase::ao::{Simulator, Stepper, actuators_in_use};
use cophase::io::{FitsWriter, Pixel};
use cophase::modes::InfluenceFunctions;
use cophase::pipeline::Estimator;
use cophase::scene::Scene;
use cophase::telescope::Telescope;
use ndarray::{Array2, Array3};
use std::path::{Path, PathBuf};

/// Actuators along a side, their distance and the coupling of the scene's Gaussian.
const ACROSS: usize = 11;
const PITCH_M: f64 = 0.5625;
const COUPLING: f64 = 0.1458;
/// Width of the grid, and distance of the simulator's samples.
const WIDTH_M: f64 = 5.625;
const SAMPLE_M: f64 = WIDTH_M / 80.0;

fn scene(settings: &[(&str, &str)]) -> Scene {
    let own = [("estimate.method", "full-phase"), ("estimate.device", "cpu")];
    Scene::from_file(sky()).unwrap().with(&[&own, settings].concat()).unwrap()
}

/// The scene with the influence functions of a file, and other settings.
fn with_file(path: &Path, settings: &[(&str, &str)]) -> Scene {
    let file = format!("{:?}", path.display().to_string());
    scene(&[&[("mirror.influence_file", file.as_str())], settings].concat())
}

fn gaussian(r_m: f64) -> f64 {
    COUPLING.powf((r_m / PITCH_M).powi(2))
}

/// A peak with a ring of −0.07: the difference of two Gaussians.
fn ringed(r_m: f64) -> f64 {
    let square = (r_m / PITCH_M).powi(2);
    1.4 * (-square / 0.45).exp() - 0.4 * (-square / 1.3).exp()
}

/// Function of all actuators in use, `[actuator, y, x]` on `samples` across the pupil's grid, for
/// the distance from the actuator.
fn cube(samples: usize, function: fn(f64) -> f64) -> Array3<f64> {
    let places_m = Simulator::new(&scene(&[])).unwrap().influence().positions_m();
    let at_m = |i: usize| (i as f64 - (samples as f64 - 1.0) / 2.0) * WIDTH_M / samples as f64;
    Array3::from_shape_fn((places_m.len(), samples, samples), |(actuator, y, x)| {
        function((at_m(x) - places_m[actuator].0).hypot(at_m(y) - places_m[actuator].1))
    })
}

/// One function about sample [half, half].
fn single(half: usize, pitch_m: f64, function: fn(f64) -> f64) -> Array2<f64> {
    let from = |i: usize| (i as f64 - half as f64) * pitch_m;
    Array2::from_shape_fn((2 * half + 1, 2 * half + 1), |(y, x)| function(from(x).hypot(from(y))))
}

/// Writes an array as a FITS image with these cards.
macro_rules! write {
    ($path:expr, $array:expr, $unit:expr, $cards:expr) => {{
        let cards: &[(&str, f64)] = $cards;
        let mut file = FitsWriter::create($path).unwrap();
        file.image("INFLUENCE", $array, Pixel::F64, $unit).unwrap();
        cards.iter().for_each(|(key, value)| file.card("INFLUENCE", key, *value, "").unwrap());
        file.finish().unwrap();
    }};
}

/// Largest difference over the largest value.
fn off(found: &Array2<f64>, expected: &Array2<f64>) -> f64 {
    let largest = |matrix: &Array2<f64>| matrix.iter().fold(0.0f64, |most, value| most.max(value.abs()));
    largest(&(found - expected)) / largest(expected)
}

/// Values of all functions at points of the pupil that are no samples of the files.
fn values(influence: &InfluenceFunctions) -> Array2<f64> {
    let (xs_m, ys_m): (Vec<f64>, Vec<f64>) =
        (0..400).map(|i| (2.0 * (1.7 * i as f64).sin(), 2.0 * (2.3 * i as f64).cos())).unzip();
    influence.evaluate(&xs_m, &ys_m).unwrap()
}

/// Strehl ratio by Maréchal of the mean square of the residual wavefront, over 100 frames from
/// frame 100 on.
fn strehl(simulator: &mut Simulator) -> f64 {
    let mut square_nm2 = 0.0;
    for frame in 0..200 {
        let residual_nm = simulator.step().unwrap().residual_rms_nm;
        square_nm2 += if frame < 100 { 0.0 } else { residual_nm * residual_nm / 100.0 };
    }
    (-square_nm2 * (std::f64::consts::TAU / 2168.6).powi(2)).exp()
}

#[test]
fn a_sampled_gaussian_is_the_gaussian_mirror() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    // On the samples of the simulator; in µm for commands of 0.5 µm; on others, a twentieth of the
    // pitch; one for all, with the simulator's samples among its own, and with others.
    write!(&path("same.fits"), &cube(80, gaussian), "", &[]);
    write!(&path("um.fits"), &(cube(80, gaussian) * 0.5), "um", &[("GRID_M", WIDTH_M)]);
    write!(&path("fine.fits"), &cube(200, gaussian), "", &[("PUPLSCAL", WIDTH_M / 200.0)]);
    write!(&path("one.fits"), &single(60, SAMPLE_M / 2.0, gaussian), "", &[("PUPLSCAL", SAMPLE_M / 2.0)]);
    write!(&path("one-fine.fits"), &single(65, PITCH_M / 20.0, gaussian), "", &[("PIXELSCL", PITCH_M / 20.0)]);
    let mut model = Simulator::new(&scene(&[])).unwrap();
    let (functions, interaction) = (values(model.influence()), model.interaction().clone());
    let expected = strehl(&mut model);
    assert!((0.3..0.95).contains(&expected), "{expected}");
    // Bilinear interpolation errs by h²/8 times the second derivative along each axis, which is
    // 2|ln c|/pitch² at most.
    let bound = |h_m: f64| 2.0 * h_m * h_m / 8.0 * 2.0 * COUPLING.ln().abs() / (PITCH_M * PITCH_M);
    for (name, h_m, is_exact) in [
        ("same.fits", SAMPLE_M, true),
        ("um.fits", SAMPLE_M, true),
        ("fine.fits", PITCH_M / 20.0, false),
        ("one.fits", SAMPLE_M / 2.0, true),
        ("one-fine.fits", PITCH_M / 20.0, false),
    ] {
        let mut found = Simulator::new(&with_file(&path(name), &[("control.matrix_command_nm", "500.0")])).unwrap();
        let between = off(&values(found.influence()), &functions);
        assert!(between > 0.0 && between < 1.001 * bound(h_m), "{name}: {between:e} {:e}", bound(h_m));
        // At its own samples a function has single precision. A slope is a difference of some
        // samples' phases over a lenslet, a pitch, and so no larger than that of the functions with
        // errors of the same sign; a factor of two for those of opposite signs.
        let matrix = off(found.interaction(), &interaction);
        assert!(matrix < if is_exact { 1e-5 } else { 2.0 * bound(h_m) }, "{name}: {matrix:e}");
        // The loop sees its own mirror: the error of the functions is a loop gain lower by it, and
        // as much of the fitted wavefront is left to the next frame. ln S changes by less than
        // twice that, and without it by rounding over 200 frames of a stable loop.
        let apart = (strehl(&mut found).ln() / expected.ln() - 1.0).abs();
        assert!(apart < if is_exact { 1e-4 } else { 2.0 * bound(h_m) }, "{name}: {apart:e}");
    }
}

/// What an estimate behind the ringed functions leaves of phasing and NCPA, and its error bars, nm;
/// whether it warns that NCPA extend beyond its modes.
fn left_behind_ringed_mirror(folder: &Path, seed: u64, zernikes: &str) -> ([(f64, f64); 2], bool) {
    let path = folder.join("ringed.fits");
    write!(&path, &cube(120, ringed), "", &[]);
    let seed = seed.to_string();
    // The images need pupil frequencies to 42 cycles over the grid: 20 of the pixels, 14 of the
    // defocus, 8 of aberrations. The low pass of the pupil ends 12 below the Nyquist frequency: at
    // 28 with the scene's 8 samples across a lenslet, which biases NCPA by 1 nm, and at 48 with 12.
    let settings = [
        ("turbulence.seed", &seed[..]),
        ("aberrations.seed", &seed),
        ("aberrations.ncpa_zernikes", zernikes),
        ("wavefront_sensor.samples_per_lenslet", "12"),
    ];
    let measured = with_file(&path, &settings);
    let mut stepper = Stepper::new(&measured).unwrap();
    // 0.3 s apart, in which the wind of the high layer carries turbulence over the pupil.
    let images = exposures_apart(&mut stepper, 316, 8);
    let truth = stepper.simulator().truth();
    let found = Estimator::new(&measured).unwrap().estimate(&images).unwrap();
    let maps_nm = [
        (&found.maps.phasing_nm, &truth.phasing_nm, found.figures.phasing.sigma_nm),
        (&found.maps.ncpa_nm, &truth.ncpa_nm, found.figures.ncpa.sigma_nm),
    ];
    let left = maps_nm.map(|(found_nm, truth_nm, sigma_nm)| {
        (cophase::metrics::residual_nm(&found.pupil, found_nm.view(), truth_nm.view()).unwrap(), sigma_nm)
    });
    println!("draw {seed}: nm left and error bars {left:.2?}");
    (left, found.warnings.iter().any(|warning| warning.contains("extend beyond")))
}

#[test]
#[ignore = "merge: 47 s"]
fn measured_mirror_estimates_are_within_their_error_bars() {
    const DRAWS: u64 = 6;
    let folder = tempfile::tempdir().unwrap();
    let mut squares = [0.0; 2];
    for seed in 1..=DRAWS {
        let (left, is_beyond) = left_behind_ringed_mirror(folder.path(), seed, "[4, 11]");
        assert!(!is_beyond, "draw {seed}: Noll 4 to 11 are within the modes");
        for (square, (left_nm, sigma_nm)) in squares.iter_mut().zip(left) {
            *square += (left_nm / sigma_nm).powi(2) / DRAWS as f64;
        }
    }
    // Some ten errors in each draw: a mean of 60 squares is known to 18 %, and the scatter of eight
    // images, shrunk towards what all modes have in common, to 20 % in its square. Three standard
    // deviations of both are 80 %, √1.8 = 1.34 times the error bars.
    assert!(squares.iter().all(|square| (0.2..1.8).contains(square)), "{squares:?}");
}

/// Where NCPA extend beyond the polynomials of an estimate, modes of this mirror of few actuators
/// are no better: they leave out a fourth of the lowest polynomials.
#[test]
#[ignore = "merge: 6 s"]
fn coarse_mirror_modes_do_not_replace_missing_polynomials() {
    let folder = tempfile::tempdir().unwrap();
    let ([phasing, ncpa], is_beyond) = left_behind_ringed_mirror(folder.path(), 4, "[4, 78]");
    // What is extrapolated is most of the error bar.
    assert!(is_beyond);
    // Polynomials to order 9 hold Noll 4 to 55, and leave 13 nm; the mirror's modes leave 18: the
    // bound is between. Errors of one draw, the RMS of some ten, scatter by 1/√20 = 22 % of the
    // error bars: 1.3 is 1.3 standard deviations, and the draw is fixed.
    assert!(ncpa.0 < 15.5 && ncpa.0 < 1.3 * ncpa.1 && phasing.0 < 1.3 * phasing.1, "{phasing:?} {ncpa:?}");
}

/// The mirror behind a raised segment, once the loop is at rest: the response of the loop with the
/// file is that of the functions themselves, and with the Gaussian in their place it is another.
#[test]
fn the_response_to_a_segment_is_that_of_the_measured_mirror() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ringed.fits");
    write!(&path, &cube(400, ringed), "", &[]);
    let quiet = [
        ("wavefront_sensor.photon_noise", "false"),
        ("wavefront_sensor.read_noise_e", "0.0"),
        ("turbulence.fractions", "[]"),
        ("turbulence.heights_m", "[]"),
        ("turbulence.wind_m_s", "[]"),
        ("turbulence.wind_dir_rad", "[]"),
        ("aberrations.segment_piston_rms_nm", "40.0"),
    ];
    let surface_nm = |scene: &Scene| {
        let mut simulator = Simulator::new(scene).unwrap();
        let mut commands_nm = Vec::new();
        for _ in 0..300 {
            commands_nm = simulator.step().unwrap().commands_nm.to_vec();
        }
        let surface_nm = simulator.surface_nm(&commands_nm).unwrap().to_vec();
        (simulator, commands_nm, surface_nm)
    };
    let (simulator, commands_nm, found_nm) = surface_nm(&with_file(&path, &quiet));
    let (_, _, other_nm) = surface_nm(&scene(&quiet));
    let (places_m, footprint, grid) =
        (simulator.influence().positions_m(), simulator.footprint(), simulator.pupil().grid);
    let (mut own, mut other, mut all) = (0.0, 0.0, 0.0);
    for ((y, x), _) in simulator.pupil().amplitude.indexed_iter().filter(|(_, amplitude)| **amplitude > 0.0) {
        let expected_nm: f64 = places_m
            .iter()
            .zip(&commands_nm)
            .map(|(place, &nm)| {
                f64::from(nm) * ringed((grid.coordinate_m(x) - place.0).hypot(grid.coordinate_m(y) - place.1))
            })
            .sum();
        let at = y * footprint.stride() + x;
        own += (f64::from(found_nm[at]) - expected_nm).powi(2);
        other += (f64::from(other_nm[at]) - expected_nm).powi(2);
        all += expected_nm.powi(2);
    }
    println!("{} and {} of the surface", (own / all).sqrt(), (other / all).sqrt());
    // A fortieth of a pitch between samples: an eighth of its square times second derivatives of 6
    // per pitch² along both axes, 1e-3, which neighbours of either sign amplify a few times.
    assert!((own / all).sqrt() < 5e-3 && other > 16.0 * own, "{own} {other} {all}");
}

#[test]
fn modes_of_the_mirror_are_those_of_its_functions() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("functions.fits");
    write!(&path, &cube(80, gaussian), "", &[]);
    let measured = with_file(&path, &[]);
    let telescope = Telescope::new(&measured).unwrap();
    let in_use = actuators_in_use(&measured, &telescope).unwrap();
    // Without lenslets the file's functions are placed by their peaks.
    assert_eq!(telescope.influence(&measured).unwrap(), in_use);
    assert_eq!(in_use.mirror().actuators_across(), ACROSS);
    let turbulence = Telescope::turbulence(&measured).unwrap();
    let pupil = &telescope.pupil;
    let modes =
        |influence: &InfluenceFunctions| cophase::modes::karhunen_loeve(influence, pupil, &turbulence, 12).unwrap();
    let gaussian = actuators_in_use(&scene(&[]), &telescope).unwrap();
    let (found, expected) = (modes(&in_use), modes(&gaussian));
    // Interpolation on the grid of the pupil: an eighth of the square of an eighth of a pitch times
    // the second derivatives, 1.5 % of each function; the variance of a smooth mode, a sum of many,
    // changes by less than twice that.
    for (found, expected) in found.variances_nm2.iter().zip(&expected.variances_nm2) {
        assert!((found / expected - 1.0).abs() < 0.03, "{found} {expected}");
    }
}

#[test]
fn files_that_do_not_fit_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("functions.fits");
    let refused = |path: &PathBuf, settings: &[(&str, &str)], words: &[&str]| {
        let sentence = Simulator::new(&with_file(path, settings)).map(|_| ()).unwrap_err().to_string();
        for word in [&["functions.fits"], words].concat() {
            assert!(sentence.contains(word), "{sentence:?} does not contain {word:?}");
        }
    };
    let good = cube(80, gaussian);
    let all = good.dim().0;
    refused(&path, &[], &["functions.fits"]);
    write!(&path, &good.slice(ndarray::s![1.., .., ..]).to_owned(), "", &[]);
    refused(&path, &[], &[&format!("{} influence functions", all - 1), &format!("{all} actuators in use")]);
    let mut broken = good.clone();
    broken[[3, 40, 41]] = f64::NAN;
    write!(&path, &broken, "", &[]);
    refused(&path, &[], &["actuator 3", "NaN", "row 40, column 41", "finite"]);
    broken.index_axis_mut(ndarray::Axis(0), 3).fill(0.0);
    write!(&path, &broken, "", &[]);
    refused(&path, &[], &["actuator 3", "0 everywhere"]);
    write!(&path, &good, "", &[("PUPLSCAL", 0.05)]);
    refused(&path, &[], &["4 m wide", "a map of the whole pupil"]);
    write!(&path, &good, "", &[("PUPLSCAL", 0.0)]);
    refused(&path, &[], &["PUPLSCAL = 0", "a length in m"]);
    write!(&path, &good, "V", &[]);
    refused(&path, &[], &["BUNIT = 'v'"]);
    write!(&path, &(&good * 500.0), "", &[]);
    refused(&path, &[], &["peaks of", "nm per nm of command", "0.1 to 10", "control.matrix_command_nm"]);
    write!(&path, &(&good * 500.0), "nm", &[]);
    Simulator::new(&with_file(&path, &[("control.matrix_command_nm", "500.0")])).unwrap();
    // Column by column; rotated by 180° is another order, too.
    write!(&path, &good.clone().permuted_axes([0, 2, 1]).as_standard_layout().to_owned(), "", &[]);
    refused(&path, &[], &["has its peak at", "row by row from the smallest y"]);
    write!(&path, &single(20, 0.05, gaussian), "", &[]);
    refused(&path, &[], &["single influence function", "PUPLSCAL"]);
    write!(&path, &Array2::<f64>::zeros((5, 5)), "", &[("PUPLSCAL", 0.1)]);
    refused(&path, &[], &["is 0 everywhere"]);
}

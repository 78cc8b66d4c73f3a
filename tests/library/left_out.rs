//! What the modes leave out, marginalised after the fit.

use crate::consistency::{scene, shown};
use cophase::pipeline::{Estimate, Estimator, Images, ModelError};
use cophase::scene::Scene;
use ndarray::Array2;
use std::path::Path;

/// The estimate of images that `simulated` changes, by a scene without these changes, whose error
/// bars hold what the modes leave out, or do not.
fn estimate(settings: &[(&str, &str)], simulated: &[(&str, &str)], posterior: bool) -> Estimate {
    estimate_changed(settings, simulated, posterior, |_, _| 1.0)
}

/// The same of images whose electrons are multiplied by `gain`, of the place of a pixel from the
/// axis along x and y and of its share of the peak.
fn estimate_changed(
    settings: &[(&str, &str)],
    simulated: &[(&str, &str)],
    posterior: bool,
    gain: fn([i64; 2], f64) -> f64,
) -> Estimate {
    let own = [("estimate.model", "scene"), ("estimate.posterior", if posterior { "true" } else { "false" })];
    let keck = [("image.samples_per_lambda_over_d", "2"), ("image.pixels", "128"), ("image.peak_snr", "150")];
    let scene = Scene::preset("keck-artificial").unwrap().with(&[&keck[..], settings, &own].concat()).unwrap();
    let mut images = Images { scene: None, ..crate::common::simulated(&scene.with(simulated).unwrap()) };
    let peak_e = images.images_e.iter().copied().fold(0.0, f64::max);
    for ((_, y, x), electrons) in images.images_e.indexed_iter_mut() {
        *electrons *= gain([x as i64 - 64, y as i64 - 64], *electrons / peak_e);
    }
    shown(Estimator::new(&scene).unwrap().estimate(&images).unwrap())
}

/// Residual of phasing and NCPA over their error bars.
fn pulls(found: &Estimate) -> [f64; 2] {
    let residual_nm = found.truth.as_ref().unwrap().1.rms_nm;
    [residual_nm[0] / found.figures.phasing.sigma_nm, residual_nm[1] / found.figures.ncpa.sigma_nm]
}

/// Sentences on errors of the camera: warnings beyond their tolerances, remarks within.
fn named(found: &Estimate) -> Vec<&String> {
    found.warnings.iter().chain(&found.remarks).filter(|sentence| sentence.contains("how an error")).collect()
}

#[test]
fn error_bars_hold_tilts_that_are_not_fitted() {
    let tilted = [("aberrations.segment_tip_tilt_rms_nm", "4")];
    let without = pulls(&estimate(&[], &tilted, false));
    assert!(without[0] > 3.0, "{without:?}");
    let found = estimate(&[], &tilted, true);
    // Some twenty directions make most of a residual: 16 %, four of these.
    assert!(pulls(&found).iter().all(|pull| (0.4..1.6).contains(pull)), "{:?}", pulls(&found));
    let remark = found.remarks.iter().find(|remark| remark.starts_with("Not fitted")).unwrap();
    assert!(remark.contains("tips and tilts of the segments"), "{remark}");
    let [noise, left_out] = &found.error_budget[..] else { panic!("{:?}", found.error_budget) };
    assert!(left_out.name == "what is not fitted" && left_out.phasing_nm > 2.0 * noise.phasing_nm, "{left_out:?}");
}

/// A figure of 10 nm that all segments share, and figures of 5 nm of each, of which the images show
/// pistons, tilts and a smooth wavefront.
#[test]
#[ignore = "merge: 16 s"]
fn error_bars_hold_figures_of_the_segments() {
    for (key, nm) in [("aberrations.common_figure_rms_nm", 10.0), ("aberrations.segment_figure_rms_nm", 5.0)] {
        let own = nm.to_string();
        let figure = [(key, own.as_str())];
        let without = pulls(&estimate(&[], &figure, false));
        assert!(without.iter().all(|pull| *pull > 2.0), "{key}: {without:?}");
        let found = estimate(&[], &figure, true);
        assert!(pulls(&found).iter().all(|pull| (0.4..1.6).contains(pull)), "{key}: {:?}", pulls(&found));
        // On a coarser grid, and piston, tip and tilt of the figures removed.
        let flat = [("aberrations.segment_piston_rms_nm", "0"), ("image.peak_snr", "500")];
        let figures = estimate(&[], &[&flat[..], &figure].concat(), true).truth.unwrap().0.phasing_nm;
        let rms_nm = found.pupil.rms(figures.view()).unwrap();
        assert!((rms_nm / nm - 1.0).abs() < 0.05, "{key}: {rms_nm}");
    }
}

/// Pistons, tips and tilts along a smooth surface of 43 nm, with its opposite in the NCPA, are the
/// wavefront of 1 nm of a common figure: which of the two it is no image says.
#[test]
#[ignore = "merge: 9 s"]
fn a_common_figure_may_be_a_surface_of_the_whole_mirror() {
    let found = estimate(&[], &[("aberrations.common_figure_rms_nm", "1")], true);
    let doubt = found.warnings.iter().find(|sentence| sentence.contains("all segments share a figure")).unwrap();
    let surface_nm: f64 = doubt.split("smooth surface of ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    // 2 % of noise in the figure.
    assert!((surface_nm / 43.0 - 1.0).abs() < 0.2, "{doubt}");
    assert!(
        found.without_staircases.is_some() && found.remarks.iter().any(|remark| remark.contains("Without these three"))
    );
    let without = estimate(&[], &[], true);
    assert!(without.warnings.is_empty() && without.without_staircases.is_none(), "{:?}", without.warnings);
}

/// A tenth of a per cent of the plate scale, 1.5 % of the gain of a quadrant and 4 % of the
/// response at the peak: 2 to 3 error bars of the noise each.
#[test]
#[ignore = "merge: 19 s"]
fn errors_of_the_camera_are_held_and_named() {
    type Gain = fn([i64; 2], f64) -> f64;
    let cases: [(&str, Gain, &str); 3] = [
        ("2.002", |_, _| 1.0, "the scale of the image along"),
        ("2", |[x, y], _| if x >= 0 && y >= 0 { 1.015 } else { 1.0 }, "the gain of the"),
        ("2", |_, share| 1.0 - 0.04 * share.max(0.0), "the loss of response at the peak is off by"),
    ];
    for (samples, gain, name) in cases {
        let simulated = [("image.samples_per_lambda_over_d", samples)];
        let found = estimate_changed(&[], &simulated, true, gain);
        let pulls = pulls(&found);
        assert!(pulls.iter().all(|pull| *pull < 1.6), "{name}: {pulls:?}");
        let named = named(&found);
        assert!(!named.is_empty() && named.iter().all(|sentence| sentence.contains(name)), "{named:?}");
    }
}

/// Light that is not even over a pupil whose segments are not fitted, which no amplitude of theirs
/// explains.
#[test]
#[ignore = "merge: 6 s"]
fn light_over_a_pupil_without_segments_is_held_and_named() {
    let whole = [("modes.segment", "none"), ("aberrations.segment_piston_rms_nm", "0")];
    let uneven = [("pupil.illumination_x", "0.05"), ("pupil.illumination_edge", "-0.03")];
    let without = pulls(&estimate(&whole, &uneven, false));
    let found = estimate(&whole, &uneven, true);
    let pull = pulls(&found)[1];
    assert!(without[1] > 2.0 && pull < 1.6, "{without:?} {pull}");
    let of = |name: &str| {
        let error = found.model_errors.iter().find(|error| error.name.contains(name)).unwrap().clone();
        (error.value, error.sigma)
    };
    for (name, truth) in [("illumination along x", 0.05), ("illumination along y", 0.0), ("to the rim", -0.03)] {
        let (value, sigma) = of(name);
        // The change is linear: what 0.05 does of second order is 0.05 of it.
        assert!((value - truth).abs() < 3.0 * sigma + 0.0025, "{name}: {value} ± {sigma}");
    }
    let is_it = |error: &ModelError| error.name.contains("illumination along x") && error.significance > 20.0;
    assert!(found.model_errors.iter().any(is_it));
}

#[test]
#[ignore = "merge: 11 s"]
fn tolerances_widen_error_bars_and_exact_ones_do_not() {
    let exact = [
        ("tolerance.pixel_scale_fraction", "0"),
        ("tolerance.gain_fraction", "0"),
        ("tolerance.common_figure_nm", "0"),
        ("tolerance.illumination_fraction", "0"),
    ];
    let wide = [("tolerance.gain_fraction", "0.3")];
    let [exact, usual, wide] =
        [&exact[..], &[], &wide].map(|settings| estimate(settings, &[], true).figures.ncpa.sigma_nm);
    assert!(exact < usual && usual < wide, "{exact} {usual} {wide}");
    let scene = Scene::preset("keck-artificial").unwrap();
    let useless = [("tolerance.gain_fraction", "0.02"), ("estimate.posterior", "false")];
    let error = scene.with(&useless).unwrap_err().to_string();
    assert!(error.contains("tolerance.gain_fraction = 0.02 has no effect where estimate.posterior = false"), "{error}");
}

#[test]
fn error_bars_without_anything_left_out_stay_near_noise() {
    let [without, with] = [false, true].map(|posterior| estimate(&[], &[], posterior));
    for (one, other) in [
        (without.figures.phasing.sigma_nm, with.figures.phasing.sigma_nm),
        (without.figures.ncpa.sigma_nm, with.figures.ncpa.sigma_nm),
    ] {
        // Four draws of this scene gave 1.23 and 1.31: the images cannot exclude what is not there.
        assert!((1.0..1.4).contains(&(other / one)), "{one} {other}");
    }
    assert!(with.is_sound() && pulls(&with).iter().all(|pull| *pull < 1.5), "{:?} {:?}", pulls(&with), with.warnings);
}

/// What was left out explains a part of what χ² of a wrong minimum is above 1.
#[test]
#[ignore = "merge: 18 s"]
fn a_wrong_minimum_is_no_less_a_misfit() {
    let is_wrong = |seed: &&str| {
        let large = [
            ("aberrations.segment_piston_rms_nm", "700"),
            ("aberrations.ncpa_rms_nm", "300"),
            ("aberrations.seed", seed),
        ];
        let found = estimate(&[("image.peak_snr", "30"), ("estimate.restarts", "0")], &large, true);
        // Ten times what the noise leaves: the error bars hold what the modes leave out of it.
        let is_wrong = found.truth.as_ref().unwrap().1.rms_nm[1] > 90.0;
        let is_flagged = found.status.word() != "ok" && !found.warnings.is_empty();
        assert!(!is_wrong || is_flagged, "{seed}: {} {:?}", found.status.word(), found.warnings);
        is_wrong
    };
    // Which of them end in a wrong minimum hangs on the last digits.
    assert!(["1", "3", "5", "8"].into_iter().filter(is_wrong).count() > 1);
}

/// A slope by the fitted modes is one along shapes that change no image, too: where it was taken
/// to be 0 these were 750 nm of a staircase and of a smooth shape.
#[test]
fn the_step_takes_the_slope_that_a_coarse_fit_leaves() {
    let found = estimate(&[("estimate.step_tolerance_nm", "1"), ("aberrations.seed", "3")], &[], true);
    assert!(
        found.is_sound() && pulls(&found).iter().all(|pull| *pull < 1.5),
        "{:?} {:?}",
        pulls(&found),
        found.warnings
    );
}

#[test]
#[ignore = "merge: 6 s"]
fn tilts_that_are_fitted_have_the_prior_too() {
    let fitted = [("modes.segment", "piston-tip-tilt")];
    let tilted = [("aberrations.segment_tip_tilt_rms_nm", "4")];
    let [free, found] = [false, true].map(|posterior| estimate(&fitted, &tilted, posterior));
    let [free_nm, nm] = [&free, &found].map(|found| found.truth.as_ref().unwrap().1.rms_nm[0]);
    assert!(nm < free_nm && pulls(&found).iter().all(|pull| *pull < 1.6), "{nm} {free_nm} {:?}", pulls(&found));
}

/// The estimate of a pair of images that `simulated` changes, by a scene without these changes.
fn pair(settings: &[(&str, &str)], simulated: &[(&str, &str)], posterior: bool) -> Estimate {
    let own = [
        ("image.pixels", "128"),
        ("image.samples_per_lambda_over_d", "2"),
        ("image.peak_snr", "150"),
        ("estimate.model", "scene"),
        ("estimate.posterior", if posterior { "true" } else { "false" }),
    ];
    let scene = Scene::preset("keck-pair").unwrap().with(&[&own[..], settings].concat()).unwrap();
    let mut images = Images::simulated(&scene.with(simulated).unwrap()).unwrap();
    images.iter_mut().for_each(|images| images.scene = None);
    shown(Estimator::new(&scene).unwrap().estimate(&images).unwrap())
}

#[test]
#[ignore = "merge: 24 s"]
fn channels_hold_tilts_that_are_not_fitted() {
    let tilted = [("aberrations.segment_tip_tilt_rms_nm", "4")];
    let without = pulls(&pair(&[], &tilted, false));
    assert!(without[0] > 3.0, "{without:?}");
    let found = pair(&[], &tilted, true);
    assert!(pulls(&found).iter().all(|pull| (0.4..1.6).contains(pull)), "{:?}", pulls(&found));
    let [noise, left_out] = &found.error_budget[..] else { panic!("{:?}", found.error_budget) };
    assert!(left_out.name == "what is not fitted" && left_out.phasing_nm > 2.0 * noise.phasing_nm, "{left_out:?}");
}

/// Both channels have one camera, whose scale is a tenth of a per cent off; in a bright image it
/// more than doubles χ², which the step explains.
#[test]
#[ignore = "merge: 29 s"]
fn channels_name_an_error_of_their_camera() {
    for peak_snr in ["150", "500"] {
        let bright = [("image.peak_snr", peak_snr)];
        let found = pair(&bright, &[("image.samples_per_lambda_over_d", "2.002")], true);
        assert!(pulls(&found).iter().all(|pull| *pull < 1.6), "{:?}", pulls(&found));
        let named = named(&found);
        let is_scale = |sentence: &&String| sentence.contains("the scale of the image along");
        assert!(!named.is_empty() && named.iter().all(is_scale), "{named:?}");
        assert!(found.warnings.iter().all(|warning| named.contains(&warning)), "{:?}", found.warnings);
        let shown = found.model_errors.iter().filter(|error| error.name.contains("the scale of the image along"));
        // Pixels of 1/2.002 in place of 1/2.
        let is_right = |error: &ModelError| (error.value + 1e-3).abs() < 5.0 * error.sigma + 3e-5;
        assert!(shown.clone().count() == 2 && shown.clone().all(is_right), "{:?}", found.model_errors);
        assert!(
            found.status.word() == "ok" && found.reduced_chi2 < 1.1,
            "{} {}",
            found.status.word(),
            found.reduced_chi2
        );
    }
    let nominal = pair(&[], &[], true);
    assert!(nominal.warnings.is_empty() && pulls(&nominal).iter().all(|pull| *pull < 1.6), "{nominal:?}");
}

/// Channels of several images, each of which is fitted alone: tilts that are not fitted, and a
/// plate scale that is a tenth of a per cent off, by which the channels contradict each other.
#[test]
#[ignore = "merge: 30 s"]
fn channels_of_several_images_hold_and_name_errors() {
    let several = [("image.count", "3")];
    let found = pair(&several, &[("aberrations.segment_tip_tilt_rms_nm", "4")], true);
    assert!(pulls(&found).iter().all(|pull| (0.4..1.6).contains(pull)), "{:?}", pulls(&found));
    let [noise, left_out] = &found.error_budget[..] else { panic!("{:?}", found.error_budget) };
    assert!(left_out.name == "what is not fitted" && left_out.phasing_nm > 2.0 * noise.phasing_nm, "{left_out:?}");
    assert_eq!(
        found.remarks.iter().filter(|remark| remark.starts_with("Not fitted")).count(),
        1,
        "{:?}",
        found.remarks
    );
    let simulated = [("image.samples_per_lambda_over_d", "2.002")];
    let without = pair(&several, &simulated, false);
    assert!(without.warnings.iter().any(|warning| warning.contains("contradict")), "{:?}", without.warnings);
    let found = pair(&several, &simulated, true);
    let named = named(&found);
    assert!(
        named.len() == 2 && named.iter().all(|sentence| sentence.contains("the scale of the image along")),
        "{named:?}"
    );
    assert!(found.warnings.iter().all(|warning| named.contains(&warning)), "{:?}", found.warnings);
    assert!(pulls(&found).iter().all(|pull| *pull < 1.6), "{:?}", pulls(&found));
    assert!(found.figures.phasing.sigma_nm < 0.5 * without.figures.phasing.sigma_nm, "{:?}", found.figures);
}

/// A scene that lists one channel has the estimate of the same scene without a list.
#[test]
fn a_channel_alone_is_an_image_without_channels() {
    let settings = [("estimate.posterior", "true"), ("estimate.model", "scene")];
    let alone = scene(&settings);
    let text = alone.text().replacen("[modes]", "[[image.channel]]\n[modes]", 1);
    let channel = Scene::from_text(&text, Path::new("")).unwrap();
    let [one, other] = [alone, channel].map(|scene| {
        let images = Images::simulated(&scene).unwrap();
        Estimator::new(&scene).unwrap().estimate(&images).unwrap()
    });
    // Both are the same equations. The combination inverts a covariance twice, and error bars are
    // scaled by χ² from 1.05 on.
    for (one, other) in [
        (one.figures.phasing, other.figures.phasing),
        (one.figures.ncpa, other.figures.ncpa),
        (one.figures.wavefront, other.figures.wavefront),
    ] {
        assert!((one.sigma_nm / other.sigma_nm - 1.0).abs() < 0.01, "{one:?} {other:?}");
        assert!((one.rms_nm - other.rms_nm).abs() < 0.01 * one.sigma_nm, "{one:?} {other:?}");
    }
    assert_eq!(one.model_errors.len(), other.model_errors.len());
}

/// A figure that all segments share and a staircase of the segments with a smooth shape are one
/// wavefront: by its tolerance the error bars are several times as large as without, and without
/// the three shapes little larger.
#[test]
#[ignore = "merge: 20 s"]
fn what_a_common_figure_leaves_open_is_given_apart() {
    let estimate = |tolerance: &str| {
        let settings = [("estimate.posterior", "true"), ("tolerance.common_figure_nm", tolerance)];
        let scene = Scene::preset("jwst-pair").unwrap().with(&settings).unwrap();
        let images = Images::simulated(&scene).unwrap();
        shown(Estimator::new(&scene).unwrap().estimate(&images).unwrap())
    };
    let [open, known] = ["5", "0"].map(estimate);
    let [wide_nm, narrow_nm] = [&open, &known].map(|found| found.figures.phasing.sigma_nm);
    let apart = open.without_staircases.as_ref().unwrap();
    assert!(wide_nm > 4.0 * narrow_nm, "{wide_nm} {narrow_nm}");
    // The figure itself, known to 0.6 nm by the prior of the tilts, is in no map.
    assert!(apart.figures.phasing.sigma_nm < 1.5 * narrow_nm, "{:?} {narrow_nm}", apart.figures);
    assert!(open.figures.wavefront.sigma_nm < 2.0 * narrow_nm, "{:?}", open.figures);
    let pupil = &open.pupil;
    let segments = Array2::from_shape_fn(pupil.owner.dim(), |at| pupil.owner[at]);
    let mean = |map: &Array2<f64>, of: &dyn Fn(i32) -> bool| {
        let inside = segments.indexed_iter().filter(|(_, owner)| **owner >= 0 && of(**owner));
        let sums = inside
            .fold([0.0; 2], |[sum, all], (at, _)| [sum + pupil.amplitude[at] * map[at], all + pupil.amplitude[at]]);
        sums[0] / sums[1]
    };
    let coordinate = |axis: usize| {
        Array2::from_shape_fn(segments.dim(), |(y, x)| pupil.grid.coordinate_m(if axis == 0 { x } else { y }))
    };
    let [x, y] = [0, 1].map(coordinate);
    // Piston, tip and tilt of each segment, and of the pupil.
    let planes_of = |of: &dyn Fn(i32) -> bool| {
        let mut planes = vec![Array2::ones(segments.dim())];
        for plane in [&x, &y] {
            let rest = planes.iter().fold(plane.clone(), |rest, other: &Array2<f64>| {
                let share = mean(&(&rest * other), of);
                rest - other * share
            });
            let rms = mean(&(&rest * &rest), of).sqrt();
            planes.push(rest / rms);
        }
        planes
    };
    let along = |map: &Array2<f64>, planes: &[Array2<f64>], of: &dyn Fn(i32) -> bool| {
        planes.iter().fold(Array2::zeros(map.dim()), |sum, plane| sum + plane * mean(&(map * plane), of))
    };
    let of_all = |owner: i32| owner >= 0;
    let mut known = planes_of(&of_all);
    for shape in [&x * &x + &y * &y, &x * &x - &y * &y, &x * &y] {
        let mut staircase = Array2::zeros(shape.dim());
        for segment in 0..pupil.segments.len() as i32 {
            let own = |owner: i32| owner == segment;
            let plane = along(&shape, &planes_of(&own), &own);
            let cells = segments.indexed_iter().filter(|(_, owner)| **owner == segment);
            cells.for_each(|(at, _)| staircase[at] = plane[at]);
        }
        let rest = &staircase - &along(&staircase, &known, &of_all);
        let rms = mean(&(&rest * &rest), &of_all).sqrt();
        known.push(rest / rms);
    }
    let filled = |map: &Array2<f64>| map.mapv(|nm| if nm.is_nan() { 0.0 } else { nm });
    let truth_nm = filled(&open.truth.as_ref().unwrap().0.phasing_nm);
    let off_nm = &filled(&apart.maps.phasing_nm) - &truth_nm;
    let off_nm = &off_nm - &along(&off_nm, &known, &of_all);
    let rms_nm = mean(&(&off_nm * &off_nm), &of_all).sqrt();
    assert!((0.4..1.6).contains(&(rms_nm / apart.figures.phasing.sigma_nm)), "{rms_nm} {:?}", apart.figures);
    // They are in the map no more.
    let of_map = along(&filled(&apart.maps.phasing_nm), &known[3..], &of_all);
    assert!(mean(&(&of_map * &of_map), &of_all).sqrt() < 0.02 * apart.figures.phasing.rms_nm);
}

/// 5 nm of a common figure are the wavefront of 216 nm of a staircase and a smooth shape. With
/// figures that were maps, of one segment at each sample, the step took one for the other.
#[test]
#[ignore = "merge: 6 s"]
fn a_bright_image_tells_a_common_figure_from_a_staircase() {
    let found = estimate(&[("image.peak_snr", "500")], &[("aberrations.common_figure_rms_nm", "5")], true);
    assert!(pulls(&found).iter().all(|pull| *pull < 1.6) && found.figures.ncpa.sigma_nm < 2.0, "{:?}", found.figures);
}

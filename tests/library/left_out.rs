//! What the modes leave out, marginalised after the fit.

use crate::consistency::{scene, shown};
use cophase::pipeline::{Estimate, Estimator, Images};
use cophase::scene::Scene;
use std::path::Path;

/// The estimate of images that `simulated` changes, by a scene without these changes, whose error
/// bars hold what the modes leave out, or do not.
fn estimate(settings: &[(&str, &str)], simulated: &[(&str, &str)], posterior: bool) -> Estimate {
    let own = [("estimate.model", "scene"), ("estimate.posterior", if posterior { "true" } else { "false" })];
    let keck = [("image.samples_per_lambda_over_d", "2"), ("image.pixels", "128"), ("image.peak_snr", "150")];
    let scene = Scene::preset("keck-artificial").unwrap().with(&[&keck[..], settings, &own].concat()).unwrap();
    let images = Images { scene: None, ..Images::simulated(&scene.with(simulated).unwrap()).unwrap() };
    shown(Estimator::new(&scene).unwrap().estimate(&images).unwrap())
}

/// Residual of phasing and NCPA over their error bars.
fn pulls(found: &Estimate) -> [f64; 2] {
    let residual_nm = found.truth.as_ref().unwrap().1.rms_nm;
    [residual_nm[0] / found.figures.phasing.sigma_nm, residual_nm[1] / found.figures.ncpa.sigma_nm]
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

#[test]
fn error_bars_without_anything_left_out_stay_near_noise() {
    let [without, with] = [false, true].map(|posterior| estimate(&[], &[], posterior));
    for (one, other) in [
        (without.figures.phasing.sigma_nm, with.figures.phasing.sigma_nm),
        (without.figures.ncpa.sigma_nm, with.figures.ncpa.sigma_nm),
    ] {
        // Four draws of this scene gave 1.23 and 1.28: the images cannot exclude what is not there.
        assert!((1.0..1.4).contains(&(other / one)), "{one} {other}");
    }
    assert!(pulls(&with).iter().all(|pull| *pull < 1.5), "{:?}", pulls(&with));
}

#[test]
fn tilts_that_are_fitted_have_the_prior_too() {
    let fitted = [("modes.segment", "piston-tip-tilt")];
    let tilted = [("aberrations.segment_tip_tilt_rms_nm", "4")];
    let [free, found] = [false, true].map(|posterior| estimate(&fitted, &tilted, posterior));
    let [free_nm, nm] = [&free, &found].map(|found| found.truth.as_ref().unwrap().1.rms_nm[0]);
    assert!(nm < free_nm && pulls(&found).iter().all(|pull| *pull < 1.6), "{nm} {free_nm} {:?}", pulls(&found));
}

#[test]
fn several_channels_are_refused() {
    let text = scene(&[("estimate.posterior", "true")]).text().replacen(
        "[modes]",
        "[[image.channel]]\n[[image.channel]]\ndiversity_focus_waves_rms = -0.8\n[modes]",
        1,
    );
    let pair = Scene::from_text(&text, Path::new("")).unwrap();
    let images = Images::simulated_channels(&pair).unwrap();
    let error = Estimator::new(&pair).unwrap().estimate(&images).unwrap_err().to_string();
    assert!(error.contains("estimate.posterior = true is for images of one channel"), "{error}");
}

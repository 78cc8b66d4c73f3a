//! Sessions of several channels.

use crate::channels::{COLOURS, PAIR, with_channels};
use crate::common::assert_facts;
use cophase::Error;
use cophase::modal::{FitOptions, JointSession, SessionOptions, Status};
use cophase::optimize::StopReason;
use cophase::pipeline::{Control, Estimate, Estimator, Images, Policy};
use cophase::scene::Scene;
use ndarray::{Array2, s};
use std::sync::atomic::Ordering;
use std::time::Duration;

/// A session of `scene` with the frames of `images`.
fn session(scene: &Scene, images: &[Images]) -> JointSession {
    let mut session = JointSession::new(scene, &SessionOptions::default()).unwrap();
    for (channel, images) in images.iter().enumerate() {
        session.frame_mut(channel).unwrap().0.assign(&images.images_e.slice(s![0, .., ..]));
    }
    session
}

/// The estimate without retries of the images.
fn estimate(scene: &Scene, images: &[Images]) -> Estimate {
    let realtime = Estimator::with_policy(scene, Policy::realtime(), Control::default()).unwrap();
    realtime.estimate_channels(images).unwrap()
}

/// Compares a session with the estimate from the same images: the largest difference of a coefficient over its error bar, and the
/// smallest and largest ratio of error bars.
fn agreement(session: &JointSession, estimate: &Estimate) -> (f64, [f64; 2]) {
    let (fit, sigma_nm) = (session.result().unwrap(), estimate.sigma_nm());
    let off = fit.coefficients_nm.iter().zip(&estimate.coefficients_nm).zip(&sigma_nm);
    let off = off.map(|((a, b), sigma)| (a - b).abs() / sigma).fold(0.0, f64::max);
    let ratios: Vec<f64> = fit.sigma_nm.iter().zip(&sigma_nm).map(|(a, b)| a / b).collect();
    let extreme = |choose: fn(f64, f64) -> f64| ratios.iter().copied().reduce(choose).unwrap();
    (off, [extreme(f64::min), extreme(f64::max)])
}

/// The refined fit is the estimate: the same matrices from fits that are the same to the bit, but for the last digits of χ².
fn refines_to(session: &JointSession, estimate: &Estimate) {
    let refined = session.refine().unwrap();
    let sigma_nm = estimate.sigma_nm();
    for (mode, sigma) in sigma_nm.iter().enumerate() {
        let off = (refined.coefficients_nm[mode] - estimate.coefficients_nm[mode]).abs();
        assert!(off < 1e-5 * sigma, "{mode}: {off} of {sigma}");
    }
    let largest = sigma_nm.iter().fold(0.0, |most: f64, sigma| most.max(sigma * sigma));
    let off: Array2<f64> = &refined.covariance_nm2 - &estimate.covariance_nm2;
    assert!(off.iter().all(|nm2| nm2.abs() < 1e-6 * largest));
    assert_eq!(refined.integers.len(), estimate.integers.len());
    assert!(refined.integers.iter().zip(&estimate.integers).all(|(a, b)| a.integer == b.integer));
}

/// A pair with its defocus known and known to 1 %, and two colours: the weights at the flat wavefront move the estimate by a small part of
/// its error bar, which is itself a few per cent off; of wavefronts of 64 nm and some 40 nm.
#[test]
fn a_session_agrees_with_the_estimate() {
    for (channels, error) in [(PAIR, "0"), (PAIR, "0.01"), (COLOURS, "0")] {
        let scene = with_channels(channels, &[("estimate.diversity_error", error)]);
        let images = Images::simulated_channels(&scene).unwrap();
        let mut session = session(&scene, &images);
        // Twice: nothing of the first fit is left in the second.
        for _ in 0..2 {
            session.fit(&FitOptions::default()).unwrap();
        }
        let found = estimate(&scene, &images);
        let fit = session.result().unwrap();
        assert!(matches!(fit.status, Status::Ok | Status::Misfit) && !fit.is_contradictory, "{:?}", fit.disagreement);
        let (off, ratios) = agreement(&session, &found);
        println!("{error}: off {off:.3} σ, ratios {ratios:?}, χ² {:?}", fit.disagreement);
        assert!(off < 0.25, "{off}");
        assert!(ratios[0] > 0.85 && ratios[1] < 1.15, "{ratios:?}");
        for (image, result) in found.images.iter().zip(session.results()) {
            assert_eq!(image.evaluations, result.report.evaluations);
        }
        refines_to(&session, &found);
        assert!(session.warnings().is_empty(), "{:?}", session.warnings());
    }
}

#[test]
fn whole_wavelengths_are_flagged_by_a_fit_and_then_refined() {
    let scene = with_channels(COLOURS, &[("aberrations.segment_piston_rms_nm", "3000")]);
    let images = Images::simulated_channels(&scene).unwrap();
    let mut session = session(&scene, &images);
    session.fit(&FitOptions::default()).unwrap();
    assert!(session.result().unwrap().is_contradictory);
    assert!(session.warnings().iter().any(|warning| warning.contains("contradict each other")));
    let found = estimate(&scene, &images);
    refines_to(&session, &found);
    let refined = session.refine().unwrap();
    assert!(!refined.is_contradictory && refined.integers.iter().all(|one| one.probability > 0.99));
    // From there on a fit has the whole wavelengths of its start.
    let start_nm = Array2::from_shape_vec((1, refined.coefficients_nm.len()), refined.coefficients_nm.clone()).unwrap();
    session.fit(&FitOptions { start_nm: Some(start_nm.view()), ..FitOptions::default() }).unwrap();
    let fit = session.result().unwrap();
    assert!(!fit.is_contradictory, "{:?}", fit.disagreement);
    let off = fit.coefficients_nm.iter().zip(&refined.coefficients_nm).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 1.0, "{off} nm");
}

#[test]
fn a_flipped_channel_is_flagged() {
    let scene = with_channels(PAIR, &[]);
    let mut images = Images::simulated_channels(&scene).unwrap();
    let flipped = images[1].images_e.slice(s![.., .., 1..;-1]).to_owned();
    images[1].images_e.slice_mut(s![.., .., 1..]).assign(&flipped);
    let mut session = session(&scene, &images);
    session.fit(&FitOptions::default()).unwrap();
    assert!(session.result().unwrap().is_contradictory);
}

#[test]
fn deadlines_cancels_and_frames_of_no_use() {
    let scene = with_channels(PAIR, &[]);
    let images = Images::simulated_channels(&scene).unwrap();
    let mut session = session(&scene, &images);
    assert!(session.result().is_none() && session.results().len() == 0);
    assert!(matches!(session.refine(), Err(Error::Value(_))));
    session.fit(&FitOptions { deadline: Some(Duration::ZERO), ..FitOptions::default() }).unwrap();
    let late = Status::NotConverged(StopReason::DeadlineReached);
    assert!(session.results().all(|result| result.report.status == late));
    let fit = session.result().unwrap();
    assert!(fit.status == late && fit.coefficients_nm.iter().chain(&fit.sigma_nm).all(|nm| nm.is_nan()));
    assert!(matches!(session.refine(), Err(Error::Value(_))));
    // The flag stops the fit of the next channel, too, and is lowered by it.
    session.cancel_flag().store(true, Ordering::Relaxed);
    assert!(matches!(session.fit(&FitOptions::default()), Err(Error::Interrupted(_))));
    assert!(session.result().is_none());
    session.fit(&FitOptions::default()).unwrap();
    assert!(session.result().unwrap().coefficients_nm.iter().all(|nm| nm.is_finite()));
    session.frame_mut(1).unwrap().0.fill(3.0);
    session.fit(&FitOptions::default()).unwrap();
    let statuses: Vec<Status> = session.results().map(|result| result.report.status).collect();
    assert!(matches!(statuses[..], [Status::Ok | Status::Misfit, Status::Unusable(_)]), "{statuses:?}");
    assert_eq!(session.result().unwrap().status, statuses[1]);
    assert!(session.result().unwrap().coefficients_nm[0].is_nan());
}

#[test]
fn scenes_without_a_joint_session_are_refused_with_the_reason() {
    let refused = |scene: &Scene, words: &str| {
        let error = JointSession::new(scene, &SessionOptions::default()).err().unwrap().to_string();
        assert_facts(&error, words);
    };
    refused(&crate::consistency::scene(&[]), "[[image.channel]]");
    let focus = format!("{PAIR}[[image.channel]]\nname = \"focus\"\ndiversity_focus_waves_rms = 0.0\n");
    refused(&with_channels(&focus, &[]), "channel 'focus' | in focus");
    refused(&with_channels(PAIR, &[("estimate.weighting", "none")]), "estimate.weighting = \"noise\"");
    refused(&with_channels(PAIR, &[("estimate.fit_optics", "[\"defocus\"]")]), "estimate.fit_optics");
    let two = SessionOptions { capacity: 2, ..SessionOptions::default() };
    let error = JointSession::new(&with_channels(PAIR, &[]), &two).err().unwrap().to_string();
    assert!(error.contains("capacity is 2"), "{error}");
}

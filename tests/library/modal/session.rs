//! A session gives what the estimator gives, and says what became of each image.

use super::scene;
use crate::common::source_images;
use cophase::Control;
use cophase::Error;
use cophase::imaging::{Chain, Choice, Precision};
use cophase::modal::{
    Cube, FitOptions, ImageResult, ModalEstimate, ModalFitter, Refusal, Session, SessionOptions, Status,
};
use cophase::optimize::StopReason;
use cophase::scene::Scene;
use ndarray::{Array2, Array3, Axis, s};
use std::sync::Arc;
use std::time::Duration;

fn estimator(scene: &Scene) -> Arc<ModalFitter> {
    Arc::new(ModalFitter::new(scene, false).unwrap())
}

/// A session on the CPU chain, whose bits the tests compare; a GPU has its own, and fits all images
/// of a call together.
fn session(estimator: &Arc<ModalFitter>, options: SessionOptions) -> Session {
    Session::new(estimator.clone(), &SessionOptions { device: Some(Choice::Cpu), ..options }).unwrap()
}

/// The fits of the images of the only channel.
fn fitted(session: &Session) -> &[ImageResult] {
    session.channels()[0].results()
}

/// Writes images into the frames of a session.
fn fill(session: &mut Session, images_e: &Array3<f64>) {
    for (i, image_e) in images_e.outer_iter().enumerate() {
        session.frame_mut(i, 0).unwrap().0.assign(&image_e);
    }
}

fn batch(estimator: &ModalFitter, images_e: &Array3<f64>) -> ModalEstimate {
    let bad = images_e.mapv(|_| false);
    let mut chain = Chain::cpu(estimator.model().optics.clone(), Precision::F64);
    let Cube { images_e, bad, .. } = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
    estimator.estimate(&mut chain, Cube { images_e, bad, read_noise_e: None }, &Control::default()).unwrap()
}

#[test]
fn session_has_the_bits_of_the_estimator_at_any_thread_count() {
    for weighting in ["noise", "none"] {
        // A session does not restart a misfit.
        let settings = [("image.count", "5"), ("estimate.weighting", weighting), ("estimate.restarts", "0")];
        let scene = scene(&settings);
        let mut images_e = source_images(&scene).images_e;
        images_e.index_axis_mut(Axis(0), 2).fill(4.0);
        let estimator = estimator(&scene);
        let estimate = batch(&estimator, &images_e);
        for (count, threads) in [(1, 1), (5, 1), (5, 2), (4, 0)] {
            let options = SessionOptions { capacity: 5, threads, ..SessionOptions::default() };
            let mut session = session(&estimator, options);
            fill(&mut session, &images_e);
            // Twice: nothing of the first fit is left in the second.
            for _ in 0..2 {
                session.fit(count, &FitOptions::default()).unwrap();
                assert_eq!(session.results().len(), count);
            }
            for (i, result) in fitted(&session).iter().enumerate() {
                let bits = |values: &[f64]| values.iter().map(|nm| nm.to_bits()).collect::<Vec<_>>();
                let expected = estimate.image_coefficients_nm.row(i).to_vec();
                if i == 2 {
                    assert_eq!(result.report.status, Status::Unusable(Refusal::Constant { value: 4.0 }));
                    assert!(result.coefficients_nm.iter().all(|nm| nm.is_nan()));
                    assert!(matches!(session.refine(i), Err(Error::Value(_))));
                    continue;
                }
                assert_eq!(bits(&result.coefficients_nm), bits(&expected), "image {i} of {count}, {threads} threads");
                let (here, there) = (&result.report, &estimate.images[i]);
                assert_eq!((here.status, here.evaluations), (there.status, there.evaluations));
                // The PSF is that before the mean piston was taken out: the same but for its
                // rounding.
                assert!((here.reduced_chi2 / there.reduced_chi2 - 1.0).abs() < 1e-9);
            }
        }
    }
}

#[test]
fn dead_lines_and_blocks_are_masked() {
    // Not reduced: a session refuses bad pixels of frames that are.
    let scene = scene(&[("image.samples_per_lambda_over_d", "2"), ("image.pixels", "88")]);
    let estimator = estimator(&scene);
    let mut session = session(&estimator, SessionOptions::default());
    let mut images_e = source_images(&scene).images_e;
    // Rows and columns.
    let dead = [s![0..88, 20..23], s![30..34, 31..35]];
    for mut image_e in images_e.outer_iter_mut() {
        dead.iter().for_each(|part| image_e.slice_mut(*part).fill(12.5));
    }
    let mut bits_when = |is_marked: bool| {
        fill(&mut session, &images_e);
        let (_, mut bad) = session.frame_mut(0, 0).unwrap();
        dead.iter().for_each(|part| bad.slice_mut(*part).fill(is_marked));
        session.fit(1, &FitOptions::default()).unwrap();
        let found = &fitted(&session)[0];
        (found.report.bad_pixels, found.coefficients_nm.iter().map(|nm| nm.to_bits()).collect::<Vec<_>>())
    };
    let (found, marked) = (bits_when(false), bits_when(true));
    assert!(found == marked && found.0 > 16, "{}, {}", found.0, marked.0);
}

#[test]
fn dead_pixels_without_light_refuse_no_frame() {
    // Reduced for the fit, and of a star whose light does not reach the corner.
    let scene = scene(&[("image.peak_snr", "50")]);
    let mut session = session(&estimator(&scene), SessionOptions::default());
    let mut images_e = source_images(&scene).images_e;
    images_e.slice_mut(s![.., 2..6, 3..7]).fill(0.0);
    fill(&mut session, &images_e);
    session.fit(1, &FitOptions::default()).unwrap();
    assert_eq!(fitted(&session)[0].report.status, Status::Ok);
}

#[test]
fn the_covariance_is_that_of_a_single_image() {
    let scene = scene(&[]);
    let images_e = source_images(&scene).images_e;
    let estimator = estimator(&scene);
    let mut session = session(&estimator, SessionOptions::default());
    assert!(matches!(session.refine(0), Err(Error::Value(_))));
    fill(&mut session, &images_e);
    session.fit(1, &FitOptions::default()).unwrap();
    // One image: the estimate's covariance is this image's.
    let (mine, theirs) =
        (session.refine(0).unwrap().modes.covariance_nm2, batch(&estimator, &images_e).combined.modes.covariance_nm2);
    let largest = theirs.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    // The same matrices from the same bits; χ² differs in its last digits.
    assert!((&mine - &theirs).iter().all(|d| d.abs() < 1e-9 * largest));
}

#[test]
fn a_deadline_stops_the_call_with_the_best_so_far() {
    let scene = scene(&[("image.count", "3")]);
    let images_e = source_images(&scene).images_e;
    let estimator = estimator(&scene);
    let options = SessionOptions { capacity: 3, ..SessionOptions::default() };
    let mut session = session(&estimator, options);
    fill(&mut session, &images_e);
    let start_nm = Array2::from_elem((3, estimator.model().optics.modes()), 1.5);
    let late = FitOptions { deadline: Some(Duration::ZERO), start_nm: Some(start_nm.view()), ..FitOptions::default() };
    session.fit(3, &late).unwrap();
    for result in fitted(&session) {
        assert_eq!(result.report.status, Status::NotConverged(StopReason::DeadlineReached));
        assert_eq!(result.report.evaluations, 0);
        assert!(result.coefficients_nm.iter().all(|&nm| nm == 1.5));
    }
    // Ever more time, until it suffices: whatever was begun and not finished says so.
    let mut microseconds = 20;
    loop {
        let options = FitOptions { deadline: Some(Duration::from_micros(microseconds)), ..FitOptions::default() };
        session.fit(3, &options).unwrap();
        let late = |status| matches!(status, Status::NotConverged(StopReason::DeadlineReached));
        let statuses: Vec<Status> = fitted(&session).iter().map(|result| result.report.status).collect();
        let first = statuses.iter().position(|&status| late(status));
        let Some(first) = first else { break };
        assert!(statuses[first..].iter().all(|&status| late(status)), "{statuses:?}");
        assert!(fitted(&session).iter().skip(first + 1).all(|result| result.report.evaluations == 0));
        assert!(session.results()[first].coefficients_nm.iter().all(|nm| nm.is_finite()));
        microseconds *= 2;
    }
}

#[test]
fn a_cancelled_fit_leaves_nothing_and_the_next_goes_on() {
    let scene = scene(&[super::EXPLAINED_SNR]);
    let images_e = source_images(&scene).images_e;
    let mut session = session(&estimator(&scene), SessionOptions::default());
    fill(&mut session, &images_e);
    session.control().cancel();
    assert!(matches!(session.fit(1, &FitOptions::default()), Err(Error::Interrupted(_))));
    assert!(session.results().is_empty());
    session.fit(1, &FitOptions::default()).unwrap();
    assert_eq!(fitted(&session)[0].report.status, Status::Ok);
}

#[test]
fn start_near_the_truth_takes_fewer_evaluations() {
    let scene = scene(&[]);
    let images_e = source_images(&scene).images_e;
    let mut session = session(&estimator(&scene), SessionOptions::default());
    fill(&mut session, &images_e);
    session.fit(1, &FitOptions::default()).unwrap();
    let cold = fitted(&session)[0].clone();
    let start_nm = ndarray::Array1::from(cold.coefficients_nm.clone()).insert_axis(Axis(0));
    session.fit(1, &FitOptions { start_nm: Some(start_nm.view()), ..FitOptions::default() }).unwrap();
    let warm = &fitted(&session)[0];
    assert!(warm.report.evaluations < cold.report.evaluations);
    let moved = warm.coefficients_nm.iter().zip(&cold.coefficients_nm).map(|(a, b)| (a - b).abs());
    // Each stops within its tolerance of 1e-3 nm of the minimum; where the directions are weak a
    // few times that.
    assert!(moved.fold(0.0, f64::max) < 1e-2);
}

#[test]
fn evaluations_are_those_of_the_chain() {
    let scene = scene(&[("image.count", "2")]);
    let images_e = source_images(&scene).images_e;
    let estimator = estimator(&scene);
    let modes = estimator.model().optics.modes();
    let at = Array2::from_shape_fn((2, modes), |(i, k)| ((i * modes + k) as f64).sin() * 5.0);
    let mut chain = Chain::cpu(estimator.model().optics.clone(), Precision::F64);
    let frame = |image_e| cophase::modal::Frame {
        data_e: image_e,
        bad: ndarray::ArrayView2::from_shape((132, 132), &[false; 132 * 132]).unwrap(),
        read_noise_e: Some(60.0),
    };
    let plan = estimator.model().preparation;
    let exposures: Vec<_> = images_e
        .outer_iter()
        .map(|image_e| plan.prepare(frame(image_e), estimator.recipe()).unwrap().exposure)
        .collect();
    chain.load(&exposures).unwrap();
    let expected = chain.evaluate(&[0, 1], at.view()).unwrap();
    for threads in [1, 2] {
        let options = SessionOptions { capacity: 2, threads, ..SessionOptions::default() };
        let mut session = session(&estimator, options);
        fill(&mut session, &images_e);
        let (mut objectives, mut gradients) = (vec![0.0; 2], vec![0.0; 2 * modes]);
        let unloaded = session.evaluate(0, at.view(), &mut objectives, &mut gradients);
        assert!(matches!(unloaded, Err(Error::Value(_))));
        session.load(0, 2, Some(60.0)).unwrap();
        session.evaluate(0, at.view(), &mut objectives, &mut gradients).unwrap();
        for (i, expected) in expected.iter().enumerate() {
            assert_eq!(objectives[i], expected.objective);
            assert_eq!(gradients[i * modes..][..modes], expected.gradient);
        }
    }
}

#[test]
fn invalid_sessions_are_refused_with_the_reason() {
    let scene = scene(&[]);
    let estimator = estimator(&scene);
    let message = |options| Session::new(estimator.clone(), &options).err().unwrap().to_string();
    assert!(message(SessionOptions { capacity: 0, ..SessionOptions::default() }).contains("capacity is 0"));
    let tolerance = SessionOptions { step_tolerance_nm: Some(-1.0), ..SessionOptions::default() };
    assert!(message(tolerance).contains("step_tolerance_nm is -1"));
    let paper = Arc::new(ModalFitter::new(&scene.with(&[("estimate.optimizer", "bfgs")]).unwrap(), false).unwrap());
    let error = Session::new(paper, &SessionOptions::default()).err().unwrap();
    assert!(error.to_string().contains("bfgs"));
    let mut session = session(&estimator, SessionOptions::default());
    assert!(session.frame_mut(1, 0).unwrap_err().to_string().contains("frame 1"));
    assert!(session.fit(2, &FitOptions::default()).unwrap_err().to_string().contains("2 groups"));
    let start_nm = Array2::from_elem((1, 3), 0.0);
    let error = session.fit(1, &FitOptions { start_nm: Some(start_nm.view()), ..FitOptions::default() }).unwrap_err();
    assert!(error.to_string().contains("1x3"));
    let error = session.fit(1, &FitOptions { read_noise_e: Some(f64::NAN), ..FitOptions::default() }).unwrap_err();
    assert!(error.to_string().contains("NaN"));
    // The frame is still empty.
    assert!(session.load(0, 1, None).unwrap_err().to_string().contains("frame 0"));
}

#[test]
fn bad_pixels_in_a_frame_to_be_reduced_are_refused() {
    let scene = scene(&[("image.samples_per_lambda_over_d", "4"), ("image.pixels", "176")]);
    let images_e = source_images(&scene).images_e;
    let estimator = estimator(&scene);
    assert!(estimator.model().preparation.reduced[0] < 176);
    let mut session = session(&estimator, SessionOptions::default());
    fill(&mut session, &images_e);
    session.fit(1, &FitOptions::default()).unwrap();
    // What the reduction leaves of this bright star makes χ² 2.03: fitted it is.
    assert!(matches!(fitted(&session)[0].report.status, Status::Ok | Status::Misfit));
    session.frame_mut(0, 0).unwrap().1[[3, 4]] = true;
    session.fit(1, &FitOptions::default()).unwrap();
    let Status::Unusable(refusal) = fitted(&session)[0].report.status else { panic!("a bad pixel would ring") };
    assert_eq!(refusal, Refusal::BadPixelsWouldRing { bad: 1 });
    assert!(refusal.to_string().contains("estimate.sampling = \"native\""));
}

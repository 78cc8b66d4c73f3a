//! Sessions of several channels.

use crate::channels::{COLOURS, PAIR, with_channels};
use crate::common::assert_facts;
use cophase::Error;
use cophase::imaging::{Choice, Precision};
use cophase::modal::{
    Accumulator, ChannelFitters, FitOptions, GroupResult, ImageResult, ModalFitter, Session, SessionOptions, Status,
};
use cophase::optimize::StopReason;
use cophase::pipeline::{Control, Estimate, Estimator, Images, Policy};
use cophase::scene::Scene;
use ndarray::{Array2, Axis, s};
use std::time::Duration;

/// A session of `scene` with the frames of `images`.
fn session(scene: &Scene, images: &[Images]) -> Session {
    let mut session = Session::new(ChannelFitters::new(scene, false).unwrap(), &SessionOptions::default()).unwrap();
    write(&mut session, 0, images);
    session
}

/// Writes the first frame of each channel into a group.
fn write(session: &mut Session, group: usize, images: &[Images]) {
    for (channel, images) in images.iter().enumerate() {
        session.frame_mut(group, channel).unwrap().0.assign(&images.images_e.slice(s![0, .., ..]));
    }
}

/// The result of the only group.
fn result(session: &Session) -> &GroupResult {
    &session.results()[0]
}

/// The fit of each image of the only group.
fn fits(session: &Session) -> impl Iterator<Item = &ImageResult> {
    session.channels().iter().map(|channel| &channel.results()[0])
}

/// The estimate without retries of the images.
fn estimate(scene: &Scene, images: &[Images]) -> Estimate {
    let realtime = Estimator::with_policy(scene, Policy::realtime(), Control::default()).unwrap();
    realtime.estimate(images).unwrap()
}

/// Compares a session with the estimate from the same images: the largest difference of a
/// coefficient over its error bar, and the smallest and largest ratio of error bars.
fn agreement(session: &Session, estimate: &Estimate) -> (f64, [f64; 2]) {
    let (fit, sigma_nm) = (result(session), estimate.modes.sigma_nm());
    let off = fit.coefficients_nm.iter().zip(&estimate.modes.coefficients_nm).zip(&sigma_nm);
    let off = off.map(|((a, b), sigma)| (a - b).abs() / sigma).fold(0.0, f64::max);
    let ratios: Vec<f64> = fit.sigma_nm.iter().zip(&sigma_nm).map(|(a, b)| a / b).collect();
    let extreme = |choose: fn(f64, f64) -> f64| ratios.iter().copied().reduce(choose).unwrap();
    (off, [extreme(f64::min), extreme(f64::max)])
}

/// The refined fit is the estimate: the minimum of one objective from two starts, within a tenth of
/// the step at which a fit stops, 1e-3 nm or 1e-2 of an error bar. The levels of the prior are
/// settled to 2 %, and with them the covariance to less.
fn refines_to(session: &Session, estimate: &Estimate) {
    let refined = session.refine(0).unwrap();
    let sigma_nm = estimate.modes.sigma_nm();
    for (mode, sigma) in sigma_nm.iter().enumerate() {
        let off = (refined.modes.coefficients_nm[mode] - estimate.modes.coefficients_nm[mode]).abs();
        assert!(off < 1e-3 * sigma, "{mode}: {off} of {sigma}");
    }
    let largest = sigma_nm.iter().fold(0.0, |most: f64, sigma| most.max(sigma * sigma));
    let off: Array2<f64> = &refined.modes.covariance_nm2 - &estimate.modes.covariance_nm2;
    let off = off.iter().fold(0.0, |most: f64, nm2| most.max(nm2.abs())) / largest;
    assert!(off < 0.01, "{off}");
    assert_eq!(refined.integers.len(), estimate.integers.len());
    assert!(refined.integers.iter().zip(&estimate.integers).all(|(a, b)| a.integer == b.integer));
}

/// A pair with its defocus known and known to 1 %, and two colours: one objective, from two starts,
/// but for the prior of the estimate. The error bars of the flat wavefront are a few per cent off;
/// of wavefronts of 64 nm and some 40 nm.
#[test]
fn a_session_agrees_with_the_estimate() {
    for (channels, error) in [(PAIR, "0"), (PAIR, "0.01"), (COLOURS, "0")] {
        let scene = with_channels(channels, &[("tolerance.defocus_fraction", error)]);
        let images = Images::simulated(&scene).unwrap();
        let mut session = session(&scene, &images);
        // Twice: nothing of the first fit is left in the second.
        for _ in 0..2 {
            session.fit(1, &FitOptions::default()).unwrap();
        }
        let found = estimate(&scene, &images);
        let fit = result(&session);
        assert!(matches!(fit.status, Status::Ok | Status::Misfit) && !fit.is_contradictory, "{:?}", fit.disagreement);
        let (off, ratios) = agreement(&session, &found);
        assert!(off < 0.05, "{off}");
        assert!(ratios[0] > 0.85 && ratios[1] < 1.15, "{ratios:?}");
        refines_to(&session, &found);
        assert!(session.warnings().is_empty(), "{:?}", session.warnings());
    }
}

/// Images that do not determine the wavefront one by one: a pair of a fifth of a wave, and an image
/// in focus beside a pair.
#[test]
fn weak_diversities_are_fitted_together() {
    let weak = PAIR.replace("-0.8", "-0.2");
    let with_focus = format!("[[image.channel]]\nname = \"focus\"\ndiversity_focus_waves_rms = 0.0\n{PAIR}");
    for (channels, settings) in [(weak, [("image.diversity_focus_waves_rms", "0.2")].as_slice()), (with_focus, &[])] {
        let scene = with_channels(&channels, settings);
        let images = Images::simulated(&scene).unwrap();
        let mut session = session(&scene, &images);
        session.fit(1, &FitOptions::default()).unwrap();
        let (found, fit) = (estimate(&scene, &images), result(&session));
        let (off, ratios) = agreement(&session, &found);
        assert!(off < 0.05 && !fit.is_contradictory, "{off} {:?}", fit.disagreement);
        assert!(ratios[0] > 0.85 && ratios[1] < 1.15, "{ratios:?}");
        refines_to(&session, &found);
    }
}

/// A star that is elsewhere in a channel that joins later: two colours, and one in focus.
#[test]
fn channels_may_have_stars_in_different_places() {
    let with_focus = format!("{PAIR}[[image.channel]]\nname = \"focus\"\ndiversity_focus_waves_rms = 0.0\n");
    for channels in [COLOURS, &with_focus] {
        let scene = with_channels(channels, &[]);
        let mut images = Images::simulated(&scene).unwrap();
        let last = images.len() - 1;
        let frame = images[last].images_e.index_axis(Axis(0), 0).to_owned();
        let (rows, columns) = frame.dim();
        let moved = |(y, x): (usize, usize)| frame[[(y + 3) % rows, (x + columns - 2) % columns]];
        let moved = Array2::from_shape_fn((rows, columns), moved);
        images[last].images_e.index_axis_mut(Axis(0), 0).assign(&moved);
        let found = estimate(&scene, &images);
        let mut session = session(&scene, &images);
        session.fit(1, &FitOptions::default()).unwrap();
        let (off, _) = agreement(&session, &found);
        let fit = result(&session);
        assert!(fit.status == Status::Ok && !fit.is_contradictory, "{:?} {:?}", fit.status, fit.disagreement);
        assert!(off < 0.05, "{off}");
    }
}

/// Two groups, on two threads and on each device: the fits of one thread of the CPU, to the
/// rounding of another chain and the step at which fits end.
#[test]
fn groups_are_the_same_on_threads_and_devices() {
    let scene = with_channels(PAIR, &[]);
    let other = scene.with(&[("aberrations.seed", "77")]).unwrap();
    let groups = [&scene, &other].map(|scene| Images::simulated(scene).unwrap());
    let fitters = ChannelFitters::new(&scene, false).unwrap();
    let fitted = |options: SessionOptions| {
        let mut session = Session::new(fitters.clone(), &SessionOptions { capacity: 2, ..options }).unwrap();
        groups.iter().enumerate().for_each(|(group, images)| write(&mut session, group, images));
        session.fit(2, &FitOptions::default()).unwrap();
        session.results().to_vec()
    };
    let expected = fitted(SessionOptions::default());
    let on_two = fitted(SessionOptions { threads: 2, ..SessionOptions::default() });
    for (found, expected) in on_two.iter().zip(&expected) {
        assert_eq!((&found.coefficients_nm, &found.sigma_nm), (&expected.coefficients_nm, &expected.sigma_nm));
    }
    for info in cophase::device::devices().unwrap_or_default() {
        for (precision, most) in [(Precision::F64, 0.01), (Precision::F32, 0.05)] {
            let device = Some(Choice::OpenClAt(info.platform, info.device));
            let found = fitted(SessionOptions { device, precision: Some(precision), ..SessionOptions::default() });
            for (found, expected) in found.iter().zip(&expected) {
                let modes = found.coefficients_nm.iter().zip(&expected.coefficients_nm).zip(&expected.sigma_nm);
                let off = modes.map(|((a, b), sigma)| (a - b).abs() / sigma).fold(0.0, f64::max);
                assert!(found.status == expected.status && off < most, "{precision:?} {:?} {off}", found.status);
            }
            // A channel of which no frame can be used.
            let options = SessionOptions { device, precision: Some(precision), ..SessionOptions::default() };
            let mut session = Session::new(fitters.clone(), &options).unwrap();
            write(&mut session, 0, &groups[0]);
            session.frame_mut(0, 1).unwrap().0.fill(3.0);
            session.fit(1, &FitOptions::default()).unwrap();
            let statuses: Vec<Status> = fits(&session).map(|fit| fit.report.status).collect();
            assert!(matches!(statuses[..], [Status::Ok, Status::Unusable(_)]), "{statuses:?}");
        }
    }
}

#[test]
fn whole_wavelengths_are_flagged_by_a_fit_and_then_refined() {
    let scene = with_channels(COLOURS, &[("aberrations.segment_piston_rms_nm", "3000")]);
    let images = Images::simulated(&scene).unwrap();
    let mut session = session(&scene, &images);
    session.fit(1, &FitOptions::default()).unwrap();
    assert!(result(&session).is_contradictory);
    assert!(session.warnings().iter().any(|warning| warning.contains("contradict each other")));
    let found = estimate(&scene, &images);
    refines_to(&session, &found);
    let refined = session.refine(0).unwrap();
    assert!(!refined.is_contradictory && refined.integers.iter().all(|one| one.probability > 0.99));
    // From there on a fit has the whole wavelengths of its start.
    let start_nm =
        Array2::from_shape_vec((1, refined.modes.coefficients_nm.len()), refined.modes.coefficients_nm.clone())
            .unwrap();
    session.fit(1, &FitOptions { start_nm: Some(start_nm.view()), ..FitOptions::default() }).unwrap();
    let fit = result(&session);
    assert!(!fit.is_contradictory, "{:?}", fit.disagreement);
    let off =
        fit.coefficients_nm.iter().zip(&refined.modes.coefficients_nm).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    assert!(off < 1.0, "{off} nm");
}

#[test]
fn a_flipped_channel_is_flagged() {
    let scene = with_channels(PAIR, &[]);
    let mut images = Images::simulated(&scene).unwrap();
    let flipped = images[1].images_e.slice(s![.., .., 1..;-1]).to_owned();
    images[1].images_e.slice_mut(s![.., .., 1..]).assign(&flipped);
    let mut session = session(&scene, &images);
    session.fit(1, &FitOptions::default()).unwrap();
    assert!(result(&session).is_contradictory);
}

#[test]
fn deadlines_cancels_and_frames_of_no_use() {
    let scene = with_channels(PAIR, &[]);
    let images = Images::simulated(&scene).unwrap();
    let mut session = session(&scene, &images);
    assert!(session.results().is_empty() && session.channels()[0].results().is_empty());
    assert!(matches!(session.refine(0), Err(Error::Value(_))));
    session.fit(1, &FitOptions { deadline: Some(Duration::ZERO), ..FitOptions::default() }).unwrap();
    let late = Status::NotConverged(StopReason::DeadlineReached);
    assert!(fits(&session).all(|fit| fit.report.status == late));
    let fit = result(&session);
    assert!(fit.status == late && fit.coefficients_nm.iter().chain(&fit.sigma_nm).all(|nm| nm.is_nan()));
    assert!(matches!(session.refine(0), Err(Error::Value(_))));
    // The flag stops the fit of the next channel, too, and is lowered by it.
    session.control().cancel();
    assert!(matches!(session.fit(1, &FitOptions::default()), Err(Error::Interrupted(_))));
    assert!(session.results().is_empty() && session.channels().iter().all(|channel| channel.results().is_empty()));
    session.fit(1, &FitOptions::default()).unwrap();
    assert!(result(&session).coefficients_nm.iter().all(|nm| nm.is_finite()));
    session.frame_mut(0, 1).unwrap().0.fill(3.0);
    session.fit(1, &FitOptions::default()).unwrap();
    let statuses: Vec<Status> = fits(&session).map(|fit| fit.report.status).collect();
    assert!(matches!(statuses[..], [Status::Ok | Status::Misfit, Status::Unusable(_)]), "{statuses:?}");
    assert_eq!(result(&session).status, statuses[1]);
    assert!(result(&session).coefficients_nm[0].is_nan());
}

/// A batch of two groups, of which the second has no joint result, and each group by itself: the
/// same bits.
#[test]
fn groups_of_a_batch_have_the_bits_of_single_groups() {
    let scene = with_channels(PAIR, &[]);
    let images = Images::simulated(&scene).unwrap();
    let mut empty = images.clone();
    empty[1].images_e.fill(3.0);
    let fitters = ChannelFitters::new(&scene, false).unwrap();
    let mut batch =
        Session::new(fitters.clone(), &SessionOptions { capacity: 3, ..SessionOptions::default() }).unwrap();
    for (group, images) in [&images, &empty, &images].into_iter().enumerate() {
        write(&mut batch, group, images);
    }
    batch.fit(3, &FitOptions::default()).unwrap();
    let mut single = Session::new(fitters.clone(), &SessionOptions::default()).unwrap();
    write(&mut single, 0, &images);
    single.fit(1, &FitOptions::default()).unwrap();
    assert_eq!(batch.results().len(), 3);
    for group in [0, 2] {
        let (found, expected) = (&batch.results()[group], result(&single));
        assert_eq!((&found.coefficients_nm, &found.sigma_nm), (&expected.coefficients_nm, &expected.sigma_nm));
        let (found, expected) = (batch.refine(group).unwrap(), single.refine(0).unwrap());
        assert_eq!(
            (found.modes.coefficients_nm, found.modes.covariance_nm2),
            (expected.modes.coefficients_nm, expected.modes.covariance_nm2)
        );
    }
    assert!(
        matches!(batch.results()[1].status, Status::Unusable(_)) && matches!(batch.refine(1), Err(Error::Value(_)))
    );
    assert!(matches!(batch.refine(3), Err(Error::Value(_))));
    // A sequence combines images of one channel.
    let error = Accumulator::new(fitters.first().clone(), 3).unwrap().push(&batch).unwrap_err().to_string();
    assert_facts(&error, "the session has 2 channels | one of one channel");
}

/// A list of one channel is fitted as the only channel of a scene, whose scene is that of the
/// channel.
#[test]
fn a_list_of_one_channel_is_a_scene_of_one() {
    let scene = with_channels("[[image.channel]]\nname = \"plus\"\n", &[]);
    let images = Images::simulated(&scene).unwrap();
    let mut listed = session(&scene, &images);
    let fitter = std::sync::Arc::new(ModalFitter::new(&scene.channels()[0].scene, false).unwrap());
    let mut only = Session::new(fitter, &SessionOptions::default()).unwrap();
    write(&mut only, 0, &images);
    for session in [&mut listed, &mut only] {
        session.fit(1, &FitOptions::default()).unwrap();
    }
    assert_eq!(result(&listed).coefficients_nm, result(&only).coefficients_nm);
    assert_eq!(result(&listed).coefficients_nm, fits(&listed).next().unwrap().coefficients_nm);
    assert!(result(&listed).sigma_nm.iter().all(|sigma| sigma.is_nan()) && !result(&listed).is_contradictory);
    assert_eq!(listed.refine(0).unwrap().modes.covariance_nm2, only.refine(0).unwrap().modes.covariance_nm2);
    assert_eq!([&listed, &only].map(|session| session.channels()[0].name()), ["plus", ""]);
}

#[test]
fn channels_without_a_session_are_refused_with_the_reason() {
    let refused = |scene: &Scene, words: &str| {
        let session =
            ChannelFitters::new(scene, false).and_then(|fitters| Session::new(fitters, &SessionOptions::default()));
        assert_facts(&session.err().unwrap().to_string(), words);
    };
    let focus = PAIR.replace("minus\"\ndiversity_focus_waves_rms = -0.8", "minus\"");
    refused(&with_channels(&focus, &[("image.diversity_focus_waves_rms", "0.0")]), "all channels are in focus");
    refused(&with_channels(PAIR, &[("estimate.weighting", "none")]), "estimate.weighting = \"noise\"");
    refused(&with_channels(PAIR, &[("estimate.group", "each")]), "one image of each channel together | \"each\"");
    refused(&with_channels(PAIR, &[("estimate.fit_optics", "[\"defocus\"]")]), "estimate.fit_optics");
    let mut pair =
        Session::new(ChannelFitters::new(&with_channels(PAIR, &[]), false).unwrap(), &SessionOptions::default())
            .unwrap();
    assert_facts(&pair.load(2, 1, None).unwrap_err().to_string(), "channel 2 does not exist | there are 2");
    assert_facts(&pair.frame_mut(0, 2).unwrap_err().to_string(), "channel 2 does not exist");
    assert_facts(&pair.fitters().only("a map").unwrap_err().to_string(), "2 channels | a map is of one channel");
}

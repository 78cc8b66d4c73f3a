//! On the CPU and the caller's own thread, a session neither allocates nor frees memory: counted at
//! the allocator.

use cophase::capi::*;
use cophase::imaging::Precision;
use cophase::modal::{ChannelFitters, FitOptions, ModalFitter, Refusal, Session, SessionOptions, Status};
use cophase::optimize::StopReason;
use cophase::scene::Scene;
use cophase::source;
use ndarray::{Array2, Axis};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::ffi::CString;
use std::hint::black_box;
use std::mem::MaybeUninit;
use std::ptr::{null, null_mut};
use std::sync::Arc;
use std::time::Duration;

/// The system's allocator, with a count of what this thread asks of it. A count of all threads
/// would see the test harness at work.
struct Counting;

thread_local! {
    /// Allocations, reallocations and deallocations. Has neither an initialiser to run nor a
    /// destructor, so that it can be used within the allocator.
    static CALLS: Cell<usize> = const { Cell::new(0) };
}

fn count() {
    CALLS.with(|calls| calls.set(calls.get() + 1));
}

// SAFETY: every call is passed on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count();
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// What `work` returns, and how often it called the allocator.
fn counted<R>(work: impl FnOnce() -> R) -> (R, usize) {
    let before = CALLS.with(Cell::get);
    let result = work();
    (result, CALLS.with(Cell::get) - before)
}

#[test]
fn the_counter_counts() {
    let (kept, calls) = counted(|| black_box(vec![1_u8; 100]));
    assert_eq!(calls, 1, "one allocation");
    assert_eq!(counted(|| drop(kept)).1, 1, "one deallocation");
    assert_eq!(counted(|| black_box(7.0_f64).sqrt()).1, 0, "nothing");
}

/// Seven segments and 12 Zernikes.
fn scene(settings: &[(&str, &str)]) -> Scene {
    let small = [
        ("pupil.aperture", "hexagonal"),
        ("pupil.rings", "1"),
        ("pupil.grid_m", "4.8"),
        ("pupil.samples", "64"),
        ("image.count", "4"),
        ("image.diversity_focus_waves_rms", "0.8"),
        ("aberrations.truth_samples", "512"),
        ("aberrations.ncpa_zernikes", "[4, 11]"),
        ("modes.ncpa", "zernike"),
        ("modes.ncpa_count", "12"),
        ("modes.exact_zernikes", "none"),
    ];
    Scene::preset("keck-artificial").unwrap().with(&small).unwrap().with(settings).unwrap()
}

/// Runs everything that promises not to allocate, on a thread that has never run any of it.
fn silent(scene: &Scene, precision: Precision) {
    let images_e = source::simulate(scene).unwrap().remove(0).images_e;
    let estimator = Arc::new(ModalFitter::new(scene, false).unwrap());
    let modes = estimator.model().optics.modes();
    let options = SessionOptions { capacity: 5, precision: Some(precision), ..SessionOptions::default() };
    let mut session = Session::new(estimator, &options).unwrap();
    for (i, image_e) in images_e.outer_iter().enumerate() {
        session.frame_mut(i, 0).unwrap().0.assign(&image_e);
    }
    session.frame_mut(4, 0).unwrap().0.fill(7.0);
    // Another thread than the session was made on: what the libraries keep per thread would show.
    let work = move || {
        let start_nm = Array2::from_elem((5, modes), 1.0);
        let (fitted, calls) = counted(|| session.fit(5, &FitOptions::default()));
        fitted.unwrap();
        assert_eq!(calls, 0, "a fit of five frames");
        let statuses: Vec<Status> = session.results().iter().map(|result| result.status).collect();
        let fitted = |status: &Status| matches!(status, Status::Ok | Status::Misfit);
        assert!(statuses[..4].iter().all(fitted), "{statuses:?}");
        assert_eq!(statuses[4], Status::Unusable(Refusal::Constant { value: 7.0 }));
        // A fit of these takes a dozen evaluations in the first weights, and some in each renewal
        // of them.
        let evaluations = session.channels()[0].results()[0].report.evaluations;
        assert!(evaluations > 5, "{evaluations}");

        let warm = FitOptions { start_nm: Some(start_nm.view()), read_noise_e: Some(0.0), ..FitOptions::default() };
        let (fitted, calls) = counted(|| session.fit(5, &warm));
        fitted.unwrap();
        assert_eq!(calls, 0, "a fit from a start, with the read noise of the border");

        // Half of the time that the fits took: the deadline comes in the midst of them.
        let seconds: f64 = session.results().iter().map(|result| result.seconds).sum();
        let mut share = 0.5;
        loop {
            let late = FitOptions { deadline: Some(Duration::from_secs_f64(seconds * share)), ..FitOptions::default() };
            let (fitted, calls) = counted(|| session.fit(4, &late));
            fitted.unwrap();
            assert_eq!(calls, 0, "a fit up to a deadline");
            let late = Status::NotConverged(StopReason::DeadlineReached);
            if session.results().iter().any(|result| result.status == late) {
                break;
            }
            share *= 0.5;
        }

        let (loaded, calls) = counted(|| session.load(0, 4, None));
        loaded.unwrap();
        assert_eq!(calls, 0, "loading");
        let (mut objectives, mut gradients) = (vec![0.0; 4], vec![0.0; 4 * modes]);
        let at = start_nm.slice(ndarray::s![..4, ..]);
        let (evaluated, calls) = counted(|| session.evaluate(0, at, &mut objectives, &mut gradients));
        evaluated.unwrap();
        assert_eq!(calls, 0, "evaluating");
        assert!(objectives.iter().all(|objective| *objective > 0.0));
    };
    std::thread::spawn(work).join().unwrap();
}

#[test]
fn native_frames_in_both_precisions() {
    let scene = scene(&[("image.samples_per_lambda_over_d", "3"), ("image.pixels", "132")]);
    for precision in [Precision::F64, Precision::F32] {
        silent(&scene, precision);
    }
}

#[test]
fn frames_whose_sampling_is_reduced() {
    let scene = scene(&[("image.samples_per_lambda_over_d", "4"), ("image.pixels", "176")]);
    let estimator = ModalFitter::new(&scene, false).unwrap();
    assert!(estimator.model().preparation.reduced[0] < 176);
    for precision in [Precision::F64, Precision::F32] {
        silent(&scene, precision);
    }
}

#[test]
fn frames_that_are_not_square() {
    let (columns, rows) = (("image.pixels", "132"), ("image.rows", "120"));
    silent(&scene(&[("image.samples_per_lambda_over_d", "3"), columns, rows]), Precision::F64);
    let reduced = scene(&[("image.samples_per_lambda_over_d", "4"), ("image.pixels", "176"), ("image.rows", "168")]);
    let preparation = ModalFitter::new(&reduced, false).unwrap().model().preparation;
    assert_eq!((preparation.frame, preparation.reduced), ([176, 168], [88, 84]));
    silent(&reduced, Precision::F64);
}

#[test]
fn the_objective_without_weights() {
    let scene =
        scene(&[("image.samples_per_lambda_over_d", "3"), ("image.pixels", "132"), ("estimate.weighting", "none")]);
    silent(&scene, Precision::F64);
}

/// A pair and two colours, on a thread that has never run any of it.
#[test]
fn sessions_of_several_channels() {
    for channel in ["diversity_focus_waves_rms = -0.8", "wavelength_nm = 1640.0"] {
        let scene = channels(channel);
        let images_e = source::simulate(&scene).unwrap();
        let fitters = ChannelFitters::new(&scene, false).unwrap();
        let mut session = Session::new(fitters, &SessionOptions { capacity: 2, ..SessionOptions::default() }).unwrap();
        for (group, channel) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            let frame_e = images_e[channel].images_e.index_axis(Axis(0), 0);
            session.frame_mut(group, channel).unwrap().0.assign(&frame_e);
        }
        let work = move || {
            let (fitted, calls) = counted(|| session.fit(2, &FitOptions::default()));
            fitted.unwrap();
            assert_eq!(calls, 0, "a fit of two frames of each channel");
            let fit = &session.results()[1];
            assert!(fit.sigma_nm.iter().all(|sigma| *sigma > 0.0 && sigma.is_finite()), "{:?}", fit.sigma_nm);
            let late = FitOptions { deadline: Some(Duration::ZERO), ..FitOptions::default() };
            let (fitted, calls) = counted(|| session.fit(2, &late));
            fitted.unwrap();
            assert_eq!(calls, 0, "a fit past its deadline");
        };
        std::thread::spawn(work).join().unwrap();
    }
}

/// The scene with two channels, whose second differs by `key`.
fn channels(key: &str) -> Scene {
    // At a higher S/N the few samples of this model would show.
    let settings = [("image.samples_per_lambda_over_d", "3"), ("image.pixels", "132"), ("image.count", "1")];
    let text = scene(&settings).with_override("image.peak_snr", "150").unwrap();
    let channels =
        format!("[[image.channel]]\nname = \"one\"\n[[image.channel]]\nname = \"two\"\n{key}\n\n[aberrations]");
    Scene::from_text(&text.text().replacen("[aberrations]", &channels, 1), std::path::Path::new("")).unwrap()
}

/// A caller's array as C hands it in.
fn input<T>(values: &[T], element: i32, shape: [usize; 3]) -> cophase_input {
    let [count, rows, cols] = shape;
    let (count_stride, row_stride) = ((rows * cols) as isize, cols as isize);
    cophase_input { data: values.as_ptr().cast(), element, count, rows, cols, count_stride, row_stride, col_stride: 1 }
}

/// The calls of a session of several channels that are marked [RT].
#[test]
fn the_calls_of_a_session_of_several_channels_marked_rt() {
    let scene = channels("diversity_focus_waves_rms = -0.8");
    let images_e = source::simulate(&scene).unwrap();
    let cubes: Vec<Vec<f64>> = images_e.iter().map(|made| made.images_e.iter().copied().collect()).collect();
    let frames: Vec<cophase_input> = cubes.iter().map(|cube| input(cube, COPHASE_F64, [1, 132, 132])).collect();
    let text = CString::new(scene.text()).unwrap();
    let (mut session, mut model) = (null_mut(), null_mut());
    unsafe {
        // SAFETY: zeros are the defaults.
        let mut options = std::mem::zeroed::<cophase_session_options>();
        (options.struct_size, options.device) = (size_of_val(&options), c"cpu".as_ptr());
        assert_eq!(cophase_model_create(text.as_ptr(), null(), null(), &mut model), COPHASE_OK);
        assert_eq!(cophase_session_create(model, &options, &mut session), COPHASE_OK);
        let mut info = MaybeUninit::<cophase_model_info>::uninit();
        assert_eq!(cophase_model_get_info(model, info.as_mut_ptr(), size_of::<cophase_model_info>()), COPHASE_OK);
        let modes = info.assume_init().modes;
        cophase_model_destroy(model);
        let (mut coefficients_nm, mut sigma_nm) = (vec![0.0; modes], vec![0.0; modes]);
        let mut group = MaybeUninit::<cophase_group_report>::uninit();
        let mut images = [MaybeUninit::<cophase_image_report>::uninit(); 2];
        let (first, size) = (images.as_mut_ptr().cast(), size_of::<cophase_image_report>());
        let (status, calls) = counted(|| {
            cophase_session_fit(
                session,
                frames.as_ptr(),
                2,
                null(),
                coefficients_nm.as_mut_ptr(),
                sigma_nm.as_mut_ptr(),
                modes,
                first,
                size,
                group.as_mut_ptr(),
                size_of::<cophase_group_report>(),
            )
        });
        assert_eq!((status, calls), (COPHASE_OK, 0), "fit");
        let group = group.assume_init();
        assert!(group.status <= COPHASE_IMAGE_MISFIT && group.is_contradictory == 0, "{group:?}");
        for (channel, image) in images.into_iter().enumerate() {
            let image = image.assume_init();
            assert!(image.channel == channel as i64 && image.is_used == 1 && image.evaluations > 5, "{image:?}");
        }
        cophase_session_destroy(session);
    }
}

/// What a camera would deliver: whole numbers, three electrons each, over a dark level.
fn raw(scene: &Scene) -> Vec<u16> {
    let images_e = source::simulate(scene).unwrap().remove(0).images_e;
    images_e.iter().map(|electrons| (electrons / 3.0 + 100.0).round() as u16).collect()
}

/// Every call of the header that is marked [RT], with raw frames and their calibration.
#[test]
fn the_calls_of_the_c_interface_marked_rt() {
    let scene = scene(&[
        ("image.samples_per_lambda_over_d", "3"),
        ("image.pixels", "132"),
        ("image.rows", "120"),
        ("image.peak_snr", "150"),
        ("image.read_noise_e", "5"),
    ]);
    let (raw, shape) = (raw(&scene), [4, 120, 132]);
    let dark = vec![100.0_f32; 120 * 132];
    let text = CString::new(scene.text()).unwrap();
    let (mut model, mut session, mut sequence) = (null_mut(), null_mut(), null_mut());
    let mut estimator = null_mut();
    let modes = unsafe {
        assert_eq!(cophase_model_create(text.as_ptr(), null(), null(), &mut model), COPHASE_OK);
        let mut info = MaybeUninit::<cophase_model_info>::uninit();
        assert_eq!(cophase_model_get_info(model, info.as_mut_ptr(), size_of::<cophase_model_info>()), COPHASE_OK);
        // SAFETY: zeros are the defaults.
        let mut options = std::mem::zeroed::<cophase_session_options>();
        (options.struct_size, options.capacity) = (size_of_val(&options), 4);
        options.device = c"cpu".as_ptr();
        assert_eq!(cophase_session_create(model, &options, &mut session), COPHASE_OK);
        assert_eq!(cophase_sequence_create(model, 3, &mut sequence), COPHASE_OK);
        assert_eq!(cophase_estimator_create(text.as_ptr(), null(), null(), &mut estimator), COPHASE_OK);
        let mut calibration = std::mem::zeroed::<cophase_calibration>();
        calibration.struct_size = size_of_val(&calibration);
        (calibration.dark, calibration.gain_e) = (input(&dark, COPHASE_F32, [1, 120, 132]), 3.0);
        calibration.saturation = 65535.0;
        assert_eq!(cophase_session_calibrate(session, 0, &calibration), COPHASE_OK);
        info.assume_init().modes
    };
    let frames = input(&raw, COPHASE_U16, shape);
    let mut coefficients_nm = vec![0.0; 4 * modes];
    let (mut objectives, mut gradients) = (vec![0.0; 4], vec![0.0; 4 * modes]);
    let mut reports = [MaybeUninit::<cophase_image_report>::uninit(); 4];
    let size = size_of::<cophase_image_report>();
    let call = |name: &str, call: &mut dyn FnMut() -> i32| {
        let (status, calls) = counted(call);
        assert_eq!((status, calls), (COPHASE_OK, 0), "{name}");
    };
    unsafe {
        let (out, first) = (coefficients_nm.as_mut_ptr(), reports.as_mut_ptr().cast());
        let (sigma, groups) = (null_mut(), null_mut());
        call("fit", &mut || {
            cophase_session_fit(session, &frames, 1, null(), out, sigma, modes, first, size, groups, 0)
        });
        // More than it keeps.
        call("push", &mut || cophase_sequence_push(sequence, session));
        call("push again", &mut || cophase_sequence_push(sequence, session));
        let (objectives, gradients) = (objectives.as_mut_ptr(), gradients.as_mut_ptr());
        for frames in [&raw const frames, null()] {
            call("evaluate", &mut || {
                cophase_session_evaluate(session, 0, frames, null(), out, 4, modes, objectives, gradients)
            });
        }
        call("clear", &mut || cophase_sequence_push(sequence, null()));
        call("cancel", &mut || cophase_session_cancel(session));
        let (mut stage, mut done, mut total) = (7, 7, 7);
        call("progress", &mut || cophase_estimator_progress(estimator, &mut stage, &mut done, &mut total));
        assert_eq!((stage, done, total), (COPHASE_STAGE_IDLE, 0, 0));
        call("cancel an estimate", &mut || cophase_estimator_cancel(estimator));
        cophase_estimator_destroy(estimator);
        for report in reports {
            let report = report.assume_init();
            assert!(report.status <= COPHASE_IMAGE_MISFIT && report.evaluations > 5, "{report:?}");
        }
        cophase_sequence_destroy(sequence);
        cophase_session_destroy(session);
        cophase_model_destroy(model);
    }
}

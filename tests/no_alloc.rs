//! On the CPU and the caller's own thread, a session neither allocates nor frees memory: counted at the allocator.

use cophase::estimate::{Estimator, FitOptions, Refusal, Session, SessionOptions, Status};
use cophase::imaging::Precision;
use cophase::optimize::StopReason;
use cophase::scene::Scene;
use cophase::source;
use ndarray::Array2;
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::hint::black_box;
use std::sync::Arc;
use std::time::Duration;

/// The system's allocator, with a count of what this thread asks of it. A count of all threads would see the test
/// harness at work.
struct Counting;

thread_local! {
    /// Allocations, reallocations and deallocations. Has neither an initialiser to run nor a destructor, so that it can
    /// be used within the allocator.
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
    let images_e = source::images(scene).unwrap().images_e;
    let estimator = Arc::new(Estimator::new(scene, false).unwrap());
    let modes = estimator.model().optics.modes();
    let options = SessionOptions { capacity: 5, precision, ..SessionOptions::default() };
    let mut session = Session::new(estimator, &options).unwrap();
    for (i, image_e) in images_e.outer_iter().enumerate() {
        session.frame_mut(i).unwrap().0.assign(&image_e);
    }
    session.frame_mut(4).unwrap().0.fill(7.0);
    // Another thread than the session was made on: what the libraries keep per thread would show.
    let work = move || {
        let start_nm = Array2::from_elem((5, modes), 1.0);
        let (fitted, calls) = counted(|| session.fit(5, &FitOptions::default()));
        fitted.unwrap();
        assert_eq!(calls, 0, "a fit of five frames");
        let statuses: Vec<Status> = session.results().iter().map(|result| result.report.status).collect();
        let fitted = |status: &Status| matches!(status, Status::Ok | Status::Misfit);
        assert!(statuses[..4].iter().all(fitted), "{statuses:?}");
        assert_eq!(statuses[4], Status::Unusable(Refusal::Constant { value: 7.0 }));
        // A fit of these takes a dozen evaluations in the first weights, and some in each renewal of them.
        let evaluations = session.results()[0].report.evaluations;
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
            if session.results().iter().any(|result| result.report.status == late) {
                break;
            }
            share *= 0.5;
        }

        let (loaded, calls) = counted(|| session.load(4, None));
        loaded.unwrap();
        assert_eq!(calls, 0, "loading");
        let (mut objectives, mut gradients) = (vec![0.0; 4], vec![0.0; 4 * modes]);
        let at = start_nm.slice(ndarray::s![..4, ..]);
        let (evaluated, calls) = counted(|| session.evaluate(at, &mut objectives, &mut gradients));
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
    let estimator = Estimator::new(&scene, false).unwrap();
    assert!(estimator.model().preparation.reduced[0] < 176);
    for precision in [Precision::F64, Precision::F32] {
        silent(&scene, precision);
    }
}

#[test]
fn frames_that_are_not_square() {
    let (columns, rows) = (("image.pixels", "132"), ("image.rows", "120"));
    silent(&scene(&[("image.samples_per_lambda_over_d", "3"), columns, rows]), Precision::F64);
    let reduced = scene(&[("image.samples_per_lambda_over_d", "4"), ("image.pixels", "176"), ("image.rows", "144")]);
    let preparation = Estimator::new(&reduced, false).unwrap().model().preparation;
    assert_eq!((preparation.frame, preparation.reduced), ([176, 144], [88, 72]));
    silent(&reduced, Precision::F64);
}

#[test]
fn the_objective_without_weights() {
    let scene =
        scene(&[("image.samples_per_lambda_over_d", "3"), ("image.pixels", "132"), ("estimate.weighting", "none")]);
    silent(&scene, Precision::F64);
}

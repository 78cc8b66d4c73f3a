//! Progress and cancellation of MAP estimates.

use crate::full_phase::{exposures, sky};
use cophase::Error;
use cophase::ao::Stepper;
use cophase::control::CancelFlag;
use cophase::pipeline::{Control, Estimator, Images, Policy, Progress, Stage};
use cophase::scene::Scene;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};

const COUNT: u64 = 3;

fn setting() -> (Scene, Images) {
    let settings = [("estimate.method", "full-phase"), ("estimate.device", "cpu")];
    let scene = Scene::from_file(sky()).unwrap().with(&settings).unwrap();
    let images = exposures(&mut Stepper::new(&scene).unwrap(), COUNT as usize);
    (scene, images)
}

/// Progress of an estimator that raises its flag when `is_enough`, and the estimator.
fn observed(
    scene: &Scene,
    is_enough: impl Fn(&[Progress]) -> bool + Send + 'static,
) -> (Estimator, Arc<Mutex<Vec<Progress>>>) {
    let (flag, seen) = (CancelFlag::default(), Arc::new(Mutex::new(Vec::new())));
    let observer = {
        let (flag, seen) = (flag.clone(), seen.clone());
        move |progress| {
            let mut seen = seen.lock().unwrap();
            seen.push(progress);
            if is_enough(&seen) {
                flag.store(true, Ordering::Relaxed);
            }
        }
    };
    let control = Control::with_flag(flag, observer);
    (Estimator::with_policy(scene, Policy::default(), control).unwrap(), seen)
}

#[test]
#[ignore = "merge: 2 s"]
fn the_stages_of_a_map_estimate_count_their_images() {
    let (scene, images) = setting();
    let (estimator, seen) = observed(&scene, |_| false);
    let found = estimator.estimate(&images).unwrap();
    let seen = seen.lock().unwrap();
    // One run of equal stages for each change of the stage.
    let runs: Vec<&[Progress]> = seen.chunk_by(|one, next| one.stage == next.stage).collect();
    let of = |stage: Stage| runs.iter().copied().filter(move |run| run[0].stage == stage).collect::<Vec<_>>();
    let (retrieving, separating) = (of(Stage::Retrieving), of(Stage::Separating));
    let iterations = found.full_phase().unwrap().iterations.len();
    // The iterations, each of which retrieves wavefronts and then separates the static errors.
    assert!(retrieving.len() >= iterations && separating.len() >= iterations, "{iterations} iterations: {seen:?}");
    for run in retrieving {
        assert!(run.iter().all(|progress| progress.total == COUNT && progress.done <= COUNT), "{run:?}");
        assert!(run.iter().any(|progress| progress.done == COUNT), "{run:?}");
    }
    // The count of all stages goes on, and ends with an image for each of an iteration's.
    assert!(seen.is_sorted_by_key(|progress| progress.all_done), "{seen:?}");
    let all_done = seen.last().unwrap().all_done;
    assert!(all_done >= iterations as u64 * COUNT, "{all_done} of {iterations} iterations");
    assert_eq!(seen.last().unwrap().stage, Stage::Idle);
}

#[test]
fn map_estimate_is_cancelled_in_retrieval_and_separation() {
    let (scene, images) = setting();
    for stage in [Stage::Retrieving, Stage::Separating] {
        // Of the images one is retrieved, so that the work is in its middle.
        let is_under_way =
            move |progress: &Progress| progress.stage == stage && (progress.total == 0 || progress.done > 0);
        let (estimator, seen) = observed(&scene, move |seen: &[Progress]| seen.last().is_some_and(is_under_way));
        match estimator.estimate(&images).map(|_| ()) {
            Err(Error::Interrupted(_)) => {}
            other => panic!("{stage:?}: {other:?}"),
        }
        let seen = seen.lock().unwrap();
        let first = seen.iter().position(is_under_way).unwrap();
        // No further iteration begins.
        let begins = |progress: &Progress| progress.stage == Stage::Retrieving && progress.done == 0;
        assert!(!seen[first..].iter().any(begins), "{seen:?}");
        // The flag is lowered again.
        assert!(!estimator.control().is_cancelled());
    }
}

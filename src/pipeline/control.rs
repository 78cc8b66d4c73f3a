//! Progress and cancellation of a long call: one object that the caller keeps and other threads may use.

use crate::optimize::CancelFlag;
use crate::{Error, Result};
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// Stage of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Nothing has begun.
    Idle,
    /// The planner tries models on simulated images (`estimate.budget_nm`).
    Planning,
    /// Pupil, modes and metric are built; optical parameters are fitted where the scene asks for it.
    Preparing,
    /// Images are fitted.
    Fitting,
    /// Covariances are computed, and images combined.
    Combining,
    /// Wavefronts are retrieved (MAP); `done` counts the images of this iteration.
    Retrieving,
    /// Static errors are separated from the turbulence (MAP).
    Separating,
}

impl Stage {
    const ALL: [Self; 7] = [
        Self::Idle,
        Self::Planning,
        Self::Preparing,
        Self::Fitting,
        Self::Combining,
        Self::Retrieving,
        Self::Separating,
    ];

    /// Label for a progress bar.
    pub fn label(self) -> &'static str {
        match self {
            Self::Idle => "Idle",
            Self::Planning => "Planning",
            Self::Preparing => "Preparing the model",
            Self::Fitting => "Fitting images",
            Self::Combining => "Computing error bars",
            Self::Retrieving => "Retrieving wavefronts",
            Self::Separating => "Separating static errors",
        }
    }
}

/// Progress of an estimate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Current stage.
    pub stage: Stage,
    /// Steps of this stage that are done: images, or candidates of a plan.
    pub done: u64,
    /// Steps of this stage; 0 where the number is not known.
    pub total: u64,
    /// Steps of all stages that were done since the call began.
    pub all_done: u64,
}

type Observer = Box<dyn FnMut(Progress) + Send>;

/// Progress of a call, and the flag that stops it. Clones share one state: keep one, give the other to the
/// [`Estimator`](super::Estimator).
#[derive(Clone, Default)]
pub struct Control {
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    cancel: CancelFlag,
    stage: AtomicU8,
    done: AtomicU64,
    total: AtomicU64,
    all_done: AtomicU64,
    observer: Mutex<Option<Observer>>,
}

impl Control {
    /// A control that calls `observer` whenever the progress changes, on a thread of the estimate.
    pub fn with_observer(observer: impl FnMut(Progress) + Send + 'static) -> Self {
        Self::with_flag(CancelFlag::default(), observer)
    }

    /// As [`Control::with_observer`], with a flag of the caller's, which for example a signal handler raises.
    pub fn with_flag(cancel: CancelFlag, observer: impl FnMut(Progress) + Send + 'static) -> Self {
        let observer: Mutex<Option<Observer>> = Mutex::new(Some(Box::new(observer)));
        Self { shared: Arc::new(Shared { cancel, observer, ..Shared::default() }) }
    }

    /// Stops the call that is running, or else the next one, at its next safe place: it returns
    /// [`Error::Interrupted`]. Safe in a signal handler.
    pub fn cancel(&self) {
        self.shared.cancel.store(true, Ordering::Relaxed);
    }

    /// Whether [`Control::cancel`] was called and no call has returned for it yet.
    pub fn is_cancelled(&self) -> bool {
        self.shared.cancel.load(Ordering::Relaxed)
    }

    /// Progress of the call.
    pub fn progress(&self) -> Progress {
        let shared = &self.shared;
        let stage = usize::from(shared.stage.load(Ordering::Relaxed));
        Progress {
            stage: Stage::ALL.get(stage).copied().unwrap_or(Stage::Idle),
            done: shared.done.load(Ordering::Relaxed),
            total: shared.total.load(Ordering::Relaxed),
            all_done: shared.all_done.load(Ordering::Relaxed),
        }
    }

    /// The flag itself.
    pub(crate) fn flag(&self) -> &CancelFlag {
        &self.shared.cancel
    }

    /// Resets the progress at the start of a call.
    pub(super) fn reset_progress(&self) {
        self.shared.all_done.store(0, Ordering::Relaxed);
        self.enter(Stage::Idle, 0);
    }

    /// Lowers the flag after a call was cancelled.
    pub(super) fn acknowledge(&self) {
        self.shared.cancel.store(false, Ordering::Relaxed);
    }

    /// A stage of `total` steps begins.
    pub(super) fn enter(&self, stage: Stage, total: usize) {
        let place = Stage::ALL.iter().position(|known| *known == stage).unwrap_or_default();
        self.shared.stage.store(place as u8, Ordering::Relaxed);
        self.shared.done.store(0, Ordering::Relaxed);
        self.shared.total.store(total as u64, Ordering::Relaxed);
        self.observe();
    }

    /// `done` steps of this stage are done.
    pub(super) fn advance_to(&self, done: usize) {
        let before = self.shared.done.swap(done as u64, Ordering::Relaxed);
        // A smaller number starts a new count, as each iteration of a MAP estimate does.
        let new = if (done as u64) < before { done as u64 } else { done as u64 - before };
        self.shared.all_done.fetch_add(new, Ordering::Relaxed);
        self.observe();
    }

    /// # Errors
    /// [`Error::Interrupted`] with `state`, a description of what was done by then, where the flag is raised.
    pub(super) fn check(&self, state: &str) -> Result<()> {
        if self.is_cancelled() { Err(Error::Interrupted(state.into())) } else { Ok(()) }
    }

    fn observe(&self) {
        let mut observer = self.shared.observer.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(observer) = observer.as_mut() {
            observer(self.progress());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_and_the_flag_are_shared_between_clones() {
        let seen = Arc::new(Mutex::new(Vec::new()));
        let control = {
            let seen = seen.clone();
            Control::with_observer(move |progress| seen.lock().unwrap().push((progress.stage, progress.done)))
        };
        let other = control.clone();
        control.enter(Stage::Fitting, 3);
        control.advance_to(2);
        control.advance_to(3);
        let expected = Progress { stage: Stage::Fitting, done: 3, total: 3, all_done: 3 };
        assert_eq!(other.progress(), expected);
        assert_eq!(*seen.lock().unwrap(), [(Stage::Fitting, 0), (Stage::Fitting, 2), (Stage::Fitting, 3)]);
        other.cancel();
        let stopped = control.check("3 of 3 images were fitted").unwrap_err();
        assert!(matches!(stopped, Error::Interrupted(sentence) if sentence == "3 of 3 images were fitted"));
        control.acknowledge();
        assert!(!other.is_cancelled());
    }
}

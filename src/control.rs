//! Control of a long call: its progress, its cancellation and its deadline, in one object that
//! every level of it is given.

use crate::{Error, Result};
use std::sync::atomic::{AtomicBool, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// Cancel flag: set it to true to end a run. It is read once per evaluation.
pub type CancelFlag = Arc<AtomicBool>;

/// Stage of a long call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stage {
    /// Nothing has begun.
    Idle,
    /// A planner tries models (`estimate.budget_nm`) or observations on simulated images.
    Planning,
    /// Pupil, modes and metric are built; optical parameters are fitted where the scene asks for
    /// it.
    Preparing,
    /// Images are fitted.
    Fitting,
    /// Covariances are computed, and images combined.
    Combining,
    /// Wavefronts are retrieved (MAP); `done` counts the images of this iteration.
    Retrieving,
    /// Static errors are separated from the turbulence (MAP).
    Separating,
    /// An AO system is simulated; `done` counts the frames of its loop.
    Simulating,
}

impl Stage {
    const ALL: [Self; 8] = [
        Self::Idle,
        Self::Planning,
        Self::Preparing,
        Self::Fitting,
        Self::Combining,
        Self::Retrieving,
        Self::Separating,
        Self::Simulating,
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
            Self::Simulating => "Simulating",
        }
    }
}

/// Progress of a long call.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Progress {
    /// Current stage.
    pub stage: Stage,
    /// Steps of this stage that are done: images, candidates of a plan, frames of a loop.
    pub done: u64,
    /// Steps of this stage; 0 where the number is not known.
    pub total: u64,
    /// Steps of all stages that were done since the call began.
    pub all_done: u64,
}

type Observer = Box<dyn FnMut(Progress) + Send>;

/// Progress of a call, the flag that stops it, and its deadline. Clones share progress and flag:
/// keep one, give the other to the [`Estimator`](crate::pipeline::Estimator). Without an observer
/// no method takes a lock or memory.
#[derive(Clone, Default)]
pub struct Control {
    shared: Arc<Shared>,
    deadline: Option<Instant>,
    is_silent: bool,
}

#[derive(Default)]
struct Shared {
    cancel: CancelFlag,
    stage: AtomicU8,
    done: AtomicU64,
    total: AtomicU64,
    all_done: AtomicU64,
    observer: Option<Mutex<Observer>>,
}

impl Shared {
    fn begin(&self, stage: Stage, total: usize) {
        let place = Stage::ALL.iter().position(|known| *known == stage).unwrap_or_default();
        self.stage.store(place as u8, Ordering::Relaxed);
        self.done.store(0, Ordering::Relaxed);
        self.total.store(total as u64, Ordering::Relaxed);
    }
}

impl Control {
    /// A control that calls `observer` whenever the progress changes, on a thread of the call.
    pub fn with_observer(observer: impl FnMut(Progress) + Send + 'static) -> Self {
        Self::with_flag(CancelFlag::default(), observer)
    }

    /// As [`Control::with_observer`], with a flag of the caller's, which for example a signal
    /// handler raises.
    pub fn with_flag(cancel: CancelFlag, observer: impl FnMut(Progress) + Send + 'static) -> Self {
        let observer: Observer = Box::new(observer);
        let shared = Shared { cancel, observer: Some(Mutex::new(observer)), ..Shared::default() };
        Self { shared: Arc::new(shared), ..Self::default() }
    }

    /// Stops the call that is running, or else the next one, at its next safe place: it returns
    /// [`Error::Interrupted`]. An estimator, a check and a session lower the flag then; plans and
    /// simulators leave it up. Safe in a signal handler.
    pub fn cancel(&self) {
        self.shared.cancel.store(true, Ordering::Relaxed);
    }

    /// Whether the flag is up.
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

    /// A control without an observer, with a flag of the caller's.
    pub fn of_flag(cancel: CancelFlag) -> Self {
        Self { shared: Arc::new(Shared { cancel, ..Shared::default() }), ..Self::default() }
    }

    /// For work within a stage whose steps are not the stage's: cancelled with this control, and
    /// without progress.
    pub(crate) fn silent(&self) -> Self {
        Self { is_silent: true, ..self.clone() }
    }

    /// This control with another deadline.
    pub(crate) fn until(&self, deadline: Option<Instant>) -> Self {
        Self { deadline, ..self.clone() }
    }

    /// When to stop, with what there is by then.
    pub(crate) fn deadline(&self) -> Option<Instant> {
        self.deadline
    }

    /// Whether the deadline has passed.
    pub(crate) fn is_late(&self) -> bool {
        self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    /// The flag itself.
    pub(crate) fn flag(&self) -> &CancelFlag {
        &self.shared.cancel
    }

    /// Resets the progress at the start of a call.
    pub(crate) fn reset_progress(&self) {
        self.change(|shared| {
            shared.all_done.store(0, Ordering::Relaxed);
            shared.begin(Stage::Idle, 0);
        });
    }

    /// Lowers the flag after a call was cancelled; work within a call leaves it to the call.
    pub(crate) fn acknowledge(&self) {
        if !self.is_silent {
            self.shared.cancel.store(false, Ordering::Relaxed);
        }
    }

    /// A stage of `total` steps begins.
    pub(crate) fn enter(&self, stage: Stage, total: usize) {
        self.change(|shared| shared.begin(stage, total));
    }

    /// `steps` more of this stage are done. No more than all are counted: images of a device that
    /// is lost are fitted twice.
    pub(crate) fn step(&self, steps: usize) {
        let steps = steps as u64;
        if steps > 0 {
            self.change(|shared| {
                let total = shared.total.load(Ordering::Relaxed);
                let most = if total == 0 { u64::MAX } else { total };
                let after = |done: u64| (done + steps).min(most.max(done));
                let counted = shared.done.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |done| Some(after(done)));
                let before = counted.unwrap_or_else(|done| done);
                shared.all_done.fetch_add(after(before) - before, Ordering::Relaxed);
            });
        }
    }

    /// # Errors
    /// [`Error::Interrupted`] with `state`, a description of what was done by then, where the flag
    /// is raised.
    pub(crate) fn check(&self, state: &str) -> Result<()> {
        self.check_with(|| state.into())
    }

    /// As [`Control::check`], with a description that is made where it is needed.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where the flag is raised.
    pub(crate) fn check_with(&self, state: impl FnOnce() -> String) -> Result<()> {
        if self.is_cancelled() { Err(Error::Interrupted(state())) } else { Ok(()) }
    }

    /// Changes the progress under the lock of the observer, so that the counts that it sees never
    /// fall.
    fn change(&self, change: impl FnOnce(&Shared)) {
        if self.is_silent {
            return;
        }
        let Some(observer) = &self.shared.observer else { return change(&self.shared) };
        let mut observer = observer.lock().unwrap_or_else(PoisonError::into_inner);
        change(&self.shared);
        observer(self.progress());
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
        control.step(2);
        control.silent().enter(Stage::Combining, 0);
        control.silent().step(1);
        control.silent().reset_progress();
        // One image of a device that was lost, again.
        control.step(2);
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

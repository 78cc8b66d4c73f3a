//! Minimisation of smooth functions of many variables. This room knows vectors only.
//!
//! * [`QuasiNewton`] is the fast path: limited-memory BFGS in coordinates whitened by a Gauss-Newton matrix
//!   ([`Metric`]), written as an ask/tell machine so that many independent problems can advance in lock-step over one
//!   device call. [`minimize`] drives one of them over a closure.
//! * [`ArgminBfgs`] is the reference: full-memory BFGS of the `argmin` crate, in the caller's own coordinates.
//!
//! Every run ends with a [`StopReason`], a sentence that can be shown to a person.

mod line_search;
mod metric;
mod pairs;
mod quasi_newton;
mod reference;
mod settings;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

pub use metric::Metric;
pub use quasi_newton::{Progress, QuasiNewton, minimize};
pub use reference::{ArgminBfgs, argmin_bfgs};
pub use settings::{RESOLUTION_F32, RESOLUTION_F64, Scaling, Settings};

/// A function to minimise: at a point, its value and its gradient. Values that are not finite are allowed; an error ends
/// the run.
pub type Objective<'a> = dyn FnMut(&[f64]) -> crate::Result<(f64, Vec<f64>)> + 'a;

/// A flag that whoever waits may raise; it is read once per evaluation.
pub type CancelFlag = Arc<AtomicBool>;

/// Whether the flag, if there is one, is up.
fn is_cancelled(flag: Option<&CancelFlag>) -> bool {
    flag.is_some_and(|flag| flag.load(Ordering::Relaxed))
}

/// Where a minimisation stands: the best point it accepted and why it stopped there.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The point, in the caller's coordinates.
    pub x: Vec<f64>,
    /// The objective there.
    pub f: f64,
    /// Its gradient there, in the caller's coordinates.
    pub gradient: Vec<f64>,
    /// How often the objective and its gradient were evaluated, together.
    pub evaluations: usize,
    /// How many search directions were followed.
    pub iterations: usize,
    /// Largest |component| of the step that the quasi-Newton model would take next, in the caller's units; NaN where
    /// no model stands behind it.
    pub proposed_step: f64,
    /// The decrease that the same model promises for that step, −g·d/2, in the units of f; NaN likewise.
    pub predicted_decrease: f64,
    /// Why it stopped.
    pub reason: StopReason,
}

impl Outcome {
    /// Nothing evaluated yet.
    fn at(start: &[f64]) -> Self {
        Outcome {
            x: start.to_vec(),
            f: f64::NAN,
            gradient: vec![f64::NAN; start.len()],
            evaluations: 0,
            iterations: 0,
            proposed_step: f64::NAN,
            predicted_decrease: f64::NAN,
            reason: StopReason::Unfinished,
        }
    }

    /// As [`Outcome::at`], in the memory that is there.
    fn restart_at(&mut self, start: &[f64]) {
        self.x.copy_from_slice(start);
        self.gradient.fill(f64::NAN);
        (self.f, self.proposed_step, self.predicted_decrease) = (f64::NAN, f64::NAN, f64::NAN);
        (self.evaluations, self.iterations) = (0, 0);
        self.reason = StopReason::Unfinished;
    }
}

/// Why a minimisation stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum StopReason {
    /// It has not stopped yet.
    Unfinished,
    /// The next step is too small to matter.
    StepBelowTolerance,
    /// The decrease that is left is too small to matter.
    DecrementBelowTolerance,
    /// The gradient's norm is below the tolerance (only [`ArgminBfgs`] asks this).
    GradientBelowTolerance,
    /// The last iteration changed the objective by less than the tolerance (only [`ArgminBfgs`] asks this).
    ChangeBelowTolerance,
    /// The decrease that is left drowns in the rounding of the objective.
    ResolutionReached,
    /// The allowance of evaluations is spent.
    EvaluationLimit,
    /// The objective or its gradient is not a number, at the start or however short the step.
    NotFinite,
    /// No step along a descent direction lowers the objective.
    NoDescent,
    /// The cancel flag went up.
    Cancelled,
    /// The time that was given is up.
    DeadlineReached,
}

impl StopReason {
    /// Whether the point is a minimum as far as the tolerances, or the arithmetic, can tell.
    pub fn converged(self) -> bool {
        matches!(
            self,
            StopReason::StepBelowTolerance
                | StopReason::DecrementBelowTolerance
                | StopReason::GradientBelowTolerance
                | StopReason::ChangeBelowTolerance
                | StopReason::ResolutionReached
        )
    }
}

impl std::fmt::Display for StopReason {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            StopReason::Unfinished => "not finished",
            StopReason::StepBelowTolerance => "converged: the next step is below the step tolerance",
            StopReason::DecrementBelowTolerance => "converged: the decrease left is below the tolerance",
            StopReason::GradientBelowTolerance => "converged: the norm of the gradient is below the tolerance",
            StopReason::ChangeBelowTolerance => "converged: the last change of the objective is below the tolerance",
            StopReason::ResolutionReached => "converged: the objective no longer resolves the decrease that is left",
            StopReason::EvaluationLimit => "stopped early: the limit of evaluations is reached",
            StopReason::NotFinite => "failed: the objective or its gradient is not a finite number",
            StopReason::NoDescent => "failed: no step along a descent direction lowers the objective",
            StopReason::Cancelled => "cancelled",
            StopReason::DeadlineReached => "stopped early: the deadline is reached",
        })
    }
}

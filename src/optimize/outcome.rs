//! Result of a minimisation.

/// State or result of a minimisation: the best accepted point, and why the run stopped.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// The point, in the caller's coordinates.
    pub x: Vec<f64>,
    /// Objective at that point.
    pub f: f64,
    /// Gradient at that point, in the caller's coordinates.
    pub gradient: Vec<f64>,
    /// Number of evaluations of objective and gradient.
    pub evaluations: usize,
    /// Number of search directions followed.
    pub iterations: usize,
    /// Largest |component| of the next step of the quasi-Newton model, in the caller's units; NaN
    /// without a model of the curvature.
    pub proposed_step: f64,
    /// Decrease that the model predicts for that step, −g·d/2, in the units of f; NaN without a
    /// model.
    pub predicted_decrease: f64,
    /// Why the run stopped.
    pub reason: StopReason,
}

impl Outcome {
    /// The state before the first evaluation.
    pub(super) fn at(start: &[f64]) -> Self {
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

    /// As [`Outcome::at`], without allocation.
    pub(super) fn restart_at(&mut self, start: &[f64]) {
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
    /// The run has not stopped yet.
    Unfinished,
    /// The next step is below the tolerance.
    StepBelowTolerance,
    /// The predicted decrease is below the tolerance.
    DecrementBelowTolerance,
    /// The gradient's norm is below the tolerance (only for [`super::ArgminBfgs`]).
    GradientBelowTolerance,
    /// The last iteration changed the objective by less than the tolerance (only for
    /// [`super::ArgminBfgs`]).
    ChangeBelowTolerance,
    /// The predicted decrease is below the rounding of the objective.
    ResolutionReached,
    /// The limit of evaluations is reached.
    EvaluationLimit,
    /// The objective or its gradient is not a number, at the start or however short the step.
    NotFinite,
    /// No step along a descent direction lowers the objective.
    NoDescent,
    /// The cancel flag was set.
    Cancelled,
    /// The deadline is reached.
    DeadlineReached,
}

impl StopReason {
    /// All of them.
    pub const ALL: [Self; 11] = [
        Self::Unfinished,
        Self::StepBelowTolerance,
        Self::DecrementBelowTolerance,
        Self::GradientBelowTolerance,
        Self::ChangeBelowTolerance,
        Self::ResolutionReached,
        Self::EvaluationLimit,
        Self::NotFinite,
        Self::NoDescent,
        Self::Cancelled,
        Self::DeadlineReached,
    ];

    /// Whether the point is a minimum within the tolerances or within rounding.
    pub fn has_converged(self) -> bool {
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

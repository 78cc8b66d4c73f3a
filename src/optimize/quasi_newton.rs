//! Limited-memory BFGS in whitened coordinates, with a reverse communication interface.

use super::line_search::{LineSearch, LineSearchDecision};
use super::metric::Metric;
use super::outcome::{Outcome, StopReason};
use super::pairs::{Pairs, dot, scale_by};
use super::problem::{check_start, is_cancelled};
use super::settings::{Scaling, Settings};
use crate::{Error, Result};
use std::sync::Arc;
use std::time::Instant;

/// Inverse curvature of J = Σ w r² in coordinates whitened by its Gauss-Newton matrix: the Hessian
/// is 2·I.
const WHITENED_INVERSE_CURVATURE: f64 = 0.5;

/// Whether the run continues.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[must_use]
pub enum Advance {
    /// Evaluate the objective at [`QuasiNewton::point`].
    Continue,
    /// The run has ended: see [`QuasiNewton::outcome`].
    Done,
}

/// What the point to evaluate is.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// The iterate itself: at the start, and when the objective has changed.
    Iterate,
    /// A point of the line search.
    Searching,
    /// None: the run has ended.
    Done,
}

/// L-BFGS with a reverse communication interface: evaluate the objective and its gradient at
/// [`point`](Self::point) and pass both to [`advance`](Self::advance), until that returns
/// [`Advance::Done`]. All arithmetic is f64 and depends on this problem only, so problems in
/// lock-step give bitwise the same results as one by one. Nothing is allocated after construction;
/// [`begin`](Self::begin) starts another problem of the same size in the same memory.
#[derive(Debug, Clone)]
pub struct QuasiNewton {
    metric: Arc<Metric>,
    /// Length scale of this problem relative to the metric.
    scale: f64,
    settings: Settings,
    /// The iterate, its objective and its gradient.
    outcome: Outcome,
    gradient_z: Vec<f64>,
    direction_z: Vec<f64>,
    direction_x: Vec<f64>,
    trial_x: Vec<f64>,
    trial_gradient_z: Vec<f64>,
    kept_f: f64,
    kept_gradient_x: Vec<f64>,
    kept_gradient_z: Vec<f64>,
    pairs: Pairs,
    search: LineSearch,
    phase: Phase,
    /// Whether the pairs were removed after a failed search; a second failure ends the run.
    memory_reset: bool,
}

impl QuasiNewton {
    /// An optimiser that starts at `start` and works in the coordinates of `metric`.
    ///
    /// # Errors
    /// [`Error::Shape`] if `start` does not have the metric's dimension; [`Error::Value`] for a
    /// start that is not finite or a setting out of range.
    pub fn new(metric: Arc<Metric>, start: &[f64], settings: Settings) -> Result<Self> {
        settings.check()?;
        check_start(start)?;
        metric.check_dimension(start)?;
        if let Some(weights) = settings.step_weights.as_ref().filter(|weights| weights.len() != start.len()) {
            let (given, needed) = (weights.len(), start.len());
            return Err(Error::Shape(format!("{given} step weights were given where {needed} are needed")));
        }
        // Metrics of one dimension may differ in rank: memory for the largest rank.
        let (n, rank) = (metric.dimension(), metric.rank());
        let zeros = || {
            let mut zeros = Vec::with_capacity(n);
            zeros.resize(rank, 0.0);
            zeros
        };
        let mut pairs = Pairs::new(n, settings.memory);
        pairs.restart(rank);
        Ok(QuasiNewton {
            outcome: Outcome::at(start),
            gradient_z: zeros(),
            direction_z: zeros(),
            direction_x: vec![0.0; n],
            trial_x: start.to_vec(),
            trial_gradient_z: zeros(),
            kept_f: f64::NAN,
            kept_gradient_x: vec![0.0; n],
            kept_gradient_z: zeros(),
            pairs,
            search: LineSearch::new(f64::NAN, f64::NAN, 0.0, 0.0, 0.0, false),
            phase: Phase::Iterate,
            memory_reset: false,
            metric,
            scale: 1.0,
            settings,
        })
    }

    /// The metric, in whose place another one is until the next problem.
    pub(crate) fn replace_metric(&mut self, other: &Arc<Metric>) -> Arc<Metric> {
        std::mem::replace(&mut self.metric, other.clone())
    }

    /// Starts another problem, from `start`, in the same memory. Its coordinates are those of
    /// `metric` with every length multiplied by `scale` (positive): for an objective with `scale`⁻²
    /// times the curvature of the metric's.
    ///
    /// # Errors
    /// As [`QuasiNewton::new`]; the optimiser is unchanged then.
    pub fn begin(&mut self, metric: &Arc<Metric>, scale: f64, start: &[f64]) -> Result<()> {
        if metric.dimension() != self.metric.dimension() {
            let (new, old) = (metric.dimension(), self.metric.dimension());
            return Err(Error::Shape(format!("a metric of {new} dimensions was given where {old} are needed")));
        }
        if !(scale > 0.0 && scale.is_finite()) {
            return Err(Error::Value(format!("the scale of the metric is {scale}, where a positive number is needed")));
        }
        check_start(start)?;
        metric.check_dimension(start)?;
        let rank = metric.rank();
        for z in [&mut self.gradient_z, &mut self.direction_z, &mut self.trial_gradient_z, &mut self.kept_gradient_z] {
            z.resize(rank, 0.0);
        }
        self.pairs.restart(rank);
        self.metric.clone_from(metric);
        self.scale = scale;
        self.outcome.restart_at(start);
        self.trial_x.copy_from_slice(start);
        self.search = LineSearch::new(f64::NAN, f64::NAN, 0.0, 0.0, 0.0, false);
        self.phase = Phase::Iterate;
        self.memory_reset = false;
        Ok(())
    }

    /// Changes the deadline.
    pub fn set_deadline(&mut self, deadline: Option<Instant>) {
        self.settings.deadline = deadline;
    }

    /// Changes the tolerances `step_tolerance` and `decrement_tolerance` of [`Settings`].
    ///
    /// # Errors
    /// [`Error::Value`] for a tolerance that is negative or not finite; both are unchanged then.
    pub fn set_tolerances(&mut self, step_tolerance: f64, decrement_tolerance: f64) -> Result<()> {
        let changed = Settings { step_tolerance, decrement_tolerance, ..Settings::default() };
        changed.check()?;
        (self.settings.step_tolerance, self.settings.decrement_tolerance) = (step_tolerance, decrement_tolerance);
        Ok(())
    }

    /// Writes the solution into `x`: the iterate, or, where the run stopped because the next step
    /// was too small to be worth an evaluation, the end of that step. The model predicts that step
    /// to a fraction of its length, so that the error is a fraction of the iterate's.
    pub fn write_solution(&self, x: &mut [f64]) {
        x.copy_from_slice(&self.outcome.x);
        if self.phase == Phase::Done && self.has_proposed_step() {
            x.iter_mut().zip(&self.direction_x).for_each(|(x, d)| *x += d);
        }
    }

    /// Whether the run stopped before a step that the model of the curvature predicts.
    fn has_proposed_step(&self) -> bool {
        let before_a_step =
            matches!(self.outcome.reason, StopReason::StepBelowTolerance | StopReason::DecrementBelowTolerance);
        before_a_step && self.outcome.proposed_step <= self.settings.max_step
    }

    /// The point to evaluate, in the caller's coordinates. After [`Advance::Done`]: the best point.
    pub fn point(&self) -> &[f64] {
        &self.trial_x
    }

    /// Processes the objective `f` and its gradient `gradient`, in the caller's coordinates, at
    /// [`point`](Self::point), and sets the next point. Values that are not finite are allowed.
    /// After [`Advance::Done`] it has no effect.
    ///
    /// # Panics
    /// If `gradient` is not as long as the starting point.
    pub fn advance(&mut self, f: f64, gradient: &[f64]) -> Advance {
        assert_eq!(gradient.len(), self.trial_x.len(), "length of the gradient");
        if self.phase == Phase::Done {
            return Advance::Done;
        }
        self.outcome.evaluations += 1;
        let finite = f.is_finite() && gradient.iter().all(|g| g.is_finite());
        let f = if finite { f } else { f64::NAN };
        self.metric.gradient_to_z(gradient, &mut self.trial_gradient_z);
        scale_by(&mut self.trial_gradient_z, self.scale);
        let stop = match self.phase {
            Phase::Iterate if finite => {
                self.adopt_trial(f, gradient);
                self.follow_new_direction()
            }
            Phase::Iterate => Some(StopReason::NotFinite),
            _ => self.search_step(f, gradient),
        };
        match stop.or_else(|| self.limit_reached()) {
            Some(reason) => self.finish(reason),
            None => Advance::Continue,
        }
    }

    /// The limit that forbids another evaluation, if one is reached: cancel flag, evaluations,
    /// deadline.
    fn limit_reached(&self) -> Option<StopReason> {
        if is_cancelled(self.settings.cancel.as_ref()) {
            Some(StopReason::Cancelled)
        } else if self.outcome.evaluations >= self.settings.max_evaluations {
            Some(StopReason::EvaluationLimit)
        } else if self.settings.deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            Some(StopReason::DeadlineReached)
        } else {
            None
        }
    }

    /// The iterate, and after [`Advance::Done`] the reason of the end.
    pub fn outcome(&self) -> &Outcome {
        &self.outcome
    }

    /// Continues after a small change of the objective (of its weights, for instance): keeps the
    /// curvature and starts from the best point, or, where the run stopped because the next step
    /// was too small, from the end of that step, which costs no additional evaluation. The
    /// evaluations are counted on; [`Advance::Done`] if a limit is reached.
    pub fn restart_objective(&mut self) -> Advance {
        if self.phase == Phase::Searching {
            self.adopt_kept();
        }
        if let Some(reason) = self.limit_reached() {
            return self.finish(reason);
        }
        if self.phase == Phase::Done && self.has_proposed_step() {
            self.set_trial(1.0);
        } else {
            self.trial_x.copy_from_slice(&self.outcome.x);
        }
        self.outcome.reason = StopReason::Unfinished;
        self.phase = Phase::Iterate;
        self.memory_reset = false;
        Advance::Continue
    }

    /// Processes a point of the line search; returns the reason if the run ends.
    fn search_step(&mut self, f: f64, gradient: &[f64]) -> Option<StopReason> {
        let slope = dot(&self.trial_gradient_z, &self.direction_z);
        match self.search.advance(f, slope) {
            LineSearchDecision::Try(alpha) => self.set_trial(alpha),
            LineSearchDecision::KeepAndTry(alpha) => {
                self.kept_f = f;
                self.kept_gradient_x.copy_from_slice(gradient);
                std::mem::swap(&mut self.kept_gradient_z, &mut self.trial_gradient_z);
                self.set_trial(alpha);
            }
            LineSearchDecision::Accept => {
                self.store_pair(self.search.alpha());
                self.adopt_trial(f, gradient);
                self.memory_reset = false;
                return self.follow_new_direction();
            }
            LineSearchDecision::AcceptKept => {
                self.adopt_kept();
                self.memory_reset = false;
                return self.follow_new_direction();
            }
            LineSearchDecision::AcceptUnresolved => {
                self.adopt_trial(f, gradient);
                return Some(StopReason::ResolutionReached);
            }
            LineSearchDecision::Unresolved => return Some(StopReason::ResolutionReached),
            LineSearchDecision::NotFinite => return Some(StopReason::NotFinite),
            LineSearchDecision::NoDescent => {
                // The pairs may be misleading: once, try the direction without them.
                if self.memory_reset || self.pairs.is_empty() {
                    return Some(StopReason::NoDescent);
                }
                self.pairs.clear();
                self.memory_reset = true;
                return self.follow_new_direction();
            }
        }
        None
    }

    /// Computes the direction from the iterate and sets its first point; returns the reason if the
    /// run ends.
    fn follow_new_direction(&mut self) -> Option<StopReason> {
        let mut slope = self.find_direction();
        // Pairs that overflow or do not give a descent direction are useless.
        if !self.pairs.is_empty() && (!slope.is_finite() || slope >= 0.0) {
            self.pairs.clear();
            slope = self.find_direction();
        }
        let step = self.direction_x.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
        if !(slope.is_finite() && step.is_finite()) {
            return Some(StopReason::NotFinite);
        }
        if slope >= 0.0 {
            // Without pairs the slope is zero only where the gradient is zero (or its square
            // underflows).
            return Some(StopReason::DecrementBelowTolerance);
        }
        let decrease = -0.5 * slope;
        let scale = self.outcome.f.abs();
        let noise = self.settings.resolution * scale + self.settings.resolution_floor;
        let modelled = self.metric.is_whitened() || !self.pairs.is_empty();
        if modelled {
            (self.outcome.proposed_step, self.outcome.predicted_decrease) = (step, decrease);
            let Settings { step_tolerance, decrement_tolerance, relative_decrement_tolerance, .. } = self.settings;
            if step < step_tolerance && self.step_rms() < step_tolerance {
                return Some(StopReason::StepBelowTolerance);
            }
            if decrease < decrement_tolerance || decrease < relative_decrement_tolerance * scale {
                return Some(StopReason::DecrementBelowTolerance);
            }
        } else {
            (self.outcome.proposed_step, self.outcome.predicted_decrease) = (f64::NAN, f64::NAN);
        }
        let longest = self.settings.max_step / step;
        let first = longest.min(1.0);
        self.search = LineSearch::new(self.outcome.f, slope, first, longest, noise, modelled && decrease < noise);
        self.outcome.iterations += 1;
        self.phase = Phase::Searching;
        self.set_trial(first);
        None
    }

    /// Root of the weighted sum of the squares of the proposed step's components; 0 without
    /// weights.
    fn step_rms(&self) -> f64 {
        let weights = self.settings.step_weights.iter().flat_map(|weights| weights.iter());
        weights.zip(&self.direction_x).map(|(weight, d)| weight * d * d).sum::<f64>().sqrt()
    }

    /// Sets the direction −H·g in both coordinates and returns the slope of the objective along it.
    fn find_direction(&mut self) -> f64 {
        let own = if self.metric.is_whitened() { Some(WHITENED_INVERSE_CURVATURE) } else { None };
        let measured = self.pairs.newest_inverse_curvature();
        let inverse_curvature = match self.settings.scaling {
            Scaling::Metric => own.or(measured),
            Scaling::Adaptive => measured.or(own),
        };
        let inverse_curvature = inverse_curvature.unwrap_or_else(|| {
            // Without any estimate of the curvature: a step of length one, which the line search
            // corrects.
            let norm = dot(&self.gradient_z, &self.gradient_z).sqrt();
            if norm > 0.0 { 1.0 / norm } else { 1.0 }
        });
        for (d, g) in self.direction_z.iter_mut().zip(&self.gradient_z) {
            *d = -g;
        }
        self.pairs.apply(inverse_curvature, &mut self.direction_z);
        self.metric.to_x(&self.direction_z, &mut self.direction_x);
        scale_by(&mut self.direction_x, self.scale);
        dot(&self.gradient_z, &self.direction_z)
    }

    fn set_trial(&mut self, alpha: f64) {
        for ((t, x), d) in self.trial_x.iter_mut().zip(&self.outcome.x).zip(&self.direction_x) {
            *t = x + alpha * d;
        }
    }

    /// Stores the pair of the step from the iterate to the trial point, `alpha` along the
    /// direction.
    fn store_pair(&mut self, alpha: f64) {
        self.pairs.push(alpha, &self.direction_z, &self.gradient_z, &self.trial_gradient_z);
    }

    /// Makes the trial point the iterate.
    fn adopt_trial(&mut self, f: f64, gradient: &[f64]) {
        self.outcome.f = f;
        self.outcome.x.copy_from_slice(&self.trial_x);
        self.outcome.gradient.copy_from_slice(gradient);
        std::mem::swap(&mut self.gradient_z, &mut self.trial_gradient_z);
    }

    /// Makes the point kept by the line search, if there is one, the iterate.
    fn adopt_kept(&mut self) {
        let Some(alpha) = self.search.kept_alpha() else { return };
        std::mem::swap(&mut self.trial_gradient_z, &mut self.kept_gradient_z);
        self.store_pair(alpha);
        std::mem::swap(&mut self.gradient_z, &mut self.trial_gradient_z);
        self.set_trial(alpha);
        self.outcome.x.copy_from_slice(&self.trial_x);
        self.outcome.f = self.kept_f;
        std::mem::swap(&mut self.outcome.gradient, &mut self.kept_gradient_x);
    }

    /// The outcome, without the optimiser.
    pub(super) fn into_outcome(self) -> Outcome {
        self.outcome
    }

    fn finish(&mut self, reason: StopReason) -> Advance {
        let early = matches!(reason, StopReason::Cancelled | StopReason::EvaluationLimit | StopReason::DeadlineReached);
        if self.phase == Phase::Searching && early {
            self.adopt_kept();
        }
        self.trial_x.copy_from_slice(&self.outcome.x);
        self.outcome.reason = reason;
        self.phase = Phase::Done;
        Advance::Done
    }
}

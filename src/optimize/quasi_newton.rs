//! Limited-memory BFGS in whitened coordinates, as a machine that asks for points and is told values.

use super::line_search::{LineSearch, Verdict};
use super::pairs::{Pairs, dot};
use super::settings::{Scaling, Settings};
use super::{Metric, Objective, Outcome, StopReason, is_cancelled};
use crate::{Error, Result};
use std::sync::Arc;
use std::time::Instant;

/// Inverse curvature of J = Σ w r² in coordinates whitened by its Gauss-Newton matrix: the Hessian is 2·I.
const WHITENED: f64 = 0.5;

/// Whether to go on asking.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[must_use]
pub enum Progress {
    /// Evaluate the point that [`QuasiNewton::ask`] now names.
    Continue,
    /// Read the [`Outcome`].
    Done,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// The iterate itself is to be evaluated: at the start, and when the objective has changed.
    Anchor,
    Searching,
    Done,
}

/// L-BFGS with an ask/tell interface: evaluate the objective and its gradient at [`ask`](Self::ask), hand both to
/// [`tell`](Self::tell), until it answers [`Progress::Done`]. All arithmetic is f64 and depends on this problem alone,
/// so a batch in lock-step gives bitwise what the problems give one by one. Nothing is allocated after construction,
/// and [`begin`](Self::begin) takes up another problem of the same size in the same memory.
#[derive(Debug, Clone)]
pub struct QuasiNewton {
    metric: Arc<Metric>,
    /// What is a step of length one in the metric is this long here.
    scale: f64,
    settings: Settings,
    /// The iterate and its gradient live here.
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
    /// A direction that failed was followed by one without memory; another failure is final.
    forgot: bool,
}

impl QuasiNewton {
    /// A machine that starts at `start` and moves in the coordinates of `metric`.
    ///
    /// # Errors
    /// [`Error::Shape`] if `start` does not have the metric's dimension; [`Error::Value`] for a start that is not
    /// finite or a setting out of range.
    pub fn new(metric: Arc<Metric>, start: &[f64], settings: Settings) -> Result<Self> {
        settings.check()?;
        check_start(start)?;
        check_dimension(start, &metric)?;
        if let Some(weights) = settings.step_weights.as_ref().filter(|weights| weights.len() != start.len()) {
            let (given, needed) = (weights.len(), start.len());
            return Err(Error::Shape(format!("{given} step weights were given where {needed} are needed")));
        }
        // Metrics of one size may differ in rank: room for the largest.
        let (n, rank) = (metric.dimension(), metric.rank());
        let room = || {
            let mut room = Vec::with_capacity(n);
            room.resize(rank, 0.0);
            room
        };
        let mut pairs = Pairs::new(n, settings.memory);
        pairs.restart(rank);
        Ok(QuasiNewton {
            outcome: Outcome::at(start),
            gradient_z: room(),
            direction_z: room(),
            direction_x: vec![0.0; n],
            trial_x: start.to_vec(),
            trial_gradient_z: room(),
            kept_f: f64::NAN,
            kept_gradient_x: vec![0.0; n],
            kept_gradient_z: room(),
            pairs,
            search: LineSearch::new(f64::NAN, f64::NAN, 0.0, 0.0, 0.0, false),
            phase: Phase::Anchor,
            forgot: false,
            metric,
            scale: 1.0,
            settings,
        })
    }

    /// Takes up another problem, from `start`, in the memory of the last. Its coordinates are those of `metric` with
    /// every length times `scale` (positive): an objective that is `scale`⁻² times as curved needs no metric of its own.
    ///
    /// # Errors
    /// As [`QuasiNewton::new`]; nothing has changed then.
    pub fn begin(&mut self, metric: &Arc<Metric>, scale: f64, start: &[f64]) -> Result<()> {
        if metric.dimension() != self.metric.dimension() {
            let (new, old) = (metric.dimension(), self.metric.dimension());
            return Err(Error::Shape(format!("a metric of {new} dimensions was given where {old} are needed")));
        }
        if !(scale > 0.0 && scale.is_finite()) {
            return Err(Error::Value(format!("the scale of the metric is {scale}, where a positive number is needed")));
        }
        check_start(start)?;
        check_dimension(start, metric)?;
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
        self.phase = Phase::Anchor;
        self.forgot = false;
        Ok(())
    }

    /// Changes when to stop wherever it stands.
    pub fn set_deadline(&mut self, deadline: Option<Instant>) {
        self.settings.deadline = deadline;
    }

    /// Changes how far it goes: `step_tolerance` and `decrement_tolerance` of [`Settings`].
    ///
    /// # Errors
    /// [`Error::Value`] for one that is negative or not finite; nothing has changed then.
    pub fn set_tolerances(&mut self, step_tolerance: f64, decrement_tolerance: f64) -> Result<()> {
        let changed = Settings { step_tolerance, decrement_tolerance, ..Settings::default() };
        changed.check()?;
        (self.settings.step_tolerance, self.settings.decrement_tolerance) = (step_tolerance, decrement_tolerance);
        Ok(())
    }

    /// Writes where it ends: the iterate, or, where it stopped because the next step was too small to be worth an
    /// evaluation, the end of that step. The metric and the pairs know that step to a fraction of its length, so that it
    /// leaves a fraction of the error that the iterate has.
    pub fn write_end(&self, x: &mut [f64]) {
        x.copy_from_slice(&self.outcome.x);
        if self.phase == Phase::Done && self.proposes() {
            x.iter_mut().zip(&self.direction_x).for_each(|(x, d)| *x += d);
        }
    }

    /// Whether it stopped before a step that a model stands behind.
    fn proposes(&self) -> bool {
        let before_a_step =
            matches!(self.outcome.reason, StopReason::StepBelowTolerance | StopReason::DecrementBelowTolerance);
        before_a_step && self.outcome.proposed_step <= self.settings.max_step
    }

    /// The point to evaluate, in the caller's coordinates. After [`Progress::Done`]: the best point.
    pub fn ask(&self) -> &[f64] {
        &self.trial_x
    }

    /// Takes the objective `f` and its gradient `gradient`, in the caller's coordinates, at [`ask`](Self::ask).
    /// Numbers that are not finite are part of the game. Told after [`Progress::Done`], it changes nothing.
    ///
    /// # Panics
    /// If `gradient` is not as long as the starting point.
    pub fn tell(&mut self, f: f64, gradient: &[f64]) -> Progress {
        assert_eq!(gradient.len(), self.trial_x.len(), "length of the gradient");
        if self.phase == Phase::Done {
            return Progress::Done;
        }
        self.outcome.evaluations += 1;
        let finite = f.is_finite() && gradient.iter().all(|g| g.is_finite());
        let f = if finite { f } else { f64::NAN };
        self.metric.gradient_to_z(gradient, &mut self.trial_gradient_z);
        scale_by(&mut self.trial_gradient_z, self.scale);
        let stop = match self.phase {
            Phase::Anchor if finite => {
                self.adopt_trial(f, gradient);
                self.follow_new_direction()
            }
            Phase::Anchor => Some(StopReason::NotFinite),
            _ => self.advance(f, gradient),
        };
        match stop.or_else(|| self.out_of_patience()) {
            Some(reason) => self.finish(reason),
            None => Progress::Continue,
        }
    }

    /// Why not to evaluate once more, whatever the objective does.
    fn out_of_patience(&self) -> Option<StopReason> {
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

    /// Where it stands: the iterate, and once [`Progress::Done`] the reason.
    pub fn outcome(&self) -> &Outcome {
        &self.outcome
    }

    /// The objective has changed a little (its weights, say): forgets its value, keeps the curvature, and goes on from
    /// the best point, or, where it stopped because the next step was too small to matter, from the end of that step,
    /// which costs nothing now. Evaluations go on counting; [`Progress::Done`] if none are left, or no time.
    pub fn restart_objective(&mut self) -> Progress {
        if self.phase == Phase::Searching {
            self.take_kept();
        }
        if let Some(reason) = self.out_of_patience() {
            return self.finish(reason);
        }
        if self.phase == Phase::Done && self.proposes() {
            self.set_trial(1.0);
        } else {
            self.trial_x.copy_from_slice(&self.outcome.x);
        }
        self.outcome.reason = StopReason::Unfinished;
        self.phase = Phase::Anchor;
        self.forgot = false;
        Progress::Continue
    }

    /// Hands the point just told to the line search and does what it says; the reason, if that is to stop.
    fn advance(&mut self, f: f64, gradient: &[f64]) -> Option<StopReason> {
        let slope = dot(&self.trial_gradient_z, &self.direction_z);
        match self.search.tell(f, slope) {
            Verdict::Try(alpha) => self.set_trial(alpha),
            Verdict::KeepAndTry(alpha) => {
                self.kept_f = f;
                self.kept_gradient_x.copy_from_slice(gradient);
                std::mem::swap(&mut self.kept_gradient_z, &mut self.trial_gradient_z);
                self.set_trial(alpha);
            }
            Verdict::Accept => {
                self.remember_pair(self.search.alpha());
                self.adopt_trial(f, gradient);
                self.forgot = false;
                return self.follow_new_direction();
            }
            Verdict::AcceptKept => {
                self.take_kept();
                self.forgot = false;
                return self.follow_new_direction();
            }
            Verdict::AcceptUnresolved => {
                self.adopt_trial(f, gradient);
                return Some(StopReason::ResolutionReached);
            }
            Verdict::Unresolved => return Some(StopReason::ResolutionReached),
            Verdict::NotFinite => return Some(StopReason::NotFinite),
            Verdict::NoDescent => {
                // The memory may be what misleads: once, try the direction that the metric alone gives.
                if self.forgot || self.pairs.is_empty() {
                    return Some(StopReason::NoDescent);
                }
                self.pairs.clear();
                self.forgot = true;
                return self.follow_new_direction();
            }
        }
        None
    }

    /// Finds the direction from the iterate and sets its first point; the reason, if there is nothing to follow.
    fn follow_new_direction(&mut self) -> Option<StopReason> {
        let mut slope = self.find_direction();
        // A memory that overflows or does not point down is worth nothing.
        if !self.pairs.is_empty() && (!slope.is_finite() || slope >= 0.0) {
            self.pairs.clear();
            slope = self.find_direction();
        }
        let step = self.direction_x.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
        if !(slope.is_finite() && step.is_finite()) {
            return Some(StopReason::NotFinite);
        }
        if slope >= 0.0 {
            // Without memory the slope is zero only where the gradient is (or where its square underflows).
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

    /// Root of the sum of the squares of the proposed step's components, each in its own weight; 0 without weights.
    fn step_rms(&self) -> f64 {
        let weights = self.settings.step_weights.iter().flat_map(|weights| weights.iter());
        weights.zip(&self.direction_x).map(|(weight, d)| weight * d * d).sum::<f64>().sqrt()
    }

    /// Sets the direction −H·g in both coordinates and returns the slope of the objective along it.
    fn find_direction(&mut self) -> f64 {
        let own = if self.metric.is_whitened() { Some(WHITENED) } else { None };
        let seen = self.pairs.newest_inverse_curvature();
        let inverse_curvature = match self.settings.scaling {
            Scaling::Metric => own.or(seen),
            Scaling::Adaptive => seen.or(own),
        };
        let inverse_curvature = inverse_curvature.unwrap_or_else(|| {
            // Where nothing is known of the curvature: a step of length one, from which the line search learns.
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

    /// Remembers the curvature between the iterate and the trial point, `alpha` along the direction.
    fn remember_pair(&mut self, alpha: f64) {
        self.pairs.push(alpha, &self.direction_z, &self.gradient_z, &self.trial_gradient_z);
    }

    /// The trial point becomes the iterate.
    fn adopt_trial(&mut self, f: f64, gradient: &[f64]) {
        self.outcome.f = f;
        self.outcome.x.copy_from_slice(&self.trial_x);
        self.outcome.gradient.copy_from_slice(gradient);
        std::mem::swap(&mut self.gradient_z, &mut self.trial_gradient_z);
    }

    /// The point that the line search kept, if it kept one, becomes the iterate.
    fn take_kept(&mut self) {
        let Some(alpha) = self.search.kept_alpha() else { return };
        std::mem::swap(&mut self.trial_gradient_z, &mut self.kept_gradient_z);
        self.remember_pair(alpha);
        std::mem::swap(&mut self.gradient_z, &mut self.trial_gradient_z);
        self.set_trial(alpha);
        self.outcome.x.copy_from_slice(&self.trial_x);
        self.outcome.f = self.kept_f;
        std::mem::swap(&mut self.outcome.gradient, &mut self.kept_gradient_x);
    }

    fn finish(&mut self, reason: StopReason) -> Progress {
        let early = matches!(reason, StopReason::Cancelled | StopReason::EvaluationLimit | StopReason::DeadlineReached);
        if self.phase == Phase::Searching && early {
            self.take_kept();
        }
        self.trial_x.copy_from_slice(&self.outcome.x);
        self.outcome.reason = reason;
        self.phase = Phase::Done;
        Progress::Done
    }
}

fn scale_by(vector: &mut [f64], scale: f64) {
    vector.iter_mut().for_each(|component| *component *= scale);
}

/// # Errors
/// [`Error::Shape`] for a start of another dimension.
fn check_dimension(start: &[f64], metric: &Metric) -> Result<()> {
    let (given, wanted) = (start.len(), metric.dimension());
    if given != wanted {
        let text = format!("the starting point has {given} components, where the metric has {wanted}");
        return Err(Error::Shape(text));
    }
    Ok(())
}

/// # Errors
/// [`Error::Value`] for the first component that is not finite.
pub(super) fn check_start(start: &[f64]) -> Result<()> {
    match start.iter().position(|x| !x.is_finite()) {
        Some(k) => {
            Err(Error::Value(format!("component {k} of the starting point is {}, not a finite number", start[k])))
        }
        None => Ok(()),
    }
}

/// Minimises `problem`, which gives the objective and its gradient at a point, from `start`.
///
/// # Errors
/// Those of [`QuasiNewton::new`], those of `problem`, and [`Error::Shape`] for a gradient of another length.
pub fn minimize(problem: &mut Objective, metric: Arc<Metric>, start: &[f64], settings: Settings) -> Result<Outcome> {
    let mut optimizer = QuasiNewton::new(metric, start, settings)?;
    loop {
        let (f, gradient) = problem(optimizer.ask())?;
        check_gradient(&gradient, start.len())?;
        if optimizer.tell(f, &gradient) == Progress::Done {
            return Ok(optimizer.outcome);
        }
    }
}

/// # Errors
/// [`Error::Shape`] for a gradient that is not `n` long.
pub(super) fn check_gradient(gradient: &[f64], n: usize) -> Result<()> {
    if gradient.len() == n {
        return Ok(());
    }
    Err(Error::Shape(format!("the gradient has {} components, where the point has {n}", gradient.len())))
}

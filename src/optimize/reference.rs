//! The reference: full-memory BFGS of the `argmin` crate with a Moré-Thuente line search, in the
//! caller's own coordinates. It keeps a dense inverse Hessian, allocates at each step and does not
//! check the curvature: a reference for comparisons, not a fast method.

use super::outcome::{Outcome, StopReason};
use super::problem::{Objective, check_gradient, check_start, is_cancelled};
use crate::control::CancelFlag;
use crate::{Error, Result};
use argmin::core::{CostFunction, Executor, Gradient};
use argmin::solver::linesearch::MoreThuenteLineSearch;
use argmin::solver::quasinewton::BFGS;
use std::cell::RefCell;

/// Settings of the reference optimiser.
#[derive(Debug, Clone)]
pub struct ArgminBfgs {
    /// Stop when the Euclidean norm of the gradient is below this. It has the units of the
    /// objective per unit of x.
    pub gradient_tolerance: f64,
    /// Stop when an iteration changes the objective by less than this, in its units.
    pub cost_tolerance: f64,
    /// The inverse Hessian starts as this times the identity.
    pub initial_scale: f64,
    /// Evaluations of objective and gradient together; at least 1.
    pub max_evaluations: usize,
    /// Read once per evaluation.
    pub cancel: Option<CancelFlag>,
}

impl ArgminBfgs {
    /// Minimises `problem`, which returns the objective and its gradient at a point, from `start`.
    /// A failed line search and a value that is not finite end the run with a [`StopReason`] and
    /// the best point found.
    ///
    /// # Errors
    /// [`Error::Value`] for a start that is not finite or a setting out of range, [`Error::Shape`]
    /// for a gradient that is not as long as `start`, and those of `problem`.
    pub fn minimize(&self, problem: &mut Objective, start: &[f64]) -> Result<Outcome> {
        self.check(start)?;
        let log = RefCell::new(EvaluationLog {
            problem,
            cancel: self.cancel.as_ref(),
            max_evaluations: self.max_evaluations,
            last: None,
            best: Outcome::at(start),
            stop: None,
        });
        let run = self.run(&log, start);
        let EvaluationLog { mut best, stop, .. } = log.into_inner();
        best.reason = match (stop, run) {
            (Some(Interruption::Failure(error)), _) => return Err(error),
            (Some(Interruption::Reason(reason)), _) => reason,
            (None, Ok((iterations, reason))) => {
                best.iterations = iterations;
                reason
            }
            (None, Err(_)) => StopReason::NoDescent,
        };
        Ok(best)
    }

    fn check(&self, start: &[f64]) -> Result<()> {
        for (name, value) in [("gradient_tolerance", self.gradient_tolerance), ("cost_tolerance", self.cost_tolerance)]
        {
            if !(value >= 0.0 && value.is_finite()) {
                return Err(Error::Value(format!("{name} is {value}, where a finite number of 0 or more is needed")));
            }
        }
        if !(self.initial_scale > 0.0 && self.initial_scale.is_finite()) {
            return Err(Error::Value(format!(
                "initial_scale is {}, where a finite positive number is needed",
                self.initial_scale
            )));
        }
        if self.max_evaluations == 0 {
            return Err(Error::Value("max_evaluations is 0, where 1 or more is needed".into()));
        }
        if start.is_empty() {
            return Err(Error::Shape("the starting point has 0 components, where 1 or more is needed".into()));
        }
        check_start(start)
    }

    /// Runs argmin; returns its number of iterations and the tolerance that was met.
    fn run(
        &self,
        log: &RefCell<EvaluationLog>,
        start: &[f64],
    ) -> std::result::Result<(usize, StopReason), argmin::core::Error> {
        let solver = BFGS::new(MoreThuenteLineSearch::<Vec<f64>, Vec<f64>, f64>::new())
            .with_tolerance_grad(self.gradient_tolerance)?
            .with_tolerance_cost(self.cost_tolerance)?;
        let n = start.len();
        let inverse_hessian: Vec<Vec<f64>> =
            (0..n).map(|i| (0..n).map(|j| if i == j { self.initial_scale } else { 0.0 }).collect()).collect();
        let result = Executor::new(Problem(log), solver)
            .configure(|state| state.param(start.to_vec()).inv_hessian(inverse_hessian))
            .timer(false)
            .run()?;
        let state = result.state();
        // The log keeps the gradient of the best point; argmin decides by that of the last point.
        let norm = state.grad.as_ref().map_or(f64::NAN, |g| g.iter().map(|g| g * g).sum::<f64>().sqrt());
        let met = norm < self.gradient_tolerance;
        let reason = if met { StopReason::GradientBelowTolerance } else { StopReason::ChangeBelowTolerance };
        Ok((state.iter as usize, reason))
    }
}

/// Why the run was interrupted inside an evaluation.
enum Interruption {
    Reason(StopReason),
    Failure(Error),
}

/// The evaluations so far. The state of argmin is lost where its line search fails.
struct EvaluationLog<'a> {
    problem: &'a mut Objective<'a>,
    cancel: Option<&'a CancelFlag>,
    max_evaluations: usize,
    /// The last point, its value and gradient: argmin requests value and gradient separately.
    last: Option<(Vec<f64>, f64, Vec<f64>)>,
    /// The lowest point so far, and the count of evaluations.
    best: Outcome,
    stop: Option<Interruption>,
}

impl EvaluationLog<'_> {
    /// The evaluation at `x`, without repeating the last one; `None` once the run is interrupted.
    fn evaluate_once(&mut self, x: &[f64]) -> Option<&(Vec<f64>, f64, Vec<f64>)> {
        if self.stop.is_none() && !self.last.as_ref().is_some_and(|(at, ..)| at == x) {
            match self.evaluate(x) {
                Ok((f, gradient)) => self.last = Some((x.to_vec(), f, gradient)),
                Err(stop) => self.stop = Some(stop),
            }
        }
        if self.stop.is_some() { None } else { self.last.as_ref() }
    }

    fn evaluate(&mut self, x: &[f64]) -> std::result::Result<(f64, Vec<f64>), Interruption> {
        if is_cancelled(self.cancel) {
            return Err(Interruption::Reason(StopReason::Cancelled));
        }
        if self.best.evaluations >= self.max_evaluations {
            return Err(Interruption::Reason(StopReason::EvaluationLimit));
        }
        // The line search failed to interpolate: not a point to evaluate.
        if x.iter().any(|x| !x.is_finite()) {
            return Err(Interruption::Reason(StopReason::NotFinite));
        }
        let (f, gradient) = (self.problem)(x).map_err(Interruption::Failure)?;
        check_gradient(&gradient, x.len()).map_err(Interruption::Failure)?;
        self.best.evaluations += 1;
        if !f.is_finite() || gradient.iter().any(|g| !g.is_finite()) {
            return Err(Interruption::Reason(StopReason::NotFinite));
        }
        if self.best.f.is_nan() || f < self.best.f {
            self.best.f = f;
            self.best.x.copy_from_slice(x);
            self.best.gradient.copy_from_slice(&gradient);
        }
        Ok((f, gradient))
    }
}

/// Handle of the log that argmin can own.
struct Problem<'l, 'a>(&'l RefCell<EvaluationLog<'a>>);

impl Problem<'_, '_> {
    fn read<T>(
        &self,
        x: &[f64],
        part: impl Fn(&(Vec<f64>, f64, Vec<f64>)) -> T,
    ) -> std::result::Result<T, argmin::core::Error> {
        // The log has the reason; argmin only has to stop.
        self.0.borrow_mut().evaluate_once(x).map(part).ok_or_else(|| argmin::core::Error::msg("interrupted"))
    }
}

impl CostFunction for Problem<'_, '_> {
    type Param = Vec<f64>;
    type Output = f64;

    fn cost(&self, x: &Vec<f64>) -> std::result::Result<f64, argmin::core::Error> {
        self.read(x, |(_, f, _)| *f)
    }
}

impl Gradient for Problem<'_, '_> {
    type Param = Vec<f64>;
    type Gradient = Vec<f64>;

    fn gradient(&self, x: &Vec<f64>) -> std::result::Result<Vec<f64>, argmin::core::Error> {
        self.read(x, |(_, _, gradient)| gradient.clone())
    }
}

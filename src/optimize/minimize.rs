//! A complete minimisation of a closure with [`QuasiNewton`].

use super::metric::Metric;
use super::outcome::Outcome;
use super::problem::{Objective, check_gradient};
use super::quasi_newton::{Advance, QuasiNewton};
use super::settings::Settings;
use crate::Result;
use std::sync::Arc;

/// Minimises `problem`, which returns the objective and its gradient at a point, from `start`.
///
/// # Errors
/// Those of [`QuasiNewton::new`], those of `problem`, and [`Error::Shape`](crate::Error::Shape) for
/// a gradient of another length.
pub fn minimize(problem: &mut Objective, metric: Arc<Metric>, start: &[f64], settings: Settings) -> Result<Outcome> {
    let mut optimizer = QuasiNewton::new(metric, start, settings)?;
    loop {
        let (f, gradient) = problem(optimizer.point())?;
        check_gradient(&gradient, start.len())?;
        if optimizer.advance(f, &gradient) == Advance::Done {
            return Ok(optimizer.into_outcome());
        }
    }
}

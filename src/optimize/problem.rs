//! The function to minimise, and checks of points, gradients and the cancel flag.

use crate::control::CancelFlag;
use crate::{Error, Result};
use std::sync::atomic::Ordering;

/// A function to minimise: returns its value and its gradient at a point. Values that are not
/// finite are allowed; an error ends the run.
pub type Objective<'a> = dyn FnMut(&[f64]) -> Result<(f64, Vec<f64>)> + 'a;

/// Whether there is a flag and it is set.
pub(crate) fn is_cancelled(flag: Option<&CancelFlag>) -> bool {
    flag.is_some_and(|flag| flag.load(Ordering::Relaxed))
}

/// Checks that a starting point is finite.
///
/// # Errors
/// [`Error::Value`] for the first component that is not finite.
pub(super) fn check_start(start: &[f64]) -> Result<()> {
    match start.iter().position(|x| !x.is_finite()) {
        Some(k) => {
            Err(Error::Value(format!("component {k} of the starting point is {}: a finite number is needed", start[k])))
        }
        None => Ok(()),
    }
}

/// Checks the length of a gradient.
///
/// # Errors
/// [`Error::Shape`] for a gradient that is not `n` long.
pub(super) fn check_gradient(gradient: &[f64], n: usize) -> Result<()> {
    if gradient.len() == n {
        return Ok(());
    }
    Err(Error::Shape(format!(
        "the gradient has {} components, and the point {n}: the same number is needed",
        gradient.len()
    )))
}

//! When a quasi-Newton run stops, and how far it trusts its model.

use super::CancelFlag;
use crate::{Error, Result};
use std::sync::Arc;
use std::time::Instant;

/// [`Settings::resolution`] of a sum of about a million terms in f64, accumulated in blocks: some 50 roundings.
pub const RESOLUTION_F64: f64 = 1e-14;
/// [`Settings::resolution`] of a sum of squares whose terms come from f32 transforms: some 10 roundings.
pub const RESOLUTION_F32: f64 = 1e-6;

/// What stands in for the Hessian in directions that no pair has explored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scaling {
    /// The metric's own: 2·I in whitened coordinates. Falls back on [`Adaptive`](Self::Adaptive) where the metric is
    /// the identity.
    Metric,
    /// s·y / y·y of the newest pair. Far from the matrix's own point it learns sooner: on a small phase retrieval
    /// 6.8 / 11.5 / 18.4 evaluations from 0.3 / 0.6 / 1.2 rad RMS, against 6.7 / 12.1 / 22.4 (`tests/optimize.rs`).
    #[default]
    Adaptive,
}

/// When to stop, and how far to trust the model.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Evaluations of objective and gradient, in all, over restarts too; at least 1.
    pub max_evaluations: usize,
    /// Stop when the largest |component| of the proposed step, in the caller's units, is below this, and its RMS by
    /// [`step_weights`](Self::step_weights) too; 0 turns it off.
    pub step_tolerance: f64,
    /// Weight of the square of each component in the RMS of a step, 0 or more: many small components add up. Without
    /// weights the largest component decides alone.
    pub step_weights: Option<Arc<[f64]>>,
    /// Stop when the predicted decrease −g·d/2 (half the squared Newton decrement) is below this, in the units of
    /// the objective; 0 turns it off. For a χ² one unit is one standard deviation along one direction. The prediction
    /// is the model's: good in whitened coordinates, but off by factors of ten where the metric is the identity.
    pub decrement_tolerance: f64,
    /// The same, as a fraction of |f|; 0 turns it off.
    pub relative_decrement_tolerance: f64,
    /// Pairs that L-BFGS remembers; 0 is steepest descent in whitened coordinates.
    pub memory: usize,
    /// Smallest change of the objective that means something, as a fraction of |f|: [`RESOLUTION_F64`],
    /// [`RESOLUTION_F32`].
    pub resolution: f64,
    /// The same as a number in the units of the objective, added to the former: for objectives that fall to zero.
    pub resolution_floor: f64,
    /// Largest |component|, in the caller's units, of the displacement from one accepted point to any point evaluated
    /// on the way to the next; infinite for no bound.
    pub max_step: f64,
    /// The Hessian in unexplored directions.
    pub scaling: Scaling,
    /// Read once per evaluation.
    pub cancel: Option<CancelFlag>,
    /// When to stop wherever it stands; read once per evaluation.
    pub deadline: Option<Instant>,
}

impl Default for Settings {
    fn default() -> Self {
        Settings {
            max_evaluations: 200,
            step_tolerance: 0.0,
            step_weights: None,
            decrement_tolerance: 0.0,
            relative_decrement_tolerance: 1e-10,
            memory: 20,
            resolution: RESOLUTION_F64,
            resolution_floor: 0.0,
            max_step: f64::INFINITY,
            scaling: Scaling::default(),
            cancel: None,
            deadline: None,
        }
    }
}

impl Settings {
    /// # Errors
    /// [`Error::Value`] for the first setting out of range.
    pub(super) fn check(&self) -> Result<()> {
        if self.max_evaluations == 0 {
            return Err(Error::Value("max_evaluations is 0, where 1 or more is needed".into()));
        }
        let non_negative = [
            ("step_tolerance", self.step_tolerance),
            ("decrement_tolerance", self.decrement_tolerance),
            ("relative_decrement_tolerance", self.relative_decrement_tolerance),
            ("resolution", self.resolution),
            ("resolution_floor", self.resolution_floor),
        ];
        if let Some((name, value)) = non_negative.iter().find(|(_, v)| !(*v >= 0.0 && v.is_finite())) {
            return Err(Error::Value(format!("{name} is {value}, where a finite number of 0 or more is needed")));
        }
        let weights = self.step_weights.iter().flat_map(|weights| weights.iter());
        if let Some(weight) = weights.copied().find(|weight| !(*weight >= 0.0 && weight.is_finite())) {
            return Err(Error::Value(format!(
                "a step weight is {weight}, where a finite number of 0 or more is needed"
            )));
        }
        if self.max_step.is_nan() || self.max_step <= 0.0 {
            return Err(Error::Value(format!("max_step is {}, where a positive number is needed", self.max_step)));
        }
        Ok(())
    }
}

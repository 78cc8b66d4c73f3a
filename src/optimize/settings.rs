//! Settings of the quasi-Newton optimiser: tolerances, limits, and scaling of the model.

use crate::control::CancelFlag;
use crate::{Error, Result};
use std::sync::Arc;
use std::time::Instant;

/// [`Settings::resolution`] of a sum of about a million terms in f64, accumulated in blocks: some
/// 50 roundings.
pub const RESOLUTION_F64: f64 = 1e-14;
/// [`Settings::resolution`] of a sum of squares whose terms come from f32 transforms: some 10
/// roundings.
pub const RESOLUTION_F32: f64 = 1e-6;

/// Initial inverse Hessian, used in directions that no pair has explored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scaling {
    /// That of the metric: a Hessian of 2·I in whitened coordinates. With the identity as metric,
    /// as [`Adaptive`](Self::Adaptive).
    Metric,
    /// s·y / y·y of the newest pair. Far from the point of linearisation it converges faster: in a
    /// small phase retrieval 6.8 / 11.5 / 18.4 evaluations from 0.3 / 0.6 / 1.2 rad RMS, against
    /// 6.7 / 12.1 / 22.4 (`tests/optimize.rs`).
    #[default]
    Adaptive,
}

/// Settings of [`super::QuasiNewton`].
#[derive(Debug, Clone)]
pub struct Settings {
    /// Largest number of evaluations of objective and gradient, restarts included; at least 1.
    pub max_evaluations: usize,
    /// Stop when the largest |component| of the proposed step, in the caller's units, and its RMS
    /// with [`step_weights`](Self::step_weights) are below this; 0 disables the test.
    pub step_tolerance: f64,
    /// Weight of the square of each component in the RMS of a step, 0 or more; `None` tests the
    /// largest component only.
    pub step_weights: Option<Arc<[f64]>>,
    /// Stop when the predicted decrease −g·d/2 (half the squared Newton decrement) is below this,
    /// in the units of the objective; 0 disables the test. For a χ², 1 is one standard deviation
    /// along one direction. The prediction is accurate in whitened coordinates, but may be wrong by
    /// factors of ten with the identity as metric.
    pub decrement_tolerance: f64,
    /// The same, as a fraction of |f|; 0 disables the test.
    pub relative_decrement_tolerance: f64,
    /// Number of pairs of L-BFGS; 0 is steepest descent in whitened coordinates.
    pub memory: usize,
    /// Smallest significant change of the objective, as a fraction of |f|: [`RESOLUTION_F64`],
    /// [`RESOLUTION_F32`].
    pub resolution: f64,
    /// The same in the units of the objective, added to the former: for objectives whose minimum is
    /// 0.
    pub resolution_floor: f64,
    /// Largest |component|, in the caller's units, of the displacement from an accepted point to
    /// any point evaluated in the search for the next; infinite for no bound.
    pub max_step: f64,
    /// Initial inverse Hessian.
    pub scaling: Scaling,
    /// Read once per evaluation.
    pub cancel: Option<CancelFlag>,
    /// Deadline of the run; checked once per evaluation.
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
    /// Checks the settings.
    ///
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

//! Planner: the cheapest model of a scene whose error stays within a budget, with the cost of each
//! choice in nm and in time.
//!
//! A plan is a scene: [`Plan::scene`] is the given scene with the choices written in as keys, so
//! that it can be read, stored, and given to any estimator. A choice changes how the result is
//! computed, and not which modes are estimated: `[modes]` stays as it is. The drawn wavefronts
//! cannot select a basis, because they have only the aberrations that the scene foresees; modes for
//! others are why an estimate has Zernikes with a prior.
//!
//! Wavefronts are drawn from the scene's own `[aberrations]`, imaged without noise by the simulator
//! on its fine pupil, and estimated by each candidate: the residual is the candidate's own error on
//! this scene. The error from noise is the Cramér-Rao bound of the candidate's pixels.

mod channels;
mod omission;
mod plan;
mod price;
mod search;
mod trial;

pub use omission::Omission;
pub use plan::{Plan, TriedValue};
pub use price::Price;

use crate::control::{Control, Stage};
use crate::scene::Scene;
use crate::{Error, Result};

/// Finds the cheapest model of `scene` whose error stays within `budget_nm`: RMS over the pupil, of
/// the phasing and of the NCPA each, model and noise together, tip and tilt removed. Where noise
/// alone is larger than that, the model that adds no more than a tenth to it. For a scene with
/// channels it is the error of their joint estimate.
///
/// # Errors
/// [`Error::Value`] for a budget that is not positive, [`Error::Scene`] for a scene whose images
/// cannot be simulated or whose recipe is the paper's, [`Error::Interrupted`] where `control` was
/// cancelled, and those of the estimator.
pub fn plan(scene: &Scene, budget_nm: f64, control: &Control) -> Result<Plan> {
    if !(budget_nm.is_finite() && budget_nm > 0.0) {
        return Err(Error::Value(format!("a budget of {budget_nm} nm is not accepted: a positive number is needed")));
    }
    control.enter(Stage::Planning, 0);
    // The fits of a trial are no steps of the plan.
    let control = &control.silent();
    // The plan has no budget: a scene with one would be planned again.
    let given = scene.changed(|sections| sections.estimate.budget_nm = None)?;
    let found = if given.channels().is_empty() {
        search::PlanSearch::new(&given, budget_nm, control)?.run()?
    } else {
        channels::plan(&given, budget_nm, control)?
    };
    Plan::new(&given, budget_nm, found)
}

/// `scene`, or its plan where it names a budget (`estimate.budget_nm`).
///
/// # Errors
/// As [`plan`].
pub fn resolve(scene: &Scene, control: &Control) -> Result<Scene> {
    match scene.estimate.budget_nm {
        Some(budget_nm) => Ok(plan(scene, budget_nm, control)?.scene),
        None => Ok(scene.clone()),
    }
}

//! Which model a scene needs: the cheapest that keeps the error within a budget, what each choice costs in nm and in
//! time, and what is left out.
//!
//! A plan is a scene: [`Plan::scene`] is the one that was asked about with the choices written in as keys, so that it
//! can be read, kept, and given to any estimator. A choice changes how the answer is computed and not what was asked:
//! keys that name modes stay as they are.
//!
//! Nothing here rests on a table. Wavefronts are drawn from the scene's own `[aberrations]`, imaged without noise by the
//! simulator on its fine pupil, and read by each candidate: what is left is the candidate's own error on this scene.
//! Noise adds what the Fisher information of the candidate's pixels leaves (the Cramér-Rao bound).

mod omission;
mod plan;
mod price;
mod trial;
mod walk;

pub use omission::Omission;
pub use plan::{Choice, Plan};
pub use price::Price;

use crate::optimize::CancelFlag;
use crate::scene::Scene;
use crate::{Error, Result};

/// Finds the cheapest model of `scene` whose error stays within `budget_nm`: RMS over the pupil, of the phasing and of
/// the NCPA each, model and noise together, tip and tilt removed. Where noise alone is larger than that, the model that
/// adds no more than a tenth to it.
///
/// # Errors
/// [`Error::Value`] for a budget that is not positive, [`Error::Scene`] for a scene whose images cannot be simulated or
/// whose recipe is the paper's, [`Error::Interrupted`] where `cancel` went up, and those of the estimator.
pub fn plan(scene: &Scene, budget_nm: f64, cancel: Option<&CancelFlag>) -> Result<Plan> {
    if !(budget_nm.is_finite() && budget_nm > 0.0) {
        return Err(Error::Value(format!("a budget of {budget_nm} nm is not accepted: a positive number is needed")));
    }
    // The plan is the answer to the budget: a scene that still had it would be planned again.
    let asked = scene.without("estimate.budget_nm")?;
    walk::Walk::new(&asked, budget_nm, cancel)?.run()
}

/// `scene`, or its plan where it names a budget (`estimate.budget_nm`).
///
/// # Errors
/// As [`plan`].
pub fn resolved(scene: &Scene, cancel: Option<&CancelFlag>) -> Result<Scene> {
    match scene.estimate.budget_nm {
        Some(budget_nm) => Ok(plan(scene, budget_nm, cancel)?.scene),
        None => Ok(scene.clone()),
    }
}

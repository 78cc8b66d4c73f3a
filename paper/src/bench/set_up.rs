//! A model, set up on the draws and not timed yet.

use super::grid::ModelPlan;
use super::reference::Reference;
use crate::experiment::{Case, Draw, Progress};
use cophase::Result;
use cophase::scene::Scene;
use std::time::Instant;

/// A model with what is known of it before it is timed.
pub(super) struct SetUp {
    pub(super) case: Case,
    /// s.
    pub(super) seconds: f64,
    /// Cramér-Rao bound of the first draw: segment errors and NCPA, nm.
    pub(super) bound_nm: [f64; 2],
    /// What the f64 CPU chain finds.
    pub(super) reference: Reference,
}

impl SetUp {
    pub(super) fn new(model: &ModelPlan, scene: &Scene, draws: &[Draw], progress: &Progress) -> Result<Self> {
        progress.check()?;
        let scene = model.scene(scene, progress.control())?;
        let started = Instant::now();
        let case = Case::new(&scene)?;
        let seconds = started.elapsed().as_secs_f64();
        let reference = Reference::new(&case, draws)?;
        let bound_nm = match &reference.coefficients_nm[0] {
            Some(found) => {
                let bound = case.bound_at(found, &draws[0])?;
                [bound.phasing_nm, bound.ncpa_nm]
            }
            None => [f64::NAN; 2],
        };
        Ok(Self { case, seconds, bound_nm, reference })
    }
}

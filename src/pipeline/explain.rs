//! Cause of a residual that the model does not explain, and a larger model that explains it.

use super::image_changes::{CHANGING, image_changes};
use super::misfit;
use super::modal_task::{Fitted, ModalTask};
use super::model_selection;
use crate::Result;
use crate::scene::Scene;
use std::time::Instant;

/// Looks for the cause of the residual of `fitted`, and for a larger model that explains the images: they are then fitted by that.
///
/// # Errors
/// Those of the fits, and [`crate::Error::Interrupted`].
pub(super) fn explain(task: &ModalTask, fitted: &mut Fitted) -> Result<()> {
    // Only a misfit asks for a cause.
    if fitted.is_explained() {
        return Ok(());
    }
    let started = Instant::now();
    fitted.changes = image_changes(task.scene, task.images);
    let found = &fitted.fit;
    let Some(&image) = found.1.used_images.first().filter(|_| fitted.changes.is_none_or(|chi2| chi2 < CHANGING)) else {
        return Ok(());
    };
    task.control.check("the images were fitted, the cause of a residual was not sought")?;
    let diversity = found.0.diversity_projection()?;
    let case = misfit::Case { task: *task, image, model: found.0.model(), diversity: &diversity };
    fitted.cause = case.likely_cause(&found.1)?;
    if fitted.cause.is_none() && model_selection::may_extend(task.scene, task.policy) {
        let mut one = |scene: &Scene| task.fit_one(scene, image);
        fitted.selected = model_selection::select(task.scene, task.control, &fitted.fit, image, &mut one)?;
    }
    let mut fit_seconds = 0.0;
    if let Some(selected) = &fitted.selected {
        fitted.fit = task.fit_by(&selected.scene)?;
        fit_seconds = fitted.fit.1.seconds;
    }
    fitted.model_seconds += started.elapsed().as_secs_f64() - fit_seconds;
    Ok(())
}

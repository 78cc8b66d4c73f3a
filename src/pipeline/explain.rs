//! Cause of a residual that the model does not explain, and a larger model that explains it.

use super::image_changes::{CHANGING, image_changes};
use super::misfit;
use super::modal_task::{Fitted, ModalTask};
use super::model_selection::{self, FitOne, Selected};
use super::policy::Policy;
use crate::Result;
use crate::modal::{ModalEstimate, ModalFit, Status};
use std::time::Instant;

/// Reduced χ² of the mean residual of several images above which the model is wrong, as for one
/// image.
const MEAN_RESIDUAL_MISFIT: f64 = 2.0;

/// Whether the mean of `images` images, whose residual has this reduced χ², is not explained.
pub(super) fn is_mean_misfit(images: usize, mean_residual_chi2: f64) -> bool {
    images > 1 && mean_residual_chi2 > MEAN_RESIDUAL_MISFIT
}

/// Looks for the cause of the residual of `fitted`, and for a larger model that explains the
/// images: they are then fitted by that.
///
/// # Errors
/// Those of the fits, and [`crate::Error::Interrupted`].
pub(super) fn explain(task: &ModalTask, fitted: &mut Fitted) -> Result<()> {
    // Only a misfit asks for a cause: by the modes, because a larger model fits what is large
    // better than one linear step.
    let found = &fitted.fit.1;
    let is_ok = |&image: &usize| found.report_by_modes(image).status == Status::Ok;
    let is_explained = fitted.is_explained() && found.combined.used_images.iter().all(is_ok);
    let is_mean_misfit = is_mean_misfit(found.used(), found.mean_residual_chi2);
    if is_explained && !is_mean_misfit {
        return Ok(());
    }
    let started = Instant::now();
    task.control.check("the images were fitted, the cause of a residual was not sought")?;
    if !is_explained {
        explain_image(task, fitted)?;
        if fitted.selected.is_none() && fitted.is_explained() {
            // What the modes leave out is the cause.
            (fitted.cause, fitted.changes) = (None, None);
        }
    }
    let is_static = fitted.changes.is_none_or(|chi2| chi2 < CHANGING);
    if is_mean_misfit && is_static && fitted.selected.is_none() && fitted.cause.is_none() {
        fitted.selected = selected_by_sum(task, &fitted.fit.1)?;
    }
    let mut fit_seconds = 0.0;
    if let Some(selected) = &fitted.selected {
        fitted.fit = task.fit_by(&selected.scene, None)?;
        fitted.scene = selected.scene.adopting(fitted.fit.0.scene())?;
        fit_seconds = fitted.fit.1.seconds;
    }
    fitted.model_seconds += started.elapsed().as_secs_f64() - fit_seconds;
    Ok(())
}

/// Looks for the cause of the residual of the first image that is used, or for a model that
/// explains it.
fn explain_image(task: &ModalTask, fitted: &mut Fitted) -> Result<()> {
    fitted.changes = image_changes(task.scene, task.images);
    let found = &fitted.fit;
    let Some(&image) =
        found.1.combined.used_images.first().filter(|_| fitted.changes.is_none_or(|chi2| chi2 < CHANGING))
    else {
        return Ok(());
    };
    let diversity = found.0.diversity_projection()?;
    let (model, chain) = (found.0.model(), found.0.reference_chain());
    let case = misfit::Case { task: *task, image, model, chain, diversity: &diversity };
    fitted.cause = case.likely_cause(&found.1)?;
    if fitted.cause.is_none() && model_selection::may_extend(task.scene, task.policy) {
        let name = format!("image {}", image + 1);
        fitted.selected = selected(task, (found, image, &name))?;
    }
    Ok(())
}

/// Looks for a model that explains the sum of the images, in which modes are N times as significant
/// as in one of N images.
fn selected_by_sum(task: &ModalTask, found: &ModalEstimate) -> Result<Option<Selected>> {
    if !model_selection::may_extend(task.scene, task.policy) {
        return Ok(None);
    }
    let images = task.images.sum(&found.combined.used_images, task.scene.image.read_noise_e);
    let task = ModalTask { images: &images, ..*task };
    let Some(own) = task.fit_one(task.scene, 0)? else { return Ok(None) };
    let name = format!("the sum of {} images", found.used());
    selected(&task, (&own, 0, &name))
}

/// Looks for a model that explains image `image` of `own`, which is called `name`.
fn selected(task: &ModalTask, (own, image, name): (&ModalFit, usize, &str)) -> Result<Option<Selected>> {
    let policy = Policy::realtime();
    let coarse = ModalTask { policy: &policy, ..*task };
    let fits: [&FitOne; 2] = [&|scene| task.fit_one(scene, image), &|scene| coarse.fit_one(scene, image)];
    model_selection::select(task.scene, task.control, (own, image, name), fits)
}

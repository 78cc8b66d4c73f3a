//! Fitter for the images of a scene: its model, with the optical parameters where they are fitted.

use crate::Result;
use crate::control::Control;
use crate::modal::fit_optics;
use crate::modal::fitter::ModalFitter;
use crate::modal::model::model_cache::ModelCache;
use crate::modal::model::recipe::Recipe;
use crate::modal::prepare::cube::Cube;
use crate::scene::{Sampling, System};

/// Whether `cube` is fitted at its native sampling: a reduction would smear bad pixels.
fn is_native(scene: &System, cube: Cube) -> bool {
    scene.estimate.sampling == Sampling::Auto && cube.has_bad()
}

/// The fitter for `cube` of a scene that fits no optical parameters, with the basis of `cache`.
///
/// # Errors
/// Those of [`ModalFitter::new`].
pub(crate) fn fitter_for(scene: &System, recipe: Recipe, cache: &ModelCache, cube: Cube) -> Result<ModalFitter> {
    ModalFitter::with_scene_basis(scene, recipe, is_native(scene, cube), cache.basis.clone())
}

/// The fitter for `cube` of `scene`, which `cache` keeps; optical parameters are fitted first where
/// the scene names some.
///
/// # Errors
/// Those of [`ModalFitter::new`], and of the fit of the parameters.
pub fn fitter_of(
    scene: &System,
    recipe: Recipe,
    cache: &ModelCache,
    cube: Cube,
    control: &Control,
) -> Result<ModalFitter> {
    if scene.estimate.fit_optics.is_empty() {
        cache.fitter(scene, recipe, is_native(scene, cube))
    } else {
        fit_optics::fitter(scene, &recipe, cube, is_native(scene, cube), control)
    }
}

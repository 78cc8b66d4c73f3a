//! Modal estimate of the images of a scene: model, optical parameters where they are fitted, chain,
//! fits.

use crate::Result;
use crate::control::Control;
use crate::imaging::Chain;
use crate::modal::combine::ModalEstimate;
use crate::modal::fit_optics;
use crate::modal::fitter::ModalFitter;
use crate::modal::model::model_cache::ModelCache;
use crate::modal::model::recipe::Recipe;
use crate::modal::prepare::cube::Cube;
use crate::scene::{Sampling, System};

/// Opens the chain for a fitter's model.
pub type OpenChain<'a> = dyn FnMut(&ModalFitter) -> Result<Chain> + 'a;

/// [`estimate_with`] the recipe of the scene, as [`Recipe::with_prior`] has it.
///
/// # Errors
/// As [`estimate_with`].
pub fn estimate_scene(
    scene: &System,
    cube: Cube,
    open: &mut OpenChain,
    control: &Control,
) -> Result<(ModalFitter, ModalEstimate)> {
    estimate_with(scene, Recipe::with_prior(scene), &ModelCache::default(), cube, open, control)
}

/// Whether `cube` is fitted at its native sampling.
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
pub(crate) fn fitter_of(
    scene: &System,
    recipe: Recipe,
    cache: &ModelCache,
    cube: Cube,
    control: &Control,
) -> Result<ModalFitter> {
    if scene.estimate.fit_optics.is_empty() {
        cache.fitter(scene, recipe, is_native(scene, cube))
    } else {
        fit_optics::estimator(scene, &recipe, cube, is_native(scene, cube), control)
    }
}

/// Estimates the static wavefront behind `cube` by `recipe`, on the chain that `open` opens for the
/// model. Frames with bad pixels are fitted at their native sampling, because a reduction would
/// smear them. Optical parameters that `estimate.fit_optics` names are fitted first.
///
/// # Errors
/// Those of [`ModalFitter::new`], of [`ModalFitter::estimate`] and of `open`.
pub fn estimate_with(
    scene: &System,
    recipe: Recipe,
    cache: &ModelCache,
    cube: Cube,
    open: &mut OpenChain,
    control: &Control,
) -> Result<(ModalFitter, ModalEstimate)> {
    let keeps_optics = scene.estimate.fit_optics.is_empty();
    let fitter = if keeps_optics {
        fitter_for(scene, recipe, cache, cube)
    } else {
        fitter_of(scene, recipe, cache, cube, control)
    }?;
    let mut chain = open(&fitter)?;
    let estimate = fitter.estimate(&mut chain, cube, control)?;
    Ok((fitter, estimate))
}

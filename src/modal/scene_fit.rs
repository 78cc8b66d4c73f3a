//! Modal estimate of the images of a scene: model, optical parameters where they are fitted, chain, fits.

use super::combine::ModalEstimate;
use super::cube::Cube;
use super::engine::Watch;
use super::fit_optics;
use super::fitter::{ModalFitter, same_basis};
use super::mode_set::SceneBasis;
use super::recipe::Recipe;
use crate::Result;
use crate::imaging::Chain;
use crate::optimize::CancelFlag;
use crate::scene::{Sampling, Scene};
use std::sync::Arc;

/// Opens the chain for a fitter's model.
pub type OpenChain<'a> = dyn FnMut(&ModalFitter) -> Result<Chain> + 'a;

/// Karhunen-Loève basis of a scene, which takes most of the time of building a model: computed once for all models of one scene.
#[derive(Clone, Default)]
pub struct BasisCache(Arc<SceneBasis>);

impl BasisCache {
    /// The cache for the scene `other` of one that was made for `scene`: shared where both have the same basis.
    pub(crate) fn for_scene(&self, scene: &Scene, other: &Scene) -> Self {
        if same_basis(scene, other) { self.clone() } else { Self::default() }
    }
}

/// [`estimate_with`] the recipe of the scene, as [`Recipe::with_prior`] has it.
///
/// # Errors
/// As [`estimate_with`].
pub fn estimate_scene(
    scene: &Scene,
    cube: Cube,
    open: &mut OpenChain,
    cancel: Option<&CancelFlag>,
    watch: &mut Watch,
) -> Result<(ModalFitter, ModalEstimate)> {
    estimate_with(scene, Recipe::with_prior(scene), &BasisCache::default(), cube, open, cancel, watch)
}

/// Estimates the static wavefront behind `cube` by `recipe`, on the chain that `open` opens for the model. Frames with bad
/// pixels are fitted at their native sampling, because a reduction would smear them. Optical parameters that
/// `estimate.fit_optics` names are fitted first.
///
/// # Errors
/// Those of [`ModalFitter::new`], of [`ModalFitter::estimate`] and of `open`.
pub fn estimate_with(
    scene: &Scene,
    recipe: Recipe,
    cache: &BasisCache,
    cube: Cube,
    open: &mut OpenChain,
    cancel: Option<&CancelFlag>,
    watch: &mut Watch,
) -> Result<(ModalFitter, ModalEstimate)> {
    let native = scene.estimate.sampling == Sampling::Auto && cube.bad.iter().any(|bad| *bad);
    let fitter = if scene.estimate.fit_optics.is_empty() {
        ModalFitter::with_scene_basis(scene, recipe, native, cache.0.clone())?
    } else {
        fit_optics::estimator(scene, &recipe, cube, native, cancel)?
    };
    let mut chain = open(&fitter)?;
    let estimate = fitter.estimate(&mut chain, cube.images_e, cube.bad, cube.read_noise_e, cancel, watch)?;
    Ok((fitter, estimate))
}

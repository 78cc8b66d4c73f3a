//! Model selection: the smallest basis that explains the images.

use super::combine::ModalEstimate;
use super::cube::Cube;
use super::engine::Watch;
use super::fit_optics;
use super::fitter::ModalFitter;
use super::mode_set::SceneBasis;
use super::recipe::Recipe;
use crate::imaging::Chain;
use crate::optimize::CancelFlag;
use crate::scene::{Sampling, Scene};
use crate::{Error, Result};
use ndarray::Axis;
use std::sync::Arc;

/// Opens the chain for a fitter's model.
pub type OpenChain<'a> = dyn FnMut(&ModalFitter) -> Result<Chain> + 'a;

/// Largest reduced χ² at which a basis explains the images. Over 9,000 pixels its scatter is 0.015; the sampling
/// of the pupil leaves up to 0.1 at the bright end.
const EXPLAINED: f64 = 1.1;
/// A larger basis is kept only if it lowers χ² at least to this fraction: far more than 17 further modes lower it by fitting
/// noise (0.2 % over 9,000 pixels).
const CHI2_RATIO: f64 = 0.97;

/// Longest sequence of which every image is fitted in every basis.
const SHORT: usize = 12;
/// Images of a longer sequence from which the basis is selected: the median of six χ² is accurate to a few per cent where
/// turbulence dominates it, and the bases are compared on the same images.
const PILOTS: usize = 6;

/// Karhunen-Loève basis of a scene, which takes most of the time of building a model: computed once for all models of one scene.
#[derive(Clone, Default)]
pub struct BasisCache(pub(super) Arc<SceneBasis>);

/// [`select`] with the recipes of the scene, as [`Recipe::ladder`] has them.
///
/// # Errors
/// As [`select`].
pub fn select_default(
    scene: &Scene,
    cube: Cube,
    open: &mut OpenChain,
    cancel: Option<&CancelFlag>,
    watch: &mut Watch,
) -> Result<(ModalFitter, ModalEstimate)> {
    select(scene, &Recipe::ladder(scene), &BasisCache::default(), cube, open, cancel, watch)
}

/// Estimates the static wavefront behind `cube` with the first of `recipes`, smallest basis first, that explains it, on the
/// chain that `open` opens for a model. The basis of a sequence of more than twelve images is selected from six images spread
/// over it. Frames with bad pixels are fitted at their native sampling, because a reduction would smear them. Optical parameters
/// that `estimate.fit_optics` names are fitted first, with the last recipe, which is then that of the estimate.
///
/// # Errors
/// Those of [`ModalFitter::new`], of [`ModalFitter::estimate`] and of `open`; [`Error::Internal`] without a recipe.
pub fn select(
    scene: &Scene,
    recipes: &[Recipe],
    cache: &BasisCache,
    cube: Cube,
    open: &mut OpenChain,
    cancel: Option<&CancelFlag>,
    watch: &mut Watch,
) -> Result<(ModalFitter, ModalEstimate)> {
    let Some(largest) = recipes.last() else { return Err(Error::Internal("no recipe was given".into())) };
    let ladder = Ladder { scene, recipes, cache, cancel };
    let native = scene.estimate.sampling == Sampling::Auto && cube.bad.iter().any(|bad| *bad);
    if !scene.estimate.fit_optics.is_empty() {
        let estimator = fit_optics::estimator(scene, largest, cube, native, cancel)?;
        let estimate = ladder.fit(&estimator, cube, open, watch)?;
        return Ok((estimator, estimate));
    }
    let count = cube.images_e.dim().0;
    if count > SHORT && recipes.len() > 1 {
        // In the middles of equal parts of the sequence.
        let at: Vec<usize> = (0..PILOTS).map(|i| (2 * i + 1) * count / (2 * PILOTS)).collect();
        let (images_e, bad) = (cube.images_e.select(Axis(0), &at), cube.bad.select(Axis(0), &at));
        let pilots = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: cube.read_noise_e };
        // The caller waits for all images: progress of the pilots is not reported.
        match ladder.select(pilots, native, open, &mut |_, _| {}) {
            Ok((estimator, chosen)) => {
                let mut estimate = ladder.fit(&estimator, cube, open, watch)?;
                estimate.seconds += chosen.seconds;
                return Ok((estimator, estimate));
            }
            // No pilot can be used: the basis is selected from all images.
            Err(Error::Image(_)) => {}
            Err(error) => return Err(error),
        }
    }
    ladder.select(cube, native, open, watch)
}

/// Basis ladder of one scene.
struct Ladder<'a> {
    scene: &'a Scene,
    recipes: &'a [Recipe],
    cache: &'a BasisCache,
    cancel: Option<&'a CancelFlag>,
}

impl Ladder<'_> {
    fn fit(
        &self,
        estimator: &ModalFitter,
        cube: Cube,
        open: &mut OpenChain,
        watch: &mut Watch,
    ) -> Result<ModalEstimate> {
        let mut chain = open(estimator)?;
        estimator.estimate(&mut chain, cube.images_e, cube.bad, cube.read_noise_e, self.cancel, watch)
    }

    /// The estimate in the smallest basis that explains the images.
    fn select(
        &self,
        cube: Cube,
        native: bool,
        open: &mut OpenChain,
        watch: &mut Watch,
    ) -> Result<(ModalFitter, ModalEstimate)> {
        let mut best: Option<(ModalFitter, ModalEstimate)> = None;
        let mut seconds = 0.0;
        for recipe in self.recipes {
            let estimator = ModalFitter::with_scene_basis(self.scene, recipe.clone(), native, self.cache.0.clone())?;
            let estimate = self.fit(&estimator, cube, open, watch)?;
            seconds += estimate.seconds;
            let chi2 = estimate.typical_chi2();
            // A comparison with NaN is false: a fit without χ² does not replace one that has it.
            let better = best.as_ref().is_none_or(|(_, smaller)| chi2 < CHI2_RATIO * smaller.typical_chi2());
            if better {
                best = Some((estimator, estimate));
            }
            if chi2 <= EXPLAINED {
                break;
            }
        }
        let (estimator, mut estimate) = best.ok_or_else(|| Error::Internal("no recipe was fitted".into()))?;
        estimate.seconds = seconds;
        Ok((estimator, estimate))
    }
}

//! Which basis the images ask for: the smallest that explains them.

use super::combine::ModalEstimate;
use super::cube::Cube;
use super::engine::Watch;
use super::fit_optics;
use super::fitter::ModalFitter;
use super::mode_set::OwnBasis;
use super::recipe::Recipe;
use crate::imaging::Chain;
use crate::optimize::CancelFlag;
use crate::scene::{Sampling, Scene};
use crate::{Error, Result};
use ndarray::Axis;
use std::sync::Arc;

/// Makes the chain for an estimator's model.
pub type Open<'a> = dyn FnMut(&ModalFitter) -> Result<Chain> + 'a;

/// Reduced χ² up to which a basis is taken to explain the images. Over 9,000 pixels its scatter is 0.015; the sampling
/// of the pupil leaves up to 0.1 at the bright end.
const EXPLAINED: f64 = 1.1;
/// A larger basis is kept only if it lowers χ² at least to this fraction: far beyond what 17 more modes take from noise
/// (0.2 % over 9,000 pixels).
const WORTH_IT: f64 = 0.97;

/// Longest sequence of which every image is fitted in every basis.
const SHORT: usize = 12;
/// Images that choose the basis of a longer one: the median of six knows χ² to a few per cent where turbulence rules it,
/// and the two bases are compared on the same images.
const PILOTS: usize = 6;

/// Karhunen-Loève basis of a scene, which is most of what a model costs: made once for all models of one scene.
#[derive(Clone, Default)]
pub struct BasisCache(pub(super) Arc<OwnBasis>);

/// [`select`] with the recipes of the scene, as [`Recipe::ladder`] has them.
///
/// # Errors
/// As [`select`].
pub fn read(
    scene: &Scene,
    cube: Cube,
    open: &mut Open,
    cancel: Option<&CancelFlag>,
    watch: &mut Watch,
) -> Result<(ModalFitter, ModalEstimate)> {
    select(scene, &Recipe::ladder(scene), &BasisCache::default(), cube, open, cancel, watch)
}

/// Estimates the static wavefront behind `cube` with the first of `recipes`, smallest basis first, that explains it, on the
/// chain that `open` makes for a model. Of a sequence of more than twelve images, six spread over it choose the basis.
/// Frames with bad pixels are compared at their native sampling: a reduction would smear them. Where `estimate.fit_optics`
/// names optics they are found first, with the last recipe, which is then the estimate's.
///
/// # Errors
/// Those of [`ModalFitter::new`], of [`ModalFitter::estimate`] and of `open`; [`Error::Internal`] without a recipe.
pub fn select(
    scene: &Scene,
    recipes: &[Recipe],
    cache: &BasisCache,
    cube: Cube,
    open: &mut Open,
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
        // Pilots are not what the caller waits for.
        match ladder.climb(pilots, native, open, &mut |_, _| {}) {
            Ok((estimator, chosen)) => {
                let mut estimate = ladder.fit(&estimator, cube, open, watch)?;
                estimate.seconds += chosen.seconds;
                return Ok((estimator, estimate));
            }
            // Not one of them can be used: all choose.
            Err(Error::Image(_)) => {}
            Err(error) => return Err(error),
        }
    }
    ladder.climb(cube, native, open, watch)
}

/// The recipes to choose from.
struct Ladder<'a> {
    scene: &'a Scene,
    recipes: &'a [Recipe],
    cache: &'a BasisCache,
    cancel: Option<&'a CancelFlag>,
}

impl Ladder<'_> {
    fn fit(&self, estimator: &ModalFitter, cube: Cube, open: &mut Open, watch: &mut Watch) -> Result<ModalEstimate> {
        let mut chain = open(estimator)?;
        estimator.estimate(&mut chain, cube.images_e, cube.bad, cube.read_noise_e, self.cancel, watch)
    }

    /// The estimate in the smallest basis that explains the images.
    fn climb(
        &self,
        cube: Cube,
        native: bool,
        open: &mut Open,
        watch: &mut Watch,
    ) -> Result<(ModalFitter, ModalEstimate)> {
        let mut best: Option<(ModalFitter, ModalEstimate)> = None;
        let mut seconds = 0.0;
        for recipe in self.recipes {
            let estimator = ModalFitter::with_own_basis(self.scene, recipe.clone(), native, self.cache.0.clone())?;
            let estimate = self.fit(&estimator, cube, open, watch)?;
            seconds += estimate.seconds;
            let chi2 = estimate.typical_chi2();
            // A comparison with NaN is false: whatever cannot be judged does not displace what can.
            let better = best.as_ref().is_none_or(|(_, smaller)| chi2 < WORTH_IT * smaller.typical_chi2());
            if better {
                best = Some((estimator, estimate));
            }
            if chi2 <= EXPLAINED {
                break;
            }
        }
        let (estimator, mut estimate) = best.ok_or_else(|| Error::Internal("no recipe was tried".into()))?;
        estimate.seconds = seconds;
        Ok((estimator, estimate))
    }
}

//! Which basis the images ask for: the smallest that explains them.

use super::mode_set::OwnBasis;
use super::{Estimate, Estimator, Recipe, Watch};
use crate::Result;
use crate::imaging::Chain;
use crate::optimize::CancelFlag;
use crate::scene::{Sampling, Scene};
use ndarray::ArrayView3;

/// Images as they were read.
#[derive(Debug, Clone, Copy)]
pub struct Cube<'a> {
    /// Electrons, `[image, y, x]`.
    pub images_e: ArrayView3<'a, f64>,
    /// Bad pixels, `[image, y, x]`.
    pub bad: ArrayView3<'a, bool>,
    /// Read noise of a pixel, RMS electrons; `None` takes the scene's.
    pub read_noise_e: Option<f64>,
}

/// Reduced χ² up to which a basis is taken to explain the images. Over 9,000 pixels its scatter is 0.015; the sampling
/// of the pupil leaves up to 0.1 at the bright end.
const EXPLAINED: f64 = 1.1;
/// A larger basis is kept only if it lowers χ² at least to this fraction: far beyond what 17 more modes take from noise
/// (0.2 % over 9,000 pixels).
const WORTH_IT: f64 = 0.97;

/// Estimates the static wavefront behind `cube` with the smallest basis of [`Recipe::ladder`] that explains it, on the
/// chain that `open` makes for a model. Frames with bad pixels are compared at their native sampling: a reduction would
/// smear them.
///
/// # Errors
/// Those of [`Estimator::new`], of [`Estimator::estimate`] and of `open`.
pub fn read(
    scene: &Scene,
    cube: Cube,
    open: &mut dyn FnMut(&Estimator) -> Result<Chain>,
    cancel: Option<&CancelFlag>,
    watch: &mut Watch,
) -> Result<(Estimator, Estimate)> {
    let native = scene.estimate.sampling == Sampling::Auto && cube.bad.iter().any(|bad| *bad);
    let mut best: Option<(Estimator, Estimate)> = None;
    let mut seconds = 0.0;
    let own = OwnBasis::default();
    for recipe in Recipe::ladder(scene) {
        let estimator = Estimator::with_own_basis(scene, recipe, native, &own)?;
        let mut chain = open(&estimator)?;
        let (images_e, bad) = (cube.images_e, cube.bad);
        let mut estimate = estimator.estimate(&mut chain, images_e, bad, cube.read_noise_e, cancel, watch)?;
        seconds += estimate.seconds;
        let chi2 = estimate.reduced_chi2();
        // A comparison with NaN is false: whatever cannot be judged does not displace what can.
        let better = best.as_ref().is_none_or(|(_, smaller)| chi2 < WORTH_IT * smaller.reduced_chi2());
        if better {
            estimate.seconds = seconds;
            best = Some((estimator, estimate));
        }
        if chi2 <= EXPLAINED {
            break;
        }
    }
    let (estimator, mut estimate) = best.ok_or_else(|| crate::Error::Internal("no recipe was tried".into()))?;
    estimate.seconds = seconds;
    Ok((estimator, estimate))
}

//! Fit of optical parameters of the scene together with the modes: the plate scale, the rotation
//! and the shadows of the pupil, the reflectivities of its segments, its illumination, the
//! amplitude of the defocus, the width of the filter, the area of a pixel.
//!
//! Each image has its own modes a; all images share the optical parameters θ. With J the
//! derivatives of an image's electrons, orthogonalised to its flux and background, W its weights
//! and r its residual, Gauss-Newton about the images' own minima (where Jₐᵀ W r = 0) eliminates a:
//!
//! ```text
//! c = Jₐᵀ W Jθ      F = Jₐᵀ W Jₐ      S = Σ (Jθᵀ W Jθ − cᵀ F⁻¹ c)      δθ = S⁻¹ Σ Jθᵀ W r
//! ```
//!
//! cov θ = χ² S⁻¹, and with G the mean of F⁻¹ c an error δθ moves the mean modes by −G δθ: G cov θ
//! Gᵀ is the covariance that all images share. The share of Jθᵀ W Jθ that is left in S measures how
//! identifiable the parameters are: where it is nearly 0 the modes reproduce their effect, and the
//! scene's value stays.

mod normal;
mod parameter;
mod search;

use super::fitter::ModalFitter;
use crate::control::Control;
use crate::modal::model::model_cache::ModelCache;
use crate::modal::model::recipe::Recipe;
use crate::modal::prepare::cube::Cube;
use crate::scene::{Optic, System};
use crate::{Error, Result};
use ndarray::Array2;
use parameter::FittedParameter;
use search::ParameterSearch;

/// Fits the optical parameters that `scene` names to the images of `cube`, and returns the fitter
/// of the scene with them; `native` as in [`ModalFitter::new`].
///
/// # Errors
/// Those of [`ModalFitter::new`] and of fits; [`Error::Scene`] for parameters that the scene does
/// not have; [`Error::Interrupted`].
pub(super) fn fitter(
    scene: &System,
    recipe: &Recipe,
    cube: Cube,
    native: bool,
    control: &Control,
) -> Result<ModalFitter> {
    let cache = ModelCache::default();
    let (mut search, own) = ParameterSearch::new(scene, recipe, &cache, cube, native, control)?;
    let first = search.iterate(&own)?;
    let (mut values, mut last) = search.minimum((own.clone(), first))?;
    if search.take_more(&cube) {
        let first = search.iterate(&values)?;
        (values, last) = search.minimum((values, first))?;
    }
    search.fitter_at(&own, &values, &last)
}

/// Least part of χ² beyond 1 that the start and the step from it must be expected to remove for a
/// parameter to be fitted as its likely cause. At the start that a misfit gives, a plate scale that
/// is 5 or 10 % wrong has lost 51 to 99.9 % of it (Keck, peak S/N of 50 to 1,000). Other causes
/// lose 0 to 8 % there, except gaps of another width between the segments (47 %), which the fit
/// itself excludes.
const WORTH_FITTING: f64 = 0.2;

/// As [`fitter`], for the only parameter that `scene` names, with the Karhunen-Loève basis of
/// `cache`, without another search for outlier pixels, and with the median reduced χ² of the images
/// with the scene's value and with the fitted one. The fit starts from the scene's value times
/// `factor` where χ² is lower there. `None` where a first step shows that the parameter does not
/// explain the residual.
///
/// # Errors
/// As [`fitter`].
pub(crate) fn explaining_fit(
    scene: &System,
    recipe: &Recipe,
    cache: &ModelCache,
    cube: Cube,
    factor: f64,
    control: &Control,
) -> Result<Option<(ModalFitter, [f64; 2])>> {
    let recipe = Recipe { search_outliers: false, ..recipe.clone() };
    let (search, own) = ParameterSearch::new(scene, &recipe, cache, cube, false, control)?;
    let first = search.iterate(&own)?;
    let own_chi2 = first.reduced_chi2;
    let elsewhere = own.iter().map(|value| factor * value).collect();
    let start = search.better_start((own.clone(), first), elsewhere)?;
    let removed = own_chi2 - start.1.reduced_chi2 + start.1.expected_drop;
    // Without the reduction of the image a misfit can be within the noise.
    if own_chi2 <= 1.0 || removed <= WORTH_FITTING * (own_chi2 - 1.0) {
        return Ok(None);
    }
    let (fitter, chi2) = search.run(&own, start)?;
    Ok(Some((fitter, [own_chi2, chi2])))
}

/// Minimum of all optical parameters that a scene names, fitted together.
pub(crate) struct OpticsMinimum {
    /// The fitter of the scene with the fitted values.
    pub(crate) fitter: ModalFitter,
    /// Covariance of [`ModalFitter::fitted_optics`], in their order; 0 for those that are not
    /// identifiable.
    pub(crate) covariance: Array2<f64>,
    /// Median reduced χ² of the images with the scene's values, and with the fitted ones.
    pub(crate) reduced_chi2: [f64; 2],
    /// Pixels with a weight, of all images that were fitted.
    pub(crate) pixels: usize,
}

/// Where a fit of optical parameters begins.
pub(crate) struct OpticsStart<'a> {
    /// Values of some of them in place of the scene's.
    pub(crate) values: &'a [(Optic, f64)],
    /// Reduced χ² with the scene's values, for images of which no fit converges with these.
    pub(crate) own_chi2: f64,
}

/// Fits the numbers that `scene` names (no reflectivities), with the Karhunen-Loève basis of
/// `cache`, without another search for outlier pixels, to find which of them the images contradict.
/// The fit begins at `start` where χ² is lower there than with the scene's values.
///
/// # Errors
/// As [`fitter`].
pub(crate) fn fit_together(
    scene: &System,
    recipe: &Recipe,
    cache: &ModelCache,
    cube: Cube,
    start: &OpticsStart,
    control: &Control,
) -> Result<OpticsMinimum> {
    let recipe = Recipe { search_outliers: false, ..recipe.clone() };
    let (mut search, own) = ParameterSearch::new(scene, &recipe, cache, cube, false, control)?;
    let mut elsewhere = own.clone();
    for &(optic, value) in start.values {
        let is_it = |parameter: &FittedParameter| matches!(parameter, FittedParameter::Number(of, _) if *of == optic);
        if let Some(at) = search.parameters.iter().position(is_it) {
            elsewhere[at] = value;
        }
    }
    let (own_chi2, start) = match search.iterate(&own) {
        Ok(first) => (first.reduced_chi2, search.better_start((own.clone(), first), elsewhere)?),
        Err(Error::Image(_)) if elsewhere != own => {
            let first = search.iterate(&elsewhere)?;
            (start.own_chi2, (elsewhere, first))
        }
        Err(error) => return Err(error),
    };
    let (values, last) = search.minimum(start)?;
    let fitter = search.fitter_at(&own, &values, &last)?;
    let reduced_chi2 = [own_chi2, last.reduced_chi2];
    Ok(OpticsMinimum { fitter, covariance: last.covariance, reduced_chi2, pixels: last.pixels })
}

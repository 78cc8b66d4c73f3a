//! The plate scale, where the images say that the scene's is not theirs.
//!
//! A pupil that is 1 % wider in the model than it is puts the rim of the defocused spot a third of a pixel off, all round:
//! no wavefront explains that, so χ² has a sharp minimum where the scale is right. It is found from a few of the images.

use super::found::EXPLAINED;
use super::retrieve::{RetrievalRecipe, Retriever};
use super::{SkyImages, Spectrum};
use crate::estimate::Cube;
use crate::optimize::CancelFlag;
use crate::scene::Scene;
use crate::{Error, Result};
use ndarray::Axis;

/// Images that are asked: the minimum is sharp.
const ASKED: usize = 6;

/// Farthest that the scene's plate scale may be off, and how far apart the first tries are: χ² is a bowl of about this width.
const FARTHEST: f64 = 0.03;
const FIRST_STEP: f64 = 0.01;

/// Where the search ends: 0.02 % of the scale cost a tenth of the error bars.
const LAST_STEP: f64 = 0.0003;

/// A scale that lowers χ² by less is no better than the scene's.
const WORTH: f64 = 0.8;

/// By how much the pixels of `images` are finer than `scene` says (1.01: 1 % more of them per λ/D), where that explains images
/// that the scene's scale does not; `None` where its scale is as good as any.
///
/// # Errors
/// Those of making retrievers; [`Error::Interrupted`].
pub(super) fn found(
    scene: &Scene,
    prior: &Spectrum,
    recipe: &RetrievalRecipe,
    images: &SkyImages,
    cancel: Option<&CancelFlag>,
) -> Result<Option<f64>> {
    let count = images.images_e.dim().0;
    let asked: Vec<usize> = (0..ASKED.min(count)).map(|i| i * count / ASKED.min(count)).collect();
    let (images_e, bad) = (images.images_e.select(Axis(0), &asked), images.bad.select(Axis(0), &asked));
    let chi2 = |scale: f64| -> Result<f64> {
        let retriever = Retriever::new(&scaled(scene, scale)?, prior, recipe.clone())?;
        let cube = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: images.read_noise_e };
        let reports = retriever.retrieve(cube, None, cancel, &|_| {})?.reports;
        let mut values: Vec<f64> = reports.iter().map(|report| report.reduced_chi2).filter(|v| v.is_finite()).collect();
        values.sort_by(f64::total_cmp);
        values.get(values.len() / 2).copied().ok_or_else(|| Error::Image("no image can be used".into()))
    };
    let own = match chi2(1.0) {
        // What is wrong with images is told where all of them are read.
        Err(Error::Image(_)) => return Ok(None),
        own => own?,
    };
    if own <= EXPLAINED {
        return Ok(None);
    }
    let (mut best, mut step) = ((1.0, own), FIRST_STEP);
    // Downhill in steps that halve where neither side is lower.
    while step > LAST_STEP {
        let mut moved = false;
        for side in [-step, step] {
            let scale = best.0 + side;
            if (scale - 1.0).abs() > FARTHEST {
                continue;
            }
            let value = chi2(scale)?;
            if value < best.1 {
                (best, moved) = ((scale, value), true);
                break;
            }
        }
        if !moved {
            step /= 2.0;
        }
    }
    Ok((best.1 < WORTH * own).then_some(best.0))
}

/// `scene` with `scale` times its pixels per λ/D.
///
/// # Errors
/// [`Error::Scene`] for a scale out of range.
pub(super) fn scaled(scene: &Scene, scale: f64) -> Result<Scene> {
    let sampling = (scene.image.samples_per_lambda_over_d * scale).to_string();
    scene.with(&[("image.samples_per_lambda_over_d", &sampling)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::Unknown;
    use crate::sky::tests::{draw, prior, scene};

    #[test]
    fn a_scale_that_is_not_the_scenes_is_found_and_its_own_left_alone() {
        let (scene, prior) = (scene(), prior());
        let recipe = RetrievalRecipe::default();
        let retriever = Retriever::new(&scene, &prior, recipe.clone()).unwrap();
        let images_e = draw(&retriever, &prior, 3, true).images_e;
        let bad = images_e.mapv(|_| false);
        let images = SkyImages { images_e, bad, read_noise_e: None, slopes_mas: None };
        assert_eq!(found(&scene, &prior, &recipe, &images, None).unwrap(), None);
        let off = scaled(&scene, 1.02).unwrap();
        let wide = Spectrum::of_scene(&off, Unknown { piston_rms_nm: 0.0, ncpa_rms_nm: 40.0 }).unwrap();
        let back = 1.02 * found(&off, &wide, &recipe, &images, None).unwrap().unwrap();
        // The last step is 0.03 % or more, and so is the noise of three images of a pupil half as wide as Keck's.
        assert!((back - 1.0).abs() < 1e-3, "{back}");
    }
}

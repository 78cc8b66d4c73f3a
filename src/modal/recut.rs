//! Another fit for an image that the model does not explain, without the pixels that stand out.

use super::engine::{FitTask, ImageFit};
use super::fitter::ModalFitter;
use super::outliers::{Cleaned, OutlierFinder};
use super::prepare::Frame;
use super::status::Status;
use crate::Result;
use crate::imaging::Chain;
use crate::scene::Scene;
use ndarray::{Array2, Array3, Axis};
use rayon::prelude::*;

impl ModalFitter {
    /// Seeks outlier pixels in those of `frames` that the model does not explain, and fits these again without. Returns the
    /// frames in which there were any, and keeps the better fit.
    ///
    /// # Errors
    /// As [`super::engine::fit`].
    pub(super) fn reject_outliers(
        &self,
        chain: &mut Chain,
        task: &FitTask,
        frames: &[Frame],
        fits: &mut [ImageFit],
    ) -> Result<Vec<Option<Cleaned>>> {
        let mut cleaned: Vec<Option<Cleaned>> = frames.iter().map(|_| None).collect();
        if !self.recipe.reject_outliers {
            return Ok(cleaned);
        }
        let reports = self.reports(fits);
        let unexplained: Vec<usize> =
            (0..fits.len()).filter(|&image| fits[image].is_fitted() && reports[image].status != Status::Ok).collect();
        let Some(finder) = (!unexplained.is_empty()).then(|| OutlierFinder::of(&self.scene)).flatten() else {
            return Ok(cleaned);
        };
        let seek = |&image: &usize| {
            Some((image, usable(finder.clean(frames[image])?, &frames[image], self.compares_native_pixels())))
        };
        let found: Vec<(usize, Cleaned)> = unexplained.par_iter().filter_map(seek).collect();
        let fresh = ImageFit::new(&self.model.preparation, self.model.optics.modes());
        let mut again = vec![fresh; found.len()];
        let without: Vec<Frame> =
            found.iter().map(|(image, cleaned)| cleaned.frame(frames[*image].read_noise_e)).collect();
        self.fit_frames(chain, task, &without, &mut again, &mut |_, _| {})?;
        for ((image, found), mut again) in found.into_iter().zip(again) {
            again.prepared.cut_pixels = found.cut;
            if fits[image].improve(again) {
                cleaned[image] = Some(found);
            }
        }
        Ok(cleaned)
    }

    fn compares_native_pixels(&self) -> bool {
        let preparation = self.model.preparation;
        preparation.reduced == preparation.frame
    }
}

impl Cleaned {
    /// As a frame.
    pub(super) fn frame(&self, read_noise_e: f64) -> Frame<'_> {
        Frame { data_e: self.data_e.view(), bad: self.bad.view(), read_noise_e }
    }
}

/// What an estimator takes: pixels that stood out are bad where each is compared by itself; where a reduction would smear
/// the hole they keep what is theirs.
fn usable(found: Cleaned, frame: &Frame, native: bool) -> Cleaned {
    let Cleaned { data_e, bad, cut } = found;
    if native {
        Cleaned { data_e: frame.data_e.to_owned(), bad, cut }
    } else {
        Cleaned { data_e, bad: frame.bad.to_owned(), cut }
    }
}

/// A cube of images without the single pixels that stand out, and how many these were in each.
pub struct WithoutOutliers {
    /// Electrons, `[image, y, x]`; where a pixel stood out, what it has without that.
    pub images_e: Array3<f64>,
    /// How many pixels stood out in each image.
    pub cut_pixels: Vec<usize>,
}

/// Takes single pixels that stand out off images of `scene` (`[image, y, x]`), before anybody looks at them; none where there are
/// none.
pub fn without_outliers(
    scene: &Scene,
    images_e: &Array3<f64>,
    bad: &Array3<bool>,
    read_noise_e: Option<f64>,
) -> Option<WithoutOutliers> {
    let finder = OutlierFinder::of(scene)?;
    let read_noise_e = read_noise_e.unwrap_or(scene.image.read_noise_e);
    let seek = |image: usize| -> Option<(Array2<f64>, usize)> {
        let (data_e, bad) = (images_e.index_axis(Axis(0), image), bad.index_axis(Axis(0), image));
        finder.clean(Frame { data_e, bad, read_noise_e }).map(|found| (found.data_e, found.cut))
    };
    let found: Vec<Option<(Array2<f64>, usize)>> = (0..images_e.dim().0).into_par_iter().map(seek).collect();
    if found.iter().all(Option::is_none) {
        return None;
    }
    let mut cleaned = WithoutOutliers { images_e: images_e.clone(), cut_pixels: vec![0; found.len()] };
    for (image, (data_e, cut)) in found.into_iter().enumerate().filter_map(|(image, found)| Some((image, found?))) {
        cleaned.images_e.index_axis_mut(Axis(0), image).assign(&data_e);
        cleaned.cut_pixels[image] = cut;
    }
    Some(cleaned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cube_is_cleaned_image_by_image() {
        let settings = [("image.count", "3"), ("image.pixels", "132"), ("pupil.samples", "64")];
        let scene = Scene::preset("keck-artificial").unwrap().with(&settings).unwrap();
        let clean_e = crate::source::simulate(&scene).unwrap().images_e;
        let bad = clean_e.mapv(|_| false);
        assert!(without_outliers(&scene, &clean_e, &bad, None).is_none());
        let mut images_e = clean_e.clone();
        images_e[[1, 50, 60]] += 1e6;
        let found = without_outliers(&scene, &images_e, &bad, None).unwrap();
        assert_eq!(found.cut_pixels, [0, 1, 0]);
        assert!(found.images_e.index_axis(Axis(0), 2) == clean_e.index_axis(Axis(0), 2));
        // What was added is off again, but for noise and photons of it: 1e3, and a share of light that is told.
        assert!((found.images_e[[1, 50, 60]] - clean_e[[1, 50, 60]]).abs() < 5e3);
    }
}

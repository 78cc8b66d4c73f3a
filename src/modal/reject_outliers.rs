//! Outlier rejection: an image that the model does not explain is fitted again without its outlier pixels.

use super::engine::{FitTask, ImageFit};
use super::fit_series::{FitSeries, SeriesStep, WITHOUT_OUTLIERS};
use super::fitter::ModalFitter;
use super::outliers::{CleanedFrame, OutlierFinder};
use super::prepare::Frame;
use super::status::Status;
use crate::Result;
use crate::imaging::Chain;
use crate::scene::Scene;
use crate::telescope::Filter;
use ndarray::{Array2, Array3, Axis};
use rayon::prelude::*;

impl ModalFitter {
    /// Searches for outlier pixels in those of `frames` that the model does not explain, fits these again without them, and keeps
    /// the better fit. Returns the cleaned frames of the fits that were replaced.
    ///
    /// # Errors
    /// As [`super::engine::fit`].
    pub(super) fn reject_outliers(
        &self,
        chain: &mut Chain,
        task: &FitTask,
        frames: &[Frame],
        fits: &mut [ImageFit],
        series: Option<&mut FitSeries>,
    ) -> Result<Vec<Option<CleanedFrame>>> {
        let mut cleaned: Vec<Option<CleanedFrame>> = frames.iter().map(|_| None).collect();
        if !self.recipe.reject_outliers {
            return Ok(cleaned);
        }
        let reports = self.reports(fits);
        let unexplained: Vec<usize> =
            (0..fits.len()).filter(|&image| fits[image].is_fitted() && reports[image].status != Status::Ok).collect();
        if unexplained.is_empty() {
            return Ok(cleaned);
        }
        let Some(finder) = OutlierFinder::new(&self.scene, &Filter::new(&self.scene)?) else { return Ok(cleaned) };
        let find = |&image: &usize| {
            Some((image, for_fit(finder.clean(frames[image])?, &frames[image], self.fits_native_pixels())))
        };
        let found: Vec<(usize, CleanedFrame)> = unexplained.par_iter().filter_map(find).collect();
        let empty = ImageFit::new(&self.model.preparation, self.model.optics.modes());
        let mut again = vec![empty; found.len()];
        let without: Vec<Frame> =
            found.iter().map(|(image, cleaned)| cleaned.frame(frames[*image].read_noise_e)).collect();
        let images: Vec<usize> = found.iter().map(|(image, _)| *image).collect();
        let step = series.map(|series| SeriesStep { series, images: &images, step: WITHOUT_OUTLIERS });
        self.fit_frames(chain, task, &without, &mut again, step, &mut |_, _| {})?;
        for ((image, found), mut again) in found.into_iter().zip(again) {
            again.prepared.rejected_pixels = found.rejected;
            if fits[image].improve(again) {
                cleaned[image] = Some(found);
            }
        }
        Ok(cleaned)
    }

    fn fits_native_pixels(&self) -> bool {
        let preparation = self.model.preparation;
        preparation.reduced == preparation.frame
    }
}

impl CleanedFrame {
    /// The cleaned frame, with this read noise.
    pub(super) fn frame(&self, read_noise_e: Option<f64>) -> Frame<'_> {
        Frame { data_e: self.data_e.view(), bad: self.bad.view(), read_noise_e }
    }
}

/// The cleaned frame for a fit: at the native sampling outliers are bad pixels; where the sampling is reduced, which would smear
/// bad pixels, they keep their value without the excess.
fn for_fit(found: CleanedFrame, frame: &Frame, native: bool) -> CleanedFrame {
    let CleanedFrame { data_e, bad, rejected } = found;
    if native {
        CleanedFrame { data_e: frame.data_e.to_owned(), bad, rejected }
    } else {
        CleanedFrame { data_e, bad: frame.bad.to_owned(), rejected }
    }
}

/// A cube of images without its outlier pixels.
pub struct CleanedImages {
    /// Electrons, `[image, y, x]`; of an outlier, without its excess.
    pub images_e: Array3<f64>,
    /// Number of outlier pixels in each image.
    pub rejected_pixels: Vec<usize>,
}

/// Subtracts the excess of outlier pixels from images of `scene` (`[image, y, x]`); `None` where there are none.
///
/// # Errors
/// Those of reading the filter.
pub fn reject_outliers(
    scene: &Scene,
    images_e: &Array3<f64>,
    bad: &Array3<bool>,
    read_noise_e: Option<f64>,
) -> Result<Option<CleanedImages>> {
    let Some(finder) = OutlierFinder::new(scene, &Filter::new(scene)?) else { return Ok(None) };
    let read_noise_e = read_noise_e.or(scene.image.read_noise_e);
    let find = |image: usize| -> Option<(Array2<f64>, usize)> {
        let (data_e, bad) = (images_e.index_axis(Axis(0), image), bad.index_axis(Axis(0), image));
        finder.clean(Frame { data_e, bad, read_noise_e }).map(|found| (found.data_e, found.rejected))
    };
    let found: Vec<Option<(Array2<f64>, usize)>> = (0..images_e.dim().0).into_par_iter().map(find).collect();
    if found.iter().all(Option::is_none) {
        return Ok(None);
    }
    let mut cleaned = CleanedImages { images_e: images_e.clone(), rejected_pixels: vec![0; found.len()] };
    for (image, (data_e, rejected)) in found.into_iter().enumerate().filter_map(|(image, found)| Some((image, found?)))
    {
        cleaned.images_e.index_axis_mut(Axis(0), image).assign(&data_e);
        cleaned.rejected_pixels[image] = rejected;
    }
    Ok(Some(cleaned))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[ignore = "merge: 23 s"]
    fn a_cube_is_cleaned_image_by_image() {
        let settings = [("image.count", "3"), ("image.pixels", "132"), ("pupil.samples", "64")];
        let scene = Scene::preset("keck-artificial").unwrap().with(&settings).unwrap();
        let clean_e = crate::source::simulate(&scene).unwrap().images_e;
        let bad = clean_e.mapv(|_| false);
        assert!(reject_outliers(&scene, &clean_e, &bad, None).unwrap().is_none());
        let mut images_e = clean_e.clone();
        images_e[[1, 50, 60]] += 1e6;
        let found = reject_outliers(&scene, &images_e, &bad, None).unwrap().unwrap();
        assert_eq!(found.rejected_pixels, [0, 1, 0]);
        assert!(found.images_e.index_axis(Axis(0), 2) == clean_e.index_axis(Axis(0), 2));
        // The excess is subtracted up to its own photon noise, 1e3, and a share of the light.
        assert!((found.images_e[[1, 50, 60]] - clean_e[[1, 50, 60]]).abs() < 5e3);
    }
}

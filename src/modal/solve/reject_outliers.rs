//! Outliers of frames whose sampling is reduced for the fit, which smears them: a frame that the
//! model does not explain, or of which the fit has rejected pixels, is searched for outliers at its
//! own sampling and fitted again without them. A fit at the native sampling rejects them itself
//! ([`crate::modal::prepare::rejection`]).

use crate::Result;
use crate::imaging::Chain;
use crate::modal::assess::status::{ImageReport, Status};
use crate::modal::fitter::ModalFitter;
use crate::modal::prepare::Frame;
use crate::modal::prepare::outliers::{CleanedFrame, OutlierFinder};
use crate::modal::prepare::rejected::RejectedPixels;
use crate::modal::solve::engine::{FitTask, ImageFit};
use crate::modal::solve::fit_series::{FitSeries, SeriesStep, WITHOUT_OUTLIERS};
use crate::scene::System;
use crate::telescope::Filter;
use ndarray::{Array3, Axis};
use rayon::prelude::*;

impl ModalFitter {
    /// Searches for outlier pixels in those of `frames` that may have some, fits these again
    /// without them, and keeps the better fit. Returns the cleaned frames of the fits that were
    /// replaced.
    ///
    /// # Errors
    /// As [`crate::modal::solve::engine::fit`].
    pub(in crate::modal) fn reject_outliers(
        &self,
        chain: &mut Chain,
        task: &FitTask,
        frames: &[Frame],
        fits: &mut [ImageFit],
        series: Option<&mut FitSeries>,
    ) -> Result<Vec<Option<CleanedFrame>>> {
        let mut cleaned: Vec<Option<CleanedFrame>> = frames.iter().map(|_| None).collect();
        if !self.recipe.search_outliers || self.fits_native_pixels() {
            return Ok(cleaned);
        }
        let reports = self.reports(fits);
        let may_have_outliers = |report: &ImageReport| report.status != Status::Ok || report.rejected.total() > 0;
        let unexplained: Vec<usize> =
            (0..fits.len()).filter(|&image| fits[image].is_fitted() && may_have_outliers(&reports[image])).collect();
        if unexplained.is_empty() {
            return Ok(cleaned);
        }
        let finder = OutlierFinder::new(&self.scene, &Filter::new(&self.scene)?);
        let Some(finder) = finder.filter(OutlierFinder::can_predict) else { return Ok(cleaned) };
        let find = |&image: &usize| finder.clean(frames[image]).map(|found| (image, found));
        let found: Vec<(usize, CleanedFrame)> = unexplained.par_iter().filter_map(find).collect();
        let silent = task.control.silent();
        let task = &FitTask { control: &silent, ..*task };
        let empty = ImageFit::new(&self.model.preparation, self.model.optics.modes());
        let mut again = vec![empty; found.len()];
        let without: Vec<Frame> = found.iter().map(|(image, cleaned)| cleaned.frame(&frames[*image])).collect();
        let images: Vec<usize> = found.iter().map(|(image, _)| *image).collect();
        let step = series.map(|series| SeriesStep { series, images: &images, step: WITHOUT_OUTLIERS });
        self.fit_frames(chain, task, &without, &mut again, step)?;
        for ((image, found), mut again) in found.into_iter().zip(again) {
            again.prepared.taken_out = again.prepared.taken_out.and(found.rejected);
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
    /// The cleaned `frame`.
    pub(in crate::modal) fn frame<'a>(&'a self, frame: &'a Frame) -> Frame<'a> {
        Frame { data_e: self.data_e.view(), bad: self.bad.view(), read_noise_e: frame.read_noise_e }
    }
}

/// A cube of images without its outlier pixels.
pub struct CleanedImages {
    /// Electrons, `[image, y, x]`; of an outlier, its prediction from the pixels around it.
    pub images_e: Array3<f64>,
    /// Bad pixels, with the outliers whose predictions are poor.
    pub bad: Array3<bool>,
    /// Outlier pixels of each image.
    pub rejected: Vec<RejectedPixels>,
}

/// Images of `scene` (`[image, y, x]`) without outlier pixels; `None` where there are none.
///
/// # Errors
/// Those of reading the filter.
pub fn reject_outliers(
    scene: &System,
    images_e: &Array3<f64>,
    bad: &Array3<bool>,
    read_noise_e: Option<f64>,
) -> Result<Option<CleanedImages>> {
    let Some(finder) = OutlierFinder::new(scene, &Filter::new(scene)?) else { return Ok(None) };
    let read_noise_e = read_noise_e.or(scene.image.read_noise_e);
    let find = |image: usize| {
        let (data_e, bad) = (images_e.index_axis(Axis(0), image), bad.index_axis(Axis(0), image));
        finder.clean(Frame { data_e, bad, read_noise_e })
    };
    let found: Vec<Option<CleanedFrame>> = (0..images_e.dim().0).into_par_iter().map(find).collect();
    if found.iter().all(Option::is_none) {
        return Ok(None);
    }
    let rejected = found.iter().map(|found| found.as_ref().map(|found| found.rejected).unwrap_or_default()).collect();
    let mut cleaned = CleanedImages { images_e: images_e.clone(), bad: bad.clone(), rejected };
    for (image, found) in found.into_iter().enumerate().filter_map(|(image, found)| Some((image, found?))) {
        cleaned.images_e.index_axis_mut(Axis(0), image).assign(&found.data_e);
        cleaned.bad.index_axis_mut(Axis(0), image).assign(&found.bad);
    }
    Ok(Some(cleaned))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;

    #[test]
    #[ignore = "merge: 23 s"]
    fn a_cube_is_cleaned_image_by_image() {
        let settings = [("image.count", "3"), ("image.pixels", "132"), ("pupil.samples", "64")];
        let scene = Scene::preset("keck-artificial").unwrap().with(&settings).unwrap();
        let clean_e = crate::source::simulate(&scene).unwrap().remove(0).images_e;
        let bad = clean_e.mapv(|_| false);
        assert!(reject_outliers(&scene, &clean_e, &bad, None).unwrap().is_none());
        let mut images_e = clean_e.clone();
        images_e[[1, 50, 60]] += 1e6;
        let found = reject_outliers(&scene, &images_e, &bad, None).unwrap().unwrap();
        assert_eq!(found.rejected.iter().map(RejectedPixels::total).collect::<Vec<_>>(), [0, 1, 0]);
        assert!(found.images_e.index_axis(Axis(0), 2) == clean_e.index_axis(Axis(0), 2));
        // A prediction is within some 1 % of the light, and its noise.
        assert!((found.images_e[[1, 50, 60]] - clean_e[[1, 50, 60]]).abs() < 5e3 && found.bad == bad);
    }
}

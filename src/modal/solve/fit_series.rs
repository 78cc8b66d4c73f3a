//! Fit series: the fits of an image in the order in which they are made, so that an estimate can
//! take those that were made before.
//!
//! The steps of a series are the first fit, that without the outlier pixels, and the restarts. The
//! start of each follows from those before, and nothing else enters but the image: a fit that was
//! made at the same step after the same steps has the same bits. At the first step that the series
//! of an image does not have, its fits are made from there on.

use crate::Result;
use crate::imaging::Chain;
use crate::modal::fitter::ModalFitter;
use crate::modal::prepare::{Frame, PreparedFrame, Preparer, Ringing};
use crate::modal::solve::engine::{self, FitState, FitTask, ImageFit};
use crate::modal::solve::minimum::Minimum;
use rayon::prelude::*;

/// Step of the first fit of an image.
pub(in crate::modal) const FIRST: usize = 0;
/// Step of the fit without outlier pixels. Restart n is n steps after it.
pub(in crate::modal) const WITHOUT_OUTLIERS: usize = 1;

/// Result of one fit of a series.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StoredFit {
    /// 0 for the first fit, 1 for that without outlier pixels, 1 + n for restart n.
    pub(crate) step: usize,
    /// Precision of the chain that it was made on, and whether that was the CPU's: others differ by
    /// rounding.
    pub(crate) chain: String,
    pub(crate) minimum: Minimum,
    /// Weight of each pixel after the last renewal, e⁻².
    pub(crate) weights: Vec<f64>,
}

/// The series of some images, each with the number of its fits that this call has taken or made;
/// others were made before, and not needed yet.
pub(crate) struct FitSeries {
    images: Vec<(Vec<StoredFit>, usize)>,
    made: usize,
}

impl FitSeries {
    /// Series of fits that were made before, of each image in order.
    pub(crate) fn new(images: impl IntoIterator<Item = Vec<StoredFit>>) -> Self {
        Self { images: images.into_iter().map(|fits| (fits, 0)).collect(), made: 0 }
    }

    /// Number of fits that were not there and were made.
    pub(crate) fn made(&self) -> usize {
        self.made
    }

    /// The fits of each image that were taken or made.
    pub(crate) fn into_fits(self) -> impl Iterator<Item = Vec<StoredFit>> {
        self.images.into_iter().map(|(fits, taken)| fits.into_iter().take(taken).collect())
    }

    /// Whether the next fit of `image` is that of `step`, which is then taken; otherwise those that
    /// follow are of no use.
    fn take(&mut self, image: usize, step: usize, chain: &str, (modes, pixels): (usize, usize)) -> bool {
        let (fits, taken) = &mut self.images[image];
        let is_there = fits.get(*taken).is_some_and(|fit| {
            let size = (fit.minimum.coefficients_nm.len(), fit.weights.len());
            fit.step == step && fit.chain == chain && size == (modes, pixels)
        });
        if is_there {
            *taken += 1
        } else {
            fits.truncate(*taken)
        }
        is_there
    }

    fn push(&mut self, image: usize, fit: StoredFit) {
        let (fits, taken) = &mut self.images[image];
        fits.push(fit);
        *taken += 1;
        self.made += 1;
    }
}

/// A step of the fits of `images`, each of which has its place in the series.
pub(in crate::modal) struct SeriesStep<'a> {
    pub(in crate::modal) series: &'a mut FitSeries,
    pub(in crate::modal) images: &'a [usize],
    pub(in crate::modal) step: usize,
}

impl ModalFitter {
    /// Prepares `frames` and fits them, each from the start of its fit; fits that the series have
    /// at this step are taken, others made and added.
    ///
    /// # Errors
    /// As [`engine::fit`].
    pub(in crate::modal) fn fit_frames(
        &self,
        chain: &mut Chain,
        task: &FitTask,
        frames: &[Frame],
        fits: &mut [ImageFit],
        step: Option<SeriesStep>,
    ) -> Result<()> {
        let prepare = |frame: Frame, preparer: &mut Preparer, prepared: &mut PreparedFrame| {
            preparer.prepare(frame, task.recipe, Ringing::Accepted, prepared)
        };
        let Some(SeriesStep { series, images, step }) = step else {
            return engine::fit(chain, task, &|index, by, out| prepare(frames[index], by, out), fits);
        };
        let device = if chain.device_name() == "cpu" { "cpu" } else { "device" };
        let kind = format!("{:?} {device}", chain.precision());
        let size = (self.model.optics.modes(), self.model.preparation.pixels.pow(2));
        let (known, missing): (Vec<usize>, Vec<usize>) =
            (0..fits.len()).partition(|&place| series.take(images[place], step, &kind, size));
        fits.par_iter_mut().enumerate().filter(|(place, _)| known.binary_search(place).is_ok()).for_each_init(
            || Preparer::new(self.model.preparation),
            |preparer, (place, fit)| {
                fit.seconds = 0.0;
                fit.state = match prepare(frames[place], preparer, &mut fit.prepared) {
                    Ok(()) => FitState::Fitted,
                    Err(refusal) => return fit.state = FitState::Refused(refusal),
                };
                let (stored, taken) = &series.images[images[place]];
                let StoredFit { minimum, weights, .. } = &stored[taken - 1];
                fit.minimum.clone_from(minimum);
                fit.prepared.exposure.weight.copy_from_slice(weights);
                crate::modal::prepare::rejection::reject_without_weight(&mut fit.prepared);
            },
        );
        task.control.step(known.len());
        if missing.is_empty() {
            return Ok(());
        }
        let mut own: Vec<ImageFit> = missing.iter().map(|&place| fits[place].clone()).collect();
        let prepare_own = |index: usize, by: &mut Preparer, out: &mut _| prepare(frames[missing[index]], by, out);
        engine::fit(chain, task, &prepare_own, &mut own)?;
        for (&place, own) in missing.iter().zip(own) {
            if own.is_fitted() {
                let (minimum, weights) = (own.minimum.clone(), own.prepared.exposure.weight.clone());
                series.push(images[place], StoredFit { step, chain: kind.clone(), minimum, weights });
            }
            fits[place] = own;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_end_at_the_first_step_that_differs() {
        let fit = |step| StoredFit { step, chain: "F64 cpu".into(), minimum: Minimum::empty(2), weights: vec![1.0; 9] };
        let series = || FitSeries::new([vec![fit(0), fit(2), fit(3)]]);
        let take = |series: &mut FitSeries, steps: &[usize]| -> Vec<bool> {
            steps.iter().map(|step| series.take(0, *step, "F64 cpu", (2, 9))).collect()
        };
        let mut own = series();
        assert_eq!(take(&mut own, &[0, 2, 3, 4]), [true, true, true, false]);
        own.push(0, fit(4));
        assert_eq!((own.made(), own.into_fits().next().unwrap().len()), (1, 4));
        // A step that the series does not have, or has and this call has not, changes the starts of
        // all others.
        assert_eq!(take(&mut series(), &[0, 1, 2]), [true, false, false]);
        assert_eq!(take(&mut series(), &[0, 3]), [true, false]);
        // Of another chain, or another model.
        assert!(!series().take(0, 0, "F32 cpu", (2, 9)) && !series().take(0, 0, "F64 cpu", (2, 8)));
        // What was not taken is not of the call.
        let mut first = series();
        take(&mut first, &[0]);
        assert_eq!(first.into_fits().next().unwrap().len(), 1);
    }
}

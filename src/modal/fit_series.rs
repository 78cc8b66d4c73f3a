//! Fit series: the fits of an image in the order in which they are made, so that an estimate can take those that were made before.
//!
//! The steps of a series are the first fit, that without the outlier pixels, and the restarts. The start of each follows from those
//! before, and nothing else enters but the image: a fit that was made at the same step after the same steps has the same bits. At the first step that
//! the series of an image does not have, its fits are made from there on.

use super::chi2::ReducedChi2;
use super::engine::{self, FitState, FitTask, ImageFit, Watch};
use super::fitter::ModalFitter;
use super::minimum::Minimum;
use super::prepare::{Frame, PreparedFrame, Preparer, Ringing};
use crate::Result;
use crate::imaging::{Chain, Precision};
use crate::optimize::StopReason;
use rayon::prelude::*;

/// Step of the first fit of an image.
pub(super) const FIRST: usize = 0;
/// Step of the fit without outlier pixels. Restart n is n steps after it.
pub(super) const WITHOUT_OUTLIERS: usize = 1;

/// Kinds of chains, whose fits differ by rounding.
pub(crate) const CHAINS: [&str; 4] = ["f32 cpu", "f64 cpu", "f32 device", "f64 device"];

/// Result of one fit of a series.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StoredFit {
    /// 0 for the first fit, 1 for that without outlier pixels, 1 + n for restart n.
    pub(crate) step: usize,
    /// The one of [`CHAINS`] that it was made on.
    pub(crate) chain: &'static str,
    /// Coefficients, nm.
    pub(crate) coefficients_nm: Vec<f64>,
    /// Weight of each pixel after the last renewal, e⁻².
    pub(crate) weights: Vec<f64>,
    pub(crate) evaluations: usize,
    pub(crate) reason: StopReason,
    /// Flux and background, e⁻, and of χ² its value, least expectation, scatter, square of the S/N and degrees of freedom.
    pub(crate) numbers: [f64; 7],
}

impl StoredFit {
    fn of(fit: &ImageFit, step: usize, chain: &'static str) -> Self {
        let Minimum { coefficients_nm, flux_e, background_e, evaluations, reason, chi2, .. } = &fit.minimum;
        let ReducedChi2 { value, least, scatter, square_snr, freedom } = *chi2;
        Self {
            step,
            chain,
            coefficients_nm: coefficients_nm.clone(),
            weights: fit.prepared.exposure.weight.clone(),
            evaluations: *evaluations,
            reason: *reason,
            numbers: [*flux_e, *background_e, value, least, scatter, square_snr, freedom],
        }
    }

    /// Writes the result into `fit`, whose frame is prepared.
    fn write(&self, fit: &mut ImageFit) {
        let [flux_e, background_e, value, least, scatter, square_snr, freedom] = self.numbers;
        fit.prepared.exposure.weight.copy_from_slice(&self.weights);
        fit.minimum = Minimum {
            coefficients_nm: self.coefficients_nm.clone(),
            flux_e,
            background_e,
            evaluations: self.evaluations,
            reason: self.reason,
            chi2: ReducedChi2 { value, least, scatter, square_snr, freedom },
            is_unconfirmed: false,
        };
        fit.state = FitState::Fitted;
    }
}

/// The series of some images: the first `taken` fits of each are of this call, the others were made before and are not needed yet.
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

    /// Drops all fits, for another model.
    pub(crate) fn clear(&mut self) {
        self.images.iter_mut().for_each(|image| *image = (Vec::new(), 0));
    }

    /// The fits of each image that were taken or made.
    pub(crate) fn into_fits(self) -> impl Iterator<Item = Vec<StoredFit>> {
        self.images.into_iter().map(|(mut fits, taken)| {
            fits.truncate(taken);
            fits
        })
    }

    /// The fit of `image` at `step`; without it, what follows is of no use.
    fn take(&mut self, image: usize, step: usize, chain: &str, [modes, pixels]: [usize; 2]) -> bool {
        let (fits, taken) = &mut self.images[image];
        let is_there = fits.get(*taken).is_some_and(|fit| {
            (fit.step, fit.chain) == (step, chain) && (fit.coefficients_nm.len(), fit.weights.len()) == (modes, pixels)
        });
        if is_there {
            *taken += 1
        } else {
            fits.truncate(*taken)
        }
        is_there
    }

    /// The fit of `image` that was taken last.
    fn last(&self, image: usize) -> Option<&StoredFit> {
        let (fits, taken) = &self.images[image];
        fits[..*taken].last()
    }

    fn push(&mut self, image: usize, fit: StoredFit) {
        let (fits, taken) = &mut self.images[image];
        fits.push(fit);
        *taken += 1;
        self.made += 1;
    }
}

/// A step of the fits of `images`, each of which has its place in the series.
pub(super) struct SeriesStep<'a> {
    pub(super) series: &'a mut FitSeries,
    pub(super) images: &'a [usize],
    pub(super) step: usize,
}

impl ModalFitter {
    /// Prepares `frames` and fits them, each from the start of its fit; fits that the series have at this step are taken, others made and
    /// added.
    ///
    /// # Errors
    /// As [`engine::fit`].
    pub(super) fn fit_frames(
        &self,
        chain: &mut Chain,
        task: &FitTask,
        frames: &[Frame],
        fits: &mut [ImageFit],
        step: Option<SeriesStep>,
        watch: &mut Watch,
    ) -> Result<()> {
        let prepare = |frame: Frame, preparer: &mut Preparer, prepared: &mut PreparedFrame| {
            preparer.prepare(frame, task.recipe, Ringing::Accepted, prepared)
        };
        let Some(SeriesStep { series, images, step }) = step else {
            return engine::fit(chain, task, &|index, by, out| prepare(frames[index], by, out), fits, watch);
        };
        let kind = kind_of(chain);
        let size = [self.model.optics.modes(), self.model.preparation.pixels.pow(2)];
        let missing: Vec<usize> =
            (0..fits.len()).filter(|&place| !series.take(images[place], step, kind, size)).collect();
        let is_missing = |place: usize| missing.binary_search(&place).is_ok();
        fits.par_iter_mut().enumerate().filter(|(place, _)| !is_missing(*place)).for_each_init(
            || Preparer::new(self.model.preparation),
            |preparer, (place, fit)| {
                fit.seconds = 0.0;
                match prepare(frames[place], preparer, &mut fit.prepared) {
                    Ok(()) => series.last(images[place]).into_iter().for_each(|known| known.write(fit)),
                    Err(refusal) => fit.state = FitState::Refused(refusal),
                }
            },
        );
        let (taken, all) = (fits.len() - missing.len(), fits.len());
        watch(taken, all);
        if missing.is_empty() {
            return Ok(());
        }
        let mut own: Vec<ImageFit> = missing.iter().map(|&place| fits[place].clone()).collect();
        let prepare_own = |index: usize, by: &mut Preparer, out: &mut _| prepare(frames[missing[index]], by, out);
        engine::fit(chain, task, &prepare_own, &mut own, &mut |done, _| watch(taken + done, all))?;
        for (&place, own) in missing.iter().zip(own) {
            if own.is_fitted() {
                series.push(images[place], StoredFit::of(&own, step, kind));
            }
            fits[place] = own;
        }
        Ok(())
    }
}

/// The one of [`CHAINS`] that `chain` is.
fn kind_of(chain: &Chain) -> &'static str {
    let [f32, f64] = if chain.device_name() == "cpu" { [0, 1] } else { [2, 3] };
    match chain.precision() {
        Precision::F32 => CHAINS[f32],
        Precision::F64 => CHAINS[f64],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fit(step: usize) -> StoredFit {
        let (coefficients_nm, weights, numbers) = (vec![0.0; 2], vec![1.0; 9], [0.0; 7]);
        let reason = StopReason::Unfinished;
        StoredFit { step, chain: CHAINS[1], coefficients_nm, weights, evaluations: 1, reason, numbers }
    }

    #[test]
    fn series_end_at_the_first_step_that_differs() {
        let series = || FitSeries::new([vec![fit(0), fit(2), fit(3)]]);
        let take = |series: &mut FitSeries, steps: &[usize]| -> Vec<bool> {
            steps.iter().map(|step| series.take(0, *step, CHAINS[1], [2, 9])).collect()
        };
        let mut own = series();
        assert_eq!(take(&mut own, &[0, 2, 3, 4]), [true, true, true, false]);
        own.push(0, fit(4));
        assert_eq!((own.made(), own.into_fits().next().unwrap().len()), (1, 4));
        // A step that the series does not have, or has and this call has not, changes the starts of all others.
        assert_eq!(take(&mut series(), &[0, 1, 2]), [true, false, false]);
        assert_eq!(take(&mut series(), &[0, 3]), [true, false]);
        // Of another chain, or another model.
        assert!(!series().take(0, 0, CHAINS[0], [2, 9]) && !series().take(0, 0, CHAINS[1], [2, 8]));
        own = series();
        own.clear();
        assert_eq!(take(&mut own, &[0]), [false]);
        // What was not taken is not of the call.
        let mut first = series();
        take(&mut first, &[0]);
        assert_eq!(first.into_fits().next().unwrap(), [fit(0)]);
    }
}

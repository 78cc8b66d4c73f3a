//! Another try for a fit that ended in the wrong place.
//!
//! From the flat wavefront nearly every image leads to its minimum. What does not shows: its χ² is hundreds of times what
//! noise explains, or the fit has used up its evaluations. It is tried again from elsewhere, and the best is kept.

use super::engine::{FitTask, ImageFit};
use super::fitter::ModalFitter;
use super::minimum::Minimum;
use super::outliers::Cleaned;
use super::prepare::Frame;
use super::status::Status;
use crate::Result;
use crate::imaging::Chain;
use crate::optimize::StopReason;
use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};

/// What another start keeps of where a fit ended, and how far aside it steps, waves RMS a mode. Of 32 draws with pistons of
/// 500 nm behind a defocus of 0.5 and 0.25 waves this brought 28 to the right minimum; 27 with all of the wrong one kept, and
/// then 25 with steps of half the size, 21 of twice the size.
const KEPT: f64 = 0.5;
const SEGMENT_WAVES: f64 = 0.05;
/// See [`SEGMENT_WAVES`].
const NCPA_WAVES: f64 = 0.02;

impl ModalFitter {
    /// Restarts those of `fits` that ended in a wrong minimum, and keeps the better fit. Outlier pixels that were rejected
    /// from a frame stay so.
    ///
    /// # Errors
    /// As [`super::engine::fit`].
    pub(super) fn restart<'a>(
        &self,
        chain: &mut Chain,
        task: &FitTask,
        (frames, cleaned): (&'a [Frame<'a>], &'a [Option<Cleaned>]),
        fits: &mut [ImageFit],
    ) -> Result<()> {
        for attempt in 1..=self.recipe.restarts {
            let reports = self.reports(fits);
            let is_lost = |&image: &usize| fits[image].is_fitted() && is_lost(&reports[image].status);
            let lost: Vec<usize> = (0..fits.len()).filter(is_lost).collect();
            if lost.is_empty() {
                break;
            }
            let without = |&image: &usize| -> Frame<'a> {
                match &cleaned[image] {
                    Some(cleaned) => cleaned.frame(frames[image].read_noise_e),
                    None => frames[image],
                }
            };
            let lost_frames: Vec<Frame> = lost.iter().map(without).collect();
            let from = |&image: &usize| {
                let start_nm = self.start(&fits[image].minimum, attempt);
                ImageFit { start_nm, ..ImageFit::new(&self.model.preparation, self.model.optics.modes()) }
            };
            let mut again: Vec<ImageFit> = lost.iter().map(from).collect();
            self.fit_frames(chain, task, &lost_frames, &mut again, &mut |_, _| {})?;
            for (image, mut again) in lost.into_iter().zip(again) {
                again.prepared.cut_pixels = cleaned[image].as_ref().map_or(0, |cleaned| cleaned.cut);
                fits[image].improve(again);
            }
        }
        Ok(())
    }

    /// Where to begin another time: half way back, and aside. The same steps for every image, so that a fit depends on its own
    /// image alone.
    fn start(&self, minimum: &Minimum, attempt: usize) -> Vec<f64> {
        let mut rng = ChaCha12Rng::seed_from_u64(attempt as u64);
        let wavelength_nm = self.model.optics.parts().wavelength_nm;
        let aside = |(mode, &nm): (usize, &f64)| {
            let waves = if mode < self.model.segment_modes { SEGMENT_WAVES } else { NCPA_WAVES };
            let normal: f64 = StandardNormal.sample(&mut rng);
            let kept = if nm.is_finite() { KEPT * nm } else { 0.0 };
            kept + waves * wavelength_nm * normal
        };
        minimum.coefficients_nm.iter().enumerate().map(aside).collect()
    }
}

/// Whether a fit ended in the wrong place, and another could end elsewhere.
fn is_lost(status: &Status) -> bool {
    match status {
        Status::WrongMinimum => true,
        Status::NotConverged(reason) => *reason == StopReason::EvaluationLimit,
        Status::Ok | Status::Misfit | Status::Unusable(_) => false,
    }
}

//! Restarts of fits that ended in a wrong minimum.
//!
//! From the flat wavefront the fit of nearly every image converges to its minimum. Where it does
//! not, χ² is larger than noise and a finely sampled model explain (which of a faint star is less
//! than what is accepted of a coarser model), or the fit has used up its evaluations. It is then
//! restarted from a perturbed start, and the better fit is kept. A model that is wrong leaves a
//! large χ² too: a misfit of which two restarts end at the same χ² is not restarted again, and one
//! that most images of a sequence share is not restarted at all. Where no restart ends at the same
//! χ², the best fit is a misfit.

use crate::Result;
use crate::imaging::Chain;
use crate::modal::assess::status::{ImageReport, Status};
use crate::modal::combine::sequence::SEQUENCE;
use crate::modal::fitter::ModalFitter;
use crate::modal::prepare::Frame;
use crate::modal::prepare::outliers::CleanedFrame;
use crate::modal::solve::engine::{FitTask, ImageFit};
use crate::modal::solve::fit_series::{FitSeries, SeriesStep, WITHOUT_OUTLIERS};
use crate::optimize::StopReason;
use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};

/// The new start is this share of the end of the last fit plus a random perturbation, waves RMS a
/// mode. Of 32 draws with pistons of 500 nm and a defocus of 0.5 and 0.25 waves 28 then ended in
/// the right minimum; with a share of 1 27, and then 25 with half the perturbation and 21 with
/// twice the perturbation.
const START_SHARE: f64 = 0.5;
const SEGMENT_WAVES: f64 = 0.05;
/// See [`SEGMENT_WAVES`].
const NCPA_WAVES: f64 = 0.02;
/// Two fits of an image whose χ² differ by no more than this share are taken to have ended in one
/// minimum: a fit stops within 0.001 nm of it, where χ² differs by far less.
const SAME_MINIMUM: f64 = 1e-3;
/// Restarts that end in the minimum of a fit before it is taken for the best one. With pistons of
/// 500 nm RMS at a peak S/N of 30, one such restart and restarts from five deviations of χ² on
/// leave 36 of 40 draws in the right minimum; two, and restarts from three deviations on, 38.
pub(in crate::modal) const CONFIRMING: usize = 2;

impl ModalFitter {
    /// Restarts those of `fits` that ended in a wrong minimum, and keeps the better fit. Outlier
    /// pixels that were rejected from a frame stay rejected.
    ///
    /// # Errors
    /// As [`crate::modal::solve::engine::fit`].
    pub(in crate::modal) fn restart<'a>(
        &self,
        chain: &mut Chain,
        task: &FitTask,
        (frames, cleaned): (&'a [Frame<'a>], &'a [Option<CleanedFrame>]),
        fits: &mut [ImageFit],
        mut series: Option<&mut FitSeries>,
    ) -> Result<()> {
        let silent = task.control.silent();
        let task = &FitTask { control: &silent, ..*task };
        let mut confirmed = vec![0; fits.len()];
        for attempt in 1..=self.recipe.restarts {
            let failed = self.failed(fits, &confirmed);
            if failed.is_empty() {
                return Ok(());
            }
            let without = |&image: &usize| -> Frame<'a> {
                match &cleaned[image] {
                    Some(cleaned) => cleaned.frame(&frames[image]),
                    None => frames[image],
                }
            };
            let failed_frames: Vec<Frame> = failed.iter().map(without).collect();
            let from = |&image: &usize| {
                let start_nm = self.perturbed_start(&fits[image].minimum.coefficients_nm, attempt);
                ImageFit { start_nm, ..ImageFit::new(&self.model.preparation, self.model.optics.modes()) }
            };
            let mut again: Vec<ImageFit> = failed.iter().map(from).collect();
            let step = series.as_deref_mut();
            let step = step.map(|series| SeriesStep { series, images: &failed, step: WITHOUT_OUTLIERS + attempt });
            self.fit_frames(chain, task, &failed_frames, &mut again, step)?;
            for (image, mut again) in failed.into_iter().zip(again) {
                if let Some(cleaned) = &cleaned[image] {
                    again.prepared.taken_out = again.prepared.taken_out.and(cleaned.rejected);
                }
                let [before, after] = [&fits[image], &again].map(|fit| fit.minimum.reduced_chi2());
                if is_same_minimum(after, before) {
                    // The first fit is kept: the other may differ from it by whole wavelengths of
                    // pistons.
                    confirmed[image] += 1;
                    fits[image].minimum.evaluations += again.minimum.evaluations;
                } else if fits[image].improve(again) {
                    confirmed[image] = 0;
                }
            }
        }
        if self.recipe.restarts > 0 {
            for image in self.failed(fits, &confirmed).into_iter().filter(|&image| confirmed[image] == 0) {
                fits[image].minimum.is_unconfirmed = true;
            }
        }
        Ok(())
    }

    /// The images whose fits need a restart, and have not ended in the same minimum again
    /// [`CONFIRMING`] times.
    fn failed(&self, fits: &[ImageFit], confirmed: &[usize]) -> Vec<usize> {
        let reports = self.reports(fits);
        let misfits = can_restart_misfits(&reports);
        let is_failed = |&image: &usize| {
            fits[image].is_fitted() && confirmed[image] < CONFIRMING && needs_restart(&reports[image], misfits)
        };
        (0..fits.len()).filter(is_failed).collect()
    }

    /// Perturbed start after a fit that ended at `coefficients_nm`. The perturbation is the same
    /// for every image, so that a fit depends on its own image alone.
    pub(crate) fn perturbed_start(&self, coefficients_nm: &[f64], attempt: usize) -> Vec<f64> {
        let mut rng = ChaCha12Rng::seed_from_u64(attempt as u64);
        let wavelength_nm = self.model.optics.parts().wavelength_nm;
        let perturbed = |(mode, &nm): (usize, &f64)| {
            let waves = if mode < self.model.segment_modes { SEGMENT_WAVES } else { NCPA_WAVES };
            let normal: f64 = StandardNormal.sample(&mut rng);
            let kept = if nm.is_finite() { START_SHARE * nm } else { 0.0 };
            kept + waves * wavelength_nm * normal
        };
        coefficients_nm.iter().enumerate().map(perturbed).collect()
    }
}

/// Whether two fits of an image with these χ² ended in one minimum.
pub(in crate::modal) fn is_same_minimum(one: f64, other: f64) -> bool {
    (one - other).abs() <= SAME_MINIMUM * other
}

/// Whether misfits may be restarted: unless most of a sequence misfit, which is the model's or the
/// turbulence's doing.
fn can_restart_misfits(reports: &[ImageReport]) -> bool {
    let misfits = reports.iter().filter(|report| report.reduced_chi2 > report.expected_chi2).count();
    reports.len() < SEQUENCE || 2 * misfits < reports.len()
}

/// Whether a fit probably ended in a wrong minimum, so that another start could lead to a better
/// one.
fn needs_restart(report: &ImageReport, misfits: bool) -> bool {
    match report.status {
        Status::WrongMinimum => true,
        Status::Ok | Status::Misfit => misfits && report.reduced_chi2 > report.suspicious_chi2,
        Status::NotConverged(reason) => reason == StopReason::EvaluationLimit,
        Status::Contradictory | Status::Unusable(_) => false,
    }
}

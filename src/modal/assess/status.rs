//! Status of each image: from its own residual, and in a sequence also from those of the others.

use crate::Error;
use crate::modal::assess::chi2::{ReducedChi2, nuisances};
use crate::modal::assess::tilts::Tilts;
use crate::modal::combine::sequence::{SEQUENCE, distances, outliers};
use crate::modal::fitter::ModalFitter;
use crate::modal::model::Model;
use crate::modal::prepare::rejected::RejectedPixels;
use crate::modal::prepare::rejection;
use crate::modal::prepare::{PreparedFrame, Refusal};
use crate::modal::solve::engine::{FitState, ImageFit};
use crate::modal::solve::minimum::Minimum;
use crate::optimize::StopReason;
use crate::scene::Combine;
use ndarray::{Array2, Axis};

/// Whether an image was fitted, and how well.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Status {
    /// Fitted, and the model explains it.
    Ok,
    /// Fitted, but the residual is larger than the noise (the modes do not span the wavefront, or
    /// the model is wrong), or smaller (the image is not in electrons, was smoothed or averaged, or
    /// its stated noise is too large): χ² is outside [`ImageReport::explained_chi2`]. Where it is
    /// larger, error bars are scaled up by √χ²; those of a sequence are from the scatter between
    /// its images.
    Misfit,
    /// The residual is so large that the fit is probably in a wrong minimum. Among eight images or
    /// more it must also be an outlier: turbulence that the modes do not span leaves the same
    /// residual in every image.
    WrongMinimum,
    /// Of an estimate alone: its images are of several wavefronts, so that their mean is of none.
    Contradictory,
    /// The optimiser stopped before it converged.
    NotConverged(StopReason),
    /// The image could not be used.
    Unusable(Refusal),
}

impl Status {
    /// Whether the fit converged to a minimum.
    pub(in crate::modal) fn has_converged(&self) -> bool {
        matches!(self, Status::Ok | Status::Misfit | Status::WrongMinimum)
    }

    /// Whether the fit ended near the right minimum, so that a linear step from there has a
    /// meaning.
    pub(crate) fn is_near_minimum(&self) -> bool {
        matches!(self, Status::Ok | Status::Misfit | Status::Contradictory)
    }

    /// The word in files and JSON.
    pub fn word(&self) -> &'static str {
        match self {
            Status::Ok => "ok",
            Status::Misfit => "misfit",
            Status::WrongMinimum => "wrong-minimum",
            Status::Contradictory => "contradictory",
            Status::NotConverged(_) => "not-converged",
            Status::Unusable(_) => "unusable",
        }
    }

    /// Place among the statuses, from the best; the reason does not count.
    pub(in crate::modal) fn rank(&self) -> usize {
        match self {
            Status::Ok => 0,
            Status::Misfit => 1,
            Status::WrongMinimum => 2,
            Status::Contradictory => 3,
            Status::NotConverged(_) => 4,
            Status::Unusable(_) => 5,
        }
    }

    /// The worst of some statuses; ok for none.
    pub(crate) fn worst<'a>(statuses: impl Iterator<Item = &'a Self>) -> &'a Self {
        statuses.max_by_key(|status| status.rank()).unwrap_or(&Status::Ok)
    }
}

/// Standard deviations of χ² from its expectation at which a fit is called a misfit. With 9,000
/// pixels one is 0.015. A right model is beyond five in one of three million images.
const SIGNIFICANT: f64 = 5.0;
/// Standard deviations at which another minimum is looked for, which costs a fit: a right one of
/// 1,000 is beyond. A minimum with a segment half a wave off has 1.08 to 1.15 at a peak S/N of 30,
/// five to ten standard deviations.
const SUSPICIOUS: f64 = 3.0;
/// Relative error of the band-limited model, RMS: a bound of what χ² shows on nominal scenes of
/// `keck-artificial`, whose excess over 1 is 0.04 at a peak S/N of 500 and 0.20 at 1,000 (4e-4 of
/// the signal).
const MODEL_ERROR: f64 = 5e-4;
/// Relative error of a coarser model: 64 samples across seven segments have an excess of 0.08 at a
/// peak S/N of 100 (3e-3 of the signal).
const COARSE_MODEL_ERROR: f64 = 4e-3;
/// Largest excess of χ² over its expectation that is put down to a coarser model, and to any model:
/// beyond, it is not good enough for the light. Up to the second error bars scaled by √χ² are
/// within 15 % of those of the noise.
const MODEL_EXCESS: [f64; 2] = [0.1, 0.3];
/// Least fraction of the expectation that is accepted. It matters only for a handful of photons,
/// whose χ² scatters by more than its expectation; an image that was normalised to a sum of 1 has
/// 1e-9 of it or less.
const LEAST_FRACTION: f64 = 0.01;
/// Reduced χ² above which a wrong minimum is suspected: a basis that misses part of the NCPA gives
/// 17 at a peak SNR of 500, wrong minima 900 to 5,000.
pub(in crate::modal) const WRONG_MINIMUM: f64 = 300.0;

/// Least square of a star's signal-to-noise ratio over all pixels, per parameter of the fit. In a
/// linear fit pure noise reaches 1; a nonlinear fit finds the aberrations whose image is most
/// similar to the noise, and reaches 7 to 8 (Keck, 149 parameters). A star of a peak S/N of 5 has
/// 200 there.
const FAINT: f64 = 12.0;

/// The interval in which the model explains a χ².
fn explained(chi2: &ReducedChi2) -> [f64; 2] {
    let least = (chi2.least - SIGNIFICANT * chi2.scatter).max(LEAST_FRACTION * chi2.least);
    let coarse = chi2.excess(COARSE_MODEL_ERROR).min(MODEL_EXCESS[0]);
    let excess = chi2.excess(MODEL_ERROR).clamp(coarse, MODEL_EXCESS[1]);
    [least, 1.0 + excess + SIGNIFICANT * chi2.scatter]
}

/// The χ² that noise at `deviations` standard deviations and the band-limited model explain.
fn expected(chi2: &ReducedChi2, deviations: f64) -> f64 {
    1.0 + chi2.excess(MODEL_ERROR) + deviations * chi2.scatter
}

/// How far χ² is above what the band-limited model explains, and its standard deviation.
pub(in crate::modal) fn suspicion(chi2: &ReducedChi2) -> (f64, f64) {
    (chi2.value - expected(chi2, 0.0), chi2.scatter)
}

/// The report on one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImageReport {
    /// Status.
    pub status: Status,
    /// Evaluations of objective and gradient; of a MAP retrieval, in its last iteration.
    pub evaluations: usize,
    /// χ² per degree of freedom; NaN for an image that could not be used.
    pub reduced_chi2: f64,
    /// Smallest and largest χ² per degree of freedom that noise explains; NaN for an image that no
    /// modes were fitted to.
    pub explained_chi2: [f64; 2],
    /// Largest χ² per degree of freedom that noise and the error of a finely sampled model explain.
    pub(crate) expected_chi2: f64,
    /// χ² per degree of freedom above which another minimum is looked for.
    pub(crate) suspicious_chi2: f64,
    /// Electrons of the star.
    pub flux_e: f64,
    /// Background, electrons per pixel of the frame.
    pub background_e: f64,
    /// Tilt of the fitted wavefront and of the shift onto the axis, along x and y, nm RMS over the
    /// pupil; NaN for an image that no modes were fitted to.
    pub tip_tilt_nm: [f64; 2],
    /// Number of bad pixels of the fitted part.
    pub bad_pixels: usize,
    /// Outlier pixels of the frame that were rejected.
    pub rejected: RejectedPixels,
}

impl ImageReport {
    /// The report on an image that was not fitted.
    pub(crate) fn unfitted(status: Status) -> Self {
        Self {
            status,
            evaluations: 0,
            reduced_chi2: f64::NAN,
            explained_chi2: [f64::NAN; 2],
            expected_chi2: f64::NAN,
            suspicious_chi2: f64::NAN,
            flux_e: f64::NAN,
            background_e: f64::NAN,
            tip_tilt_nm: [f64::NAN; 2],
            bad_pixels: 0,
            rejected: RejectedPixels::default(),
        }
    }

    /// Whether χ² is smaller than noise explains.
    pub fn is_too_small(&self) -> bool {
        self.reduced_chi2 < self.explained_chi2[0]
    }

    /// The status and its reason, as a sentence.
    pub fn sentence(&self) -> String {
        let chi2 = self.reduced_chi2;
        match self.status {
            Status::Ok => format!("the model explains the image: reduced chi-square {chi2:.3}"),
            Status::Misfit => {
                let [least, most] = self.explained_chi2;
                let than = if chi2 < least { "smaller" } else { "larger" };
                format!(
                    "the residual is {than} than the noise: reduced chi-square {}, where {least:.3} to {most:.3} is explained",
                    significant(chi2)
                )
            }
            Status::WrongMinimum => format!(
                "the fit is probably in a wrong minimum: reduced chi-square {chi2:.0}, where up to {WRONG_MINIMUM} is \
                 plausible"
            ),
            Status::Contradictory => "the images are of several wavefronts".into(),
            Status::NotConverged(reason) => {
                format!("the fit did not converge in {} evaluations: {reason}", self.evaluations)
            }
            Status::Unusable(refusal) => refusal.to_string(),
        }
    }
}

/// Three decimals, or an exponent where they would all be 0.
fn significant(chi2: f64) -> String {
    if chi2 < 1e-3 { format!("{chi2:.0e}") } else { format!("{chi2:.3}") }
}

impl ModalFitter {
    /// The reports on fits, in order.
    pub(in crate::modal) fn reports(&self, fits: &[ImageFit]) -> Vec<ImageReport> {
        let report = |fit: &ImageFit| match fit.state {
            FitState::Fitted => assess(&self.model, &self.tilts, &fit.prepared, &fit.minimum),
            FitState::Refused(refusal) => ImageReport::unfitted(Status::Unusable(refusal)),
            FitState::NotBegun => ImageReport::unfitted(Status::NotConverged(StopReason::Unfinished)),
        };
        let mut reports: Vec<ImageReport> = fits.iter().map(report).collect();
        assess_together(&mut reports);
        reports
    }
}

/// The reports on the minima of `prepared`.
pub(in crate::modal) fn assess_all(
    fitter: &ModalFitter,
    prepared: &[PreparedFrame],
    minima: &[Minimum],
) -> Vec<ImageReport> {
    let pairs = prepared.iter().zip(minima);
    let mut reports: Vec<ImageReport> =
        pairs.map(|(prepared, minimum)| assess(&fitter.model, &fitter.tilts, prepared, minimum)).collect();
    assess_together(&mut reports);
    reports
}

/// Corrects the statuses of a sequence: a large residual that all images share is from turbulence
/// that the modes do not span; only an outlier is a wrong minimum.
pub(in crate::modal) fn assess_together(reports: &mut [ImageReport]) {
    let converged: Vec<usize> = (0..reports.len()).filter(|&i| reports[i].status.has_converged()).collect();
    if converged.len() < SEQUENCE {
        return;
    }
    let chi2: Vec<f64> = converged.iter().map(|&i| reports[i].reduced_chi2).collect();
    for (&i, outlier) in converged.iter().zip(outliers(&chi2)) {
        if reports[i].status == Status::WrongMinimum && !outlier {
            reports[i].status = Status::Misfit;
        }
    }
}

/// Assesses one minimum by itself. `tilts` are the slopes of each mode.
pub(in crate::modal) fn assess(
    model: &Model,
    tilts: &Tilts,
    prepared: &PreparedFrame,
    minimum: &Minimum,
) -> ImageReport {
    let reduced_chi2 = minimum.reduced_chi2();
    let [expected_chi2, suspicious_chi2] = [SIGNIFICANT, SUSPICIOUS].map(|limit| expected(&minimum.chi2, limit));
    let mut explained_chi2 = explained(&minimum.chi2);
    if minimum.is_unconfirmed {
        explained_chi2[1] = explained_chi2[1].min(expected_chi2);
    }
    let parameters = model.optics.modes().div_ceil(minimum.images) + nuisances(&prepared.exposure);
    let snr = minimum.chi2.square_snr.sqrt();
    let least_snr = (FAINT * parameters as f64).sqrt();
    let status = match minimum.reason {
        _ if minimum.flux_e < 0.0 => Status::Unusable(Refusal::NegativeStar { flux_e: minimum.flux_e }),
        // Where χ² is too small the noise is not what is stated, and tells nothing.
        _ if snr < least_snr && reduced_chi2 >= explained_chi2[0] => {
            Status::Unusable(Refusal::FaintStar { snr, least_snr })
        }
        reason if !reason.has_converged() && reason != StopReason::NoDescent => Status::NotConverged(reason),
        _ if reduced_chi2 > WRONG_MINIMUM => Status::WrongMinimum,
        _ if reduced_chi2 < explained_chi2[0] || reduced_chi2 > explained_chi2[1] => Status::Misfit,
        _ => Status::Ok,
    };
    ImageReport {
        status,
        evaluations: minimum.evaluations,
        reduced_chi2,
        explained_chi2,
        expected_chi2,
        suspicious_chi2,
        flux_e: minimum.flux_e,
        background_e: minimum.background_e / model.preparation.native_pixels(),
        tip_tilt_nm: tilts.tip_tilt_nm(&minimum.coefficients_nm, prepared.shift_pixels),
        bad_pixels: prepared.bad_pixels,
        rejected: rejection::kinds(prepared, &model.preparation),
    }
}

/// Images that are combined, and images that the clipped mean leaves out; as places in the list
/// that was given.
pub(in crate::modal) struct Selection {
    pub(in crate::modal) used: Vec<usize>,
    pub(in crate::modal) clipped: Vec<usize>,
}

impl Selection {
    /// Selects among images with these reports and coefficients (`[image, mode]`, in the order of
    /// the reports).
    ///
    /// Of up to seven images that converged, those with the best kind of status are used in every
    /// combination. From eight on, all that converged are used; a clipped mean leaves out outliers
    /// of χ² and of the coefficients.
    pub(in crate::modal) fn new(reports: &[&ImageReport], coefficients_nm: &Array2<f64>, how: Combine) -> Self {
        let converged: Vec<usize> = (0..reports.len()).filter(|&i| reports[i].status.has_converged()).collect();
        if converged.len() < SEQUENCE {
            return Self { used: best_kind(reports), clipped: Vec::new() };
        }
        if how != Combine::ClippedMean {
            return Self { used: converged, clipped: Vec::new() };
        }
        let chi2: Vec<f64> = converged.iter().map(|&i| reports[i].reduced_chi2).collect();
        let distances = distances(&coefficients_nm.select(Axis(0), &converged));
        let out = outliers(&chi2).into_iter().zip(outliers(&distances)).map(|(chi2, distance)| chi2 || distance);
        let (clipped, used): (Vec<_>, Vec<_>) = converged.into_iter().zip(out).partition(|(_, out)| *out);
        let places = |pairs: Vec<(usize, bool)>| pairs.into_iter().map(|(place, _)| place).collect();
        Self { used: places(used), clipped: places(clipped) }
    }
}

/// The error where no image was fitted.
pub(in crate::modal) fn nothing_fitted(reports: &[&ImageReport]) -> Error {
    let reason = match reports.first().map(|report| &report.status) {
        Some(Status::NotConverged(reason)) => reason.to_string(),
        Some(Status::Unusable(refusal)) => refusal.to_string(),
        Some(other) => other.word().into(),
        None => "there is none".into(),
    };
    Error::Image(format!("no image could be fitted: {reason}"))
}

/// Which of a few fits are used: those that converged to a plausible minimum; where there is none,
/// suspected wrong minima; where none converged, those with a finite χ². Their status tells them
/// apart.
fn best_kind(reports: &[&ImageReport]) -> Vec<usize> {
    let rank = |report: &ImageReport| match report.status {
        Status::Ok | Status::Misfit => Some(0),
        Status::WrongMinimum => Some(1),
        Status::NotConverged(_) if report.reduced_chi2.is_finite() => Some(2),
        Status::Contradictory | Status::NotConverged(_) | Status::Unusable(_) => None,
    };
    let Some(best) = reports.iter().filter_map(|report| rank(report)).min() else { return Vec::new() };
    reports.iter().enumerate().filter(|(_, report)| rank(report) == Some(best)).map(|(i, _)| i).collect()
}

//! Outcome of each image of an estimate.

use crate::modal::{ImageReport, ImageStatus, RejectedPixels};

/// Outcome of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageOutcome {
    /// Whether it was fitted, and how well.
    pub status: ImageStatus,
    /// The channel that it is of, a place in [`Estimate::channels`](super::Estimate::channels); 0 without channels.
    pub channel: usize,
    /// Why it has this status, in a sentence.
    pub message: String,
    /// Whether it was combined into the estimate.
    pub is_used: bool,
    /// Whether it was fitted and then left out as an outlier among the images.
    pub is_clipped: bool,
    /// Evaluations of objective and gradient; of a MAP retrieval, in its last iteration.
    pub evaluations: usize,
    /// χ² per degree of freedom; NaN for an image that could not be used.
    pub reduced_chi2: f64,
    /// Electrons of the star.
    pub flux_e: f64,
    /// Background, electrons per pixel of the frame.
    pub background_e: f64,
    /// Tip and tilt of the fitted wavefront, and of the shift onto the axis, nm RMS over the pupil along x and y; NaN in a
    /// MAP estimate.
    pub tip_tilt_nm: [f64; 2],
    /// Pixels of the fitted part that were marked bad.
    pub bad_pixels: usize,
    /// Outlier pixels that were found and rejected.
    pub rejected: RejectedPixels,
}

impl ImageOutcome {
    pub(super) fn from_modal(report: &ImageReport, is_used: bool, is_clipped: bool) -> Self {
        Self {
            channel: 0,
            status: report.status.kind(),
            message: report.sentence(),
            is_used,
            is_clipped,
            evaluations: report.evaluations,
            reduced_chi2: report.reduced_chi2,
            flux_e: report.flux_e,
            background_e: report.background_e,
            tip_tilt_nm: report.tip_tilt_nm,
            bad_pixels: report.bad_pixels,
            rejected: report.rejected,
        }
    }
}

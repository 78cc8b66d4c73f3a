//! Outcome of each image of an estimate.

use crate::modal::ImageReport;

/// Outcome of one image.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageOutcome {
    /// Whether it was fitted, and how well.
    pub report: ImageReport,
    /// The channel that it is of, a place in [`Estimate::channels`](super::Estimate::channels); 0
    /// without channels.
    pub channel: usize,
    /// Why it has its status, in a sentence.
    pub message: String,
    /// Whether it was combined into the estimate.
    pub is_used: bool,
    /// Whether it was fitted and then left out as an outlier among the images.
    pub is_clipped: bool,
}

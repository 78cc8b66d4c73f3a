//! Minimum: result of the fit of one image.

use crate::modal::assess::chi2::ReducedChi2;
use crate::optimize::StopReason;

/// The minimum of one image.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Minimum {
    pub(crate) coefficients_nm: Vec<f64>,
    pub(crate) flux_e: f64,
    pub(crate) background_e: f64,
    pub(crate) evaluations: usize,
    pub(crate) reason: StopReason,
    /// χ² per degree of freedom under the variances of the fitted model.
    pub(crate) chi2: ReducedChi2,
    /// Number of images that share the modes: 1 but in a fit of several together.
    pub(crate) images: usize,
    /// Whether χ² is larger than expected, and every restart ended in another minimum: this one is
    /// probably wrong, too.
    pub(crate) is_unconfirmed: bool,
}

impl Minimum {
    /// χ² per degree of freedom under the variances of the fitted model.
    pub(in crate::modal) fn reduced_chi2(&self) -> f64 {
        self.chi2.value
    }

    /// An empty minimum of `modes` coefficients, to be written by a fit.
    pub(crate) fn empty(modes: usize) -> Self {
        Self {
            coefficients_nm: vec![0.0; modes],
            flux_e: f64::NAN,
            background_e: f64::NAN,
            evaluations: 0,
            reason: StopReason::Unfinished,
            chi2: ReducedChi2::NONE,
            images: 1,
            is_unconfirmed: false,
        }
    }
}

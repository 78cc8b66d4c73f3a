//! Fits of a cube of images, before they are combined.

use crate::modal::assess::status::{ImageReport, Status, assess_all};
use crate::modal::fitter::ModalFitter;
use crate::modal::prepare::{PreparedFrame, Refusal};
use crate::modal::solve::engine::{FitState, ImageFit};
use crate::modal::solve::minimum::Minimum;
use crate::optimize::StopReason;
use ndarray::{Array2, ArrayView1};

/// Coefficients and report of each image; see [`ModalFitter::fit_each`].
#[derive(Debug, Clone)]
pub struct ImageFits {
    /// `[image, mode]`, nm, pistons about their mean over the pupil; NaN for images that cannot be
    /// used.
    pub coefficients_nm: Array2<f64>,
    /// Report of each image, in order.
    pub reports: Vec<ImageReport>,
}

/// Fits of a cube of images.
pub(in crate::modal) struct FittedCube {
    /// For each image, why it could not be used.
    refused: Vec<Option<Refusal>>,
    /// The images that were fitted.
    pub(in crate::modal) indices: Vec<usize>,
    pub(in crate::modal) prepared: Vec<PreparedFrame>,
    pub(in crate::modal) minima: Vec<Minimum>,
}

impl FittedCube {
    pub(in crate::modal) fn from_fits(fits: Vec<ImageFit>) -> Self {
        let mut fitted = Self { refused: Vec::new(), indices: Vec::new(), prepared: Vec::new(), minima: Vec::new() };
        for (image, fit) in fits.into_iter().enumerate() {
            let refused = match fit.state {
                FitState::Refused(refusal) => Some(refusal),
                FitState::NotBegun | FitState::Fitted => None,
            };
            fitted.refused.push(refused);
            if fit.is_fitted() {
                fitted.indices.push(image);
                fitted.prepared.push(fit.prepared);
                fitted.minima.push(fit.minimum);
            }
        }
        fitted
    }

    /// Coefficients and reports of all images, once the minima have their pistons about the mean.
    pub(in crate::modal) fn assess(&mut self, fitter: &ModalFitter) -> ImageFits {
        let Self { refused, indices, prepared, minima } = self;
        minima.iter_mut().for_each(|minimum| fitter.motions.remove(&mut minimum.coefficients_nm));
        // Reports of images that were not fitted first; those of fitted images then take their
        // places.
        let unfitted = |refused: &Option<Refusal>| {
            ImageReport::unfitted(refused.map_or(Status::NotConverged(StopReason::Unfinished), Status::Unusable))
        };
        let mut reports: Vec<ImageReport> = refused.iter().map(unfitted).collect();
        let mut coefficients_nm = Array2::from_elem((reports.len(), fitter.model.optics.modes()), f64::NAN);
        let assessed = assess_all(fitter, prepared, minima);
        for ((&image, minimum), report) in indices.iter().zip(minima).zip(assessed) {
            reports[image] = report;
            coefficients_nm.row_mut(image).assign(&ArrayView1::from(&minimum.coefficients_nm));
        }
        ImageFits { coefficients_nm, reports }
    }
}

//! Coefficients of the static wavefront with their covariance.

use ndarray::{Array2, ArrayView2};

/// Modes of the static wavefront.
#[derive(Debug, Clone)]
pub struct CombinedModes {
    /// Every mode, nm; pistons have zero mean over the pupil.
    pub coefficients_nm: Vec<f64>,
    /// Its covariance, nm².
    pub covariance_nm2: Array2<f64>,
}

impl CombinedModes {
    /// Standard deviation of each mode, nm.
    pub fn sigma_nm(&self) -> Vec<f64> {
        sigma_nm(self.covariance_nm2.view())
    }
}

/// Standard deviation of each mode of a covariance, nm.
pub(crate) fn sigma_nm(covariance_nm2: ArrayView2<f64>) -> Vec<f64> {
    covariance_nm2.diag().iter().map(|nm2| nm2.max(0.0).sqrt()).collect()
}

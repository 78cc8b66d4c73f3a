//! Assessment of a fit: χ² and its expectation, status, the information in an image and the
//! covariance that follows from it.

pub(in crate::modal) mod chi2;
pub(in crate::modal) mod fisher;
pub(in crate::modal) mod image_covariances;
pub(in crate::modal) mod mean_residual;
pub(in crate::modal) mod residual;
pub(in crate::modal) mod status;
pub(in crate::modal) mod tilts;

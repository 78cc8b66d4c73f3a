//! Solution of the fits of a batch of images: engines, optimiser, restarts, and the order in which
//! fits are made.

pub(in crate::modal) mod engine;
pub(in crate::modal) mod fit_series;
pub(in crate::modal) mod gauss_newton;
pub(in crate::modal) mod metrics;
pub(in crate::modal) mod minimum;
pub(in crate::modal) mod reject_outliers;
pub(in crate::modal) mod restart;
pub(in crate::modal) mod runner;

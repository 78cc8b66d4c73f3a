//! Artificial source (the paper's section 3): simulated images of a point source with known
//! aberrations, photon and read noise.
//!
//! The truth is computed on a finer grid than an estimator's, with the exact area of each segment
//! in each sample. So the simulation does not share the estimator's discretisation errors.

mod camera;
pub(crate) mod file;
mod images;
mod pixels;
mod random;
mod truth;

pub use camera::{Camera, expose, flux_e};
pub use file::write;
pub use images::{ChangeOfTruth, SourceImages, simulate, simulate_with};
pub(crate) use pixels::DetectorPixels;
pub use random::stream;
pub use truth::Truth;

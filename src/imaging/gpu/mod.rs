//! The forward model and its adjoint on an OpenCL device: a whole batch of images per call, with only coefficients going
//! up and objectives, gradients and photometry coming down.
//!
//! The stages are those of `kernels/`: `field.cl` (coefficients to pupil field), `transform.cl` (pupil to focus as two
//! folded real matrix products, and back), `pixels.cl` (photometry, objective, residuals), `project.cl` (pupil field to
//! gradient). On a processor `focus.cl` joins all but the products over modes into one kernel that carries an image from
//! its phase to its slopes in one core's cache, and `fft.cl` does so with an FFT where the image is whole (as many pixels as
//! the padded pupil has samples, a product of two of 8, 12, 15, 16 and 20). A batch goes through them in tiles.
//!
//! Vectors make some sizes cheaper than others: in f32 with 16 numbers to a vector, m/2 and n/2 are padded to multiples of
//! 16, so that an image of 96 pixels costs what 66 to 94 do.
//!
//! Without the feature `opencl` the same names are here, and [`GpuChain`] cannot be made.

mod layout;

#[cfg(feature = "opencl")]
mod bind;
#[cfg(feature = "opencl")]
mod chain;
#[cfg(feature = "opencl")]
mod fold;
#[cfg(feature = "opencl")]
mod folded;
#[cfg(feature = "opencl")]
mod memory;
#[cfg(feature = "opencl")]
mod room;
#[cfg(feature = "opencl")]
mod stages;
#[cfg(all(test, feature = "opencl"))]
mod tests;

#[cfg(not(feature = "opencl"))]
mod absent;

#[cfg(not(feature = "opencl"))]
pub use absent::GpuChain;
#[cfg(feature = "opencl")]
pub use chain::GpuChain;
pub use layout::{GpuLayout, GpuMode};

/// How the flux and background of an image are found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GpuPhotometry {
    /// Both known, electrons.
    Known {
        /// Flux, electrons.
        flux_e: f64,
        /// Background, electrons per pixel.
        background_e: f64,
    },
    /// The flux that minimises the objective over a known background.
    FitFlux {
        /// Background, electrons per pixel.
        background_e: f64,
    },
    /// The flux and background that minimise the objective.
    FitBoth,
}

/// One evaluation of a batch; every list is in the order of the active images.
#[derive(Debug, Clone, PartialEq)]
pub struct GpuEvaluation {
    /// J = Σ w (flux·h + background − d)².
    pub objective: Vec<f64>,
    /// dJ/d(coefficient), `[image][mode]`, per nm.
    pub gradient: Vec<f64>,
    /// Flux, electrons.
    pub flux_e: Vec<f64>,
    /// Background, electrons per pixel.
    pub background_e: Vec<f64>,
}

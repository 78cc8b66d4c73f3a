//! The forward model and its adjoint on an OpenCL device. One call evaluates a batch of images:
//! coefficients are uploaded; objectives, gradients and photometry are downloaded.
//!
//! The stages are the files of `kernels/`: `field.cl` (coefficients to pupil field), `transform.cl`
//! (pupil to focus as two folded real matrix products, and the adjoint), `pixels.cl` (photometry,
//! objective, residuals), `project.cl` (pupil field to gradient). On a CPU `focus.cl` joins all
//! stages but the products over modes into one kernel, which processes an image in the cache of one
//! core; `fft.cl` does the same with an FFT where the image is whole (as many pixels as the padded
//! pupil has samples, a product of two of 8, 12, 15, 16 and 20). A batch is processed in tiles.
//!
//! Where a model has several wavelengths or pixels with an area, `intensity.cl` takes the place of
//! `pixels.cl`: the fields of all wavelengths are kept, and their intensity is summed and convolved
//! with the response of the pixels. All wavelengths share one phase, in turns of the first, and one
//! gradient by it, so that the products over modes are those of one wavelength.
//!
//! Sizes are padded to whole vectors: in f32 with 16 numbers per vector, m/2 and n/2 are padded to
//! multiples of 16, so that an image of 96 pixels costs as much as one of 66 to 94.
//!
//! Without the feature `opencl` the same names exist, but a [`GpuChain`] cannot be constructed.

mod evaluation;
mod layout;

#[cfg(feature = "opencl")]
mod bind;
#[cfg(feature = "opencl")]
mod budget;
#[cfg(feature = "opencl")]
mod chain;
#[cfg(feature = "opencl")]
mod colours;
#[cfg(feature = "opencl")]
mod fold;
#[cfg(feature = "opencl")]
mod image;
#[cfg(feature = "opencl")]
mod memory;
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
pub use evaluation::{GpuEvaluation, GpuPhotometry};
pub use layout::{GpuColour, GpuLayout, GpuMode};

//! The forward model: from mode coefficients to the objective (χ² of an image) and its exact
//! gradient, stage by stage.
//!
//! ```text
//!  coefficients ──field──▶ pupil field ──fourier──▶ focal field ──detector──▶ objective
//!  gradient     ◀─field── pupil field̄ ◀─fourier── focal field̄ ◀─detector──┘
//! ```
//!
//! Each stage has a file with its forward step and its adjoint. [`Chain`] composes them and selects
//! device and precision. The f64 CPU chain is the reference, against which all others are tested.

mod chain;
mod cpu;
mod detector;
mod device_group;
mod field;
pub mod gpu;
mod linear;
mod optics;
mod phasor;
mod pixels;
mod segment_blocks;
mod smooth;
mod work;

pub use crate::fourier::{Real, Sampling, Transform};
pub use chain::{Chain, Choice, Fallback, Precision};
pub use cpu::{CpuChain, FlatWavefront, FreeWavefront, Scratch};
pub use detector::{Evaluation, Exposure, LoadedImage, Photometry};
pub use device_group::{DeviceGroup, GroupMember};
pub use field::SegmentFigure;
pub use linear::LinearModel;
pub use optics::{Colour, Mode, Optics, OpticsParts};
pub use phasor::Polynomial;
pub use work::{EvaluationWork, Shapes};

#[cfg(all(test, feature = "opencl"))]
mod agreement;
#[cfg(test)]
mod tests;

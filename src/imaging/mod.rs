//! From mode coefficients to a likelihood and its exact gradient, stage by stage.
//!
//! ```text
//!  coefficients ──field──▶ pupil field ──fourier──▶ focal field ──detector──▶ objective
//!  gradient     ◀─field── pupil field̄ ◀─fourier── focal field̄ ◀─detector──┘
//! ```
//!
//! Each stage's file holds the forward step and its adjoint side by side; [`Chain`] composes them, and is the only
//! place that knows on which device and in which precision they run. The f64 CPU chain is the judge of all others.

pub mod chain;
pub mod cpu;
mod detector;
mod fallback;
mod field;
pub mod gpu;
mod linear;
mod optics;
mod phasor;
mod shares;
mod smooth;
mod work;

pub use chain::{Chain, Choice, Precision};
pub use cpu::{CpuChain, Flat, Scratch};
pub use detector::{Evaluation, Exposure, Loaded, Photometry};
pub use fallback::Fallback;
pub use linear::Linear;
pub use optics::{Colour, Mode, Optics, OpticsParts};
pub use phasor::Polynomial;
pub use work::{Shapes, Work};

#[cfg(all(test, feature = "opencl"))]
mod agreement;
#[cfg(test)]
mod tests;

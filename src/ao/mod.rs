//! The adaptive optics, end to end: turbulence, Shack-Hartmann sensor, mirror, control, science camera.
//!
//! It makes the images and the truth behind them, and shares nothing with the estimator but the telescope's geometry and
//! the modes of its mirror: a simulator with the estimator's shortcuts would only confirm them.

mod control;
mod footprint;

pub use control::{ControlLaw, Controller, Inpainting, Plant, Reconstructor, Stability, segment_mask};
pub use footprint::{Footprint, LANES};

//! Reduction of raw detector frames to the cube of images that an estimate takes.
//!
//! For a frame of `c` coadds the reduced image is, in electrons,
//!
//! ```text
//! image = g·(raw − c·D)/F − s·S
//! ```
//!
//! with the gain `g`, the dark of one coadd `D`, the flat `F` (median 1) and the sky `S` scaled to
//! the exposure. What remains of the raw frame's noise beside the photon noise of the star is one
//! number per channel, the card `RON_E`: `noise.rs`.
//!
//! * [`RawFrame::read`] reads a file; [`FrameClass`] is what it shows, by a list or by its header:
//!   `classify`.
//! * [`reduce`] makes masters (`masters`), finds the star (`star`, `found`), subtracts the sky
//!   (`sky`), cuts out, and rejects.
//! * [`first_scene`] writes the scene to begin with.
//! * [`Reduction::write`] writes the cube with bad pixels, log and scene.

mod aot_scene;
mod calibration;
mod channel;
mod classify;
mod cut_out;
mod files;
mod first_scene;
mod frame;
mod log;
mod masters;
mod noise;
mod pupil_turns;
mod read;
mod reduce;
mod reduced;
mod rejection;
mod scene_text;
mod sky;
mod star;
mod star_frame;
mod write;

pub use calibration::ReductionOptions;
pub use classify::FrameClass;
pub use files::{Pattern, list_files};
pub use first_scene::first_scene;
pub use frame::{ChannelRule, FrameHeader, RawFrame};
pub use log::LogRow;
pub use read::read_frames;
pub use reduce::reduce;
pub use reduced::{ReducedChannel, Reduction};

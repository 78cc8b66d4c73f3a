//! The adaptive optics, end to end: turbulence, Shack-Hartmann sensor, mirror, control, science camera.
//!
//! It makes the images and the truth behind them, and shares nothing with the estimator but the telescope's geometry and
//! the modes of its mirror: a simulator with the estimator's shortcuts would only confirm them.

mod atmosphere;
mod calm;
mod camera;
mod control;
mod darkroom;
mod divergence;
mod drift;
mod file;
mod footprint;
mod lines;
mod parts;
mod phase;
mod profile;
mod run;
mod sensor;
mod simulator;
mod stepper;
mod surface;
mod valid_map;
mod work;

pub use atmosphere::{Atmosphere, LARGEST_OUTER_SCALE};
pub use calm::CALM;
pub use camera::{ScienceCamera, View, strehl_on_axis};
pub use control::{ControlLaw, Controller, Inpainting, Plant, Reconstructor, Stability, segment_mask};
pub(crate) use control::{Svd, svd};
pub use divergence::Divergence;
pub use file::write;
pub use footprint::{Footprint, LANES};
pub use lines::Lines;
pub use profile::{Profile, Stage};
pub use run::{Progress, Recorder, Schedule, Shot, Summary};
pub use sensor::{Lenslets, Light, MAS_PER_NM_M, Sensor};
pub use simulator::{Frame, Simulator};
pub use stepper::Stepper;
pub use surface::Surface;
pub use work::Work;

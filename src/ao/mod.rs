//! AO simulation, end to end: turbulence, Shack-Hartmann sensor, deformable mirror, control,
//! science camera.
//!
//! It makes images together with the aberrations that they contain. It shares only the telescope's
//! geometry and the mirror's modes with the estimator: a simulator that made the estimator's
//! approximations could not reveal them.

mod aligned;
mod aot;
mod at_rest;
mod atmosphere;
mod camera;
mod channel;
mod control;
mod correction;
mod detector;
mod divergence;
mod drift;
mod exposure;
mod file;
mod footprint;
mod interaction;
mod loop_run;
mod measured_matrices;
mod moved_reference;
mod parts;
mod phase;
mod profile;
mod recorder;
mod run;
mod schedule;
mod sensor;
mod simulator;
mod stepper;
mod surface;
#[cfg(test)]
mod testing;
mod undisturbed;
mod work;

pub use aligned::AlignedBuffer;
pub use aot::{AOT_SCENE, check_aot, write_aot};
pub use at_rest::LoopAtRest;
pub use atmosphere::Atmosphere;
pub use camera::{ScienceCamera, View, strehl_on_axis};
pub use control::{ControlLaw, Controller, Inpainting, Plant, Reconstructor, SparseReconstructor, Stability};
pub(crate) use control::{Svd, svd};
pub use correction::LoopFrame;
pub use divergence::Divergence;
pub use file::write;
pub use footprint::{Footprint, LANES};
pub(crate) use parts::actuators;
pub use parts::{actuators_in_use, sensor_pupil};
pub use profile::{LoopStage, Profile};
pub use recorder::{Recorder, Shot, Summary};
#[cfg(test)]
pub(crate) use schedule::Schedule;
pub use sensor::{GuideStar, Lenslets, Sensor, SlopeFormat};
pub(crate) use sensor::{MOVED_REFERENCE, moved_reference, reference_slopes};
pub(crate) use sensor::{OTHER_SLOPE_ORDERS, slope_sources};
pub use simulator::Simulator;
pub use stepper::Stepper;
pub use surface::Surface;
pub use undisturbed::undisturb;
pub use work::LoopWork;

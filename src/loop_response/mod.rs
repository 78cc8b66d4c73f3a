//! Response of the closed AO loop: to the segments' pistons, of the wavefront sensor to NCPA, and the corrections that it takes.

mod closed_loop;
mod corrections;
mod sensor_model;
mod slope_information;

pub use closed_loop::ClosedLoopResponse;
pub use corrections::{CorrectableErrors, Corrections};
pub use sensor_model::SensorModel;
pub use slope_information::SlopeInformation;

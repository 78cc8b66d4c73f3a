//! Response of the closed AO loop to the segments, the wavefront sensor's response to NCPA, and corrections.

mod closed_loop;
mod corrections;
mod sensor_model;
mod slope_information;

pub use closed_loop::CalmLoop;
pub use corrections::Commands;
pub use sensor_model::SensorModel;
pub use slope_information::Sensed;

//! Response of the closed AO loop: to the segments, of the wavefront sensor to NCPA, and the
//! corrections that it takes.

mod closed_loop;
mod controller;
mod correction_file;
mod corrections;
mod gain_loss;
mod mirror_fit;
mod mirror_shape;
mod segment_layout;
mod segment_surface;
mod sensor_model;
mod serial_correlation;
mod slope_information;
mod slope_regression;

pub use closed_loop::ClosedLoopResponse;
pub use controller::{Command, Commands};
pub use correction_file::SentCorrections;
pub use corrections::{CorrectableErrors, Corrections, ModeCorrection, NcpaModes, SegmentLimits};
pub use sensor_model::SensorModel;
pub use slope_information::SlopeInformation;
pub use slope_regression::{ACCEPTED_GAIN, SlopeRegression, TelemetryFault, USUAL_GAIN};

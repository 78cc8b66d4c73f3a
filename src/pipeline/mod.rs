//! Pipeline: images in, one [`Estimate`] out, by one [`Policy`]; what the program, Rust, C, Python
//! and MATLAB all call.
//!
//! ```text
//! Scene ─ Telescope ─ Model ┐
//!                           ├ prepare → fit → select/reject/restart → combine → Estimate ─ write, report, corrections
//! Images (frames, masks) ───┘             (one Policy)
//! ```
//!
//! A modal estimate fits static modes to each image and combines the images; a maximum a posteriori
//! (MAP) estimate (`estimate.method = "full-phase"`) retrieves the whole wavefront behind each
//! exposure of a sequence and separates the static errors from the turbulence. Both end in the same
//! type.

mod absolute_pistons;
mod channels;
mod check;
mod consistency;
mod cut_out;
mod divided_images;
mod estimate;
mod estimator;
mod explain;
mod file;
mod foreign_truth;
mod frame_estimator;
mod full_phase;
mod group;
mod grouping;
mod image_changes;
mod images;
mod instrument;
mod lost_light;
mod misfit;
mod modal;
mod modal_errors;
mod modal_task;
mod model_selection;
mod observation;
mod opd_file;
mod orientation;
mod outcome;
mod parts;
mod piston_table;
mod policy;
mod remarks;
mod report;
mod residual_shape;
mod scene_files;
mod sequence;
mod sequence_channel;
mod staircases;
mod telemetry;
mod warnings;

pub use crate::control::{Control, Progress, Stage};
pub use crate::loop_response::{Command, Commands, Corrections, ModeCorrection, SentCorrections};
pub use crate::modal::{CombinedModes, ModelError, PistonInteger, StaticMaps};
pub use crate::scene::{Optic, OpticalParameter, Setting};
pub use crate::statics::{ErrorBudget, ErrorTerm, Iteration, NcpaFamily, SegmentTilts, StaticErrors};
pub use check::{Check, CheckedQuantity, Finding, Verdict, check};
pub use estimate::{Basis, Comparison, Estimate, Figure, Figures, FullPhaseSummary, MethodResult, ModalSummary, Run};
pub use estimator::Estimator;
pub use foreign_truth::{ForeignComparison, ForeignTruth};
pub use frame_estimator::{FrameEstimate, FrameEstimator};
pub use images::{Images, Trust, embedded_scene};
pub use observation::{Observation, ObservationPlan, plan_observation};
pub use orientation::{MovedPart, Orientation, OrientationCandidate, Poke, PokeResult, check_orientation};
pub use outcome::ImageOutcome;
pub use parts::{FittedPart, Part, PartFits};
pub use piston_table::read_pistons;
pub use policy::Policy;
pub use telemetry::TelemetryCheck;

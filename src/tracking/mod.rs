//! Tracking of static errors through a sequence of estimates: Kalman filter, detector of changes,
//! corrections.
//!
//! An estimate of one image has the covariance R; segments and NCPA drift slowly between images.
//! The model is a random walk,
//!
//! ```text
//! x(t + dt) = x(t) + w,   w ~ N(0, Q dt),   Q = diag(rate²)         one rate for segment modes, one for NCPA modes
//! y(t)      = x(t) + e,   e ~ N(0, R(t))                            R: the covariance of the estimate
//! ```
//!
//! whose minimum variance estimate is the Kalman filter ([`Tracker`]; Kalman 1960, J. Basic Eng.
//! 82, 35). Its rates are learnt by maximum likelihood of the innovations, steps are found by a
//! generalised likelihood ratio at a stated rate of false alarms, and single bad estimates are
//! rejected. Two things move without being a step, and raise no alarm of the wavefront: the star,
//! which has its own place in each image ([`TrackerSettings::pointing_modes`],
//! [`Update::pointing`]), and NCPA modes that move more than the others, such as a focus that
//! breathes, whose motion is learnt for itself. [`correction`] says which modes are worth
//! correcting, and by how much; a tracker recognises from estimates that a correction was applied
//! ([`Tracker::expect`]).

mod bytes;
mod change_detector;
mod coordinates;
mod correction;
mod drift_rate;
mod filter;
mod mode_motion;
mod motion;
mod pointing;
mod scalar_filter;
mod settings;
mod steps;
mod threshold;
mod tracker;

pub use crate::scene::SegmentConvention;
pub use correction::{Correctable, Correction, CorrectionPolicy, HeldMode, HoldReason, correction};
pub use pointing::PointingChange;
pub use settings::{Applied, AppliedPart, Change, NIGHT_S, TimedEstimate, TrackerSettings, TrackerVerdict, Update};
pub use threshold::change_threshold;
pub use tracker::Tracker;

//! What experiments share: draws of images with their truth, an estimator tried on them, statistics, tables, progress.
//!
//! Residuals are RMS over the pupil (weight A) in nm, piston, tip and tilt removed.

mod case;
mod draw;
pub mod metrics;
mod progress;
pub mod statistics;
mod table;

pub use case::{Bound, Case, Pulls, Trial, Way};
pub use draw::{Draw, draws, draws_from};
pub use progress::Progress;
pub use table::{Cell, Table};

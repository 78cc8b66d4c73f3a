//! What experiments share: draws of images with their truth, an estimator tried on them,
//! statistics, tables, progress.
//!
//! Residuals are RMS over the pupil (weight A) in nm, piston, tip and tilt removed.

mod case;
mod draw;
pub mod metrics;
mod progress;
mod shares;
pub mod statistics;
mod table;

pub use case::{Bound, Case, Pulls, Trial, Way};
pub use draw::{Draw, draws, draws_from};
pub use progress::Progress;
#[cfg(test)]
pub(crate) use shares::assert_survives;
pub use shares::{KeptDraw, Shares, to_cells, to_numbers};
pub use table::{Cell, Table};

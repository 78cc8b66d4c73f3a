//! Static errors, segment pistons and non-common path aberrations (NCPA), from a sequence of retrieved wavefronts.
//!
//! ```text
//! wavefronts ─ mean ─ generalised least squares ─ pistons, NCPA ─┐
//!   ↑           └ scatter ─ covariance ─┘  ↑                      │
//!   └────────────── static wavefront ──────┼── loop response ─────┘      iterations, until one changes nothing
//! ```
//!
//! The loop's response to the pistons is smooth and pistons are edges, so a covariance like that of turbulence separates one
//! from the other; the response itself is known from a simulation of the loop closed on the pistons alone.

mod anderson;
mod convolution;
mod covariance;
mod empirical_bayes;
mod image_selection;
mod iterations;
mod least_squares;
mod retrieved_sequence;
mod segment_tilts;
mod simulated_wavefronts;
mod static_modes;

pub use covariance::{MeanCovariance, ResidualCovariance};
pub use empirical_bayes::{Evidence, Family};
pub use iterations::{Measured, Pass, PassRecipe, PhaseSource, StaticWavefront, find_statics};
pub use least_squares::{NcpaModes, StaticErrors, StaticModel};
pub use retrieved_sequence::RetrievedPhases;
pub use segment_tilts::SegmentTilts;
pub use simulated_wavefronts::TruePhases;
pub(crate) use static_modes::check_diversity;

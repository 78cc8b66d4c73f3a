//! Static errors, segment pistons (and tips and tilts) and non-common path aberrations (NCPA), from
//! a sequence of retrieved wavefronts.
//!
//! ```text
//! wavefronts ─ mean ─ generalised least squares ─ segments, NCPA ┐
//!   ↑           └ scatter ─ covariance ─┘  ↑                      │
//!   └────────────── static wavefront ──────┼── loop response ─────┘      iterations, until one changes next to nothing
//! ```
//!
//! The loop's response to the segments is smooth and segments have edges, so a covariance like that
//! of turbulence separates the two; the response itself is known from a simulation of the loop
//! closed on the segments alone. Tips and tilts are estimated where the scene has them, or where
//! the residual of the mean wavefront shows them.

mod anderson;
mod common_figure;
mod convolution;
mod covariance;
mod error_budget;
mod estimator;
mod image_selection;
mod iterate;
mod iteration;
mod least_squares;
mod loop_compensation;
mod mean_covariance;
mod ncpa_basis;
mod segment_tilts;
mod sequence_retrieval;
mod settings;
mod static_errors;
mod static_modes;
mod wavefront_source;

pub(crate) use error_budget::ErrorSource;
pub use error_budget::{ErrorBudget, ErrorTerm};
pub use iterate::estimate_static_errors;
pub use iteration::Iteration;
pub use ncpa_basis::NcpaFamily;
pub(crate) use ncpa_basis::{MAX_NCPA_MODES, NcpaBasis};
pub use segment_tilts::SegmentTilts;
pub use sequence_retrieval::{ChannelSequence, SequenceRetrieval};
pub use settings::{StaticsSettings, TiltSelection};
pub use static_errors::StaticErrors;
pub(crate) use static_modes::check_diversity;

#[cfg(test)]
mod tests;

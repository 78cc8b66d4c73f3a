//! Mode bases: segment motions, and the aberrations of the optics behind the segments.
//!
//! There are two kinds. A [`SmoothBasis`] (Zernike, Karhunen-Loève, petals) consists of functions
//! and can be evaluated at any point; a [`Basis`] (segment modes, modes from a file) consists of
//! maps on the grid of the pupil. The unit of a coefficient is nm of piston of a segment, or nm RMS
//! over the pupil (weight A).
//!
//! ```text
//! Zernikes ───────────┐                     ┌ zernike_basis
//! InfluenceFunctions ─┼ SmoothBasis ────────┼ karhunen_loeve (VonKarman) ── join_exact ── .sampled(pupil) ┐
//! Petals ─────────────┘                     └ orthonormalise                                              ├ Basis
//! SegmentModes, files ────────────────────────────────────────────────────────────────────────────────────┘
//! ```
//!
//! [`Degeneracy`] lists the combinations of modes that a Gram or Fisher matrix does not determine.

mod basis;
mod influence;
mod karhunen_loeve;
mod linalg;
mod measured_influence;
mod orthonormal;
mod petals;
mod report;
mod samples;
mod segment;
mod separable;
mod smooth;
mod von_karman;
mod zernike;

pub use basis::{Basis, Group};
pub use influence::{InfluenceFunctions, Mirror};
pub(crate) use influence::{marked_cells, reach};
pub use karhunen_loeve::{KarhunenLoeve, karhunen_loeve, karhunen_loeve_at_most, karhunen_loeve_complete};
pub(crate) use linalg::symmetric_eigen;
pub use measured_influence::MeasuredInfluence;
pub use orthonormal::{DroppedMode, OrthonormalBasis, circle_zernikes, join_exact, orthonormalise, zernike_basis};
pub use petals::Petals;
pub use report::{Degeneracy, Direction, NULL_BELOW, WEAK_BELOW};
pub use samples::Samples;
pub use segment::SegmentModes;
pub(crate) use segment::{TiltFrame, tilt_frames, tilt_frames_of_lit};
pub use separable::SeparableBasis;
pub use smooth::SmoothBasis;
pub use von_karman::{R0_WAVELENGTH_NM, VonKarman};
pub use zernike::Zernikes;
pub(crate) use zernike::noll_orders;

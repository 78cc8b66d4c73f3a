//! The full-phase estimate of a sequence: MAP retrieval of every image, and static errors from the retrieved wavefronts.

mod estimate;
mod full_phase;

pub use estimate::{SkyImages, knows, read, write};
pub use full_phase::FullPhase;

//! Telescope of a scene: pupil on any grid, segment weights, diversity, filter, pixels, deformable
//! mirror, turbulence statistics.
//!
//! Simulators and estimators share this module, so that both describe the same telescope; each
//! chooses its own sampling.

mod band;
mod continuation;
mod diversity;
mod filter;
mod filter_file;
mod map_on_grid;
mod mirror;
mod model;
mod opd;
mod petals;
mod pixels;
mod places;
mod spectrum;
pub(crate) mod valid_map;

pub use band::band;
pub(crate) use band::wavelengths_to;
pub(crate) use continuation::continued;
pub use diversity::Diversity;
pub use filter::Filter;
pub use map_on_grid::MapOnGrid;
pub use model::Telescope;
pub use opd::{OpdMap, SegmentPlane, likely_unit, unit_remark};
pub use pixels::pixel_response;
pub use places::SegmentPlace;

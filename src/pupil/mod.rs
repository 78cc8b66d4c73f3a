//! The telescope's pupil: amplitude, segments, and the weights of the segments in the samples of
//! the model.

mod aperture;
mod band_limit;
mod coverage;
mod fit;
mod labels;
mod maps;
mod parts;
mod polygon;
mod sampled;
mod weights;

pub use crate::grid::Grid;
pub use crate::hexagons::{Hexagon, HexagonLayout};
pub use aperture::{Aperture, HexagonalParameters};
pub use band_limit::BandLimit;
pub use maps::FinePupil;
pub use parts::PupilParts;
pub use sampled::{Pupil, Segment};
pub use weights::SegmentWeights;

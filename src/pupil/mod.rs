//! The telescope's pupil: amplitude, segments, and the weights of the segments in the samples of the model.

mod aperture;
mod band_limit;
mod coverage;
mod fit;
mod maps;
mod polygon;
mod weights;

pub use aperture::{Aperture, HexagonalParameters};
pub use band_limit::BandLimit;
pub use maps::FinePupil;

use crate::grid::Grid;
use ndarray::Array2;

/// One mirror segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Centre of the segment, m, +x along columns.
    pub x_m: f64,
    /// Centre of the segment, m, +y along rows.
    pub y_m: f64,
}

/// A pupil on a grid.
#[derive(Debug, Clone)]
pub struct Pupil {
    /// Where the samples are.
    pub grid: Grid,
    /// Fraction of each sample's area that is illuminated, `[y, x]`, in [0, 1].
    pub amplitude: Array2<f64>,
    /// Segment at the centre of each sample, `[y, x]`; −1 where there is none. An illuminated sample always has an owner
    /// (where its centre is in a gap, the segment that covers most of it).
    pub owner: Array2<i32>,
    /// The segments, ring by ring, counter-clockwise from +x.
    pub segments: Vec<Segment>,
}

/// Weight of each segment in each illuminated sample: `E_p = e^{ikψ_p} Σ_s w_ps e^{ik c_s}`. Compressed sparse rows over the
/// illuminated samples.
#[derive(Debug, Clone)]
pub struct SegmentWeights {
    /// Number of segments.
    pub segments: usize,
    /// Flat grid index `y·samples + x` of each illuminated sample, ascending.
    pub lit: Vec<u32>,
    /// Row starts into `segment` and `weight`; `lit.len() + 1` entries.
    pub offsets: Vec<u32>,
    /// Segment of each entry.
    pub segment: Vec<u32>,
    /// Weight of each entry (may be negative for a band-limited pupil).
    pub weight: Vec<f64>,
    /// Σ over the aperture of amplitude², in units of this grid's samples, of the unfiltered pupil. It normalises the
    /// PSF to a sum of 1 over an unbounded detector.
    pub energy: f64,
}

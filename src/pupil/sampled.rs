//! A pupil sampled on a grid, with its segments.

use crate::grid::Grid;
use ndarray::Array2;

/// One mirror segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Centre of the segment, m, +x along columns.
    pub x_m: f64,
    /// Centre of the segment, m, +y along rows.
    pub y_m: f64,
    /// Its label in the map of a pupil from a file or an array; else its number.
    pub label: i32,
}

/// A pupil on a grid.
#[derive(Debug, Clone)]
pub struct Pupil {
    /// Where the samples are.
    pub grid: Grid,
    /// Fraction of each sample's area that is illuminated, `[y, x]`, in [0, 1].
    pub amplitude: Array2<f64>,
    /// Segment at the centre of each sample, `[y, x]`; −1 where there is none. An illuminated
    /// sample always has an owner (where its centre is in a gap, the segment that covers most of
    /// it).
    pub owner: Array2<i32>,
    /// The segments, ring by ring, counter-clockwise from +x.
    pub segments: Vec<Segment>,
}

impl Pupil {
    /// The samples that have an owner, row by row: place `(y, x)` and segment.
    pub(crate) fn owned_samples(&self) -> impl Iterator<Item = ((usize, usize), usize)> + '_ {
        self.owner.indexed_iter().filter(|(_, owner)| **owner >= 0).map(|(at, &owner)| (at, owner as usize))
    }
}

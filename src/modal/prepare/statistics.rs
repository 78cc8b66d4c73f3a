//! Statistics of the border of a frame: background level and scatter.

use crate::statistics::upper_median_in_place;
use ndarray::{ArrayView2, s};

/// Pixels of the border that are used: their median is accurate to 2 % of their scatter. The border
/// has a quarter of a frame's pixels or more.
const ENOUGH: usize = 4096;

/// Medians, in memory that is allocated once.
pub(super) struct Statistics {
    values: Vec<f64>,
}

impl Statistics {
    /// Statistics for frames of up to `pixels`.
    pub(super) fn with_capacity(pixels: usize) -> Self {
        Self { values: Vec::with_capacity(pixels) }
    }

    /// Median of the frame's border, an eighth of each side wide; of a large frame, of its rows at
    /// equal distances.
    pub(super) fn level_of_border(&mut self, data: ArrayView2<f64>, bad: ArrayView2<bool>) -> f64 {
        let (rows, columns) = data.dim();
        let inner = |size: usize| size / 8..size - size / 8;
        let (inner_rows, inner_columns) = (inner(rows), inner(columns));
        let every = (rows * columns).div_ceil(4 * ENOUGH).max(1);
        self.values.clear();
        for (v, (data, bad)) in data.outer_iter().zip(bad.outer_iter()).enumerate().step_by(every) {
            let hidden = if inner_rows.contains(&v) { inner_columns.clone() } else { 0..0 };
            for part in [0..hidden.start, hidden.end..columns] {
                let (data, bad) = (data.slice(s![part.clone()]), bad.slice(s![part]));
                self.values.extend(data.iter().zip(bad).filter(|(_, bad)| !**bad).map(|(&d, _)| d));
            }
        }
        median(&mut self.values)
    }

    /// Scatter of the same pixels about their `level`: 1.4826 times the median deviation.
    /// Overwrites them.
    pub(super) fn scatter_about(&mut self, level: f64) -> f64 {
        self.values.iter_mut().for_each(|d| *d = (*d - level).abs());
        1.4826 * median(&mut self.values)
    }
}

/// The upper median; 0 of none. Reorders `values`.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() { 0.0 } else { upper_median_in_place(values) }
}

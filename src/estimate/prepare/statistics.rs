//! What the border of a frame says of its background.

use ndarray::Array2;

/// The memory in which medians are selected.
pub(super) struct Statistics {
    values: Vec<f64>,
}

impl Statistics {
    /// For frames of up to `pixels`.
    pub(super) fn with_room(pixels: usize) -> Self {
        Self { values: Vec::with_capacity(pixels) }
    }

    /// Median and scatter (1.4826 times the median deviation) of the frame's border, an eighth of each side wide.
    pub(super) fn of_border(&mut self, data: &Array2<f64>, bad: &Array2<bool>) -> (f64, f64) {
        let (rows, columns) = data.dim();
        let inner = |size: usize| size / 8..size - size / 8;
        let (inner_rows, inner_columns) = (inner(rows), inner(columns));
        self.values.clear();
        for (v, (data, bad)) in data.outer_iter().zip(bad.outer_iter()).enumerate() {
            let hidden = if inner_rows.contains(&v) { inner_columns.clone() } else { 0..0 };
            let good = data.iter().zip(&bad).enumerate().filter(|(u, (_, bad))| !(**bad || hidden.contains(u)));
            self.values.extend(good.map(|(_, (&d, _))| d));
        }
        let level = median(&mut self.values);
        self.values.iter_mut().for_each(|d| *d = (*d - level).abs());
        (level, 1.4826 * median(&mut self.values))
    }
}

/// The middle value, the upper of two; 0 of none. Reorders `values`.
fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

//! Cut-out of a frame about its star.

use ndarray::{Array2, s};

/// Rectangle of a frame, whose pixel `[rows/2, columns/2]` is the star's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct CutOut {
    pub(super) top: usize,
    pub(super) left: usize,
    pub(super) rows: usize,
    pub(super) columns: usize,
}

impl CutOut {
    /// The cut-out of `(rows, columns)` pixels about the star at `(x, y)` in a frame of `shape`;
    /// the reason where it does not fit.
    pub(super) fn about(
        (x, y): (f64, f64),
        (rows, columns): (usize, usize),
        shape: (usize, usize),
    ) -> std::result::Result<Self, String> {
        let (top, left) = (y.round() as i64 - rows as i64 / 2, x.round() as i64 - columns as i64 / 2);
        let (bottom, right) = (top + rows as i64, left + columns as i64);
        let (height, width) = (shape.0 as i64, shape.1 as i64);
        let beyond = [-top, -left, bottom - height, right - width].into_iter().max().unwrap_or(0);
        if beyond > 0 {
            let most = Self::largest_side((x, y), shape);
            return Err(format!(
                "the star at column {x:.1}, row {y:.1} is too near to the edge of the frame of {width}x{height} pixels: {columns}x{rows} \
                 pixels about it leave it by {beyond}; {most}x{most} are the most that fit (--pixels)"
            ));
        }
        Ok(Self { top: top as usize, left: left as usize, rows, columns })
    }

    /// Side of the largest even square about the star at `(x, y)` in a frame of `shape`, pixels; 0
    /// for a star that is not on it.
    pub(super) fn largest_side((x, y): (f64, f64), (height, width): (usize, usize)) -> usize {
        let half = |at: f64, size: usize| (at.round() as i64).min(size as i64 - at.round() as i64);
        2 * half(x, width).min(half(y, height)).max(0) as usize
    }

    /// The part of a map.
    pub(super) fn of<T: Clone>(&self, map: &Array2<T>) -> Array2<T> {
        map.slice(s![self.top..self.top + self.rows, self.left..self.left + self.columns]).to_owned()
    }

    /// Whether a pixel of the frame is in it.
    pub(super) fn contains(&self, y: usize, x: usize) -> bool {
        (self.top..self.top + self.rows).contains(&y) && (self.left..self.left + self.columns).contains(&x)
    }
}

//! Map over a square of the pupil plane, at any point of it.

use crate::{Error, Result};
use ndarray::Array2;

/// Map over the pupil grid's width, interpolated bilinearly.
#[derive(Clone)]
pub struct MapOnGrid {
    values: Array2<f64>,
    width_m: f64,
}

impl MapOnGrid {
    /// Map `[y, x]` whose samples tile `width_m`. Values that are not finite are replaced by 0.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map that is not square.
    pub fn new(values: Array2<f64>, width_m: f64) -> Result<Self> {
        if values.nrows() != values.ncols() || values.is_empty() {
            let (rows, columns) = values.dim();
            return Err(Error::Shape(format!("the map has {columns}x{rows} samples; a square map is needed")));
        }
        Ok(Self { values: values.mapv(|v| if v.is_finite() { v } else { 0.0 }), width_m })
    }

    /// Bilinear interpolation at (x, y), m; beyond the outermost samples the value of the nearest
    /// one.
    pub fn at(&self, x_m: f64, y_m: f64) -> f64 {
        let n = self.values.nrows();
        let index = |c: f64| (c / self.width_m * n as f64 + (n as f64 - 1.0) / 2.0).clamp(0.0, n as f64 - 1.0);
        let (x, y) = (index(x_m), index(y_m));
        let (u, v) = ((x as usize).min(n.saturating_sub(2)), (y as usize).min(n.saturating_sub(2)));
        let (right, up) = ((u + 1).min(n - 1), (v + 1).min(n - 1));
        let (fx, fy) = (x - u as f64, y - v as f64);
        let row = |v: usize| self.values[[v, u]] * (1.0 - fx) + self.values[[v, right]] * fx;
        row(v) * (1.0 - fy) + row(up) * fy
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use approx::assert_relative_eq;

    #[test]
    fn map_is_interpolated_between_samples_and_constant_beyond() {
        let plane = |x: f64, y: f64| 3.0 + 2.0 * x - y;
        let grid = Grid::new(6, 3.0).unwrap();
        let values = Array2::from_shape_fn((6, 6), |(y, x)| plane(grid.coordinate_m(x), grid.coordinate_m(y)));
        let map = MapOnGrid::new(values, 3.0).unwrap();
        for (x, y) in [(0.0, 0.0), (0.31, -0.9), (1.25, 1.25), (-1.2, 0.7)] {
            assert_relative_eq!(map.at(x, y), plane(x, y), max_relative = 1e-14);
        }
        assert_relative_eq!(map.at(9.0, 0.25), plane(1.25, 0.25), max_relative = 1e-14);
        assert!(MapOnGrid::new(Array2::zeros((3, 4)), 1.0).is_err());
    }
}

//! Diversity of a scene: focus or a map.

use super::model::Telescope;
use super::opd::OpdMap;
use crate::pupil::Pupil;
use crate::scene::Scene;
use crate::{Error, Result};
use ndarray::Array2;

/// Map over the pupil grid's width, interpolated bilinearly.
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

    /// Bilinear interpolation at (x, y), m; beyond the outermost samples the value of the nearest one.
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

/// Diversity of a scene at any point of the pupil plane.
pub enum Diversity {
    /// Focus `factor·(x² + y²) + offset`, nm.
    Focus {
        /// nm per m².
        factor_nm_m2: f64,
        /// nm.
        offset_nm: f64,
    },
    /// Map, nm.
    Map(MapOnGrid),
}

impl Diversity {
    /// Diversity of `scene`: focus of the stated RMS over the pupil (weight A, zero mean, positive at the edge), or the
    /// map of its file.
    ///
    /// The RMS is computed on the finest known pupil, not on the scene's grid: on 120 and on 108 samples it differs by
    /// 1e-4, which would appear as 0.3 nm of focus in an estimate.
    ///
    /// # Errors
    /// [`Error::File`] for a map that cannot be read.
    pub fn new(scene: &Scene, telescope: &Telescope) -> Result<Self> {
        let pupil = &telescope.pupil;
        if let Some(file) = &scene.image.diversity_file {
            let path = scene.resolve(file);
            return Ok(Self::Map(OpdMap::read(&path)?.on_width(pupil.grid.width_m())?));
        }
        let pupil = telescope.finest_pupil()?;
        let (mut weight, mut mean, mut square) = (0.0, 0.0, 0.0);
        for ((y, x), &a) in pupil.amplitude.indexed_iter() {
            let r2 = pupil.grid.coordinate_m(x).powi(2) + pupil.grid.coordinate_m(y).powi(2);
            (weight, mean, square) = (weight + a, mean + a * r2, square + a * r2 * r2);
        }
        let (mean, square) = (mean / weight, square / weight);
        let rms_nm = scene.image.diversity_focus_waves_rms * scene.image.wavelength_nm;
        let factor_nm_m2 = rms_nm / (square - mean * mean).sqrt();
        Ok(Self::Focus { factor_nm_m2, offset_nm: -factor_nm_m2 * mean })
    }

    /// Diversity at (x, y) m, nm.
    pub fn at(&self, x_m: f64, y_m: f64) -> f64 {
        match self {
            Self::Focus { factor_nm_m2, offset_nm } => factor_nm_m2 * (x_m * x_m + y_m * y_m) + offset_nm,
            Self::Map(map) => map.at(x_m, y_m),
        }
    }

    /// Largest slope over the pupil, nm/m; it determines the size of the spot. Differences across the pupil's edge are
    /// left out, because a map is arbitrary outside the pupil.
    pub fn steepest_nm_m(&self, pupil: &Pupil) -> f64 {
        let (grid, last) = (&pupil.grid, pupil.grid.samples() - 1);
        let inside = |y: usize, x: usize| pupil.amplitude[[y, x]] > 0.0;
        let value = |y: usize, x: usize| self.at(grid.coordinate_m(x), grid.coordinate_m(y));
        let mut steepest = 0.0f64;
        for y in 1..last {
            for x in 1..last {
                if inside(y, x) && inside(y, x - 1) && inside(y, x + 1) && inside(y - 1, x) && inside(y + 1, x) {
                    let along_x = value(y, x + 1) - value(y, x - 1);
                    let along_y = value(y + 1, x) - value(y - 1, x);
                    steepest = steepest.max(along_x.hypot(along_y) / (2.0 * grid.pitch_m()));
                }
            }
        }
        steepest
    }

    /// Half-width of the geometric spot of a point source, in λ over the width of the grid of `pupil`.
    pub fn spot(&self, pupil: &Pupil, wavelength_nm: f64) -> f64 {
        self.steepest_nm_m(pupil) * pupil.grid.width_m() / wavelength_nm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use approx::assert_relative_eq;

    #[test]
    fn the_focus_has_the_stated_rms_and_no_mean_over_the_pupil() {
        let scene = Scene::preset("keck-artificial").unwrap();
        let telescope = Telescope::new(&scene).unwrap();
        let diversity = Diversity::new(&scene, &telescope).unwrap();
        // On a grid without common samples with the one of the normalisation.
        let pupil = telescope.pupil_on(Grid::new(700, 10.95).unwrap()).unwrap();
        let grid = pupil.grid;
        let map = Array2::from_shape_fn(pupil.amplitude.dim(), |(y, x)| {
            diversity.at(grid.coordinate_m(x), grid.coordinate_m(y))
        });
        let mean = (&map * &pupil.amplitude).sum() / pupil.weight_sum();
        // Moments on 700 samples have errors of a few parts in 10⁶ (1e-4 at 120, falling as the square of the pitch).
        assert_relative_eq!(pupil.rms(map.view()).unwrap(), 1.5 * 2168.6, max_relative = 1e-5);
        assert!(mean.abs() < 1e-5 * 1.5 * 2168.6, "{mean}");
        assert!(diversity.at(5.0, 0.0) > 0.0 && diversity.at(0.0, 0.0) < 0.0);
    }

    #[test]
    fn a_map_is_interpolated_between_its_samples_and_constant_beyond_them() {
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

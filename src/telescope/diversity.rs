//! Diversity of a scene: focus or a map.

use super::map_on_grid::MapOnGrid;
use super::model::Telescope;
use super::opd::OpdMap;
use crate::pupil::Pupil;
use crate::scene::System;
use crate::{Error, Result};

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
    /// Diversity of `scene`: focus of the stated RMS over the pupil (weight A, zero mean, positive
    /// at the edge), or the map of its file.
    ///
    /// The RMS is computed on the finest known pupil, not on the scene's grid: on 120 and on 108
    /// samples it differs by 1e-4, which would appear as 0.3 nm of focus in an estimate.
    ///
    /// # Errors
    /// [`Error::File`] for a map that cannot be read.
    pub fn new(scene: &System, telescope: &Telescope) -> Result<Self> {
        let pupil = &telescope.pupil;
        if let Some(file) = &scene.image.diversity_file {
            let (path, image) = (scene.resolve(file), &scene.image);
            let Some(plane) = image.diversity_plane() else {
                return Err(Error::Scene(format!(
                    "{}: image.diversity_planes has one number for each image, and a model, its sessions and the watch have one diversity: a \
                     list of one is needed there; 'cophase estimate' and pipeline::Estimator take one for each image",
                    scene.name()
                )));
            };
            let Ok(plane) = usize::try_from(plane) else {
                return Ok(Self::Focus { factor_nm_m2: 0.0, offset_nm: 0.0 });
            };
            let mut map = OpdMap::read_plane(&path, plane, image.wavelength_nm)?;
            map.values_nm *= image.diversity_scale;
            return Ok(Self::Map(map.over(pupil).map_err(|error| Error::file(&path, error))?));
        }
        let [mean, square] = telescope.moments()?;
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

    /// Largest slope over the pupil, nm/m; it determines the size of the spot. Differences across
    /// the pupil's edge are left out, because a map is arbitrary outside the pupil.
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

    /// Half-width of the geometric spot of a point source, in λ over the width of the grid of
    /// `pupil`.
    pub fn spot(&self, pupil: &Pupil, wavelength_nm: f64) -> f64 {
        self.steepest_nm_m(pupil) * pupil.grid.width_m() / wavelength_nm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::scene::Scene;
    use approx::assert_relative_eq;
    use ndarray::Array2;

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
        // Moments on 700 samples have errors of a few parts in 10⁶ (1e-4 at 120, falling as the
        // square of the pitch).
        assert_relative_eq!(pupil.rms(map.view()).unwrap(), 1.5 * 2168.6, max_relative = 1e-5);
        assert!(mean.abs() < 1e-5 * 1.5 * 2168.6, "{mean}");
        assert!(diversity.at(5.0, 0.0) > 0.0 && diversity.at(0.0, 0.0) < 0.0);
    }
}

//! Figures of merit of images and spectra on a segmented pupil, against theory.

mod psd;
mod strehl;

use cophase::pupil::{Grid, Pupil};
use cophase::scene::Scene;
use cophase::telescope::Telescope;
use ndarray::Array2;

/// Pupil of the scene `keck-onsky` (36 segments, partly covered samples at edges) on a grid of 20
/// lenslets of 12 samples.
fn keck() -> Pupil {
    let telescope = Telescope::new(&Scene::preset("keck-onsky").unwrap()).unwrap();
    telescope.pupil_on(Grid::new(240, 11.25).unwrap()).unwrap()
}

/// Map of a function of (x, y), m, on the grid of `pupil`.
fn map(pupil: &Pupil, function: impl Fn(f64, f64) -> f64) -> Array2<f64> {
    let grid = pupil.grid;
    Array2::from_shape_fn(pupil.amplitude.dim(), |(y, x)| function(grid.coordinate_m(x), grid.coordinate_m(y)))
}

//! Figures of merit of images and spectra, on the telescope of a scene and against theory.

mod psd;
mod strehl;

use cophase::grid::Grid;
use cophase::pupil::Pupil;
use cophase::scene::Scene;
use cophase::telescope::Telescope;
use ndarray::Array2;

/// The pupil of the sky's scene (grey edges, 36 segments) on a grid of 20 lenslets of 12 samples.
fn keck() -> Pupil {
    let telescope = Telescope::of(&Scene::preset("keck-onsky").unwrap()).unwrap();
    telescope.pupil_on(Grid::new(240, 11.25).unwrap()).unwrap()
}

/// A map on the grid of `pupil` from the function of (x, y), m.
fn map(pupil: &Pupil, of: impl Fn(f64, f64) -> f64) -> Array2<f64> {
    let grid = pupil.grid;
    Array2::from_shape_fn(pupil.amplitude.dim(), |(y, x)| of(grid.coordinate_m(x), grid.coordinate_m(y)))
}

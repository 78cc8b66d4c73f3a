//! What the figures share: rows of the table, maps.

use crate::reproduce::Row;
use cophase::ao::Simulator;
use cophase::pupil::Pupil;
use cophase::scene::Scene;
use cophase::{Error, Result};
use cophase_view::plot::{CaptionedMap, MapScale};
use ndarray::Array2;

/// The row of the table of that name.
pub(super) fn row(name: &str) -> Result<&'static Row> {
    Row::named(name).ok_or_else(|| Error::Internal(format!("there is no row {name}")))
}

/// `scene` with the draw `seed` of the aberrations, and of the turbulence and the noise.
pub(super) fn with_seed(scene: &Scene, seed: usize) -> Result<Scene> {
    let seed = seed.to_string();
    scene.with(&[("aberrations.seed", &seed), ("turbulence.seed", &seed)])
}

/// A map over the footprint of `simulator` as `[y, x]` on its pupil's grid; NaN where there is no
/// glass.
pub(super) fn on_pupil(simulator: &Simulator, map: &[f32]) -> Array2<f64> {
    let stride = simulator.footprint().stride();
    let amplitude = &simulator.pupil().amplitude;
    Array2::from_shape_fn(amplitude.dim(), |(y, x)| {
        if amplitude[[y, x]] > 0.0 { f64::from(map[y * stride + x]) } else { f64::NAN }
    })
}

/// A wavefront to be drawn, `[y, x]`, nm.
pub(super) fn wavefront(pupil: &Pupil, caption: String, map_nm: &Array2<f64>, scale: MapScale) -> CaptionedMap {
    let (values, unit, width_m) = (map_nm.clone(), "nm".into(), Some(pupil.grid.width_m()));
    CaptionedMap { caption, values, unit, width_m, scale, labels: Vec::new() }
}

/// The NCPA behind `simulator` on its pupil's grid, `[y, x]`, nm, NaN where there is no glass.
pub(super) fn ncpa_nm(simulator: &Simulator) -> Result<Array2<f64>> {
    let pupil = simulator.pupil();
    let lit: Vec<(usize, usize)> =
        pupil.amplitude.indexed_iter().filter(|(_, amplitude)| **amplitude > 0.0).map(|(at, _)| at).collect();
    let at = |&(y, x): &(usize, usize)| (pupil.grid.coordinate_m(x), pupil.grid.coordinate_m(y));
    let (xs, ys): (Vec<f64>, Vec<f64>) = lit.iter().map(at).unzip();
    let mut map_nm = Array2::from_elem(pupil.amplitude.dim(), f64::NAN);
    for (at, ncpa) in lit.into_iter().zip(simulator.truth().ncpa_at(&xs, &ys)?) {
        map_nm[at] = ncpa;
    }
    Ok(map_nm)
}

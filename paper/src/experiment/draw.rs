//! Draws of the artificial source: an image and the truth behind it, on any grid.

use super::Progress;
use cophase::pupil::Pupil;
use cophase::scene::Scene;
use cophase::source::{self, Truth};
use cophase::{Error, Result};
use ndarray::{Array2, Axis, s};
use rayon::prelude::*;

/// One image of a scene, with one draw of aberrations and noise.
pub struct Draw {
    /// `aberrations.seed`.
    pub seed: usize,
    /// The image, `[y, x]`, electrons.
    pub image_e: Array2<f64>,
    /// Electrons of the star.
    pub flux_e: f64,
    /// What was put in.
    pub truth: Truth,
}

/// The draws 1 to `seeds` of `scene`.
///
/// # Errors
/// As [`draws_from`].
pub fn draws(scene: &Scene, seeds: usize, progress: &Progress) -> Result<Vec<Draw>> {
    draws_from(scene, 1, seeds, progress)
}

/// `count` draws of `scene`, the first with the seed `first`.
///
/// # Errors
/// Those of [`source::simulate`]; [`Error::Scene`] for a scene whose segments are tilted,
/// [`Error::Interrupted`].
pub fn draws_from(scene: &Scene, first: u64, count: usize, progress: &Progress) -> Result<Vec<Draw>> {
    if scene.aberrations.as_ref().is_some_and(|truth| truth.segment_tip_tilt_rms_nm > 0.0) {
        let sentence = "aberrations.segment_tip_tilt_rms_nm is not 0: these experiments move segments in piston only";
        return Err(Error::Scene(sentence.into()));
    }
    let draw = |seed: u64| {
        progress.check()?;
        let drawn = scene.with_override("aberrations.seed", &seed.to_string())?;
        let made = source::simulate(&drawn)?.remove(0);
        let (rows, columns) = scene.image.fitted_shape();
        let image_e = made.images_e.index_axis_move(Axis(0), 0).slice_move(s![..rows, ..columns]);
        Ok(Draw { seed: seed as usize, image_e, flux_e: made.flux_e, truth: made.truth })
    };
    (first..first.saturating_add(count as u64)).into_par_iter().map(draw).collect()
}

impl Draw {
    /// The maps of the truth on the grid of `pupil`, as [`Truth::maps_on`] gives them.
    ///
    /// # Errors
    /// As there.
    pub fn truth_on(&self, pupil: &Pupil) -> Result<[Array2<f64>; 2]> {
        self.truth.maps_on(pupil)
    }
}

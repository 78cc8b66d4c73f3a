//! Lenslet array of the wavefront sensor, and the subapertures in use.

use crate::pupil::Pupil;
use crate::scene::SensorScene;
use crate::telescope::valid_map;
use crate::{Error, Result};
use std::path::Path;

/// Angle on the sky of a slope of 1 nm/m (1e-9 rad), mas.
pub const MAS_PER_NM_M: f64 = 1e-9 * 180.0 / std::f64::consts::PI * 3600.0 * 1000.0;

/// Lenslets over the simulator's grid.
#[derive(Debug, Clone)]
pub struct Lenslets {
    /// Lenslets along a side.
    pub across: usize,
    /// Samples along a side of a lenslet.
    pub samples: usize,
    /// Side of a lenslet, m.
    pub pitch_m: f64,
    /// `row·across + column` of the subapertures in use, ascending.
    pub subapertures: Vec<usize>,
    /// Light of each subaperture, as a fraction of that of a fully illuminated one.
    pub light: Vec<f64>,
}

impl Lenslets {
    /// Lenslets of `scene` over `pupil`, whose grid has `samples_per_lenslet` samples for each.
    /// Files are relative to `directory`.
    ///
    /// # Errors
    /// [`Error::Shape`] for a grid with other samples, [`Error::Value`] if no subaperture has
    /// enough light, [`Error::File`] for a map that cannot be read.
    pub fn new(scene: &SensorScene, pupil: &Pupil, directory: &Path) -> Result<Self> {
        let (across, samples) = (scene.lenslets_across, scene.samples_per_lenslet);
        if pupil.grid.samples() != across * samples {
            return Err(Error::Shape(format!(
                "a grid of {} samples does not match {across} lenslets of {samples} samples; {} are needed",
                pupil.grid.samples(),
                across * samples
            )));
        }
        let full = (samples * samples) as f64;
        let covered = |index: usize| -> f64 {
            let (row, column) = (index / across * samples, index % across * samples);
            pupil.amplitude.slice(ndarray::s![row..row + samples, column..column + samples]).sum() / full
        };
        let subapertures: Vec<usize> = match &scene.subaperture_file {
            // A subaperture without light has no slope, even if the map marks it.
            Some(file) => {
                let marked = valid_map::read(&directory.join(file), across)?;
                marked.into_iter().filter(|&index| covered(index) > 0.0).collect()
            }
            None => {
                let least = scene.min_light_ratio.max(f64::MIN_POSITIVE);
                (0..across * across).filter(|&index| covered(index) >= least).collect()
            }
        };
        if subapertures.is_empty() {
            return Err(Error::Value(format!(
                "no subaperture has {} of a full one's light; lower wavefront_sensor.min_light_ratio",
                scene.min_light_ratio
            )));
        }
        let pitch_m = pupil.grid.width_m() / across as f64;
        Ok(Self { across, samples, pitch_m, subapertures, light: Vec::new() }.with_light_of(pupil))
    }

    /// The same subapertures with the light of another pupil on the same grid.
    pub fn with_light_of(mut self, pupil: &Pupil) -> Self {
        let (across, samples) = (self.across, self.samples);
        // The light is the square of the pupil amplitude.
        let light = |&index: &usize| {
            let (row, column) = (index / across * samples, index % across * samples);
            let cell = pupil.amplitude.slice(ndarray::s![row..row + samples, column..column + samples]);
            cell.iter().map(|a| a * a).sum::<f64>() / (samples * samples) as f64
        };
        self.light = self.subapertures.iter().map(light).collect();
        self
    }
}

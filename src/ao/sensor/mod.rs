//! The Shack-Hartmann wavefront sensor: lenslets, their light, their spots, their slopes.
//!
//! A slope is the tilt of the wavefront over a subaperture as an angle on the sky, mas: positive along x where the
//! wavefront grows along +x. Slopes are `[all x, all y]` over the subapertures in use, ascending.

mod geometric;
mod light;
mod moved;
mod pixels;
mod quad_cell;

pub use light::Light;

use super::footprint::Footprint;
use super::lines::Lines;
use crate::grid::Grid;
use crate::pupil::Pupil;
use crate::scene::{SensorDetector, SensorScene};
use crate::{Error, Result};
use geometric::Geometric;
use moved::Moved;
use pixels::Pixels;
use quad_cell::QuadCell;
use std::path::Path;

/// Milliarcseconds of a slope of 1 nm/m: 1e-9 rad.
pub const MAS_PER_NM_M: f64 = 1e-9 * 180.0 / std::f64::consts::PI * 3600.0 * 1000.0;

/// The tilt that calibrates the slopes, mas: a thousandth of a spot's width, so that the response is its slope at 0, and
/// 1e4 times what single precision resolves.
const CALIBRATION_MAS: f64 = 1.0;

/// The lenslets over the simulator's grid.
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
    /// Light of each, as a fraction of a full one.
    pub light: Vec<f64>,
}

impl Lenslets {
    /// The lenslets of `scene` over `pupil`, whose grid has `samples_per_lenslet` samples for each; files are relative to
    /// `directory`.
    ///
    /// # Errors
    /// [`Error::Shape`] where the grid does not fit, [`Error::Value`] where no lenslet sees enough light,
    /// [`Error::File`] for a map that cannot be read.
    pub fn of(scene: &SensorScene, pupil: &Pupil, directory: &Path) -> Result<Self> {
        let (across, samples) = (scene.lenslets_across, scene.samples_per_lenslet);
        if pupil.grid.samples() != across * samples {
            return Err(Error::Shape(format!(
                "a grid of {} samples does not fit {across} lenslets of {samples}: {} are needed",
                pupil.grid.samples(),
                across * samples
            )));
        }
        let full = (samples * samples) as f64;
        let glass = |index: usize| -> f64 {
            let (row, column) = (index / across * samples, index % across * samples);
            pupil.amplitude.slice(ndarray::s![row..row + samples, column..column + samples]).sum() / full
        };
        let subapertures: Vec<usize> = match &scene.subaperture_file {
            // A subaperture without any light has no slope, whatever the map says.
            Some(file) => {
                let marked = super::valid_map::read(&directory.join(file), across)?;
                marked.into_iter().filter(|&index| glass(index) > 0.0).collect()
            }
            None => {
                let least = scene.min_light_ratio.max(f64::MIN_POSITIVE);
                (0..across * across).filter(|&index| glass(index) >= least).collect()
            }
        };
        if subapertures.is_empty() {
            return Err(Error::Value(format!(
                "no lenslet sees a fraction of {} of its light: lower wavefront_sensor.min_light_ratio",
                scene.min_light_ratio
            )));
        }
        let pitch_m = pupil.grid.width_m() / across as f64;
        Ok(Self { across, samples, pitch_m, subapertures, light: Vec::new() }.before(pupil))
    }

    /// The same lenslets in use before another pupil on the same grid.
    pub fn before(mut self, pupil: &Pupil) -> Self {
        let (across, samples) = (self.across, self.samples);
        // The field's amplitude is the share of glass; its light the square.
        let light = |&index: &usize| {
            let (row, column) = (index / across * samples, index % across * samples);
            let cell = pupil.amplitude.slice(ndarray::s![row..row + samples, column..column + samples]);
            cell.iter().map(|a| a * a).sum::<f64>() / (samples * samples) as f64
        };
        self.light = self.subapertures.iter().map(light).collect();
        self
    }
}

enum Detector {
    QuadCell(QuadCell),
    Pixels(Pixels),
    Geometric(Geometric),
}

impl Detector {
    fn of(scene: &SensorScene, lenslets: &Lenslets, grid: &Grid, footprint: &Footprint) -> Self {
        match scene.detector {
            SensorDetector::QuadCell => Self::QuadCell(QuadCell::new(lenslets, footprint, scene.wavelength_nm)),
            SensorDetector::Pixels => Self::Pixels(Pixels::new(scene, lenslets, footprint)),
            SensorDetector::Geometric => Self::Geometric(Geometric::new(lenslets, grid, footprint)),
        }
    }

    /// Slopes in the detector's own unit.
    fn raw(&mut self, opd_nm: &[f32], light: Option<&mut Light>, slopes: &mut [f32]) {
        match self {
            Self::QuadCell(cell) => cell.raw(opd_nm, light, slopes),
            Self::Pixels(pixels) => pixels.raw(opd_nm, light, slopes),
            Self::Geometric(geometric) => geometric.raw(opd_nm, slopes),
        }
    }
}

/// The sensor, calibrated.
pub struct Sensor {
    lenslets: Lenslets,
    detector: Detector,
    map: usize,
    /// Slopes of a flat wavefront, mas.
    reference: Vec<f32>,
    /// mas for one of the detector's own unit.
    unit_mas: f32,
    /// Lenslets that have moved since.
    moved: Option<Moved>,
}

impl Sensor {
    /// The sensor of `scene` over a pupil on the simulator's grid.
    ///
    /// The scale of the slopes comes from a small tilt seen by the best-lit subaperture, their zero from a flat
    /// wavefront.
    ///
    /// # Errors
    /// [`Error::Value`] for a sensor that does not respond to a tilt.
    pub fn new(scene: &SensorScene, lenslets: Lenslets, pupil: &Pupil, footprint: &Footprint) -> Result<Self> {
        let detector = Detector::of(scene, &lenslets, &pupil.grid, footprint);
        let slopes = 2 * lenslets.subapertures.len();
        let map = footprint.len();
        let mut sensor = Self { lenslets, detector, map, reference: vec![0.0; slopes], unit_mas: 1.0, moved: None };
        let mut flat = vec![0.0; slopes];
        sensor.detector.raw(&footprint.zeros(), None, &mut flat);
        let mut tilted = vec![0.0; slopes];
        sensor.detector.raw(&tilt(CALIBRATION_MAS, &pupil.grid, footprint), None, &mut tilted);
        let light = &sensor.lenslets.light;
        let best = (0..light.len()).max_by(|&a, &b| light[a].total_cmp(&light[b])).unwrap_or(0);
        let response = tilted[best] - flat[best];
        if !(response.is_finite() && response > 0.0) {
            return Err(Error::Value(format!(
                "the wavefront sensor answers a tilt of {CALIBRATION_MAS} mas with {response}: a positive answer is needed; \
                 its threshold may be above the light"
            )));
        }
        sensor.unit_mas = CALIBRATION_MAS as f32 / response;
        sensor.reference = flat.iter().map(|slope| slope * sensor.unit_mas).collect();
        Ok(sensor)
    }

    /// This sensor as it is now, some time after its calibration: with the scene's shift of the lenslets and gain of the
    /// slopes. `pupil` and `footprint` are those it was made with.
    ///
    /// # Errors
    /// [`Error::Value`] for lenslets that have left a subaperture in use without light.
    pub fn as_it_is(mut self, scene: &SensorScene, pupil: &Pupil, footprint: &Footprint) -> Result<Self> {
        self.unit_mas *= scene.slope_gain as f32;
        self.reference.iter_mut().for_each(|slope| *slope *= scene.slope_gain as f32);
        let [x, y] = [0, 1].map(|axis| scene.shift_subapertures.get(axis).copied().unwrap_or(0.0));
        if (x, y) != (0.0, 0.0) {
            let samples = self.lenslets.samples as f64;
            let (moved, seen) = Moved::by([x * samples, y * samples], pupil, footprint);
            self.lenslets = self.lenslets.before(&seen);
            if self.lenslets.light.iter().any(|&light| light <= 0.0) {
                return Err(Error::Value(format!(
                    "wavefront_sensor.shift_subapertures = [{x}, {y}] leaves a subaperture in use without light: less is \
                     accepted"
                )));
            }
            self.detector = Detector::of(scene, &self.lenslets, &pupil.grid, &Footprint::of(&seen));
            self.moved = Some(moved);
        }
        Ok(self)
    }

    /// The lenslets and which of them are used.
    pub fn lenslets(&self) -> &Lenslets {
        &self.lenslets
    }

    /// Number of slopes: two for each subaperture.
    pub fn slopes(&self) -> usize {
        self.reference.len()
    }

    /// Measures `opd_nm`, a map over the footprint; without `light` there is no noise. Writes `[all x, all y]`, mas.
    ///
    /// # Errors
    /// [`Error::Shape`] where either has another length.
    pub fn measure(&mut self, opd_nm: &[f32], light: Option<&mut Light>, slopes_mas: &mut [f32]) -> Result<()> {
        if opd_nm.len() != self.map || slopes_mas.len() != self.slopes() {
            return Err(Error::Shape(format!(
                "{} slopes of a map of {} samples were asked for: {} of {} are accepted",
                slopes_mas.len(),
                opd_nm.len(),
                self.slopes(),
                self.map
            )));
        }
        let opd_nm = self.moved.as_mut().map_or(opd_nm, |moved| moved.look(opd_nm));
        self.detector.raw(opd_nm, light, slopes_mas);
        for (slope, reference) in slopes_mas.iter_mut().zip(&self.reference) {
            *slope = *slope * self.unit_mas - reference;
        }
        Ok(())
    }
}

/// A wavefront that grows along +x by `mas`, nm.
fn tilt(mas: f64, grid: &Grid, footprint: &Footprint) -> Lines {
    let mut map = footprint.zeros();
    for row in map.chunks_exact_mut(footprint.stride()) {
        for (x, out) in row.iter_mut().take(grid.samples()).enumerate() {
            *out = (mas / MAS_PER_NM_M * grid.coordinate_m(x)) as f32;
        }
    }
    map
}

#[cfg(test)]
mod tests;

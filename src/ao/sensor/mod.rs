//! Wavefront sensor: lenslets, spots, detector and slopes of a Shack-Hartmann sensor, or a pyramid
//! and its images of the pupil.
//!
//! A slope is the tilt of the wavefront over a subaperture as an angle on the sky, mas: positive
//! along x where the wavefront grows along +x. Slopes are `[all x, all y]` over the subapertures in
//! use, ascending. Subapertures of a pyramid are the pixels of an image of the pupil; a slope is
//! the tilt of the whole wavefront that has the pixel's signal on average.

mod geometric;
mod lenslets;
mod light;
mod misregistration;
mod pixels;
mod pyramid;
mod quad_cell;
mod reference;
mod slope_order;

pub use lenslets::{Lenslets, MAS_PER_NM_M};
pub use light::GuideStar;
pub(in crate::ao) use reference::reference_mas;
pub(crate) use reference::{MOVED_REFERENCE, moved_reference, reference_slopes};
pub use slope_order::SlopeFormat;
pub(crate) use slope_order::{OTHER_SLOPE_ORDERS, slope_sources};

use super::aligned::AlignedBuffer;
use super::footprint::Footprint;
use crate::grid::Grid;
use crate::pupil::Pupil;
use crate::scene::{SensorDetector, SensorScene};
use crate::{Error, Result};
use geometric::Geometric;
use misregistration::Misregistration;
use pixels::SensorPixels;
use pyramid::Pyramid;
use quad_cell::QuadCell;

/// Tilt that calibrates the slopes, mas: a thousandth of a spot's width, so that the response is
/// linear, and 1e4 times the resolution of single precision.
const CALIBRATION_MAS: f64 = 1.0;

/// Detector behind the lenslets or the pyramid.
#[derive(Clone)]
enum Detector {
    QuadCell(QuadCell),
    Pixels(SensorPixels),
    Geometric(Geometric),
    Pyramid(Box<Pyramid>),
}

impl Detector {
    fn new(scene: &SensorScene, lenslets: &Lenslets, grid: &Grid, footprint: &Footprint) -> Self {
        if scene.is_pyramid() {
            return Self::Pyramid(Box::new(Pyramid::new(scene, lenslets, footprint)));
        }
        match scene.detector {
            SensorDetector::QuadCell => Self::QuadCell(QuadCell::new(lenslets, footprint, scene.wavelength_nm)),
            SensorDetector::Pixels => Self::Pixels(SensorPixels::new(scene, lenslets, footprint)),
            SensorDetector::Geometric => Self::Geometric(Geometric::new(lenslets, grid, footprint)),
        }
    }

    /// Measures slopes in the detector's own unit.
    fn raw_slopes(&mut self, opd_nm: &[f32], light: Option<&mut GuideStar>, slopes: &mut [f32]) {
        match self {
            Self::QuadCell(cell) => cell.raw_slopes(opd_nm, light, slopes),
            Self::Pixels(pixels) => pixels.raw_slopes(opd_nm, light, slopes),
            Self::Geometric(geometric) => geometric.raw_slopes(opd_nm, slopes),
            Self::Pyramid(pyramid) => pyramid.raw_slopes(opd_nm, light, slopes),
        }
    }

    /// Response to a tilt from its slopes along x and those of a flat wavefront, subapertures with
    /// this `light`: that of the brightest lenslet; the mean of a pyramid, whose pixels differ.
    fn response(&self, tilted: &[f32], flat: &[f32], light: &[f64]) -> f32 {
        let difference = |i: usize| tilted[i] - flat[i];
        match self {
            Self::Pyramid(_) => {
                let all: f64 = light.iter().enumerate().map(|(i, light)| light * f64::from(difference(i))).sum();
                (all / light.iter().sum::<f64>()) as f32
            }
            _ => difference((0..light.len()).max_by(|&a, &b| light[a].total_cmp(&light[b])).unwrap_or(0)),
        }
    }
}

/// Calibrated wavefront sensor.
#[derive(Clone)]
pub struct Sensor {
    lenslets: Lenslets,
    detector: Detector,
    /// Values of a map over the footprint.
    map: usize,
    /// Slopes of a flat wavefront, mas.
    reference: Vec<f32>,
    /// Detector's own unit, mas.
    unit_mas: f32,
    /// Motion of the lenslets since the calibration.
    moved: Option<Misregistration>,
}

impl Sensor {
    /// Builds and calibrates the sensor of `scene` over a pupil on the simulator's grid.
    ///
    /// The scale of the slopes is the response of the brightest lenslet, or the mean one of a
    /// pyramid's pixels, to a small tilt; their zero is a flat wavefront.
    ///
    /// # Errors
    /// [`Error::Value`] for a sensor that does not respond to a tilt.
    pub fn new(scene: &SensorScene, lenslets: Lenslets, pupil: &Pupil, footprint: &Footprint) -> Result<Self> {
        let detector = Detector::new(scene, &lenslets, &pupil.grid, footprint);
        let slopes = 2 * lenslets.subapertures.len();
        let map = footprint.len();
        let mut sensor = Self { lenslets, detector, map, reference: vec![0.0; slopes], unit_mas: 1.0, moved: None };
        let mut flat = vec![0.0; slopes];
        sensor.detector.raw_slopes(&footprint.zeros(), None, &mut flat);
        let mut tilted = vec![0.0; slopes];
        sensor.detector.raw_slopes(&tilt(CALIBRATION_MAS, &pupil.grid, footprint), None, &mut tilted);
        let response = sensor.detector.response(&tilted, &flat, &sensor.lenslets.light);
        if !(response.is_finite() && response > 0.0) {
            return Err(Error::Value(format!(
                "the wavefront sensor's response to a tilt of {CALIBRATION_MAS} mas is {response}; a positive response is \
                 needed: check that wavefront_sensor.threshold_e is below the star's signal"
            )));
        }
        sensor.unit_mas = CALIBRATION_MAS as f32 / response;
        sensor.reference = flat.iter().map(|slope| slope * sensor.unit_mas).collect();
        Ok(sensor)
    }

    /// This sensor with the changes since its calibration: the scene's misregistration of the
    /// lenslets and gain of the slopes. `pupil` and `footprint` are those of [`Sensor::new`].
    ///
    /// # Errors
    /// [`Error::Value`] for a misregistration that leaves a subaperture in use without light.
    pub fn with_changes(mut self, scene: &SensorScene, pupil: &Pupil, footprint: &Footprint) -> Result<Self> {
        self.unit_mas *= scene.slope_gain as f32;
        self.reference.iter_mut().for_each(|slope| *slope *= scene.slope_gain as f32);
        if let Some((moved, seen)) = Misregistration::new(scene, pupil, footprint) {
            self.lenslets = self.lenslets.with_light_of(&seen);
            if self.lenslets.light.iter().any(|&light| light <= 0.0) {
                return Err(Error::Value(format!(
                    "wavefront_sensor.shift_subapertures = {:?}, rotation_deg = {} and magnification = {} leave a subaperture in use \
                     without light; smaller changes are needed",
                    scene.shift_subapertures, scene.rotation_deg, scene.magnification
                )));
            }
            self.detector = Detector::new(scene, &self.lenslets, &pupil.grid, &Footprint::new(&seen));
            self.moved = Some(moved);
        }
        Ok(self)
    }

    /// Lenslets, and the subapertures in use.
    pub fn lenslets(&self) -> &Lenslets {
        &self.lenslets
    }

    /// Whether a slope depends on the wavefront over its subaperture alone.
    pub(crate) fn is_local(&self) -> bool {
        !matches!(self.detector, Detector::Pyramid(_))
    }

    /// Least operations of a frame of a pyramid; `None` for lenslets.
    pub(super) fn pyramid_operations(&self) -> Option<f64> {
        match &self.detector {
            Detector::Pyramid(pyramid) => Some(pyramid.operations()),
            _ => None,
        }
    }

    /// Number of slopes: two for each subaperture.
    pub fn slopes(&self) -> usize {
        self.reference.len()
    }

    /// Measures the slopes `[all x, all y]`, mas, of `opd_nm`, a map over the footprint; noise-free
    /// without `light`.
    ///
    /// # Errors
    /// [`Error::Shape`] if either has a wrong length.
    pub fn measure(&mut self, opd_nm: &[f32], light: Option<&mut GuideStar>, slopes_mas: &mut [f32]) -> Result<()> {
        if opd_nm.len() != self.map || slopes_mas.len() != self.slopes() {
            return Err(Error::Shape(format!(
                "{} slopes of a map of {} samples were requested; {} of {} are accepted",
                slopes_mas.len(),
                opd_nm.len(),
                self.slopes(),
                self.map
            )));
        }
        let opd_nm = self.moved.as_mut().map_or(opd_nm, |moved| moved.apply(opd_nm));
        self.detector.raw_slopes(opd_nm, light, slopes_mas);
        for (slope, reference) in slopes_mas.iter_mut().zip(&self.reference) {
            *slope = *slope * self.unit_mas - reference;
        }
        Ok(())
    }
}

/// Map of a wavefront that grows along +x by the angle `mas`, nm.
fn tilt(mas: f64, grid: &Grid, footprint: &Footprint) -> AlignedBuffer {
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

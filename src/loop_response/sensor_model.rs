//! Wavefront sensor model: slopes of retrieved wavefronts, to compare with the slopes measured
//! during each exposure.
//!
//! Sensor and camera measure the same turbulence at the same time; only the NCPA are the camera's
//! own. In the differences of slopes the turbulence, its aliases, the mirror and the segments
//! cancel image by image, and the scatter is that of the noise of sensor and retrieval: 2 nm of a
//! mode in an image instead of 20.

mod interpolation;
#[cfg(test)]
mod tests;

use super::gain_loss::loop_gains;
use super::mirror_fit::MirrorFit;
use super::segment_surface::SegmentSurface;
use super::slope_information::{SensorResponse, SlopeInformation};
use super::slope_regression::{SlopeRegression, slope_gain};
use crate::ao::{AlignedBuffer, Footprint, Lenslets, Sensor, actuators, sensor_pupil};
use crate::linear_algebra::{SpdInverse, combination};
use crate::machine;
use crate::modes::{InfluenceFunctions, Samples, SmoothBasis};
use crate::pupil::Grid;
use crate::retrieval::IlluminatedSamples;
use crate::scene::System;
use crate::telescope::Telescope;
use crate::{Error, Result};
use interpolation::{interpolated, interpolation};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, ArrayViewMut2, Axis, s};
use rayon::prelude::*;

/// Amplitude with which the response to a mode is measured, ±, nm RMS: small against the sensor's
/// wavelength.
const POKE_NM: f64 = 10.0;

/// Images about which the response is measured: spots blurred by turbulence reduce a quad cell's
/// gain, nearly equally in every image.
const RESPONSE_IMAGES: usize = 6;

/// Tilt with which the gains of single slopes are measured, ±: 1 mas.
const TILT_NM_PER_M: f64 = 4.85;

/// Relative error of the shape that a mirror has taken about moved reference slopes, RMS, as a
/// whole: the gain of a quad cell changes with turbulence, and slopes weight images by it. About 74
/// nm of NCPA on Keck four sequences of 25 images, of different turbulence, had errors of 0.8, 1.2,
/// 1.8 and 2.9 nm along that shape, where the scatter between their images made error bars of 0.5
/// nm.
const MOVED_SHAPE_ERROR: f64 = 0.025;

/// Response of a mode to reference slopes, over the RMS of all, below which it has not been moved.
const LEAST_RESPONSE: f64 = 1e-3;

/// Least number of measurements that a thread makes at once: enough to pay for its copy of the
/// sensor.
const ROWS_OF_A_THREAD: usize = 4;

/// A thread's own copy of the sensor, with its work arrays.
struct OwnSensor {
    sensor: Sensor,
    map_nm: AlignedBuffer,
    slopes_mas: Vec<f32>,
}

/// Wavefront sensor of a scene, for wavefronts on other samples than its own.
pub struct SensorModel {
    sensor: Sensor,
    footprint: Footprint,
    /// Index of each illuminated sample of the sensor's grid in a map over the footprint.
    indices: Vec<usize>,
    /// Segments at these samples.
    surface: SegmentSurface,
    /// Interpolation of its wavefront: retrieved samples and their weights.
    interpolation: Vec<[(u32, f64); 4]>,
    /// Modes at the samples of the sensor, `[mode, sample]`.
    modes: Array2<f64>,
    /// Inverse of the modes' scalar products, once it is needed.
    inverse_gram: Option<Array2<f64>>,
    /// The samples of the sensor, and their grid.
    samples: Samples,
    grid: Grid,
    /// The mirror that takes corrections of the NCPA.
    mirror: Option<InfluenceFunctions>,
    /// Response of the slopes to the modes, once it is measured.
    response: Option<SensorResponse>,
    /// [`SensorModel::reference_mas_per_nm`], once it is measured.
    reference_mas_per_nm: Option<Array2<f64>>,
    /// By how much corrections have moved the reference slopes, mas.
    moved_reference_mas: Option<Array1<f64>>,
    /// Measured slopes over those of the wavefronts: turbulence that an exposure averages, and a
    /// retrieval does not resolve, blurs spots further.
    gain: f64,
}

impl SensorModel {
    /// The sensor of `scene`, for wavefronts on the illuminated `samples` and NCPA of `basis`.
    ///
    /// # Errors
    /// [`Error::Scene`] for a scene without a sensor; those of building it.
    pub fn new(
        scene: &System,
        telescope: &Telescope,
        samples: &IlluminatedSamples,
        basis: &SmoothBasis,
    ) -> Result<Self> {
        let Some(sensing) = &scene.wavefront_sensor else {
            let name = scene.name();
            return Err(Error::Scene(format!("{name}: the section [wavefront_sensor] is missing: slopes need it")));
        };
        let pupil = sensor_pupil(scene, sensing, telescope, 0)?;
        let footprint = Footprint::new(&pupil);
        let sensor = Sensor::new(sensing, Lenslets::new(sensing, &pupil, scene.directory())?, &pupil, &footprint)?
            .with_changes(sensing, &pupil, &footprint)?;
        let fine = Samples::from_pupil(&pupil)?;
        let n = pupil.grid.samples();
        let (count, places) = (basis.len(), fine.indices.len());
        // Values of the modes, and of the functions that they combine.
        machine::check_memory(
            format_args!("the wavefront sensor's view of {count} modes at {places} samples"),
            2 * 8 * (count * places) as u64,
            "set fewer wavefront_sensor.samples_per_lenslet",
        )?;
        let owner = |&at: &usize| ((at / n, at % n), pupil.owner[[at / n, at % n]].max(0) as usize);
        let owned: Vec<_> = fine.indices.iter().map(owner).collect();
        Ok(Self {
            indices: fine.indices.iter().map(|&at| at / n * footprint.stride() + at % n).collect(),
            surface: SegmentSurface::new(&owned, &pupil, &telescope.pupil),
            interpolation: interpolation(samples, &fine),
            modes: basis.evaluate(&fine.xs_m, &fine.ys_m)?,
            inverse_gram: None,
            samples: fine,
            grid: pupil.grid,
            mirror: scene.has_mirror().then(|| actuators(scene, sensor.lenslets(), telescope)).transpose()?,
            response: None,
            reference_mas_per_nm: None,
            moved_reference_mas: None,
            gain: 1.0,
            sensor,
            footprint,
        })
    }

    /// This sensor in a loop whose reference slopes corrections of the NCPA have moved by
    /// `moved_mas`.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of slopes, [`Error::Value`] for one that is not finite.
    pub fn with_moved_reference(self, moved_mas: Option<Array1<f64>>) -> Result<Self> {
        let (given, needed) = (moved_mas.iter().flatten(), self.slopes());
        if let Some((slope, mas)) = given.clone().enumerate().find(|(_, mas)| !mas.is_finite()) {
            return Err(Error::Value(format!(
                "reference slope {} was moved by {mas} mas: a finite number is needed",
                slope + 1
            )));
        }
        if moved_mas.is_some() && given.clone().count() != needed {
            let given = given.count();
            return Err(Error::Shape(format!("{given} moves of reference slopes were given: {needed} are needed")));
        }
        Ok(Self { moved_reference_mas: moved_mas, ..self })
    }

    /// Number of slopes, `[all x, all y]`.
    pub fn slopes(&self) -> usize {
        self.sensor.slopes()
    }

    /// Reference slopes about which a loop behind segments without errors moves its mirror by 1 nm
    /// of each mode, `[mode, slope]`, mas; `None` before [`SensorModel::ncpa_information`].
    pub fn reference_mas_per_nm(&self) -> Option<&Array2<f64>> {
        self.reference_mas_per_nm.as_ref()
    }

    /// Compares the slopes measured during each exposure (`[image, slope]`, mas) with those of the
    /// images' wavefronts (`[image, sample]`, nm), segments and NCPA included.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of slopes or images.
    pub fn compare_slopes(
        &self,
        wavefronts_nm: ArrayView2<f64>,
        slopes_mas: ArrayView2<f64>,
    ) -> Result<SlopeRegression> {
        let images = wavefronts_nm.nrows();
        if slopes_mas.dim() != (images, self.slopes()) {
            let (given, needed) = (slopes_mas.dim(), (images, self.slopes()));
            return Err(Error::Shape(format!("slopes of the shape {given:?} were given: {needed:?} is needed")));
        }
        let flat_nm = self.flat_segments_nm();
        let mut predicted_mas = Array2::zeros(slopes_mas.dim());
        self.fill_rows(predicted_mas.view_mut(), |image, own| {
            let fine_nm = interpolated(&self.interpolation, wavefronts_nm.row(image));
            self.measure(own, &flat_nm, fine_nm.view())
        })?;
        let lenslets = self.sensor.lenslets();
        Ok(SlopeRegression::new(predicted_mas.view(), slopes_mas, lenslets.across, &lenslets.subapertures))
    }

    /// Coefficients of segments that add nothing to a wavefront.
    fn flat_segments_nm(&self) -> Vec<f64> {
        vec![0.0; self.surface.segments()]
    }

    /// A sensor of its own for a thread.
    fn own_sensor(&self) -> OwnSensor {
        OwnSensor {
            sensor: self.sensor.clone(),
            map_nm: self.footprint.zeros(),
            slopes_mas: vec![0.0; self.sensor.slopes()],
        }
    }

    /// Fills the rows of `slopes_mas` with the slopes that `measure` gives for each, on all cores.
    fn fill_rows(
        &self,
        mut slopes_mas: ArrayViewMut2<f64>,
        measure: impl Fn(usize, &mut OwnSensor) -> Result<Array1<f64>> + Sync,
    ) -> Result<()> {
        let rows = slopes_mas.axis_iter_mut(Axis(0)).into_par_iter().enumerate().with_min_len(ROWS_OF_A_THREAD);
        rows.try_for_each_init(
            || self.own_sensor(),
            |own, (row, mut slopes_mas)| {
                slopes_mas.assign(&measure(row, own)?);
                Ok(())
            },
        )
    }

    /// Computes the slopes of a wavefront: segments with sharp edges, and the rest at the samples
    /// of the sensor.
    fn measure(&self, own: &mut OwnSensor, segments_nm: &[f64], rest_nm: ArrayView1<f64>) -> Result<Array1<f64>> {
        for (sample, (&index, rest)) in self.indices.iter().zip(rest_nm).enumerate() {
            own.map_nm[index] = (rest + self.surface.wavefront_nm(sample, segments_nm)) as f32;
        }
        own.sensor.measure(&own.map_nm, None, &mut own.slopes_mas)?;
        Ok(own.slopes_mas.iter().map(|&slope| f64::from(slope)).collect())
    }

    /// Information on the NCPA from the wavefronts (`[image, sample]`, nm) of images and the slopes
    /// measured during each (`[image, slope]`, mas), about previous estimates of the static errors:
    /// coefficients `segments_nm` of the segment modes `segments` (`[mode, sample]`), and of the
    /// NCPA.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of slopes, images or segment modes.
    pub fn ncpa_information(
        &mut self,
        segments: ArrayView2<f64>,
        wavefronts_nm: ArrayView2<f64>,
        slopes_mas: ArrayView2<f64>,
        segments_nm: &[f64],
        ncpa_nm: &[f64],
    ) -> Result<SlopeInformation> {
        self.surface.check(segments_nm)?;
        if segments.nrows() != segments_nm.len() {
            let (given, needed) = (segments_nm.len(), segments.nrows());
            return Err(Error::Shape(format!(
                "{given} coefficients of {needed} segment modes were given: one each is needed"
            )));
        }
        let (images, slopes) = slopes_mas.dim();
        if slopes != self.slopes() || images != wavefronts_nm.nrows() {
            return Err(Error::Shape(format!(
                "{images} sets of {slopes} slopes were given with {} wavefronts: as many sets of {} are needed",
                wavefronts_nm.nrows(),
                self.slopes()
            )));
        }
        // Interpolation would smooth the segments' edges, so it is done without them.
        let sampled_nm = combination(segments_nm.into(), segments);
        let known_nm = combination(ncpa_nm.into(), self.modes.view());
        let mut rests_nm = Array2::zeros((images, self.modes.ncols()));
        rests_nm.axis_iter_mut(Axis(0)).into_par_iter().zip(wavefronts_nm.axis_iter(Axis(0))).for_each(
            |(mut rest, nm)| {
                let smooth_nm = &nm - &sampled_nm;
                rest.assign(&(interpolated(&self.interpolation, smooth_nm.view()) - &known_nm));
            },
        );
        let rests_nm = rests_nm.view();
        let mut expected_mas = Array2::zeros((images, slopes));
        self.fill_rows(expected_mas.view_mut(), |image, own| self.measure(own, segments_nm, rests_nm.row(image)))?;
        // Measured once: small changes of the static errors change the response by less than its
        // scatter over images, and the iterations end where the differences vanish, for any
        // response.
        let response = match self.response.take() {
            Some(known) => known,
            None => {
                self.gain = slope_gain(expected_mas.view(), slopes_mas);
                let response_mas = self.measure_response(segments_nm, rests_nm)?;
                self.reference_mas_per_nm = Some(self.measure_references(&response_mas, rests_nm)?);
                SensorResponse::new(response_mas)
            }
        };
        // In units of the expected slopes, in which the response was measured.
        let difference_mas = expected_mas - &slopes_mas / self.gain;
        let turbulence_nm = self.in_modes(rests_nm)?;
        let information = response.information(difference_mas.view(), turbulence_nm.view(), ncpa_nm)?;
        self.response = Some(response);
        Ok(match self.moved_shape_nm()? {
            Some(moved_nm) => information.with_uncertainty_along((moved_nm * MOVED_SHAPE_ERROR).view()),
            None => information,
        })
    }

    /// Wavefronts, nm, `[wavefront, sample]`, in the modes, `[wavefront, mode]`: least squares.
    fn in_modes(&mut self, wavefronts_nm: ArrayView2<f64>) -> Result<Array2<f64>> {
        let inverse = match self.inverse_gram.take() {
            Some(known) => known,
            None => SpdInverse::new(&self.modes.dot(&self.modes.t()))?.inverse,
        };
        let coefficients_nm = wavefronts_nm.dot(&self.modes.t()).dot(&inverse);
        self.inverse_gram = Some(inverse);
        Ok(coefficients_nm)
    }

    /// The modes that the mirror took where corrections have moved the reference slopes, nm: least
    /// squares.
    fn moved_shape_nm(&self) -> Result<Option<Array1<f64>>> {
        let (Some(moved_mas), Some(per_nm)) = (&self.moved_reference_mas, &self.reference_mas_per_nm) else {
            return Ok(None);
        };
        let mut normal = per_nm.dot(&per_nm.t());
        let least = LEAST_RESPONSE * LEAST_RESPONSE * normal.diag().mean().unwrap_or(0.0);
        normal.diag_mut().iter_mut().for_each(|value| *value += least);
        Ok(Some(SpdInverse::new(&normal)?.inverse.dot(&per_nm.dot(moved_mas))))
    }

    /// Measures the reference slopes for 1 nm of each mode, `[mode, slope]`, mas, from the response
    /// about the images' wavefronts.
    ///
    /// A slope that depends on its own subaperture alone has the response of a flat wavefront times
    /// the gain that the turbulence of the images leaves it. Steps between segments reduce it
    /// further, but they are corrected with the NCPA.
    ///
    /// The loop is to make the shape that is nearest to a mode over the pupil, so the response is
    /// that of this shape. About the slopes of the mode itself it would make the shape whose slopes
    /// are nearest: what the mirror leaves has slopes, too, which it would answer with other
    /// shapes.
    fn measure_references(&self, response_mas: &Array2<f64>, rests_nm: ArrayView2<f64>) -> Result<Array2<f64>> {
        if !self.sensor.is_local() {
            return Ok(response_mas * self.gain);
        }
        let (segments_nm, flat_nm) = (self.flat_segments_nm(), Array1::zeros(self.modes.ncols()));
        let flat_mas = self.tilt_response_mas(&mut self.own_sensor(), &segments_nm, flat_nm.view())?;
        let mut responses_mas = Array2::zeros((rests_nm.nrows(), self.slopes()));
        self.fill_rows(responses_mas.view_mut(), |image, own| {
            self.tilt_response_mas(own, &segments_nm, rests_nm.row(image))
        })?;
        let mirror = self.mirror.as_ref();
        let actuators = mirror.map_or(0, InfluenceFunctions::len);
        let share = (actuators as f64 / self.slopes() as f64).min(1.0);
        let gains = loop_gains(responses_mas.view(), flat_mas.view(), share) * self.gain;
        let mirror = mirror.map(|mirror| MirrorFit::new(mirror, &self.samples, self.grid)).transpose()?;
        let taken_nm = mirror.map_or_else(|| self.modes.clone(), |mirror| mirror.shapes_nm(self.modes.view()));
        let mut references = Array2::zeros(response_mas.dim());
        self.fill_rows(references.view_mut(), |mode, own| {
            Ok(self.response_to(own, taken_nm.row(mode), &segments_nm, flat_nm.view())? * &gains)
        })?;
        Ok(references)
    }

    /// Slopes along the axis of a tilt of each subaperture's wavefront, about a wavefront.
    fn tilt_response_mas(
        &self,
        own: &mut OwnSensor,
        segments_nm: &[f64],
        rest_nm: ArrayView1<f64>,
    ) -> Result<Array1<f64>> {
        let half = self.slopes() / 2;
        let mut response_mas = Array1::zeros(2 * half);
        for (axis, slopes) in [s![..half], s![half..]].into_iter().enumerate() {
            let places_m = if axis == 0 { &self.samples.xs_m } else { &self.samples.ys_m };
            let tilt_nm: Array1<f64> = places_m.iter().map(|place_m| place_m * TILT_NM_PER_M / POKE_NM).collect();
            let along_mas = self.response_to(own, tilt_nm.view(), segments_nm, rest_nm)?;
            response_mas.slice_mut(slopes).assign(&along_mas.slice(slopes));
        }
        Ok(response_mas)
    }

    /// Slopes for a wavefront, of 1 nm as a mode, about another one: half the difference of a push
    /// and a pull, mas.
    fn response_to(
        &self,
        own: &mut OwnSensor,
        shape_nm: ArrayView1<f64>,
        segments_nm: &[f64],
        rest_nm: ArrayView1<f64>,
    ) -> Result<Array1<f64>> {
        let poke_nm = &shape_nm * POKE_NM;
        let push_mas = self.measure(own, segments_nm, (&rest_nm + &poke_nm).view())?;
        let pull_mas = self.measure(own, segments_nm, (&rest_nm - &poke_nm).view())?;
        Ok((push_mas - pull_mas) * (0.5 / POKE_NM))
    }

    /// Measures the slopes for 1 nm of each mode about some of the wavefronts, `[mode, slope]`,
    /// mas.
    fn measure_response(&self, segments_nm: &[f64], rests_nm: ArrayView2<f64>) -> Result<Array2<f64>> {
        let count = RESPONSE_IMAGES.min(rests_nm.nrows());
        let mut responses = Array2::zeros((self.modes.nrows(), self.slopes()));
        self.fill_rows(responses.view_mut(), |mode, own| {
            let mut response = Array1::zeros(self.slopes());
            for share in 0..count {
                let rest_nm = rests_nm.row(share * rests_nm.nrows() / count);
                let about_mas = self.response_to(own, self.modes.row(mode), segments_nm, rest_nm)?;
                response.scaled_add(1.0 / count as f64, &about_mas);
            }
            Ok(response)
        })?;
        Ok(responses)
    }
}

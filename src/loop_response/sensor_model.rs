//! NCPA from what the wavefront sensor did not see: the slopes that the phases behind the images would give, less those
//! that it measured meanwhile.
//!
//! Sensor and camera look through the same turbulence at the same moment; only the NCPA are the camera's own. So the
//! turbulence, its aliases, the mirror and the segments drop out image by image, and what is left scatters with the
//! noise of sensor and retrieval: 2 nm of a mode in an image instead of 20.

use super::slope_information::{Response, Sensed};
use crate::ao::{Footprint, Lenslets, Sensor};
use crate::grid::Grid;
use crate::modes::{Samples, SmoothBasis};
use crate::retrieval::LitSamples;
use crate::scene::Scene;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2};
use rayon::prelude::*;

/// Push and pull with which the sensor's response to a mode is taken, nm RMS: small against its wavelength.
const POKE_NM: f64 = 10.0;

/// Images about which the response is taken: spots that turbulence blurs move less in a quad cell, by nearly as much in
/// every image.
const RESPONDING: usize = 6;

/// Part of a subaperture's light without which a fine sample's phase is taken from its neighbours.
const SHARE_LOST: f64 = 1e-3;

/// The sensor of a scene behind phases on other samples than its own.
pub struct SensorModel {
    sensor: Sensor,
    footprint: Footprint,
    /// Place of each lit sample of the sensor's grid in a map over the footprint, and the segment that owns it.
    places: Vec<(usize, usize)>,
    /// Where its phase comes from: samples of the phases and their weights.
    sources: Vec<[(u32, f64); 4]>,
    /// The modes at those samples, `[mode, sample]`.
    modes: Array2<f64>,
    map_nm: Vec<f32>,
    slopes_mas: Vec<f32>,
    /// What modes do to the slopes, once it was measured.
    response: Option<Response>,
}

impl SensorModel {
    /// The sensor of `scene`, phases on the samples `lit`, NCPA of `basis`.
    ///
    /// # Errors
    /// [`Error::Scene`] for a scene without a sensor; those of building it.
    pub fn of(scene: &Scene, telescope: &Telescope, lit: &LitSamples, basis: &SmoothBasis) -> Result<Self> {
        let Some(sensing) = &scene.wavefront_sensor else {
            let name = scene.name();
            return Err(Error::Scene(format!("{name}: the section [wavefront_sensor] is missing: slopes need it")));
        };
        let grid = Grid::new(sensing.lenslets_across * sensing.samples_per_lenslet, telescope.pupil.grid.width_m())?;
        let pupil = telescope.pupil_on(grid)?;
        let footprint = Footprint::of(&pupil);
        let sensor = Sensor::new(sensing, Lenslets::of(sensing, &pupil, scene.directory())?, &pupil, &footprint)?
            .as_it_is(sensing, &pupil, &footprint)?;
        let fine = Samples::of(&pupil)?;
        let n = grid.samples();
        let place = |&at: &usize| (at / n * footprint.stride() + at % n, pupil.owner[[at / n, at % n]].max(0) as usize);
        Ok(Self {
            places: fine.indices.iter().map(place).collect(),
            sources: sources(lit, &fine),
            modes: basis.evaluate(&fine.xs_m, &fine.ys_m)?,
            map_nm: footprint.zeros().to_vec(),
            slopes_mas: vec![0.0; sensor.slopes()],
            response: None,
            sensor,
            footprint,
        })
    }

    /// Number of slopes, `[all x, all y]`.
    pub fn slopes(&self) -> usize {
        self.slopes_mas.len()
    }

    /// The slopes of the modes alone with these coefficients, mas.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of modes.
    pub fn slopes_mas(&mut self, segments: usize, ncpa_nm: &[f64]) -> Result<Array1<f64>> {
        if ncpa_nm.len() != self.modes.nrows() {
            let (given, needed) = (ncpa_nm.len(), self.modes.nrows());
            return Err(Error::Shape(format!("{given} NCPA coefficients were given: {needed} are needed")));
        }
        self.measure(&vec![0.0; segments], ArrayView1::from(ncpa_nm).dot(&self.modes).view())
    }

    /// The slopes of a phase: pistons with sharp edges, and the rest at the fine samples.
    fn measure(&mut self, pistons_nm: &[f64], rest_nm: ArrayView1<f64>) -> Result<Array1<f64>> {
        debug_assert_eq!(self.map_nm.len(), self.footprint.len());
        for (&(place, segment), rest) in self.places.iter().zip(rest_nm) {
            self.map_nm[place] = (rest + pistons_nm[segment]) as f32;
        }
        self.sensor.measure(&self.map_nm, None, &mut self.slopes_mas)?;
        Ok(self.slopes_mas.iter().map(|&slope| f64::from(slope)).collect())
    }

    /// What the phases (`[image, sample]`, nm) of images show beside the slopes measured meanwhile (`[image, slope]`, mas), about
    /// static errors found before.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of slopes or images.
    pub fn ncpa(
        &mut self,
        lit: &LitSamples,
        phases_nm: ArrayView2<f64>,
        slopes_mas: ArrayView2<f64>,
        pistons_nm: &[f64],
        ncpa_nm: &[f64],
    ) -> Result<Sensed> {
        let (images, slopes) = slopes_mas.dim();
        if slopes != self.slopes() || images != phases_nm.nrows() {
            return Err(Error::Shape(format!(
                "{images} sets of {slopes} slopes were given with {} phases: as many sets of {} are needed",
                phases_nm.nrows(),
                self.slopes()
            )));
        }
        let shown_nm = ArrayView1::from(pistons_nm).dot(&lit.pistons);
        let known_nm = ArrayView1::from(ncpa_nm).dot(&self.modes);
        let rest = |image: usize| {
            let smooth_nm = &phases_nm.row(image) - &shown_nm;
            let fine = |sources: &[(u32, f64); 4]| sources.iter().map(|&(s, w)| w * smooth_nm[s as usize]).sum::<f64>();
            self.sources.iter().map(fine).collect::<Array1<f64>>() - &known_nm
        };
        let rests_nm: Vec<Array1<f64>> = (0..images).into_par_iter().map(rest).collect();
        // Taken once: static errors that are a little better known change the response by less than its images scatter, and
        // what is sought is where nothing is left, whatever the step.
        let response = match self.response.take() {
            Some(known) => known,
            None => Response::of(self.response(pistons_nm, &rests_nm)?),
        };
        let mut unseen_mas = Array2::zeros((images, slopes));
        for (image, rest_nm) in rests_nm.iter().enumerate() {
            let expected_mas = self.measure(pistons_nm, rest_nm.view())?;
            unseen_mas.row_mut(image).assign(&(expected_mas - slopes_mas.row(image)));
        }
        let sensed = response.sensed(unseen_mas.view(), ncpa_nm)?;
        self.response = Some(response);
        Ok(sensed)
    }

    /// Slopes for 1 nm of each mode about some of the phases, `[mode, slope]`, mas.
    fn response(&mut self, pistons_nm: &[f64], rests_nm: &[Array1<f64>]) -> Result<Array2<f64>> {
        let count = RESPONDING.min(rests_nm.len());
        let mut response = Array2::zeros((self.modes.nrows(), self.slopes()));
        for mode in 0..self.modes.nrows() {
            let poke_nm = &self.modes.row(mode) * POKE_NM;
            for share in 0..count {
                let rest_nm = &rests_nm[share * rests_nm.len() / count];
                let push = self.measure(pistons_nm, (rest_nm + &poke_nm).view())?;
                let pull = self.measure(pistons_nm, (rest_nm - &poke_nm).view())?;
                response.row_mut(mode).scaled_add(0.5 / (POKE_NM * count as f64), &(push - pull));
            }
        }
        Ok(response)
    }
}

/// Bilinear interpolation between lit samples; where some are dark the others stand for them, where all are, the nearest.
fn sources(lit: &LitSamples, fine: &Samples) -> Vec<[(u32, f64); 4]> {
    let n = lit.samples;
    let mut sample_at = vec![None; n * n];
    lit.places.iter().enumerate().for_each(|(sample, &place)| sample_at[place] = Some(sample as u32));
    let index = |c_m: f64| (c_m / lit.pitch_m + (n as f64 - 1.0) / 2.0).clamp(0.0, n as f64 - 1.0);
    let between = |x_m: f64, y_m: f64| {
        let (x, y) = (index(x_m), index(y_m));
        let (u, v) = ((x as usize).min(n - 2), (y as usize).min(n - 2));
        let (fx, fy) = (x - u as f64, y - v as f64);
        let corners = [
            (v, u, (1.0 - fy) * (1.0 - fx)),
            (v, u + 1, (1.0 - fy) * fx),
            (v + 1, u, fy * (1.0 - fx)),
            (v + 1, u + 1, fy * fx),
        ];
        let mut found = corners.map(|(v, u, w)| sample_at[v * n + u].map_or((0, 0.0), |sample| (sample, w)));
        let whole: f64 = found.iter().map(|(_, w)| w).sum();
        if whole > SHARE_LOST {
            found.iter_mut().for_each(|(_, w)| *w /= whole);
            return found;
        }
        let away = |sample: usize| (lit.xs_m[sample] - x_m).powi(2) + (lit.ys_m[sample] - y_m).powi(2);
        let nearest = (0..lit.len()).min_by(|&a, &b| away(a).total_cmp(&away(b))).unwrap_or(0);
        [(nearest as u32, 1.0), (0, 0.0), (0, 0.0), (0, 0.0)]
    };
    fine.xs_m.iter().zip(&fine.ys_m).map(|(&x_m, &y_m)| between(x_m, y_m)).collect()
}

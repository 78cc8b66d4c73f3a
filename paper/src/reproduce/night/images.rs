//! Images of the night, and their estimates by a session.

use super::scenario::{BadFrame, NOLLS, Scenario};
use crate::experiment::{Case, Progress};
use cophase::modal::{FitOptions, Session, SessionOptions};
use cophase::modes::{SmoothBasis, Zernikes};
use cophase::scene::Scene;
use cophase::source::{self, Camera, Truth, expose, stream};
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use ndarray::{Array2, s};
use rand::Rng;
use rayon::prelude::*;

/// Images that are made and fitted at a time.
const BATCH: usize = 64;
/// Random numbers of the noise begin at this number above the frame's.
const NOISE_STREAMS: u64 = 1_000;
/// A saturated frame is cut at this fraction of its peak; a cosmic ray leaves so many times the
/// peak, in so many pixels; a shifted star is so many pixels off.
const SATURATED: f64 = 0.4;
const COSMIC_PEAKS: f64 = 5.0;
const COSMIC_PIXELS: usize = 30;
const SHIFT: usize = 8;

/// An image's estimate.
pub struct Estimated {
    pub coefficients_nm: Vec<f64>,
    pub covariance_nm2: Array2<f64>,
    /// One word: `ok`, `misfit`, ...
    pub status: &'static str,
}

/// Makes the images of a scenario.
pub struct Cameraman<'a> {
    scene: &'a Scene,
    scenario: &'a Scenario,
    telescope: Telescope,
    zernikes: SmoothBasis,
    flux_e: f64,
    /// Pistons and Zernike coefficients of each frame, nm.
    aberrations_nm: Vec<Vec<f64>>,
    /// The same in the estimated modes.
    truth_nm: Vec<Vec<f64>>,
}

impl<'a> Cameraman<'a> {
    pub fn new(scene: &'a Scene, case: &Case, scenario: &'a Scenario) -> Result<Self> {
        let first = source::simulate(scene)?.remove(0);
        let telescope = Telescope::new(scene)?;
        let radius_m = 0.5 * telescope.pupil.grid.width_m();
        let zernikes = SmoothBasis::zernike(Zernikes::new(NOLLS, radius_m)?);
        // The first NCPA are those of the scene, in these Zernikes as far as they are.
        let count = zernikes.len();
        let mut first_nm = first.truth.piston_nm.clone();
        first_nm.resize(first_nm.len() + count, 0.0);
        for (place, noll) in NOLLS.enumerate() {
            first_nm[scenario.segments + place] = if noll % 2 == 0 { 12.0 } else { -9.0 };
        }
        let mut made = Self {
            scene,
            scenario,
            telescope,
            zernikes,
            flux_e: first.flux_e,
            aberrations_nm: scenario.walk(&first_nm),
            truth_nm: Vec::new(),
        };
        // Coefficients of the estimated modes are linear in these.
        let unit = |place: usize| -> Result<Vec<f64>> {
            let mut unit_nm = vec![0.0; scenario.segments + count];
            unit_nm[place] = 1.0;
            case.truth_coefficients_nm(&made.truth(&unit_nm)?)
        };
        let units: Vec<Vec<f64>> = (scenario.segments..scenario.segments + count).map(unit).collect::<Result<_>>()?;
        let areas = made.telescope.pupil.segment_areas();
        let whole: f64 = areas.iter().sum();
        let in_modes = |nm: &Vec<f64>| {
            let (pistons_nm, zernikes_nm) = nm.split_at(scenario.segments);
            let mean = pistons_nm.iter().zip(&areas).map(|(nm, area)| nm * area).sum::<f64>() / whole;
            let mut modes_nm: Vec<f64> = pistons_nm.iter().map(|nm| nm - mean).collect();
            modes_nm.resize(units[0].len(), 0.0);
            for (unit, nm) in units.iter().zip(zernikes_nm) {
                modes_nm.iter_mut().zip(unit).for_each(|(sum, unit)| *sum += unit * nm);
            }
            modes_nm
        };
        made.truth_nm = made.aberrations_nm.iter().map(in_modes).collect();
        Ok(made)
    }

    /// Coefficients of the estimated modes of each frame, nm.
    pub fn truth_nm(&self) -> &[Vec<f64>] {
        &self.truth_nm
    }

    fn truth(&self, aberrations_nm: &[f64]) -> Result<Truth> {
        let (pistons_nm, zernikes_nm) = aberrations_nm.split_at(self.scenario.segments);
        let none = self.scene.with(&[("aberrations.segment_piston_rms_nm", "0"), ("aberrations.ncpa_rms_nm", "0")])?;
        Truth::draw(&none, &self.telescope, &mut stream(1, 0))?
            .with_pistons(&self.telescope, pistons_nm.to_vec())?
            .with_added_ncpa(&self.telescope, self.zernikes.clone(), zernikes_nm.to_vec())
    }

    /// Image of a frame, electrons, `[y, x]`.
    fn image_e(&self, camera: &Camera, frame: usize) -> Result<Array2<f64>> {
        let psf = camera.psf(&self.truth(&self.aberrations_nm[frame])?)?;
        let mut random = stream(1, NOISE_STREAMS + frame as u64);
        let fault = self.scenario.fault(frame);
        let star = if fault == Some(BadFrame::Empty) { 0.0 } else { self.flux_e * self.scenario.flux(frame) };
        let mut image_e = psf.mapv(|h| expose(&self.scene.image, h, star, &mut random));
        let peak_e = image_e.iter().copied().fold(0.0, f64::max);
        match fault {
            Some(BadFrame::Saturated) => image_e.mapv_inplace(|value| value.min(SATURATED * peak_e)),
            Some(BadFrame::Cosmic) => {
                let (rows, columns) = image_e.dim();
                for _ in 0..COSMIC_PIXELS {
                    let place = random.next_u32() as usize % (rows * columns);
                    image_e[[place / columns, place % columns]] += COSMIC_PEAKS * peak_e;
                }
            }
            Some(BadFrame::Shifted) => {
                let kept = image_e.clone();
                let columns = kept.ncols();
                image_e.slice_mut(s![.., SHIFT..]).assign(&kept.slice(s![.., ..columns - SHIFT]));
                image_e.slice_mut(s![.., ..SHIFT]).assign(&kept.slice(s![.., columns - SHIFT..]));
            }
            Some(BadFrame::Empty) | None => {}
        }
        Ok(image_e)
    }

    /// The estimate of each frame; none where the image could not be fitted.
    pub fn estimates(&self, case: &Case, progress: &Progress) -> Result<Vec<Option<Estimated>>> {
        let camera = Camera::new(self.scene, &self.telescope)?;
        let options = SessionOptions { capacity: BATCH, threads: 0, ..SessionOptions::default() };
        let mut session = Session::new(case.estimator.clone(), &options)?;
        let frames: Vec<usize> = (0..self.scenario.frames).collect();
        let mut estimates = Vec::with_capacity(frames.len());
        for batch in frames.chunks(BATCH) {
            progress.check()?;
            let images: Vec<Array2<f64>> =
                batch.par_iter().map(|&frame| self.image_e(&camera, frame)).collect::<Result<_>>()?;
            for (place, image_e) in images.iter().enumerate() {
                session.frame_mut(place, 0)?.0.assign(image_e);
            }
            session.fit(batch.len(), &FitOptions::default())?;
            for (place, result) in session.channels()[0].results().iter().enumerate() {
                let status = result.report.status.word();
                let covariance_nm2 = match session.refine(place) {
                    Ok(refined) => Some(refined.modes.covariance_nm2),
                    Err(Error::Value(_)) => None,
                    Err(error) => return Err(error),
                };
                let coefficients_nm = result.coefficients_nm.clone();
                estimates.push(covariance_nm2.map(|covariance_nm2| Estimated {
                    coefficients_nm,
                    covariance_nm2,
                    status,
                }));
            }
            progress.add(batch.len());
        }
        Ok(estimates)
    }
}

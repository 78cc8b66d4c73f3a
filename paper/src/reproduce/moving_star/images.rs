//! Images of disturbed nights, and their estimates by a session.

use super::disturbance::{DisturbedNight, Moment, NOLLS, SEGMENTS};
use crate::experiment::Progress;
use cophase::modal::{FitOptions, ModalFitter, Session, SessionOptions};
use cophase::modes::{SmoothBasis, Zernikes};
use cophase::scene::Scene;
use cophase::source::{self, Camera, Truth, expose, stream};
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use ndarray::Array2;
use rand::Rng;
use rayon::prelude::*;
use std::sync::Arc;

/// Images that are made and fitted at a time.
const BATCH: usize = 60;
/// Random numbers of the noise begin at this number above the image's.
const NOISE_STREAMS: u64 = 1_000;
/// Bad pixels of the detector: one in so many, which are known; and what they read, electrons.
const BAD_ONE_IN: u32 = 200;
const BAD_E: f64 = 1e5;

/// An image's estimate, one that a watch gives its tracker.
pub struct Estimated {
    pub coefficients_nm: Vec<f64>,
    pub covariance_nm2: Array2<f64>,
    pub tip_tilt_nm: [f64; 2],
}

/// Makes the images.
pub struct Observatory<'a> {
    scene: &'a Scene,
    telescope: Telescope,
    zernikes: SmoothBasis,
    flux_e: f64,
}

impl<'a> Observatory<'a> {
    pub fn new(scene: &'a Scene) -> Result<Self> {
        let telescope = Telescope::new(scene)?;
        let zernikes = SmoothBasis::zernike(Zernikes::new(NOLLS, 0.5 * telescope.pupil.grid.width_m())?);
        Ok(Self { scene, zernikes, flux_e: source::simulate(scene)?[0].flux_e, telescope })
    }

    /// The image of a moment without bad pixels, electrons, `[y, x]`.
    fn image_e(&self, camera: &Camera, moment: &Moment, seed: u64, number: usize) -> Result<Array2<f64>> {
        let (pistons_nm, zernikes_nm) = moment.aberrations_nm.split_at(SEGMENTS);
        let none = self.scene.with(&[("aberrations.segment_piston_rms_nm", "0"), ("aberrations.ncpa_rms_nm", "0")])?;
        let truth = Truth::draw(&none, &self.telescope, &mut stream(1, 0))?
            .with_pistons(&self.telescope, pistons_nm.to_vec())?
            .with_added_ncpa(&self.telescope, self.zernikes.clone(), zernikes_nm.to_vec())?;
        let psf = camera.psf(&truth)?;
        let mut random = stream(800 + seed, NOISE_STREAMS + number as u64);
        Ok(psf.mapv(|h| expose(&self.scene.image, h, self.flux_e * moment.flux, &mut random)))
    }

    /// The estimate of each image; none where a watch would refuse it.
    pub fn estimates(
        &self,
        fitter: &Arc<ModalFitter>,
        night: &DisturbedNight,
        progress: &Progress,
    ) -> Result<Vec<Option<Estimated>>> {
        let options = SessionOptions { capacity: BATCH, threads: 0, ..SessionOptions::default() };
        let camera = Camera::new(self.scene, &self.telescope)?;
        let mut session = Session::new(fitter.clone(), &options)?;
        let mut random = stream(900 + night.seed, 0);
        let side = self.scene.image.pixels;
        let bad = Array2::from_shape_fn((side, side), |_| random.next_u32().is_multiple_of(BAD_ONE_IN));
        let numbers: Vec<usize> = (0..night.moments.len()).collect();
        let mut estimates = Vec::with_capacity(numbers.len());
        for batch in numbers.chunks(BATCH) {
            progress.check()?;
            let image = |&number: &usize| self.image_e(&camera, &night.moments[number], night.seed, number);
            let images: Vec<Array2<f64>> = batch.par_iter().map(image).collect::<Result<_>>()?;
            for (place, image_e) in images.iter().enumerate() {
                let (mut to_e, mut to_bad) = session.frame_mut(place, 0)?;
                to_bad.assign(&bad);
                to_e.assign(image_e);
                to_e.zip_mut_with(&bad, |e, bad| *e = if *bad { BAD_E } else { *e });
            }
            session.fit(batch.len(), &FitOptions::default())?;
            for (place, result) in session.channels()[0].results().iter().enumerate() {
                let covariance_nm2 = match session.refine(place) {
                    Ok(refined) => Some(refined.modes.covariance_nm2),
                    Err(Error::Value(_)) => None,
                    Err(error) => return Err(error),
                };
                let (coefficients_nm, tip_tilt_nm) = (result.coefficients_nm.clone(), result.report.tip_tilt_nm);
                let usable = covariance_nm2.filter(|_| matches!(result.report.status.word(), "ok" | "misfit"));
                estimates.push(usable.map(|covariance_nm2| Estimated { coefficients_nm, covariance_nm2, tip_tilt_nm }));
            }
            progress.add(batch.len());
        }
        Ok(estimates)
    }
}

//! Fitting a batch of images: all of them advance in lock-step, one batched evaluation per step; those that are done
//! drop out.

use super::fisher::{NULL_FLOOR, Sensitivity};
use super::model::Model;
use super::prepare::Prepared;
use super::recipe::Recipe;
use crate::imaging::{Chain, CpuChain, Exposure, Photometry, Precision};
use crate::optimize::{
    ArgminBfgs, CancelFlag, Metric, Progress, QuasiNewton, RESOLUTION_F32, RESOLUTION_F64, Settings, StopReason,
};
use crate::scene::{Optimizer, Weighting};
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The minimum of one image.
#[derive(Clone)]
pub(super) struct Minimum {
    pub(super) coefficients_nm: Vec<f64>,
    pub(super) flux_e: f64,
    pub(super) background_e: f64,
    pub(super) evaluations: usize,
    pub(super) reason: StopReason,
    /// The exposure as it was weighted last.
    pub(super) exposure: Exposure,
}

/// What a caller sees while it waits: images done of all.
pub type Watch<'a> = dyn FnMut(usize, usize) + 'a;

/// Most often that the weights are renewed from the fitted model. Where the model is right two renewals settle it;
/// where it misfits, each brings about a digit.
const REWEIGHTINGS: usize = 8;
/// Decrease of χ² that is left where a fit stops, at the default step tolerance: √(2·1e-5) = 0.4 % of a σ. A finer step
/// tolerance lowers it as its square.
const DECREMENT: f64 = 1e-5;
/// The step tolerance to which [`DECREMENT`] belongs.
const DECREMENT_STEP_NM: f64 = 1e-3;
/// Largest step of one iteration, as a fraction of the wavelength: about one radian, beyond which the linearisation
/// that made the metric says nothing.
const LARGEST_STEP_WAVES: f64 = 0.2;

/// The paper's way also stops where the objective, in units of the brightest pixel squared, changes by no more than this:
/// a few roundings. Where much is unexplained the gradient never gets small against them, and 2,000 evaluations are
/// spent on nothing; with it 330 lead to within 1e-4 nm of the same point (150 nm of turbulence).
const PAPER_COST_TOLERANCE: f64 = 1e-13;

/// What every fit of a call shares.
pub(super) struct Fitter<'a> {
    pub(super) model: &'a Model,
    pub(super) judge: &'a CpuChain<f64>,
    pub(super) recipe: &'a Recipe,
    pub(super) cancel: Option<&'a CancelFlag>,
}

impl Fitter<'_> {
    /// Fits every prepared image on `chain`.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where the flag went up, and those of the chain.
    pub(super) fn fit(&self, chain: &mut Chain, prepared: &[Prepared], watch: &mut Watch) -> Result<Vec<Minimum>> {
        let exposures: Vec<Exposure> = prepared.iter().map(|image| image.exposure.clone()).collect();
        chain.load(&exposures)?;
        match self.recipe.optimizer {
            Optimizer::Bfgs => self.paper(chain, exposures, watch),
            Optimizer::GaussNewton | Optimizer::Paper => self.lock_step(chain, prepared, exposures, watch),
        }
    }

    /// The paper's way, image by image: BFGS from zero, coefficients in radians, tolerance 1e-6 on the gradient.
    fn paper(&self, chain: &mut Chain, exposures: Vec<Exposure>, watch: &mut Watch) -> Result<Vec<Minimum>> {
        let nm = self.model.optics.parts().wavelength_nm / std::f64::consts::TAU;
        let solver = ArgminBfgs {
            gradient_tolerance: 1e-6,
            cost_tolerance: PAPER_COST_TOLERANCE,
            initial_scale: 1.0,
            max_evaluations: self.recipe.max_evaluations,
            cancel: self.cancel.cloned(),
        };
        let count = exposures.len();
        let mut minima = Vec::with_capacity(count);
        for (image, exposure) in exposures.into_iter().enumerate() {
            let mut objective = |radians: &[f64]| -> Result<(f64, Vec<f64>)> {
                let x = Array1::from(radians.to_vec()) * nm;
                let found = chain.evaluate(&[image], x.view().insert_axis(ndarray::Axis(0)))?.remove(0);
                Ok((found.objective, found.gradient.iter().map(|g| g * nm).collect()))
            };
            let outcome = solver.minimize(&mut objective, &vec![0.0; self.model.optics.modes()])?;
            let (evaluations, reason) = (outcome.evaluations, outcome.reason);
            stop_if_cancelled(reason, image, count)?;
            let coefficients_nm: Vec<f64> = outcome.x.iter().map(|x| x * nm).collect();
            let psf = self.judge.psf(ArrayView1::from(&coefficients_nm));
            let (flux_e, background_e) = photometry(&exposure, &psf);
            minima.push(Minimum { coefficients_nm, flux_e, background_e, evaluations, reason, exposure });
            watch(image + 1, count);
        }
        Ok(minima)
    }

    /// Our way: one batched evaluation per step for all images that are still on their way.
    fn lock_step(
        &self,
        chain: &mut Chain,
        prepared: &[Prepared],
        mut exposures: Vec<Exposure>,
        watch: &mut Watch,
    ) -> Result<Vec<Minimum>> {
        let mut metrics =
            Metrics { model: self.model, judge: self.judge, weighting: self.recipe.weighting, made: BTreeMap::new() };
        let settings = settings(self.model, self.recipe, chain.precision(), self.cancel);
        let start = vec![0.0; self.model.optics.modes()];
        let count = prepared.len();
        let runner = |image| -> Result<Runner> {
            let solver = QuasiNewton::new(metrics.of(image)?, &start, settings.clone())?;
            Ok(Runner { solver, reweightings: 0, weighted_at: Vec::new(), flux_e: 0.0, background_e: 0.0 })
        };
        let mut runners = prepared.iter().map(runner).collect::<Result<Vec<_>>>()?;
        let mut active: Vec<usize> = (0..count).collect();
        while !active.is_empty() {
            let mut points = Array2::zeros((active.len(), start.len()));
            for (mut row, &image) in points.outer_iter_mut().zip(&active) {
                row.assign(&ArrayView1::from(runners[image].solver.ask()));
            }
            let evaluations = chain.evaluate(&active, points.view())?;
            let (mut going, mut ended) = (Vec::with_capacity(active.len()), Vec::new());
            for (&image, evaluation) in active.iter().zip(&evaluations) {
                let solver = &mut runners[image].solver;
                match solver.tell(evaluation.objective, &evaluation.gradient) {
                    Progress::Continue => going.push(image),
                    Progress::Done => {
                        stop_if_cancelled(solver.outcome().reason, count - active.len(), count)?;
                        ended.push(image);
                    }
                }
            }
            let psf = |&image: &usize| self.judge.psf(ArrayView1::from(&runners[image].solver.outcome().x));
            let psfs: Vec<Vec<f64>> = ended.par_iter().map(psf).collect();
            for (&image, psf) in ended.iter().zip(&psfs) {
                let (runner, exposure) = (&mut runners[image], &mut exposures[image]);
                (runner.flux_e, runner.background_e) = photometry(exposure, psf);
                let again =
                    self.recipe.weighting == Weighting::Noise && runner.unsettled(self.recipe.step_tolerance_nm);
                if !(again && runner.solver.outcome().reason.converged()) {
                    continue;
                }
                exposure.weight = weights(psf, runner.flux_e, runner.background_e, &prepared[image].floor_variance_e2);
                chain.replace(image, exposure)?;
                runner.reweightings += 1;
                runner.weighted_at = runner.solver.outcome().x.clone();
                if runner.solver.restart_objective() == Progress::Continue {
                    going.push(image);
                }
            }
            active = going;
            watch(count - active.len(), count);
        }
        let finished = runners.into_iter().zip(exposures);
        Ok(finished
            .map(|(runner, exposure)| {
                let outcome = runner.solver.outcome();
                Minimum {
                    coefficients_nm: outcome.x.clone(),
                    flux_e: runner.flux_e,
                    background_e: runner.background_e,
                    evaluations: outcome.evaluations,
                    reason: outcome.reason,
                    exposure,
                }
            })
            .collect())
    }
}

fn stop_if_cancelled(reason: StopReason, done: usize, count: usize) -> Result<()> {
    if reason == StopReason::Cancelled {
        return Err(Error::Interrupted(format!("{done} of {count} images were fitted")));
    }
    Ok(())
}

/// Coordinates in which the objective looks round: the Gauss-Newton matrix of the flat wavefront, with the weights that
/// an image of this brightness would have. Computed once for all images whose flux and read noise have the same powers of
/// two, which depend on each image alone: so a fit does not depend on what else is in the batch.
struct Metrics<'a> {
    model: &'a Model,
    judge: &'a CpuChain<f64>,
    weighting: Weighting,
    /// By the exponents of the flux and of the variance without photons.
    made: BTreeMap<(i32, i32), Arc<Metric>>,
}

impl Metrics<'_> {
    fn of(&mut self, image: &Prepared) -> Result<Arc<Metric>> {
        let level = image.level_e;
        let good = image.exposure.data_e.iter().zip(&image.floor_variance_e2).filter(|(_, floor)| floor.is_finite());
        let flux_e: f64 = good.clone().map(|(d, _)| d - level).sum::<f64>().max(1.0);
        // Bad pixels are an image's own; one that has many only looks a little less round.
        let floor = good.map(|(_, floor)| *floor).fold(f64::INFINITY, f64::min);
        let key @ (flux_exponent, floor_exponent) = (flux_e.log2().round() as i32, floor.log2().round() as i32);
        if let Some(metric) = self.made.get(&key) {
            return Ok(metric.clone());
        }
        let [flux_e, floor] = [flux_exponent, floor_exponent].map(|exponent| f64::from(exponent).exp2());
        let zero = Array1::zeros(self.model.optics.modes());
        let psf = self.judge.psf(zero.view());
        // The metric and the cost must use the same kind of weights: mixing them loses the capture range.
        let weight: Vec<f64> = match self.weighting {
            Weighting::Noise => weights(&psf, flux_e, 0.0, &vec![floor; psf.len()]),
            Weighting::None => {
                let brightest = flux_e * psf.iter().copied().fold(0.0, f64::max);
                vec![brightest.powi(-2); psf.len()]
            }
        };
        let photometry = image.exposure.photometry;
        let fisher = Sensitivity::at(self.judge, zero.view(), flux_e, &weight, photometry).fisher();
        let metric = Arc::new(Metric::from_gauss_newton(&fisher, NULL_FLOOR)?);
        self.made.insert(key, metric.clone());
        Ok(metric)
    }
}

/// 1/(photon variance of the model + floor); 0 where the floor is infinite.
fn weights(psf: &[f64], flux_e: f64, background_e: f64, floor_variance_e2: &[f64]) -> Vec<f64> {
    let variance = psf.iter().zip(floor_variance_e2).map(|(h, floor)| (flux_e * h + background_e).max(0.0) + floor);
    variance.map(|v| 1.0 / v).collect()
}

/// Variance of each pixel under the fitted model, e²; infinite for a bad pixel.
pub(super) fn variance(psf: &[f64], minimum: &Minimum, floor_variance_e2: &[f64]) -> Vec<f64> {
    weights(psf, minimum.flux_e, minimum.background_e, floor_variance_e2).iter().map(|w| 1.0 / w).collect()
}

/// One image on its way.
struct Runner {
    solver: QuasiNewton,
    reweightings: usize,
    /// Where the last weights were made.
    weighted_at: Vec<f64>,
    flux_e: f64,
    background_e: f64,
}

impl Runner {
    /// Whether new weights could still move the minimum by more than the tolerance.
    fn unsettled(&self, step_tolerance_nm: f64) -> bool {
        let moved = self.solver.outcome().x.iter().zip(&self.weighted_at).map(|(a, b)| (a - b).abs());
        self.reweightings == 0 || (self.reweightings < REWEIGHTINGS && moved.fold(0.0, f64::max) > step_tolerance_nm)
    }
}

fn settings(model: &Model, recipe: &Recipe, precision: Precision, cancel: Option<&CancelFlag>) -> Settings {
    Settings {
        max_evaluations: recipe.max_evaluations,
        step_tolerance: recipe.step_tolerance_nm,
        decrement_tolerance: match recipe.weighting {
            Weighting::Noise => DECREMENT * (recipe.step_tolerance_nm / DECREMENT_STEP_NM).powi(2).min(1.0),
            Weighting::None => 0.0,
        },
        relative_decrement_tolerance: 0.0,
        resolution: match precision {
            Precision::F32 => RESOLUTION_F32,
            Precision::F64 => RESOLUTION_F64,
        },
        max_step: LARGEST_STEP_WAVES * model.optics.parts().wavelength_nm,
        cancel: cancel.cloned(),
        ..Settings::default()
    }
}

/// Flux and background of an exposure for a given PSF.
pub(super) fn photometry(exposure: &Exposure, psf: &[f64]) -> (f64, f64) {
    let (mut w, mut wd, mut wh, mut whh, mut whd) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for ((&weight, &d), &h) in exposure.weight.iter().zip(&exposure.data_e).zip(psf) {
        w += weight;
        wd += weight * d;
        wh += weight * h;
        whh += weight * h * h;
        whd += weight * h * d;
    }
    exposure.photometry.solve(w, wd, wh, whh, whd)
}

/// χ² per degree of freedom of a minimum: 1 where the model is right.
pub(super) fn reduced_chi2(psf: &[f64], minimum: &Minimum, variance_e2: &[f64], seen_modes: usize) -> f64 {
    let (mut sum, mut good) = (0.0, 0usize);
    for ((h, d), v) in psf.iter().zip(&minimum.exposure.data_e).zip(variance_e2) {
        if v.is_finite() {
            sum += (minimum.flux_e * h + minimum.background_e - d).powi(2) / v;
            good += 1;
        }
    }
    let nuisances = match minimum.exposure.photometry {
        Photometry::Fixed { .. } => 0,
        Photometry::FitFlux { .. } => 1,
        Photometry::FitBoth => 2,
    };
    sum / good.saturating_sub(seen_modes + nuisances).max(1) as f64
}

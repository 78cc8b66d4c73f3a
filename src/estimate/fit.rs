//! Fitting a batch of images. On a device all of them advance in lock-step, one batched evaluation per step, and those
//! that are done drop out; on the CPU each thread leads one image after the other to its end. The fits are the same.

use super::alone::Alone;
use super::metrics::Metrics;
use super::minimum::Minimum;
use super::model::Model;
use super::prepare::Prepared;
use super::recipe::Recipe;
use super::residual::{photometry, reduced_chi2};
use super::runner::{Next, Runner, settings};
use crate::imaging::{Chain, CpuChain, Evaluation, Exposure, Polynomial, Precision};
use crate::optimize::{ArgminBfgs, CancelFlag, StopReason};
use crate::scene::Optimizer;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1};
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What a caller sees while it waits: images done of all.
pub type Watch<'a> = dyn FnMut(usize, usize) + 'a;

/// The paper's way also stops where the objective, in units of the brightest pixel squared, changes by no more than this:
/// a few roundings. Where much is unexplained the gradient never gets small against them, and 2,000 evaluations are
/// spent on nothing; with it 330 lead to within 1e-4 nm of the same point (150 nm of turbulence).
const PAPER_COST_TOLERANCE: f64 = 1e-13;

/// Time between two reports of how far the fits on the CPU are, about: the threads wait for each other then.
const REPORT: Duration = Duration::from_millis(100);

/// What every fit of a call shares.
pub(super) struct Fitter<'a> {
    pub(super) model: &'a Model,
    pub(super) judge: &'a CpuChain<f64>,
    pub(super) metrics: &'a Metrics,
    pub(super) recipe: &'a Recipe,
    pub(super) cancel: Option<&'a CancelFlag>,
    /// When to stop wherever the fits stand; the paper's way knows none.
    pub(super) deadline: Option<Instant>,
}

impl Fitter<'_> {
    /// Fits every prepared image on `chain`, from `start_nm` of each; the exposures leave with their last weights. Memory
    /// may have no room for all of them at once ([`Model::tiles`]): then they come in tiles, each of which `chain` must
    /// hold. The result is the same: a fit depends on its own image alone.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where the flag went up, and those of the chain.
    pub(super) fn fit(
        &self,
        chain: &mut Chain,
        prepared: &mut [&mut Prepared],
        start_nm: &[&[f64]],
        watch: &mut Watch,
    ) -> Result<Vec<Minimum>> {
        let (count, tile) = (prepared.len(), self.model.tiles().images);
        let mut minima = Vec::with_capacity(count);
        for (prepared, start_nm) in prepared.chunks_mut(tile).zip(start_nm.chunks(tile)) {
            let before = minima.len();
            let mut watch = |done: usize, _: usize| watch(before + done, count);
            minima.extend(self.fit_tile(chain, prepared, start_nm, &mut watch).map_err(|error| match error {
                Error::Interrupted(_) if count > tile => interrupted(before, count),
                other => other,
            })?);
        }
        Ok(minima)
    }

    fn fit_tile(
        &self,
        chain: &mut Chain,
        prepared: &mut [&mut Prepared],
        start_nm: &[&[f64]],
        watch: &mut Watch,
    ) -> Result<Vec<Minimum>> {
        if self.recipe.optimizer != Optimizer::Bfgs {
            let precision = chain.precision();
            match chain.running() {
                Chain::Cpu32(chain) => return self.side_by_side(chain, precision, prepared, start_nm, watch),
                Chain::Cpu64(chain) => return self.side_by_side(chain, precision, prepared, start_nm, watch),
                Chain::Device { .. } | Chain::Auto(_) => {}
            }
        }
        let exposures: Vec<Exposure> = prepared.iter().map(|image| image.exposure.clone()).collect();
        chain.load(&exposures)?;
        match self.recipe.optimizer {
            Optimizer::Bfgs => self.paper(chain, &exposures, prepared, watch),
            Optimizer::GaussNewton | Optimizer::Paper => self.lock_step(chain, prepared, start_nm, watch),
        }
    }

    /// Our way on the CPU: each thread leads one image after the other.
    fn side_by_side<T: Polynomial>(
        &self,
        chain: &CpuChain<T>,
        precision: Precision,
        prepared: &mut [&mut Prepared],
        start_nm: &[&[f64]],
        watch: &mut Watch,
    ) -> Result<Vec<Minimum>> {
        let settings = settings(self.model, self.recipe, precision, self.cancel);
        let (count, modes) = (prepared.len(), self.model.optics.modes());
        let any = self.metrics.any(self.judge)?;
        // A thread's memory is taken up again by whoever comes next: to make it takes as long as a fit.
        let idle = Mutex::new(Vec::new());
        let take = || idle.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let put_back = |memory| idle.lock().unwrap_or_else(PoisonError::into_inner).push(memory);
        let make =
            || -> Result<_> { Ok((Runner::new(any, self.recipe, settings.clone())?, Alone::new(chain), chain.room())) };
        let mut minima = Vec::with_capacity(count);
        let (mut rest, mut part) = (prepared, rayon::current_num_threads());
        while !rest.is_empty() {
            let began = Instant::now();
            let (now, later) = rest.split_at_mut(part.min(rest.len()));
            rest = later;
            let images = now.par_iter_mut().zip(&start_nm[minima.len()..]);
            let found = images.map(|(image, start_nm)| {
                let mut memory = take().map_or_else(make, Ok)?;
                let (runner, alone, loaded) = &mut memory;
                runner.begin(self.metrics.of(self.judge, image)?, start_nm, self.deadline)?;
                alone.lead(chain, runner, image, loaded)?;
                let mut minimum = Minimum::room(modes);
                runner.write(&mut minimum);
                put_back(memory);
                Ok(minimum)
            });
            for minimum in found.collect::<Result<Vec<_>>>()? {
                stop_if_cancelled(minimum.reason, minima.len(), count)?;
                minima.push(minimum);
            }
            watch(minima.len(), count);
            if began.elapsed() < REPORT {
                part *= 2;
            }
        }
        Ok(minima)
    }

    /// The paper's way, image by image: BFGS from zero, coefficients in radians, tolerance 1e-6 on the gradient.
    fn paper(
        &self,
        chain: &mut Chain,
        exposures: &[Exposure],
        prepared: &[&mut Prepared],
        watch: &mut Watch,
    ) -> Result<Vec<Minimum>> {
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
        for (image, exposure) in exposures.iter().enumerate() {
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
            let (flux_e, background_e) = photometry(exposure, &psf);
            let floor_e2 = &prepared[image].floor_variance_e2;
            let reduced_chi2 =
                reduced_chi2(&psf, (flux_e, background_e), exposure, floor_e2, self.model.optics.modes());
            minima.push(Minimum { coefficients_nm, flux_e, background_e, evaluations, reason, reduced_chi2 });
            watch(image + 1, count);
        }
        Ok(minima)
    }

    /// Our way on a device: one batched evaluation per step for all images that are still on their way.
    fn lock_step(
        &self,
        chain: &mut Chain,
        prepared: &mut [&mut Prepared],
        start_nm: &[&[f64]],
        watch: &mut Watch,
    ) -> Result<Vec<Minimum>> {
        let settings = settings(self.model, self.recipe, chain.precision(), self.cancel);
        let (count, modes) = (prepared.len(), self.model.optics.modes());
        let runner = |(image, start_nm): (&&mut Prepared, &&[f64])| -> Result<Runner> {
            let metric = self.metrics.of(self.judge, image)?;
            let mut runner = Runner::new(metric.0, self.recipe, settings.clone())?;
            runner.begin(metric, start_nm, self.deadline)?;
            Ok(runner)
        };
        let mut runners = prepared.par_iter().zip(start_nm).map(runner).collect::<Result<Vec<_>>>()?;
        let mut active: Vec<usize> = (0..count).collect();
        while !active.is_empty() {
            let mut points = Array2::zeros((active.len(), modes));
            for (mut row, &image) in points.outer_iter_mut().zip(&active) {
                row.assign(&ArrayView1::from(runners[image].point()));
            }
            let evaluations = chain.evaluate(&active, points.view())?;
            let told: Vec<(&mut Runner, &mut &mut Prepared, &Evaluation)> = {
                let images = runners.iter_mut().zip(prepared.iter_mut()).enumerate();
                // `active` is in ascending order.
                let mut next = active.iter().zip(&evaluations).peekable();
                let own = |(image, (runner, prepared))| {
                    next.next_if(|(at, _)| **at == image).map(|(_, evaluation)| (runner, prepared, evaluation))
                };
                images.filter_map(own).collect()
            };
            let step =
                |(runner, prepared, evaluation): (&mut Runner, &mut &mut Prepared, &Evaluation)| -> Result<Next> {
                    let next = runner.tell(evaluation);
                    // A device gives no PSFs.
                    let psf = |runner: &Runner| self.judge.psf(ArrayView1::from(runner.point()));
                    match next {
                        Next::Evaluation => {}
                        Next::Renewal => runner.renew(&psf(runner), prepared)?,
                        Next::Psf => runner.settle(&psf(runner), prepared),
                    }
                    Ok(next)
                };
            let next = told.into_par_iter().map(step).collect::<Result<Vec<Next>>>()?;
            let renewed = active.iter().zip(&next).filter(|(_, next)| **next == Next::Renewal).map(|(&image, _)| image);
            let renewed: Vec<(usize, &Exposure)> = renewed.map(|image| (image, &prepared[image].exposure)).collect();
            chain.replace_all(&renewed)?;
            for (&image, next) in active.iter().zip(&next) {
                if *next == Next::Psf {
                    stop_if_cancelled(runners[image].reason(), count - active.len(), count)?;
                }
            }
            active = active.into_iter().zip(&next).filter(|(_, next)| **next != Next::Psf).map(|(i, _)| i).collect();
            watch(count - active.len(), count);
        }
        let minimum = |runner: Runner| {
            let mut minimum = Minimum::room(modes);
            runner.write(&mut minimum);
            minimum
        };
        Ok(runners.into_iter().map(minimum).collect())
    }
}

fn stop_if_cancelled(reason: StopReason, done: usize, count: usize) -> Result<()> {
    if reason == StopReason::Cancelled {
        return Err(interrupted(done, count));
    }
    Ok(())
}

fn interrupted(done: usize, count: usize) -> Error {
    Error::Interrupted(format!("{done} of {count} images were fitted"))
}

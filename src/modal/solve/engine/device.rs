//! Device engine: all images advance in lock-step, one batched evaluation a step, and those that
//! are done drop out.

use crate::imaging::{Chain, Evaluation, Exposure};
use crate::modal::prepare::rejection::weigh_dead;
use crate::modal::prepare::{Frame, PreparedFrame, Preparer, Ringing};
use crate::modal::solve::engine::cpu::CpuEngine;
use crate::modal::solve::engine::task::{Engine, FitState, FitTask, ImageFit, Prepare, interrupted, stop_if_cancelled};
use crate::modal::solve::runner::{Next, Runner, settings};
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, ArrayView2};
use rayon::prelude::*;
use std::borrow::BorrowMut;
use std::time::Instant;

/// Fits on a device, on a chain that it owns or borrows.
pub(in crate::modal) struct DeviceEngine<C: BorrowMut<Chain>> {
    chain: C,
}

impl<C: BorrowMut<Chain> + Send> DeviceEngine<C> {
    pub(in crate::modal) fn new(chain: C) -> Self {
        Self { chain }
    }

    /// Fits a tile of prepared images, which the device has memory for.
    fn fit_tile(&mut self, task: &FitTask, images: &mut [&mut ImageFit]) -> Result<()> {
        match self.chain.borrow_mut().active_chain() {
            // The device was lost before, and the CPU has taken its place.
            Chain::Cpu32(chain) => fit_on_cpu(CpuEngine::new(&*chain, None), task, images),
            Chain::Cpu64(chain) => fit_on_cpu(CpuEngine::new(&*chain, None), task, images),
            Chain::Device { .. } | Chain::Auto(_) | Chain::Several(_) => {
                let exposures: Vec<&Exposure> = images.iter().map(|image| &image.prepared.exposure).collect();
                self.chain.borrow_mut().load(&exposures)?;
                self.lock_step(task, images)
            }
        }
    }

    /// One batched evaluation a step for all images that have not converged.
    fn lock_step(&mut self, task: &FitTask, images: &mut [&mut ImageFit]) -> Result<()> {
        let chain = self.chain.borrow_mut();
        let settings = settings(task.model, task.recipe, chain.precision(), task.control);
        let (count, modes) = (images.len(), task.model.optics.modes());
        let runner = |image: &&mut ImageFit| -> Result<Runner> {
            let metric = task.metrics.for_image(task.reference, &image.prepared)?;
            let mut runner = Runner::new(metric.0, task.recipe, settings.clone())?;
            runner.begin(metric, &image.start_nm, task.control.deadline())?;
            Ok(runner)
        };
        let mut runners = images.par_iter().map(runner).collect::<Result<Vec<_>>>()?;
        let mut active: Vec<usize> = (0..count).collect();
        while !active.is_empty() {
            let mut points = Array2::zeros((active.len(), modes));
            for (mut row, &image) in points.outer_iter_mut().zip(&active) {
                row.assign(&ArrayView1::from(runners[image].point()));
            }
            let evaluations = chain.evaluate(&active, points.view())?;
            let evaluated: Vec<(&mut Runner, &mut &mut ImageFit, &Evaluation)> = {
                let all = runners.iter_mut().zip(images.iter_mut()).enumerate();
                // `active` is in ascending order.
                let mut next = active.iter().zip(&evaluations).peekable();
                let own = |(image, (runner, fit))| {
                    next.next_if(|(at, _)| **at == image).map(|(_, evaluation)| (runner, fit, evaluation))
                };
                all.filter_map(own).collect()
            };
            let step = |(runner, fit, evaluation): (&mut Runner, &mut &mut ImageFit, &Evaluation)| -> Result<Next> {
                let next = runner.advance(evaluation);
                // A device gives no PSFs.
                let psf = |runner: &Runner| task.reference.psf(ArrayView1::from(runner.point()));
                match next {
                    Next::Evaluation => {}
                    Next::Renewal => runner.renew(&psf(runner), &mut fit.prepared)?,
                    Next::Psf => runner.settle(&psf(runner), &fit.prepared),
                }
                Ok(next)
            };
            let next = evaluated.into_par_iter().map(step).collect::<Result<Vec<Next>>>()?;
            let renewed = active.iter().zip(&next).filter(|(_, next)| **next == Next::Renewal).map(|(&image, _)| image);
            let renewed: Vec<(usize, &Exposure)> =
                renewed.map(|image| (image, &images[image].prepared.exposure)).collect();
            chain.replace_all(&renewed)?;
            for (&image, next) in active.iter().zip(&next) {
                if *next == Next::Psf {
                    stop_if_cancelled(runners[image].reason(), count - active.len(), count)?;
                }
            }
            let before = active.len();
            active = active.into_iter().zip(&next).filter(|(_, next)| **next != Next::Psf).map(|(i, _)| i).collect();
            task.control.step(before - active.len());
        }
        for (image, runner) in images.iter_mut().zip(&runners) {
            runner.write(&mut image.minimum);
            image.state = FitState::Fitted;
        }
        Ok(())
    }
}

/// Fits images that are prepared.
fn fit_on_cpu(mut engine: impl Engine, task: &FitTask, images: &mut [&mut ImageFit]) -> Result<()> {
    let mut owned: Vec<ImageFit> = images.iter().map(|image| (**image).clone()).collect();
    let prepared: Vec<_> = owned.iter().map(|image| image.prepared.clone()).collect();
    engine.fit(
        task,
        &|index, _, out| {
            out.clone_from(&prepared[index]);
            Ok(())
        },
        &mut owned,
    )?;
    images.iter_mut().zip(owned).for_each(|(image, fitted)| **image = fitted);
    Ok(())
}

impl<C: BorrowMut<Chain> + Send> Engine for DeviceEngine<C> {
    fn fit(&mut self, task: &FitTask, prepare: &Prepare, images: &mut [ImageFit]) -> Result<()> {
        let began = Instant::now();
        prepare_all(task, prepare, images);
        let (all, tile) = (images.len(), task.model.tiles().images);
        task.check(0, all)?;
        task.metrics.prepare(task.reference);
        let is_late = task.control.is_late();
        let mut ready: Vec<&mut ImageFit> =
            images.iter_mut().filter(|image| !is_late && image.state == FitState::NotBegun).collect();
        if task.recipe.reject_outliers {
            ready.par_iter_mut().for_each(|image| {
                weigh_dead(&mut image.prepared);
            });
        }
        let (count, mut done) = (ready.len(), 0);
        task.control.step(all - count);
        for images in ready.chunks_mut(tile) {
            self.fit_tile(task, images).map_err(|error| match error {
                Error::Interrupted(_) if count > tile => interrupted(done, count),
                other => other,
            })?;
            done += images.len();
        }
        let seconds = began.elapsed().as_secs_f64();
        ready.into_iter().for_each(|image| image.seconds = seconds);
        Ok(())
    }

    fn load(&mut self, task: &FitTask, prepare: &Prepare, images: &mut [ImageFit]) -> Result<()> {
        prepare_all(task, prepare, images);
        // In the place of one that cannot be used is another.
        let Some(usable) = images.iter().find(|image| image.state == FitState::NotBegun) else { return Ok(()) };
        let own = images.iter().map(|image| if image.state == FitState::NotBegun { image } else { usable });
        let exposures: Vec<&Exposure> = own.map(|image| &image.prepared.exposure).collect();
        self.chain.borrow_mut().load(&exposures)
    }

    fn replace(&mut self, image: usize, exposure: &Exposure) -> Result<()> {
        self.chain.borrow_mut().replace_all(&[(image, exposure)])
    }

    fn evaluate(
        &mut self,
        images: &[usize],
        coefficients_nm: ArrayView2<f64>,
        objectives: &mut [f64],
        gradients: &mut [f64],
    ) -> Result<()> {
        let found = self.chain.borrow_mut().evaluate(images, coefficients_nm)?;
        let outputs = objectives.iter_mut().zip(gradients.chunks_exact_mut(coefficients_nm.ncols()));
        for (found, (objective, gradient)) in found.iter().zip(outputs) {
            *objective = found.objective;
            gradient.copy_from_slice(&found.gradient);
        }
        Ok(())
    }

    fn failure(&self) -> Option<&str> {
        self.chain.borrow().failure()
    }
}

/// Prepares `frames`; those that can be used are left as not begun.
pub(in crate::modal) fn prepare_frames(task: &FitTask, frames: &[Frame], images: &mut [ImageFit]) {
    let prepare = |index: usize, preparer: &mut Preparer, prepared: &mut PreparedFrame| {
        preparer.prepare(frames[index], task.recipe, Ringing::Accepted, prepared)
    };
    prepare_all(task, &prepare, images);
}

/// Prepares all frames; those that can be used are left as not begun.
pub(super) fn prepare_all(task: &FitTask, prepare: &Prepare, images: &mut [ImageFit]) {
    let preparation = task.model.preparation;
    images.par_iter_mut().enumerate().for_each_init(
        || Preparer::new(preparation),
        |preparer, (index, image)| {
            image.seconds = 0.0;
            let outcome = prepare(index, preparer, &mut image.prepared);
            image.state = outcome.err().map_or(FitState::NotBegun, FitState::Refused);
        },
    );
}

//! Lane: the memory in which one thread fits one image after the other. An image's data stay in
//! that core's cache, and no thread waits for another.

use crate::Result;
use crate::imaging::{CpuChain, Evaluation, FlatWavefront, LoadedImage, Polynomial, Precision, Scratch};
use crate::modal::prepare::rejection::weigh_dead;
use crate::modal::prepare::{PreparedFrame, Preparer};
use crate::modal::solve::engine::task::{FitState, FitTask, ImageFit, Prepare};
use crate::modal::solve::runner::{Next, Runner, settings};
use crate::optimize::StopReason;
use ndarray::ArrayView1;
use std::time::Instant;

/// One thread's memory. After construction nothing is allocated.
pub(super) struct FitLane<T: Polynomial> {
    preparer: Preparer,
    runner: Runner,
    loaded: LoadedImage<T>,
    scratch: Scratch<T>,
    /// Evaluation at the flat wavefront, where most fits start.
    flat: FlatWavefront<T>,
    evaluation: Evaluation,
    /// PSF in double precision: sums over it give flux, background and χ².
    psf: Vec<f64>,
    /// Coefficients whose PSF is in `scratch`, nm.
    psf_at_nm: Vec<f64>,
}

impl<T: Polynomial> FitLane<T> {
    /// # Errors
    /// [`crate::Error::Value`] for settings out of range, or where no mode changes the image.
    pub(super) fn new(chain: &CpuChain<T>, precision: Precision, task: &FitTask) -> Result<Self> {
        let pixels = chain.optics().sampling().pixels;
        let settings = settings(task.model, task.recipe, precision, task.control);
        Ok(Self {
            preparer: Preparer::new(task.model.preparation),
            runner: Runner::new(task.metrics.first(task.reference)?, task.recipe, settings)?,
            loaded: chain.empty_image(),
            scratch: chain.scratch(),
            flat: chain.flat_wavefront(),
            evaluation: chain.evaluation(),
            psf: vec![0.0; pixels * pixels],
            psf_at_nm: vec![f64::NAN; chain.optics().modes()],
        })
    }

    /// Prepares and fits image `index`, or records why it cannot be used.
    ///
    /// # Errors
    /// As [`CpuChain::set`].
    pub(super) fn fit(
        &mut self,
        chain: &CpuChain<T>,
        task: &FitTask,
        prepare: &Prepare,
        index: usize,
        image: &mut ImageFit,
    ) -> Result<()> {
        let began = Instant::now();
        image.seconds = 0.0;
        image.minimum.reason = StopReason::Unfinished;
        if task.control.is_late() {
            image.state = FitState::NotBegun;
            return Ok(());
        }
        match prepare(index, &mut self.preparer, &mut image.prepared) {
            Ok(()) => {
                if task.recipe.reject_outliers {
                    weigh_dead(&mut image.prepared);
                }
                let metric = task.metrics.for_image(task.reference, &image.prepared)?;
                self.runner.begin(metric, &image.start_nm, task.control.deadline())?;
                self.minimize(chain, &mut image.prepared)?;
                self.runner.write(&mut image.minimum);
                image.state = FitState::Fitted;
            }
            Err(refusal) => image.state = FitState::Refused(refusal),
        }
        image.seconds = began.elapsed().as_secs_f64();
        Ok(())
    }

    /// Runs the optimiser, which has begun, to the minimum of `image`.
    fn minimize(&mut self, chain: &CpuChain<T>, image: &mut PreparedFrame) -> Result<()> {
        chain.set(&mut self.loaded, &image.exposure)?;
        let mut next = Next::Evaluation;
        if self.runner.point().iter().all(|&nm| nm == 0.0) {
            chain.evaluate_flat(&self.loaded, &mut self.flat, &mut self.evaluation);
            next = self.runner.advance(&self.evaluation);
        }
        loop {
            next = match next {
                Next::Evaluation => {
                    let Self { runner, loaded, scratch, evaluation, psf_at_nm, .. } = self;
                    chain.evaluate_one(loaded, runner.point().into(), scratch, evaluation);
                    psf_at_nm.copy_from_slice(runner.point());
                    runner.advance(evaluation)
                }
                Next::Renewal => {
                    self.compute_psf(chain);
                    self.runner.renew(&self.psf, image)?;
                    chain.set(&mut self.loaded, &image.exposure)?;
                    chain.evaluate_at_last_psf(&self.loaded, &mut self.scratch, &mut self.evaluation);
                    self.runner.advance(&self.evaluation)
                }
                Next::Psf => {
                    // Most fits end where they were evaluated last.
                    if self.psf_at_nm == self.runner.point() {
                        widen(self.scratch.psf(), &mut self.psf);
                    } else {
                        self.compute_psf(chain);
                    }
                    self.runner.settle(&self.psf, image);
                    return Ok(());
                }
            };
        }
    }

    /// Computes the PSF at the optimiser's point.
    fn compute_psf(&mut self, chain: &CpuChain<T>) {
        let point_nm = self.runner.point();
        widen(chain.psf_in(point_nm.into(), &mut self.scratch), &mut self.psf);
        self.psf_at_nm.copy_from_slice(point_nm);
    }

    /// Prepares image `index` into `loaded`.
    ///
    /// # Errors
    /// As [`crate::modal::solve::engine::task::Engine::load`].
    pub(super) fn load(
        &mut self,
        chain: &CpuChain<T>,
        prepare: &Prepare,
        index: usize,
        (image, loaded): (&mut ImageFit, &mut LoadedImage<T>),
    ) -> Result<()> {
        match prepare(index, &mut self.preparer, &mut image.prepared) {
            Ok(()) => {
                image.state = FitState::NotBegun;
                chain.set(loaded, &image.prepared.exposure)
            }
            Err(refusal) => {
                image.state = FitState::Refused(refusal);
                Ok(())
            }
        }
    }

    /// Objective and gradient of `loaded` at a point.
    pub(super) fn evaluate(
        &mut self,
        chain: &CpuChain<T>,
        loaded: &LoadedImage<T>,
        coefficients_nm: ArrayView1<f64>,
    ) -> &Evaluation {
        if coefficients_nm.iter().all(|&nm| nm == 0.0) {
            chain.evaluate_flat(loaded, &mut self.flat, &mut self.evaluation);
        } else {
            chain.evaluate_one(loaded, coefficients_nm, &mut self.scratch, &mut self.evaluation);
            self.psf_at_nm.fill(f64::NAN);
        }
        &self.evaluation
    }
}

fn widen<T: Polynomial>(from: &[T], to: &mut [f64]) {
    to.iter_mut().zip(from).for_each(|(to, from)| *to = from.widen());
}

//! Fits on the CPU, one image after the other on each thread, in memory that was taken before.

use super::{Call, Image, ImageResult, SessionOptions, Shared, interrupted, unusable, write_start};
use crate::Result;
use crate::estimate::alone::Alone;
use crate::estimate::prepare::{Preparer, Ringing};
use crate::estimate::runner::{Runner, settings};
use crate::estimate::status::judge;
use crate::imaging::{CpuChain, Loaded, Polynomial, Precision};
use crate::optimize::StopReason;
use ndarray::ArrayView2;
use rayon::prelude::*;
use std::time::Instant;

/// The chain, and what it compares with.
pub(super) struct Single<T: Polynomial> {
    chain: CpuChain<T>,
    /// One per image.
    loaded: Vec<Loaded<T>>,
    /// One per thread.
    lanes: Vec<Lane<T>>,
}

/// One thread's memory.
struct Lane<T: Polynomial> {
    preparer: Preparer,
    runner: Runner,
    alone: Alone<T>,
    start_nm: Vec<f64>,
}

impl<T: Polynomial> Single<T> {
    pub(super) fn new(
        chain: CpuChain<T>,
        shared: &Shared,
        options: &SessionOptions,
        precision: Precision,
    ) -> Result<Self> {
        let threads = if options.threads == 0 { rayon::current_num_threads() } else { options.threads };
        let lanes = (0..threads.min(options.capacity)).map(|_| Lane::new(&chain, shared, precision));
        let lanes = lanes.collect::<Result<Vec<_>>>()?;
        let loaded = vec![chain.room(); options.capacity];
        Ok(Self { chain, loaded, lanes })
    }

    pub(super) fn fit(&mut self, call: &Call, images: &mut [Image], results: &mut [ImageResult]) -> Result<()> {
        let chain = &self.chain;
        let loaded = &mut self.loaded[..images.len()];
        if let [lane] = self.lanes.as_mut_slice() {
            let places = images.iter_mut().zip(loaded).zip(results).enumerate();
            for (index, ((image, loaded), result)) in places {
                lane.fit(chain, call, index, Place { image, loaded, result })?;
            }
            return Ok(());
        }
        let share = images.len().div_ceil(self.lanes.len()).max(1);
        let shares = images.par_chunks_mut(share).zip(loaded.par_chunks_mut(share)).zip(results.par_chunks_mut(share));
        shares.zip(&mut self.lanes).enumerate().try_for_each(|(of, (((images, loaded), results), lane))| {
            let places = images.iter_mut().zip(loaded).zip(results).enumerate();
            for (index, ((image, loaded), result)) in places {
                lane.fit(chain, call, of * share + index, Place { image, loaded, result })?;
            }
            Ok(())
        })
    }

    pub(super) fn load(&mut self, call: &Call, images: &mut [Image]) -> Result<()> {
        let lane = &mut self.lanes[0];
        for (index, (image, loaded)) in images.iter_mut().zip(&mut self.loaded).enumerate() {
            image.fitted = false;
            lane.prepare(call, image).map_err(|refusal| unusable(index, refusal))?;
            self.chain.set(loaded, &image.prepared.exposure)?;
        }
        Ok(())
    }

    pub(super) fn evaluate(&mut self, coefficients_nm: ArrayView2<f64>, objectives: &mut [f64], gradients: &mut [f64]) {
        let (chain, modes) = (&self.chain, coefficients_nm.ncols());
        let one = |lane: &mut Lane<T>, image: usize, loaded: &Loaded<T>, objective: &mut f64, gradient: &mut [f64]| {
            let at = coefficients_nm.row(image);
            let found = lane.alone.evaluate(chain, loaded, at);
            *objective = found.objective;
            gradient.copy_from_slice(&found.gradient);
        };
        let count = objectives.len();
        if let [lane] = self.lanes.as_mut_slice() {
            let places = self.loaded.iter().zip(objectives).zip(gradients.chunks_exact_mut(modes)).enumerate();
            places.for_each(|(image, ((loaded, objective), gradient))| one(lane, image, loaded, objective, gradient));
            return;
        }
        let share = count.div_ceil(self.lanes.len()).max(1);
        let outputs = objectives.par_chunks_mut(share).zip(gradients.par_chunks_mut(share * modes));
        let shares = self.loaded[..count].par_chunks(share).zip(outputs).zip(&mut self.lanes);
        shares.enumerate().for_each(|(of, ((loaded, (objectives, gradients)), lane))| {
            let places = loaded.iter().zip(objectives).zip(gradients.chunks_exact_mut(modes)).enumerate();
            places.for_each(|(index, ((loaded, objective), gradient))| {
                one(lane, of * share + index, loaded, objective, gradient);
            });
        });
    }
}

/// Where one image's fit reads and writes.
struct Place<'a, T> {
    image: &'a mut Image,
    loaded: &'a mut Loaded<T>,
    result: &'a mut ImageResult,
}

impl<T: Polynomial> Lane<T> {
    fn new(chain: &CpuChain<T>, shared: &Shared, precision: Precision) -> Result<Self> {
        let estimator = &shared.estimator;
        let settings = settings(&estimator.model, &shared.recipe, precision, Some(&shared.cancel));
        let metric = estimator.metrics.any(&estimator.judge)?;
        Ok(Self {
            preparer: Preparer::new(estimator.model.preparation),
            runner: Runner::new(metric, &shared.recipe, settings)?,
            alone: Alone::new(chain),
            start_nm: vec![0.0; shared.modes()],
        })
    }

    fn prepare(&mut self, call: &Call, image: &mut Image) -> std::result::Result<(), crate::estimate::Refusal> {
        let Image { data_e, bad, prepared, .. } = image;
        let frame = super::Frame { data_e: data_e.view(), bad: bad.view(), read_noise_e: call.read_noise_e };
        self.preparer.prepare(frame, &call.shared.recipe, Ringing::Refused, prepared)
    }

    /// Fits one image, or says in its result why not.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] where the flag went up.
    fn fit(&mut self, chain: &CpuChain<T>, call: &Call, index: usize, place: Place<T>) -> Result<()> {
        let Place { image, loaded, result } = place;
        let began = Instant::now();
        image.fitted = false;
        call.go_on()?;
        if call.is_late() {
            result.not_begun(call.start_of(index));
            return Ok(());
        }
        match self.prepare(call, image) {
            Ok(()) => {
                self.minimize(chain, call, index, image, loaded)?;
                self.report(call, image, result);
            }
            Err(refusal) => result.refuse(refusal),
        }
        result.seconds = began.elapsed().as_secs_f64();
        Ok(())
    }

    /// Leads the prepared image to its minimum.
    fn minimize(
        &mut self,
        chain: &CpuChain<T>,
        call: &Call,
        index: usize,
        image: &mut Image,
        loaded: &mut Loaded<T>,
    ) -> Result<()> {
        let estimator = &call.shared.estimator;
        write_start(&mut self.start_nm, call.start_of(index));
        let metric = estimator.metrics.of(&estimator.judge, &image.prepared)?;
        self.runner.begin(metric, &self.start_nm, call.deadline)?;
        self.alone.lead(chain, &mut self.runner, &mut image.prepared, loaded)?;
        if self.runner.reason() == StopReason::Cancelled { Err(interrupted()) } else { Ok(()) }
    }

    /// Writes what [`Lane::minimize`] found.
    fn report(&self, call: &Call, image: &mut Image, result: &mut ImageResult) {
        let Shared { estimator, tilts, pistons, .. } = call.shared;
        self.runner.write(&mut image.minimum);
        pistons.centre(&mut image.minimum.coefficients_nm);
        image.fitted = true;
        result.report = judge(&estimator.model, tilts, &image.prepared, &image.minimum);
        result.coefficients_nm.copy_from_slice(&image.minimum.coefficients_nm);
    }
}

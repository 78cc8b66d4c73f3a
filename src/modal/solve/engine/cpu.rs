//! CPU engine: each thread fits one image after the other.

use crate::Result;
use crate::imaging::{CpuChain, Exposure, LoadedImage, Polynomial, Precision};
use crate::modal::solve::engine::lane::FitLane;
use crate::modal::solve::engine::task::{Engine, FitTask, ImageFit, Prepare, stop_if_cancelled};
use ndarray::ArrayView2;
use rayon::prelude::*;
use std::borrow::Borrow;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Fits on CPU threads, on a chain that it owns or borrows.
pub(in crate::modal) struct CpuEngine<T: Polynomial, C: Borrow<CpuChain<T>>> {
    chain: C,
    /// Lanes that no thread uses now.
    lanes: Mutex<Vec<FitLane<T>>>,
    /// Threads that fit; `None` for all that there are.
    threads: Option<usize>,
    /// Exposures for evaluations, one for each image.
    loaded: Vec<LoadedImage<T>>,
}

impl<T: Polynomial, C: Borrow<CpuChain<T>> + Send + Sync> CpuEngine<T, C> {
    /// Takes no memory yet: that of a thread is taken when it fits its first image.
    pub(in crate::modal) fn new(chain: C, threads: Option<usize>) -> Self {
        Self { chain, lanes: Mutex::new(Vec::new()), threads, loaded: Vec::new() }
    }

    /// Takes all memory now, for up to `capacity` images a call.
    ///
    /// # Errors
    /// As [`FitLane::new`].
    pub(in crate::modal) fn allocate(&mut self, task: &FitTask, capacity: usize) -> Result<()> {
        let threads = self.threads.unwrap_or_else(rayon::current_num_threads).min(capacity);
        let chain = self.chain.borrow();
        let lanes = (0..threads).map(|_| FitLane::new(chain, precision::<T>(), task)).collect::<Result<Vec<_>>>()?;
        self.loaded = vec![chain.empty_image(); capacity];
        self.lanes = Mutex::new(lanes);
        Ok(())
    }

    /// Runs `work` with a lane.
    fn with_lane<R>(&self, task: &FitTask, work: impl FnOnce(&mut FitLane<T>) -> Result<R>) -> Result<R> {
        let idle = self.lanes.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut lane = idle.map_or_else(|| FitLane::new(self.chain.borrow(), precision::<T>(), task), Ok)?;
        let outcome = work(&mut lane);
        self.lanes.lock().unwrap_or_else(PoisonError::into_inner).push(lane);
        outcome
    }

    /// All images on the caller's thread: no allocation, and no lock, where the lane is there.
    fn fit_alone(&mut self, task: &FitTask, prepare: &Prepare, images: &mut [ImageFit]) -> Result<()> {
        let (chain, count) = (self.chain.borrow(), images.len());
        let lanes = self.lanes.get_mut().unwrap_or_else(PoisonError::into_inner);
        if lanes.is_empty() {
            lanes.push(FitLane::new(chain, precision::<T>(), task)?);
        }
        let lane = &mut lanes[0];
        for (index, image) in images.iter_mut().enumerate() {
            task.check(index, count)?;
            lane.fit(chain, task, prepare, index, image)?;
            stop_if_cancelled(image.minimum.reason, index, count)?;
            task.control.step(1);
        }
        Ok(())
    }
}

fn precision<T: Polynomial>() -> Precision {
    if size_of::<T>() == size_of::<f32>() { Precision::F32 } else { Precision::F64 }
}

impl<T: Polynomial, C: Borrow<CpuChain<T>> + Send + Sync> Engine for CpuEngine<T, C> {
    fn fit(&mut self, task: &FitTask, prepare: &Prepare, images: &mut [ImageFit]) -> Result<()> {
        if self.threads == Some(1) {
            return self.fit_alone(task, prepare, images);
        }
        let (count, done) = (images.len(), AtomicUsize::new(0));
        images.par_iter_mut().with_max_len(1).enumerate().try_for_each(|(index, image)| {
            task.check(done.load(Ordering::Relaxed), count)?;
            self.with_lane(task, |lane| lane.fit(self.chain.borrow(), task, prepare, index, image))?;
            stop_if_cancelled(image.minimum.reason, done.load(Ordering::Relaxed), count)?;
            done.fetch_add(1, Ordering::Relaxed);
            task.control.step(1);
            Ok(())
        })
    }

    fn load(&mut self, task: &FitTask, prepare: &Prepare, images: &mut [ImageFit]) -> Result<()> {
        let chain = self.chain.borrow();
        let lanes = self.lanes.get_mut().unwrap_or_else(PoisonError::into_inner);
        if lanes.is_empty() {
            lanes.push(FitLane::new(chain, precision::<T>(), task)?);
        }
        let places = images.iter_mut().zip(&mut self.loaded).enumerate();
        places.into_iter().try_for_each(|(index, place)| lanes[0].load(chain, prepare, index, place))
    }

    fn replace(&mut self, image: usize, exposure: &Exposure) -> Result<()> {
        self.chain.borrow().set(&mut self.loaded[image], exposure)
    }

    fn evaluate(
        &mut self,
        images: &[usize],
        coefficients_nm: ArrayView2<f64>,
        objectives: &mut [f64],
        gradients: &mut [f64],
    ) -> Result<()> {
        let (chain, modes, all) = (self.chain.borrow(), coefficients_nm.ncols(), &self.loaded);
        let some = |lane: &mut FitLane<T>, first: usize, images: &[usize], outputs: (&mut [f64], &mut [f64])| {
            let outputs = outputs.0.iter_mut().zip(outputs.1.chunks_exact_mut(modes));
            for ((row, &image), (objective, gradient)) in (first..).zip(images).zip(outputs) {
                let found = lane.evaluate(chain, &all[image], coefficients_nm.row(row));
                *objective = found.objective;
                gradient.copy_from_slice(&found.gradient);
            }
        };
        let lanes = self.lanes.get_mut().unwrap_or_else(PoisonError::into_inner);
        if let [lane] = lanes.as_mut_slice() {
            some(lane, 0, images, (objectives, gradients));
            return Ok(());
        }
        let share = images.len().div_ceil(lanes.len()).max(1);
        let outputs = objectives.par_chunks_mut(share).zip(gradients.par_chunks_mut(share * modes));
        let shares = images.par_chunks(share).zip(outputs).zip(lanes);
        shares.enumerate().for_each(|(of, ((images, outputs), lane))| some(lane, of * share, images, outputs));
        Ok(())
    }
}

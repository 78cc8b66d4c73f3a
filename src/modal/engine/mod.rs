//! Engines: run the fits of a batch of images, on CPU threads or on a device. A fit depends on its own image alone, so
//! that every engine of one precision, whatever its number of threads or images, finds the same.

mod cpu;
mod device;
mod lane;
mod paper;

pub(super) use cpu::CpuEngine;
pub(super) use device::DeviceEngine;

use super::metrics::Metrics;
use super::minimum::Minimum;
use super::model::Model;
use super::prepare::{Preparation, Prepared, Preparer, Refusal};
use super::recipe::Recipe;
use crate::imaging::{Chain, CpuChain};
use crate::optimize::{CancelFlag, StopReason};
use crate::scene::Optimizer;
use crate::{Error, Result};
use ndarray::ArrayView2;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

/// Called with the number of images that are done, and of all.
pub type Watch<'a> = dyn FnMut(usize, usize) + 'a;

/// Prepares frame `index` in memory of the engine's.
pub(super) type Prepare<'a> =
    dyn Fn(usize, &mut Preparer, &mut Prepared) -> std::result::Result<(), Refusal> + Sync + 'a;

/// What all fits of a call share.
pub(super) struct FitTask<'a> {
    pub(super) model: &'a Model,
    /// Reference chain (f64, CPU): metric, weights and χ² come from it whatever chain fits.
    pub(super) reference: &'a CpuChain<f64>,
    pub(super) metrics: &'a Metrics,
    pub(super) recipe: &'a Recipe,
    pub(super) cancel: Option<&'a CancelFlag>,
    /// When to stop wherever the fits stand; the paper's BFGS ignores it.
    pub(super) deadline: Option<Instant>,
}

impl FitTask<'_> {
    fn is_late(&self) -> bool {
        self.deadline.is_some_and(|deadline| Instant::now() >= deadline)
    }

    /// # Errors
    /// [`Error::Interrupted`] where the flag is raised, after `done` of `count` images.
    fn check(&self, done: usize, count: usize) -> Result<()> {
        match self.cancel {
            Some(flag) if flag.load(Ordering::Relaxed) => Err(interrupted(done, count)),
            _ => Ok(()),
        }
    }
}

/// State of an image's fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum FitState {
    /// The deadline came before its turn.
    NotBegun,
    /// The frame cannot be used.
    Refused(Refusal),
    /// There is a minimum.
    Fitted,
}

/// Fit of one image: what goes in, and where it ended.
#[derive(Clone)]
pub(super) struct ImageFit {
    pub(super) prepared: Prepared,
    /// Where the fit starts, nm.
    pub(super) start_nm: Vec<f64>,
    pub(super) minimum: Minimum,
    pub(super) state: FitState,
    /// Wall-clock time of the fit, s; on a device, of the whole batch.
    pub(super) seconds: f64,
}

impl ImageFit {
    /// Memory for the fit of an image with `modes` modes, from the flat wavefront.
    pub(super) fn new(preparation: &Preparation, modes: usize) -> Self {
        Self {
            prepared: preparation.room(),
            start_nm: vec![0.0; modes],
            minimum: Minimum::room(modes),
            state: FitState::NotBegun,
            seconds: 0.0,
        }
    }

    pub(super) fn is_fitted(&self) -> bool {
        self.state == FitState::Fitted
    }

    /// Takes the place of another try, `again`, if that has a smaller χ²; counts the evaluations of both. Whether it did.
    pub(super) fn improve(&mut self, again: Self) -> bool {
        if !again.is_fitted() {
            return false;
        }
        let evaluations = self.minimum.evaluations + again.minimum.evaluations;
        let is_better = again.minimum.reduced_chi2 < self.minimum.reduced_chi2 || self.minimum.reduced_chi2.is_nan();
        if is_better {
            *self = again;
        }
        self.minimum.evaluations = evaluations;
        is_better
    }
}

/// Runs fits. Two implementations: CPU threads, and a device.
pub(super) trait Engine: Send {
    /// Prepares and fits every image from its start.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where the flag was raised, and those of the chain.
    fn fit(&mut self, task: &FitTask, prepare: &Prepare, images: &mut [ImageFit], watch: &mut Watch) -> Result<()>;

    /// Prepares images for [`Engine::evaluate`], with the weights that a fit begins with.
    ///
    /// # Errors
    /// [`Error::Image`] for the first that cannot be used, and those of the chain.
    fn load(&mut self, task: &FitTask, prepare: &Prepare, images: &mut [ImageFit]) -> Result<()>;

    /// Objectives and gradients of the loaded images at `coefficients_nm`, `[image, mode]`.
    ///
    /// # Errors
    /// Those of the chain.
    fn evaluate(
        &mut self,
        coefficients_nm: ArrayView2<f64>,
        objectives: &mut [f64],
        gradients: &mut [f64],
    ) -> Result<()>;

    /// Sentence on a device that was lost and that the CPU replaces.
    fn failure(&self) -> Option<&str> {
        None
    }
}

/// Fits images on `chain`, in memory that is taken for this call.
///
/// # Errors
/// As [`Engine::fit`].
pub(super) fn fit(
    chain: &mut Chain,
    task: &FitTask,
    prepare: &Prepare,
    images: &mut [ImageFit],
    watch: &mut Watch,
) -> Result<()> {
    if task.recipe.optimizer == Optimizer::Bfgs {
        return paper::fit(chain, task, prepare, images, watch);
    }
    match chain.active_chain() {
        Chain::Cpu32(chain) => CpuEngine::new(&*chain, None).fit(task, prepare, images, watch),
        Chain::Cpu64(chain) => CpuEngine::new(&*chain, None).fit(task, prepare, images, watch),
        device => DeviceEngine::new(device).fit(task, prepare, images, watch),
    }
}

/// Time between two reports of progress on the CPU, about: all threads wait for each other then.
const REPORT: Duration = Duration::from_millis(100);

fn stop_if_cancelled(reason: StopReason, done: usize, count: usize) -> Result<()> {
    if reason == StopReason::Cancelled { Err(interrupted(done, count)) } else { Ok(()) }
}

fn interrupted(done: usize, count: usize) -> Error {
    Error::Interrupted(format!("{done} of {count} images were fitted"))
}

fn unusable(image: usize, refusal: Refusal) -> Error {
    Error::Image(format!("frame {image} cannot be used: {refusal}"))
}

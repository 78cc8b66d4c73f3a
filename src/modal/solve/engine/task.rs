//! Interface of the engines: the task, one image's fit, the trait.

use crate::control::Control;
use crate::imaging::{CpuChain, Exposure};
use crate::modal::model::Model;
use crate::modal::model::recipe::Recipe;
use crate::modal::prepare::{Preparation, PreparedFrame, Preparer, Refusal};
use crate::modal::solve::metrics::Metrics;
use crate::modal::solve::minimum::Minimum;
use crate::optimize::StopReason;
use crate::{Error, Result};
use ndarray::ArrayView2;

/// Prepares frame `index` in memory of the engine's.
pub(in crate::modal) type Prepare<'a> =
    dyn Fn(usize, &mut Preparer, &mut PreparedFrame) -> std::result::Result<(), Refusal> + Sync + 'a;

/// What all fits of a call share.
#[derive(Clone, Copy)]
pub(in crate::modal) struct FitTask<'a> {
    pub(in crate::modal) model: &'a Model,
    /// Reference chain (f64, CPU): metric, weights and χ² come from it for every chain that fits.
    pub(in crate::modal) reference: &'a CpuChain<f64>,
    pub(in crate::modal) metrics: &'a Metrics,
    pub(in crate::modal) recipe: &'a Recipe,
    /// Its deadline stops fits, converged or not; the paper's BFGS ignores it.
    pub(in crate::modal) control: &'a Control,
}

impl FitTask<'_> {
    /// # Errors
    /// [`Error::Interrupted`] where the flag is raised, after `done` of `count` images.
    pub(super) fn check(&self, done: usize, count: usize) -> Result<()> {
        if self.control.is_cancelled() { Err(interrupted(done, count)) } else { Ok(()) }
    }
}

/// State of an image's fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::modal) enum FitState {
    /// The deadline came before its turn.
    NotBegun,
    /// The frame cannot be used.
    Refused(Refusal),
    /// There is a minimum.
    Fitted,
}

/// Fit of one image: what goes in, and where it ended.
#[derive(Clone)]
pub(in crate::modal) struct ImageFit {
    pub(in crate::modal) prepared: PreparedFrame,
    /// Where the fit starts, nm.
    pub(in crate::modal) start_nm: Vec<f64>,
    pub(in crate::modal) minimum: Minimum,
    pub(in crate::modal) state: FitState,
    /// Wall-clock time of the fit, s; on a device, of the whole batch.
    pub(in crate::modal) seconds: f64,
}

impl ImageFit {
    /// Memory for the fit of an image with `modes` modes, from the flat wavefront.
    pub(in crate::modal) fn new(preparation: &Preparation, modes: usize) -> Self {
        Self {
            prepared: preparation.empty(),
            start_nm: vec![0.0; modes],
            minimum: Minimum::empty(modes),
            state: FitState::NotBegun,
            seconds: 0.0,
        }
    }

    pub(in crate::modal) fn is_fitted(&self) -> bool {
        self.state == FitState::Fitted
    }

    /// Replaces this fit by another one of the same image where that has a smaller χ², and adds up
    /// the evaluations of both. Returns whether it was replaced.
    pub(in crate::modal) fn improve(&mut self, other: Self) -> bool {
        if !other.is_fitted() {
            return false;
        }
        let evaluations = self.minimum.evaluations + other.minimum.evaluations;
        let is_better =
            other.minimum.reduced_chi2() < self.minimum.reduced_chi2() || self.minimum.reduced_chi2().is_nan();
        if is_better {
            *self = other;
        }
        self.minimum.evaluations = evaluations;
        is_better
    }
}

/// The first of `images` that cannot be used.
///
/// # Errors
/// [`Error::Image`].
pub(in crate::modal) fn check_usable(images: &[ImageFit]) -> Result<()> {
    let refused = images.iter().enumerate().find_map(|(image, fit)| match fit.state {
        FitState::Refused(refusal) => Some((image, refusal)),
        FitState::NotBegun | FitState::Fitted => None,
    });
    refused.map_or(Ok(()), |(image, refusal)| Err(Error::Image(format!("frame {image} cannot be used: {refusal}"))))
}

/// Why none of `fits` was made.
pub(in crate::modal) fn reason_of_none<'a>(fits: impl IntoIterator<Item = &'a ImageFit>) -> String {
    let refused = fits.into_iter().find_map(|fit| match fit.state {
        FitState::Refused(refusal) => Some(refusal.to_string()),
        FitState::NotBegun | FitState::Fitted => None,
    });
    refused.unwrap_or_else(|| "there is no image to estimate from".into())
}

/// Runs fits. Two implementations: CPU threads, and a device.
pub(in crate::modal) trait Engine: Send {
    /// Prepares and fits every image from its start; each is a step of the progress.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where the flag was raised, and those of the chain.
    fn fit(&mut self, task: &FitTask, prepare: &Prepare, images: &mut [ImageFit]) -> Result<()>;

    /// Prepares images for [`Engine::evaluate`]: those that can be used are left as not begun, with
    /// the weights that a fit begins with.
    ///
    /// # Errors
    /// Those of the chain.
    fn load(&mut self, task: &FitTask, prepare: &Prepare, images: &mut [ImageFit]) -> Result<()>;

    /// Replaces the weights of a loaded image.
    ///
    /// # Errors
    /// Those of the chain.
    fn replace(&mut self, image: usize, exposure: &Exposure) -> Result<()>;

    /// Objectives and gradients of `images` that are loaded, by their numbers in ascending order,
    /// at `coefficients_nm`, `[image, mode]`.
    ///
    /// # Errors
    /// Those of the chain.
    fn evaluate(
        &mut self,
        images: &[usize],
        coefficients_nm: ArrayView2<f64>,
        objectives: &mut [f64],
        gradients: &mut [f64],
    ) -> Result<()>;

    /// Sentence on a device that was lost and that the CPU replaces.
    fn failure(&self) -> Option<&str> {
        None
    }
}

pub(super) fn stop_if_cancelled(reason: StopReason, done: usize, count: usize) -> Result<()> {
    if reason == StopReason::Cancelled { Err(interrupted(done, count)) } else { Ok(()) }
}

pub(super) fn interrupted(done: usize, count: usize) -> Error {
    Error::Interrupted(format!("{done} of {count} images were fitted"))
}

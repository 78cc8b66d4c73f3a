//! Options and results of a session.

use super::super::prepare::Refusal;
use super::super::status::{ImageReport, Status, unfitted_report};
use crate::imaging::{Choice, Precision};
use crate::optimize::StopReason;
use crate::{Error, Result};
use ndarray::{ArrayView1, ArrayView2};
use std::time::Duration;

/// Options of a [`Session`](super::Session).
#[derive(Debug, Clone)]
pub struct SessionOptions {
    /// Largest number of images of a call; 1 by default.
    pub capacity: usize,
    /// Precision of the chain; `None`, the default, for the scene's (`estimate.precision`).
    pub precision: Option<Precision>,
    /// Where the chain runs; `None`, the default, for the scene's (`estimate.device`).
    pub device: Option<Choice>,
    /// Threads of the CPU chain: 1, the default, is the caller's own, 0 all that there are.
    pub threads: usize,
    /// Most evaluations for one image; `None` for the recipe's.
    pub max_evaluations: Option<usize>,
    /// A fit stops where neither a coefficient nor the RMS of the wavefront would move by more than this, nm; `None` for
    /// the recipe's.
    pub step_tolerance_nm: Option<f64>,
}

impl Default for SessionOptions {
    fn default() -> Self {
        Self { capacity: 1, precision: None, device: None, threads: 1, max_evaluations: None, step_tolerance_nm: None }
    }
}

impl SessionOptions {
    /// Checks what no device accepts.
    ///
    /// # Errors
    /// [`Error::Value`] for the first option out of range.
    pub(super) fn check(&self) -> Result<()> {
        if self.capacity == 0 {
            return Err(Error::Value("capacity is 0: 1 image or more is accepted".into()));
        }
        if self.max_evaluations == Some(0) {
            return Err(Error::Value("max_evaluations is 0: 1 or more is accepted".into()));
        }
        match self.step_tolerance_nm.filter(|nm| !(*nm >= 0.0 && nm.is_finite())) {
            Some(nm) => {
                Err(Error::Value(format!("step_tolerance_nm is {nm}: a finite number of 0 or more is accepted")))
            }
            None => Ok(()),
        }
    }
}

/// Options of one call of [`Session::fit`](super::Session::fit).
#[derive(Debug, Clone, Default)]
pub struct FitOptions<'a> {
    /// Wall-clock time for the whole call; `None` is without limit. It is honoured within one evaluation.
    pub deadline: Option<Duration>,
    /// Read noise of a pixel, RMS electrons; `None` for the scene's; where that has none, the scatter of
    /// the frame's border.
    pub read_noise_e: Option<f64>,
    /// Where each fit starts, `[image, mode]`, nm; `None` is the flat wavefront.
    pub start_nm: Option<ArrayView2<'a, f64>>,
}

/// Result of one image.
#[derive(Debug, Clone)]
pub struct ImageResult {
    /// Every mode, nm, pistons about their mean over the pupil; NaN where the image could not be used, the start where
    /// the deadline came before its turn.
    pub coefficients_nm: Vec<f64>,
    /// Status and figures of the fit. Past the deadline the status is [`Status::NotConverged`] with [`StopReason::DeadlineReached`]; an
    /// image whose turn never came has no evaluations.
    pub report: ImageReport,
    /// Wall-clock time of this image's fit; of a batch on a device, that of the batch.
    pub seconds: f64,
}

impl ImageResult {
    /// Records that the image cannot be used.
    pub(super) fn refuse(&mut self, refusal: Refusal) {
        self.coefficients_nm.fill(f64::NAN);
        self.report = unfitted_report(Status::Unusable(refusal));
    }

    /// Records that the fit did not begin before the deadline.
    pub(super) fn not_begun(&mut self, start_nm: &[f64]) {
        self.coefficients_nm.copy_from_slice(start_nm);
        self.report = unfitted_report(Status::NotConverged(StopReason::DeadlineReached));
    }
}

/// Writes the start of an image's fit; the flat wavefront where none is given.
pub(super) fn write_start(to: &mut [f64], start_nm: Option<ArrayView1<f64>>) {
    match start_nm {
        Some(start_nm) => to.iter_mut().zip(start_nm).for_each(|(to, nm)| *to = *nm),
        None => to.fill(0.0),
    }
}

//! Options and results of a session.

use super::super::prepare::Refusal;
use crate::imaging::{Choice, Precision};
use crate::modal::assess::status::{ImageReport, Status};
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::integers::PistonInteger;
use crate::modal::combine::joint::JointEstimate;
use crate::optimize::StopReason;
use crate::{Error, Result};
use ndarray::{ArrayView1, ArrayView2};
use std::time::Duration;

/// Options of a [`Session`](super::Session).
#[derive(Debug, Clone)]
pub struct SessionOptions {
    /// Largest number of groups of a call, which are images with one channel; 1 by default.
    pub capacity: usize,
    /// Precision of the chain; `None`, the default, for the scene's (`estimate.precision`).
    pub precision: Option<Precision>,
    /// Where the chain runs; `None`, the default, for the scene's (`estimate.device`).
    pub device: Option<Choice>,
    /// Threads of the CPU chain: 1, the default, is the caller's own, 0 all that there are.
    pub threads: usize,
    /// Most evaluations for one image, or one group of several channels before and after some join;
    /// `None` for the recipe's.
    pub max_evaluations: Option<usize>,
    /// A fit stops where neither a coefficient nor the RMS of the wavefront would move by more than
    /// this, nm; `None` for the recipe's.
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
    /// Wall-clock time for the whole call; `None` is without limit. It is honoured within one
    /// evaluation.
    pub deadline: Option<Duration>,
    /// Read noise of a pixel, RMS electrons; `None` for the scene's; where that has none, the
    /// scatter of the frame's border.
    pub read_noise_e: Option<f64>,
    /// Start of the fits of each group, `[group, mode]`, nm; `None` is the flat wavefront.
    pub start_nm: Option<ArrayView2<'a, f64>>,
}

impl FitOptions<'_> {
    /// Checks the options of a fit of `count` groups.
    ///
    /// # Errors
    /// [`Error::Shape`] for a start of another shape, [`Error::Value`] for the first number out of
    /// range.
    pub(super) fn check(&self, count: usize, modes: usize) -> Result<()> {
        check_read_noise(self.read_noise_e)?;
        let Some(start_nm) = self.start_nm else { return Ok(()) };
        let (rows, columns) = start_nm.dim();
        if (rows, columns) != (count, modes) {
            return Err(Error::Shape(format!(
                "a start of {rows}x{columns} was given, where {count}x{modes} is needed"
            )));
        }
        match start_nm.indexed_iter().find(|(_, nm)| !nm.is_finite()) {
            Some(((image, mode), nm)) => Err(Error::Value(format!(
                "coefficient {mode} of the start of image {image} is {nm}, where a finite number is needed"
            ))),
            None => Ok(()),
        }
    }
}

/// Checks a caller's read noise.
///
/// # Errors
/// [`Error::Value`] for one out of range.
pub(super) fn check_read_noise(given: Option<f64>) -> Result<()> {
    match given.filter(|read_noise_e| !(*read_noise_e >= 0.0 && read_noise_e.is_finite())) {
        Some(read_noise_e) => Err(Error::Value(format!(
            "a read noise of {read_noise_e} electrons was given, where a finite number of 0 or more is needed"
        ))),
        None => Ok(()),
    }
}

/// Result of a group: one frame of each channel.
#[derive(Debug, Clone)]
pub struct GroupResult {
    /// Every mode, nm, pistons about their mean over the pupil: in one channel those of its
    /// [`ImageResult`]; in several the modes that they have in common, NaN unless all could be used
    /// and the fit converged.
    pub coefficients_nm: Vec<f64>,
    /// Error bar of each mode of several channels, 1σ, nm: from the information at the flat
    /// wavefront, scaled by the roots of the largest χ² where a channel's model misfits, and of
    /// the χ² of their differences where the channels contradict each other. Bad pixels are not
    /// left out. NaN in one channel: [`Session::refine`](super::Session::refine) has its
    /// covariance.
    pub sigma_nm: Vec<f64>,
    /// The worst status of the channels.
    pub status: Status,
    /// Reduced χ² of the differences of the channels from the wavefront of all, where noise gives
    /// 1, and its degrees of freedom; (NaN, 0) in one channel, and without coefficients.
    pub disagreement: (f64, f64),
    /// Whether the channels differ by more than their noise: one is flipped, of another wavelength
    /// or diversity than the scene says, or in another minimum.
    pub is_contradictory: bool,
    /// Wall-clock time of the fits of its images, s; on a device that of the batch.
    pub seconds: f64,
}

impl GroupResult {
    /// That of a group of `modes` which was not fitted.
    pub(super) fn new(modes: usize) -> Self {
        Self {
            coefficients_nm: vec![f64::NAN; modes],
            sigma_nm: vec![f64::NAN; modes],
            status: Status::NotConverged(StopReason::Unfinished),
            disagreement: (f64::NAN, 0.0),
            is_contradictory: false,
            seconds: 0.0,
        }
    }

    /// Takes the result of the only image of the group.
    pub(super) fn take(&mut self, image: &ImageResult) {
        self.coefficients_nm.copy_from_slice(&image.coefficients_nm);
        (self.status, self.seconds) = (image.report.status, image.seconds);
    }
}

/// Result of a group with its covariance; see [`Session::refine`](super::Session::refine).
#[derive(Debug, Clone)]
pub struct RefinedGroup {
    /// The modes, with their covariance.
    pub modes: CombinedModes,
    /// As in [`GroupResult::disagreement`].
    pub disagreement: (f64, f64),
    /// As in [`GroupResult::is_contradictory`].
    pub is_contradictory: bool,
    /// Whole wavelengths of each segment's piston; none where the channels have one wavelength.
    pub integers: Vec<PistonInteger>,
}

impl From<JointEstimate> for RefinedGroup {
    fn from(joint: JointEstimate) -> Self {
        Self {
            disagreement: joint.disagreement,
            is_contradictory: joint.is_contradictory(),
            modes: joint.modes,
            integers: joint.integers,
        }
    }
}

impl RefinedGroup {
    /// That of one channel.
    pub(super) fn of_one(modes: CombinedModes) -> Self {
        Self { modes, disagreement: (f64::NAN, 0.0), is_contradictory: false, integers: Vec::new() }
    }
}

/// Result of the fit of one image.
#[derive(Debug, Clone)]
pub struct ImageResult {
    /// Every mode, nm, pistons about their mean over the pupil; NaN where the image could not be
    /// used, the start where the deadline came before its turn.
    pub coefficients_nm: Vec<f64>,
    /// Status and figures of the fit. Past the deadline the status is [`Status::NotConverged`] with
    /// [`StopReason::DeadlineReached`]; an image that was not begun has no evaluations.
    pub report: ImageReport,
    /// Wall-clock time of this image's fit; of a batch on a device, that of the batch; of several
    /// channels, its share of that of its group and those beside it.
    pub seconds: f64,
}

impl ImageResult {
    /// Records that the image cannot be used.
    pub(super) fn refuse(&mut self, refusal: Refusal) {
        self.coefficients_nm.fill(f64::NAN);
        self.report = ImageReport::unfitted(Status::Unusable(refusal));
    }

    /// Records that the fit did not begin before the deadline.
    pub(super) fn not_begun(&mut self, start_nm: &[f64]) {
        self.coefficients_nm.copy_from_slice(start_nm);
        self.report = ImageReport::unfitted(Status::NotConverged(StopReason::DeadlineReached));
    }
}

/// Writes the start of an image's fit; the flat wavefront where none is given.
pub(super) fn write_start(to: &mut [f64], start_nm: Option<ArrayView1<f64>>) {
    match start_nm {
        Some(start_nm) => to.iter_mut().zip(start_nm).for_each(|(to, nm)| *to = *nm),
        None => to.fill(0.0),
    }
}

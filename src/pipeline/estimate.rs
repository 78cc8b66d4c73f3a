//! Estimate: the static wavefront behind images, with error bars, by either method.

use super::modal_errors::ModalErrors;
use super::outcome::ImageOutcome;
use super::policy::Policy;
use super::telemetry::TelemetryCheck;
use crate::imaging::Precision;
use crate::loop_response::{Corrections, SegmentLimits};
use crate::modal::{CombinedModes, FittedImage, ModalFitter, ModelError, PistonInteger, StaticMaps, Status};
use crate::modes::{Degeneracy, Group};
use crate::pupil::Pupil;
use crate::scene::{AoKnowledge, Combine, Method, OpticalParameter, Scene};
use crate::statics::{ErrorTerm, Iteration};
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2};
use std::sync::Arc;

/// Static wavefront behind one image or many: modes, maps, error bars, and the outcome of each
/// image.
///
/// Maps are `[y, x]` on the grid of [`Estimate::pupil`], nm of wavefront, NaN outside the pupil.
/// Modes are those of [`Estimate::basis`]: segments first, then NCPA.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// The scene that was used: with the choices of a plan and the optical parameters that were
    /// fitted; one with channels as it was given.
    pub scene: Scene,
    /// The policy that was followed.
    pub policy: Policy,
    /// Names and groups of the modes.
    pub basis: Basis,
    /// Coefficients of the modes, with their covariance.
    pub modes: CombinedModes,
    /// The pupil on which the maps are.
    pub pupil: Pupil,
    /// Segment errors and NCPA: the modes, and with `estimate.posterior` what these leave out of
    /// the wavefront.
    pub maps: StaticMaps,
    /// Error bars of the maps.
    pub sigma_maps: StaticMaps,
    /// RMS of the maps over the pupil.
    pub figures: Figures,
    /// Contributions to the error bars of phasing and NCPA.
    pub error_budget: Vec<ErrorTerm>,
    /// Errors of the optics and the camera that the error bars hold; none without
    /// `estimate.posterior`.
    pub model_errors: Vec<ModelError>,
    /// What is known apart from focus and astigmatisms of the whole pupil; `None` where the images
    /// divide these among segments and NCPA, and without `estimate.posterior`.
    pub without_staircases: Option<WithoutStaircases>,
    /// Outcome of each image, in order.
    pub images: Vec<ImageOutcome>,
    /// Names of the channels whose images it is from, in order; none for a scene with one way of
    /// imaging.
    pub channels: Vec<String>,
    /// Worst status of the images that the estimate depends on.
    pub status: Status,
    /// Median reduced χ² of the images that were used.
    pub reduced_chi2: f64,
    /// Whether error bars are from the scatter between images, as from eight images on.
    pub is_sequence: bool,
    /// Description of the modes that were added to the scene's.
    pub model: String,
    /// Optical parameters that were fitted, or found to differ from the scene's.
    pub optics: Vec<OpticalParameter>,
    /// Whole wavelengths of each segment's piston, in the order of the segments; none where the
    /// channels have one wavelength.
    pub integers: Vec<PistonInteger>,
    /// Warnings: sentences that a user should read before using the numbers.
    pub warnings: Vec<String>,
    /// Remarks that hold for every image of this scene.
    pub remarks: Vec<String>,
    /// Where it ran, and how long.
    pub run: Run,
    /// Maps that simulated images were made with, and the residual against them.
    pub truth: Option<(StaticMaps, Comparison)>,
    /// Results that estimates by its method alone have.
    pub method: MethodResult,
}

/// Results that estimates by one method alone have.
#[derive(Debug, Clone)]
pub enum MethodResult {
    /// Static modes fitted to each image, images combined.
    Modal(ModalSummary),
    /// Maximum a posteriori (MAP) wavefront behind each exposure, static errors separated from the
    /// turbulence.
    FullPhase(FullPhaseSummary),
}

/// Fits of a modal estimate.
#[derive(Debug, Clone)]
pub struct ModalSummary {
    /// How the images were combined.
    pub combine: Combine,
    /// Coefficients of each image, `[image, mode]`, nm, NaN for unusable ones.
    pub image_coefficients_nm: Array2<f64>,
    /// First image of each channel that was used, with its model, in the order of
    /// [`Estimate::channels`].
    pub compared: Vec<FittedImage>,
    /// Combinations of modes that change the images little or not at all.
    pub degeneracy: Degeneracy,
    /// Modal fitter with the model that the images were compared with; of several channels that of
    /// the first.
    pub fitter: Arc<ModalFitter>,
}

/// Names and groups of modes, in order: segments first, then NCPA.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    /// Name of each mode.
    pub names: Vec<String>,
    /// Group of each mode.
    pub groups: Vec<Group>,
}

/// RMS over the pupil, piston, tip and tilt removed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// RMS of the map, nm.
    pub rms_nm: f64,
    /// Expected RMS of its error, nm.
    pub sigma_nm: f64,
}

/// RMS of the maps of an estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figures {
    /// Of the segment errors.
    pub phasing: Figure,
    /// Of the NCPA.
    pub ncpa: Figure,
    /// Of the sum of both. The error bar of a MAP estimate is an upper limit, the sum of both error
    /// bars: how their errors go together is not known.
    pub wavefront: Figure,
}

/// An estimate without focus and astigmatisms of the whole pupil.
#[derive(Debug, Clone)]
pub struct WithoutStaircases {
    /// RMS of the maps over the pupil.
    pub figures: Figures,
    /// Segment errors without the staircases that segments make of the three shapes, and NCPA
    /// without these.
    pub maps: StaticMaps,
    /// Error bars of the maps.
    pub sigma_maps: StaticMaps,
}

/// Where an estimate ran, and how long.
#[derive(Debug, Clone, PartialEq)]
pub struct Run {
    /// The device.
    pub device: String,
    /// Precision of the imaging chain.
    pub precision: Precision,
    /// Wall-clock time of the estimate, s, without building the model where that is apart.
    pub seconds: f64,
    /// Wall-clock time of building the model, s.
    pub model_seconds: f64,
}

/// Estimate minus truth, piston, tip and tilt removed.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Residual maps of phasing and NCPA.
    pub maps: StaticMaps,
    /// RMS of the residual of phasing, NCPA and their sum, nm.
    pub rms_nm: [f64; 3],
}

/// Iterations of a MAP estimate, and what was assumed of the adaptive optics.
#[derive(Debug, Clone)]
pub struct FullPhaseSummary {
    /// What was assumed of the adaptive optics.
    pub ao_knowledge: AoKnowledge,
    /// Measured slopes against those of the retrieved wavefronts; `None` without telemetry.
    pub telemetry: Option<TelemetryCheck>,
    /// All iterations; the last one is the estimate.
    pub iterations: Vec<Iteration>,
    /// Whether they ended because the last one changed less than the tolerance.
    pub has_settled: bool,
    /// Wall-clock time in retrievals, s.
    pub retrieval_seconds: f64,
    /// Reflectivity of each segment over the mean; empty where all are taken to be equal.
    pub segment_reflectivities: Vec<f64>,
}

impl Figures {
    /// RMS of `maps` over the pupil, with the expected RMS of the errors of phasing, NCPA and their
    /// sum.
    pub(super) fn new(pupil: &Pupil, maps: &StaticMaps, sigma_nm: [f64; 3]) -> Result<Self> {
        let figure = |map: &Array2<f64>, sigma_nm| Ok(Figure { rms_nm: detrended(pupil, map.view())?.1, sigma_nm });
        let [phasing, ncpa, wavefront] = sigma_nm;
        Ok(Self {
            phasing: figure(&maps.phasing_nm, phasing)?,
            ncpa: figure(&maps.ncpa_nm, ncpa)?,
            wavefront: figure(&maps.wavefront_nm(), wavefront)?,
        })
    }
}

/// `map` without piston, tip and tilt, and its RMS over the pupil.
fn detrended(pupil: &Pupil, map: ArrayView2<f64>) -> Result<(Array2<f64>, f64)> {
    let map = pupil.remove_piston_tip_tilt(map)?;
    let rms = pupil.rms(map.view())?;
    Ok((map, rms))
}

impl Comparison {
    /// Compares maps on the grid of `pupil` with the truth.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Value`] where a map is not one of this pupil.
    pub fn new(pupil: &Pupil, maps: &StaticMaps, truth: &StaticMaps) -> Result<Self> {
        check_on_pupil(pupil, "the estimate's", maps)?;
        check_on_pupil(pupil, "the true", truth)?;
        let (phasing_nm, phasing) = detrended(pupil, (&maps.phasing_nm - &truth.phasing_nm).view())?;
        let (ncpa_nm, ncpa) = detrended(pupil, (&maps.ncpa_nm - &truth.ncpa_nm).view())?;
        let maps = StaticMaps { phasing_nm, ncpa_nm };
        let wavefront = pupil.rms(maps.wavefront_nm().view())?;
        Ok(Self { maps, rms_nm: [phasing, ncpa, wavefront] })
    }
}

/// Refuses maps of another grid or of another pupil than `pupil`; `whose` is the beginning of their
/// names.
pub(super) fn check_on_pupil(pupil: &Pupil, whose: &str, maps: &StaticMaps) -> Result<()> {
    check_map_on_pupil(pupil, &format!("{whose} phasing"), &maps.phasing_nm)?;
    check_map_on_pupil(pupil, &format!("{whose} NCPA"), &maps.ncpa_nm)
}

fn check_map_on_pupil(pupil: &Pupil, name: &str, map: &Array2<f64>) -> Result<()> {
    let (rows, columns) = map.dim();
    let samples = pupil.grid.samples();
    if (rows, columns) != (samples, samples) {
        return Err(Error::Shape(format!(
            "{name} has {columns}x{rows} samples where the estimate's pupil has {samples}x{samples}: they cannot be compared"
        )));
    }
    let illuminated = || pupil.amplitude.iter().zip(map).filter(|(amplitude, _)| **amplitude > 0.0);
    let (all, missing) = (illuminated().count(), illuminated().filter(|(_, nm)| !nm.is_finite()).count());
    if missing > 0 {
        return Err(Error::Value(format!(
            "{name} has no value at {missing} of the {all} samples of the estimate's pupil: maps of the same pupil on the same \
             grid can be compared"
        )));
    }
    Ok(())
}

impl MethodResult {
    /// The word of the method in scenes, files and JSON.
    pub fn word(&self) -> &'static str {
        match self {
            Self::Modal(_) => Method::Modal.word(),
            Self::FullPhase(_) => Method::FullPhase.word(),
        }
    }
}

impl FullPhaseSummary {
    /// The last iteration, which is the estimate.
    pub(crate) fn last(&self) -> Result<&Iteration> {
        self.iterations.last().ok_or_else(|| Error::Internal("no iteration was made".into()))
    }
}

impl Estimate {
    /// The fits of a modal estimate; `None` for a MAP estimate.
    pub fn modal(&self) -> Option<&ModalSummary> {
        match &self.method {
            MethodResult::Modal(modal) => Some(modal),
            MethodResult::FullPhase(_) => None,
        }
    }

    /// The iterations of a MAP estimate; `None` for a modal estimate.
    pub fn full_phase(&self) -> Option<&FullPhaseSummary> {
        match &self.method {
            MethodResult::Modal(_) => None,
            MethodResult::FullPhase(map) => Some(map),
        }
    }

    /// Whether there is no warning, and the status is ok.
    pub fn is_sound(&self) -> bool {
        self.warnings.is_empty() && self.status == Status::Ok
    }

    /// Number of modes that move segments; they come first.
    pub fn segment_modes(&self) -> usize {
        self.basis.groups.iter().filter(|group| **group == Group::Segment).count()
    }

    /// Number of images that were combined.
    pub fn used(&self) -> usize {
        self.images.iter().filter(|image| image.is_used).count()
    }

    /// Number of images that were fitted and left out as outliers.
    pub fn clipped(&self) -> usize {
        self.images.iter().filter(|image| image.is_clipped).count()
    }

    /// Evaluations of objective and gradient, all images together.
    pub fn evaluations(&self) -> usize {
        self.images.iter().map(|image| image.report.evaluations).sum()
    }

    /// Residual against the aberrations that simulated images were made with.
    ///
    /// # Errors
    /// [`Error::Shape`] for a truth on another grid.
    pub fn compare(&self, truth: &StaticMaps) -> Result<Comparison> {
        Comparison::new(&self.pupil, &self.maps, truth)
    }

    /// Corrections of segments, mirror and reference slopes by the policy of the scene's section
    /// `[commands]`, also in the terms of the controllers that it describes. No increment is larger
    /// than `limit_nm`; `None` takes the mirror's stroke and, for segments, a quarter of the
    /// wavelength (half of the distance to the next fringe), and no limit where the whole
    /// wavelengths are known, or `commands.max_step_nm`. Of a modal estimate tips and tilts of
    /// segments are not corrected, and it has no reference slopes.
    ///
    /// # Errors
    /// [`Error::Value`] for a limit that is not positive, for a piston that would move by more than
    /// `commands.max_step_nm` (unset and with one wavelength: half of it), for segment modes from a
    /// file, which are not pistons, and for steps at edges where segments are tilted;
    /// [`Error::File`] for a controller's table or matrix that cannot be read or does not fit.
    pub fn corrections(&self, limit_nm: Option<f64>) -> Result<Corrections> {
        let limits = SegmentLimits::of_scene(&self.scene, !self.integers.is_empty());
        let mut corrections = match &self.method {
            MethodResult::FullPhase(map) => map.last()?.corrections(&self.scene, limit_nm, limits)?,
            MethodResult::Modal(modal) => {
                let modes = ModalErrors {
                    scene: &self.scene,
                    model: modal.fitter.model(),
                    coefficients_nm: &self.modes.coefficients_nm,
                    covariance_nm2: self.modes.covariance_nm2.view(),
                    limits,
                };
                modes.corrections(limit_nm)?
            }
        };
        let status = (self.status != Status::Ok).then(|| format!("the status is {}", self.status.word()));
        let said = status.into_iter().chain(self.warnings.iter().cloned()).chain(self.remarks.iter().cloned());
        corrections.estimate_warnings = said.collect();
        // In the unit of the slopes that were measured.
        if let Some(check) = self.full_phase().and_then(|map| map.telemetry.as_ref()) {
            corrections.slopes_mas.iter_mut().for_each(|mas| *mas *= check.divided_by);
        }
        Ok(corrections)
    }
}

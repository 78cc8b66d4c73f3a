//! Estimator of the static errors of one iteration: the linear model, iterated over the nonlinear
//! responses of the closed loop and of the wavefront sensor.

use super::common_figure::common_figures;
use super::covariance::ResidualCovariance;
use super::image_selection::SelectedImages;
use super::least_squares::StaticModel;
use super::loop_compensation::uncompensated_rms_nm;
use super::mean_covariance::MeanCovariance;
use super::ncpa_basis::NcpaFamily;
use super::segment_tilts::SegmentTilts;
use super::settings::StaticsSettings;
use super::static_errors::StaticErrors;
use super::static_modes::StaticModes;
use super::wavefront_source::WavefrontSource;
use crate::control::Control;
use crate::linear_algebra::combination;
use crate::loop_response::{ClosedLoopResponse, SensorModel, SlopeInformation};
use crate::modes::{SegmentModes, TiltFrame, tilt_frames};
use crate::retrieval::{IlluminatedSamples, StaticWavefront};
use crate::scene::{AoKnowledge, System};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, concatenate, s};
use rayon::prelude::*;

/// Amplitude below which a sample is left out: images hold little information on its phase.
const MIN_AMPLITUDE: f64 = 0.5;

/// Most simulations of the closed loop in an estimate: its nonlinear part is a tenth of the linear
/// one, and each reduces the remaining error by that factor.
const MAX_LOOP_SIMULATIONS: usize = 8;
/// Change of the segment modes below which the loop response is converged, nm.
const LOOP_TOLERANCE_NM: f64 = 0.05;

/// Distance ([`MeanCovariance::distance`]) of the covariance of the mean wavefront from that of an
/// earlier iteration below which the earlier one's weights serve: they add 0.3 % to the variance of
/// the estimate at most, and change error bars by 2.5 % at most.
const SAME_COVARIANCE: f64 = 0.05;

/// Most comparisons of wavefronts with slopes in an estimate: a quad cell is nonlinear, and each
/// removes nine tenths of the remaining error.
const MAX_SLOPE_COMPARISONS: usize = 6;
/// Change of the NCPA below which the comparisons are converged, nm RMS.
const SLOPE_TOLERANCE_NM: f64 = 0.2;

/// Estimator of static errors: what all iterations over a sequence share.
pub(super) struct StaticsEstimator<'a> {
    scene: &'a System,
    pub(super) telescope: Telescope,
    all_samples: IlluminatedSamples,
    /// Indices of the samples that are used.
    pub(super) kept: Vec<usize>,
    pub(super) samples: IlluminatedSamples,
    /// Where the tip and the tilt of each segment are 0; none where a segment is too small for
    /// tilts.
    frames: Option<Vec<TiltFrame>>,
    /// Modes of the segments that are estimated.
    segment_modes: SegmentModes,
    /// Their wavefronts without the loop's response, at the samples that are used,
    /// `[mode, sample]`.
    segments_at_kept: Array2<f64>,
    loop_response: Option<SampledLoopResponse>,
    sample_error_nm: f64,
    /// [`WavefrontSource::moved_reference_mas`].
    moved_reference_mas: Option<Array1<f64>>,
    control: &'a Control,
    /// What the next iteration in the same modes begins with.
    last: Option<LastEstimate>,
}

/// Parts of an estimate that serve the next one in the same modes.
struct LastEstimate {
    family: NcpaFamily,
    model: StaticModel,
    sensor: Option<SensorModel>,
    errors: StaticErrors,
}

impl<'a> StaticsEstimator<'a> {
    pub(super) fn new(
        scene: &'a System,
        source: &dyn WavefrontSource,
        settings: &StaticsSettings,
        control: &'a Control,
    ) -> Result<Self> {
        let all_samples = source.samples();
        let kept = all_samples.select_bright(MIN_AMPLITUDE);
        let is_known = settings.ao_knowledge >= AoKnowledge::Loop;
        let even_nm = vec![0.0; all_samples.pistons.nrows()];
        let about_nm = source.start_pistons_nm().unwrap_or(&even_nm);
        let loop_response =
            is_known.then(|| SampledLoopResponse::new(scene, all_samples, &kept, about_nm)).transpose()?;
        let (telescope, samples) = (Telescope::new(scene)?, all_samples.subset(&kept));
        Ok(Self {
            frames: tilt_frames(&telescope.pupil).ok(),
            segment_modes: SegmentModes::Piston,
            segments_at_kept: samples.pistons.clone(),
            all_samples: all_samples.clone(),
            scene,
            telescope,
            kept,
            samples,
            loop_response,
            sample_error_nm: settings.sample_error_nm,
            moved_reference_mas: source.moved_reference_mas().cloned(),
            control,
            last: None,
        })
    }

    /// Whether tips and tilts of the segments are estimated.
    pub(super) fn has_tilts(&self) -> bool {
        self.segment_modes == SegmentModes::PistonTipTilt
    }

    /// Adds tips and tilts of the segments to the modes that are estimated, with the loop's
    /// response to them.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a segment that is too small for tilts; those of the loop.
    pub(super) fn add_tilts(&mut self) -> Result<()> {
        let tilts = self.samples.tilts(&tilt_frames(&self.telescope.pupil)?);
        self.segments_at_kept = joined(self.samples.pistons.view(), tilts.view())?;
        self.segment_modes = SegmentModes::PistonTipTilt;
        self.last = None;
        self.loop_response.as_mut().map_or(Ok(()), |response| response.extend_to(self.segments_at_kept.nrows()))
    }

    /// Seeks tilts of single segments in the residual of the mean of `images` wavefronts, nm at
    /// each sample; `None` where a segment is too small for tilts.
    pub(super) fn tilts_in_residual(
        &self,
        residual_nm: ArrayView1<f64>,
        residual: &ResidualCovariance,
        images: usize,
    ) -> Result<Option<SegmentTilts>> {
        let Some(frames) = &self.frames else { return Ok(None) };
        let (tilts, covariance) = (self.samples.tilts(frames), self.mean_covariance(residual, images));
        SegmentTilts::estimate(residual_nm, tilts.view(), &covariance, &self.samples).map(Some)
    }

    /// Wavefronts of the segment modes with the loop's response to them, at the samples that are
    /// used, `[mode, sample]`.
    fn segment_columns(&self) -> Array2<f64> {
        match &self.loop_response {
            Some(response) => response.added_to(self.segments_at_kept.clone()),
            None => self.segments_at_kept.clone(),
        }
    }

    /// Expected error of the segments that the loop leaves in the wavefront, nm RMS; `None` where
    /// segments have no tilts, or the loop is not known.
    pub(super) fn uncompensated_nm(&self, errors: &StaticErrors) -> Option<f64> {
        let modes = errors.segment_modes();
        let covariance_nm2 = errors.covariance_nm2.slice(s![..modes, ..modes]);
        let is_known = self.has_tilts() && self.loop_response.is_some();
        is_known.then(|| uncompensated_rms_nm(self.segment_columns().view(), covariance_nm2, &self.samples))
    }

    /// The static modes with NCPA of `family`.
    pub(super) fn static_modes(&self, family: NcpaFamily) -> Result<StaticModes> {
        let samples = (&self.all_samples, &self.kept[..]);
        StaticModes::new(
            (self.segment_modes, family),
            self.scene,
            &self.telescope,
            samples,
            self.loop_response.is_some(),
        )
    }

    /// Covariance of the mean of `images` wavefronts of the covariance `residual`.
    pub(super) fn mean_covariance(&self, residual: &ResidualCovariance, images: usize) -> MeanCovariance {
        MeanCovariance::new(residual, images, self.sample_error_nm, &self.samples).stopped_by(self.control)
    }

    /// Estimates the static errors of the selected images' wavefronts, of covariance `residual`,
    /// and of the slopes measured during each exposure (`[image, slope]`, mas, NaN where there is
    /// no telemetry; of two images at least).
    pub(super) fn estimate(
        &mut self,
        modes: &StaticModes,
        images: &SelectedImages,
        residual: &ResidualCovariance,
        slopes_mas: Option<Array2<f64>>,
    ) -> Result<StaticErrors> {
        let covariance = self.mean_covariance(residual, images.used.len());
        let has_slopes = slopes_mas.is_some();
        let last = self.last.take();
        let last = last.filter(|last| last.family == modes.family && last.model.has_telemetry() == has_slopes);
        let (model, sensor, last) = match last {
            Some(LastEstimate { model, sensor, errors, .. }) => (Some(model), sensor, Some(errors)),
            None => (None, None, None),
        };
        let model = model.filter(|model| model.covariance().distance(&covariance) < SAME_COVARIANCE);
        let mut model = model.map_or_else(|| self.static_model(modes, has_slopes, &covariance), Ok)?;
        let Some(slopes_mas) = slopes_mas else {
            let errors = self.estimate_with_loop(&mut model, modes, &images.mean_nm, (None, last.as_ref()))?;
            self.last = Some(LastEstimate { family: modes.family, model, sensor: None, errors: errors.clone() });
            return Ok(errors);
        };
        let mut sensor = match sensor {
            Some(sensor) => sensor,
            None => SensorModel::new(self.scene, &self.telescope, &self.samples, &modes.basis)?
                .with_moved_reference(self.moved_reference_mas.clone())?,
        };
        let errors = self.estimate_with_slopes((&mut model, &mut sensor), modes, images, slopes_mas, last)?;
        let sensor = Some(sensor);
        self.last = Some(LastEstimate { family: modes.family, model, sensor, errors: errors.clone() });
        Ok(errors)
    }

    /// [`SensorModel::reference_mas_per_nm`] of the last estimate.
    pub(super) fn reference_mas_per_nm(&self) -> Option<Array2<f64>> {
        self.last.as_ref()?.sensor.as_ref()?.reference_mas_per_nm().cloned()
    }

    /// The linear model of a mean wavefront of `covariance`.
    fn static_model(&self, modes: &StaticModes, has_slopes: bool, covariance: &MeanCovariance) -> Result<StaticModel> {
        let columns = self.segment_columns();
        let figures = match self.has_tilts() {
            true => common_figures(self.segments_at_kept.view(), columns.view(), &self.samples)?,
            false => Array2::zeros((0, self.samples.len())),
        };
        let columns = modes.columns_without_motions(columns);
        let segments = (columns.view(), self.samples.pistons.nrows());
        StaticModel::new(segments, (modes.at_kept.view(), figures.view()), (&modes.groups[..], has_slopes), covariance)
    }

    /// Compares the wavefronts with the slopes until the NCPA change no more, from `last`, the
    /// errors of the iteration before.
    fn estimate_with_slopes(
        &mut self,
        (model, sensor): (&mut StaticModel, &mut SensorModel),
        modes: &StaticModes,
        images: &SelectedImages,
        slopes_mas: Array2<f64>,
        last: Option<StaticErrors>,
    ) -> Result<StaticErrors> {
        let measured = images_with_slopes(slopes_mas.view());
        let (slopes_mas, residuals_nm) =
            (slopes_mas.select(Axis(0), &measured), images.residuals_nm.select(Axis(0), &measured));
        let wavefronts_nm = residuals_nm + &images.mean_nm;
        // Hyperparameters without slopes are no start for those with slopes.
        let mut has_initial = last.is_some();
        let without_slopes = |estimator: &mut Self, model: &mut StaticModel| {
            estimator.estimate_with_loop(model, modes, &images.mean_nm, (None, None))
        };
        let mut errors = last.map_or_else(|| without_slopes(self, model), Ok)?;
        for _ in 0..MAX_SLOPE_COMPARISONS {
            let (segments_nm, before) = (errors.segments_nm(), &errors.ncpa_nm);
            let segments = self.segments_at_kept.view();
            let slopes =
                sensor.ncpa_information(segments, wavefronts_nm.view(), slopes_mas.view(), &segments_nm, before)?;
            let initial = has_initial.then_some(&errors);
            let next = self.estimate_with_loop(model, modes, &images.mean_nm, (Some(&slopes), initial))?;
            has_initial = true;
            let change_nm2: f64 = next.ncpa_nm.iter().zip(before).map(|(now, then)| (now - then).powi(2)).sum();
            errors = next;
            if change_nm2.sqrt() < SLOPE_TOLERANCE_NM {
                break;
            }
        }
        Ok(errors)
    }

    /// Estimates the static errors of a mean wavefront, with the loop's response to them simulated
    /// until it is converged, with these slopes and from these errors.
    fn estimate_with_loop(
        &mut self,
        model: &mut StaticModel,
        modes: &StaticModes,
        mean_nm: &Array1<f64>,
        (slopes, initial): (Option<&SlopeInformation>, Option<&StaticErrors>),
    ) -> Result<StaticErrors> {
        let mut estimate = |mean_nm: ArrayView1<f64>, initial: Option<&StaticErrors>| {
            model.estimate(mean_nm, slopes, initial).map(|errors| modes.without_motions(errors))
        };
        let Some(response) = &mut self.loop_response else { return estimate(mean_nm.view(), initial) };
        let mut errors = match initial {
            Some(errors) => errors.clone(),
            None => estimate((mean_nm - &response.offset_nm).view(), None)?,
        };
        for _ in 0..MAX_LOOP_SIMULATIONS {
            let before_nm = errors.segments_nm();
            let nonlinear_nm = response.nonlinear_nm(&before_nm)?;
            errors = estimate((mean_nm - &nonlinear_nm).view(), Some(&errors))?;
            let change = errors.segments_nm().into_iter().zip(&before_nm).map(|(now, then)| (now - then).abs());
            if change.fold(0.0, f64::max) < LOOP_TOLERANCE_NM {
                break;
            }
        }
        Ok(errors)
    }

    /// The static wavefront of `coefficients_nm` (segment modes and NCPA) and of the common-path
    /// part of `errors`.
    pub(super) fn static_wavefront(
        &mut self,
        modes: &StaticModes,
        coefficients_nm: &Array1<f64>,
        errors: &StaticErrors,
    ) -> Result<StaticWavefront> {
        let (segments_nm, ncpa) = coefficients_nm.view().split_at(Axis(0), errors.segment_modes());
        let (pistons_nm, tilts_nm) = segments_nm.split_at(Axis(0), errors.pistons_nm.len());
        let common_path_nm = ArrayView1::from(&errors.common_path_nm);
        let mut smooth_nm = combination((&ncpa + &common_path_nm).view(), modes.at_all.view());
        if let Some(frames) = self.frames.as_ref().filter(|_| !tilts_nm.is_empty()) {
            // The retrieval's model has pistons, so that it may fit reflectivities and costs no
            // more: tilts are a wavefront at its samples, the one that the linear model has.
            smooth_nm += &combination(tilts_nm, self.all_samples.tilts(frames).view());
        }
        if let Some(response) = &mut self.loop_response {
            smooth_nm += &response.closed_loop.response_nm(&segments_nm.to_vec())?;
        }
        Ok(StaticWavefront { segments_nm: pistons_nm.to_vec(), smooth_nm: smooth_nm.to_vec() })
    }
}

/// The images whose slopes were measured.
pub(super) fn images_with_slopes(slopes_mas: ArrayView2<f64>) -> Vec<usize> {
    let is_measured = |(image, row): (usize, ArrayView1<f64>)| row.iter().all(|mas| mas.is_finite()).then_some(image);
    slopes_mas.outer_iter().enumerate().filter_map(is_measured).collect()
}

/// Wavefronts of two sets of modes, `[mode, sample]`, one set after the other.
fn joined(first: ArrayView2<f64>, second: ArrayView2<f64>) -> Result<Array2<f64>> {
    concatenate(Axis(0), &[first, second]).map_err(|error| Error::Internal(format!("modes of uneven length: {error}")))
}

/// Closed-loop response at the samples that are used: linear · segments + offset, and the rest by
/// simulation.
struct SampledLoopResponse {
    closed_loop: ClosedLoopResponse,
    kept: Vec<usize>,
    /// Segments about which it is linear, nm.
    about_nm: Vec<f64>,
    /// Commands for 1 nm of each segment mode that is estimated, `[mode, actuator]`.
    linear_commands: Array2<f64>,
    /// What is not linear in those segments; 0 about even segments.
    offset_nm: Array1<f64>,
}

impl SampledLoopResponse {
    /// The response to the pistons, about pistons of `about_nm`.
    fn new(scene: &System, samples: &IlluminatedSamples, kept: &[usize], about_nm: &[f64]) -> Result<Self> {
        let mut closed_loop = ClosedLoopResponse::new(scene, samples)?;
        let linear_commands = closed_loop.linear_commands(about_nm, 0..about_nm.len())?;
        let (kept, about_nm, offset_nm) = (kept.to_vec(), about_nm.to_vec(), Array1::zeros(kept.len()));
        let mut response = Self { closed_loop, kept, about_nm, linear_commands, offset_nm };
        if response.about_nm.iter().any(|nm| *nm != 0.0) {
            response.offset_nm = response.nonlinear_nm(&response.about_nm.clone())?;
        }
        Ok(response)
    }

    /// Measures the responses to the segment modes that are missing of the first `modes`.
    fn extend_to(&mut self, modes: usize) -> Result<()> {
        let known = self.about_nm.len();
        self.about_nm.resize(modes, 0.0);
        let more = self.closed_loop.linear_commands(&self.about_nm, known..modes)?;
        self.linear_commands = joined(self.linear_commands.view(), more.view())?;
        Ok(())
    }

    /// Response to these segments less its linear part.
    fn nonlinear_nm(&mut self, segments_nm: &[f64]) -> Result<Array1<f64>> {
        let commands_nm = self.closed_loop.commands_nm(segments_nm)?;
        let linear_nm = ArrayView1::from(segments_nm).dot(&self.linear_commands);
        Ok(self.wavefront_nm((commands_nm - &linear_nm).view()))
    }

    /// The mirror's contribution to the wavefront at the samples that are used, nm.
    fn wavefront_nm(&self, commands_nm: ArrayView1<f64>) -> Array1<f64> {
        self.closed_loop.wavefront_nm(commands_nm).select(Axis(0), &self.kept)
    }

    /// Wavefronts `segments` of the segment modes, `[mode, sample]`, with the linear part of the
    /// response to them.
    fn added_to(&self, mut segments: Array2<f64>) -> Array2<f64> {
        let rows = segments.axis_iter_mut(Axis(0)).into_par_iter();
        rows.zip(self.linear_commands.axis_iter(Axis(0)))
            .for_each(|(mut row, commands)| row += &self.wavefront_nm(commands));
        segments
    }
}

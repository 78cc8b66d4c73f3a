//! Estimator of the static errors of one iteration: the linear model, iterated over the nonlinear responses of the closed loop and
//! of the wavefront sensor.

use super::covariance::ResidualCovariance;
use super::image_selection::SelectedImages;
use super::least_squares::StaticModel;
use super::mean_covariance::MeanCovariance;
use super::ncpa_basis::NcpaFamily;
use super::settings::StaticsSettings;
use super::static_errors::StaticErrors;
use super::static_modes::StaticModes;
use super::wavefront_source::WavefrontSource;
use crate::Result;
use crate::loop_response::{ClosedLoopResponse, SensorModel, SlopeInformation};
use crate::optimize::CancelFlag;
use crate::retrieval::{IlluminatedSamples, StaticWavefront};
use crate::scene::{AoKnowledge, Scene};
use crate::telescope::Telescope;
use ndarray::{Array1, Array2, ArrayView1, Axis};

/// Amplitude below which a sample is left out: images hold little information on its phase.
const MIN_AMPLITUDE: f64 = 0.5;

/// Most simulations of the closed loop in an estimate: its nonlinear part is a tenth of the linear one, and each reduces the
/// remaining error by that factor.
const MAX_LOOP_SIMULATIONS: usize = 8;
/// Change of the pistons below which the loop response is converged, nm.
const LOOP_TOLERANCE_NM: f64 = 0.05;

/// Most comparisons of wavefronts with slopes in an estimate: a quad cell is nonlinear, and each removes nine tenths of the
/// remaining error.
const MAX_SLOPE_COMPARISONS: usize = 6;
/// Change of the NCPA below which the comparisons are converged, nm RMS.
const SLOPE_TOLERANCE_NM: f64 = 0.2;

/// Estimator of static errors: what all iterations over a sequence share.
pub(super) struct StaticsEstimator<'a> {
    scene: &'a Scene,
    pub(super) telescope: Telescope,
    all_samples: IlluminatedSamples,
    /// Indices of the samples that are used.
    pub(super) kept: Vec<usize>,
    pub(super) samples: IlluminatedSamples,
    loop_response: Option<SampledLoopResponse>,
    sample_error_nm: f64,
    cancel: Option<&'a CancelFlag>,
}

impl<'a> StaticsEstimator<'a> {
    pub(super) fn new(
        scene: &'a Scene,
        source: &dyn WavefrontSource,
        settings: &StaticsSettings,
        cancel: Option<&'a CancelFlag>,
    ) -> Result<Self> {
        let all_samples = source.samples();
        let kept = all_samples.select_bright(MIN_AMPLITUDE);
        let is_known = settings.ao_knowledge >= AoKnowledge::Loop;
        let even_nm = vec![0.0; all_samples.pistons.nrows()];
        let about_nm = source.start_pistons_nm().unwrap_or(&even_nm);
        let loop_response =
            is_known.then(|| SampledLoopResponse::new(scene, all_samples, &kept, about_nm)).transpose()?;
        let (telescope, samples) = (Telescope::new(scene)?, all_samples.subset(&kept));
        let all_samples = all_samples.clone();
        Ok(Self {
            scene,
            telescope,
            all_samples,
            kept,
            samples,
            loop_response,
            sample_error_nm: settings.sample_error_nm,
            cancel,
        })
    }

    /// The static modes with NCPA of `family`.
    pub(super) fn static_modes(&self, family: NcpaFamily) -> Result<StaticModes> {
        let samples = (&self.all_samples, &self.kept[..]);
        StaticModes::new(family, self.scene, &self.telescope, samples, self.loop_response.is_some())
    }

    /// Covariance of the mean of `images` wavefronts of the covariance `residual`.
    pub(super) fn mean_covariance<'r>(&self, residual: &'r ResidualCovariance, images: usize) -> MeanCovariance<'r>
    where
        'a: 'r,
    {
        MeanCovariance::new(residual, images, self.sample_error_nm, &self.samples).stopped_by(self.cancel)
    }

    /// Estimates the static errors of the selected images' wavefronts, of covariance `residual`, and of the slopes measured during
    /// each exposure (`[image, slope]`, mas).
    pub(super) fn estimate(
        &mut self,
        modes: &StaticModes,
        images: &SelectedImages,
        residual: &ResidualCovariance,
        slopes_mas: Option<Array2<f64>>,
    ) -> Result<StaticErrors> {
        let covariance = self.mean_covariance(residual, images.used.len());
        let pistons = match &self.loop_response {
            Some(response) => &self.samples.pistons + &response.linear,
            None => self.samples.pistons.clone(),
        };
        let groups = (&modes.groups[..], slopes_mas.is_some());
        let mut model = StaticModel::new(pistons.view(), modes.at_kept.view(), groups, &covariance)?;
        let mut loop_response = self.loop_response.as_mut();
        let mut errors = estimate_with_loop(&mut model, &images.mean_nm, loop_response.as_deref_mut(), None, None)?;
        let Some(slopes_mas) = slopes_mas else { return Ok(errors) };
        let wavefronts_nm = &images.residuals_nm + &images.mean_nm;
        let mut sensor = SensorModel::new(self.scene, &self.telescope, &self.samples, &modes.basis)?;
        for comparison in 0..MAX_SLOPE_COMPARISONS {
            let (pistons, before) = (&errors.pistons_nm, &errors.ncpa_nm);
            let slopes =
                sensor.ncpa_information(&self.samples, wavefronts_nm.view(), slopes_mas.view(), pistons, before)?;
            // Hyperparameters without slopes are no start for those with slopes.
            let initial = (comparison > 0).then_some(&errors);
            let next =
                estimate_with_loop(&mut model, &images.mean_nm, loop_response.as_deref_mut(), Some(&slopes), initial)?;
            let change_nm2: f64 = next.ncpa_nm.iter().zip(before).map(|(now, then)| (now - then).powi(2)).sum();
            errors = next;
            if change_nm2.sqrt() < SLOPE_TOLERANCE_NM {
                break;
            }
        }
        Ok(errors)
    }

    /// The static wavefront of `coefficients_nm` (pistons and NCPA) and of the common-path part of `errors`.
    pub(super) fn static_wavefront(
        &mut self,
        modes: &StaticModes,
        coefficients_nm: &Array1<f64>,
        errors: &StaticErrors,
    ) -> Result<StaticWavefront> {
        let (pistons, ncpa) = coefficients_nm.view().split_at(Axis(0), errors.pistons_nm.len());
        let segments_nm = pistons.to_vec();
        let mut smooth_nm = (&ncpa + &ArrayView1::from(&errors.common_path_nm)).dot(&modes.at_all);
        if let Some(response) = &mut self.loop_response {
            smooth_nm += &response.closed_loop.response_nm(&segments_nm)?;
        }
        Ok(StaticWavefront { segments_nm, smooth_nm: smooth_nm.to_vec() })
    }
}

/// Estimates the static errors of a mean wavefront, with the loop's response to them simulated until it is converged.
fn estimate_with_loop(
    model: &mut StaticModel,
    mean_nm: &Array1<f64>,
    loop_response: Option<&mut SampledLoopResponse>,
    slopes: Option<&SlopeInformation>,
    initial: Option<&StaticErrors>,
) -> Result<StaticErrors> {
    let Some(response) = loop_response else { return model.estimate(mean_nm.view(), slopes, initial) };
    let mut errors = model.estimate((mean_nm - &response.offset_nm).view(), slopes, initial)?;
    for _ in 0..MAX_LOOP_SIMULATIONS {
        let pistons_nm = Array1::from(errors.pistons_nm.clone());
        let nonlinear_nm = response.nonlinear_nm(&errors.pistons_nm)?;
        errors = model.estimate((mean_nm - &nonlinear_nm).view(), slopes, Some(&errors))?;
        let change = errors.pistons_nm.iter().zip(&pistons_nm).map(|(now, then)| (now - then).abs());
        if change.fold(0.0, f64::max) < LOOP_TOLERANCE_NM {
            break;
        }
    }
    Ok(errors)
}

/// Closed-loop response at the samples that are used: linear · pistons + offset, and the rest by simulation.
struct SampledLoopResponse {
    closed_loop: ClosedLoopResponse,
    kept: Vec<usize>,
    /// For 1 nm of each piston, `[segment, sample]`, about some pistons.
    linear: Array2<f64>,
    /// What is not linear in those pistons; 0 about even segments.
    offset_nm: Array1<f64>,
}

impl SampledLoopResponse {
    fn new(scene: &Scene, samples: &IlluminatedSamples, kept: &[usize], about_nm: &[f64]) -> Result<Self> {
        let mut closed_loop = ClosedLoopResponse::new(scene, samples)?;
        let linear = closed_loop.linear_response(about_nm)?.select(Axis(1), kept);
        let offset_nm = Array1::zeros(kept.len());
        let mut response = Self { closed_loop, kept: kept.to_vec(), linear, offset_nm };
        if about_nm.iter().any(|nm| *nm != 0.0) {
            response.offset_nm = response.nonlinear_nm(about_nm)?;
        }
        Ok(response)
    }

    /// Response to these pistons less its linear part.
    fn nonlinear_nm(&mut self, pistons_nm: &[f64]) -> Result<Array1<f64>> {
        let response_nm = self.closed_loop.response_nm(pistons_nm)?.select(Axis(0), &self.kept);
        Ok(response_nm - ArrayView1::from(pistons_nm).dot(&self.linear))
    }
}

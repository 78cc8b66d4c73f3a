//! MAP objective of one scene: the parts that all images and threads of a retrieval share.

use super::exposure_blur::ExposureBlur;
use super::information_probe::{TypicalExposure, information_rad2, probe_response};
use super::preconditioner::SpectralPreconditioner;
use super::prior::RadialPsd;
use super::settings::RetrievalSettings;
use crate::imaging::{CpuChain, Mode, Polynomial, Precision};
use crate::modal::Model;
use crate::optimize::{Metric, RESOLUTION_F32, RESOLUTION_F64, Settings};
use crate::{Error, Result};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Prior RMS of tip and of tilt of the whole pupil, nm: a few pixels.
const POINTING_RMS_NM: f64 = 2000.0;

/// Coefficient of the model that is an unknown of the retrieval.
#[derive(Debug, Clone, Copy)]
pub(super) struct FreeCoefficient {
    /// Index among the model's modes.
    pub(super) mode: usize,
    /// Prior RMS, nm.
    pub(super) rms_nm: f64,
    /// Illuminated samples that it moves by 1 nm RMS for each nm.
    pub(super) samples: f64,
}

/// MAP objective of one scene, `χ² + prior`, but for an image's data: imaging chain,
/// preconditioner, unknowns, limits.
pub(super) struct MapModel<T: Polynomial> {
    pub(super) chain: CpuChain<T>,
    pub(super) preconditioner: SpectralPreconditioner<T>,
    pub(super) metric: Arc<Metric>,
    pub(super) optimizer: Settings,
    pub(super) settings: RetrievalSettings,
    pub(super) free: Vec<FreeCoefficient>,
    /// Illuminated samples of each segment where its amplitude is an unknown; empty where
    /// amplitudes are known.
    pub(super) segment_samples: Vec<f64>,
    /// Blur of the exposures, where it is known.
    pub(super) blur: Option<ExposureBlur>,
}

impl<T: Polynomial> MapModel<T> {
    /// For wavefronts of power spectral density `prior` on samples `pitch_m` apart; wavefronts
    /// `margin_m` apart are taken as independent, and `typical` sets the exposure with which the
    /// response to each spatial frequency is probed.
    pub(super) fn new(
        model: &Model,
        prior: &RadialPsd,
        pitch_m: f64,
        margin_m: f64,
        settings: &RetrievalSettings,
        typical: TypicalExposure,
    ) -> Result<Self> {
        let (parts, samples) = (model.optics.parts(), model.optics.sampling().samples);
        let amplitude: Vec<f64> = parts.weights.rows().map(|(.., weights)| weights.iter().sum()).collect();
        let mut preconditioner =
            SpectralPreconditioner::new((&parts.weights.illuminated, &amplitude), samples, pitch_m, margin_m, prior)?;
        let mut areas = vec![0.0; parts.weights.segments];
        for (&segment, &weight) in parts.weights.segment.iter().zip(&parts.weights.weight) {
            areas[segment as usize] += weight;
        }
        let prior_of = |mode: &Mode| match *mode {
            Mode::Piston(segment) => (settings.piston_rms_nm, areas[segment]),
            Mode::Tip(segment) | Mode::Tilt(segment) => (settings.segment_tilt_rms_nm, areas[segment]),
            Mode::Smooth(_) => (POINTING_RMS_NM, areas.iter().sum()),
        };
        let coefficients = parts.modes.iter().map(prior_of).enumerate();
        let free: Vec<_> = coefficients
            .map(|(mode, (rms_nm, samples))| FreeCoefficient { mode, rms_nm, samples })
            .filter(|coefficient| coefficient.rms_nm > 0.0)
            .collect();
        let optimizer = Settings {
            max_evaluations: settings.max_evaluations,
            decrement_tolerance: settings.decrement_tolerance,
            relative_decrement_tolerance: 0.0,
            memory: settings.memory,
            resolution: match settings.precision {
                Precision::F32 => RESOLUTION_F32,
                Precision::F64 => RESOLUTION_F64,
            },
            ..Settings::default()
        };
        let chain = CpuChain::new(model.optics.clone());
        probe_response(&chain, &mut preconditioner, prior, settings.model_error, &typical)?;
        let segment_samples = if settings.segment_amplitude_rms > 0.0 { areas } else { Vec::new() };
        if !(segment_samples.is_empty() || chain.has_amplitudes()) {
            return Err(Error::Value(
                "segments that tilt have no amplitudes of their own: modes.segment = \"piston\" is needed".into(),
            ));
        }
        Ok(Self {
            metric: Arc::new(Metric::whitened(preconditioner.len() + free.len() + segment_samples.len())),
            chain,
            preconditioner,
            optimizer,
            settings: settings.clone(),
            free,
            segment_samples,
            blur: None,
        })
    }

    /// This objective, of exposures with this blur.
    pub(super) fn blurred_by(self, blur: Option<ExposureBlur>) -> Self {
        Self { blur, ..self }
    }

    /// Number of illuminated samples.
    pub(super) fn samples(&self) -> usize {
        self.chain.optics().parts().weights.illuminated.len()
    }

    /// Draws a wavefront of power spectral density `psd`, nm at each illuminated sample.
    #[cfg(test)]
    pub(super) fn draw_nm(&self, psd: &RadialPsd, seed: u64) -> Vec<f64> {
        self.preconditioner.draw(psd, 1.0, seed).into_iter().map(|nm| nm.widen()).collect()
    }

    /// Fisher information of an exposure on the phase of each illuminated sample, nm⁻².
    ///
    /// Σ_x w (∂(S·h_x)/∂φ_p)² with ∂h_x/∂φ_p = −2 Im(U_x*·F_xp·E_p). The phase of U_x* F_xp E_p is
    /// uniform, so its square is half that of the modulus, and |F_xp·E_p|² is the same for all
    /// pixels, 1/((n·q)²·Σ A²) of the total flux. So h = 2·S·Σ_x w·S·h_x/((n·q)²·ΣA²) per radian
    /// squared: twice the photons of a sample where photon noise dominates.
    pub(super) fn information_nm2(&self, flux_e: f64, weighed_e: f64) -> f64 {
        let radians = TAU / self.chain.optics().parts().wavelength_nm;
        information_rad2(self.chain.optics(), flux_e, weighed_e) * radians * radians
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modal::Recipe;
    use crate::retrieval::StaticAberrationRms;
    use crate::scene::Scene;

    /// The analytic information of a sample against the mean response of the probes over all
    /// frequencies.
    #[test]
    fn analytic_information_of_a_sample_agrees_with_the_probes() {
        let settings = [("pupil.samples", "64"), ("modes.ncpa", "none"), ("modes.exact_zernikes", "[2, 3]")];
        let scene = Scene::preset("keck-onsky").unwrap().with(&settings).unwrap();
        let model = Model::new(&scene, &Recipe::from_scene(&scene), false).unwrap();
        let prior = RadialPsd::ao_residual(&scene, StaticAberrationRms::default()).unwrap();
        let pitch_m = 11.25 * model.width_ratio() / 64.0;
        let typical = TypicalExposure { flux_e: 1e9, background_e: 0.0, pixel_variance_e2: 100.0 };
        let map = MapModel::<f64>::new(&model, &prior, pitch_m, 1.0, &RetrievalSettings::default(), typical).unwrap();
        // A sample counts by the square of its amplitude, and those that ring beyond the rim have
        // next to none.
        let weights = &model.optics.parts().weights;
        let amplitude = |weights: &[f64]| weights.iter().sum::<f64>();
        let power = weights.rows().map(|(.., weights)| amplitude(weights).powi(2)).sum::<f64>();
        let (probed, analytic) = (map.preconditioner.mean_response(), power / weights.illuminated.len() as f64);
        // Eight probes of some thousand samples know their mean to 1 %. The formula takes the phase
        // between a sample's light and the image's as uniform, which holds for a spot of 40 λ/D to
        // a tenth.
        assert!((probed / analytic - 1.0).abs() < 0.1, "{probed} {analytic}");
    }
}

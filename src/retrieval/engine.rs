//! What all images and threads of a retrieval share.

use super::cpu_worker::Room;
use super::device_batch::Batch;
use super::information_probe::{Typical, information_rad2, probe};
use super::optimisation::Descent;
use super::preconditioner::Square;
use super::prior::Spectrum;
use super::retriever::RetrievalRecipe;
use crate::estimate::Model;
use crate::imaging::{CpuChain, Mode, Polynomial, Precision};
use crate::optimize::{Metric, RESOLUTION_F32, RESOLUTION_F64, Settings};
use crate::{Error, Result};
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex};

/// Tip and tilt of the whole pupil are known this badly, nm RMS: a few pixels.
const POINTING_RMS_NM: f64 = 2000.0;

/// What all images and threads share.
pub(super) struct Engine<T: Polynomial> {
    pub(super) chain: CpuChain<T>,
    pub(super) square: Square<T>,
    pub(super) metric: Arc<Metric>,
    pub(super) settings: Settings,
    pub(super) recipe: RetrievalRecipe,
    /// The coefficients that vary, the RMS that is expected of each, nm, and how many samples each moves by 1 nm RMS.
    pub(super) free: Vec<(usize, f64, f64)>,
    /// How many samples each segment fills where its amplitude varies; none where amplitudes are known.
    pub(super) filled: Vec<f64>,
    /// Searches and rooms that are not in use now.
    pub(super) descents: Pool<Descent<T>>,
    pub(super) rooms: Pool<Room<T>>,
    /// Whether a device was chosen: not where amplitudes vary, which it does not know.
    pub(super) on_device: bool,
    /// The chain there, once there was one.
    pub(super) batch: Mutex<Option<Batch>>,
}

/// Memory that is used again.
pub(super) struct Pool<M>(Mutex<Vec<M>>);

impl<M> Pool<M> {
    fn new() -> Self {
        Self(Mutex::new(Vec::new()))
    }

    /// One that is idle.
    pub(super) fn take(&self) -> Option<M> {
        self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).pop()
    }

    pub(super) fn put_back(&self, memory: M) {
        self.0.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push(memory);
    }
}

impl<T: Polynomial> Engine<T> {
    pub(super) fn new(
        model: &Model,
        prior: &Spectrum,
        pitch_m: f64,
        margin_m: f64,
        recipe: &RetrievalRecipe,
        typical: Typical,
    ) -> Result<Self> {
        let (parts, samples) = (model.optics.parts(), model.optics.sampling().samples);
        let glass: Vec<f64> = parts.weights.rows().map(|(.., weights)| weights.iter().sum()).collect();
        let mut square = Square::new((&parts.weights.lit, &glass), samples, pitch_m, margin_m, prior)?;
        let mut areas = vec![0.0; parts.weights.segments];
        for (&segment, &weight) in parts.weights.segment.iter().zip(&parts.weights.weight) {
            areas[segment as usize] += weight;
        }
        let known = |mode: &Mode| match *mode {
            Mode::Piston(segment) => (recipe.piston_rms_nm, areas[segment]),
            Mode::Tip(segment) | Mode::Tilt(segment) => (recipe.segment_tilt_rms_nm, areas[segment]),
            Mode::Smooth(_) => (POINTING_RMS_NM, areas.iter().sum()),
        };
        let known = parts.modes.iter().map(known).enumerate();
        let free: Vec<_> = known.map(|(k, (rms, count))| (k, rms, count)).filter(|(_, rms, _)| *rms > 0.0).collect();
        let settings = Settings {
            max_evaluations: recipe.max_evaluations,
            decrement_tolerance: recipe.decrement_tolerance,
            relative_decrement_tolerance: 0.0,
            memory: recipe.memory,
            resolution: match recipe.precision {
                Precision::F32 => RESOLUTION_F32,
                Precision::F64 => RESOLUTION_F64,
            },
            ..Settings::default()
        };
        let chain = CpuChain::new(model.optics.clone());
        probe(&chain, &mut square, prior, recipe, &typical)?;
        let filled = if recipe.segment_amplitude_rms > 0.0 { areas } else { Vec::new() };
        if !(filled.is_empty() || chain.has_amplitudes()) {
            return Err(Error::Value(
                "segments that tilt have no amplitudes of their own: modes.segment = \"piston\" is needed".into(),
            ));
        }
        let on_device = filled.is_empty() && recipe.device.resolve()?.is_some();
        Ok(Self {
            metric: Arc::new(Metric::whitened(square.len() + free.len() + filled.len())),
            chain,
            square,
            settings,
            recipe: recipe.clone(),
            free,
            filled,
            on_device,
            descents: Pool::new(),
            rooms: Pool::new(),
            batch: Mutex::new(None),
        })
    }

    /// Lit samples.
    pub(super) fn lit(&self) -> usize {
        self.chain.optics().parts().weights.lit.len()
    }

    /// What reports call that on which the last retrievals ran, and why it does not compute any more, if it was lost.
    pub(super) fn device(&self) -> (String, Option<String>) {
        let held = self.batch.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let named = |batch: &Batch| (batch.chain.device_name(), batch.chain.failure().map(str::to_owned));
        held.as_ref().map_or_else(|| ("cpu".into(), None), named)
    }

    /// A search in memory of its own.
    ///
    /// # Errors
    /// Broken promises of this module's.
    pub(super) fn descent(&self) -> Result<Descent<T>> {
        self.descents.take().map_or_else(|| Descent::new(self), Ok)
    }

    /// What one thread works in.
    pub(super) fn room(&self) -> Room<T> {
        self.rooms.take().unwrap_or_else(|| Room::new(self))
    }

    /// A wavefront drawn from `spectrum`, nm.
    pub(super) fn draw_nm(&self, spectrum: &Spectrum, seed: u64) -> Vec<f64> {
        self.square.draw(spectrum, 1.0, seed).into_iter().map(|nm| nm.wide()).collect()
    }

    /// Information that an exposure carries on the phase of each lit sample, nm⁻².
    ///
    /// Σ_x w (∂(S·h_x)/∂φ_p)² with ∂h_x/∂φ_p = −2 Im(U_x*·F_xp·E_p): the phase of U_x* F_xp E_p is anything, so its
    /// square is half that of the size, and |F_xp·E_p|² is the same for all pixels, 1/((n·q)²·Σ A²) of the whole light.
    /// So h = 2·S·Σ_x w·S·h_x/((n·q)²·ΣA²) a radian squared: twice the photons of a sample where photon noise rules.
    pub(super) fn information_nm2(&self, flux_e: f64, weighed_e: f64) -> f64 {
        let radians = TAU / self.chain.optics().parts().wavelength_nm;
        information_rad2(self.chain.optics(), flux_e, weighed_e) * radians * radians
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::Recipe;
    use crate::scene::Scene;

    /// What an image tells of a sample by formula, against what probes of the chain say on average over all frequencies.
    #[test]
    fn the_information_of_a_sample_is_what_probes_find() {
        let settings = [("pupil.samples", "64"), ("modes.ncpa", "none"), ("modes.exact_zernikes", "[2, 3]")];
        let scene = Scene::preset("keck-onsky").unwrap().with(&settings).unwrap();
        let model = Model::of(&scene, &Recipe::of(&scene), false).unwrap();
        let prior = Spectrum::of_scene(&scene, super::super::prior::Unknown::default()).unwrap();
        let pitch_m = 11.25 * model.width_ratio() / 64.0;
        let typical = Typical { flux_e: 1e9, background_e: 0.0, floor_e2: 100.0 };
        let engine = Engine::<f64>::new(&model, &prior, pitch_m, 1.0, &RetrievalRecipe::default(), typical).unwrap();
        // A sample counts by the square of its amplitude, and those that ring beyond the rim have next to none.
        let weights = &model.optics.parts().weights;
        let amplitude = |weights: &[f64]| weights.iter().sum::<f64>();
        let light = weights.rows().map(|(.., weights)| amplitude(weights).powi(2)).sum::<f64>();
        let (found, expected) = (engine.square.mean_response(), light / weights.lit.len() as f64);
        // Eight probes of some thousand samples know their mean to 1 %. The formula takes the phase between a sample's
        // light and the image's for anything, and that is what a spot of 40 λ/D has, to a tenth.
        assert!((found / expected - 1.0).abs() < 0.1, "{found} {expected}");
    }
}

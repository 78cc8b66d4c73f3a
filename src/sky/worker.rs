//! One image's retrieval, in memory that one thread keeps.

use super::amplitudes::Amplitudes;
use super::lit::shown_nm;
use super::precondition::{Filter, Square, SquareScratch};
use super::prior::Spectrum;
use super::probe::{Typical, information_rad2, probe, variance_e2};
use super::retrieve::{RetrievalRecipe, RetrievalReport, Statics};
use crate::estimate::{Model, Prepared};
use crate::imaging::{CpuChain, Evaluation, Loaded, Mode, Polynomial, Precision, Scratch};
use crate::optimize::{Metric, Progress, QuasiNewton, RESOLUTION_F32, RESOLUTION_F64, Settings};
use crate::{Error, Result};
use ndarray::{Array1, ArrayView1};
use std::f64::consts::TAU;
use std::sync::{Arc, Mutex};

/// Tip and tilt of the whole pupil are known this badly, nm RMS: a few pixels.
const POINTING_RMS_NM: f64 = 2000.0;

/// Misfit, in degrees of freedom, beyond which it is not what the model leaves of a bright star's image (about 1) but a fit
/// that is still on its way: it does not count for when to stop.
const LARGEST_MISFIT: f64 = 5.0;

/// What all images and threads share.
pub(super) struct Engine<T: Polynomial> {
    chain: CpuChain<T>,
    square: Square<T>,
    metric: Arc<Metric>,
    settings: Settings,
    recipe: RetrievalRecipe,
    /// The coefficients that vary, the RMS that is expected of each, nm, and how many samples each moves by 1 nm RMS.
    free: Vec<(usize, f64, f64)>,
    /// How many samples each segment fills where its amplitude varies; none where amplitudes are known.
    filled: Vec<f64>,
    /// Memory of threads that are not at work now.
    idle: Mutex<Vec<Worker<T>>>,
}

/// What an image shows.
pub(super) struct Found {
    pub(super) phase_nm: Vec<f64>,
    pub(super) coefficients_nm: Vec<f64>,
    /// Logarithm of each segment's amplitude over the model's, where it varies.
    pub(super) ln_amplitudes: Vec<f64>,
    pub(super) report: RetrievalReport,
}

/// One thread's memory.
struct Worker<T: Polynomial> {
    solver: QuasiNewton,
    start: Vec<f64>,
    loaded: Loaded<T>,
    scratch: Scratch<T>,
    evaluation: Evaluation,
    square: SquareScratch<T>,
    filter: Filter<T>,
    /// nm of each free coefficient for 1 of its white number, and the weight of that number's square in the prior.
    scales: Vec<[f64; 2]>,
    amplitudes: Amplitudes,
    coefficients_nm: Array1<f64>,
    base_nm: Vec<f64>,
    base_turns: Vec<T>,
    turns: Vec<T>,
    turns_bar: Vec<T>,
    gradient: Vec<f64>,
    /// Of the image, on the phase of each sample.
    information_nm2: f64,
    /// Degrees of freedom: pixels less what field, coefficients, flux and background take.
    freedom: f64,
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
        Ok(Self {
            metric: Arc::new(Metric::whitened(square.len() + free.len() + filled.len())),
            chain,
            square,
            settings,
            recipe: recipe.clone(),
            free,
            filled,
            idle: Mutex::new(Vec::new()),
        })
    }

    /// The wavefront behind one image.
    ///
    /// # Errors
    /// Broken promises of this module's.
    pub(super) fn retrieve(&self, mut prepared: Prepared, statics: Option<&Statics>) -> Result<Found> {
        let idle = self.idle.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).pop();
        let mut worker = match idle {
            Some(worker) => worker,
            None => Worker::new(self)?,
        };
        let found = worker.retrieve(self, &mut prepared, statics)?;
        self.idle.lock().unwrap_or_else(|poisoned| poisoned.into_inner()).push(worker);
        Ok(found)
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
    fn information_nm2(&self, flux_e: f64, weighed_e: f64) -> f64 {
        let radians = TAU / self.chain.optics().parts().wavelength_nm;
        information_rad2(self.chain.optics(), flux_e, weighed_e) * radians * radians
    }
}

impl<T: Polynomial> Worker<T> {
    fn new(engine: &Engine<T>) -> Result<Self> {
        let (chain, square) = (&engine.chain, &engine.square);
        let lit = chain.optics().parts().weights.lit.len();
        let start = vec![0.0; engine.metric.dimension()];
        let zeros = || vec![T::zero(); lit];
        Ok(Self {
            solver: QuasiNewton::new(engine.metric.clone(), &start, engine.settings.clone())?,
            gradient: start.clone(),
            start,
            loaded: chain.room(),
            scratch: chain.scratch(),
            evaluation: chain.evaluation(),
            square: square.scratch(),
            filter: square.filter(),
            scales: vec![[0.0; 2]; engine.free.len()],
            amplitudes: Amplitudes::new(engine.recipe.segment_amplitude_rms, &engine.filled),
            coefficients_nm: Array1::zeros(chain.optics().modes()),
            base_nm: vec![0.0; chain.optics().modes()],
            base_turns: zeros(),
            turns: zeros(),
            turns_bar: zeros(),
            information_nm2: 0.0,
            freedom: 1.0,
        })
    }

    fn retrieve(&mut self, engine: &Engine<T>, prepared: &mut Prepared, statics: Option<&Statics>) -> Result<Found> {
        self.begin(engine, prepared, statics)?;
        self.minimise(engine)?;
        for _ in 0..engine.recipe.renewals {
            if !self.solver.outcome().reason.converged() {
                break;
            }
            self.weigh_by_model(engine, prepared)?;
            if self.solver.restart_objective() == Progress::Done {
                break;
            }
            self.minimise(engine)?;
        }
        self.place(engine, Point::Best);
        let psf = engine.chain.psf_free_in(self.coefficients_nm.view(), &self.turns, &mut self.scratch);
        let (flux_e, background_e) = (self.evaluation.flux_e, self.evaluation.background_e);
        let mut chi2 = 0.0;
        for ((h, &d), &floor) in psf.iter().zip(&prepared.exposure.data_e).zip(&prepared.floor_variance_e2) {
            let expected = flux_e * h.wide() + background_e;
            let variance = variance_e2(expected, floor, engine.recipe.model_error);
            if variance.is_finite() {
                chi2 += (expected - d).powi(2) / variance;
            }
        }
        let outcome = self.solver.outcome();
        let report = RetrievalReport {
            reduced_chi2: chi2 / self.freedom,
            reduced_objective: outcome.f / self.freedom,
            evaluations: outcome.evaluations,
            reason: outcome.reason,
            flux_e,
            background_e,
            refusal: None,
        };
        let wavelength_nm = engine.chain.optics().parts().wavelength_nm;
        let coefficients_nm = self.coefficients_nm.to_vec();
        let mut phase_nm = shown_nm(engine.chain.optics(), &coefficients_nm);
        phase_nm.iter_mut().zip(&self.turns).for_each(|(nm, turns)| *nm += turns.wide() * wavelength_nm);
        let ln_amplitudes = self.amplitudes.ln().to_vec();
        Ok(Found { phase_nm, coefficients_nm, ln_amplitudes, report })
    }

    /// Takes up an image: its weights, its coordinates, its static wavefront.
    fn begin(&mut self, engine: &Engine<T>, prepared: &mut Prepared, statics: Option<&Statics>) -> Result<()> {
        let (mut flux_e, mut weighed_e) = (0.0, 0.0);
        let exposure = &mut prepared.exposure;
        let pixels = exposure.weight.iter_mut().zip(&exposure.data_e).zip(&prepared.floor_variance_e2);
        for ((weight, &data), &floor) in pixels {
            *weight = 1.0 / variance_e2(data, floor, engine.recipe.model_error);
            let light = data - prepared.level_e;
            flux_e += if floor.is_finite() { light } else { 0.0 };
            weighed_e += *weight * light.max(0.0);
        }
        engine.chain.set(&mut self.loaded, &prepared.exposure)?;
        self.information_nm2 = engine.information_nm2(flux_e, weighed_e);
        let good = prepared.exposure.weight.iter().filter(|weight| **weight > 0.0).count();
        let glass = engine.chain.optics().parts().weights.energy;
        let taken =
            engine.square.freedom(self.information_nm2, glass) + (self.scales.len() + engine.filled.len() + 2) as f64;
        self.freedom = (good as f64 - taken).max(1.0);
        // As far as the linearisation is to be believed: coordinates in which a bright star fixes every sample to a nm
        // would send the first steps, which start a wavefront's RMS away, into what it sees worst. With 24 times this
        // number six images of turbulence take a third more evaluations, to twice the error.
        let information_nm2 = self.information_nm2.min(1.0 / engine.square.variance_nm2());
        let wavelength_nm = engine.chain.optics().parts().wavelength_nm;
        engine.square.set(information_nm2, 1.0 / wavelength_nm, &mut self.filter);
        for (scale, (_, rms_nm, count)) in self.scales.iter_mut().zip(&engine.free) {
            let seen = information_nm2 * count;
            *scale = [1.0 / (seen + rms_nm.powi(-2)).sqrt(), 1.0 / (1.0 + seen * rms_nm * rms_nm)];
        }
        self.amplitudes.begin(information_nm2 * (wavelength_nm / TAU).powi(2));
        self.base_nm.fill(0.0);
        self.base_turns.fill(T::zero());
        if let Some(statics) = statics {
            self.base_nm[..statics.segments_nm.len()].copy_from_slice(&statics.segments_nm);
            let turns = statics.map_nm.iter().map(|nm| T::of(nm / wavelength_nm));
            self.base_turns.iter_mut().zip(turns).for_each(|(out, turns)| *out = turns);
        }
        // The coordinates' information is less than the image's by this much, and the curvature in them more.
        let scale = (information_nm2 / self.information_nm2).sqrt();
        let scale = if scale.is_finite() { scale } else { 1.0 };
        self.solver.begin(&engine.metric, scale, &self.start)
    }

    fn minimise(&mut self, engine: &Engine<T>) -> Result<()> {
        loop {
            self.place(engine, Point::Asked);
            engine.chain.evaluate_free(
                &self.loaded,
                self.coefficients_nm.view(),
                &self.turns,
                &mut self.scratch,
                &mut self.evaluation,
                &mut self.turns_bar,
            );
            let (field, others) = self.gradient.split_at_mut(engine.square.len());
            let (coefficients, amplitudes) = others.split_at_mut(engine.free.len());
            engine.square.field_adjoint(&self.filter, &self.turns_bar, &mut self.square, field);
            let (y, u) = self.solver.ask().split_at(engine.square.len());
            let mut objective = self.evaluation.objective + self.filter.add_prior(y, field);
            engine.chain.amplitude_gradient(&self.scratch, amplitudes);
            objective += self.amplitudes.add_prior(&u[engine.free.len()..], amplitudes);
            for (((out, &(k, ..)), &u), [scale, prior]) in
                coefficients.iter_mut().zip(&engine.free).zip(u).zip(&self.scales)
            {
                objective += prior * u * u;
                *out = self.evaluation.gradient[k] * scale + 2.0 * prior * u;
            }
            let misfit = (self.evaluation.objective - self.freedom).clamp(0.0, LARGEST_MISFIT * self.freedom);
            let tolerance = engine.recipe.decrement_tolerance + engine.recipe.misfit_tolerance * misfit;
            // A misfit that is not finite is the solver's business.
            if tolerance.is_finite() {
                self.solver.set_tolerances(0.0, tolerance)?;
            }
            if self.solver.tell(objective, &self.gradient) == Progress::Done {
                return Ok(());
            }
        }
    }

    /// Phase and coefficients of a point.
    fn place(&mut self, engine: &Engine<T>, point: Point) {
        let at = match point {
            Point::Asked => self.solver.ask(),
            Point::Best => &self.solver.outcome().x,
        };
        let (y, u) = at.split_at(engine.square.len());
        engine.square.field(&self.filter, y, &mut self.square, &mut self.turns);
        self.turns.iter_mut().zip(&self.base_turns).for_each(|(turns, &base)| *turns += base);
        self.coefficients_nm.assign(&ArrayView1::from(&self.base_nm));
        for ((&(k, ..), &u), [scale, _]) in engine.free.iter().zip(u).zip(&self.scales) {
            self.coefficients_nm[k] += scale * u;
        }
        self.amplitudes.place(&u[engine.free.len()..], &mut self.scratch);
    }

    /// Weighs the exposure by the variances that the fitted model gives it.
    fn weigh_by_model(&mut self, engine: &Engine<T>, prepared: &mut Prepared) -> Result<()> {
        self.place(engine, Point::Best);
        let psf = engine.chain.psf_free_in(self.coefficients_nm.view(), &self.turns, &mut self.scratch);
        let (flux_e, background_e) = (self.evaluation.flux_e, self.evaluation.background_e);
        let pixels = prepared.exposure.weight.iter_mut().zip(psf).zip(&prepared.floor_variance_e2);
        for ((weight, h), &floor) in pixels {
            *weight = 1.0 / variance_e2(flux_e * h.wide() + background_e, floor, engine.recipe.model_error);
        }
        engine.chain.set(&mut self.loaded, &prepared.exposure)
    }
}

/// Which point of the optimiser's.
#[derive(Clone, Copy)]
enum Point {
    Asked,
    Best,
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
        let prior = Spectrum::of_scene(&scene, super::super::Unknown::default()).unwrap();
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

//! One image's way to its wavefront: asked for a point, told its objective, until done. It evaluates nothing: threads with
//! an image each and a batch in lock-step drive the same search.

use super::engine::Engine;
use super::illuminated_samples::shown_nm;
use super::information_probe::variance_e2;
use super::preconditioner::{Filter, SquareScratch};
use super::results::RetrievalReport;
use super::retriever::Statics;
use super::segment_amplitudes::Amplitudes;
use crate::Result;
use crate::estimate::{Prepared, photometry};
use crate::imaging::{Evaluation, Polynomial, Scratch};
use crate::optimize::{Progress, QuasiNewton};
use ndarray::{Array1, ArrayView1};
use std::f64::consts::TAU;

/// Misfit, in degrees of freedom, beyond which it is not what the model leaves of a bright star's image (about 1) but a fit
/// that is still on its way: it does not count for when to stop.
const LARGEST_MISFIT: f64 = 5.0;

/// What an image shows.
pub(super) struct Found {
    pub(super) phase_nm: Vec<f64>,
    pub(super) coefficients_nm: Vec<f64>,
    /// Logarithm of each segment's amplitude over the model's, where it varies.
    pub(super) ln_amplitudes: Vec<f64>,
    pub(super) report: RetrievalReport,
}

/// Which point of the optimiser's.
#[derive(Clone, Copy)]
enum Point {
    Asked,
    Best,
}

/// The search for one image's wavefront.
pub(super) struct Descent<T: Polynomial> {
    solver: QuasiNewton,
    start: Vec<f64>,
    filter: Filter<T>,
    /// nm of each free coefficient for 1 of its white number, and the weight of that number's square in the prior.
    scales: Vec<[f64; 2]>,
    amplitudes: Amplitudes,
    coefficients_nm: Array1<f64>,
    base_nm: Vec<f64>,
    base_turns: Vec<T>,
    turns: Vec<T>,
    gradient: Vec<f64>,
    /// Of the image, on the phase of each sample.
    information_nm2: f64,
    /// Degrees of freedom: pixels less what field, coefficients, flux and background take.
    freedom: f64,
}

impl<T: Polynomial> Descent<T> {
    pub(super) fn new(engine: &Engine<T>) -> Result<Self> {
        let (chain, square) = (&engine.chain, &engine.square);
        let start = vec![0.0; engine.metric.dimension()];
        let zeros = || vec![T::zero(); engine.lit()];
        Ok(Self {
            solver: QuasiNewton::new(engine.metric.clone(), &start, engine.settings.clone())?,
            gradient: start.clone(),
            start,
            filter: square.filter(),
            scales: vec![[0.0; 2]; engine.free.len()],
            amplitudes: Amplitudes::new(engine.recipe.segment_amplitude_rms, &engine.filled),
            coefficients_nm: Array1::zeros(chain.optics().modes()),
            base_nm: vec![0.0; chain.optics().modes()],
            base_turns: zeros(),
            turns: zeros(),
            information_nm2: 0.0,
            freedom: 1.0,
        })
    }

    /// Takes up an image: its weights, which go into `prepared`, its coordinates, its static wavefront.
    pub(super) fn begin(
        &mut self,
        engine: &Engine<T>,
        prepared: &mut Prepared,
        statics: Option<&Statics>,
    ) -> Result<()> {
        let (mut flux_e, mut weighed_e) = (0.0, 0.0);
        let exposure = &mut prepared.exposure;
        let pixels = exposure.weight.iter_mut().zip(&exposure.data_e).zip(&prepared.floor_variance_e2);
        for ((weight, &data), &floor) in pixels {
            *weight = 1.0 / variance_e2(data, floor, engine.recipe.model_error);
            let light = data - prepared.level_e;
            flux_e += if floor.is_finite() { light } else { 0.0 };
            weighed_e += *weight * light.max(0.0);
        }
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

    /// Goes to the point that is asked for: what [`Descent::coefficients_nm`], [`Descent::turns`] and
    /// [`Descent::show_amplitudes`] say from now on.
    pub(super) fn place(&mut self, engine: &Engine<T>, square: &mut SquareScratch<T>) {
        self.place_at(Point::Asked, engine, square);
    }

    fn place_at(&mut self, point: Point, engine: &Engine<T>, square: &mut SquareScratch<T>) {
        let at = match point {
            Point::Asked => self.solver.ask(),
            Point::Best => &self.solver.outcome().x,
        };
        let (y, u) = at.split_at(engine.square.len());
        engine.square.field(&self.filter, y, square, &mut self.turns);
        self.turns.iter_mut().zip(&self.base_turns).for_each(|(turns, &base)| *turns += base);
        self.coefficients_nm.assign(&ArrayView1::from(&self.base_nm));
        for ((&(k, ..), &u), [scale, _]) in engine.free.iter().zip(u).zip(&self.scales) {
            self.coefficients_nm[k] += scale * u;
        }
        self.amplitudes.place(&u[engine.free.len()..]);
    }

    /// Coefficients there.
    pub(super) fn coefficients_nm(&self) -> ArrayView1<'_, f64> {
        self.coefficients_nm.view()
    }

    /// Free phase there.
    pub(super) fn turns(&self) -> &[T] {
        &self.turns
    }

    /// Has `scratch` hold the segments' amplitudes there, where they vary.
    pub(super) fn show_amplitudes(&self, scratch: &mut Scratch<T>) {
        self.amplitudes.show(scratch);
    }

    /// Is told what was found there: `turns_bar` is the derivative by the free phase, and `of_amplitudes` fills in those by
    /// the logarithms of the segments' amplitudes.
    pub(super) fn tell(
        &mut self,
        engine: &Engine<T>,
        evaluation: &Evaluation,
        turns_bar: &[T],
        of_amplitudes: impl FnOnce(&mut [f64]),
        square: &mut SquareScratch<T>,
    ) -> Result<Progress> {
        let (field, others) = self.gradient.split_at_mut(engine.square.len());
        let (coefficients, amplitudes) = others.split_at_mut(engine.free.len());
        engine.square.field_adjoint(&self.filter, turns_bar, square, field);
        let (y, u) = self.solver.ask().split_at(engine.square.len());
        let mut objective = evaluation.objective + self.filter.add_prior(y, field);
        of_amplitudes(amplitudes);
        objective += self.amplitudes.add_prior(&u[engine.free.len()..], amplitudes);
        for (((out, &(k, ..)), &u), [scale, prior]) in
            coefficients.iter_mut().zip(&engine.free).zip(u).zip(&self.scales)
        {
            objective += prior * u * u;
            *out = evaluation.gradient[k] * scale + 2.0 * prior * u;
        }
        let misfit = (evaluation.objective - self.freedom).clamp(0.0, LARGEST_MISFIT * self.freedom);
        let tolerance = engine.recipe.decrement_tolerance + engine.recipe.misfit_tolerance * misfit;
        // A misfit that is not finite is the solver's business.
        if tolerance.is_finite() {
            self.solver.set_tolerances(0.0, tolerance)?;
        }
        Ok(self.solver.tell(objective, &self.gradient))
    }

    /// What was found in the end.
    pub(super) fn found(
        &mut self,
        engine: &Engine<T>,
        prepared: &Prepared,
        square: &mut SquareScratch<T>,
        scratch: &mut Scratch<T>,
    ) -> Found {
        self.place_at(Point::Best, engine, square);
        self.show_amplitudes(scratch);
        let psf = engine.chain.psf_free_in(self.coefficients_nm.view(), &self.turns, scratch);
        let psf: Vec<f64> = psf.iter().map(|h| h.wide()).collect();
        let (flux_e, background_e) = photometry(&prepared.exposure, &psf);
        let mut chi2 = 0.0;
        for ((h, &d), &floor) in psf.iter().zip(&prepared.exposure.data_e).zip(&prepared.floor_variance_e2) {
            let expected = flux_e * h + background_e;
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
        Found { phase_nm, coefficients_nm, ln_amplitudes, report }
    }
}

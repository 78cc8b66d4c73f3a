//! MAP optimisation of one image by reverse communication: it names a point, takes the chain's
//! value and gradient there, and takes a quasi-Newton step. It evaluates no optics itself, so a
//! thread with one image and a batch in lock-step drive the same optimisation.
//!
//! The unknowns are y, whitened coordinates of the free phase ([`SpectralPreconditioner`]), and u,
//! whitened coordinates of the free coefficients and of the segments' amplitudes.
//!
//! [`SpectralPreconditioner`]: super::preconditioner::SpectralPreconditioner

use super::illuminated_samples::modal_wavefront_nm;
use super::information_probe::variance_e2;
use super::model::MapModel;
use super::preconditioner::{ImagePreconditioner, PreconditionerScratch};
use super::results::{RetrievalReport, RetrievedImage};
use super::segment_amplitudes::SegmentAmplitudes;
use super::task::KnownOfImage;
use crate::Result;
use crate::imaging::{Evaluation, FreeWavefront, Polynomial, Scratch};
use crate::modal::{PreparedFrame, photometry};
use crate::optimize::{Advance, QuasiNewton};
use ndarray::{Array1, ArrayView1};
use std::f64::consts::TAU;

/// Largest excess of χ² over its degrees of freedom, in degrees of freedom, that counts for the
/// stopping tolerance: the model error of a bright star's image is about 1; more is a fit far from
/// its minimum.
const MAX_EXCESS: f64 = 5.0;

/// A point of the optimiser.
#[derive(Clone, Copy)]
enum Point {
    /// The next one to be evaluated.
    Trial,
    /// The best one so far.
    Best,
}

/// MAP optimisation of one image.
pub(super) struct MapOptimisation<T: Polynomial> {
    solver: QuasiNewton,
    start: Vec<f64>,
    keeps_coordinates: bool,
    preconditioner: ImagePreconditioner<T>,
    /// nm of each free coefficient for u = 1, and the weight of u² in the prior.
    scales: Vec<[f64; 2]>,
    amplitudes: SegmentAmplitudes,
    coefficients_nm: Array1<f64>,
    base_nm: Vec<f64>,
    base_turns: Vec<T>,
    turns: Vec<T>,
    gradient: Vec<f64>,
    /// Fisher information of the image on the phase of each sample.
    information_nm2: f64,
    /// Degrees of freedom: pixels less those that the free phase, the coefficients, flux and
    /// background take.
    freedom: f64,
}

impl<T: Polynomial> MapOptimisation<T> {
    pub(super) fn new(model: &MapModel<T>) -> Result<Self> {
        let start = vec![0.0; model.metric.dimension()];
        let zeros = || vec![T::zero(); model.samples()];
        let modes = model.chain.optics().modes();
        Ok(Self {
            solver: QuasiNewton::new(model.metric.clone(), &start, model.optimizer.clone())?,
            gradient: start.clone(),
            start,
            keeps_coordinates: false,
            preconditioner: model.preconditioner.image_preconditioner(),
            scales: vec![[0.0; 2]; model.free.len()],
            amplitudes: SegmentAmplitudes::new(model.settings.segment_amplitude_rms, &model.segment_samples),
            coefficients_nm: Array1::zeros(modes),
            base_nm: vec![0.0; modes],
            base_turns: zeros(),
            turns: zeros(),
            information_nm2: 0.0,
            freedom: 1.0,
        })
    }

    /// Begins an image: sets the weights in `prepared`, takes the blur off its data, and sets the
    /// coordinates, the static wavefront about which it is sought, and the start.
    pub(super) fn begin(
        &mut self,
        model: &MapModel<T>,
        prepared: &mut PreparedFrame,
        KnownOfImage { about, blur_e, start }: KnownOfImage,
    ) -> Result<()> {
        let (mut flux_e, mut weighed_e) = (0.0, 0.0);
        let exposure = &mut prepared.exposure;
        let pixels = exposure.weight.iter_mut().zip(&exposure.data_e).zip(&prepared.floor_variance_e2);
        for ((weight, &data), &floor) in pixels {
            *weight = 1.0 / variance_e2(data, floor, model.settings.model_error);
            let light = data - prepared.level_e;
            flux_e += if floor.is_finite() { light } else { 0.0 };
            weighed_e += *weight * light.max(0.0);
        }
        // The noise stays that of all light.
        exposure.data_e.iter_mut().zip(blur_e).for_each(|(data, &blur)| *data -= f64::from(blur));
        self.information_nm2 = model.information_nm2(flux_e, weighed_e);
        let good = prepared.exposure.weight.iter().filter(|weight| **weight > 0.0).count();
        let illuminated = model.chain.optics().parts().weights.energy;
        let taken = model.preconditioner.freedom(self.information_nm2, illuminated)
            + (self.scales.len() + model.segment_samples.len() + 2) as f64;
        self.freedom = (good as f64 - taken).max(1.0);
        // Limited to the range of the linearisation: coordinates in which a bright star's image
        // fixes every sample to a nm would send the first steps, which start a wavefront's RMS
        // away, along the worst-determined directions. With 24 times this value six images of
        // turbulence take a third more evaluations, to twice the error.
        let information_nm2 = self.information_nm2.min(1.0 / model.preconditioner.variance_nm2());
        let wavelength_nm = model.chain.optics().parts().wavelength_nm;
        model.preconditioner.set(information_nm2, 1.0 / wavelength_nm, &mut self.preconditioner);
        for (scale, free) in self.scales.iter_mut().zip(&model.free) {
            let information = information_nm2 * free.samples;
            *scale = [
                1.0 / (information + free.rms_nm.powi(-2)).sqrt(),
                1.0 / (1.0 + information * free.rms_nm * free.rms_nm),
            ];
        }
        self.amplitudes.begin(information_nm2 * (wavelength_nm / TAU).powi(2));
        self.base_nm.fill(0.0);
        self.base_turns.fill(T::zero());
        if let Some(about) = about {
            self.base_nm[..about.segments_nm.len()].copy_from_slice(&about.segments_nm);
            let turns = about.smooth_nm.iter().map(|nm| T::narrow(nm / wavelength_nm));
            self.base_turns.iter_mut().zip(turns).for_each(|(out, turns)| *out = turns);
        }
        self.keeps_coordinates = start.is_some();
        self.start.fill(0.0);
        if let Some(start) = start.filter(|start| start.len() == self.start.len()) {
            self.start.iter_mut().zip(start).for_each(|(out, &x)| *out = f64::from(x));
        }
        // The information assumed by the coordinates is less than the image's by this factor, and
        // the curvature in them more.
        let scale = (information_nm2 / self.information_nm2).sqrt();
        let scale = if scale.is_finite() { scale } else { 1.0 };
        self.solver.begin(&model.metric, scale, &self.start)
    }

    /// Moves to the trial point: sets [`Self::coefficients_nm`], [`Self::turns`] and the
    /// amplitudes.
    pub(super) fn place(&mut self, model: &MapModel<T>, scratch: &mut PreconditionerScratch<T>) {
        self.place_at(Point::Trial, model, scratch);
    }

    fn place_at(&mut self, point: Point, model: &MapModel<T>, scratch: &mut PreconditionerScratch<T>) {
        let at = match point {
            Point::Trial => self.solver.point(),
            Point::Best => &self.solver.outcome().x,
        };
        let (y, u) = at.split_at(model.preconditioner.len());
        model.preconditioner.phase(&self.preconditioner, y, scratch, &mut self.turns);
        self.turns.iter_mut().zip(&self.base_turns).for_each(|(turns, &base)| *turns += base);
        self.coefficients_nm.assign(&ArrayView1::from(&self.base_nm));
        for ((free, &u), [scale, _]) in model.free.iter().zip(u).zip(&self.scales) {
            self.coefficients_nm[free.mode] += scale * u;
        }
        self.amplitudes.place(&u[model.free.len()..]);
    }

    /// The wavefront at the point.
    pub(super) fn wavefront(&self) -> FreeWavefront<'_, T> {
        FreeWavefront { coefficients_nm: self.coefficients_nm.view(), turns: &self.turns }
    }

    /// Sets the segments' amplitudes at the point in `scratch`, where they vary.
    pub(super) fn set_amplitudes(&self, scratch: &mut Scratch<T>) {
        self.amplitudes.set_amplitudes(scratch);
    }

    /// Takes a step from the chain's evaluation at the trial point. `turns_bar` is the derivative
    /// by the free phase, and `amplitude_gradient` fills in those by the logarithms of the
    /// segments' amplitudes.
    pub(super) fn advance(
        &mut self,
        model: &MapModel<T>,
        evaluation: &Evaluation,
        turns_bar: &[T],
        amplitude_gradient: impl FnOnce(&mut [f64]),
        scratch: &mut PreconditionerScratch<T>,
    ) -> Result<Advance> {
        let (phase, others) = self.gradient.split_at_mut(model.preconditioner.len());
        let (coefficients, amplitudes) = others.split_at_mut(model.free.len());
        model.preconditioner.phase_adjoint(&self.preconditioner, turns_bar, scratch, phase);
        let (y, u) = self.solver.point().split_at(model.preconditioner.len());
        let mut objective = evaluation.objective + self.preconditioner.add_prior(y, phase);
        amplitude_gradient(amplitudes);
        objective += self.amplitudes.add_prior(&u[model.free.len()..], amplitudes);
        for (((out, free), &u), [scale, prior]) in coefficients.iter_mut().zip(&model.free).zip(u).zip(&self.scales) {
            objective += prior * u * u;
            *out = evaluation.gradient[free.mode] * scale + 2.0 * prior * u;
        }
        let excess = (evaluation.objective - self.freedom).clamp(0.0, MAX_EXCESS * self.freedom);
        let tolerance = model.settings.decrement_tolerance + model.settings.misfit_tolerance * excess;
        // The solver handles an objective that is not finite.
        if tolerance.is_finite() {
            self.solver.set_tolerances(0.0, tolerance)?;
        }
        Ok(self.solver.advance(objective, &self.gradient))
    }

    /// The MAP estimate at the best point.
    pub(super) fn result(
        &mut self,
        model: &MapModel<T>,
        prepared: &PreparedFrame,
        preconditioner_scratch: &mut PreconditionerScratch<T>,
        scratch: &mut Scratch<T>,
    ) -> RetrievedImage {
        self.place_at(Point::Best, model, preconditioner_scratch);
        self.set_amplitudes(scratch);
        let psf = model.chain.psf_free_in(self.wavefront(), scratch);
        let psf: Vec<f64> = psf.iter().map(|h| h.widen()).collect();
        let (flux_e, background_e) = photometry(&prepared.exposure, &psf);
        let mut chi2 = 0.0;
        for ((h, &d), &floor) in psf.iter().zip(&prepared.exposure.data_e).zip(&prepared.floor_variance_e2) {
            let expected = flux_e * h + background_e;
            let variance = variance_e2(expected, floor, model.settings.model_error);
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
        let wavelength_nm = model.chain.optics().parts().wavelength_nm;
        let coefficients_nm = self.coefficients_nm.to_vec();
        let mut wavefront_nm = modal_wavefront_nm(model.chain.optics(), &coefficients_nm);
        wavefront_nm.iter_mut().zip(&self.turns).for_each(|(nm, turns)| *nm += turns.widen() * wavelength_nm);
        let ln_amplitudes = self.amplitudes.ln().to_vec();
        let blur_e =
            model.blur.iter().flat_map(|blur| blur.change(&psf)).map(|change| (flux_e * change) as f32).collect();
        let coordinates = outcome.x.iter().filter(|_| self.keeps_coordinates).map(|&x| x as f32).collect();
        RetrievedImage { wavefront_nm, coefficients_nm, ln_amplitudes, blur_e, coordinates, report }
    }
}

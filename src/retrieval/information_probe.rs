//! What an image tells of the phase of a sample, by formula and by trial.

use super::preconditioner::Square;
use super::prior::Spectrum;
use super::retriever::RetrievalRecipe;
use crate::Result;
use crate::imaging::{CpuChain, Exposure, Optics, Photometry, Polynomial};
use ndarray::Array1;
use std::f64::consts::TAU;

/// Twice the photons of a sample, where their noise rules: see `Engine::information_nm2`.
pub(super) fn information_rad2(optics: &Optics, flux_e: f64, weighed_e: f64) -> f64 {
    2.0 * flux_e * weighed_e * optics.intensity_scale()
}

/// An image such as the scene expects.
pub(super) struct Typical {
    pub(super) flux_e: f64,
    pub(super) background_e: f64,
    /// Variance of a pixel without light, e².
    pub(super) floor_e2: f64,
}

/// Fields whose images are looked at to find what an image tells of each spatial frequency, and steps in each.
const PROBES: u64 = 8;
/// Size of a step, turns: small enough that the gradient is linear to a percent, large enough for single precision.
const PROBE_TURNS: f64 = 1e-3;

/// How well an image of a wavefront drawn from the prior tells each spatial frequency. Where data and model are equal the
/// Hessian is the Gauss-Newton matrix, so a difference of two gradients, one of which is 0, is its product with a step.
pub(super) fn probe<T: Polynomial>(
    chain: &CpuChain<T>,
    square: &mut Square<T>,
    prior: &Spectrum,
    recipe: &RetrievalRecipe,
    typical: &Typical,
) -> Result<()> {
    let optics = chain.optics().clone();
    let nothing = Array1::zeros(optics.modes());
    let (mut scratch, mut evaluation, mut loaded) = (chain.scratch(), chain.evaluation(), chain.room());
    let drawn = square.draw(prior, 1.0 / optics.parts().wavelength_nm, 0);
    let photometry = Photometry::Fixed { flux_e: typical.flux_e, background_e: typical.background_e };
    let psf = chain.psf_free_in(nothing.view(), &drawn, &mut scratch);
    let data_e: Vec<f64> = psf.iter().map(|h| typical.flux_e * h.wide() + typical.background_e).collect();
    let weight: Vec<f64> = data_e.iter().map(|&e| 1.0 / variance_e2(e, typical.floor_e2, recipe.model_error)).collect();
    let weighed_e = data_e.iter().zip(&weight).map(|(e, w)| (e - typical.background_e) * w).sum();
    chain.set(&mut loaded, &Exposure { data_e, weight, photometry })?;
    // A gradient per turn is 2·JᵀWJ·step; the information is per radian.
    let scale = T::of(1.0 / (2.0 * PROBE_TURNS * TAU * TAU * information_rad2(&optics, typical.flux_e, weighed_e)));
    let mut turns = drawn.clone();
    square.probe(PROBES, |step, product| {
        for ((turns, &drawn), &step) in turns.iter_mut().zip(&drawn).zip(step) {
            *turns = drawn + step * T::of(PROBE_TURNS);
        }
        chain.evaluate_free(&loaded, nothing.view(), &turns, &mut scratch, &mut evaluation, product);
        product.iter_mut().for_each(|value| *value *= scale);
    });
    Ok(())
}

/// Variance of a pixel of which `electrons` are expected: their photon noise, the floor (infinite for a bad pixel), and
/// what the model does not know of it.
pub(super) fn variance_e2(electrons: f64, floor_e2: f64, model_error: f64) -> f64 {
    electrons.max(0.0) + floor_e2 + (model_error * electrons).powi(2)
}

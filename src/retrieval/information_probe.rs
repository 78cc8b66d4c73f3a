//! Information probe: Fisher information of an image on the phase of a sample, by formula, and its
//! response to each spatial frequency, by products of the Gauss-Newton matrix with random phases.

use super::preconditioner::SpectralPreconditioner;
use super::prior::RadialPsd;
use crate::Result;
use crate::imaging::{CpuChain, Exposure, FreeWavefront, Optics, Photometry, Polynomial};
use ndarray::Array1;
use std::f64::consts::TAU;

/// Fisher information on the phase of each sample, rad⁻²: see `MapModel::information_nm2` for the
/// derivation.
pub(super) fn information_rad2(optics: &Optics, flux_e: f64, weighed_e: f64) -> f64 {
    2.0 * flux_e * weighed_e * optics.intensity_scale()
}

/// Variance of a pixel with `electrons` expected, e²: photon noise, the floor (infinite for a bad
/// pixel), and the model error.
pub(super) fn variance_e2(electrons: f64, floor_e2: f64, model_error: f64) -> f64 {
    electrons.max(0.0) + floor_e2 + (model_error * electrons).powi(2)
}

/// Exposure that the scene leads to expect.
pub(super) struct TypicalExposure {
    pub(super) flux_e: f64,
    pub(super) background_e: f64,
    /// Variance of a pixel without light, e².
    pub(super) pixel_variance_e2: f64,
}

/// Random phases with which the response is probed.
const PROBES: u64 = 8;
/// Size of a step, turns: small enough that the gradient is linear to a percent, large enough for
/// single precision.
const PROBE_TURNS: f64 = 1e-3;

/// Measures the response to each spatial frequency of a typical exposure of a wavefront drawn from
/// the prior, into `preconditioner`. Where data and model are equal the Hessian is the Gauss-Newton
/// matrix and the gradient is 0, so the gradient at a small step is the matrix times the step.
pub(super) fn probe_response<T: Polynomial>(
    chain: &CpuChain<T>,
    preconditioner: &mut SpectralPreconditioner<T>,
    prior: &RadialPsd,
    model_error: f64,
    typical: &TypicalExposure,
) -> Result<()> {
    let optics = chain.optics().clone();
    let zero = Array1::zeros(optics.modes());
    let (mut scratch, mut evaluation, mut loaded) = (chain.scratch(), chain.evaluation(), chain.empty_image());
    let drawn = preconditioner.draw(prior, 1.0 / optics.parts().wavelength_nm, 0);
    let photometry = Photometry::Fixed { flux_e: typical.flux_e, background_e: typical.background_e };
    let psf = chain.psf_free_in(FreeWavefront { coefficients_nm: zero.view(), turns: &drawn }, &mut scratch);
    let data_e: Vec<f64> = psf.iter().map(|h| typical.flux_e * h.widen() + typical.background_e).collect();
    let weight: Vec<f64> =
        data_e.iter().map(|&e| 1.0 / variance_e2(e, typical.pixel_variance_e2, model_error)).collect();
    let weighed_e = data_e.iter().zip(&weight).map(|(e, w)| (e - typical.background_e) * w).sum();
    chain.set(&mut loaded, &Exposure { data_e, weight, photometry })?;
    // A gradient per turn is 2·JᵀWJ·step; the information is per radian.
    let scale = T::narrow(1.0 / (2.0 * PROBE_TURNS * TAU * TAU * information_rad2(&optics, typical.flux_e, weighed_e)));
    let mut turns = drawn.clone();
    preconditioner.measure_response(PROBES, |step, product| {
        for ((turns, &drawn), &step) in turns.iter_mut().zip(&drawn).zip(step) {
            *turns = drawn + step * T::narrow(PROBE_TURNS);
        }
        let at = FreeWavefront { coefficients_nm: zero.view(), turns: &turns };
        chain.evaluate_free(&loaded, at, &mut scratch, &mut evaluation, product);
        product.iter_mut().for_each(|value| *value *= scale);
    });
    Ok(())
}

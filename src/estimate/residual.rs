//! What a fitted model says of an exposure: flux and background, variances, χ².

use super::minimum::Minimum;
use crate::imaging::{Exposure, Photometry};

/// Variance of a pixel of which the model expects `electrons`: their photon noise, and the floor (infinite for a bad
/// pixel).
pub(super) fn pixel_variance(electrons: f64, floor_variance_e2: f64) -> f64 {
    electrons.max(0.0) + floor_variance_e2
}

/// Variance of each pixel under the fitted model, e²; infinite for a bad pixel.
pub(super) fn variance(psf: &[f64], minimum: &Minimum, floor_variance_e2: &[f64]) -> Vec<f64> {
    let expected = psf.iter().map(|h| minimum.flux_e * h + minimum.background_e);
    expected.zip(floor_variance_e2).map(|(electrons, &floor)| pixel_variance(electrons, floor)).collect()
}

/// Weighs an exposure by the variances that the model with this PSF, flux and background gives it.
pub(super) fn reweigh(exposure: &mut Exposure, psf: &[f64], (flux_e, background_e): (f64, f64), floor: &[f64]) {
    for ((weight, h), &floor) in exposure.weight.iter_mut().zip(psf).zip(floor) {
        *weight = 1.0 / pixel_variance(flux_e * h + background_e, floor);
    }
}

/// Flux and background of an exposure for a given PSF.
pub(super) fn photometry(exposure: &Exposure, psf: &[f64]) -> (f64, f64) {
    let (mut w, mut wd, mut wh, mut whh, mut whd) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for ((&weight, &d), &h) in exposure.weight.iter().zip(&exposure.data_e).zip(psf) {
        w += weight;
        wd += weight * d;
        wh += weight * h;
        whh += weight * h * h;
        whd += weight * h * d;
    }
    exposure.photometry.solve(w, wd, wh, whh, whd)
}

/// χ² per degree of freedom of a minimum: 1 where the model is right.
pub(super) fn reduced_chi2(
    psf: &[f64],
    (flux_e, background_e): (f64, f64),
    exposure: &Exposure,
    floor_variance_e2: &[f64],
    seen_modes: usize,
) -> f64 {
    let (mut sum, mut good) = (0.0, 0usize);
    for ((h, d), &floor) in psf.iter().zip(&exposure.data_e).zip(floor_variance_e2) {
        let expected = flux_e * h + background_e;
        let variance = pixel_variance(expected, floor);
        if variance.is_finite() {
            sum += (expected - d).powi(2) / variance;
            good += 1;
        }
    }
    let nuisances = match exposure.photometry {
        Photometry::Fixed { .. } => 0,
        Photometry::FitFlux { .. } => 1,
        Photometry::FitBoth => 2,
    };
    sum / good.saturating_sub(seen_modes + nuisances).max(1) as f64
}

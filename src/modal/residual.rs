//! Residual of an exposure under a fitted model: flux and background, variances, χ².

use super::minimum::Minimum;
use crate::imaging::{Exposure, Photometry};

/// Independent partial sums, so that they are vectorised.
const LANES: usize = 8;

/// Variance of a pixel whose expected signal is `electrons`: photon noise, and the floor (infinite for a bad pixel).
pub(super) fn pixel_variance(electrons: f64, floor_variance_e2: f64) -> f64 {
    electrons.max(0.0) + floor_variance_e2
}

/// Variance of each pixel under the fitted model, e²; infinite for a bad pixel.
pub(super) fn variance(psf: &[f64], minimum: &Minimum, floor_variance_e2: &[f64]) -> Vec<f64> {
    let expected = psf.iter().map(|h| minimum.flux_e * h + minimum.background_e);
    expected.zip(floor_variance_e2).map(|(electrons, &floor)| pixel_variance(electrons, floor)).collect()
}

/// Sets the weights of an exposure to the inverse variances under the model with this PSF, flux and background.
pub(super) fn reweigh(exposure: &mut Exposure, psf: &[f64], (flux_e, background_e): (f64, f64), floor: &[f64]) {
    for ((weight, h), &floor) in exposure.weight.iter_mut().zip(psf).zip(floor) {
        *weight = 1.0 / pixel_variance(flux_e * h + background_e, floor);
    }
}

/// Flux and background of an exposure for a given PSF.
pub(crate) fn photometry(exposure: &Exposure, psf: &[f64]) -> (f64, f64) {
    let mut sums = [[0.0; LANES]; 5];
    let [w, wd, wh, whh, whd] = &mut sums;
    let pixels = exposure.weight.chunks(LANES).zip(exposure.data_e.chunks(LANES)).zip(psf.chunks(LANES));
    for ((weight, data), psf) in pixels {
        for (i, ((&weight, &d), &h)) in weight.iter().zip(data).zip(psf).enumerate() {
            w[i] += weight;
            wd[i] += weight * d;
            wh[i] += weight * h;
            whh[i] += weight * h * h;
            whd[i] += weight * h * d;
        }
    }
    let [w, wd, wh, whh, whd] = sums.map(|lanes| lanes.iter().sum());
    exposure.photometry.solve(w, wd, wh, whh, whd)
}

/// χ² per degree of freedom of a minimum: 1 where the model is right.
pub(super) fn reduced_chi2(
    psf: &[f64],
    (flux_e, background_e): (f64, f64),
    exposure: &Exposure,
    floor_variance_e2: &[f64],
    modes: usize,
) -> f64 {
    let (mut sums, mut good) = ([0.0; LANES], [0.0; LANES]);
    let pixels = psf.chunks(LANES).zip(exposure.data_e.chunks(LANES)).zip(floor_variance_e2.chunks(LANES));
    for ((psf, data), floor) in pixels {
        for (i, ((h, d), &floor)) in psf.iter().zip(data).zip(floor).enumerate() {
            let expected = flux_e * h + background_e;
            // An infinite variance excludes a pixel.
            sums[i] += (expected - d).powi(2) / pixel_variance(expected, floor);
            good[i] += if floor < f64::INFINITY { 1.0 } else { 0.0 };
        }
    }
    let (sum, good) = (sums.iter().sum::<f64>(), good.iter().sum::<f64>() as usize);
    sum / good.saturating_sub(modes + nuisances(exposure)).max(1) as f64
}

/// Number of photometric parameters that are fitted to an exposure.
pub(super) fn nuisances(exposure: &Exposure) -> usize {
    match exposure.photometry {
        Photometry::Fixed { .. } => 0,
        Photometry::FitFlux { .. } => 1,
        Photometry::FitBoth => 2,
    }
}

//! Residual of an exposure under a fitted model: flux and background, variances.

use crate::imaging::Exposure;
use crate::modal::assess::chi2::pixel_variance;
use crate::modal::solve::minimum::Minimum;

/// Independent partial sums, so that they are vectorised.
const LANES: usize = 8;

/// Variance of each pixel under the fitted model, e²; infinite for a bad pixel.
pub(in crate::modal) fn variance(psf: &[f64], minimum: &Minimum, floor_variance_e2: &[f64]) -> Vec<f64> {
    let expected = psf.iter().map(|h| minimum.flux_e * h + minimum.background_e);
    expected.zip(floor_variance_e2).map(|(electrons, &floor)| pixel_variance(electrons, floor)).collect()
}

/// Sets the weights of an exposure to the inverse variances under the model with this PSF, flux and
/// background.
pub(in crate::modal) fn reweigh(
    exposure: &mut Exposure,
    psf: &[f64],
    (flux_e, background_e): (f64, f64),
    floor: &[f64],
) {
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

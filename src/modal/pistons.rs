//! Pistons by whole wavelengths.

use super::minimum::Minimum;
use super::model::Model;
use std::f64::consts::TAU;

/// Moves pistons by wavelengths, so that they differ least from `reference_nm` up to a piston of all.
pub(super) fn wrap(coefficients_nm: &mut [f64], reference_nm: &[f64], model: &Model) {
    let pistons = model.pistons();
    let period_nm = model.optics.parts().wavelength_nm;
    let differences: Vec<f64> = coefficients_nm[..pistons].iter().zip(reference_nm).map(|(a, b)| a - b).collect();
    let phase = |function: fn(f64) -> f64| differences.iter().map(|nm| function(TAU * nm / period_nm)).sum::<f64>();
    let common_nm = phase(f64::sin).atan2(phase(f64::cos)) * period_nm / TAU;
    for (nm, difference) in coefficients_nm.iter_mut().zip(&differences) {
        *nm -= period_nm * ((difference - common_nm) / period_nm).round();
    }
}

/// Moves the pistons of images of one scene by wavelengths: of the first to the smallest, of the others to those nearest to it. In light
/// of one wavelength the images are the same, and a step of the optimiser may end a wavelength away.
pub(super) fn wrap_all(minima: &mut [Minimum], model: &Model) {
    if model.optics.parts().colours.len() > 1 {
        return;
    }
    let mut reference_nm = vec![0.0; model.optics.modes()];
    for minimum in minima.iter_mut().filter(|minimum| minimum.coefficients_nm.iter().all(|nm| nm.is_finite())) {
        wrap(&mut minimum.coefficients_nm, &reference_nm, model);
        reference_nm.copy_from_slice(&minimum.coefficients_nm);
    }
}

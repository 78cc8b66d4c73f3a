//! Pistons by whole wavelengths.

use crate::imaging::Mode;
use crate::modal::model::Model;
use crate::statistics::median;
use ndarray::ArrayView1;
use std::f64::consts::TAU;

/// [`wrap`] where the light has one wavelength, so that the image does not show whole wavelengths:
/// a step of the optimiser may end one away from where it started. Allocates nothing.
pub(in crate::modal) fn wrap_if_monochromatic(coefficients_nm: &mut [f64], start_nm: &[f64], model: &Model) {
    if model.optics.parts().colours.len() == 1 {
        wrap(coefficients_nm, start_nm, model);
    }
}

/// Moves pistons by wavelengths, so that they differ least from those of `reference_nm` up to a
/// piston of all. Allocates nothing.
pub(in crate::modal) fn wrap(coefficients_nm: &mut [f64], reference_nm: &[f64], model: &Model) {
    let parts = model.optics.parts();
    let pistons = parts.modes.iter().take_while(|mode| matches!(mode, Mode::Piston(_))).count();
    wrap_pistons(&mut coefficients_nm[..pistons], &reference_nm[..pistons], parts.wavelength_nm);
}

/// The pistons among `coefficients_nm`, moved by wavelengths so that they differ least from those
/// of `reference_nm`, up to a piston of all, which is left out.
pub(crate) fn pistons_near(coefficients_nm: ArrayView1<f64>, reference_nm: &[f64], model: &Model) -> Vec<f64> {
    let mut moved_nm = coefficients_nm.to_vec();
    wrap(&mut moved_nm, reference_nm, model);
    moved_nm.truncate(model.pistons());
    let off_nm = median(&moved_nm.iter().zip(reference_nm).map(|(nm, reference)| nm - reference).collect::<Vec<_>>());
    moved_nm.iter_mut().for_each(|nm| *nm -= off_nm);
    moved_nm
}

fn wrap_pistons(pistons_nm: &mut [f64], reference_nm: &[f64], period_nm: f64) {
    let (mut sines, mut cosines) = (0.0, 0.0);
    for (nm, reference) in pistons_nm.iter().zip(reference_nm) {
        let (sin, cos) = (TAU * (nm - reference) / period_nm).sin_cos();
        (sines, cosines) = (sines + sin, cosines + cos);
    }
    let common_nm = f64::atan2(sines, cosines) * period_nm / TAU;
    for (nm, reference) in pistons_nm.iter_mut().zip(reference_nm) {
        *nm -= period_nm * ((*nm - reference - common_nm) / period_nm).round();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pistons_go_to_the_wavelength_of_the_reference() {
        let near = [30.0, -400.0, 700.0, 0.0];
        let mut found = [30.0 + 2000.0, -400.0, 700.0 - 4000.0, 0.0];
        wrap_pistons(&mut found, &[0.0; 4], 2000.0);
        assert_eq!(found, near);
        let far = near.map(|nm| nm + 10_000.0);
        wrap_pistons(&mut found, &far, 2000.0);
        assert_eq!(found, far);
        wrap_pistons(&mut found, &[10_000.0, 0.0, 0.0, 0.0], 2000.0);
        assert_eq!(found, [10_030.0, -400.0, 700.0, 0.0]);
    }
}

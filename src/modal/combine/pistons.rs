//! Pistons by whole wavelengths.

use crate::imaging::Mode;
use crate::modal::model::Model;
use crate::statistics::median;
use ndarray::ArrayView1;
use std::f64::consts::TAU;

/// Centres from which the pistons of least spread are sought, evenly over a wavelength.
const CENTRES: usize = 32;
/// Iterations from one of them, each of which lowers the spread; two or three suffice.
const ITERATIONS: usize = 8;
/// Share by which another spread must be smaller, so that rounding decides nothing.
const SMALLER: f64 = 1e-9;

/// Moves pistons by whole wavelengths where the light has one wavelength, so that the image does
/// not show them, and a step of the optimiser may end one away from where it started: towards those
/// of `start_nm` ([`wrap`]), and where they are all equal there so that they spread least.
/// Allocates nothing.
pub(in crate::modal) fn wrap_if_monochromatic(coefficients_nm: &mut [f64], start_nm: &[f64], model: &Model) {
    if model.optics.parts().colours.len() > 1 {
        return;
    }
    let pistons = pistons_of(model);
    if start_nm[..pistons].windows(2).all(|pair| pair[0] == pair[1]) {
        gather_pistons(&mut coefficients_nm[..pistons], model.optics.parts().wavelength_nm);
    } else {
        wrap(coefficients_nm, start_nm, model);
    }
}

/// Number of modes that are pistons, which come first.
fn pistons_of(model: &Model) -> usize {
    model.optics.parts().modes.iter().take_while(|mode| matches!(mode, Mode::Piston(_))).count()
}

/// Moves pistons by wavelengths, so that they differ least from those of `reference_nm` up to a
/// piston of all. Allocates nothing.
pub(in crate::modal) fn wrap(coefficients_nm: &mut [f64], reference_nm: &[f64], model: &Model) {
    let (pistons, period_nm) = (pistons_of(model), model.optics.parts().wavelength_nm);
    wrap_pistons(&mut coefficients_nm[..pistons], &reference_nm[..pistons], period_nm);
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

/// Moves pistons by whole periods so that the sum of their squares about their mean is smallest:
/// that about the Fréchet mean on the circle, which is a fixed point of the mean of the pistons
/// that are within half a period of it.
fn gather_pistons(pistons_nm: &mut [f64], period_nm: f64) {
    let near = |nm: f64, centre_nm: f64| nm - period_nm * ((nm - centre_nm) / period_nm).round();
    let count = pistons_nm.len() as f64;
    let (mut sines, mut cosines) = (0.0, 0.0);
    for nm in pistons_nm.iter() {
        let (sin, cos) = (TAU * nm / period_nm).sin_cos();
        (sines, cosines) = (sines + sin, cosines + cos);
    }
    let circular_nm = f64::atan2(sines, cosines) * period_nm / TAU;
    let mut best = (f64::INFINITY, circular_nm);
    for attempt in 0..=CENTRES {
        // The first, the circular mean, is right where the pistons are within half a period.
        let mut centre_nm = match attempt {
            0 => circular_nm,
            _ => ((attempt as f64 - 0.5) / CENTRES as f64 - 0.5) * period_nm,
        };
        let mut spread_nm2 = f64::INFINITY;
        for _ in 0..ITERATIONS {
            let mean_nm = pistons_nm.iter().map(|&nm| near(nm, centre_nm)).sum::<f64>() / count;
            let now_nm2: f64 = pistons_nm.iter().map(|&nm| (near(nm, centre_nm) - mean_nm).powi(2)).sum();
            if now_nm2 >= spread_nm2 * (1.0 - SMALLER) {
                break;
            }
            spread_nm2 = now_nm2;
            if spread_nm2 < best.0 * (1.0 - SMALLER) {
                best = (spread_nm2, centre_nm);
            }
            centre_nm = mean_nm;
        }
    }
    pistons_nm.iter_mut().for_each(|nm| *nm = near(*nm, best.1));
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
    fn pistons_gather_where_they_spread_least() {
        let spread = |nm: &[f64]| {
            let mean = nm.iter().sum::<f64>() / nm.len() as f64;
            nm.iter().map(|nm| (nm - mean).powi(2)).sum::<f64>()
        };
        let near = [30.0, -400.0, 700.0, 0.0];
        let mut far = [30.0 + 2000.0, -400.0, 700.0 - 4000.0, 0.0];
        gather_pistons(&mut far, 2000.0);
        assert_eq!(far, near);
        // Against all cuts of the circle, between which the least spread is.
        let mut state = 1u64;
        for _ in 0..200 {
            let mut pistons = [0.0; 9];
            for nm in &mut pistons {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                *nm = ((state >> 40) as f64 / (1u64 << 24) as f64 - 0.5) * 6000.0;
            }
            let cut = |&first: &f64| spread(&pistons.map(|nm| first + (nm - first).rem_euclid(2000.0)));
            let least = pistons.iter().map(cut).fold(f64::INFINITY, f64::min);
            gather_pistons(&mut pistons, 2000.0);
            assert!((spread(&pistons) / least - 1.0).abs() < 1e-9, "{pistons:?}");
        }
        let mut none: [f64; 0] = [];
        gather_pistons(&mut none, 2000.0);
    }

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

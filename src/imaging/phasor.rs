//! exp(2πi·t) for phases in turns, by polynomials that the compiler vectorises: the scalar library
//! functions would cost more than the Fourier transform.
//!
//! Range reduction in turns is exact: `r = t − round(t)` in [−½, ½]. With a = π·r in [−π/2, π/2]
//! the Taylor series of sin a and cos a converge fast, and the double-angle formulas
//! `cos 2a = 1 − 2 sin²a`, `sin 2a = 2 sin a cos a` keep the absolute accuracy. Truncation: the
//! first omitted terms are at most 2e-17 in f64 and 6e-9 in f32, below half an ulp of 1.

use crate::fourier::Real;

/// Floating-point type of the phasor: the number of series terms it needs, and its rounding
/// constant.
pub trait Polynomial: Real {
    /// Number of terms of each series.
    const TERMS: usize;
    /// 1.5·2^(mantissa bits): adding and subtracting it rounds to the nearest integer, in vector
    /// code on every CPU (`round` is a library call on the oldest x86-64).
    const ROUNDER: Self;
}

impl Polynomial for f32 {
    const TERMS: usize = 7;
    const ROUNDER: f32 = 12_582_912.0;
}

impl Polynomial for f64 {
    const TERMS: usize = 11;
    const ROUNDER: f64 = 6_755_399_441_055_744.0;
}

/// (cos 2πt, sin 2πt). Valid while |t| < 2^22 turns in f32, 2^51 in f64.
#[inline(always)]
pub(crate) fn phasor<T: Polynomial>(turns: T) -> (T, T) {
    let reduced = turns - ((turns + T::ROUNDER) - T::ROUNDER);
    let angle = reduced * T::PI();
    let square = angle * angle;
    // Horner from the highest term; 1/((2k)(2k+1)) and 1/((2k−1)(2k)) are the ratios of
    // neighbouring coefficients.
    let (mut sin, mut cos) = (T::one(), T::one());
    let mut k = T::TERMS - 1;
    while k > 0 {
        let even = (2 * k) as f64;
        sin = (square * sin).mul_add(T::narrow(-1.0 / (even * (even + 1.0))), T::one());
        cos = (square * cos).mul_add(T::narrow(-1.0 / (even * (even - 1.0))), T::one());
        k -= 1;
    }
    let sin = sin * angle;
    let twice = sin + sin;
    ((-twice).mul_add(sin, T::one()), twice * cos)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn worst<T: Polynomial>() -> f64 {
        (-4000..4000)
            .map(|i| {
                let turns = T::narrow(f64::from(i) * 0.000_731);
                let (cos, sin) = phasor(turns);
                let angle = std::f64::consts::TAU * (turns.widen() - turns.widen().round());
                (cos.widen() - angle.cos()).abs().max((sin.widen() - angle.sin()).abs())
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn both_precisions_are_accurate_to_their_rounding() {
        // The sine and cosine of the half angle are good to about one ulp of 1; each enters the
        // doubled angle twice, and with a factor 2: four ulps, and one more for the last
        // operations.
        assert!(worst::<f64>() < 5.0 * f64::EPSILON, "{}", worst::<f64>());
        assert!(worst::<f32>() < 5.0 * f64::from(f32::EPSILON), "{}", worst::<f32>());
    }
}

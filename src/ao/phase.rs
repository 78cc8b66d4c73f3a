//! Phasor exp(2πi·OPD/λ) in single precision, in a form that compiles to vector code.

/// Coefficients in r² of sin(πr)/r and cos(πr) on |r| ≤ ½: Chebyshev fits of degree 4, within
/// 1.4e-8 and 4.7e-8, below the rounding of single precision.
const SIN: [f32; 5] = [std::f32::consts::PI, -5.167_71, 2.550_077_5, -0.598_291_3, 0.077_657_66];
const COS: [f32; 5] = [0.999_999_95, -4.934_793, 4.058_411_4, -1.331_876_6, 0.219_689_61];
/// 1.5·2²³: adding and subtracting it rounds to the nearest integer.
const ROUNDER: f32 = 12_582_912.0;

/// (cos 2πt, sin 2πt) of a phase in turns, |t| < 2²²; within 8e-7.
#[inline(always)]
pub(super) fn unit_phasor(turns: f32) -> (f32, f32) {
    let reduced = turns - ((turns + ROUNDER) - ROUNDER);
    let square = reduced * reduced;
    let series =
        |c: [f32; 5]| c[4].mul_add(square, c[3]).mul_add(square, c[2]).mul_add(square, c[1]).mul_add(square, c[0]);
    let (sin, cos) = (series(SIN) * reduced, series(COS));
    let twice = sin + sin;
    ((-twice).mul_add(sin, 1.0), twice * cos)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_phasor_is_good_to_single_precision() {
        for i in -20_000..20_000 {
            let turns = i as f32 * 0.000_731;
            let (cos, sin) = unit_phasor(turns);
            let (true_sin, true_cos) = (f64::from(turns) * std::f64::consts::TAU).sin_cos();
            // Sine and cosine of the half angle carry two roundings of 6e-8 and the fit's 5e-8; the
            // doubled angle takes four times that.
            assert!((f64::from(cos) - true_cos).abs() < 8e-7 && (f64::from(sin) - true_sin).abs() < 8e-7, "{turns}");
        }
    }
}

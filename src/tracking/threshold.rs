//! Thresholds of the change detector, from the rate of false alarms that is accepted.

use crate::statistics::normal_cdf;
use std::f64::consts::PI;

/// Threshold of a detector of steps in white Gaussian vectors of `dimension` components: the
/// detector sums the last L vectors, L from `windows[0]` to `windows[1]`, and raises an alarm where
/// |sum|²/L exceeds the threshold for any L. It raises `false_alarms_per_step` false alarms a
/// vector.
///
/// For a level b the rate of false alarms is
///
/// ```text
/// f(b)·(θ/2)·Σ_L x·ν²(x)·x/(2L),   x = θ/√L,   θ = b·(1 − (dimension − 1)/b²),
/// ```
///
/// f the density of |N(0, 1)| in that dimension, ν the correction for overshoot: Siegmund &
/// Venkatraman 1995 (Ann. Stat. 23, 255, equation 2.2 for one dimension), Zhang et al. 2010
/// (Biometrika 97, 631) for more, both as a sum over L instead of an integral. The tests compare it
/// with counted alarms.
pub fn change_threshold(dimension: usize, windows: [usize; 2], false_alarms_per_step: f64) -> f64 {
    // Below √(dimension − 1) the level is not rare, and the approximation has no meaning.
    let least = ((dimension as f64 - 1.0).max(0.0) + 2.0).sqrt();
    let (mut low, mut high) = (least, least + 40.0);
    while high - low > 1e-9 {
        let middle = 0.5 * (low + high);
        if rate_per_step(dimension, windows, middle) > false_alarms_per_step { low = middle } else { high = middle }
    }
    high * high
}

/// False alarms a step at the level `b`.
fn rate_per_step(dimension: usize, windows: [usize; 2], b: f64) -> f64 {
    let excess = dimension as f64 - 1.0;
    let theta = b * (1.0 - excess / (b * b));
    let sum = (windows[0]..=windows[1]).map(|length| {
        let x = theta / (length as f64).sqrt();
        x * overshoot(x).powi(2) * x / (2.0 * length as f64)
    });
    let m = dimension as f64;
    let ln_density = excess * b.ln() - b * b / 2.0 - (m / 2.0 - 1.0) * 2f64.ln() - ln_gamma_of_half(dimension);
    ln_density.exp() * theta / 2.0 * sum.sum::<f64>()
}

/// ν(x), the correction for overshoot of a random walk with drift: Siegmund & Yakir 2007, "The
/// Statistics of Gene Mapping", p. 112.
fn overshoot(x: f64) -> f64 {
    let (half, density) = (x / 2.0, (-x * x / 8.0).exp() / (2.0 * PI).sqrt());
    let above = normal_cdf(half);
    2.0 / x * (above - 0.5) / (half * above + density)
}

/// ln Γ(n/2), by Γ(x + 1) = x·Γ(x) from Γ(1/2) = √π or Γ(1) = 1.
fn ln_gamma_of_half(n: usize) -> f64 {
    let (first, start) = if n.is_multiple_of(2) { (2, 0.0) } else { (1, 0.5 * PI.ln()) };
    (first..n).step_by(2).map(|k| (k as f64 / 2.0).ln()).sum::<f64>() + start
}

/// χ² of `dimension` components that a proportion Φ(−z) exceeds: the cube of Wilson & Hilferty 1931
/// (PNAS 17, 684), within 1 % for five components and more.
pub(super) fn chi2_limit(dimension: usize, z: f64) -> f64 {
    let m = dimension as f64;
    let spread = 2.0 / (9.0 * m);
    m * (1.0 - spread + z * spread.sqrt()).powi(3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_special_functions_have_their_tabulated_values() {
        // Γ(5/2) = 3√π/4, Γ(4) = 6.
        assert!((ln_gamma_of_half(5) - (0.75 * PI.sqrt()).ln()).abs() < 1e-14);
        assert!((ln_gamma_of_half(8) - 6f64.ln()).abs() < 1e-14);
        // 0.1 % of χ² with 20 degrees of freedom exceed 45.315 (table 26.8); the approximation is
        // good to 0.3 %.
        assert!((chi2_limit(20, 3.0902) - 45.315).abs() < 0.15);
        // ν(x) = exp(−0.583·x) for small x (Siegmund 1985), to its next order, x².
        assert!((overshoot(0.1) - (-0.0583f64).exp()).abs() < 0.01);
    }

    #[test]
    fn one_window_of_one_vector_has_the_tail_of_the_normal() {
        // 2·Φ(−4.5) = 6.795e-6; the approximation neglects 1/b² = 5 %.
        let threshold = change_threshold(1, [1, 1], 6.795e-6);
        assert!((threshold.sqrt() - 4.5).abs() < 0.02, "{threshold}");
    }
}

//! Robust statistics, medians and the median absolute deviation, and the normal distribution.

use std::f64::consts::PI;

/// Median absolute deviation of a normal variable over its standard deviation.
pub const NORMAL_MEDIAN_DEVIATION: f64 = 0.6745;

/// Median: the middle value, or the mean of the two middle ones; NaN of none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (below, above) = (sorted.len().saturating_sub(1) / 2, sorted.len() / 2);
    match (sorted.get(below), sorted.get(above)) {
        (Some(a), Some(b)) => (a + b) / 2.0,
        _ => f64::NAN,
    }
}

/// Upper median: the middle value, or the larger of the two middle ones, so always one of the
/// values; NaN of none.
pub fn upper_median(values: &[f64]) -> f64 {
    upper_median_in_place(&mut values.to_vec())
}

/// [`upper_median`] without allocation: reorders `values`.
pub fn upper_median_in_place(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let middle = values.len() / 2;
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Φ(x) by the series of the error function for small |x| and its continued fraction beyond:
/// Abramowitz & Stegun 26.2.11 and 26.2.14.
pub fn normal_cdf(x: f64) -> f64 {
    let density = (-x * x / 2.0).exp() / (2.0 * PI).sqrt();
    if x.abs() > 6.0 {
        let tail = density / (x.abs() + 1.0 / (x.abs() + 2.0 / (x.abs() + 3.0 / x.abs())));
        return if x > 0.0 { 1.0 - tail } else { tail };
    }
    let (mut term, mut sum, mut k) = (x, x, 1.0);
    while term.abs() > 1e-17 * sum.abs() {
        k += 2.0;
        term *= x * x / k;
        sum += term;
    }
    0.5 + density * sum
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_medians_of_an_even_number_differ() {
        let values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!((median(&values), upper_median(&values)), (2.5, 3.0));
        assert_eq!((median(&values[..3]), upper_median(&values[..3])), (3.0, 3.0));
        assert!(median(&[]).is_nan() && upper_median(&[]).is_nan());
    }

    #[test]
    fn the_normal_distribution_has_its_tabulated_values() {
        // Abramowitz & Stegun, table 26.1, to the digits that are printed there.
        for (x, value) in [(0.0, 0.5), (1.0, 0.841_344_746_068_543), (3.0, 0.998_650_101_968_370)] {
            assert!((normal_cdf(x) - value).abs() < 1e-14 && (normal_cdf(-x) - 1.0 + value).abs() < 1e-14);
        }
        assert!((normal_cdf(-6.5) / 4.016_000_583_859e-11 - 1.0).abs() < 1e-3);
    }
}

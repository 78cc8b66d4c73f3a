//! Robust statistics: medians and the median absolute deviation.

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
}

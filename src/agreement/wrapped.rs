//! Counts that wrapped: differences of unsigned numbers below 0, which no detector measures.

use ndarray::{ArrayView3, Axis};

/// The largest count of 16 bits without a sign.
const LARGEST_U16: f64 = 65_535.0;
/// Counts from either end of these 16 bits within which pixels without light are after a
/// subtraction of equal levels: 50 standard deviations of a read noise of 40 counts.
const NEAR: f64 = 2_000.0;
/// Least part of the pixels at the edge that is near each end: noise about 0 puts half of them
/// there.
const LEAST_PART: f64 = 0.1;

/// Why `counts` `[image, y, x]` are refused: differences of unsigned 16-bit counts below 0 became
/// large.
pub(crate) fn wrapped(counts: ArrayView3<f64>) -> Option<String> {
    let (rows, columns) = (counts.len_of(Axis(1)), counts.len_of(Axis(2)));
    let is_edge = |y: usize, x: usize| y < 2 || x < 2 || y + 2 >= rows || x + 2 >= columns;
    let (mut all, mut low, mut high) = (0, 0, 0);
    for ((_, y, x), &count) in counts.indexed_iter() {
        if count.is_finite() && (count.fract() != 0.0 || !(0.0..=LARGEST_U16).contains(&count)) {
            return None;
        }
        if is_edge(y, x) && count.is_finite() {
            all += 1;
            low += usize::from(count < NEAR);
            high += usize::from(count > LARGEST_U16 - NEAR);
        }
    }
    let part = |of: usize| of as f64 / f64::from(all.max(1));
    (part(low).min(part(high)) > LEAST_PART).then(|| {
        format!(
            "{:.0} % of the pixels at the edge have counts near {LARGEST_U16}, and {:.0} % near 0: a subtraction of unsigned 16-bit counts wrapped \
             below 0; counts that were subtracted as signed or as floating-point numbers are needed",
            100.0 * part(high),
            100.0 * part(low)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    /// Counts from `level` to 12 above it, in no order.
    fn frame(level: f64) -> Array3<f64> {
        let mixed = |at: usize| (at * at * 7919 + at * 104_729) / 31;
        Array3::from_shape_fn((2, 24, 30), |(i, y, x)| level + (mixed(720 * i + 30 * y + x) % 13) as f64)
    }

    #[test]
    fn counts_that_wrapped_are_refused() {
        let noise = frame(0.0) - 6.0;
        let wrap = |counts: &Array3<f64>| counts.mapv(|count| count.rem_euclid(65_536.0));
        assert!(wrapped(wrap(&noise).view()).unwrap().contains("wrapped"));
        assert!(wrapped(noise.view()).is_none() && wrapped(frame(500.0).view()).is_none());
        assert!(wrapped((wrap(&noise) + 0.5).view()).is_none());
    }
}

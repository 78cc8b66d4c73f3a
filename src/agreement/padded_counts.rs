//! Counts of fewer bits than their numbers: a camera of 12 or 14 bits whose driver fills the low
//! bits with zeros, so that all counts are multiples of 16 or 4. A gain may be that of the counts
//! before, as many drivers state it, or that of the numbers in the file.

use crate::statistics::{NORMAL_MEDIAN_DEVIATION, median};
use ndarray::{ArrayView2, ArrayView3};

/// Bits that are looked for: one alone may be a sum of two equal reads, and 256 is a picture of 8
/// bits.
const BITS: std::ops::RangeInclusive<u32> = 2..=8;

/// Counts that are all multiples of one power of two.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct PaddedCounts {
    /// The power of two.
    factor: f64,
    /// Noise of the pixels at the edge, with the gain that was given, electrons RMS.
    edge_noise_e: f64,
    /// Read noise that was stated, electrons RMS.
    read_noise_e: Option<f64>,
    /// Whether the noise at the edge is that of a gain that is smaller by the factor.
    pub(crate) contradicts: bool,
}

/// The factor of which all finite pixels of `counts` `[image, y, x]` are multiples, if there is
/// one, with what their noise says of `gain`.
pub(crate) fn found(counts: ArrayView3<f64>, gain: f64, read_noise_e: Option<f64>) -> Option<PaddedCounts> {
    let mut lowest = u32::MAX;
    for value in counts.iter().copied().filter(|value| value.is_finite() && *value != 0.0) {
        // 2^53: beyond, every number is a multiple.
        if value.fract() != 0.0 || value.abs() > 9_007_199_254_740_992.0 {
            return None;
        }
        lowest = lowest.min((value.abs() as u64).trailing_zeros());
        if lowest < *BITS.start() {
            return None;
        }
    }
    BITS.contains(&lowest).then(|| {
        let factor = f64::from(1u32 << lowest);
        let edge_noise_e = gain * counts.outer_iter().map(edge_noise).fold(0.0, f64::max);
        let stated = read_noise_e.filter(|noise_e| *noise_e > 0.0);
        // Half of the factor: the noise is then nearer to that of the smaller gain, by the ratio.
        let contradicts = stated.is_some_and(|noise_e| edge_noise_e / noise_e > 0.5 * factor);
        PaddedCounts { factor, edge_noise_e, read_noise_e: stated, contradicts }
    })
}

/// Noise of the pixels in the first and last rows, counts RMS: from differences of neighbours,
/// which a slope does not change.
fn edge_noise(image: ArrayView2<f64>) -> f64 {
    let rows = image.nrows();
    let edges = image.outer_iter().enumerate().filter(|(row, _)| *row < 2 || row + 2 >= rows).map(|(_, row)| row);
    let differences: Vec<f64> = edges
        .flat_map(|row| row.iter().zip(row.iter().skip(1)).map(|(a, b)| (a - b).abs()).collect::<Vec<_>>())
        .filter(|difference| difference.is_finite())
        .collect();
    if differences.is_empty() { 0.0 } else { median(&differences) / NORMAL_MEDIAN_DEVIATION / 2f64.sqrt() }
}

impl PaddedCounts {
    fn beginning(&self) -> String {
        format!("all counts are multiples of {}", self.factor)
    }

    /// Why the gain from `source` is refused.
    pub(crate) fn refusal(&self, gain: f64, source: &str) -> String {
        format!(
            "{}: the gain of {gain} electrons per count ({source}) is that of the counts before they were multiplied, for the pixels at the \
             edge scatter by {:.0} electrons with it, where the read noise is {}; the gain is {} times smaller: image.gain_e_per_adu = {} in \
             the scene (estimate --gain) is needed, or {gain} where it is right",
            self.beginning(),
            self.edge_noise_e,
            self.read_noise_e.unwrap_or(0.0),
            self.factor,
            gain / self.factor
        )
    }

    /// What is to be known where the gain is used.
    pub(crate) fn remark(&self, gain: f64) -> String {
        format!(
            "{}, as of a camera of fewer bits: the gain of {gain} must be that of these counts, and is {} times smaller where it was stated \
             for the bits of the camera.",
            self.beginning().replacen('a', "A", 1),
            self.factor
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array3;

    #[test]
    fn counts_of_fewer_bits_are_found_with_their_factor() {
        // Noise of one count of 12 bits, by a linear congruential generator.
        let mut state = 1u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) % 5) as f64
        };
        let counts = Array3::from_shape_fn((1, 32, 32), |_| 100.0 + noise());
        assert_eq!(found(counts.view(), 60.0, Some(80.0)), None);
        let padded = &counts * 16.0;
        let wrong = found(padded.view(), 60.0, Some(80.0)).unwrap();
        assert!(wrong.contradicts && wrong.factor == 16.0, "{wrong:?}");
        let right = found(padded.view(), 3.75, Some(80.0)).unwrap();
        assert!(!right.contradicts && right.factor == 16.0, "{right:?}");
        assert!(!found(padded.view(), 60.0, None).unwrap().contradicts);
        for other in [&counts + 0.5, &counts * 2.0, Array3::zeros((1, 4, 4))] {
            assert_eq!(found(other.view(), 60.0, Some(80.0)), None);
        }
    }
}

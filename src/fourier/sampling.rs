//! Sizes of a transform: pupil samples, image pixels, and the sampling of the image.

use crate::{Error, Result};

/// Sizes of a transform: n×n samples to m×m pixels, `pixels_per_lambda_over_d` pixels per λ/(width
/// of the pupil grid).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sampling {
    /// Pupil samples a side (even).
    pub samples: usize,
    /// Image pixels a side (even).
    pub pixels: usize,
    /// Pixels per λ/(width of the pupil grid).
    pub pixels_per_lambda_over_d: f64,
}

impl Sampling {
    /// The sizes, checked.
    ///
    /// # Errors
    /// [`Error::Shape`] for odd or zero sizes: even sizes put the axis between samples and on a
    /// pixel, and let the transform fold; [`Error::Value`] for a sampling that is not positive.
    pub fn new(samples: usize, pixels: usize, pixels_per_lambda_over_d: f64) -> Result<Self> {
        for (what, size) in [("pupil samples", samples), ("image pixels", pixels)] {
            if size == 0 || size % 2 != 0 {
                return Err(Error::Shape(format!("{size} {what} a side cannot be used: an even number is needed")));
            }
        }
        if !(pixels_per_lambda_over_d.is_finite() && pixels_per_lambda_over_d > 0.0) {
            return Err(Error::Value(format!(
                "{pixels_per_lambda_over_d} pixels per lambda/D is impossible: a positive number is needed"
            )));
        }
        Ok(Self { samples, pixels, pixels_per_lambda_over_d })
    }

    /// Turns of phase per (pupil sample × pixel).
    pub fn step(&self) -> f64 {
        1.0 / (self.samples as f64 * self.pixels_per_lambda_over_d)
    }

    /// Samples along a side of the zero-padded grid whose FFT has this sampling. `None` unless that
    /// is an even integer not below the numbers of samples and pixels.
    pub fn padded(&self) -> Option<usize> {
        let exact = self.samples as f64 * self.pixels_per_lambda_over_d;
        let whole = exact.round();
        // 1e-9 of a sample over the whole grid is far below the rounding of a double-precision
        // transform.
        let fits = (exact - whole).abs() < 1e-9 && whole as usize >= self.samples.max(self.pixels);
        (fits && (whole as usize).is_multiple_of(2)).then_some(whole as usize)
    }
}

/// The smallest even number from `least` on whose prime factors are 2, 3 and 5: an efficient length
/// for an FFT.
pub fn fast_side(least: usize) -> usize {
    (least.max(2).next_multiple_of(2)..).step_by(2).find(|&n| is_product_of(n, &[2, 3, 5])).unwrap_or(least)
}

/// Whether all prime factors of `n` are among `primes`.
pub(super) fn is_product_of(mut n: usize, primes: &[usize]) -> bool {
    for &prime in primes {
        while n.is_multiple_of(prime) {
            n /= prime;
        }
    }
    n == 1
}

//! Difference between the two sides of an edge of the pyramid: the field of the frequencies above
//! the edge less that of those below, along one axis.
//!
//! With the edge at u = −m, in cycles over a grid of N samples, and frequencies up to Nyquist's,
//! N/2, the difference is a convolution
//!
//! ```text
//! S_m(n) = ∫_{−m}^{N/2} − ∫_{−N/2}^{−m} exp(2πi·u·n/N) du/N = (cos πn − exp(−2πi·m·n/N)) / (πi·n),   S_m(0) = 2m/N
//! ```
//!
//! of the pupil with itself left in the pupil: a linear convolution, which an FFT of twice the
//! length computes exactly. It equals the Hilbert transform of the pyramid's theory (Vérinaud 2004,
//! Opt. Commun. 233, 27), and a pyramid whose focal field is sampled infinitely finely.

use cophase_numerics::fft::{Fft, FftDirection, FftReal, plan_both};
use num_complex::{Complex32, Complex64};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Convolutions with the kernels of several offsets.
#[derive(Clone)]
pub(super) struct HalfPlanes {
    samples: usize,
    length: usize,
    forward: Arc<dyn Fft<f32>>,
    inverse: Arc<dyn Fft<f32>>,
    /// Transform of the kernel of each offset, over the length.
    spectra: Vec<Vec<Complex32>>,
    scratch: Vec<Complex32>,
    product: Vec<Complex32>,
}

/// Value of the kernel at a distance of `n` samples, of `samples` across the grid, for the offset
/// `m`.
pub(super) fn kernel(m: f64, n: i64, samples: usize) -> Complex64 {
    if n == 0 {
        return Complex64::new(2.0 * m / samples as f64, 0.0);
    }
    let parity = if n % 2 == 0 { 1.0 } else { -1.0 };
    let edge = Complex64::from_polar(1.0, -TAU * m * n as f64 / samples as f64);
    (parity - edge) / Complex64::new(0.0, PI * n as f64)
}

impl HalfPlanes {
    /// Kernels of `offsets` for lines of `samples` samples.
    pub(super) fn new(samples: usize, offsets: &[f64]) -> Self {
        let length = fast_length(2 * samples - 1);
        let double = f64::plan(length, FftDirection::Forward);
        let spectrum = |&m: &f64| {
            let mut line = vec![Complex64::ZERO; length];
            for n in 1 - samples as i64..samples as i64 {
                line[n.rem_euclid(length as i64) as usize] = kernel(m, n, samples) / length as f64;
            }
            double.process(&mut line);
            line.iter().map(|z| Complex32::new(z.re as f32, z.im as f32)).collect()
        };
        let spectra = offsets.iter().map(spectrum).collect();
        let (forward, inverse) = plan_both(length);
        let scratch = forward.get_inplace_scratch_len().max(inverse.get_inplace_scratch_len());
        Self {
            samples,
            length,
            forward,
            inverse,
            spectra,
            scratch: vec![Complex32::ZERO; scratch],
            product: vec![Complex32::ZERO; length],
        }
    }

    /// Length of a transformed line.
    pub(super) fn length(&self) -> usize {
        self.length
    }

    /// Operations of a transform: 5 n log₂ n.
    pub(super) fn transform_operations(&self) -> f64 {
        5.0 * self.length as f64 * (self.length as f64).log2()
    }

    /// Transforms a line to `spectrum`.
    pub(super) fn transform(&mut self, line: impl Iterator<Item = Complex32>, spectrum: &mut [Complex32]) {
        spectrum.fill(Complex32::ZERO);
        spectrum[..self.samples].iter_mut().zip(line).for_each(|(out, value)| *out = value);
        self.forward.process_with_scratch(spectrum, &mut self.scratch);
    }

    /// Convolution of the line with this `spectrum` and the kernel of offset number `offset`.
    pub(super) fn convolve(&mut self, spectrum: &[Complex32], offset: usize) -> &[Complex32] {
        for ((out, line), kernel) in self.product.iter_mut().zip(spectrum).zip(&self.spectra[offset]) {
            *out = line * kernel;
        }
        self.inverse.process_with_scratch(&mut self.product, &mut self.scratch);
        &self.product[..self.samples]
    }
}

/// Least length from `least` on without prime factors above 5.
fn fast_length(least: usize) -> usize {
    let is_fast = |&length: &usize| {
        let mut rest = length;
        for factor in [2, 3, 5] {
            while rest.is_multiple_of(factor) {
                rest /= factor;
            }
        }
        rest == 1
    };
    (least..).find(is_fast).unwrap_or(least)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_convolution_is_the_sum_over_the_kernel() {
        let (n, offsets) = (30, [0.0, 1.3, -2.7]);
        let mut planes = HalfPlanes::new(n, &offsets);
        let [re, im] = [0.37, 1.1].map(|step| (0..n).map(|i| (step * i as f32).sin()).collect::<Vec<_>>());
        let mut spectrum = vec![Complex32::ZERO; planes.length()];
        planes.transform(re.iter().zip(&im).map(|(&re, &im)| Complex32::new(re, im)), &mut spectrum);
        for (number, &m) in offsets.iter().enumerate() {
            for (x, found) in planes.convolve(&spectrum, number).iter().enumerate() {
                let terms = (0..n)
                    .map(|s| kernel(m, x as i64 - s as i64, n) * Complex64::new(f64::from(re[s]), f64::from(im[s])));
                let expected: Complex64 = terms.sum();
                let off = (expected.re - f64::from(found.re)).hypot(expected.im - f64::from(found.im));
                // Transforms of 60 points in single precision, of numbers of order 1.
                assert!(off < 3e-6, "{m} {x}: {found} {expected}");
            }
        }
    }

    #[test]
    fn an_edge_divides_waves_by_the_sign_of_their_frequency() {
        // In the middle of a long line, a wave of 9 cycles beyond the edge passes with the sign of
        // its side.
        let n = 600;
        for (m, cycles, sign) in [(0.0, 9.0, 1.0), (0.0, -9.0, -1.0), (20.0, -11.0, 1.0), (20.0, -29.0, -1.0)] {
            let wave = |x: usize| Complex64::from_polar(1.0, TAU * cycles * x as f64 / n as f64);
            let found: Complex64 = (0..n).map(|s| kernel(m, n as i64 / 2 - s as i64, n) * wave(s)).sum();
            let ratio = found / wave(n / 2);
            // The kernel's tail beyond the line leaves 1/(π·2π·9/2) of the wave.
            assert!((ratio - sign).norm() < 0.04, "{m} {cycles}: {ratio}");
        }
    }
}

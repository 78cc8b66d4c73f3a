//! Discrete Hartley transform of a real square array: real, orthogonal, its own inverse and its own
//! adjoint.
//!
//! `H[l][k] = 1/N·Σ_yx h[y][x]·cas(2π(kx + ly)/N)`, cas θ = cos θ + sin θ. With F the DFT of the
//! same array it is (Re F − Im F)/N. A filter that is real and even in frequency is diagonal in
//! this basis: white noise, multiplied with one factor per frequency, transforms into a field with
//! that power spectrum. There are no pairs of conjugate coefficients as in a DFT, and memory and
//! time are half of a complex transform's.

use super::real::Real;
use cophase_numerics::fft::{Fft, FftDirection};
use num_complex::Complex;
use std::sync::Arc;

/// The transform of N×N numbers. Plans are shared by all threads; each thread has its own scratch
/// memory, from [`HartleyTransform::scratch`].
#[derive(Clone)]
pub struct HartleyTransform<T: Real> {
    side: usize,
    fft: Arc<dyn Fft<T>>,
}

impl<T: Real> HartleyTransform<T> {
    /// The transform of `side`×`side` numbers.
    ///
    /// # Errors
    /// [`crate::Error::Shape`] for a side that is odd or zero: rows are transformed in pairs.
    pub fn new(side: usize) -> crate::Result<Self> {
        if side == 0 || !side.is_multiple_of(2) {
            return Err(crate::Error::Shape(format!(
                "a Hartley transform of {side} numbers a side is impossible: an even number is needed"
            )));
        }
        Ok(Self { side, fft: T::plan(side, FftDirection::Forward) })
    }

    /// Numbers along a side.
    pub fn side(&self) -> usize {
        self.side
    }

    /// Memory for one thread.
    pub fn scratch(&self) -> Vec<Complex<T>> {
        let n = self.side;
        vec![Complex::default(); n + n * (n / 2 + 1) + self.fft.get_inplace_scratch_len()]
    }

    /// The transform of `from` (`[y][x]`) into `to`, **transposed** (`[k][l]`, k the frequency
    /// along x). That saves a pass over the memory; a second application restores `from` in its
    /// original orientation. Rows outside `rows` must be zero, and are not read.
    ///
    /// # Panics
    /// If an array has another size.
    pub fn transform(&self, from: &[T], rows: std::ops::Range<usize>, to: &mut [T], scratch: &mut [Complex<T>]) {
        let n = self.side;
        assert_eq!((from.len(), to.len()), (n * n, n * n), "a square of this side");
        let (line, rest) = scratch.split_at_mut(n);
        let (columns, scratch) = rest.split_at_mut(n * (n / 2 + 1));
        columns.fill(Complex::default());
        for pair in rows.start / 2..rows.end.div_ceil(2) {
            // Two real rows as one complex: F of the first is the conjugate-even part, i·F of the
            // second the odd one.
            let (first, second) = from[2 * pair * n..][..2 * n].split_at(n);
            for ((line, &re), &im) in line.iter_mut().zip(first).zip(second) {
                *line = Complex::new(re, im);
            }
            self.fft.process_with_scratch(line, scratch);
            let half = T::narrow(0.5);
            for k in 0..=n / 2 {
                let (a, b) = (line[k], line[(n - k) % n]);
                columns[k * n + 2 * pair] = Complex::new((a.re + b.re) * half, (a.im - b.im) * half);
                columns[k * n + 2 * pair + 1] = Complex::new((a.im + b.im) * half, (b.re - a.re) * half);
            }
        }
        self.fft.process_with_scratch(columns, scratch);
        let scale = T::narrow(1.0 / n as f64);
        for (k, column) in columns.chunks_exact(n).enumerate() {
            for (to, value) in to[k * n..][..n].iter_mut().zip(column) {
                *to = (value.re - value.im) * scale;
            }
            if k == 0 || 2 * k == n {
                continue;
            }
            // F(−k, −l) = F*(k, l).
            let (zero, others) = to[(n - k) * n..][..n].split_at_mut(1);
            zero[0] = (column[0].re + column[0].im) * scale;
            for (to, value) in others.iter_mut().rev().zip(&column[1..]) {
                *to = (value.re + value.im) * scale;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn numbers(n: usize) -> Vec<f64> {
        (0..n * n).map(|i| (i as f64 * 1.7).sin() + 0.2 * (i as f64 * 0.013).cos()).collect()
    }

    #[test]
    fn the_transform_is_the_sum_that_defines_it() {
        let n = 6;
        let transform = HartleyTransform::<f64>::new(n).unwrap();
        let (from, mut to) = (numbers(n), vec![f64::NAN; n * n]);
        transform.transform(&from, 0..n, &mut to, &mut transform.scratch());
        for (k, l) in (0..n).flat_map(|k| (0..n).map(move |l| (k, l))) {
            let term = |(i, h): (usize, &f64)| {
                let angle = TAU * (k * (i % n) + l * (i / n)) as f64 / n as f64;
                h * (angle.cos() + angle.sin())
            };
            let sum = from.iter().enumerate().map(term).sum::<f64>() / n as f64;
            // Sums of 36 numbers of order 1: 1e-14 is some fifty roundings.
            assert!((to[k * n + l] - sum).abs() < 1e-14, "[{k}][{l}]: {} {sum}", to[k * n + l]);
        }
    }

    #[test]
    fn twice_is_the_identity_and_rows_of_zeros_need_not_be_read() {
        fn worst<T: Real>(n: usize, rows: std::ops::Range<usize>) -> f64 {
            let transform = HartleyTransform::<T>::new(n).unwrap();
            let inside = |i: usize| rows.contains(&(i / n));
            let full = numbers(n);
            let wanted: Vec<f64> = (0..n * n).map(|i| if inside(i) { full[i] } else { 0.0 }).collect();
            let from: Vec<T> = wanted.iter().map(|&v| T::narrow(v)).collect();
            let (mut there, mut back) = (vec![T::nan(); n * n], vec![T::nan(); n * n]);
            let mut scratch = transform.scratch();
            scratch.fill(Complex::new(T::nan(), T::nan()));
            transform.transform(&from, rows, &mut there, &mut scratch);
            transform.transform(&there, 0..n, &mut back, &mut scratch);
            back.iter().zip(&wanted).map(|(b, w)| (b.widen() - w).abs()).fold(0.0, f64::max)
        }
        // Two orthogonal transforms of numbers of order 1, log₂(60²) = 12 levels each, a rounding
        // or two a level.
        assert!(worst::<f64>(60, 7..41) < 30.0 * f64::EPSILON);
        assert!(worst::<f32>(60, 7..41) < 30.0 * f64::from(f32::EPSILON));
        assert!(worst::<f64>(60, 0..60) < 30.0 * f64::EPSILON);
    }

    #[test]
    fn an_odd_side_is_refused() {
        assert!(HartleyTransform::<f64>::new(5).err().unwrap().to_string().contains("5 numbers"));
    }
}

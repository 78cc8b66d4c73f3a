//! From the pupil to the focal plane and back.
//!
//! With `step` turns per (pupil sample × pixel), n samples and m pixels a side, the forward transform is
//!
//! `U[v][u] = Σ_yx E[y][x] · exp(−2πi·step·((x − (n−1)/2)(u − m/2) + (y − (n−1)/2)(v − m/2)))`
//!
//! and its adjoint has the opposite sign in the exponent. [`definition`] is that sum, slow and plain: the judge of the
//! two fast ones, [`MatrixTransform`] and [`FftTransform`].
//!
//! **Layout.** Complex arrays are *row-planar*: each row is its real parts followed by its imaginary parts
//! (`[row][re, im][col]`). So one real matrix product serves both parts, along either axis, without a transposition.

pub mod definition;
mod fft;
mod hartley;
mod matrix;
mod product;

pub use fft::FftTransform;
pub use hartley::Hartley;
pub use matrix::MatrixTransform;
pub(crate) use product::panel_len;
pub use product::{Factors, Product};

use crate::{Error, Result};

/// The floating-point types that the chains run in.
pub trait Real:
    Product + num_traits::Float + num_traits::FloatConst + num_traits::NumAssign + rustfft::FftNum + Default
{
    /// `value` in this precision.
    fn of(value: f64) -> Self;
    /// This value in double precision.
    fn wide(self) -> f64;
}

impl Real for f32 {
    fn of(value: f64) -> Self {
        value as f32
    }
    fn wide(self) -> f64 {
        f64::from(self)
    }
}

impl Real for f64 {
    fn of(value: f64) -> Self {
        value
    }
    fn wide(self) -> f64 {
        self
    }
}

/// The smallest even number from `least` on without a prime factor beyond 5: what an FFT is fast at.
pub fn fast_side(least: usize) -> usize {
    (least.max(2).next_multiple_of(2)..).step_by(2).find(|&n| is_smooth(n, &[2, 3, 5])).unwrap_or(least)
}

/// Whether `n` is a product of `primes`.
fn is_smooth(mut n: usize, primes: &[usize]) -> bool {
    for &prime in primes {
        while n.is_multiple_of(prime) {
            n /= prime;
        }
    }
    n == 1
}

/// Shapes of a transform: n×n samples to m×m pixels, `pixels_per_lambda_over_d` pixels per λ over the grid's width.
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
    /// Checked shapes.
    ///
    /// # Errors
    /// [`Error::Shape`] for odd or zero sizes: even sizes put the axis between samples and on a pixel, and let the
    /// transform fold; [`Error::Value`] for a sampling that is not positive.
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

    /// Samples of the zero-padded grid whose FFT has this sampling, where that is a whole even number that holds both
    /// the pupil and the image.
    pub fn padded(&self) -> Option<usize> {
        let exact = self.samples as f64 * self.pixels_per_lambda_over_d;
        let whole = exact.round();
        // 1e-9 of a sample over the whole grid is far below the rounding of a double-precision transform.
        let fits = (exact - whole).abs() < 1e-9 && whole as usize >= self.samples.max(self.pixels);
        (fits && (whole as usize).is_multiple_of(2)).then_some(whole as usize)
    }
}

/// A transform with its adjoint, and the memory that one thread needs to run it.
#[derive(Clone)]
pub enum Transform<T: Real> {
    /// Folded matrix products: any sampling, cheap for crops.
    Matrix(MatrixTransform<T>),
    /// Zero-padded FFT: cheap for large images on a full grid.
    Fft(FftTransform<T>),
}

/// Scratch memory of one thread for one [`Transform`].
pub struct Workspace<T: Real> {
    pub(crate) real: Vec<T>,
    pub(crate) complex: Vec<num_complex::Complex<T>>,
}

/// Time of an operation of the FFT over that of a multiply-add of the matrix product. `cargo bench --bench transform`, on
/// an AVX-512 processor, forward and adjoint, (n, m), f32 / f64: 5.3 at (120, 112), 5.3 / 4.5 at (144, 152), 7.5 / 6.5 at
/// (120, 240), 6.0 at (240, 240), 9.7 at (240, 480). Where the two are within a third of each other the choice hardly matters.
const FFT_OPERATION: f64 = 6.5;
/// The same for a length with a prime factor beyond 7, for which Rader's algorithm goes through a convolution: 11.2 / 7.4 at
/// (144, 152) in 272 = 2⁴·17, 19 / 14 at (180, 208) in 344 = 2³·43.
const FFT_OPERATION_ROUGH: f64 = 13.0;

impl<T: Real> Transform<T> {
    /// The cheaper of the two for `sampling`, by their operations: `2mn(n+m)` multiply-adds a pass for the matrices,
    /// `5·N·log₂N` for each of the n + m lines of the FFT, each of which takes `FFT_OPERATION` times as long.
    pub fn choose(sampling: Sampling) -> Self {
        let (n, m) = (sampling.samples as f64, sampling.pixels as f64);
        match sampling.padded() {
            Some(padded) => {
                let length = padded as f64;
                let operation = if is_smooth(padded, &[2, 3, 5, 7]) { FFT_OPERATION } else { FFT_OPERATION_ROUGH };
                let fft = operation * 5.0 * length * length.log2() * (n + m);
                let matrix = 2.0 * n * m * (n + m);
                if fft < matrix { Self::Fft(FftTransform::new(sampling, padded)) } else { Self::matrix(sampling) }
            }
            None => Self::matrix(sampling),
        }
    }

    /// The matrix route.
    pub fn matrix(sampling: Sampling) -> Self {
        Self::Matrix(MatrixTransform::new(sampling))
    }

    /// The FFT route, where the sampling allows it (see [`Sampling::padded`]).
    pub fn fft(sampling: Sampling) -> Option<Self> {
        Some(Self::Fft(FftTransform::new(sampling, sampling.padded()?)))
    }

    /// Memory for one thread.
    pub fn workspace(&self) -> Workspace<T> {
        match self {
            Self::Matrix(transform) => transform.workspace(),
            Self::Fft(transform) => transform.workspace(),
        }
    }

    /// Pupil (row-planar n×n) to focus (row-planar m×m). The FFT route differs by a phase per pixel, which no
    /// intensity sees and which the adjoint undoes.
    #[inline(always)]
    pub fn forward(&self, pupil: &[T], focus: &mut [T], workspace: &mut Workspace<T>) {
        match self {
            Self::Matrix(transform) => transform.forward(pupil, focus, workspace),
            Self::Fft(transform) => transform.forward(pupil, focus, workspace),
        }
    }

    /// Focus (row-planar m×m) to pupil (row-planar n×n).
    #[inline(always)]
    pub fn adjoint(&self, focus: &[T], pupil: &mut [T], workspace: &mut Workspace<T>) {
        match self {
            Self::Matrix(transform) => transform.adjoint(focus, pupil, workspace),
            Self::Fft(transform) => transform.adjoint(focus, pupil, workspace),
        }
    }
}

#[cfg(test)]
mod tests;

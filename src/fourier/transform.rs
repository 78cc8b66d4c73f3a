//! The fast transform of one sampling: folded matrix products or a zero-padded FFT, and the choice
//! between them.

use super::fft::FftTransform;
use super::matrix::MatrixTransform;
use super::real::Real;
use super::sampling::{Sampling, is_product_of};
use super::workspace::Workspace;

/// A transform with its adjoint, by one of two algorithms.
#[derive(Clone)]
pub enum Transform<T: Real> {
    /// Folded matrix products: for any sampling, and cheaper for small images.
    Matrix(MatrixTransform<T>),
    /// Zero-padded FFT: cheaper for large images, where the sampling allows it.
    Fft(FftTransform<T>),
}

/// Time of an operation of the FFT relative to a multiply-add of the matrix product. Measured with
/// `cargo bench --bench transform` on an AVX-512 processor, forward and adjoint, (n, m), f32 / f64:
/// 5.3 at (120, 112), 5.3 / 4.5 at (144, 152), 7.5 / 6.5 at (120, 240), 6.0 at (240, 240), 9.7 at
/// (240, 480). Within a factor of 1.3 the choice makes little difference.
const FFT_OPERATION: f64 = 6.5;
/// The same for a length with a prime factor above 7, which Rader's algorithm turns into a
/// convolution: 11.2 / 7.4 at (144, 152) in 272 = 2⁴·17, 19 / 14 at (180, 208) in 344 = 2³·43.
const FFT_OPERATION_ROUGH: f64 = 13.0;

impl<T: Real> Transform<T> {
    /// The cheaper algorithm for `sampling`, by counting operations: `2mn(n+m)` multiply-adds for
    /// the matrix products, and `5·N·log₂N` operations for each of the n + m lines of the FFT,
    /// weighted with `FFT_OPERATION`.
    pub fn choose(sampling: Sampling) -> Self {
        let (n, m) = (sampling.samples as f64, sampling.pixels as f64);
        match sampling.padded() {
            Some(padded) => {
                let length = padded as f64;
                let operation = if is_product_of(padded, &[2, 3, 5, 7]) { FFT_OPERATION } else { FFT_OPERATION_ROUGH };
                let fft = operation * 5.0 * length * length.log2() * (n + m);
                let matrix = 2.0 * n * m * (n + m);
                if fft < matrix { Self::Fft(FftTransform::new(sampling, padded)) } else { Self::matrix(sampling) }
            }
            None => Self::matrix(sampling),
        }
    }

    /// The folded matrix products.
    pub fn matrix(sampling: Sampling) -> Self {
        Self::Matrix(MatrixTransform::new(sampling))
    }

    /// The zero-padded FFT; `None` where the sampling does not allow it (see [`Sampling::padded`]).
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

    /// Pupil (row-planar n×n) to focus (row-planar m×m). The FFT differs by a phase per pixel, on
    /// which the intensity does not depend and which the adjoint removes.
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

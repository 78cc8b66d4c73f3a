//! The transform as a pruned zero-padded FFT (`rustfft`): only the n rows of the pupil are
//! transformed along x, and only the m columns of the image along y.
//!
//! The FFT counts samples and frequencies from 0, the definition from the axis: they differ by a
//! phase per pixel, `exp(2πi·step·(n−1)/2·(u + v))`. The intensity does not depend on it, and the
//! adjoint here is the exact adjoint of this forward transform.

use super::real::Real;
use super::sampling::Sampling;
use super::workspace::Workspace;
use cophase_numerics::fft::{Fft, plan_both};
use num_complex::Complex;
use std::sync::Arc;

/// Zero-padded FFT of one sampling. Plans are shared by all threads; each thread has its own
/// [`Workspace`].
#[derive(Clone)]
pub struct FftTransform<T: Real> {
    sampling: Sampling,
    padded: usize,
    forward: Arc<dyn Fft<T>>,
    inverse: Arc<dyn Fft<T>>,
}

impl<T: Real> FftTransform<T> {
    pub(super) fn new(sampling: Sampling, padded: usize) -> Self {
        let (forward, inverse) = plan_both(padded);
        Self { sampling, padded, forward, inverse }
    }

    fn scratch(&self) -> usize {
        self.forward.get_inplace_scratch_len().max(self.inverse.get_inplace_scratch_len())
    }

    pub(super) fn workspace(&self) -> Workspace<T> {
        let (n, m) = (self.sampling.samples, self.sampling.pixels);
        Workspace { real: Vec::new(), complex: vec![Complex::default(); m * n + self.padded + self.scratch()] }
    }

    /// Frequency index of pixel `u`.
    fn bin(&self, u: usize) -> usize {
        (u + self.padded - self.sampling.pixels / 2) % self.padded
    }

    pub(super) fn forward(&self, pupil: &[T], focus: &mut [T], workspace: &mut Workspace<T>) {
        let (n, m) = (self.sampling.samples, self.sampling.pixels);
        let (middle, rest) = workspace.complex.split_at_mut(m * n);
        let (line, scratch) = rest.split_at_mut(self.padded);
        for y in 0..n {
            let (re, im) = pupil[2 * n * y..][..2 * n].split_at(n);
            for x in 0..n {
                line[x] = Complex::new(re[x], im[x]);
            }
            line[n..].fill(Complex::default());
            self.forward.process_with_scratch(line, scratch);
            // Stored [u][y], so that the second pass reads along its lines.
            for u in 0..m {
                middle[u * n + y] = line[self.bin(u)];
            }
        }
        for u in 0..m {
            line[..n].copy_from_slice(&middle[u * n..][..n]);
            line[n..].fill(Complex::default());
            self.forward.process_with_scratch(line, scratch);
            for v in 0..m {
                let value = line[self.bin(v)];
                focus[2 * m * v + u] = value.re;
                focus[2 * m * v + m + u] = value.im;
            }
        }
    }

    pub(super) fn adjoint(&self, focus: &[T], pupil: &mut [T], workspace: &mut Workspace<T>) {
        let (n, m) = (self.sampling.samples, self.sampling.pixels);
        let (middle, rest) = workspace.complex.split_at_mut(m * n);
        let (line, scratch) = rest.split_at_mut(self.padded);
        for u in 0..m {
            line.fill(Complex::default());
            for v in 0..m {
                line[self.bin(v)] = Complex::new(focus[2 * m * v + u], focus[2 * m * v + m + u]);
            }
            self.inverse.process_with_scratch(line, scratch);
            middle[u * n..][..n].copy_from_slice(&line[..n]);
        }
        for y in 0..n {
            line.fill(Complex::default());
            for u in 0..m {
                line[self.bin(u)] = middle[u * n + y];
            }
            self.inverse.process_with_scratch(line, scratch);
            for x in 0..n {
                pupil[2 * n * y + x] = line[x].re;
                pupil[2 * n * y + n + x] = line[x].im;
            }
        }
    }
}

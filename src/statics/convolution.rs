//! Convolutions of maps over the illuminated samples, by FFT on a grid padded for every lag.
//!
//! A map fills the first half of the rows, so the other half is transformed neither forward nor
//! back, and the spectrum stays transposed, `[kx, ky]`, which saves two transpositions of four.

use crate::fourier::{fast_side, transpose};
use crate::retrieval::IlluminatedSamples;
use cophase_numerics::fft::{Fft, FftReal, plan_both};
use num_complex::Complex;
use std::sync::Arc;

/// Plans of the convolutions on the padded grid, of which maps fill the first rows.
#[derive(Clone)]
pub(super) struct Convolver<T> {
    pub(super) padded: usize,
    /// Rows with samples; the others are 0 before a convolution and unused after it.
    rows: usize,
    /// Index of each illuminated sample.
    indices: Vec<usize>,
    pub(super) forward: Arc<dyn Fft<T>>,
    pub(super) inverse: Arc<dyn Fft<T>>,
}

/// Buffers of a convolution.
pub(super) struct ConvolutionBuffers<T> {
    /// `[y, x]`, the rows with samples.
    field: Vec<Complex<T>>,
    /// `[x, y]`, the whole grid: input of the transform along y, and the spectrum.
    pub(super) transposed: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
}

impl<T: FftReal> Convolver<T> {
    pub(super) fn new(samples: &IlluminatedSamples) -> Self {
        // Lags of either sign, up to the grid's width, without wrapping.
        let padded = fast_side(2 * samples.samples);
        let (forward, inverse) = plan_both(padded);
        Self {
            padded,
            rows: samples.samples,
            indices: samples.indices.iter().map(|&i| i / samples.samples * padded + i % samples.samples).collect(),
            forward,
            inverse,
        }
    }

    pub(super) fn buffers(&self) -> ConvolutionBuffers<T> {
        let zero = Complex::new(T::zero(), T::zero());
        let scratch = self.forward.get_inplace_scratch_len().max(self.inverse.get_inplace_scratch_len());
        ConvolutionBuffers {
            field: vec![zero; self.rows * self.padded],
            transposed: vec![zero; self.padded * self.padded],
            scratch: vec![zero; scratch],
        }
    }

    /// Transforms a map to `buffers.transposed`, `[kx, ky]`, not normalised.
    pub(super) fn spectrum(&self, map: impl Iterator<Item = Complex<T>>, buffers: &mut ConvolutionBuffers<T>) {
        let zero = Complex::new(T::zero(), T::zero());
        buffers.field.fill(zero);
        self.indices.iter().zip(map).for_each(|(&index, value)| buffers.field[index] = value);
        self.forward.process_with_scratch(&mut buffers.field, &mut buffers.scratch);
        transpose(&buffers.field, self.padded, &mut buffers.transposed, self.padded, [self.rows, self.padded]);
        buffers.transposed.chunks_exact_mut(self.padded).for_each(|line| line[self.rows..].fill(zero));
        self.forward.process_with_scratch(&mut buffers.transposed, &mut buffers.scratch);
    }

    /// Multiplies the spectrum of a map by `gain`, `[kx, ky]`; returns the illuminated samples, not
    /// normalised.
    pub(super) fn filtered<'r>(
        &'r self,
        map: impl Iterator<Item = Complex<T>>,
        gain: &[T],
        buffers: &'r mut ConvolutionBuffers<T>,
    ) -> impl Iterator<Item = Complex<T>> + 'r {
        self.spectrum(map, buffers);
        buffers.transposed.iter_mut().zip(gain).for_each(|(value, &gain)| *value = value.scale(gain));
        self.inverse.process_with_scratch(&mut buffers.transposed, &mut buffers.scratch);
        transpose(&buffers.transposed, self.padded, &mut buffers.field, self.padded, [self.padded, self.rows]);
        self.inverse.process_with_scratch(&mut buffers.field, &mut buffers.scratch);
        self.indices.iter().map(|&index| buffers.field[index])
    }
}

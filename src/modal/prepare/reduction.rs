//! Reduction of a frame to the model's sampling.

use cophase_numerics::fft::{Fft, FftDirection, FftReal};
use ndarray::{Array2, ArrayView2};
use num_complex::Complex64;
use std::sync::Arc;

/// Low-passes and decimates frames by cropping their Fourier transforms. The sum of an image is
/// kept; a PSF whose spectrum ends below the new Nyquist frequency keeps its values at the new
/// pixels, and white noise stays white. Nothing is allocated after construction.
pub(super) struct Decimation {
    along_x: Line,
    along_y: Line,
    /// The frame reduced along x, `[x][y]`, so that the reduction along y reads contiguous lines.
    middle: Vec<Complex64>,
    /// `[y, x]`.
    reduced: Array2<f64>,
}

impl Decimation {
    /// From `frame` to `reduced` pixels, both along x and y, all even.
    pub(super) fn new(frame: [usize; 2], reduced: [usize; 2]) -> Self {
        Self {
            along_x: Line::new(frame[0], reduced[0]),
            along_y: Line::new(frame[1], reduced[1]),
            middle: vec![Complex64::default(); reduced[0] * frame[1]],
            reduced: Array2::zeros((reduced[1], reduced[0])),
        }
    }

    /// `data` (`[y, x]`) reduced.
    pub(super) fn run(&mut self, data: ArrayView2<f64>) -> &Array2<f64> {
        let rows = data.nrows();
        for (y, row) in data.rows().into_iter().enumerate() {
            let kept = self.along_x.reduce(row.iter().map(|&value| Complex64::from(value)));
            for (x, &value) in kept.iter().enumerate() {
                self.middle[x * rows + y] = value;
            }
        }
        let scale = 1.0 / self.reduced.len() as f64;
        for (line, mut column) in self.middle.chunks_exact(rows).zip(self.reduced.columns_mut()) {
            let kept = self.along_y.reduce(line.iter().copied());
            column.iter_mut().zip(kept).for_each(|(to, value)| *to = value.re * scale);
        }
        &self.reduced
    }
}

/// The reduction of one line.
struct Line {
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
    full: Vec<Complex64>,
    kept: Vec<Complex64>,
    scratch: Vec<Complex64>,
}

impl Line {
    fn new(from: usize, to: usize) -> Self {
        let (forward, inverse) = (f64::plan(from, FftDirection::Forward), f64::plan(to, FftDirection::Inverse));
        let scratch = forward.get_inplace_scratch_len().max(inverse.get_inplace_scratch_len());
        let zeros = |size| vec![Complex64::default(); size];
        Self { forward, inverse, full: zeros(from), kept: zeros(to), scratch: zeros(scratch) }
    }

    /// Transform, keep the low frequencies, transform back. Not normalised.
    fn reduce(&mut self, line: impl Iterator<Item = Complex64>) -> &[Complex64] {
        let (full, kept) = (&mut self.full, &mut self.kept);
        full.iter_mut().zip(line).for_each(|(to, value)| *to = value);
        self.forward.process_with_scratch(full, &mut self.scratch);
        let half = kept.len() / 2;
        kept[..half].copy_from_slice(&full[..half]);
        kept[half..].copy_from_slice(&full[full.len() - half..]);
        if kept.len() < full.len() {
            // The Nyquist frequency of the new grid is the mean of both signs.
            kept[half] = (kept[half] + full[half]) * 0.5;
        }
        self.inverse.process_with_scratch(kept, &mut self.scratch);
        kept
    }
}

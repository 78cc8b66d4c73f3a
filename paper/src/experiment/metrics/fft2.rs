//! Two-dimensional FFT with a transposed result; plans and work arrays are allocated once.

use cophase_numerics::fft::{Fft, FftDirection, FftReal};
use ndarray::{Array2, ArrayView2};
use num_complex::Complex64;
use std::sync::Arc;

/// Side of the tiles of the transposition: 8 × 8 complex numbers of 16 bytes are 8 cache lines read
/// and 8 written.
const TILE: usize = 8;

/// FFT of `rows × columns` arrays. The result is *transposed*, `[x][y]`: sums over it, and the
/// inverse transform with a plan of `columns × rows`, need no second transposition.
pub(super) struct Fft2 {
    rows: usize,
    columns: usize,
    along_x: Arc<dyn Fft<f64>>,
    along_y: Arc<dyn Fft<f64>>,
    transposed: Vec<Complex64>,
    scratch: Vec<Complex64>,
}

impl Fft2 {
    pub(super) fn new(rows: usize, columns: usize, direction: FftDirection) -> Self {
        let [along_x, along_y] = f64::plan_pair([columns, rows], direction);
        let scratch = along_x.get_inplace_scratch_len().max(along_y.get_inplace_scratch_len());
        let zeros = |length| vec![Complex64::default(); length];
        Self { rows, columns, along_x, along_y, transposed: zeros(rows * columns), scratch: zeros(scratch) }
    }

    /// Computes the transform, not normalised, of `field`, `[y][x]`, which is overwritten. Rows
    /// from `nonzero_rows` on contain zeros only and are not transformed along x.
    pub(super) fn process(&mut self, field: &mut [Complex64], nonzero_rows: usize) -> &mut [Complex64] {
        self.along_x.process_with_scratch(&mut field[..nonzero_rows * self.columns], &mut self.scratch);
        for y0 in (0..self.rows).step_by(TILE) {
            for x0 in (0..self.columns).step_by(TILE) {
                for x in x0..(x0 + TILE).min(self.columns) {
                    for y in y0..(y0 + TILE).min(self.rows) {
                        self.transposed[x * self.rows + y] = field[y * self.columns + x];
                    }
                }
            }
        }
        self.along_y.process_with_scratch(&mut self.transposed, &mut self.scratch);
        &mut self.transposed
    }
}

/// Computes the spectrum `[kx, ky]` of an image `[y, x]`, not normalised, frequency 0 first.
pub(super) fn spectrum(image: ArrayView2<f64>) -> Array2<Complex64> {
    let (rows, columns) = image.dim();
    let mut field: Vec<Complex64> = image.iter().map(|&value| value.into()).collect();
    let mut fft = Fft2::new(rows, columns, FftDirection::Forward);
    let transposed = fft.process(&mut field, rows);
    Array2::from_shape_fn((columns, rows), |(x, y)| transposed[x * rows + y])
}

/// Computes the image `[y, x]` of a spectrum `[kx, ky]`: the inverse of [`spectrum`].
pub(super) fn image(spectrum: ArrayView2<Complex64>) -> Array2<f64> {
    let (columns, rows) = spectrum.dim();
    let mut field: Vec<Complex64> = spectrum.iter().copied().collect();
    let mut fft = Fft2::new(columns, rows, FftDirection::Inverse);
    let transposed = fft.process(&mut field, columns);
    let scale = 1.0 / (rows * columns) as f64;
    Array2::from_shape_fn((rows, columns), |(y, x)| transposed[y * columns + x].re * scale)
}

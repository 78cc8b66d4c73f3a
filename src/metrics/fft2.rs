//! Two-dimensional FFT of one shape, paid for once and run dry.

use ndarray::{Array2, ArrayView2};
use num_complex::Complex64;
use rustfft::{Fft, FftDirection, FftPlanner};
use std::sync::Arc;

/// Side of the tiles in which an array is turned: 8 × 8 complex numbers of 16 bytes are 8 cache lines read and 8 written.
const TILE: usize = 8;

/// Transforms `rows × columns` arrays. The result is left *turned*, `[x][y]`: whoever sums over it, or transforms it
/// back with a plan of `columns × rows`, has no use for turning it again.
pub(super) struct Fft2 {
    rows: usize,
    columns: usize,
    along_x: Arc<dyn Fft<f64>>,
    along_y: Arc<dyn Fft<f64>>,
    turned: Vec<Complex64>,
    scratch: Vec<Complex64>,
}

impl Fft2 {
    pub(super) fn new(rows: usize, columns: usize, direction: FftDirection) -> Self {
        let mut planner = FftPlanner::new();
        let (along_x, along_y) = (planner.plan_fft(columns, direction), planner.plan_fft(rows, direction));
        let scratch = along_x.get_inplace_scratch_len().max(along_y.get_inplace_scratch_len());
        let zeros = |length| vec![Complex64::default(); length];
        Self { rows, columns, along_x, along_y, turned: zeros(rows * columns), scratch: zeros(scratch) }
    }

    /// The transform, not normalised, of `field`, `[y][x]`, which is overwritten; rows from `lit_rows` on hold zeros
    /// only, and are not transformed.
    pub(super) fn process(&mut self, field: &mut [Complex64], lit_rows: usize) -> &mut [Complex64] {
        self.along_x.process_with_scratch(&mut field[..lit_rows * self.columns], &mut self.scratch);
        for y0 in (0..self.rows).step_by(TILE) {
            for x0 in (0..self.columns).step_by(TILE) {
                for x in x0..(x0 + TILE).min(self.columns) {
                    for y in y0..(y0 + TILE).min(self.rows) {
                        self.turned[x * self.rows + y] = field[y * self.columns + x];
                    }
                }
            }
        }
        self.along_y.process_with_scratch(&mut self.turned, &mut self.scratch);
        &mut self.turned
    }
}

/// The spectrum `[kx, ky]` of an image `[y, x]`, not normalised, frequency 0 first.
pub(super) fn spectrum(image: ArrayView2<f64>) -> Array2<Complex64> {
    let (rows, columns) = image.dim();
    let mut field: Vec<Complex64> = image.iter().map(|&value| value.into()).collect();
    let mut fft = Fft2::new(rows, columns, FftDirection::Forward);
    let turned = fft.process(&mut field, rows);
    Array2::from_shape_fn((columns, rows), |(x, y)| turned[x * rows + y])
}

/// The image `[y, x]` of a spectrum as [`spectrum`] makes it.
pub(super) fn image(spectrum: ArrayView2<Complex64>) -> Array2<f64> {
    let (columns, rows) = spectrum.dim();
    let mut field: Vec<Complex64> = spectrum.iter().copied().collect();
    let mut fft = Fft2::new(columns, rows, FftDirection::Inverse);
    let turned = fft.process(&mut field, columns);
    let scale = 1.0 / (rows * columns) as f64;
    Array2::from_shape_fn((rows, columns), |(y, x)| turned[y * columns + x].re * scale)
}

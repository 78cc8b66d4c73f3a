//! Transform of a square of numbers along both axes.

use cophase_numerics::fft::Fft;
use num_complex::Complex64;

/// Transforms a square along both axes, in place, not normalised.
pub(crate) fn transform_square(field: &mut [Complex64], n: usize, fft: &dyn Fft<f64>) {
    let mut transposed = field.to_vec();
    fft.process(&mut transposed);
    transpose(&transposed, n, field, n, [n, n]);
    fft.process(field);
    transposed.copy_from_slice(field);
    transpose(&transposed, n, field, n, [n, n]);
}

/// Transposes: writes `from[y][x]` to `to[x][y]` for the first `[y, x]`, with rows of the two
/// strides.
pub(crate) fn transpose<T: Copy>(
    from: &[T],
    from_stride: usize,
    to: &mut [T],
    to_stride: usize,
    [rows, columns]: [usize; 2],
) {
    // Tiles that stay in the cache: 16 × 16 complex numbers are 4 kB.
    const TILE: usize = 16;
    for y0 in (0..rows).step_by(TILE) {
        for x0 in (0..columns).step_by(TILE) {
            for x in x0..(x0 + TILE).min(columns) {
                for y in y0..(y0 + TILE).min(rows) {
                    to[x * to_stride + y] = from[y * from_stride + x];
                }
            }
        }
    }
}

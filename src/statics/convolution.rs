//! Convolutions of maps over the lit samples, on a grid that leaves room for every lag.
//!
//! A map fills the first half of the rows: the other half is neither transformed on the way in nor on the way out, and the
//! spectrum stays turned, `[kx, ky]`, which saves two transpositions of four.

use crate::fourier::fast_side;
use crate::retrieval::LitSamples;
use num_complex::{Complex, Complex64};
use rustfft::{Fft, FftNum, FftPlanner};
use std::sync::Arc;

/// Transforms of maps over the lit samples on the padded grid, of which they fill the first rows.
#[derive(Clone)]
pub(super) struct Convolver<T> {
    pub(super) padded: usize,
    /// Rows that hold samples; the others are 0 before, and not asked for after.
    rows: usize,
    /// The place of each lit sample.
    places: Vec<usize>,
    pub(super) forward: Arc<dyn Fft<T>>,
    pub(super) inverse: Arc<dyn Fft<T>>,
}

/// Memory of a convolver.
pub(super) struct Room<T> {
    /// `[y, x]`, its rows with samples.
    field: Vec<Complex<T>>,
    /// `[x, y]`, all of it: what is transformed along y, and the spectrum.
    pub(super) turned: Vec<Complex<T>>,
    scratch: Vec<Complex<T>>,
}

impl<T: FftNum> Convolver<T> {
    pub(super) fn of(lit: &LitSamples) -> Self {
        // Lags of either sign, up to the grid's width, without wrapping.
        let padded = fast_side(2 * lit.samples);
        let mut planner = FftPlanner::new();
        Self {
            padded,
            rows: lit.samples,
            places: lit.places.iter().map(|&place| place / lit.samples * padded + place % lit.samples).collect(),
            forward: planner.plan_fft_forward(padded),
            inverse: planner.plan_fft_inverse(padded),
        }
    }

    pub(super) fn room(&self) -> Room<T> {
        let zero = Complex::new(T::zero(), T::zero());
        let scratch = self.forward.get_inplace_scratch_len().max(self.inverse.get_inplace_scratch_len());
        Room {
            field: vec![zero; self.rows * self.padded],
            turned: vec![zero; self.padded * self.padded],
            scratch: vec![zero; scratch],
        }
    }

    /// The transform of a map, `[kx, ky]` in `room.turned`, not normalised.
    pub(super) fn spectrum(&self, map: impl Iterator<Item = Complex<T>>, room: &mut Room<T>) {
        let zero = Complex::new(T::zero(), T::zero());
        room.field.fill(zero);
        self.places.iter().zip(map).for_each(|(&place, value)| room.field[place] = value);
        self.forward.process_with_scratch(&mut room.field, &mut room.scratch);
        turn(&room.field, self.padded, &mut room.turned, self.padded, [self.rows, self.padded]);
        room.turned.chunks_exact_mut(self.padded).for_each(|line| line[self.rows..].fill(zero));
        self.forward.process_with_scratch(&mut room.turned, &mut room.scratch);
    }

    /// A map whose spectrum is multiplied by `gain`, `[kx, ky]`, at the lit samples, not normalised.
    pub(super) fn filtered<'r>(
        &'r self,
        map: impl Iterator<Item = Complex<T>>,
        gain: &[T],
        room: &'r mut Room<T>,
    ) -> impl Iterator<Item = Complex<T>> + 'r {
        self.spectrum(map, room);
        room.turned.iter_mut().zip(gain).for_each(|(value, &gain)| *value = value.scale(gain));
        self.inverse.process_with_scratch(&mut room.turned, &mut room.scratch);
        turn(&room.turned, self.padded, &mut room.field, self.padded, [self.padded, self.rows]);
        self.inverse.process_with_scratch(&mut room.field, &mut room.scratch);
        self.places.iter().map(|&place| room.field[place])
    }
}

/// Along both axes of a square, in place, not normalised.
pub(super) fn transform(field: &mut [Complex64], n: usize, fft: &dyn Fft<f64>) {
    let mut turned = field.to_vec();
    fft.process(&mut turned);
    turn(&turned, n, field, n, [n, n]);
    fft.process(field);
    turned.copy_from_slice(field);
    turn(&turned, n, field, n, [n, n]);
}

/// Writes `from[y][x]` to `to[x][y]`, for the first `[y, x]` of them; rows of the two strides.
fn turn<T: Copy>(from: &[T], from_stride: usize, to: &mut [T], to_stride: usize, [rows, columns]: [usize; 2]) {
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

//! Complex field over a square grid, in rows of whole SIMD vectors.

use super::kernel::Vector;
use crate::ao::footprint::LANES;
use num_complex::Complex32;

/// Field `[row][column]`; columns beyond the samples of a row are 0.
#[derive(Clone)]
pub(super) struct Plane {
    samples: usize,
    vectors: usize,
    pub values: Vec<Vector>,
}

impl Plane {
    /// `rows` rows of `samples` samples, 0.
    pub(super) fn zeros(rows: usize, samples: usize) -> Self {
        let vectors = samples.div_ceil(LANES);
        Self { samples, vectors, values: vec![Vector::ZERO; rows * vectors] }
    }

    /// Vectors in a row.
    pub(super) fn vectors(&self) -> usize {
        self.vectors
    }

    pub(super) fn set(&mut self, row: usize, column: usize, value: Complex32) {
        let vector = &mut self.values[row * self.vectors + column / LANES];
        (vector.re[column % LANES], vector.im[column % LANES]) = (value.re, value.im);
    }

    /// Values of a row.
    pub(super) fn row(&self, row: usize) -> impl Iterator<Item = Complex32> {
        let vectors = &self.values[row * self.vectors..][..self.vectors];
        let lanes = vectors.iter().flat_map(|vector| vector.re.iter().zip(&vector.im));
        lanes.take(self.samples).map(|(&re, &im)| Complex32::new(re, im))
    }

    pub(super) fn set_row(&mut self, row: usize, values: &[Complex32]) {
        values.iter().enumerate().for_each(|(column, &value)| self.set(row, column, value));
    }
}

//! Products of parts of row-major matrices, on the calling thread.

use faer::linalg::matmul::matmul;
use faer::{Accum, MatMut, MatRef, Par};
use std::ops::Range;

/// Matrix, part of one or the transpose of one, in memory that is row-major.
#[derive(Clone, Copy)]
pub struct Matrix<'a>(MatRef<'a, f64>);

impl<'a> Matrix<'a> {
    /// Matrix whose rows follow each other in `values`.
    ///
    /// # Panics
    /// If `values` has another size.
    pub fn from_rows(values: &'a [f64], rows: usize, columns: usize) -> Self {
        Self(MatRef::from_row_major_slice(values, rows, columns))
    }

    /// Some rows and columns.
    ///
    /// # Panics
    /// If they are beyond the matrix.
    pub fn part(self, rows: Range<usize>, columns: Range<usize>) -> Self {
        Self(self.0.submatrix(rows.start, columns.start, rows.len(), columns.len()))
    }

    /// The transpose, of the same memory.
    pub fn transpose(self) -> Self {
        Self(self.0.transpose())
    }
}

/// Matrix, or part of one, that a product is written to.
pub struct MatrixMut<'a>(MatMut<'a, f64>);

impl<'a> MatrixMut<'a> {
    /// Matrix whose rows follow each other in `values`.
    ///
    /// # Panics
    /// If `values` has another size.
    pub fn from_rows(values: &'a mut [f64], rows: usize, columns: usize) -> Self {
        Self(MatMut::from_row_major_slice_mut(values, rows, columns))
    }

    /// The columns before and from `column` on.
    ///
    /// # Panics
    /// If `column` is beyond the matrix.
    pub fn split_at_column(self, column: usize) -> (Self, Self) {
        let (before, after) = self.0.split_at_col_mut(column);
        (Self(before), Self(after))
    }

    /// Replaces the matrix by `factor`·`a`·`b`.
    ///
    /// # Panics
    /// If the shapes do not fit.
    pub fn assign_product(&mut self, factor: f64, a: Matrix, b: Matrix) {
        matmul(self.0.as_mut(), Accum::Replace, a.0, b.0, factor, Par::Seq);
    }

    /// Adds `factor`·`a`·`b`.
    ///
    /// # Panics
    /// If the shapes do not fit.
    pub fn add_product(&mut self, factor: f64, a: Matrix, b: Matrix) {
        matmul(self.0.as_mut(), Accum::Add, a.0, b.0, factor, Par::Seq);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_of_parts_are_those_by_hand() {
        let values = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let matrix = Matrix::from_rows(&values, 2, 3);
        let part = matrix.part(0..2, 1..3);
        let mut out = [0.0; 6];
        let (mut left, mut right) = MatrixMut::from_rows(&mut out, 2, 3).split_at_column(2);
        // [2 3; 5 6]·[2 5; 3 6] = [13 28; 28 61], [2 3; 5 6]·[1 4]ᵀ = [14 29]ᵀ.
        left.assign_product(1.0, part, part.transpose());
        left.add_product(-2.0, part, part.transpose());
        let column = [1.0, 4.0];
        right.add_product(1.0, part, Matrix::from_rows(&column, 2, 1));
        assert_eq!(out, [-13.0, -28.0, 14.0, -28.0, -61.0, 29.0]);
    }
}

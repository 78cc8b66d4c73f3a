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

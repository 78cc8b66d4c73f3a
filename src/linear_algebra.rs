//! Inverse, determinant and factor of symmetric positive definite matrices, by Cholesky
//! decomposition; products of long rows on all cores.

use crate::{Error, Result};
use cophase_numerics::cholesky::Cholesky;
use cophase_numerics::product::{Matrix, MatrixMut};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};
use rayon::prelude::*;

/// Columns of a matrix that a thread combines at once.
const COLUMNS_AT_ONCE: usize = 4096;
/// Rows of a product in one task.
const STRIP: usize = 64;

/// Σ coefficient · row of a matrix with long rows, on all cores: the sum for a column is in the
/// order of the rows, on any number of threads.
pub(crate) fn combination(coefficients: ArrayView1<f64>, rows: ArrayView2<f64>) -> Array1<f64> {
    let mut sum = Array1::zeros(rows.ncols());
    sum.axis_chunks_iter_mut(Axis(0), COLUMNS_AT_ONCE)
        .into_par_iter()
        .zip(rows.axis_chunks_iter(Axis(1), COLUMNS_AT_ONCE).into_par_iter())
        .for_each(|(mut sum, rows)| {
            coefficients
                .iter()
                .zip(rows.outer_iter())
                .for_each(|(&coefficient, row)| sum.scaled_add(coefficient, &row));
        });
    sum
}

/// Scalar products of the rows of a matrix with a long vector, on all cores.
pub(crate) fn row_products(rows: ArrayView2<f64>, vector: ArrayView1<f64>) -> Array1<f64> {
    let products: Vec<f64> = rows.axis_iter(Axis(0)).into_par_iter().map(|row| row.dot(&vector)).collect();
    Array1::from(products)
}

/// Some rows and columns of a matrix.
pub(crate) fn sub_matrix(matrix: &Array2<f64>, rows: &[usize], columns: &[usize]) -> Array2<f64> {
    let mut part = Array2::zeros((rows.len(), columns.len()));
    for (mut to, &row) in part.outer_iter_mut().zip(rows) {
        let from = matrix.row(row);
        to.iter_mut().zip(columns).for_each(|(value, &column)| *value = from[column]);
    }
    part
}

/// a·bᵀ of two row-major matrices, strip by strip on all threads.
pub(crate) fn times_transposed(a: ArrayView2<f64>, b: ArrayView2<f64>) -> Array2<f64> {
    let (a, b) = (a.as_standard_layout(), b.as_standard_layout());
    let (rows, depth, columns) = (a.nrows(), a.ncols(), b.nrows());
    let mut product = Array2::zeros((rows, columns));
    if let (Some(a), Some(b), Some(out)) = (a.as_slice(), b.as_slice(), product.as_slice_mut())
        && columns * depth > 0
    {
        let b = Matrix::from_rows(b, columns, depth).transpose();
        out.par_chunks_mut(STRIP * columns).zip(a.par_chunks(STRIP * depth)).for_each(|(out, a)| {
            let count = out.len() / columns;
            let a = Matrix::from_rows(a, count, depth);
            MatrixMut::from_rows(out, count, columns).assign_product(1.0, a, b);
        });
    }
    product
}

/// Inverse of a symmetric positive definite matrix, and the logarithm of its determinant.
pub(crate) struct SpdInverse {
    pub(crate) inverse: Array2<f64>,
    pub(crate) log_determinant: f64,
}

impl SpdInverse {
    /// Of normal equations, some of whose unknowns (segments with next to no illuminated sample)
    /// may have no data: 1e-9 of the largest element of the diagonal is added to it, which changes
    /// well-determined unknowns by 1e-9 of themselves.
    ///
    /// # Errors
    /// As [`SpdInverse::new`].
    pub(crate) fn of_normal_equations(mut matrix: Array2<f64>) -> Result<Self> {
        let faint = 1e-9 * matrix.diag().iter().copied().fold(0.0, f64::max);
        matrix.diag_mut().iter_mut().for_each(|value| *value += faint);
        Self::new(&matrix)
    }

    /// From the lower triangle of `matrix`.
    ///
    /// # Errors
    /// [`Error::Internal`] for a matrix that is not positive definite.
    pub(crate) fn new(matrix: &Array2<f64>) -> Result<Self> {
        let size = matrix.nrows();
        let factor = Cholesky::new(matrix.view())
            .map_err(|failure| Error::Internal(format!("a {size}×{size} matrix is not positive: {failure}")))?;
        Ok(Self { inverse: factor.inverse(), log_determinant: factor.log_determinant() })
    }
}

/// Cholesky factor L of a symmetric positive definite matrix A = L·Lᵀ. A vector with covariance A
/// is white after L⁻¹.
pub(crate) struct CholeskyFactor {
    factor: Cholesky,
}

impl CholeskyFactor {
    /// From the lower triangle of `matrix`.
    ///
    /// # Errors
    /// [`Error::Value`] for a matrix that is not positive definite.
    pub(crate) fn new(matrix: &Array2<f64>) -> Result<Self> {
        let size = matrix.nrows();
        let factor = Cholesky::new(matrix.view())
            .map_err(|_| Error::Value(format!("a {size}×{size} matrix is not positive definite")))?;
        Ok(Self { factor })
    }

    /// Rows, and columns, of A.
    pub(crate) fn size(&self) -> usize {
        self.factor.size()
    }

    /// A⁻¹·`right`, `[size, columns]`.
    pub(crate) fn solution(&self, right: &Array2<f64>) -> Array2<f64> {
        self.factor.solve(right.view())
    }

    /// L⁻¹·`right`, `[size, columns]`, by forward substitution.
    pub(crate) fn whiten(&self, right: &Array2<f64>) -> Array2<f64> {
        self.factor.solve_lower(right.view())
    }

    /// L⁻¹·`right`.
    pub(crate) fn whiten_vector(&self, right: Array1<f64>) -> Array1<f64> {
        self.whiten(&right.insert_axis(Axis(1))).remove_axis(Axis(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_product_in_strips_is_the_product() {
        for (rows, depth, columns) in [(1, 1, 1), (129, 3, 200), (300, 17, 1), (2, 0, 3)] {
            let fill = |rows: usize, seed: f64| {
                Array2::from_shape_fn((rows, depth), |(i, j)| (seed * (i * 31 + j) as f64).sin())
            };
            let (a, b) = (fill(rows, 0.7), fill(columns, 1.3));
            let off = times_transposed(a.view(), b.view()) - a.dot(&b.t());
            // Sums of 17 terms below 1.
            assert!(off.iter().all(|v| v.abs() < 1e-14));
        }
    }
}

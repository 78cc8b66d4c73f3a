//! Inverse, determinant and factor of symmetric positive definite matrices, by Cholesky decomposition; scale of a matrix for the
//! eigenvalue solver; products of long rows on all cores.

use crate::{Error, Result};
use faer::linalg::solvers::{DenseSolveCore, Llt, Solve};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};
use rayon::prelude::*;

/// Power of two by which a matrix is multiplied before its eigenvalues are computed, so that its largest entry is between 1 and 2; 1 for
/// a matrix of zeros. It changes no digit of the entries.
///
/// The divide-and-conquer solver neglects couplings and differences of eigenvalues below 8 ε × max(largest eigenvalue, 1) (faer 0.24,
/// `tridiag_evd`; LAPACK's `dlaed2` has the same rule for a matrix that was scaled before). Without the scale a matrix of norm 10⁻⁶ has
/// eigenvalues with errors of 10⁻⁹ of the largest: too large for the threshold of null directions, some 10⁻¹⁰.
pub(crate) fn unit_scale(matrix: &Array2<f64>) -> f64 {
    let largest = matrix.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    if largest.is_normal() { 2f64.powi(-(largest.log2().floor().clamp(-1000.0, 1000.0) as i32)) } else { 1.0 }
}

/// Columns of a matrix that a thread combines at once.
const COLUMNS_AT_ONCE: usize = 4096;

/// Σ coefficient · row of a matrix with long rows, on all cores: the sum for a column is in the order of the rows, on any number of threads.
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

/// Inverse of a symmetric positive definite matrix, and the logarithm of its determinant.
pub(crate) struct SpdInverse {
    pub(crate) inverse: Array2<f64>,
    pub(crate) log_determinant: f64,
}

impl SpdInverse {
    /// Of normal equations, some of whose unknowns (segments with next to no illuminated sample) may have no data: 1e-9 of the largest element
    /// of the diagonal is added to it, which changes well-determined unknowns by 1e-9 of themselves.
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
        let llt = faer::Mat::from_fn(size, size, |i, j| matrix[[i, j]])
            .llt(faer::Side::Lower)
            .map_err(|failure| Error::Internal(format!("a {size}×{size} matrix is not positive: {failure:?}")))?;
        let log_determinant = (0..size).map(|i| 2.0 * llt.L()[(i, i)].ln()).sum();
        let inverse = llt.inverse();
        Ok(Self { inverse: Array2::from_shape_fn((size, size), |(i, j)| inverse[(i, j)]), log_determinant })
    }
}

/// Cholesky factor L of a symmetric positive definite matrix A = L·Lᵀ. A vector with covariance A is white after L⁻¹.
pub(crate) struct CholeskyFactor {
    factor: Llt<f64>,
}

impl CholeskyFactor {
    /// From the lower triangle of `matrix`.
    ///
    /// # Errors
    /// [`Error::Value`] for a matrix that is not positive definite.
    pub(crate) fn new(matrix: &Array2<f64>) -> Result<Self> {
        let size = matrix.nrows();
        let factor = faer::Mat::from_fn(size, size, |i, j| matrix[[i, j]])
            .llt(faer::Side::Lower)
            .map_err(|_| Error::Value(format!("a {size}×{size} matrix is not positive definite")))?;
        Ok(Self { factor })
    }

    /// Rows, and columns, of A.
    pub(crate) fn size(&self) -> usize {
        self.factor.L().nrows()
    }

    /// A⁻¹·`right`, `[size, columns]`.
    pub(crate) fn solution(&self, right: &Array2<f64>) -> Array2<f64> {
        let solved = self.factor.solve(faer::Mat::from_fn(right.nrows(), right.ncols(), |i, j| right[[i, j]]));
        Array2::from_shape_fn(right.dim(), |(i, j)| solved[(i, j)])
    }

    /// L⁻¹·`right`, `[size, columns]`, by forward substitution.
    pub(crate) fn whiten(&self, right: &Array2<f64>) -> Array2<f64> {
        let (rows, columns) = right.dim();
        let mut solved = faer::Mat::from_fn(rows, columns, |i, j| right[[i, j]]);
        solve_lower_triangular_in_place(self.factor.L(), solved.as_mut(), faer::Par::Seq);
        Array2::from_shape_fn((rows, columns), |(i, j)| solved[(i, j)])
    }

    /// L⁻¹·`right`.
    pub(crate) fn whiten_vector(&self, right: Array1<f64>) -> Array1<f64> {
        self.whiten(&right.insert_axis(Axis(1))).remove_axis(Axis(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn the_factor_whitens_its_own_covariance() {
        let matrix = array![[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];
        let factor = CholeskyFactor::new(&matrix).unwrap();
        let white = factor.whiten(&factor.whiten(&matrix).reversed_axes());
        // A dozen operations on numbers of order 1: some 1e-15.
        assert!((&white - &Array2::<f64>::eye(3)).iter().all(|off| off.abs() < 1e-14), "{white}");
        let right = array![[1.0, 0.0], [2.0, -1.0], [3.0, 0.5]];
        assert!((matrix.dot(&factor.solution(&right)) - &right).iter().all(|off| off.abs() < 1e-14));
        assert!(CholeskyFactor::new(&array![[1.0, 2.0], [2.0, 1.0]]).is_err());
    }
}

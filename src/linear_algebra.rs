//! Inverse and determinant of symmetric positive definite matrices, by Cholesky decomposition.

use crate::{Error, Result};
use faer::linalg::solvers::DenseSolveCore;
use ndarray::Array2;

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

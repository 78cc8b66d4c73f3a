//! Where the arrays meet the dense solver.

use crate::{Error, Result};
use faer::linalg::solvers::DenseSolveCore;
use ndarray::Array2;

/// The inverse of a symmetric positive matrix, and the logarithm of its determinant.
pub(crate) struct Spd {
    pub(crate) inverse: Array2<f64>,
    pub(crate) log_determinant: f64,
}

impl Spd {
    /// By Cholesky's decomposition of the lower triangle.
    ///
    /// # Errors
    /// [`Error::Internal`] for a matrix that is not positive.
    pub(crate) fn of(matrix: &Array2<f64>) -> Result<Self> {
        let size = matrix.nrows();
        let llt = faer::Mat::from_fn(size, size, |i, j| matrix[[i, j]])
            .llt(faer::Side::Lower)
            .map_err(|failure| Error::Internal(format!("a {size}×{size} matrix is not positive: {failure:?}")))?;
        let log_determinant = (0..size).map(|i| 2.0 * llt.L()[(i, i)].ln()).sum();
        let inverse = llt.inverse();
        Ok(Self { inverse: Array2::from_shape_fn((size, size), |(i, j)| inverse[(i, j)]), log_determinant })
    }
}

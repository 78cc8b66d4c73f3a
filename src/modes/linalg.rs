//! Interface to the dense eigenvalue solver.

use crate::linear_algebra::unit_scale;
use crate::{Error, Result};
use ndarray::{Array1, Array2};

/// Eigenvalues (ascending) and eigenvectors (columns) of a symmetric matrix, read from its lower triangle.
///
/// # Errors
/// [`Error::Value`] for a matrix that is not finite; [`Error::Internal`] where the iteration does not converge.
pub(crate) fn symmetric_eigen(matrix: &Array2<f64>) -> Result<(Array1<f64>, Array2<f64>)> {
    if matrix.iter().any(|value| !value.is_finite()) {
        return Err(Error::Value(
            "a matrix has an entry that is not finite: its eigenvalues cannot be computed".into(),
        ));
    }
    let size = matrix.nrows();
    if size == 0 {
        // The solver does not accept an empty matrix.
        return Ok((Array1::zeros(0), Array2::zeros((0, 0))));
    }
    let scale = unit_scale(matrix);
    let eigen = faer::Mat::from_fn(size, size, |i, j| matrix[[i, j]] * scale)
        .self_adjoint_eigen(faer::Side::Lower)
        .map_err(|failure| Error::Internal(format!("eigenvalues of a {size}×{size} matrix: {failure:?}")))?;
    let values = (0..size).map(|i| eigen.S().column_vector()[i] / scale).collect();
    Ok((values, Array2::from_shape_fn((size, size), |(i, j)| eigen.U()[(i, j)])))
}

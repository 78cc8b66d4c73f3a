//! Interface to the dense eigenvalue solver.

use crate::{Error, Result};
use cophase_numerics::decompositions::{self, unit_scale};
use ndarray::{Array1, Array2};

/// Eigenvalues (ascending) and eigenvectors (columns) of a symmetric matrix, read from its lower
/// triangle.
///
/// # Errors
/// [`Error::Value`] for a matrix that is not finite; [`Error::Internal`] where the iteration does
/// not converge.
pub(crate) fn symmetric_eigen(matrix: &Array2<f64>) -> Result<(Array1<f64>, Array2<f64>)> {
    if matrix.iter().any(|value| !value.is_finite()) {
        return Err(Error::Value(
            "a matrix has an entry that is not finite: its eigenvalues cannot be computed".into(),
        ));
    }
    let size = matrix.nrows();
    let eigen = decompositions::symmetric_eigen(matrix.view(), unit_scale(matrix.view()))
        .map_err(|failure| Error::Internal(format!("eigenvalues of a {size}×{size} matrix: {failure}")))?;
    Ok((Array1::from(eigen.values), eigen.vectors))
}

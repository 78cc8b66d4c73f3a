//! Singular values, eigenvalues and roots, with the errors of this crate.

use crate::{Error, Result};
use cophase_numerics::decompositions;
pub(crate) use cophase_numerics::decompositions::Svd;
use ndarray::Array2;
use num_complex::Complex64;

/// Computes the singular value decomposition of a finite matrix.
pub(crate) fn svd(matrix: &Array2<f64>) -> Result<Svd> {
    let (rows, columns) = matrix.dim();
    decompositions::svd(matrix.view())
        .map_err(|failure| Error::Internal(format!("singular values of a {rows}×{columns} matrix: {failure}")))
}

/// Computes the eigenvalues of a finite square matrix, in no particular order.
pub(super) fn eigenvalues(matrix: &Array2<f64>) -> Result<Vec<Complex64>> {
    let size = matrix.nrows();
    decompositions::eigenvalues(matrix.view())
        .map_err(|failure| Error::Internal(format!("eigenvalues of a {size}×{size} matrix: {failure}")))
}

/// Computes the roots of `λⁿ + c₁λⁿ⁻¹ + … + cₙ`.
pub(super) fn roots(coefficients: &[Complex64]) -> Result<Vec<Complex64>> {
    let degree = coefficients.len();
    decompositions::roots(coefficients)
        .map_err(|failure| Error::Internal(format!("roots of a polynomial of degree {degree}: {failure}")))
}

//! Singular values, and eigenvalues of symmetric and of general matrices.

use crate::conversion::{from_faer, to_faer};
use crate::failure::Failure;
use ndarray::{Array2, ArrayView2};
use num_complex::Complex64;

/// Singular value decomposition `matrix = left · diag(values) · rightᵀ`, values descending.
pub struct Svd {
    /// `[rows, min(rows, columns)]`, orthonormal columns.
    pub left: Array2<f64>,
    pub values: Vec<f64>,
    /// `[columns, min(rows, columns)]`, orthonormal columns.
    pub right: Array2<f64>,
}

/// Computes the singular value decomposition of a finite matrix.
///
/// # Errors
/// Where the iteration does not converge.
pub fn svd(matrix: ArrayView2<f64>) -> Result<Svd, Failure> {
    let (rows, columns) = matrix.dim();
    if rows == 0 || columns == 0 {
        return Ok(Svd { left: Array2::zeros((rows, 0)), values: Vec::new(), right: Array2::zeros((columns, 0)) });
    }
    let svd = to_faer(matrix).thin_svd().map_err(Failure::new)?;
    let values = svd.S().column_vector().iter().copied().collect();
    Ok(Svd { left: from_faer(svd.U()), values, right: from_faer(svd.V()) })
}

/// Power of two by which a matrix is multiplied before its eigenvalues are computed, so that its
/// largest entry is between 1 and 2; 1 for a matrix of zeros. It changes no digit of the entries.
///
/// The divide-and-conquer solver neglects couplings and differences of eigenvalues below 8 ε ×
/// max(largest eigenvalue, 1) (faer 0.24, `tridiag_evd`; LAPACK's `dlaed2` has the same rule for a
/// matrix that was scaled before). Without the scale a matrix of norm 10⁻⁶ has eigenvalues with
/// errors of 10⁻⁹ of the largest: too large for the threshold of null directions, some 10⁻¹⁰.
pub fn unit_scale(matrix: ArrayView2<f64>) -> f64 {
    let largest = matrix.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    if largest.is_normal() { 2f64.powi(-(largest.log2().floor().clamp(-1000.0, 1000.0) as i32)) } else { 1.0 }
}

/// Eigenvalues and eigenvectors of a symmetric matrix.
pub struct SymmetricEigen {
    /// Ascending.
    pub values: Vec<f64>,
    /// Orthonormal columns, in the order of the values.
    pub vectors: Array2<f64>,
}

/// Computes the eigenvalues and eigenvectors of a finite symmetric matrix, read from its lower
/// triangle, from the matrix times `scale`: see [`unit_scale`].
///
/// # Errors
/// Where the iteration does not converge.
pub fn symmetric_eigen(matrix: ArrayView2<f64>, scale: f64) -> Result<SymmetricEigen, Failure> {
    let size = matrix.nrows();
    if size == 0 {
        // The solver does not accept an empty matrix.
        return Ok(SymmetricEigen { values: Vec::new(), vectors: Array2::zeros((0, 0)) });
    }
    let eigen = faer::Mat::from_fn(size, size, |i, j| matrix[[i, j]] * scale)
        .self_adjoint_eigen(faer::Side::Lower)
        .map_err(Failure::new)?;
    let values = eigen.S().column_vector().iter().map(|value| value / scale).collect();
    Ok(SymmetricEigen { values, vectors: from_faer(eigen.U()) })
}

/// Computes the eigenvalues of a finite square matrix, in no particular order.
///
/// # Errors
/// Where the iteration does not converge.
pub fn eigenvalues(matrix: ArrayView2<f64>) -> Result<Vec<Complex64>, Failure> {
    if matrix.nrows() == 0 {
        return Ok(Vec::new());
    }
    let values = to_faer(matrix).eigenvalues().map_err(Failure::new)?;
    Ok(values.into_iter().map(|value| Complex64::new(value.re, value.im)).collect())
}

/// Computes the roots of `λⁿ + c₁λⁿ⁻¹ + … + cₙ`: the eigenvalues of its companion matrix.
///
/// # Errors
/// Where the iteration does not converge.
pub fn roots(coefficients: &[Complex64]) -> Result<Vec<Complex64>, Failure> {
    let degree = coefficients.len();
    if let [only] = coefficients {
        return Ok(vec![-only]);
    }
    let companion = faer::Mat::from_fn(degree, degree, |row, column| match (row, column) {
        (0, _) => -coefficients[column],
        _ if row == column + 1 => Complex64::new(1.0, 0.0),
        _ => Complex64::default(),
    });
    let values = companion.eigenvalues().map_err(Failure::new)?;
    Ok(values.into_iter().map(|value| Complex64::new(value.re, value.im)).collect())
}

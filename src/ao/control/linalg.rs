//! Dense linear algebra on `ndarray` matrices, by `faer`.

use crate::{Error, Result};
use faer::linalg::solvers::SolveLstsqCore;
use ndarray::Array2;
use num_complex::Complex64;

/// Singular value decomposition `matrix = left · diag(values) · rightᵀ`, values descending.
pub(crate) struct Svd {
    /// `[rows, min(rows, columns)]`, orthonormal columns.
    pub left: Array2<f64>,
    pub values: Vec<f64>,
    /// `[columns, min(rows, columns)]`, orthonormal columns.
    pub right: Array2<f64>,
}

/// Computes the singular value decomposition of a finite matrix.
pub(crate) fn svd(matrix: &Array2<f64>) -> Result<Svd> {
    let (rows, columns) = matrix.dim();
    if rows == 0 || columns == 0 {
        return Ok(Svd { left: Array2::zeros((rows, 0)), values: Vec::new(), right: Array2::zeros((columns, 0)) });
    }
    let svd = to_faer(matrix)
        .thin_svd()
        .map_err(|failure| Error::Internal(format!("singular values of a {rows}×{columns} matrix: {failure:?}")))?;
    let values = svd.S().column_vector().iter().copied().collect();
    Ok(Svd { left: from_faer(svd.U()), values, right: from_faer(svd.V()) })
}

/// Computes the eigenvalues of a finite square matrix, in no particular order.
pub(super) fn eigenvalues(matrix: &Array2<f64>) -> Result<Vec<Complex64>> {
    let size = matrix.nrows();
    if size == 0 {
        return Ok(Vec::new());
    }
    let values = to_faer(matrix)
        .eigenvalues()
        .map_err(|failure| Error::Internal(format!("eigenvalues of a {size}×{size} matrix: {failure:?}")))?;
    Ok(values.into_iter().map(|value| Complex64::new(value.re, value.im)).collect())
}

/// Computes the roots of `λⁿ + c₁λⁿ⁻¹ + … + cₙ`: the eigenvalues of its companion matrix.
pub(super) fn roots(coefficients: &[Complex64]) -> Result<Vec<Complex64>> {
    let degree = coefficients.len();
    if let [only] = coefficients {
        return Ok(vec![-only]);
    }
    let companion = faer::Mat::from_fn(degree, degree, |row, column| match (row, column) {
        (0, _) => -coefficients[column],
        _ if row == column + 1 => Complex64::new(1.0, 0.0),
        _ => Complex64::default(),
    });
    let values = companion
        .eigenvalues()
        .map_err(|failure| Error::Internal(format!("roots of a polynomial of degree {degree}: {failure:?}")))?;
    Ok(values.into_iter().map(|value| Complex64::new(value.re, value.im)).collect())
}

/// Solves min‖`matrix · X − right`‖ for X, by a QR decomposition with column pivoting; `None` for a rank-deficient
/// matrix.
pub(super) fn least_squares(matrix: &Array2<f64>, right: &Array2<f64>) -> Option<Array2<f64>> {
    let (rows, columns) = matrix.dim();
    if rows < columns {
        return None;
    }
    let qr = to_faer(matrix).col_piv_qr();
    let pivot = |i: usize| qr.thin_R()[(i, i)].abs();
    // Pivots descend. Rounding makes a zero pivot a few ε times the size of the matrix.
    if pivot(columns - 1) <= rows as f64 * f64::EPSILON * pivot(0) {
        return None;
    }
    let mut solution = to_faer(right);
    qr.solve_lstsq_in_place_with_conj(faer::Conj::No, solution.as_mut());
    Some(from_faer(solution.as_ref().get(..columns, ..)))
}

fn to_faer(matrix: &Array2<f64>) -> faer::Mat<f64> {
    faer::Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[[i, j]])
}

fn from_faer(matrix: faer::MatRef<f64>) -> Array2<f64> {
    Array2::from_shape_fn((matrix.nrows(), matrix.ncols()), |(i, j)| matrix[(i, j)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn roots_of_known_polynomials() {
        // (λ − 2)(λ² + 1) = λ³ − 2λ² + λ − 2; simple, well separated roots: a few ε.
        let mut found = roots(&[-2.0, 1.0, -2.0].map(Complex64::from)).unwrap();
        found.sort_by(|a, b| a.im.total_cmp(&b.im));
        for (found, known) in found.iter().zip([-Complex64::i(), Complex64::from(2.0), Complex64::i()]) {
            assert!((found - known).norm() < 1e-14, "{found} against {known}");
        }
        assert_eq!(roots(&[Complex64::new(0.5, 1.0)]).unwrap(), [Complex64::new(-0.5, -1.0)]);
    }

    #[test]
    fn least_squares_fits_a_line_and_refuses_rank_deficiency() {
        let line = array![[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]];
        // Through (0, 0), (1, 1), (2, 1): intercept 1/6, slope 1/2, from the normal equations by hand.
        let fit = least_squares(&line, &array![[0.0], [1.0], [1.0]]).unwrap();
        assert!((fit[[0, 0]] - 1.0 / 6.0).abs() < 1e-15 && (fit[[1, 0]] - 0.5).abs() < 1e-15, "{fit}");
        assert!(least_squares(&array![[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]], &Array2::zeros((3, 1))).is_none());
        assert!(least_squares(&array![[1.0, 2.0]], &Array2::zeros((1, 1))).is_none());
    }
}

//! Systems of linear equations: square ones, and least squares.

use crate::conversion::{from_faer, to_faer};
use faer::linalg::solvers::{Solve, SolveLstsqCore};
use ndarray::{Array2, ArrayView2};

/// Solves `matrix · X = right` for X, by an LU decomposition with partial pivoting, of a square
/// matrix of full rank.
pub fn solve(matrix: ArrayView2<f64>, right: ArrayView2<f64>) -> Array2<f64> {
    from_faer(to_faer(matrix).partial_piv_lu().solve(&to_faer(right)).as_ref())
}

/// Solves min‖`matrix · X − right`‖ for X, by a QR decomposition with column pivoting; `None` for a
/// rank-deficient matrix.
pub fn least_squares(matrix: ArrayView2<f64>, right: ArrayView2<f64>) -> Option<Array2<f64>> {
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

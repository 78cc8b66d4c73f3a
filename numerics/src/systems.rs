//! Systems of linear equations: square ones, and least squares.

use crate::conversion::{from_faer, to_faer};
use faer::linalg::solvers::{Solve, SolveLstsqCore};
use ndarray::{Array2, ArrayView2};

/// Solves `matrix · X = right` for X, by an LU decomposition with partial pivoting, of a square matrix of full rank.
pub fn solve(matrix: ArrayView2<f64>, right: ArrayView2<f64>) -> Array2<f64> {
    from_faer(to_faer(matrix).partial_piv_lu().solve(&to_faer(right)).as_ref())
}

/// Solves min‖`matrix · X − right`‖ for X, by a QR decomposition with column pivoting; `None` for a rank-deficient
/// matrix.
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

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn least_squares_fits_a_line_and_refuses_rank_deficiency() {
        let line = array![[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]];
        // Through (0, 0), (1, 1), (2, 1): intercept 1/6, slope 1/2, from the normal equations by hand.
        let fit = least_squares(line.view(), array![[0.0], [1.0], [1.0]].view()).unwrap();
        assert!((fit[[0, 0]] - 1.0 / 6.0).abs() < 1e-15 && (fit[[1, 0]] - 0.5).abs() < 1e-15, "{fit}");
        let zeros = Array2::zeros((3, 1));
        assert!(least_squares(array![[1.0, 2.0], [2.0, 4.0], [3.0, 6.0]].view(), zeros.view()).is_none());
        assert!(least_squares(array![[1.0, 2.0]].view(), Array2::zeros((1, 1)).view()).is_none());
    }

    #[test]
    fn a_square_system_is_solved() {
        let matrix = array![[0.0, 2.0, 1.0], [1.0, 1.0, 0.0], [2.0, 0.0, -3.0]];
        let wanted = array![[1.0], [-2.0], [0.5]];
        // A dozen operations on numbers of order 1: some 1e-15.
        let found = solve(matrix.view(), matrix.dot(&wanted).view());
        assert!((found - wanted).iter().all(|off| off.abs() < 1e-14));
    }
}

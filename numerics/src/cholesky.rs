//! Cholesky decomposition of symmetric positive definite matrices.

use crate::conversion::{from_faer, to_faer};
use crate::failure::Failure;
use faer::linalg::solvers::{DenseSolveCore, Llt, Solve};
use faer::linalg::triangular_solve::solve_lower_triangular_in_place;
use ndarray::{Array2, ArrayView2};

/// Factor L of a symmetric positive definite matrix A = L·Lᵀ.
pub struct Cholesky {
    factor: Llt<f64>,
}

impl Cholesky {
    /// From the lower triangle of `matrix`.
    ///
    /// # Errors
    /// For a matrix that is not positive definite.
    pub fn new(matrix: ArrayView2<f64>) -> Result<Self, Failure> {
        Ok(Self { factor: to_faer(matrix).llt(faer::Side::Lower).map_err(Failure::new)? })
    }

    /// Rows, and columns, of A.
    pub fn size(&self) -> usize {
        self.factor.L().nrows()
    }

    /// Logarithm of the determinant of A.
    pub fn log_determinant(&self) -> f64 {
        (0..self.size()).map(|i| 2.0 * self.factor.L()[(i, i)].ln()).sum()
    }

    /// A⁻¹.
    pub fn inverse(&self) -> Array2<f64> {
        from_faer(self.factor.inverse().as_ref())
    }

    /// A⁻¹·`right`, `[size, columns]`.
    pub fn solve(&self, right: ArrayView2<f64>) -> Array2<f64> {
        from_faer(self.factor.solve(to_faer(right)).as_ref())
    }

    /// L⁻¹·`right`, `[size, columns]`, by forward substitution.
    pub fn solve_lower(&self, right: ArrayView2<f64>) -> Array2<f64> {
        let mut solved = to_faer(right);
        solve_lower_triangular_in_place(self.factor.L(), solved.as_mut(), faer::Par::Seq);
        from_faer(solved.as_ref())
    }
}

//! Copies between the matrices of `ndarray` and of `faer`.

use faer::{Mat, MatRef};
use ndarray::{Array2, ArrayView2};

pub(crate) fn to_faer(matrix: ArrayView2<f64>) -> Mat<f64> {
    Mat::from_fn(matrix.nrows(), matrix.ncols(), |i, j| matrix[[i, j]])
}

pub(crate) fn from_faer(matrix: MatRef<f64>) -> Array2<f64> {
    Array2::from_shape_fn((matrix.nrows(), matrix.ncols()), |(i, j)| matrix[(i, j)])
}

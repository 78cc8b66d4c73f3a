//! Coordinates of the observed subspace: the directions whose covariance is not zero.
//!
//! Pistons are reported about their mean, so that their covariance has no part along it. Estimates, filter and likelihood live in
//! the subspace orthogonal to such directions, in which every covariance is positive definite. The subspace is spanned by the
//! eigenvectors of the first estimate's covariance, of segment modes and of NCPA modes each, so that the drift, which is white among
//! the modes of either, stays white: Vᵀ·Q·V = diag(rate²).

use super::bytes::{Reader, Writer};
use crate::modes::symmetric_eigen;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, s};
use std::ops::Range;

/// Variance of a direction, over the largest one, below which it is not observed: rounding leaves some 1e-15.
const UNOBSERVED: f64 = 1e-10;

/// Orthonormal basis of the observed subspace.
#[derive(Debug, Clone)]
pub(super) struct Coordinates {
    /// V, `[mode, coordinate]`: coordinates of segment modes, then of NCPA modes.
    basis: Array2<f64>,
    /// Number of coordinates of segment modes.
    pub(super) of_segments: usize,
}

impl Coordinates {
    /// # Errors
    /// [`Error::Value`] for a covariance that is negative along a direction, or zero along all.
    pub(super) fn new(covariance_nm2: ArrayView2<f64>, segments: &Range<usize>) -> Result<Self> {
        let modes = covariance_nm2.nrows();
        let others: Vec<usize> = (0..modes).filter(|mode| !segments.contains(mode)).collect();
        let groups = [segments.clone().collect::<Vec<usize>>(), others];
        let mut columns: Vec<Array1<f64>> = Vec::new();
        let mut of_segments = 0;
        for (number, group) in groups.iter().enumerate() {
            let block =
                Array2::from_shape_fn((group.len(), group.len()), |(i, j)| covariance_nm2[[group[i], group[j]]]);
            let (values, vectors) = symmetric_eigen(&block)?;
            let largest_nm2 = values.iter().copied().fold(0.0, f64::max);
            if let Some(negative) = values.iter().find(|value| **value < -1e-6 * largest_nm2) {
                return Err(Error::Value(format!(
                    "the covariance has a direction of variance {negative} nm², where none may be negative"
                )));
            }
            for (&value, vector) in values.iter().zip(vectors.columns()) {
                if value > UNOBSERVED * largest_nm2 {
                    let mut column = Array1::zeros(modes);
                    group.iter().zip(vector).for_each(|(&mode, &part)| column[mode] = part);
                    columns.push(column);
                }
            }
            if number == 0 {
                of_segments = columns.len();
            }
        }
        if columns.is_empty() {
            return Err(Error::Value("the covariance is zero: an estimate with error bars is needed".into()));
        }
        let basis = Array2::from_shape_fn((modes, columns.len()), |(mode, column)| columns[column][mode]);
        Ok(Self { basis, of_segments })
    }

    /// Number of modes.
    pub(super) fn modes(&self) -> usize {
        self.basis.nrows()
    }

    /// Number of coordinates.
    pub(super) fn len(&self) -> usize {
        self.basis.ncols()
    }

    /// Vᵀ·y.
    pub(super) fn reduce(&self, coefficients_nm: ArrayView1<f64>) -> Array1<f64> {
        self.basis.t().dot(&coefficients_nm)
    }

    /// Vᵀ·R·V.
    pub(super) fn reduce_covariance(&self, covariance_nm2: ArrayView2<f64>) -> Array2<f64> {
        self.basis.t().dot(&covariance_nm2.dot(&self.basis))
    }

    /// V·z.
    pub(super) fn expand(&self, z_nm: &Array1<f64>) -> Array1<f64> {
        self.basis.dot(z_nm)
    }

    /// V·P·Vᵀ.
    pub(super) fn expand_covariance(&self, covariance_nm2: &Array2<f64>) -> Array2<f64> {
        self.basis.dot(&covariance_nm2.dot(&self.basis.t()))
    }

    /// Steps of 1 nm of the modes `range`, as columns `[coordinate, mode]`.
    pub(super) fn steps(&self, range: &Range<usize>) -> Array2<f64> {
        self.basis.slice(s![range.clone(), ..]).t().to_owned()
    }

    pub(super) fn write(&self, writer: &mut Writer) {
        writer.number(self.of_segments);
        writer.matrix(&self.basis);
    }

    pub(super) fn read(reader: &mut Reader) -> Result<Self> {
        let of_segments = reader.number()?;
        Ok(Self { of_segments, basis: reader.matrix()? })
    }
}

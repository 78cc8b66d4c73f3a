//! Coordinates of the observed subspace: the directions whose covariance is not zero, and that no
//! image has of its own.
//!
//! Pistons are reported about their mean, so that their covariance has no part along it. The
//! pointing is another matter: each image has its own, known to a tenth of a nanometre and
//! unrelated to that of the next. It is a nuisance whose prior is flat: a covariance R + κ·T·Tᵀ
//! with κ → ∞ for the directions T of tip and tilt, which is the same as to use the part of the
//! estimate that is orthogonal to T, exactly, and no more is lost. A staircase of pistons is not
//! along T where the modes hold a smooth tilt besides: it is observed as before.
//!
//! Estimates, filter and likelihood live in the subspace orthogonal to all such directions, in
//! which every covariance is positive definite:
//!
//! - that of the segment modes is spanned by the eigenvectors of the first estimate's covariance;
//! - that of the NCPA modes by vectors as near to single modes as they can be, because modes may
//!   drift by rates of their own.
//!
//! Both are orthonormal, so that a drift that is white among the modes of either stays white:
//! Vᵀ·Q·V = diag(rate²).

use super::bytes::{ByteReader, Writer};
use crate::modes::symmetric_eigen;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis, s};
use std::ops::Range;

/// Variance of a direction, over the largest one, below which it is not observed: rounding leaves
/// some 1e-15.
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
    /// Coordinates of estimates with `covariance_nm2`, orthogonal to the rows of `pointing_modes`.
    ///
    /// # Errors
    /// [`Error::Value`] for a covariance that is negative along a direction, or zero along all.
    pub(super) fn new(
        covariance_nm2: ArrayView2<f64>,
        segments: &Range<usize>,
        pointing_modes: ArrayView2<f64>,
    ) -> Result<Self> {
        let modes = covariance_nm2.nrows();
        let others: Vec<usize> = (0..modes).filter(|mode| !segments.contains(mode)).collect();
        let mut columns: Vec<Array1<f64>> = Vec::new();
        let mut of_segments = 0;
        for (number, group) in [segments.clone().collect::<Vec<usize>>(), others].into_iter().enumerate() {
            let block_nm2 = covariance_nm2.select(Axis(0), &group).select(Axis(1), &group);
            let pointing = pointing_modes.rows().into_iter().map(|row| row.select(Axis(0), &group));
            let observed = observed(&block_nm2, pointing)?;
            let vectors = if number == 0 { observed } else { near_axes(&observed) };
            for vector in vectors.columns() {
                let mut column = Array1::zeros(modes);
                group.iter().zip(vector).for_each(|(&mode, &part)| column[mode] = part);
                columns.push(column);
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

    /// Number of coordinates of segments and of NCPA.
    pub(super) fn sizes(&self) -> [usize; 2] {
        [self.of_segments, self.len() - self.of_segments]
    }

    /// Whether the rows of `pointing_modes` have no part in them, but for rounding.
    pub(super) fn are_without(&self, pointing_modes: ArrayView2<f64>) -> bool {
        pointing_modes.rows().into_iter().all(|row| {
            let has_size = row.len() == self.modes();
            has_size && self.reduce(row).iter().all(|part| part.abs() <= 1e-6 * row.dot(&row).sqrt())
        })
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

    pub(super) fn read(reader: &mut ByteReader) -> Result<Self> {
        let of_segments = reader.number()?;
        Ok(Self { of_segments, basis: reader.matrix()? })
    }
}

/// Eigenvectors of the covariance of some modes, without the part along the directions `left_out`,
/// whose variance is not zero; as columns.
fn observed(covariance_nm2: &Array2<f64>, left_out: impl Iterator<Item = Array1<f64>>) -> Result<Array2<f64>> {
    let mut projector = Array2::<f64>::eye(covariance_nm2.nrows());
    for direction in left_out {
        // What is left of it beside those before it; rounding where there is nothing.
        let rest = projector.dot(&direction);
        let square = rest.dot(&rest);
        if square > UNOBSERVED * direction.dot(&direction) {
            let column = rest.insert_axis(Axis(1));
            projector.scaled_add(-1.0 / square, &column.dot(&column.t()));
        }
    }
    let (values, vectors) = symmetric_eigen(&projector.dot(&covariance_nm2.dot(&projector)))?;
    let largest_nm2 = values.iter().copied().fold(0.0, f64::max);
    if let Some(negative) = values.iter().find(|value| **value < -1e-6 * largest_nm2) {
        return Err(Error::Value(format!(
            "the covariance has a direction of variance {negative} nm², where none may be negative"
        )));
    }
    let places: Vec<usize> = (0..values.len()).filter(|&place| values[place] > UNOBSERVED * largest_nm2).collect();
    Ok(vectors.select(Axis(1), &places))
}

/// Another orthonormal basis of the space that `vectors` span: single axes as far as they are in
/// it, the nearest first.
fn near_axes(vectors: &Array2<f64>) -> Array2<f64> {
    let (size, count) = vectors.dim();
    // What of the space the vectors that are found do not span.
    let mut rest = vectors.dot(&vectors.t());
    let mut found = Vec::with_capacity(count);
    for _ in 0..count {
        // The first of those that are equally near, whose differences are rounding.
        let nearest = (0..size).fold(0, |best, at| if rest[[at, at]] > rest[[best, best]] + 1e-9 { at } else { best });
        let column = rest.column(nearest).to_owned() / rest[[nearest, nearest]].sqrt();
        let outer = column.view().insert_axis(Axis(1));
        rest.scaled_add(-1.0, &outer.dot(&outer.t()));
        found.push((nearest, column));
    }
    found.sort_by_key(|(axis, _)| *axis);
    Array2::from_shape_fn((size, count), |(row, place)| found[place].1[row])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pointing_has_no_coordinate_and_the_rest_has_all() {
        // Three pistons about their mean, and four NCPA modes of which two are tip and tilt.
        let mut covariance_nm2 = Array2::<f64>::eye(7) * 4.0;
        covariance_nm2.slice_mut(s![..3, ..3]).iter_mut().for_each(|value| *value -= 4.0 / 3.0);
        let mut pointing = Array2::zeros((2, 7));
        (pointing[[0, 3]], pointing[[1, 5]]) = (1.0, 1.0);
        let coordinates = Coordinates::new(covariance_nm2.view(), &(0..3), pointing.view()).unwrap();
        assert_eq!((coordinates.of_segments, coordinates.len()), (2, 4));
        let seen_nm = Array1::from(vec![1.0, -2.0, 1.0, 70.0, 5.0, -80.0, 6.0]);
        let kept_nm = coordinates.expand(&coordinates.reduce(seen_nm.view()));
        let expected_nm = [1.0, -2.0, 1.0, 0.0, 5.0, 0.0, 6.0];
        assert!(kept_nm.iter().zip(expected_nm).all(|(kept, expected)| (kept - expected).abs() < 1e-12), "{kept_nm}");
        // Single modes where these are in the space.
        assert!((coordinates.reduce(seen_nm.view())[2] - 5.0).abs() < 1e-12);
    }

    #[test]
    fn pointing_across_modes_is_orthogonal_to_all() {
        let covariance_nm2 = Array2::<f64>::eye(5);
        let pointing = Array2::from_shape_vec((1, 5), vec![0.0, 0.6, 0.0, 0.8, 0.0]).unwrap();
        let coordinates = Coordinates::new(covariance_nm2.view(), &(0..0), pointing.view()).unwrap();
        assert_eq!(coordinates.len(), 4);
        assert!(coordinates.reduce(pointing.row(0)).iter().all(|nm| nm.abs() < 1e-12));
        let unit = coordinates.basis.t().dot(&coordinates.basis) - Array2::<f64>::eye(4);
        assert!(unit.iter().all(|off| off.abs() < 1e-12));
    }
}

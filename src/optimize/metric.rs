//! Whitened coordinates of a least-squares problem, in which its Hessian is a multiple of the
//! identity.

use super::pairs::{add_scaled, dot};
use crate::{Error, Result};
use cophase_numerics::decompositions::{SymmetricEigen, symmetric_eigen, unit_scale};
use ndarray::{Array2, ArrayView2, ArrayViewMut2};
use pulp::{Arch, NullaryFnOnce};

/// Largest accepted asymmetry of a Gauss-Newton matrix relative to its largest entry. Accumulating
/// Jᵀ W J in f32 leaves about 1e-7 per product and at most 1e-4 over a million pixels; more is a
/// mistake in the matrix.
const ASYMMETRY: f64 = 1e-4;

/// Whitening from a Gauss-Newton matrix H = Jᵀ W J = V Λ Vᵀ: a displacement in the caller's
/// coordinates is δx = V Λ^(−1/2) z, so that J = Σ w r² has the Hessian 2·I in z wherever the
/// linearisation holds.
///
/// Directions whose eigenvalue is zero within rounding are **null**: they have no coordinate in z,
/// so an optimiser that works in z never moves along them.
#[derive(Debug, Clone)]
pub struct Metric {
    dimension: usize,
    /// `V Λ^(−1/2)`, `[dimension, rank]`; `None` is the identity.
    whitening: Option<Array2<f64>>,
    /// Whether the Hessian is about 2·I in these coordinates.
    whitened: bool,
}

impl Metric {
    /// The caller's own coordinates, of unknown curvature.
    pub fn identity(dimension: usize) -> Self {
        Metric { dimension, whitening: None, whitened: false }
    }

    /// The caller's own coordinates, which the caller has whitened: the Hessian is about 2·I in
    /// them.
    pub fn whitened(dimension: usize) -> Self {
        Metric { whitened: true, ..Self::identity(dimension) }
    }

    /// Whitening from `gauss_newton` = Jᵀ W J, `[n, n]`, symmetric and positive semi-definite (the
    /// lower triangle is read). Directions with an eigenvalue below `relative_floor` times the
    /// largest are null: 1e-12 suits a matrix accumulated in f64, 1e-6 one accumulated in f32,
    /// where rounding fills the null space to about 1e-7.
    ///
    /// # Errors
    /// [`Error::Shape`] if the matrix is not square or is empty; [`Error::Value`] if an entry is
    /// not finite, if it is not symmetric, has a negative eigenvalue beyond the floor, or is zero,
    /// or if the floor is not in (0, 1).
    pub fn from_gauss_newton(gauss_newton: &Array2<f64>, relative_floor: f64) -> Result<Self> {
        let n = check(gauss_newton, relative_floor)?;
        // In ascending order.
        let SymmetricEigen { values, vectors } = symmetric_eigen(gauss_newton.view(), unit_scale(gauss_newton.view()))
            .map_err(|failure| {
                Error::Value(format!("the eigenvalues of the Gauss-Newton matrix cannot be found: {failure}"))
            })?;
        let (smallest, largest) = (values[0], values[n - 1]);
        if largest.is_nan() || largest <= 0.0 {
            return Err(Error::Value(format!(
                "the Gauss-Newton matrix has {largest:e} as its largest eigenvalue where a positive number is needed"
            )));
        }
        let floor = relative_floor * largest;
        if smallest < -floor {
            return Err(Error::Value(format!(
                "the Gauss-Newton matrix has the eigenvalue {smallest:e}, where {:e} or more is accepted",
                -floor
            )));
        }
        let nullity = (0..n).take_while(|&k| values[k] < floor).count();
        // Largest eigenvalue first: z[0] is the best determined direction.
        let whitening =
            Array2::from_shape_fn((n, n - nullity), |(i, k)| vectors[[i, n - 1 - k]] / values[n - 1 - k].sqrt());
        Ok(Metric { dimension: n, whitening: Some(whitening), whitened: true })
    }

    /// The metric with the given factor, `[x, z]`, of full column rank.
    pub(crate) fn of_whitening(whitening: Array2<f64>) -> Self {
        Metric { dimension: whitening.nrows(), whitening: Some(whitening), whitened: true }
    }

    /// The factor, to be replaced.
    pub(crate) fn whitening_mut(&mut self) -> Option<ArrayViewMut2<'_, f64>> {
        self.whitening.as_mut().map(|whitening| whitening.view_mut())
    }

    /// Length of x.
    pub fn dimension(&self) -> usize {
        self.dimension
    }

    /// Checks that a starting point has the dimension of the metric.
    ///
    /// # Errors
    /// [`Error::Shape`] for another dimension.
    pub(super) fn check_dimension(&self, start: &[f64]) -> Result<()> {
        if start.len() == self.dimension {
            return Ok(());
        }
        let (given, needed) = (start.len(), self.dimension);
        Err(Error::Shape(format!("the starting point has {given} components: the metric needs {needed}")))
    }

    /// Length of z: the number of directions determined by the data.
    pub fn rank(&self) -> usize {
        self.whitening.as_ref().map_or(self.dimension, |w| w.ncols())
    }

    /// `V Λ^(−1/2)`, `[dimension, rank]`, whose product with its transpose is the pseudo-inverse of
    /// the matrix; `None` is the identity.
    pub fn whitening(&self) -> Option<ArrayView2<'_, f64>> {
        self.whitening.as_ref().map(|whitening| whitening.view())
    }

    /// Whether the Hessian is about 2·I in these coordinates, so that −g/2 is a Newton step.
    pub fn is_whitened(&self) -> bool {
        self.whitened
    }

    /// `x = V Λ^(−1/2) z`: a displacement `z` of length [`rank`](Self::rank) in the caller's
    /// coordinates.
    pub fn to_x(&self, z: &[f64], x: &mut [f64]) {
        match self.whitening.as_ref().map(|whitening| (whitening.as_slice(), whitening.ncols())) {
            None => x.copy_from_slice(z),
            // Whitening matrices are stored row by row.
            Some((rows, rank)) => Arch::new().dispatch(ToX { rows: rows.unwrap_or_default(), rank, z, x }),
        }
    }

    /// `g_z = Λ^(−1/2) Vᵀ g_x`: a gradient in whitened coordinates.
    pub fn gradient_to_z(&self, gradient_x: &[f64], gradient_z: &mut [f64]) {
        match self.whitening.as_ref().map(|whitening| (whitening.as_slice(), whitening.ncols())) {
            None => gradient_z.copy_from_slice(gradient_x),
            Some((rows, rank)) => {
                Arch::new().dispatch(ToZ { rows: rows.unwrap_or_default(), rank, gradient_x, gradient_z });
            }
        }
    }
}

/// [`Metric::to_x`] by the rows of the whitening matrix, compiled for the widest vectors that this
/// processor has; the sums are the same bits at every width.
struct ToX<'a> {
    rows: &'a [f64],
    rank: usize,
    z: &'a [f64],
    x: &'a mut [f64],
}

impl NullaryFnOnce for ToX<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for (x, row) in self.x.iter_mut().zip(self.rows.chunks_exact(self.rank)) {
            *x = dot(row, self.z);
        }
    }
}

/// [`Metric::gradient_to_z`], compiled in the same way.
struct ToZ<'a> {
    rows: &'a [f64],
    rank: usize,
    gradient_x: &'a [f64],
    gradient_z: &'a mut [f64],
}

impl NullaryFnOnce for ToZ<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.gradient_z.fill(0.0);
        for (&g, row) in self.gradient_x.iter().zip(self.rows.chunks_exact(self.rank)) {
            add_scaled(self.gradient_z, g, row);
        }
    }
}

/// Checks a Gauss-Newton matrix, and returns its size.
fn check(matrix: &Array2<f64>, relative_floor: f64) -> Result<usize> {
    let (rows, columns) = matrix.dim();
    if rows != columns || rows == 0 {
        return Err(Error::Shape(format!(
            "the Gauss-Newton matrix is {rows} by {columns}, where a square matrix of one row or more is needed"
        )));
    }
    if !(relative_floor > 0.0 && relative_floor < 1.0) {
        return Err(Error::Value(format!(
            "the floor of the eigenvalues is {relative_floor}, where a number between 0 and 1 is needed"
        )));
    }
    if let Some(((i, j), value)) = matrix.indexed_iter().find(|(_, v)| !v.is_finite()) {
        return Err(Error::Value(format!(
            "entry [{i}, {j}] of the Gauss-Newton matrix is {value}: finite numbers are needed"
        )));
    }
    let largest = matrix.iter().fold(0.0_f64, |m, v| m.max(v.abs()));
    for ((i, j), &value) in matrix.indexed_iter().filter(|((i, j), _)| j < i) {
        let mirrored = matrix[[j, i]];
        if (value - mirrored).abs() > ASYMMETRY * largest {
            return Err(Error::Value(format!(
                "the Gauss-Newton matrix holds {value:e} at [{i}, {j}] but {mirrored:e} at [{j}, {i}], where a \
                 symmetric matrix is needed"
            )));
        }
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn whitening_makes_the_gauss_newton_matrix_the_identity() {
        // Hilbert's matrix of order 4: eigenvalues from 1e-4 to 1.5.
        let n = 4;
        let h = Array2::from_shape_fn((n, n), |(i, j)| 1.0 / (i + j + 1) as f64);
        let metric = Metric::from_gauss_newton(&h, 1e-12).unwrap();
        assert_eq!(metric.rank(), n);
        let mut columns = Vec::new();
        for k in 0..metric.rank() {
            let z: Vec<f64> = (0..metric.rank()).map(|i| f64::from(u8::from(i == k))).collect();
            let mut x = vec![0.0; n];
            metric.to_x(&z, &mut x);
            columns.push(ndarray::Array1::from(x));
        }
        for (i, a) in columns.iter().enumerate() {
            let image = h.dot(a);
            let mut z = vec![0.0; metric.rank()];
            // gradient_to_z is the transpose of to_x, so this is column i of Tᵀ H T.
            metric.gradient_to_z(image.as_slice().unwrap(), &mut z);
            for (j, b) in columns.iter().enumerate() {
                let expected = f64::from(u8::from(i == j));
                // Eigenvalues down to 1e-4 of the largest are good to some 1e-15/1e-4; a hundred
                // times that.
                assert!((image.dot(b) - expected).abs() < 1e-9, "[{i}, {j}]: {}", image.dot(b));
                assert!((z[j] - image.dot(b)).abs() < 1e-12, "{} {}", z[j], image.dot(b));
            }
        }
    }

    /// As large as that of several hundred segments, whose derivatives by nm are small: 1e-6 of a
    /// unit and less.
    #[test]
    fn a_large_matrix_of_small_entries_has_its_weak_directions() {
        // H = V Λ Vᵀ with the reflection V = 1 − 2 v vᵀ; eigenvalues from 1 to 1e-7 of the largest,
        // and one that is 0.
        let (n, scale) = (300, 1e-9);
        let v: Vec<f64> = (0..n).map(|i| (1.0 + 3.0 * i as f64).sin()).collect();
        let square = v.iter().map(|v| v * v).sum::<f64>();
        let reflection =
            Array2::from_shape_fn((n, n), |(i, j)| f64::from(u8::from(i == j)) - 2.0 * v[i] * v[j] / square);
        let value = |k: usize| if k == 0 { 0.0 } else { scale * 1e-7_f64.powf(k as f64 / n as f64) };
        let scaled = Array2::from_shape_fn((n, n), |(i, k)| reflection[[i, k]] * value(k));
        let h = scaled.dot(&reflection);
        let metric = Metric::from_gauss_newton(&((&h + &h.t()) / 2.0), 1e-10).unwrap();
        assert_eq!(metric.rank(), n - 1);
        // The inverse in each direction: rounding of some n·ε of the largest eigenvalue is
        // 7e-14/1e-7 of the smallest; ten times that.
        for k in 1..n {
            let direction: Vec<f64> = reflection.column(k).to_vec();
            let mut z = vec![0.0; n - 1];
            metric.gradient_to_z(&direction, &mut z);
            let inverse = z.iter().map(|z| z * z).sum::<f64>();
            assert!((inverse * value(k) - 1.0).abs() < 1e-5, "{k}: {}", inverse * value(k) - 1.0);
        }
    }

    #[test]
    fn matrices_that_are_not_gauss_newton_matrices_are_rejected() {
        let message = |h: Array2<f64>, floor: f64| Metric::from_gauss_newton(&h, floor).unwrap_err().to_string();
        assert!(message(Array2::zeros((2, 3)), 1e-12).contains("2 by 3"));
        assert!(message(Array2::zeros((0, 0)), 1e-12).contains("0 by 0"));
        assert!(message(Array2::zeros((2, 2)), 1e-12).contains("largest eigenvalue"));
        assert!(message(Array2::eye(2), 0.0).contains("between 0 and 1"));
        assert!(message(Array2::from_diag_elem(2, f64::NAN), 1e-12).contains("[0, 0]"));
        assert!(message(ndarray::array![[1.0, 2.0], [2.0, 1.0]], 1e-12).contains("eigenvalue -1"));
        assert!(message(ndarray::array![[1.0, 0.5], [0.0, 1.0]], 1e-12).contains("[1, 0]"));
    }
}

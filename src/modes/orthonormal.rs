//! Orthonormalisation of modes over a pupil, as functions that can be evaluated at any point.

use super::samples::Samples;
use super::smooth::SmoothBasis;
use super::zernike::Zernikes;
use crate::pupil::Pupil;
use crate::{Error, Result};
use ndarray::{Array2, Axis};

/// Modes with zero mean and unit RMS over a pupil (weight A), orthogonal to each other, and the
/// modes dropped.
#[derive(Debug, Clone)]
pub struct OrthonormalBasis {
    /// The modes: each is its raw mode minus a combination of the modes before it, so that names
    /// and order are kept.
    pub basis: SmoothBasis,
    /// Modes in the span of piston and the modes before them.
    pub dropped: Vec<DroppedMode>,
}

/// A mode dropped from a basis because it is in the span of the modes before it.
#[derive(Debug, Clone, PartialEq)]
pub struct DroppedMode {
    /// Name of the mode.
    pub name: String,
    /// RMS of its component outside that span, as a fraction of its own RMS.
    pub remainder: f64,
}

/// Removes piston and orthonormalises `raw` over `pupil` (weight A) in its own order. A mode whose
/// component outside the span of those before it is below `smallest` (a fraction of its RMS, in
/// \[1e-6, 1)) is dropped and reported.
///
/// Cholesky of the Gram matrix, twice (Yamamoto et al. 2015, "Roundoff error analysis of the
/// CholeskyQR2 algorithm", ETNA 44): the error after the first pass is up to ε·κ², and the second
/// pass removes it. That holds for κ² < 1/ε, hence the lower limit of 1e-6.
///
/// # Errors
/// Those of [`Samples::from_pupil`]; [`Error::Value`] for a threshold out of range, modes that are
/// not finite, or none left.
pub fn orthonormalise(raw: &SmoothBasis, pupil: &Pupil, smallest: f64) -> Result<OrthonormalBasis> {
    if !(1e-6..1.0).contains(&smallest) {
        let text = format!("a smallest remainder of {smallest} is out of range: 1e-6 to below 1 is accepted");
        return Err(Error::Value(text));
    }
    let samples = Samples::from_pupil(pupil)?;
    let first = pass(raw, &samples, smallest)?;
    // The modes kept by the first pass are independent: none is dropped here.
    let second = pass(&first.basis, &samples, 0.0)?;
    Ok(OrthonormalBasis { basis: second.basis, dropped: first.dropped })
}

/// The Zernike modes of Noll indices `first` to `last`, orthonormal over `pupil`, also to piston,
/// tip, tilt and every other polynomial before `first`, so that they do not depend on the disc of
/// the polynomials.
///
/// # Errors
/// Those of [`orthonormalise`]; [`Error::Value`] for an empty range, or more modes than the samples
/// of the pupil resolve.
pub fn zernike_basis(first: usize, last: usize, pupil: &Pupil) -> Result<SmoothBasis> {
    if first < 2 || last < first {
        let text = format!(
            "Zernike modes {first} to {last} were requested: a range that starts at 2 or higher and is not empty is needed"
        );
        return Err(Error::Value(text));
    }
    let samples = Samples::from_pupil(pupil)?;
    let radius_m = samples.radius_m().max(pupil.grid.pitch_m());
    let raw = SmoothBasis::zernike(Zernikes::new(2..=last, radius_m)?);
    let all = orthonormalise(&raw, pupil, 1e-6)?;
    if let Some(lost) = all.dropped.first() {
        let text = format!(
            "{} is not independent of the modes before it on a pupil of {} samples: use a smaller last index",
            lost.name,
            samples.weights.len()
        );
        return Err(Error::Value(text));
    }
    Ok(all.basis.selected(&(first - 2..=last - 2).collect::<Vec<_>>()))
}

/// The Zernike polynomials of Noll indices `first` to `last` on the circle around `pupil`, of unit
/// RMS over the circle.
///
/// # Errors
/// Those of [`Samples::from_pupil`]; [`Error::Value`] for an index out of range.
pub fn circle_zernikes(first: usize, last: usize, pupil: &Pupil) -> Result<SmoothBasis> {
    let radius_m = Samples::from_pupil(pupil)?.radius_m().max(pupil.grid.pitch_m());
    Ok(SmoothBasis::zernike(Zernikes::new(first..=last, radius_m)?))
}

/// The modes of `exact` first, then those of `other` with the span of `exact` projected out; all
/// orthonormal over `pupil`, names kept. Modes of `other` of which less than `smallest` (a fraction
/// of their RMS; 1e-3 is a good choice) remains are dropped and reported.
///
/// # Errors
/// Those of [`orthonormalise`].
pub fn join_exact(exact: &SmoothBasis, other: &SmoothBasis, pupil: &Pupil, smallest: f64) -> Result<OrthonormalBasis> {
    orthonormalise(&exact.followed_by(other), pupil, smallest)
}

/// One pass: removes the mean, then applies the inverse Cholesky factor of the Gram matrix.
fn pass(basis: &SmoothBasis, samples: &Samples, smallest: f64) -> Result<OrthonormalBasis> {
    let (mean, products) = basis.moments(samples);
    let gram = Array2::from_shape_fn(products.dim(), |(i, j)| products[[i, j]] - mean[i] * mean[j]);
    if let Some(mode) = (0..basis.len()).find(|&mode| !products[[mode, mode]].is_finite()) {
        return Err(Error::Value(format!("mode {} is not finite over the pupil", basis.names()[mode])));
    }
    let mut factor = Cholesky { rows: Vec::new(), kept: Vec::new() };
    let mut dropped = Vec::new();
    for mode in 0..basis.len() {
        // Relative to the RMS including piston, so that a constant counts as in the span of piston.
        let total = products[[mode, mode]];
        let remainder2 = factor.push(&gram, mode, smallest * smallest * total);
        if let Some(left) = remainder2 {
            let remainder = if total > 0.0 { (left.max(0.0) / total).sqrt() } else { 0.0 };
            dropped.push(DroppedMode { name: basis.names()[mode].clone(), remainder });
        }
    }
    if factor.kept.is_empty() {
        return Err(Error::Value("no mode is left after the removal of piston: at least one is needed".into()));
    }
    let names = factor.kept.iter().map(|&mode| basis.names()[mode].clone()).collect();
    let combination = factor.inverse(basis.len());
    Ok(OrthonormalBasis { basis: basis.combined(names, &combination, &mean), dropped })
}

/// A Cholesky factor, built row by row without the modes in the span of those before them.
struct Cholesky {
    /// Lower-triangular rows, over the kept modes.
    rows: Vec<Vec<f64>>,
    kept: Vec<usize>,
}

impl Cholesky {
    /// Adds `mode` if its pivot is above `smallest`; otherwise returns the pivot.
    fn push(&mut self, gram: &Array2<f64>, mode: usize, smallest: f64) -> Option<f64> {
        let mut row: Vec<f64> = Vec::with_capacity(self.rows.len() + 1);
        for (other, &column) in self.rows.iter().zip(&self.kept) {
            let known: f64 = row.iter().zip(other).map(|(a, b)| a * b).sum();
            row.push((gram[[mode, column]] - known) / other[row.len()]);
        }
        let pivot = gram[[mode, mode]] - row.iter().map(|a| a * a).sum::<f64>();
        // A pivot at the level of rounding is not used, even with `smallest` = 0.
        if pivot <= smallest.max(1e-15 * gram[[mode, mode]]) {
            return Some(pivot);
        }
        row.push(pivot.sqrt());
        self.rows.push(row);
        self.kept.push(mode);
        None
    }

    /// The inverse of the factor, `[kept, modes]`, zero in the columns of dropped modes.
    fn inverse(&self, modes: usize) -> Array2<f64> {
        let mut inverse = Array2::<f64>::zeros((self.kept.len(), modes));
        for (i, row) in self.rows.iter().enumerate() {
            let (above, mut below) = inverse.view_mut().split_at(Axis(0), i);
            let mut current = below.row_mut(0);
            for (factor, known) in row.iter().zip(above.rows()) {
                current.scaled_add(-factor, &known);
            }
            current[self.kept[i]] += 1.0;
            current /= row[i];
        }
        inverse
    }
}

//! Modes made orthonormal over a pupil, as functions: what holds on the samples is carried to every other point.

use super::{Samples, SmoothBasis, Zernikes};
use crate::pupil::Pupil;
use crate::{Error, Result};
use ndarray::{Array2, Axis};

/// Modes with zero mean and unit RMS over a pupil (weight A), orthogonal to each other, and what was left out.
#[derive(Debug, Clone)]
pub struct Orthonormal {
    /// The modes: each is its raw mode less a combination of those before it, so names and order stay.
    pub basis: SmoothBasis,
    /// The modes that those before them (and piston) already span.
    pub dropped: Vec<Dropped>,
}

/// A mode left out of a basis because those before it span it.
#[derive(Debug, Clone, PartialEq)]
pub struct Dropped {
    /// Its name.
    pub name: String,
    /// RMS of what the modes before it do not span, as a fraction of its own RMS.
    pub remainder: f64,
}

/// Removes piston and orthonormalises `raw` over `pupil` (weight A) in its own order. A mode whose remainder is below
/// `smallest` (a fraction of its RMS, in \[1e-6, 1)) is left out and reported.
///
/// Cholesky of the Gram matrix, twice (Yamamoto et al. 2015, "Roundoff error analysis of the CholeskyQR2 algorithm",
/// ETNA 44): the first pass may leave an error of ε·κ², the second removes it. That holds while κ² < 1/ε, which is why
/// remainders below 1e-6 cannot be asked for.
///
/// # Errors
/// Those of [`Samples::of`]; [`Error::Value`] for a threshold out of range, modes that are not finite, or none left.
pub fn orthonormalise(raw: &SmoothBasis, pupil: &Pupil, smallest: f64) -> Result<Orthonormal> {
    if !(1e-6..1.0).contains(&smallest) {
        let text = format!("a smallest remainder of {smallest} is out of range: 1e-6 to below 1 is accepted");
        return Err(Error::Value(text));
    }
    let samples = Samples::of(pupil)?;
    let first = pass(raw, &samples, smallest)?;
    // What the first pass kept is independent by its own count: drop nothing more.
    let second = pass(&first.basis, &samples, 0.0)?;
    Ok(Orthonormal { basis: second.basis, dropped: first.dropped })
}

/// The Zernike modes of Noll indices `first` to `last`, orthonormal over `pupil`: also to piston, tip, tilt and every
/// other polynomial before `first`, so that nothing depends on the disc chosen.
///
/// # Errors
/// Those of [`orthonormalise`]; [`Error::Value`] for an empty range, or more modes than the pupil's samples can tell
/// apart.
pub fn zernike_basis(first: usize, last: usize, pupil: &Pupil) -> Result<SmoothBasis> {
    if first < 2 || last < first {
        let text =
            format!("Zernike modes {first} to {last} were asked for: the range starts at 2 and must not be empty");
        return Err(Error::Value(text));
    }
    let samples = Samples::of(pupil)?;
    let radius_m = samples.radius_m().max(pupil.grid.pitch_m());
    let raw = SmoothBasis::zernike(Zernikes::new(2..=last, radius_m)?);
    let all = orthonormalise(&raw, pupil, 1e-6)?;
    if let Some(lost) = all.dropped.first() {
        let text = format!(
            "{} cannot be told from the modes before it on a pupil of {} samples: use a last index below it",
            lost.name,
            samples.weights.len()
        );
        return Err(Error::Value(text));
    }
    Ok(all.basis.selected(&(first - 2..=last - 2).collect::<Vec<_>>()))
}

/// The modes of `exact` first, then those of `other` with the span of `exact` projected out; all orthonormal over
/// `pupil`, names kept. Modes of `other` of which less than `smallest` (a fraction of their RMS; 1e-3 is a good
/// choice) remains are left out and reported.
///
/// # Errors
/// Those of [`orthonormalise`].
pub fn join_exact(exact: &SmoothBasis, other: &SmoothBasis, pupil: &Pupil, smallest: f64) -> Result<Orthonormal> {
    orthonormalise(&exact.followed_by(other), pupil, smallest)
}

/// One pass: centre, then the inverse Cholesky factor of the Gram matrix.
fn pass(basis: &SmoothBasis, samples: &Samples, smallest: f64) -> Result<Orthonormal> {
    let (mean, products) = basis.moments(samples);
    let gram = Array2::from_shape_fn(products.dim(), |(i, j)| products[[i, j]] - mean[i] * mean[j]);
    if let Some(mode) = (0..basis.len()).find(|&mode| !products[[mode, mode]].is_finite()) {
        return Err(Error::Value(format!("mode {} is not finite over the pupil", basis.names()[mode])));
    }
    let mut factor = Cholesky { rows: Vec::new(), kept: Vec::new() };
    let mut dropped = Vec::new();
    for mode in 0..basis.len() {
        // Against the RMS with piston, so that a constant counts as spanned by piston.
        let total = products[[mode, mode]];
        let remainder2 = factor.push(&gram, mode, smallest * smallest * total);
        if let Some(left) = remainder2 {
            let remainder = if total > 0.0 { (left.max(0.0) / total).sqrt() } else { 0.0 };
            dropped.push(Dropped { name: basis.names()[mode].clone(), remainder });
        }
    }
    if factor.kept.is_empty() {
        return Err(Error::Value("no mode is left once piston is removed: at least one is needed".into()));
    }
    let names = factor.kept.iter().map(|&mode| basis.names()[mode].clone()).collect();
    let combination = factor.inverse(basis.len());
    Ok(Orthonormal { basis: basis.combined(names, &combination, &mean), dropped })
}

/// A Cholesky factor that grows by a row at a time and leaves out what is spanned already.
struct Cholesky {
    /// Lower-triangular rows, over the kept modes.
    rows: Vec<Vec<f64>>,
    kept: Vec<usize>,
}

impl Cholesky {
    /// Adds `mode`, unless its pivot is not above `smallest`: then the pivot is returned and nothing added.
    fn push(&mut self, gram: &Array2<f64>, mode: usize, smallest: f64) -> Option<f64> {
        let mut row: Vec<f64> = Vec::with_capacity(self.rows.len() + 1);
        for (other, &column) in self.rows.iter().zip(&self.kept) {
            let known: f64 = row.iter().zip(other).map(|(a, b)| a * b).sum();
            row.push((gram[[mode, column]] - known) / other[row.len()]);
        }
        let pivot = gram[[mode, mode]] - row.iter().map(|a| a * a).sum::<f64>();
        // A pivot at the level of rounding is no pivot, even where nothing else was asked for.
        if pivot <= smallest.max(1e-15 * gram[[mode, mode]]) {
            return Some(pivot);
        }
        row.push(pivot.sqrt());
        self.rows.push(row);
        self.kept.push(mode);
        None
    }

    /// The inverse of the factor, `[kept, modes]`, zero in the columns of modes left out.
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

//! The linear Gaussian step after a fit, which marginalises what that left out.

use crate::Result;
use crate::empirical_bayes::{CoefficientGroup, Posterior, maximise_marginal_likelihood};
use crate::linear_algebra::{sub_matrix, times_transposed};
use crate::modal::assess::fisher::pseudo_inverse;
use ndarray::{Array1, Array2, Axis};
use std::ops::Range;

/// Relative change of variances up to which another step would find the same.
pub(in crate::modal) const SAME: f64 = 0.05;

/// Normal equations of images about the point of their fit: the unknowns of the fit come first,
/// those that it left out, which are 0, follow.
pub(in crate::modal) struct Equations<'a> {
    /// Gauss-Newton matrix.
    pub(in crate::modal) information: &'a Array2<f64>,
    /// −½ of the gradient.
    pub(in crate::modal) score: &'a Array1<f64>,
    /// The unknowns of the fit.
    pub(in crate::modal) fitted: &'a Array1<f64>,
    /// Those of them that have a prior like those that the fit left out.
    pub(in crate::modal) tilts: Range<usize>,
    /// Inverse covariance of the prior of the others, 0 for `tilts`; `None` where they have none.
    pub(in crate::modal) precision: Option<Array2<f64>>,
    /// See [`crate::modal::assess::fisher::null_floor`].
    pub(in crate::modal) floor: f64,
    /// The pseudo-inverse of the part of the unknowns of the fit without `tilts`, where it is
    /// known.
    pub(in crate::modal) inverse: Option<Array2<f64>>,
}

/// What a step finds.
pub(in crate::modal) struct Step {
    /// Change of the unknowns of the fit.
    pub(in crate::modal) change: Array1<f64>,
    /// Their covariance, if what has a prior were known.
    pub(in crate::modal) noise: Array2<f64>,
    /// What that adds.
    pub(in crate::modal) added: Array2<f64>,
    /// Their covariance with what has a prior, `[unknown, with prior]`.
    pub(in crate::modal) with_left_out: Array2<f64>,
    /// Change of the unknowns with a prior, those of the fit first.
    pub(in crate::modal) with_prior_change: Array1<f64>,
    /// Of these.
    pub(in crate::modal) found: Posterior,
}

impl Step {
    /// The step that `equations` ask for, where the unknowns with a prior are in `groups`.
    ///
    /// # Errors
    /// [`crate::Error::Internal`] for values that are not finite.
    pub(in crate::modal) fn new(equations: &Equations, groups: &[CoefficientGroup]) -> Result<Self> {
        let Equations { information, score, fitted, tilts, .. } = equations;
        let count = fitted.len();
        let free: Vec<usize> = (0..count).filter(|unknown| !tilts.contains(unknown)).collect();
        let with_prior: Vec<usize> = tilts.clone().chain(count..score.len()).collect();
        let block = |rows: &[usize], columns: &[usize]| sub_matrix(information, rows, columns);
        let (mut own, mut slope) = (block(&free, &free), score.select(Axis(0), &free));
        if let Some(precision) = &equations.precision {
            own += &sub_matrix(precision, &free, &free);
            slope -= &precision.dot(*fitted).select(Axis(0), &free);
        }
        let inverse = equations.inverse.clone().map_or_else(|| pseudo_inverse(&own, equations.floor), Ok)?;
        // The matrices are symmetric.
        let cross = block(&with_prior, &free);
        let moves = times_transposed(cross.view(), inverse.view());
        let direct = inverse.dot(&slope);
        let left = block(&with_prior, &with_prior) - times_transposed(cross.view(), moves.view());
        let score = score.select(Axis(0), &with_prior) - cross.dot(&direct);
        let before: Array1<f64> =
            with_prior.iter().map(|&unknown| if unknown < count { fitted[unknown] } else { 0.0 }).collect();
        let score = score + left.dot(&before);
        let begun: Vec<_> = groups.iter().map(|group| group.clone().begun_at_moments(&left, &score)).collect();
        let found = maximise_marginal_likelihood(&left, &score, &begun)?;
        let with_prior_change = &found.coefficients_nm - &before;
        // Rows of the unknowns of the fit by those with a prior: free ones follow these, others are
        // among them.
        let mut follow = Array2::zeros((count, with_prior.len()));
        let (mut noise, mut change) = (Array2::zeros((count, count)), Array1::zeros(count));
        for ((&unknown, row), (own, direct)) in free.iter().zip(moves.columns()).zip(inverse.outer_iter().zip(direct)) {
            follow.row_mut(unknown).assign(&(-&row));
            own.iter().zip(&free).for_each(|(value, &other)| noise[[unknown, other]] = *value);
            change[unknown] = direct;
        }
        for (place, unknown) in tilts.clone().enumerate() {
            follow[[unknown, place]] = 1.0;
        }
        change += &follow.dot(&with_prior_change);
        let with_left_out = times_transposed(follow.view(), found.covariance_nm2.view());
        let added = times_transposed(with_left_out.view(), follow.view());
        Ok(Self { change, noise, added, with_left_out, with_prior_change, found })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::empirical_bayes::VarianceRule;
    use crate::linear_algebra::SpdInverse;

    /// Five unknowns of a fit, of which the last two have a prior here, and three that it left out:
    /// the posterior of all at once is the inverse of the sum of information and prior.
    #[test]
    fn the_step_is_the_posterior_of_all_unknowns_at_once() {
        let design = Array2::from_shape_fn((12, 8), |(i, j)| ((3 * i + 5 * j + i * j) % 11) as f64 / 5.0 - 1.0);
        let information = design.t().dot(&design);
        let score = Array1::from_shape_fn(8, |i| 0.3 * i as f64 - 1.0);
        let fitted = Array1::from(vec![0.5, -1.0, 2.0, 0.7, -0.4]);
        let mut precision = Array2::zeros((5, 5));
        precision[[1, 1]] = 0.8;
        precision[[1, 2]] = 0.1;
        precision[[2, 1]] = 0.1;
        let equations = Equations {
            information: &information,
            score: &score,
            fitted: &fitted,
            tilts: 3..5,
            precision: Some(precision.clone()),
            floor: 1e-14,
            inverse: None,
        };
        let group = |columns: Range<usize>, variance_nm2| CoefficientGroup {
            columns,
            variance_nm2,
            range_nm2: [0.0, f64::INFINITY],
            rule: VarianceRule::Fixed,
        };
        let step = Step::new(&equations, &[group(0..2, 0.25), group(2..5, 4.0)]).unwrap();
        let mut prior = Array2::from_diag(&Array1::from(vec![0.0, 0.0, 0.0, 4.0, 4.0, 0.25, 0.25, 0.25]));
        let mut own = prior.slice_mut(ndarray::s![..5, ..5]);
        own += &precision;
        let covariance = SpdInverse::new(&(&information + &prior)).unwrap().inverse;
        let mut before = Array1::zeros(8);
        before.slice_mut(ndarray::s![..5]).assign(&fitted);
        // The gradient of the prior at the fit belongs to the score.
        let change = covariance.dot(&(&score - &prior.dot(&before)));
        let close = |a: f64, b: f64| (a - b).abs() < 1e-10 * (1.0 + b.abs());
        assert!((0..5).all(|i| close(step.change[i], change[i])), "{} {change}", step.change);
        let found = &step.noise + &step.added;
        assert!(found.indexed_iter().all(|((i, j), value)| close(*value, covariance[[i, j]])), "{found} {covariance}");
        assert!((0..3).all(|i| close(step.with_prior_change[2 + i], change[5 + i])), "{change}");
    }
}

//! Empirical Bayes: prior variances (hyperparameters) of groups of coefficients at which the
//! marginal likelihood of the data is greatest.
//!
//! With `y = A·x + t`, t of covariance C and x of independent normal coefficients whose prior
//! variance λ is common to a group, the marginal likelihood p(y | λ) depends on the data through
//! `F = Aᵀ·C⁻¹·A` and `b = Aᵀ·C⁻¹·y` alone. It is maximised by Fisher's scoring in log λ (Harville
//! 1977, *J. Am. Statist. Assoc.* 72, 320): at the maximum λ of a group is the mean of x̂² + V over
//! its modes. A group without support in the data falls to 0, and its modes then add no error
//! to the others; with a uniform prior of √λ (Gelman 2006, *Bayesian Analysis* 1, 515) it falls to
//! what the data cannot exclude.

use crate::Result;
use crate::linear_algebra::SpdInverse;
use ndarray::{Array1, Array2, s};

/// Most steps; where the data constrain the variances half a dozen suffice.
const MAX_STEPS: usize = 40;
/// Increase of the objective, to first order in a step, below which the search ends: coefficients
/// are then within some 1e-3 of their error bars. Where 0.002 ended it, rounding decided on the
/// last step, and moved them by a quarter of an error bar.
const TOLERANCE: f64 = 1e-6;
/// Longest step of the logarithm of a variance.
const LONGEST_STEP: f64 = 2.0;
/// Added to the curvature by the logarithm of a variance of which the data say nothing.
const LEAST_CURVATURE: f64 = 1e-6;
/// A variance that is negligible beside those of static errors, and keeps the equations well posed,
/// nm².
pub const NEGLIGIBLE_NM2: f64 = 1e-2;

/// How the prior variance of a group follows from the data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum VarianceRule {
    /// It does not.
    Fixed,
    /// The most likely one.
    MostLikely,
    /// The one with the largest posterior density of log λ, where √λ has a uniform prior.
    UniformRms,
}

/// Group of coefficients with a common prior variance.
#[derive(Debug, Clone, PartialEq)]
pub struct CoefficientGroup {
    pub columns: std::ops::Range<usize>,
    /// Prior variance, or its initial value, nm².
    pub variance_nm2: f64,
    /// Smallest and largest variance that are found, nm².
    pub range_nm2: [f64; 2],
    pub rule: VarianceRule,
}

/// Posterior of the coefficients at the maximum of the marginal likelihood.
#[derive(Debug, Clone)]
pub struct Posterior {
    /// Posterior mean, nm.
    pub coefficients_nm: Array1<f64>,
    /// Posterior covariance, nm².
    pub covariance_nm2: Array2<f64>,
    /// Logarithm of the marginal likelihood, but for a constant of the data.
    pub log_marginal_likelihood: f64,
    /// Logarithm of the determinant of 1 + σ F σ, with the prior standard deviations σ.
    log_determinant: f64,
    /// Prior RMS of the coefficients of each group, nm.
    pub prior_rms_nm: Vec<f64>,
}

impl Posterior {
    /// Widens the prior of the first `count` coefficients for the errors of a previous correction
    /// by an estimate like this one.
    ///
    /// With `F` the information on these coefficients with all others marginalised, an estimate
    /// with a prior of `uncorrected_nm` leaves errors of covariance `E = (F + 1/uncorrected²)⁻¹`,
    /// so the prior becomes `prior_rms² + E`. The errors lie along the directions that the data
    /// constrain least, where the common variance, constrained by the other directions, would
    /// shrink the estimate and its error bars too much. A prior far above the errors changes
    /// nothing; with a prior of 0 the estimate is half of the data's.
    ///
    /// # Errors
    /// Where the equations cannot be solved.
    pub fn with_previous_correction(mut self, count: usize, prior_rms_nm: f64, uncorrected_nm: f64) -> Result<Self> {
        let own = s![..count, ..count];
        let precision = SpdInverse::new(&self.covariance_nm2.slice(own).to_owned())?.inverse;
        let mut information = precision.clone();
        information.diag_mut().iter_mut().for_each(|value| *value -= prior_rms_nm.powi(-2));
        let mut before = information.clone();
        before.diag_mut().iter_mut().for_each(|value| *value += uncorrected_nm.powi(-2));
        let mut prior_nm2 = SpdInverse::new(&before)?.inverse;
        prior_nm2.diag_mut().iter_mut().for_each(|nm2| *nm2 += prior_rms_nm * prior_rms_nm);
        let covariance_nm2 = SpdInverse::new(&(&SpdInverse::new(&prior_nm2)?.inverse + &information))?.inverse;
        let data_nm = precision.dot(&self.coefficients_nm.slice(s![..count]));
        let change_nm = covariance_nm2.dot(&data_nm) - self.coefficients_nm.slice(s![..count]);
        // The others, conditional on these, are unchanged: they change by regression on them.
        let regression = self.covariance_nm2.slice(s![count.., ..count]).dot(&precision);
        let shared_nm2 = regression.dot(&(&covariance_nm2 - &self.covariance_nm2.slice(own)));
        self.covariance_nm2.slice_mut(own).assign(&covariance_nm2);
        let mut part = self.covariance_nm2.slice_mut(s![count.., ..count]);
        part += &shared_nm2;
        let mut part = self.covariance_nm2.slice_mut(s![..count, count..]);
        part += &shared_nm2.t();
        let mut part = self.covariance_nm2.slice_mut(s![count.., count..]);
        part += &shared_nm2.dot(&regression.t());
        let mut part = self.coefficients_nm.slice_mut(s![count..]);
        part += &regression.dot(&change_nm);
        let mut part = self.coefficients_nm.slice_mut(s![..count]);
        part += &change_nm;
        Ok(self)
    }
}

/// Maximises the marginal likelihood over the variances of `groups` (which hold every column), from
/// the information F, nm⁻², and the right side b, nm⁻¹.
///
/// # Errors
/// Where the equations cannot be solved.
pub fn maximise_marginal_likelihood(
    information: &Array2<f64>,
    b: &Array1<f64>,
    groups: &[CoefficientGroup],
) -> Result<Posterior> {
    let mut variances: Vec<f64> = groups.iter().map(|group| group.variance_nm2).collect();
    let mut found = posterior(information, b, groups, &variances)?;
    for _ in 0..MAX_STEPS {
        let (step, gain) = scoring_step(&found, groups, &variances);
        if gain < TOLERANCE {
            break;
        }
        let mut share = 1.0;
        let better = loop {
            let each = variances.iter().zip(groups).zip(&step);
            let trial: Vec<f64> = each.map(|((nm2, group), step)| group.moved_nm2(*nm2, share * step)).collect();
            let next = posterior(information, b, groups, &trial)?;
            if rise([&found, &next], groups, [&variances, &trial]) >= 0.0 {
                break Some((trial, next));
            }
            share *= 0.5;
            if share * gain < TOLERANCE {
                break None;
            }
        };
        let Some(better) = better else { break };
        (variances, found) = better;
    }
    found.prior_rms_nm = variances.iter().map(|v| v.sqrt()).collect();
    Ok(found)
}

/// By how much the logarithm of what is maximised over the variances rises from one posterior to
/// another.
///
/// With b − F x = x/λ at each, ½ b·x rises by ½ Σ x₀ x₁ (1/λ₀ − 1/λ₁): of the size of the number of
/// coefficients. The difference of the two products is one of rounding where these are known a
/// thousand times better than their size: pistons of a micron to a tenth of a nanometre gave 10¹⁰,
/// of which rounding left 10⁴, and the search ended with bands of modes 30 times too wide.
fn rise(found: [&Posterior; 2], groups: &[CoefficientGroup], variances: [&[f64]; 2]) -> f64 {
    let [before, after] = found;
    let of_group = |(number, group): (usize, &CoefficientGroup)| {
        let [old_nm2, new_nm2] = variances.map(|nm2| nm2[number]);
        if old_nm2 == new_nm2 {
            return 0.0;
        }
        let along = |i: usize| before.coefficients_nm[i] * after.coefficients_nm[i];
        let products_nm2: f64 = group.columns.clone().map(along).sum();
        let of_level = if group.rule == VarianceRule::UniformRms { (new_nm2 / old_nm2).ln() } else { 0.0 };
        products_nm2 * (old_nm2.recip() - new_nm2.recip()) + of_level
    };
    let rise: f64 = groups.iter().enumerate().map(of_group).sum();
    0.5 * (rise - (after.log_determinant - before.log_determinant))
}

/// Fisher's scoring: the step of the logarithms of the variances, and what it gains to first order.
///
/// With A = D⁻¹ − D⁻¹ V D⁻¹ of the prior covariance D and the posterior one V, the slope by log λ
/// of a group of n coefficients is (Σ(x̂² + V)/λ − n)/2, and the expected curvature by those of two
/// groups Σ (λ A λ)²/(2λλ) over the pairs of their coefficients.
fn scoring_step(found: &Posterior, groups: &[CoefficientGroup], variances: &[f64]) -> (Vec<f64>, f64) {
    let slope = |(group, nm2): (&CoefficientGroup, &f64)| {
        let square_nm2 = |i: usize| found.coefficients_nm[i].powi(2) + found.covariance_nm2[[i, i]];
        let squares_nm2: f64 = group.columns.clone().map(square_nm2).sum();
        let of_level = if group.rule == VarianceRule::UniformRms { 0.5 } else { 0.0 };
        0.5 * (squares_nm2 / nm2 - group.columns.len() as f64) + of_level
    };
    let slopes: Vec<f64> = groups.iter().zip(variances).map(slope).collect();
    let is_free = |&group: &usize| {
        let ([least, largest], nm2) = (groups[group].range_nm2, variances[group]);
        let is_held = if slopes[group] < 0.0 { nm2 <= least } else { nm2 >= largest };
        groups[group].rule != VarianceRule::Fixed && !is_held
    };
    let free: Vec<usize> = (0..groups.len()).filter(is_free).collect();
    let curvature = Array2::from_shape_fn((free.len(), free.len()), |(row, column)| {
        let [one, other] = [free[row], free[column]];
        let scale = (variances[one] * variances[other]).sqrt().recip();
        let mut sum = 0.0;
        for i in groups[one].columns.clone() {
            for j in groups[other].columns.clone() {
                let own = if i == j { 1.0 } else { 0.0 };
                sum += (own - found.covariance_nm2[[i, j]] * scale).powi(2);
            }
        }
        0.5 * sum + if row == column { LEAST_CURVATURE } else { 0.0 }
    });
    let along: Array1<f64> = free.iter().map(|&group| slopes[group]).collect();
    let newton = SpdInverse::new(&curvature).map_or_else(|_| along.clone(), |inverse| inverse.inverse.dot(&along));
    // A step that is cut short in one variance may lead down; along the slopes it leads up.
    let cut = |long: Array1<f64>| long.mapv_into(|step| step.clamp(-LONGEST_STEP, LONGEST_STEP));
    let step = Some(cut(newton)).filter(|step| step.dot(&along) > 0.0).unwrap_or_else(|| cut(along.clone()));
    let gain = step.dot(&along);
    let mut of_all = vec![0.0; groups.len()];
    free.iter().zip(step).for_each(|(&group, step)| of_all[group] = step);
    (of_all, gain)
}

impl CoefficientGroup {
    /// This group, with the search for its variance begun at that of the group by itself by
    /// moments, because the expectation of Σ b² is λ tr F² + tr F, where that is smaller.
    pub(crate) fn begun_at_moments(self, information: &Array2<f64>, b: &Array1<f64>) -> Self {
        let (own, columns) = (information.slice(s![self.columns.clone(), self.columns.clone()]), self.columns.clone());
        let square: f64 = columns.map(|column| b[column].powi(2)).sum();
        let moment_nm2 = (square - own.diag().sum()) / own.iter().map(|value| value * value).sum::<f64>();
        if self.rule == VarianceRule::Fixed || !moment_nm2.is_finite() {
            return self;
        }
        Self { variance_nm2: moment_nm2.min(self.variance_nm2).max(self.range_nm2[0]), ..self }
    }

    /// The variance whose logarithm is `step` from that of `nm2`.
    fn moved_nm2(&self, nm2: f64, step: f64) -> f64 {
        match self.rule {
            VarianceRule::Fixed => nm2,
            _ => (nm2 * step.exp()).min(self.range_nm2[1]).max(self.range_nm2[0]),
        }
    }
}

/// Computes the posterior at given variances. With σ = √λ the matrix is `1 + σ·F·σ`, whose
/// eigenvalues are 1 or more.
fn posterior(
    information: &Array2<f64>,
    b: &Array1<f64>,
    groups: &[CoefficientGroup],
    variances: &[f64],
) -> Result<Posterior> {
    let mut sigma = Array1::zeros(b.len());
    for (group, variance) in groups.iter().zip(variances) {
        group.columns.clone().for_each(|i| sigma[i] = variance.sqrt());
    }
    let (across, down) = (sigma.view().insert_axis(ndarray::Axis(0)), sigma.view().insert_axis(ndarray::Axis(1)));
    let mut matrix = information * &across * down;
    matrix.diag_mut().iter_mut().for_each(|value| *value += 1.0);
    let inverse = SpdInverse::new(&matrix)?;
    let covariance_nm2 = &inverse.inverse * &across * down;
    let coefficients_nm = covariance_nm2.dot(b);
    let log_determinant = inverse.log_determinant;
    let log_marginal_likelihood = 0.5 * (coefficients_nm.dot(b) - log_determinant);
    let prior_rms_nm = Vec::new();
    Ok(Posterior { coefficients_nm, covariance_nm2, log_marginal_likelihood, log_determinant, prior_rms_nm })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(columns: std::ops::Range<usize>) -> CoefficientGroup {
        CoefficientGroup {
            columns,
            variance_nm2: 100.0,
            range_nm2: [NEGLIGIBLE_NM2, f64::INFINITY],
            rule: VarianceRule::MostLikely,
        }
    }

    #[test]
    fn the_rise_is_the_difference_of_what_is_maximised() {
        let mix = Array2::from_shape_fn((9, 6), |(i, j)| ((7 * i + 11 * j + i * j) as f64).sin());
        let (information, b) = (mix.t().dot(&mix), Array1::from(vec![3.0, -1.0, 0.5, 2.0, -0.3, 1.0]));
        let fixed = CoefficientGroup { rule: VarianceRule::Fixed, ..group(5..6) };
        let groups = [group(0..2), CoefficientGroup { rule: VarianceRule::UniformRms, ..group(2..5) }, fixed];
        let variances: [&[f64]; 2] = [&[4.0, 0.3, 2.0], &[1.5, 0.7, 2.0]];
        let [before, after] = variances.map(|nm2| posterior(&information, &b, &groups, nm2).unwrap());
        // The prior of the level of the second group.
        let levels = 0.5 * (0.7f64 / 0.3).ln();
        let difference = after.log_marginal_likelihood - before.log_marginal_likelihood + levels;
        let found = rise([&before, &after], &groups, variances);
        // Six terms of the size of 1: rounding is below 1e-15 in each.
        assert!((found - difference).abs() < 1e-13 && difference.abs() > 0.01, "{found} {difference}");
    }

    #[test]
    fn a_group_without_support_in_the_data_falls_to_zero() {
        // Ten coefficients measured with an error of 1 nm each: five of about 20 nm, five that are
        // only their errors.
        let measured_nm = [21.0, -18.0, 25.0, -22.0, 15.0, 0.9, -0.7, 0.4, -1.1, 0.2];
        let (information, b) = (Array2::eye(10), Array1::from(measured_nm.to_vec()));
        let found = maximise_marginal_likelihood(&information, &b, &[group(0..5), group(5..10)]).unwrap();
        let rms = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
        // The variance of the greatest marginal likelihood is the measured one less that of the
        // error.
        assert!(
            (found.prior_rms_nm[0] - (rms(&measured_nm[..5]).powi(2) - 1.0).sqrt()).abs() < 0.1,
            "{:?}",
            found.prior_rms_nm
        );
        // The second group has 0.74 nm RMS where errors alone have 1: the best variance is 0.
        assert!(found.prior_rms_nm[1] < 0.5, "{:?}", found.prior_rms_nm);
        assert!(rms(&found.coefficients_nm.to_vec()[5..]) < 0.1);
        // With its prior the error bar of an absent coefficient is smaller than the data's.
        assert!(found.covariance_nm2[[9, 9]] < 0.2 && (found.covariance_nm2[[0, 0]] - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_uniform_prior_leaves_what_the_data_cannot_exclude() {
        // Forty coefficients that are errors of 1 nm: the most likely variance is 0. The largest of
        // the posterior is where −(n/2) log(1+λ) − n/(2(1+λ)) + ½ log λ is: λ² n = (1+λ)².
        let b = Array1::from_shape_fn(40, |i| if i % 2 == 0 { 1.0 } else { -1.0 });
        let uniform = CoefficientGroup { rule: VarianceRule::UniformRms, ..group(0..40) };
        let found = maximise_marginal_likelihood(&Array2::eye(40), &b, &[uniform]).unwrap();
        let expected = (1.0 / (40f64.sqrt() - 1.0)).sqrt();
        // The search ends where a step gains less than 1e-6, of a curvature of some 0.5.
        assert!((found.prior_rms_nm[0] / expected - 1.0).abs() < 2e-3, "{:?} {expected}", found.prior_rms_nm);
    }

    #[test]
    fn fixed_group_keeps_its_variance_and_textbook_posterior() {
        let information = ndarray::array![[2.0, 0.5], [0.5, 1.0]];
        let b = ndarray::array![3.0, -1.0];
        let fixed = CoefficientGroup { rule: VarianceRule::Fixed, ..group(0..2) };
        let found = maximise_marginal_likelihood(&information, &b, &[fixed]).unwrap();
        // (F + 1/100)⁻¹ by hand.
        let (p, q, r) = (2.01, 0.5, 1.01);
        let determinant = p * r - q * q;
        let expected = [(r * b[0] - q * b[1]) / determinant, (p * b[1] - q * b[0]) / determinant];
        for (found, expected) in found.coefficients_nm.iter().zip(expected) {
            // Rounding of a two by two system of order 1.
            assert!((found - expected).abs() < 1e-12);
        }
        let log = 0.5 * (found.coefficients_nm.dot(&b) - (100.0f64.powi(2) * determinant).ln());
        assert!((found.log_marginal_likelihood - log).abs() < 1e-12 && found.prior_rms_nm == [10.0]);
    }

    #[test]
    fn a_previous_correction_adds_its_errors_to_the_prior() {
        let information = ndarray::array![[2.0, 0.5], [0.5, 1.0]];
        let b = ndarray::array![3.0, -1.0];
        let at = |nm2: [f64; 2]| posterior(&information, &b, &[0..1, 1..2].map(group), &nm2).unwrap();
        let found = at([0.3, 7.0]).with_previous_correction(1, 0.3f64.sqrt(), 30.0).unwrap();
        // Information on the first with the second marginalised.
        let marginal = 2.0 - 0.5 * 0.5 / (1.0 + 1.0 / 7.0);
        let expected = at([0.3 + 1.0 / (marginal + 1.0 / 900.0), 7.0]);
        // Rounding of two by two systems of order 1.
        assert!((&found.coefficients_nm - &expected.coefficients_nm).iter().all(|nm| nm.abs() < 1e-12), "{found:?}");
        assert!((&found.covariance_nm2 - &expected.covariance_nm2).iter().all(|nm2| nm2.abs() < 1e-12), "{found:?}");
        // A prior far above the errors is unchanged: 1/(1 + 1/f·λ) of the data, to the square of
        // that.
        let (strong, wider) = (at([1e6, 7.0]), at([1e6, 7.0]).with_previous_correction(1, 1e3, 30.0).unwrap());
        assert!((&strong.coefficients_nm - &wider.coefficients_nm).iter().all(|nm| nm.abs() < 1e-9));
    }

    #[test]
    fn error_bars_after_a_previous_correction_cover_its_errors() {
        use rand_distr::{Distribution, StandardNormal};
        let mut rng = crate::source::stream(3, 0);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        // Thirty coefficients, of which the first is known to 10 nm and the last to 1.
        let (count, draws) = (30, 60);
        let error_nm = |k: usize| 10.0 / (1.0 + 9.0 * k as f64 / (count - 1) as f64);
        let information = Array2::from_diag(&Array1::from_shape_fn(count, |k| error_nm(k).powi(-2)));
        let mut pulls = [0.0; 2];
        for _ in 0..draws {
            // The truth is the error of a previous estimate, and this one adds its own.
            let left_nm = Array1::from_shape_fn(count, |k| error_nm(k) * normal());
            let measured_nm = Array1::from_shape_fn(count, |k| left_nm[k] + error_nm(k) * normal());
            let plain =
                maximise_marginal_likelihood(&information, &information.dot(&measured_nm), &[group(0..count)]).unwrap();
            let wider = plain.clone().with_previous_correction(count, plain.prior_rms_nm[0], 1e3).unwrap();
            for (pull, found) in pulls.iter_mut().zip([plain, wider]) {
                let off_nm = &found.coefficients_nm - &left_nm;
                *pull += off_nm.dot(&off_nm) / found.covariance_nm2.diag().sum() / f64::from(draws);
            }
        }
        let [plain, wider] = pulls.map(f64::sqrt);
        // Some ten directions make most of it, sixty times: to 1/√1200 = 3 %. The prior variance
        // widens by up to a tenth.
        assert!((0.8..1.1).contains(&wider) && plain > 1.5, "{plain} {wider}");
    }
}

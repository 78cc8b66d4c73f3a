//! Gaussian prior of the Zernikes beyond the exact ones, with a marginalised level (hierarchical
//! Bayes).
//!
//! A model that leaves out modes, because one image does not show them, is biased by them in the
//! mean of many images. So they are fitted to each image without a prior, and the combined
//! coefficients c with covariance C get the prior once, for any number of images:
//!
//! ```text
//! b ~ N(0, τ² Q)      the modes with a prior, Q = R D Rᵀ
//! D = diag(n⁻²)       variances of the Zernikes by radial order n (the default of aberrations.ncpa_power_law)
//! R                   what the modes have of each Zernike: its part outside the modes without a prior
//! c' = c − C_b (C_bb + τ² Q)⁻¹ b          C' = C − C_b (C_bb + τ² Q)⁻¹ C_bᵀ
//! ```
//!
//! The level τ is not known. Its likelihood follows from b ~ N(0, C_bb + τ² Q); with a uniform
//! prior of the standard deviation τ (Gelman 2006, *Bayesian Analysis* 1, 515) mean and covariance
//! are averaged over its posterior. Where the images show no such modes the result is that of the
//! smaller basis, up to a few per cent of the error bars; where they show them it is that of a fit
//! without a prior. C_bb and Q are diagonalised together, so that each level takes a sum over the
//! modes.

use crate::Result;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modes::{Basis, noll_orders};
use crate::optimize::Metric;
use crate::pupil::Pupil;
use ndarray::{Array1, Array2, Axis, s};
use std::ops::Range;

/// Power of the radial order with which the variances of the Zernikes fall. Over the three orders
/// from 6 to 8 another power from −1 to −4 changes a variance by at most 1.8, which the level takes
/// up in part.
const POWER: f64 = -2.0;
/// Levels for each factor of ten: steps of 15 %, the standard deviation of a level that 24 modes
/// determine.
const LEVELS_A_DECADE: i32 = 16;
/// Levels reach from so many decades below the largest coefficient or error bar to one above it.
/// Below a hundredth of the smallest error bar a level has no effect, and error bars of modes
/// differ by less than a factor of a hundred.
const DECADES_BELOW: i32 = 5;
/// Eigenvalues of Q below this fraction of the largest are null: those of remainders of 1 % and
/// more are above.
const NULL_FLOOR: f64 = 1e-10;

/// Prior of some of the modes.
#[derive(Debug, Clone)]
pub(in crate::modal) struct Prior {
    /// The modes.
    modes: Range<usize>,
    /// W with Wᵀ Q W = 1.
    whitening: Array2<f64>,
}

impl Prior {
    /// The prior of the last `count` modes of `basis`, which are what `zernikes` (on the circle
    /// around `pupil`, the first of them `first_noll`) add to the others; `None` without modes.
    ///
    /// # Errors
    /// [`crate::Error::Shape`] for a basis of another pupil.
    pub(in crate::modal) fn new(
        basis: &Basis,
        count: usize,
        (zernikes, first_noll): (&Basis, usize),
        pupil: &Pupil,
    ) -> Result<Option<Self>> {
        if count == 0 {
            return Ok(None);
        }
        let (modes, weight) = (basis.len() - count..basis.len(), &pupil.amplitude / pupil.weight_sum());
        let mut shares = Array2::zeros((count, zernikes.len()));
        for (i, zernike) in zernikes.maps().outer_iter().enumerate() {
            let along = Array1::from(basis.along(&(&zernike * &weight))?);
            let sigma = (noll_orders(first_noll + i)?.0 as f64).powf(POWER / 2.0);
            shares.column_mut(i).assign(&(along.slice_move(s![modes.clone()]) * sigma));
        }
        let metric = Metric::from_gauss_newton(&shares.dot(&shares.t()), NULL_FLOOR)?;
        Ok(metric.whitening().map(|whitening| Self { modes, whitening: whitening.to_owned() }))
    }

    /// This prior where `count` other modes come before.
    pub(in crate::modal) fn behind(&self, count: usize) -> Self {
        Self { modes: self.modes.start + count..self.modes.end + count, whitening: self.whitening.clone() }
    }

    /// Posterior of coefficients whose likelihood is normal, with this mean and covariance.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a covariance that is not finite.
    pub(in crate::modal) fn posterior(&self, likelihood: &CombinedModes) -> Result<CombinedModes> {
        let CombinedModes { coefficients_nm, covariance_nm2 } = likelihood;
        let c = Array1::from(coefficients_nm.clone());
        let columns = covariance_nm2.slice(s![.., self.modes.clone()]).dot(&self.whitening);
        let (variances, rotation) = {
            let own = self.whitening.t().dot(&columns.slice(s![self.modes.clone(), ..]));
            crate::modes::symmetric_eigen(&own)?
        };
        // In these coordinates b has the covariance diag(variances), and the prior τ²·1.
        let variances = variances.mapv(|variance| variance.max(0.0));
        let b = rotation.t().dot(&self.whitening.t().dot(&c.slice(s![self.modes.clone()])));
        let columns = columns.dot(&rotation);
        if b.iter().chain(&variances).all(|value| *value == 0.0) {
            // No image depends on these modes.
            return Ok(likelihood.clone());
        }
        let levels = Levels::new(&b, &variances);
        let gains = levels.mean_gains(&variances);
        let c = c - columns.dot(&(&gains * &b));
        let less = (&columns * &gains).dot(&columns.t());
        let moved = &columns * &b;
        let covariance_nm2 =
            covariance_nm2 - &less + moved.dot(&levels.covariance_of_gains(&variances, &gains)).dot(&moved.t());
        Ok(CombinedModes { coefficients_nm: c.to_vec(), covariance_nm2 })
    }
}

/// Squared levels τ², nm², and the posterior probability of each.
struct Levels(Vec<(f64, f64)>);

impl Levels {
    /// From coefficients `b` of variances `variances`, with a prior of 1.
    fn new(b: &Array1<f64>, variances: &Array1<f64>) -> Self {
        let largest = b.iter().map(|b| b * b).chain(variances.iter().copied()).fold(f64::MIN_POSITIVE, f64::max).sqrt();
        let level = |step: i32| largest * 10f64.powf(f64::from(step) / f64::from(LEVELS_A_DECADE));
        let levels: Vec<f64> = (-DECADES_BELOW * LEVELS_A_DECADE..=LEVELS_A_DECADE).map(level).collect();
        let log_likelihood = |level: &f64| -> f64 {
            let terms = b.iter().zip(variances).map(|(b, variance)| {
                let whole = variance + level * level;
                -0.5 * (whole.ln() + b * b / whole)
            });
            // Uniform in the level, whose steps are proportional to it.
            terms.sum::<f64>() + level.ln()
        };
        let logarithms: Vec<f64> = levels.iter().map(log_likelihood).collect();
        let most = logarithms.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let total: f64 = logarithms.iter().map(|logarithm| (logarithm - most).exp()).sum();
        let probability = |logarithm: &f64| (logarithm - most).exp() / total;
        Self(levels.iter().zip(&logarithms).map(|(level, logarithm)| (level * level, probability(logarithm))).collect())
    }

    /// 1/(variance + τ²), mean over the levels.
    fn mean_gains(&self, variances: &Array1<f64>) -> Array1<f64> {
        variances.mapv(|variance| self.0.iter().map(|(square, p)| p / (variance + square)).sum())
    }

    /// Covariance of 1/(variance + τ²) over the levels.
    fn covariance_of_gains(&self, variances: &Array1<f64>, mean: &Array1<f64>) -> Array2<f64> {
        let mut sum = Array2::zeros((mean.len(), mean.len()));
        for (square, p) in &self.0 {
            let off = variances.mapv(|variance| 1.0 / (variance + square)) - mean;
            let column = off.insert_axis(Axis(1));
            sum.scaled_add(*p, &column.dot(&column.t()));
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    /// A prior of two of three modes, with Q = 1.
    fn prior() -> Prior {
        Prior { modes: 1..3, whitening: Array2::eye(2) }
    }

    #[test]
    fn coefficients_far_above_their_error_bars_stay() {
        let covariance_nm2 = array![[1.0, 0.5, 0.2], [0.5, 1.0, 0.1], [0.2, 0.1, 1.0]] * 1e-4;
        let given = CombinedModes { coefficients_nm: vec![3.0, 5.0, -4.0], covariance_nm2 };
        let found = prior().posterior(&given).unwrap();
        // A prior of some 5 nm pulls by 1e-4/25 of the coefficient, and its level changes that by
        // as much.
        for (a, b) in found.coefficients_nm.iter().zip(&given.coefficients_nm) {
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
        for (a, b) in found.covariance_nm2.iter().zip(&given.covariance_nm2) {
            assert!((a - b).abs() < 1e-4 * 1e-4, "{a} {b}");
        }
    }

    #[test]
    fn insignificant_coefficients_shrink_with_correlated_ones() {
        let covariance_nm2 = array![[1.0, 0.9, 0.0], [0.9, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let given = CombinedModes { coefficients_nm: vec![0.09, 0.1, 0.1], covariance_nm2 };
        let found = prior().posterior(&given).unwrap();
        // The first mode was wrong by 0.9 times the second: what leaves the second leaves it, too.
        let [free, shrunk] = [found.coefficients_nm[0], found.coefficients_nm[1]];
        assert!((0.0..0.1).contains(&shrunk), "{shrunk}");
        assert!((given.coefficients_nm[0] - free - 0.9 * (0.1 - shrunk)).abs() < 1e-12, "{free}");
        let variance = |i: usize| found.covariance_nm2[[i, i]];
        assert!(variance(0) > 1.0 - 0.81 && variance(0) < 1.0 && variance(1) > 0.0 && variance(1) < 1.0);
    }

    #[test]
    fn error_bars_are_those_of_the_errors() {
        // 400 draws of three modes: c = truth + noise, with truth of 0 or 2 standard deviations in
        // the modes with a prior.
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        let mut rng = rand_chacha::ChaCha12Rng::seed_from_u64(1);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        // Cholesky factor of the covariance of the noise, of one free mode and 24 with a prior.
        let factor = Array2::from_shape_fn((25, 25), |(i, j)| match (i, j) {
            (0, 0) => 1.0,
            (i, 0) => 0.3 * (i as f64).sin(),
            (i, j) if i == j => 0.8,
            _ => 0.0,
        });
        let covariance_nm2 = factor.dot(&factor.t());
        let prior = Prior { modes: 1..25, whitening: Array2::eye(24) };
        for level in [0.0, 0.7, 2.0] {
            let (mut squares, mut bars) = (0.0, 0.0);
            for _ in 0..400 {
                let truth = Array1::from_shape_fn(25, |i| if i == 0 { 0.0 } else { level * normal() });
                let noise = factor.dot(&Array1::from_shape_fn(25, |_| normal()));
                let given = CombinedModes {
                    coefficients_nm: (&truth + &noise).to_vec(),
                    covariance_nm2: covariance_nm2.clone(),
                };
                let found = prior.posterior(&given).unwrap();
                squares += (Array1::from(found.coefficients_nm) - &truth).mapv(|e| e * e).sum();
                bars += found.covariance_nm2.diag().sum();
            }
            // 400 draws of 25 numbers: 1 %, and 2 % of the prior of the level. Where the level is 0
            // its posterior is above it: the modes have error bars of half their noise, and errors
            // of a quarter.
            let pull = (squares / bars).sqrt();
            assert!(
                if level == 0.0 { (0.4..0.7).contains(&pull) } else { (0.95..1.06).contains(&pull) },
                "{level}: {pull}"
            );
        }
    }
}

//! How strong each group of modes is, by the evidence of the data: what they support is kept, what they do not is not.
//!
//! With `y = A·x + t`, t of covariance C and x of independent normal coefficients whose variance λ is common to a group,
//! the evidence p(y | λ) depends on the data through `F = Aᵀ·C⁻¹·A` and `b = Aᵀ·C⁻¹·y` alone. It is raised step by step
//! (expectation, maximisation): λ of a group becomes the mean of x̂² + V over its modes. A group that the data do not
//! support falls to nothing and costs the others nothing.

use crate::Result;
use crate::linear_algebra::Spd;
use ndarray::{Array1, Array2, s};

/// Steps after which the strengths stay as they are; where the data say something they are there in a dozen.
const MOST_STEPS: usize = 60;
/// A step that raises the logarithm of the evidence by less decides nothing.
const DECIDED: f64 = 1e-2;
/// Least variance of a group, nm²: (0.1 nm)² is nothing, and keeps the equations well posed.
const LEAST_NM2: f64 = 1e-2;

/// How the NCPA are described.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// Zernike polynomials, orthonormal over the pupil, a group for each radial order.
    Zernike {
        /// The last of these; fewer where the sensor does not tell as many modes apart.
        highest_order: usize,
    },
    /// Karhunen-Loève modes of the mirror, all that the sensor tells apart, in groups as large as the orders of Zernike
    /// polynomials. What they do not hold nothing corrects.
    Mirror,
}

/// A group of coefficients with one variance.
#[derive(Debug, Clone, PartialEq)]
pub struct Group {
    pub columns: std::ops::Range<usize>,
    /// Where the search begins, nm².
    pub variance_nm2: f64,
    /// Whether the variance stays there.
    pub fixed: bool,
}

/// The posterior at the strengths that the data support best.
#[derive(Debug, Clone)]
pub struct Evidence {
    /// The estimate, nm.
    pub coefficients_nm: Array1<f64>,
    /// Its covariance, nm².
    pub covariance_nm2: Array2<f64>,
    /// Logarithm of the evidence, but for a constant of the data.
    pub log_evidence: f64,
    /// Standard deviation of the coefficients of each group, nm.
    pub strengths_nm: Vec<f64>,
}

impl Evidence {
    /// This posterior, where what the first `count` coefficients measure may have been corrected before by an estimate like this
    /// one: their prior, till now `strength_nm` in all directions alike, is wider by what such an estimate leaves.
    ///
    /// With `F` the information on these coefficients once all others are marginalised, an estimate that takes them for
    /// `untouched_nm` beforehand leaves errors of covariance `E = (F + 1/untouched²)⁻¹`. They lie where the data tell least; a
    /// strength is judged where the data tell most, and pulls what is left there to nothing with error bars as small.
    /// Where the strength is far above the errors nothing changes; where it is nothing, half of what the data say is believed.
    ///
    /// # Errors
    /// Where the equations cannot be solved.
    pub(super) fn corrected_before(mut self, count: usize, strength_nm: f64, untouched_nm: f64) -> Result<Self> {
        let own = s![..count, ..count];
        let precision = Spd::of(&self.covariance_nm2.slice(own).to_owned())?.inverse;
        let mut information = precision.clone();
        information.diag_mut().iter_mut().for_each(|value| *value -= strength_nm.powi(-2));
        let mut before = information.clone();
        before.diag_mut().iter_mut().for_each(|value| *value += untouched_nm.powi(-2));
        let mut prior_nm2 = Spd::of(&before)?.inverse;
        prior_nm2.diag_mut().iter_mut().for_each(|nm2| *nm2 += strength_nm * strength_nm);
        let covariance_nm2 = Spd::of(&(&Spd::of(&prior_nm2)?.inverse + &information))?.inverse;
        let of_data = precision.dot(&self.coefficients_nm.slice(s![..count]));
        let moved_nm = covariance_nm2.dot(&of_data) - self.coefficients_nm.slice(s![..count]);
        // Given these coefficients the others are as before: they follow by regression on them.
        let follow = self.covariance_nm2.slice(s![.., ..count]).dot(&precision);
        let wider_nm2 = &covariance_nm2 - &self.covariance_nm2.slice(own);
        self.covariance_nm2 += &follow.dot(&wider_nm2).dot(&follow.t());
        self.coefficients_nm += &follow.dot(&moved_nm);
        Ok(self)
    }
}

/// Finds the strengths of `groups` (which hold every column) from the information F, per nm², and `b`, per nm.
///
/// # Errors
/// Where the equations cannot be solved.
pub fn strongest(information: &Array2<f64>, b: &Array1<f64>, groups: &[Group]) -> Result<Evidence> {
    let mut variances: Vec<f64> = groups.iter().map(|group| group.variance_nm2).collect();
    let mut before = f64::NEG_INFINITY;
    for step in 1.. {
        let mut found = posterior(information, b, groups, &variances)?;
        if found.log_evidence - before < DECIDED || step == MOST_STEPS {
            found.strengths_nm = variances.iter().map(|v| v.sqrt()).collect();
            return Ok(found);
        }
        before = found.log_evidence;
        for (variance, group) in variances.iter_mut().zip(groups).filter(|(_, group)| !group.fixed) {
            let of = |i: usize| found.coefficients_nm[i].powi(2) + found.covariance_nm2[[i, i]];
            *variance = (group.columns.clone().map(of).sum::<f64>() / group.columns.len() as f64).max(LEAST_NM2);
        }
    }
    unreachable!("the loop ends at its last step")
}

/// The posterior at given variances. With σ = √λ the matrix is `1 + σ·F·σ`, whose eigenvalues are 1 or more.
fn posterior(information: &Array2<f64>, b: &Array1<f64>, groups: &[Group], variances: &[f64]) -> Result<Evidence> {
    let mut sigma = Array1::zeros(b.len());
    for (group, variance) in groups.iter().zip(variances) {
        group.columns.clone().for_each(|i| sigma[i] = variance.sqrt());
    }
    let (across, down) = (sigma.view().insert_axis(ndarray::Axis(0)), sigma.view().insert_axis(ndarray::Axis(1)));
    let mut matrix = information * &across * down;
    matrix.diag_mut().iter_mut().for_each(|value| *value += 1.0);
    let inverse = Spd::of(&matrix)?;
    let covariance_nm2 = &inverse.inverse * &across * down;
    let coefficients_nm = covariance_nm2.dot(b);
    let log_evidence = 0.5 * (coefficients_nm.dot(b) - inverse.log_determinant);
    Ok(Evidence { coefficients_nm, covariance_nm2, log_evidence, strengths_nm: Vec::new() })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(columns: std::ops::Range<usize>) -> Group {
        Group { columns, variance_nm2: 100.0, fixed: false }
    }

    #[test]
    fn what_the_data_do_not_support_falls_to_nothing() {
        // Ten coefficients seen with an error of 1 nm each: five of about 20 nm, five that are only their errors.
        let seen = [21.0, -18.0, 25.0, -22.0, 15.0, 0.9, -0.7, 0.4, -1.1, 0.2];
        let (information, b) = (Array2::eye(10), Array1::from(seen.to_vec()));
        let found = strongest(&information, &b, &[group(0..5), group(5..10)]).unwrap();
        let rms = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
        // The variance of the best evidence is that of what is seen less that of its error.
        assert!(
            (found.strengths_nm[0] - (rms(&seen[..5]).powi(2) - 1.0).sqrt()).abs() < 0.1,
            "{:?}",
            found.strengths_nm
        );
        // The second group shows 0.74 nm where errors alone make 1: the best strength is 0, which the steps approach ever more
        // slowly; they end where one gains less than 0.01.
        assert!(found.strengths_nm[1] < 0.5, "{:?}", found.strengths_nm);
        assert!(rms(&found.coefficients_nm.to_vec()[5..]) < 0.1);
        // And with its prior the error bar of what is not there is smaller than the data's.
        assert!(found.covariance_nm2[[9, 9]] < 0.2 && (found.covariance_nm2[[0, 0]] - 1.0).abs() < 0.01);
    }

    #[test]
    fn a_fixed_group_stays_and_the_posterior_is_the_textbooks() {
        let information = ndarray::array![[2.0, 0.5], [0.5, 1.0]];
        let b = ndarray::array![3.0, -1.0];
        let fixed = Group { fixed: true, ..group(0..2) };
        let found = strongest(&information, &b, &[fixed]).unwrap();
        // (F + 1/100)⁻¹ by hand.
        let (p, q, r) = (2.01, 0.5, 1.01);
        let determinant = p * r - q * q;
        let expected = [(r * b[0] - q * b[1]) / determinant, (p * b[1] - q * b[0]) / determinant];
        for (found, expected) in found.coefficients_nm.iter().zip(expected) {
            // Rounding of a two by two system of order 1.
            assert!((found - expected).abs() < 1e-12);
        }
        let log = 0.5 * (found.coefficients_nm.dot(&b) - (100.0f64.powi(2) * determinant).ln());
        assert!((found.log_evidence - log).abs() < 1e-12 && found.strengths_nm == [10.0]);
    }

    #[test]
    fn what_was_corrected_before_has_the_prior_of_its_errors_beside() {
        let information = ndarray::array![[2.0, 0.5], [0.5, 1.0]];
        let b = ndarray::array![3.0, -1.0];
        let at = |nm2: [f64; 2]| posterior(&information, &b, &[0..1, 1..2].map(group), &nm2).unwrap();
        let found = at([0.3, 7.0]).corrected_before(1, 0.3f64.sqrt(), 30.0).unwrap();
        // What the first is known by once the second is marginalised.
        let marginal = 2.0 - 0.5 * 0.5 / (1.0 + 1.0 / 7.0);
        let expected = at([0.3 + 1.0 / (marginal + 1.0 / 900.0), 7.0]);
        // Rounding of two by two systems of order 1.
        assert!((&found.coefficients_nm - &expected.coefficients_nm).iter().all(|nm| nm.abs() < 1e-12), "{found:?}");
        assert!((&found.covariance_nm2 - &expected.covariance_nm2).iter().all(|nm2| nm2.abs() < 1e-12), "{found:?}");
        // A strength far above the errors stays what it was: 1/(1 + 1/f·λ) of the data, to the square of that.
        let (strong, wider) = (at([1e6, 7.0]), at([1e6, 7.0]).corrected_before(1, 1e3, 30.0).unwrap());
        assert!((&strong.coefficients_nm - &wider.coefficients_nm).iter().all(|nm| nm.abs() < 1e-9));
    }

    #[test]
    fn error_bars_of_what_an_estimate_left_behind_hold_it() {
        use rand_distr::{Distribution, StandardNormal};
        let mut rng = crate::source::stream(3, 0);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        // Thirty coefficients, of which the first is known to 10 nm and the last to 1.
        let (count, draws) = (30, 60);
        let error_nm = |k: usize| 10.0 / (1.0 + 9.0 * k as f64 / (count - 1) as f64);
        let information = Array2::from_diag(&Array1::from_shape_fn(count, |k| error_nm(k).powi(-2)));
        let mut pulls = [0.0; 2];
        for _ in 0..draws {
            // What was left has the errors of such an estimate, and this one makes its own.
            let left_nm = Array1::from_shape_fn(count, |k| error_nm(k) * normal());
            let seen_nm = Array1::from_shape_fn(count, |k| left_nm[k] + error_nm(k) * normal());
            let plain = strongest(&information, &information.dot(&seen_nm), &[group(0..count)]).unwrap();
            let wider = plain.clone().corrected_before(count, plain.strengths_nm[0], 1e3).unwrap();
            for (pull, found) in pulls.iter_mut().zip([plain, wider]) {
                let off_nm = &found.coefficients_nm - &left_nm;
                *pull += off_nm.dot(&off_nm) / found.covariance_nm2.diag().sum() / f64::from(draws);
            }
        }
        let [plain, wider] = pulls.map(f64::sqrt);
        // Some ten directions make most of it, sixty times: to 1/√1200 = 3 %. What the strength adds widens by up to a tenth.
        assert!((0.8..1.1).contains(&wider) && plain > 1.5, "{plain} {wider}");
    }
}

//! Motion of each mode by itself: whether it moves as the others of its block do, or more.
//!
//! The modes of a block drift alike, as a rule. Some do not: a focus that breathes with the
//! temperature or with the air moves by several nm where the other modes rest. Each coordinate has
//! two hypotheses,
//!
//! ```text
//! alike: the rate of the block            own: a rate of its own, and a part that is new in each image (white, of the standard deviation b),
//! ```
//!
//! the second with a grid of rates and of b, each of which runs a scalar filter. Posterior
//! probabilities follow from the likelihoods of the innovations. The filter uses the posterior
//! means of rate² and b², so that after few images, when little is excluded, it believes little. A
//! coordinate that is more likely unsteady than [`UNSTEADY`] is left out of the search for steps: a
//! slow oscillation is no random walk, and what the walk does not predict of it must not be taken
//! for a step.

use super::bytes::{ByteReader, Writer, damaged};
use super::scalar_filter::ScalarFilter;
use crate::Result;
use ndarray::{Array1, Array2, Axis};

/// Rates, nm/√h, and standard deviations of the white part, nm: half decades. Between two of them
/// the likelihood of a hundred images changes by what one image shows.
const RATES_NM_PER_SQRT_HOUR: [f64; 7] = [0.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0];
const WHITE_NM: [f64; 7] = [0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0];
const CELLS: usize = RATES_NM_PER_SQRT_HOUR.len() * WHITE_NM.len();
/// Probability that a mode has a motion of its own, before there are images.
const PRIOR_OWN: f64 = 0.1;
/// Probability of more motion than that of the block, from which on a coordinate is left out of the
/// search for steps: of coordinates that move alike one in a hundred reaches it at any time
/// (Ville's inequality: odds of 9 in 1 from 1 in 9).
const UNSTEADY: f64 = 0.9;

/// The motions of some coordinates.
#[derive(Debug, Clone)]
pub(super) struct ModeMotion {
    /// Of the grid and, last, of the block's rate: state, variance and log-likelihood,
    /// `[cell, coordinate]`.
    states_nm: Array2<f64>,
    variances_nm2: Array2<f64>,
    log_likelihood: Array2<f64>,
}

/// What is believed of the motion of some coordinates.
#[derive(Debug, Clone, Default)]
pub(super) struct Believed {
    /// Posterior mean of rate², nm²/h.
    pub(super) rate2_nm2_per_hour: Array1<f64>,
    /// Posterior mean of the variance of the part that is new in each image, nm².
    pub(super) white_nm2: Array1<f64>,
    pub(super) is_unsteady: Vec<bool>,
}

fn cell(number: usize) -> [f64; 2] {
    [RATES_NM_PER_SQRT_HOUR[number / WHITE_NM.len()], WHITE_NM[number % WHITE_NM.len()]]
}

impl ModeMotion {
    /// From the first observation.
    pub(super) fn new(z_nm: &Array1<f64>, variances_nm2: &Array1<f64>) -> Self {
        let dim = (CELLS + 1, z_nm.len());
        let white_nm2 = |number: usize| if number < CELLS { cell(number)[1].powi(2) } else { 0.0 };
        Self {
            states_nm: Array2::from_shape_fn(dim, |(_, at)| z_nm[at]),
            variances_nm2: Array2::from_shape_fn(dim, |(number, at)| variances_nm2[at] + white_nm2(number)),
            log_likelihood: Array2::zeros(dim),
        }
    }

    /// The next observation, `hours` after the one before; `alike` is the rate of the block, nm/√h,
    /// which has learnt it already.
    pub(super) fn learn(&mut self, z_nm: &Array1<f64>, variances_nm2: &Array1<f64>, hours: f64, alike: f64) {
        for number in 0..=CELLS {
            let [rate, white_nm] = if number < CELLS { cell(number) } else { [alike, 0.0] };
            let (added_nm2, white_nm2) = (rate * rate * hours, white_nm * white_nm);
            let states = self.states_nm.row_mut(number).into_iter().zip(self.variances_nm2.row_mut(number));
            let observed = z_nm.iter().zip(variances_nm2).zip(self.log_likelihood.row_mut(number));
            for ((state_nm, variance_nm2), ((&z_nm, &error_nm2), log_likelihood)) in states.zip(observed) {
                let mut filter = ScalarFilter { state_nm: *state_nm, variance_nm2: *variance_nm2 };
                *log_likelihood += filter.learn(z_nm, error_nm2 + white_nm2, added_nm2);
                (*state_nm, *variance_nm2) = (filter.state_nm, filter.variance_nm2);
            }
        }
    }

    /// What follows, where `alike` is the rate of the block, nm/√h.
    pub(super) fn believed(&self, alike: f64) -> Believed {
        let mut believed = Believed::default();
        let (mut rates2, mut whites_nm2) = (Vec::new(), Vec::new());
        for column in self.log_likelihood.axis_iter(Axis(1)) {
            let most = column.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let (mut total, mut rate2, mut white_nm2, mut unsteady) = (0.0, 0.0, 0.0, 0.0);
            for (number, log_likelihood) in column.iter().enumerate() {
                let (prior, [rate, white_nm]) = if number < CELLS {
                    (PRIOR_OWN / CELLS as f64, cell(number))
                } else {
                    (1.0 - PRIOR_OWN, [alike, 0.0])
                };
                let weight = prior * (log_likelihood - most).exp();
                total += weight;
                rate2 += weight * rate * rate;
                white_nm2 += weight * white_nm * white_nm;
                if rate > alike || white_nm > 0.0 {
                    unsteady += weight;
                }
            }
            rates2.push(rate2 / total);
            whites_nm2.push(white_nm2 / total);
            believed.is_unsteady.push(unsteady > UNSTEADY * total);
        }
        (believed.rate2_nm2_per_hour, believed.white_nm2) = (rates2.into(), whites_nm2.into());
        believed
    }

    pub(super) fn write(&self, writer: &mut Writer) {
        [&self.states_nm, &self.variances_nm2, &self.log_likelihood].into_iter().for_each(|one| writer.matrix(one));
    }

    pub(super) fn read(coordinates: usize, reader: &mut ByteReader) -> Result<Self> {
        let (states_nm, variances_nm2) = (reader.matrix()?, reader.matrix()?);
        let read = Self { states_nm, variances_nm2, log_likelihood: reader.matrix()? };
        let fits = [&read.states_nm, &read.variances_nm2, &read.log_likelihood];
        let wanted = (CELLS + 1, coordinates);
        if fits.iter().all(|one| one.dim() == wanted) { Ok(read) } else { Err(damaged()) }
    }
}

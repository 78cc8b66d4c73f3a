//! Rate of the drift, by maximum likelihood of the innovations: a bank of filters, one for each
//! rate of a grid.
//!
//! The coordinates of a block (segments, or NCPA) drift alike and independently of each other. So
//! each member of the bank is a set of scalar filters, one a coordinate, with the diagonal of each
//! estimate's covariance: a composite likelihood, which neglects correlations of the errors and is
//! consistent all the same (Varin, Reid & Firth 2011, Stat. Sinica 21, 5). For segments, whose
//! coordinates are eigenvectors of the first covariance, and unchanged covariances it is the
//! likelihood of the block's estimates itself.

use super::bytes::{ByteReader, Writer, damaged};
use super::scalar_filter::ScalarFilter;
use crate::Result;
use ndarray::{Array2, ArrayView1};

/// Rates of the grid: from 0.1 to 10⁴ nm/√h, eight a decade.
const RATES: usize = 41;
const LEAST_NM_PER_SQRT_HOUR: f64 = 0.1;
const PER_DECADE: f64 = 8.0;
/// Prior of the rate: log-normal about 10 nm/√h with a standard deviation of a decade. It decides
/// alone before there are innovations, and weighs less than one innovation afterwards.
const PRIOR_NM_PER_SQRT_HOUR: f64 = 10.0;

/// A rate, learnt or given.
#[derive(Debug, Clone)]
pub(super) struct DriftRate {
    given: Option<f64>,
    bank: Option<Bank>,
    current: f64,
}

/// Scalar filters and their log-likelihoods, `[rate, coordinate]`.
#[derive(Debug, Clone)]
struct Bank {
    states_nm: Array2<f64>,
    variances_nm2: Array2<f64>,
    log_likelihood: Array2<f64>,
}

impl DriftRate {
    pub(super) fn new(given: Option<f64>) -> Self {
        Self { given, bank: None, current: given.unwrap_or(PRIOR_NM_PER_SQRT_HOUR) }
    }

    /// Whether it is given, so that nothing is learnt.
    pub(super) fn is_given(&self) -> bool {
        self.given.is_some()
    }

    /// nm/√h.
    pub(super) fn nm_per_sqrt_hour(&self) -> f64 {
        self.current
    }

    /// Variance that a coordinate gains in `hours`, nm².
    pub(super) fn added_nm2(&self, hours: f64) -> f64 {
        self.current.powi(2) * hours
    }

    /// The next observation of the block, `hours` after the one before. The rate is that of the
    /// coordinates that are not `left_out`, of all where it has none.
    pub(super) fn learn(
        &mut self,
        z_nm: ArrayView1<f64>,
        variances_nm2: ArrayView1<f64>,
        hours: f64,
        left_out: &[bool],
    ) {
        if self.given.is_some() || z_nm.is_empty() {
            return;
        }
        let Some(bank) = &mut self.bank else {
            let repeat = |row: ArrayView1<f64>| Array2::from_shape_fn((RATES, row.len()), |(_, at)| row[at]);
            let (states_nm, variances_nm2) = (repeat(z_nm), repeat(variances_nm2));
            let log_likelihood = Array2::zeros(states_nm.dim());
            self.bank = Some(Bank { states_nm, variances_nm2, log_likelihood });
            return;
        };
        for rate in 0..RATES {
            bank.step(rate, z_nm, variances_nm2, hours);
        }
        self.current = bank.most_likely(left_out);
    }

    pub(super) fn write(&self, writer: &mut Writer) {
        writer.real(self.current);
        writer.number(usize::from(self.bank.is_some()));
        if let Some(bank) = &self.bank {
            writer.matrix(&bank.states_nm);
            writer.matrix(&bank.variances_nm2);
            writer.matrix(&bank.log_likelihood);
        }
    }

    pub(super) fn read(given: Option<f64>, coordinates: usize, reader: &mut ByteReader) -> Result<Self> {
        let current = reader.real()?;
        let mut bank = None;
        if reader.number()? == 1 {
            let (states_nm, variances_nm2) = (reader.matrix()?, reader.matrix()?);
            let read = Bank { states_nm, variances_nm2, log_likelihood: reader.matrix()? };
            let wanted = (RATES, coordinates);
            let matrices = [&read.states_nm, &read.variances_nm2, &read.log_likelihood];
            if matrices.iter().any(|one| one.dim() != wanted) {
                return Err(damaged());
            }
            bank = Some(read);
        }
        Ok(Self { given, bank, current: given.unwrap_or(current) })
    }
}

fn rate_nm_per_sqrt_hour(place: f64) -> f64 {
    LEAST_NM_PER_SQRT_HOUR * 10f64.powf(place / PER_DECADE)
}

impl Bank {
    fn step(&mut self, rate: usize, z_nm: ArrayView1<f64>, variances_nm2: ArrayView1<f64>, hours: f64) {
        let added_nm2 = rate_nm_per_sqrt_hour(rate as f64).powi(2) * hours;
        let states = self.states_nm.row_mut(rate).into_iter().zip(self.variances_nm2.row_mut(rate));
        let observed = z_nm.into_iter().zip(variances_nm2).zip(self.log_likelihood.row_mut(rate));
        for ((state_nm, variance_nm2), ((&z_nm, &error_nm2), log_likelihood)) in states.zip(observed) {
            let mut filter = ScalarFilter { state_nm: *state_nm, variance_nm2: *variance_nm2 };
            *log_likelihood += filter.learn(z_nm, error_nm2, added_nm2);
            (*state_nm, *variance_nm2) = (filter.state_nm, filter.variance_nm2);
        }
    }

    /// Rate of the highest posterior density, by the parabola through the best of the grid and its
    /// neighbours.
    fn most_likely(&self, left_out: &[bool]) -> f64 {
        let prior_place = PER_DECADE * (PRIOR_NM_PER_SQRT_HOUR / LEAST_NM_PER_SQRT_HOUR).log10();
        let is_left = |at: usize| left_out.get(at).copied().unwrap_or(false);
        let has_others = (0..self.log_likelihood.ncols()).any(|at| !is_left(at));
        let posteriors: Vec<f64> = (self.log_likelihood.rows().into_iter().enumerate())
            .map(|(rate, row)| {
                let decades = (rate as f64 - prior_place) / PER_DECADE;
                let used = row.iter().enumerate().filter(|(at, _)| !(has_others && is_left(*at)));
                used.map(|(_, log_likelihood)| log_likelihood).sum::<f64>() - 0.5 * decades * decades
            })
            .collect();
        let posterior = |rate: usize| posteriors[rate];
        let best = (0..RATES).fold(0, |best, rate| if posterior(rate) > posterior(best) { rate } else { best });
        let mut place = best as f64;
        if best > 0 && best + 1 < RATES {
            let [below, at, above] = [best - 1, best, best + 1].map(posterior);
            let bend = below - 2.0 * at + above;
            if bend < 0.0 {
                place += (0.5 * (below - above) / bend).clamp(-0.5, 0.5);
            }
        }
        rate_nm_per_sqrt_hour(place)
    }
}

//! Normal likelihoods of the modes from several channels, and their combination by generalised
//! least squares: see [`super`].

use crate::modal::assess::fisher::{self, null_floor, pseudo_inverse};
use crate::{Error, Result};
use ndarray::{Array1, Array2, Axis, concatenate, s};

/// Normal likelihood of the modes, from one channel.
#[derive(Clone)]
pub(super) struct Likelihood {
    /// ĉ, nm.
    pub(super) coefficients_nm: Array1<f64>,
    /// Λ, per nm².
    pub(super) information: Array2<f64>,
    /// p, nm.
    pub(super) diversity_nm: Array1<f64>,
}

/// Normal equations and their solution.
#[derive(Clone)]
pub(super) struct Normal {
    /// Modes, and behind them δ where it is unknown.
    pub(super) solution: Array1<f64>,
    pub(super) covariance: Array2<f64>,
    /// N.
    pub(super) matrix: Array2<f64>,
    pub(super) has_amplitude: bool,
    /// Inverse variance of the prior of δ; 0 for none.
    pub(super) prior: f64,
}

impl Normal {
    pub(super) fn new(likelihoods: &[Likelihood], has_amplitude: bool, prior: f64) -> Result<Self> {
        let modes = likelihoods[0].coefficients_nm.len();
        let size = modes + usize::from(has_amplitude);
        let (mut matrix, mut right) = (Array2::zeros((size, size)), Array1::zeros(size));
        for channel in likelihoods {
            let design = design(channel, has_amplitude)?;
            let weighed = design.dot(&channel.information);
            matrix += &weighed.dot(&design.t());
            right += &weighed.dot(&channel.coefficients_nm);
        }
        if has_amplitude {
            matrix[[modes, modes]] += prior;
        }
        let covariance = pseudo_inverse(&matrix, null_floor(size, size))?;
        Ok(Self { solution: covariance.dot(&right), covariance, matrix, has_amplitude, prior })
    }

    /// δ and its error bar, where it is unknown.
    pub(super) fn amplitude(&self) -> Option<(f64, f64)> {
        let last = self.solution.len() - 1;
        self.has_amplitude.then(|| (self.solution[last], self.covariance[[last, last]].max(0.0).sqrt()))
    }

    /// Share of the information on δ that the modes leave.
    pub(super) fn share_of_amplitude(&self, likelihoods: &[Likelihood]) -> f64 {
        let all: f64 = likelihoods
            .iter()
            .map(|channel| channel.diversity_nm.dot(&channel.information.dot(&channel.diversity_nm)))
            .sum();
        let last = self.solution.len() - 1;
        // In a null direction N⁺ has a variance, too, and the part of N along δ that the modes
        // reproduce is what matters.
        let modes = self.matrix.slice(s![..last, ..last]).to_owned();
        let cross = self.matrix.slice(s![..last, last]);
        let reproduced =
            pseudo_inverse(&modes, null_floor(last, last)).map_or(all, |inverse| cross.dot(&inverse.dot(&cross)));
        if all > 0.0 { ((all - reproduced) / all).max(0.0) } else { 0.0 }
    }

    /// Reduced χ² of the channels about the solution, and its degrees of freedom; (1, 0) where
    /// there are none.
    pub(super) fn disagreement(&self, likelihoods: &[Likelihood]) -> (f64, f64) {
        let rank = |matrix: &Array2<f64>| fisher::rank(matrix, null_floor(matrix.nrows(), matrix.nrows())) as f64;
        let (mut chi2, mut freedom) = (0.0, -rank(&self.matrix));
        for channel in likelihoods {
            let Ok(design) = design(channel, self.has_amplitude) else { continue };
            let off = &channel.coefficients_nm - &design.t().dot(&self.solution);
            chi2 += off.dot(&channel.information.dot(&off));
            freedom += rank(&channel.information);
        }
        if let Some((delta, _)) = self.amplitude().filter(|_| self.prior > 0.0) {
            (chi2, freedom) = (chi2 + delta * delta * self.prior, freedom + 1.0);
        }
        if freedom >= 1.0 { (chi2 / freedom, freedom) } else { (1.0, 0.0) }
    }
}

/// [1 p]ᵀ of a channel, or 1.
pub(super) fn design(channel: &Likelihood, has_amplitude: bool) -> Result<Array2<f64>> {
    let own = Array2::eye(channel.coefficients_nm.len());
    if !has_amplitude {
        return Ok(own);
    }
    let last = channel.diversity_nm.view().insert_axis(Axis(0));
    concatenate(Axis(0), &[own.view(), last]).map_err(|error| Error::Internal(error.to_string()))
}

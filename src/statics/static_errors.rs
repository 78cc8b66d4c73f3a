//! Static errors: estimated pistons and NCPA with their posterior covariance.

use crate::modal::GlobalMotions;
use ndarray::{Array1, Array2};

/// Least exponent with which the variance of a mode falls with its radial order: polished glass and
/// turbulence have 3.7 and more.
const MIN_EXPONENT: f64 = 3.0;

/// Static errors of a telescope.
#[derive(Debug, Clone)]
pub struct StaticErrors {
    /// Piston of each segment, nm.
    pub pistons_nm: Vec<f64>,
    /// Tip of each segment, then tilt of each, nm RMS over the segment; empty where they are not
    /// estimated.
    pub tilts_nm: Vec<f64>,
    /// Coefficients of the NCPA's modes, nm.
    pub ncpa_nm: Vec<f64>,
    /// Coefficients, in the same modes, of the part of the mean wavefront that the sensor measured
    /// too, nm: turbulence that did not average, and the drift of actuators to which the sensor is
    /// nearly blind. 0 without telemetry, which alone separates it from NCPA.
    pub common_path_nm: Vec<f64>,
    /// Posterior covariance of pistons, tilts and NCPA in turn, nm².
    pub covariance_nm2: Array2<f64>,
    /// Logarithm of the marginal likelihood, to compare bases on the same wavefronts.
    pub log_marginal_likelihood: f64,
    /// Residual of the mean wavefront, nm at each sample.
    pub residual_nm: Array1<f64>,
    /// Hyperparameters: prior RMS of a mode of each group, nm; pistons, the segments' tilts where
    /// they are estimated, then tip and tilt of the NCPA, then their other groups in turn.
    pub prior_rms_nm: Vec<f64>,
}

impl StaticErrors {
    /// Pistons, tilts and NCPA in turn, nm.
    pub fn coefficients_nm(&self) -> Array1<f64> {
        self.pistons_nm.iter().chain(&self.tilts_nm).chain(&self.ncpa_nm).copied().collect()
    }

    /// Pistons and tilts in turn, nm.
    pub(super) fn segments_nm(&self) -> Vec<f64> {
        [&self.pistons_nm[..], &self.tilts_nm].concat()
    }

    /// Number of segment modes: pistons and tilts.
    pub fn segment_modes(&self) -> usize {
        self.pistons_nm.len() + self.tilts_nm.len()
    }

    /// Prior RMS of a mode of each group from the last one of the segments on, nm: element n is
    /// that of the NCPA's group n, from 1.
    fn ncpa_rms_nm(&self) -> &[f64] {
        &self.prior_rms_nm[usize::from(!self.tilts_nm.is_empty())..]
    }

    /// Larger prior RMS of the last two of `groups` groups of NCPA modes, nm.
    pub(super) fn highest_groups_rms_nm(&self, groups: usize) -> f64 {
        self.ncpa_rms_nm()[groups.max(3) - 1..=groups].iter().copied().fold(0.0, f64::max)
    }

    /// Extrapolates the RMS over the pupil of NCPA beyond the last of `groups` orders, nm, from the
    /// power law of the finer half of the orders: with the variance s² of a mode of the last order
    /// N, and s² ∝ n^−q, Σ (n + 1)·s²·(n/N)^−q over n > N is about s²·N²/(q − 2).
    pub(super) fn extrapolated_ncpa_nm(&self, groups: usize) -> f64 {
        // Order 1 is tip and tilt, whose prior is flat.
        let finer = (groups / 2).max(2)..=groups;
        let rms_nm = self.ncpa_rms_nm();
        let points: Vec<(f64, f64)> = finer.map(|order| ((order as f64).ln(), 2.0 * rms_nm[order].ln())).collect();
        let count = points.len() as f64;
        let (x, y) = points.iter().fold((0.0, 0.0), |(sx, sy), (x, y)| (sx + x / count, sy + y / count));
        let (across, along) =
            points.iter().fold((0.0, 0.0), |(c, a), (u, v)| (c + (u - x) * (v - y), a + (u - x).powi(2)));
        let exponent = if along > 0.0 { (-across / along).max(MIN_EXPONENT) } else { MIN_EXPONENT };
        let last = groups as f64;
        let variance_nm2 = (y - exponent * (last.ln() - x)).exp();
        (variance_nm2 * last * last / (exponent - 2.0)).sqrt()
    }

    /// Removes motions of the whole mirror, which leave the images as they are, from the
    /// coefficients and their covariance.
    pub(super) fn without_motions(mut self, motions: &GlobalMotions) -> Self {
        let mut coefficients_nm = self.coefficients_nm().to_vec();
        motions.remove(&mut coefficients_nm);
        let (pistons_nm, others_nm) = coefficients_nm.split_at(self.pistons_nm.len());
        let (tilts_nm, ncpa_nm) = others_nm.split_at(self.tilts_nm.len());
        (self.pistons_nm, self.tilts_nm, self.ncpa_nm) = (pistons_nm.to_vec(), tilts_nm.to_vec(), ncpa_nm.to_vec());
        self.covariance_nm2 = motions.removed_from(&self.covariance_nm2);
        self
    }

    /// Scales the covariance up where wavefronts recover only these fractions of an error of the
    /// segments and of the NCPA.
    pub(super) fn with_recovered_fractions(mut self, [segments, ncpa]: [f64; 2]) -> Self {
        let segment_modes = self.segment_modes();
        let fraction = |mode: usize| if mode < segment_modes { segments } else { ncpa };
        self.covariance_nm2.indexed_iter_mut().for_each(|((i, j), nm2)| *nm2 /= fraction(i) * fraction(j));
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ncpa_beyond_the_last_order_are_the_sum_of_a_power_law() {
        let orders = 20;
        let rms_nm = |order: f64, exponent: f64| 100.0 * order.powf(-exponent / 2.0);
        let errors = |exponent: f64| StaticErrors {
            pistons_nm: Vec::new(),
            tilts_nm: Vec::new(),
            ncpa_nm: Vec::new(),
            common_path_nm: Vec::new(),
            covariance_nm2: Array2::zeros((0, 0)),
            log_marginal_likelihood: 0.0,
            residual_nm: Array1::zeros(0),
            prior_rms_nm: std::iter::once(60.0)
                .chain((1..=orders).map(|order| rms_nm(order as f64, exponent)))
                .collect(),
        };
        for exponent in [3.5, 4.0, 6.0] {
            // Order by order, until the rest is a thousandth.
            let variance = |order: u32| f64::from(order + 1) * rms_nm(f64::from(order), exponent).powi(2);
            let sum: f64 = (orders as u32 + 1..20_000).map(variance).sum();
            // A sum from 20.5 with one mode more in each order, against an integral from 20: 10 %
            // at the steepest.
            let beyond_nm = errors(exponent).extrapolated_ncpa_nm(orders);
            assert!((beyond_nm / sum.sqrt() - 1.0).abs() < 0.1, "{exponent}: {beyond_nm} {}", sum.sqrt());
        }
        // Two orders, of which the first is tip and tilt: the other one, and the least exponent.
        assert!((errors(4.0).extrapolated_ncpa_nm(2) / (rms_nm(2.0, 4.0) * 2.0) - 1.0).abs() < 1e-12);
        // Variances that do not fall, which noise can cause, extrapolate to a finite one.
        let level_nm = errors(0.0).extrapolated_ncpa_nm(orders);
        assert!((level_nm / (100.0 * 20.0) - 1.0).abs() < 0.5, "{level_nm}");
    }
}

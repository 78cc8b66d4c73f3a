//! Kalman filter of a random walk that is observed directly, in the
//! [`Coordinates`](super::coordinates::Coordinates) of the observed subspace.

use super::bytes::{ByteReader, Writer};
use crate::Result;
use crate::linear_algebra::CholeskyFactor;
use ndarray::{Array1, Array2, ArrayView1, Axis};

/// Variance of a coordinate from which nothing is concluded, over its own: an innovation of a
/// hundred standard deviations counts for 1e-2 of χ².
const OPENED: f64 = 1e6;

/// State x and its covariance P.
#[derive(Debug, Clone)]
pub(super) struct KalmanFilter {
    pub(super) state_nm: Array1<f64>,
    pub(super) covariance_nm2: Array2<f64>,
}

/// Innovation of an observation, white: with S = P + R = L·Lᵀ.
pub(super) struct Innovation {
    factor: CholeskyFactor,
    /// L⁻¹·(z − x).
    pub(super) white: Array1<f64>,
}

impl Innovation {
    /// χ² of the observation about the state.
    pub(super) fn chi2(&self) -> f64 {
        self.white.dot(&self.white)
    }

    /// L⁻¹·`vector`.
    pub(super) fn whiten_vector(&self, vector: &Array1<f64>) -> Array1<f64> {
        self.factor.whiten_vector(vector.clone())
    }

    /// L⁻¹·`steps`, `[coordinate, step]`: the steps in terms of the white innovation.
    pub(super) fn whiten(&self, steps: &Array2<f64>) -> Array2<f64> {
        self.factor.whiten(steps)
    }
}

impl KalmanFilter {
    /// From the first observation.
    pub(super) fn new(z_nm: Array1<f64>, covariance_nm2: Array2<f64>) -> Self {
        Self { state_nm: z_nm, covariance_nm2 }
    }

    /// The walk of a time in which each coordinate gains the variance `added_nm2`.
    pub(super) fn predict(&mut self, added_nm2: impl Iterator<Item = f64>) {
        self.covariance_nm2.diag_mut().iter_mut().zip(added_nm2).for_each(|(variance, added)| *variance += added);
    }

    /// The innovation of `z_nm` with the covariance `covariance_nm2`.
    ///
    /// # Errors
    /// [`Error::Value`](crate::Error::Value) for a covariance that is not positive.
    pub(super) fn innovation(&self, z_nm: &Array1<f64>, covariance_nm2: &Array2<f64>) -> Result<Innovation> {
        let factor = CholeskyFactor::new(&(&self.covariance_nm2 + covariance_nm2))?;
        let white = factor.whiten_vector(z_nm - &self.state_nm);
        Ok(Innovation { factor, white })
    }

    /// [`KalmanFilter::innovation`] where nothing is concluded from the coordinates `left_out`:
    /// their variance is opened, which marginalises them.
    ///
    /// # Errors
    /// As [`KalmanFilter::innovation`].
    pub(super) fn innovation_without(
        &self,
        z_nm: &Array1<f64>,
        covariance_nm2: &Array2<f64>,
        left_out: &[usize],
    ) -> Result<Innovation> {
        let mut opened_nm2 = covariance_nm2.clone();
        for &at in left_out {
            opened_nm2[[at, at]] += OPENED * (self.covariance_nm2[[at, at]] + covariance_nm2[[at, at]]);
        }
        self.innovation(z_nm, &opened_nm2)
    }

    /// The observation whose innovation this is: with W = L⁻¹·P, x + Wᵀ·L⁻¹·(z − x) and P − Wᵀ·W.
    /// Returns W.
    pub(super) fn update(&mut self, innovation: &Innovation) -> Array2<f64> {
        let gain = innovation.factor.whiten(&self.covariance_nm2);
        self.state_nm += &gain.t().dot(&innovation.white);
        self.covariance_nm2 -= &gain.t().dot(&gain);
        // Rounding leaves the product unsymmetric, which would grow.
        let symmetric = (&self.covariance_nm2 + &self.covariance_nm2.t()) * 0.5;
        self.covariance_nm2 = symmetric;
        gain
    }

    /// Adds the variance `variance_nm2` along `step`, so that the next observation decides there.
    pub(super) fn open(&mut self, step: ArrayView1<f64>, variance_nm2: f64) {
        let column = step.insert_axis(Axis(1));
        self.covariance_nm2.scaled_add(variance_nm2, &column.dot(&column.t()));
    }

    /// Adds the variance `variance_nm2` to every coordinate.
    pub(super) fn open_all(&mut self, variance_nm2: f64) {
        self.covariance_nm2.diag_mut().iter_mut().for_each(|variance| *variance += variance_nm2);
    }

    pub(super) fn write(&self, writer: &mut Writer) {
        writer.vector(self.state_nm.iter());
        writer.matrix(&self.covariance_nm2);
    }

    pub(super) fn read(reader: &mut ByteReader) -> Result<Self> {
        Ok(Self { state_nm: reader.vector()?, covariance_nm2: reader.matrix()? })
    }
}

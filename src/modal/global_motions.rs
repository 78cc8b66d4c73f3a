//! Pistons about their mean over the pupil: removes the global piston, on which no image depends.

use super::model::Model;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, ArrayView2, s};

/// Shares of a model's pistons in their mean over the pupil.
pub(super) struct Pistons {
    /// Each piston's share; empty where pistons are not estimated.
    shares: Vec<f64>,
}

impl Pistons {
    /// # Errors
    /// [`Error::Value`] for pistons of segments without area.
    pub(super) fn new(model: &Model) -> Result<Self> {
        let pistons = model.basis.names().iter().take(model.segment_modes).take_while(|name| name.ends_with("-piston"));
        let count = pistons.count();
        let pupil = &model.telescope.pupil;
        let areas = model.basis.along(&pupil.amplitude)?[..count].to_vec();
        let total: f64 = areas.iter().sum();
        if count > 0 && total <= 0.0 {
            return Err(Error::Value("the segments of the pistons have no illuminated area".into()));
        }
        Ok(Self { shares: areas.iter().map(|area| area / total).collect() })
    }

    /// Brings the pistons to zero mean over the pupil.
    pub(super) fn centre(&self, coefficients_nm: &mut [f64]) {
        let mean: f64 = self.shares.iter().zip(coefficients_nm.iter()).map(|(share, nm)| share * nm).sum();
        coefficients_nm[..self.shares.len()].iter_mut().for_each(|nm| *nm -= mean);
    }

    /// The covariance of coefficients that were brought to zero mean.
    pub(super) fn centred(&self, covariance_nm2: &Array2<f64>) -> Array2<f64> {
        // P C Pᵀ with P = I − 1·shareᵀ on the pistons: every piston loses the pistons' mean.
        let count = self.shares.len();
        let mut covariance_nm2 = covariance_nm2.clone();
        let mean = |lines: ArrayView2<f64>| ArrayView1::from(&self.shares).dot(&lines);
        let of_rows = mean(covariance_nm2.slice(s![..count, ..]));
        covariance_nm2.slice_mut(s![..count, ..]).outer_iter_mut().for_each(|mut row| row -= &of_rows);
        let of_columns = mean(covariance_nm2.slice(s![.., ..count]).t());
        covariance_nm2
            .slice_mut(s![.., ..count])
            .columns_mut()
            .into_iter()
            .for_each(|mut column| column -= &of_columns);
        // Symmetric to the last bit, which an eigen-decomposition may need.
        (&covariance_nm2 + &covariance_nm2.t()) * 0.5
    }
}

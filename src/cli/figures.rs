//! Figures of merit: RMS over the pupil (weight A) with piston, tip and tilt removed, of estimate, error bar, residual.

use super::files::Truth;
use cophase::estimate::{Estimate, Model};
use cophase::modes::Group;
use cophase::pupil::Pupil;
use cophase::{Error, Result};
use ndarray::{Array2, ArrayView2, Axis};

/// `map` as the figures compare it, and its RMS.
pub fn detrended(pupil: &Pupil, map: ArrayView2<f64>) -> Result<(Array2<f64>, f64)> {
    let map = pupil.remove_piston_tip_tilt(map)?;
    let rms = pupil.rms(map.view())?;
    Ok((map, rms))
}

/// Estimate minus truth, phasing and NCPA, with the RMS of each and of their sum.
pub struct Residual {
    pub phasing_nm: Array2<f64>,
    pub ncpa_nm: Array2<f64>,
    /// Phasing, NCPA, wavefront.
    pub rms_nm: [f64; 3],
}

impl Residual {
    /// Compares maps on the grid of `pupil`.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Value`] where a map is not one of this pupil.
    pub fn of(pupil: &Pupil, phasing_nm: &Array2<f64>, ncpa_nm: &Array2<f64>, truth: &Truth) -> Result<Self> {
        let wanted = pupil.amplitude.dim();
        let maps = [phasing_nm, ncpa_nm, &truth.phasing_nm, &truth.ncpa_nm];
        if let Some(odd) = maps.into_iter().find(|map| map.dim() != wanted) {
            let ((rows, columns), samples) = (odd.dim(), wanted.0);
            return Err(Error::Shape(format!(
                "a map has {columns}x{rows} samples where the estimate's pupil has {samples}x{samples}: they cannot be \
                 compared"
            )));
        }
        let (phasing_nm, phasing) = detrended(pupil, (phasing_nm - &truth.phasing_nm).view())?;
        let (ncpa_nm, ncpa) = detrended(pupil, (ncpa_nm - &truth.ncpa_nm).view())?;
        let wavefront = pupil.rms((&phasing_nm + &ncpa_nm).view())?;
        Ok(Self { phasing_nm, ncpa_nm, rms_nm: [phasing, ncpa, wavefront] })
    }
}

/// One line of the table.
pub struct Row {
    pub name: &'static str,
    pub rms_nm: f64,
    pub sigma_nm: f64,
    pub residual_nm: Option<f64>,
}

/// Phasing, NCPA and their sum.
pub fn rows(model: &Model, estimate: &Estimate, residual: Option<&Residual>) -> Result<[Row; 3]> {
    let pupil = &model.telescope.pupil;
    let wavefront_nm = &estimate.phasing_nm + &estimate.ncpa_nm;
    let sigma_nm = error_bars(model, &estimate.combined.covariance_nm2)?;
    let row = |at: usize, name, map: &Array2<f64>| -> Result<Row> {
        let (_, rms_nm) = detrended(pupil, map.view())?;
        let residual_nm = residual.map(|residual| residual.rms_nm[at]);
        Ok(Row { name, rms_nm, sigma_nm: sigma_nm[at], residual_nm })
    };
    Ok([
        row(0, "phasing", &estimate.phasing_nm)?,
        row(1, "NCPA", &estimate.ncpa_nm)?,
        row(2, "wavefront", &wavefront_nm)?,
    ])
}

/// Expected RMS of the error of phasing, NCPA and wavefront: `√(Σ_kl G_kl C_kl)`, C the covariance of the coefficients
/// and G the products over the pupil of the modes with piston, tip and tilt removed, as in the residual.
fn error_bars(model: &Model, covariance_nm2: &Array2<f64>) -> Result<[f64; 3]> {
    let pupil = &model.telescope.pupil;
    let lit: Vec<(usize, usize)> =
        pupil.amplitude.indexed_iter().filter(|(_, a)| **a > 0.0).map(|(at, _)| at).collect();
    let modes = model.basis.len();
    let mut samples = Array2::zeros((modes, lit.len()));
    for (mode, mut row) in model.basis.maps().outer_iter().zip(samples.outer_iter_mut()) {
        let map = pupil.remove_piston_tip_tilt(mode)?;
        for (value, &at) in row.iter_mut().zip(&lit) {
            *value = map[at] * (pupil.amplitude[at] / pupil.weight_sum()).sqrt();
        }
    }
    let product = samples.dot(&samples.t()) * covariance_nm2;
    let sum = |keep: &dyn Fn(Group) -> bool| {
        let kept: Vec<usize> = (0..modes).filter(|&mode| keep(model.basis.groups()[mode])).collect();
        // Rounding may leave a variance of nothing slightly below 0.
        product.select(Axis(0), &kept).select(Axis(1), &kept).sum().max(0.0).sqrt()
    };
    Ok([sum(&|group| group == Group::Segment), sum(&|group| group == Group::Ncpa), sum(&|_| true)])
}

//! Figures of merit: RMS over the pupil (weight A) with piston, tip and tilt removed, of estimate, error bar, residual.

use crate::files::Truth;
use cophase::estimate::{Estimate, Model};
use cophase::metrics::MapGram;
use cophase::modes::Group;
use cophase::pupil::Pupil;
use cophase::{Error, Result};
use ndarray::{Array2, ArrayView2};

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

/// Expected RMS of the error of phasing, NCPA and wavefront, piston, tip and tilt removed as in the residual.
fn error_bars(model: &Model, covariance_nm2: &Array2<f64>) -> Result<[f64; 3]> {
    let pupil = &model.telescope.pupil;
    let weight = &pupil.amplitude / pupil.weight_sum();
    let [piston, tip, tilt] = MapGram::planes(pupil).map(|plane| model.basis.along(&(plane * &weight)));
    let gram = MapGram::of_products(model.basis.gram(&weight)?, [piston?, tip?, tilt?]);
    let groups = model.basis.groups();
    let of = |keep: &dyn Fn(Group) -> bool| {
        let inside = |(k, l): (usize, usize)| keep(groups[k]) && keep(groups[l]);
        let part = Array2::from_shape_fn(covariance_nm2.dim(), |at| if inside(at) { covariance_nm2[at] } else { 0.0 });
        gram.expected_rms_nm(part.view())
    };
    Ok([of(&|group| group == Group::Segment)?, of(&|group| group == Group::Ncpa)?, of(&|_| true)?])
}

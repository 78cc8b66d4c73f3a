//! The images of a sequence that can be used, and what they show together.

use super::iterations::Measured;
use crate::{Error, Result};
use ndarray::{Array1, Array2, Axis};

/// Images whose χ² is beyond the median by more than this many median deviations (scaled to normal ones) are left out.
const CLIPPED_AT: f64 = 5.0;

/// Median deviation of a normal variable, over its standard deviation.
const NORMAL_MEDIAN_DEVIATION: f64 = 0.6745;

/// Images that can be used, their mean and what is left of each.
pub(super) struct Sequence {
    pub(super) used: Vec<usize>,
    pub(super) mean_nm: Array1<f64>,
    pub(super) residuals_nm: Array2<f64>,
    pub(super) reduced_chi2: f64,
}

impl Sequence {
    pub(super) fn of(measured: &Measured, kept: &[usize]) -> Result<Self> {
        let used = unclipped(measured);
        if used.len() < 2 {
            let (used, all) = (used.len(), measured.reduced_chi2.len());
            return Err(Error::Image(format!("{used} of {all} images can be used: at least 2 are needed")));
        }
        let mut residuals_nm = measured.phase_nm.select(Axis(0), &used).select(Axis(1), kept);
        for mut row in residuals_nm.outer_iter_mut() {
            let mean = row.mean().unwrap_or(0.0);
            row -= mean;
        }
        let count = used.len() as f64;
        let mean_nm = residuals_nm.sum_axis(Axis(0)) / count;
        residuals_nm -= &mean_nm;
        let reduced_chi2 = median(used.iter().map(|&image| measured.reduced_chi2[image]).collect());
        Ok(Self { used, mean_nm, residuals_nm, reduced_chi2 })
    }
}

/// The images whose χ² is like the others'.
fn unclipped(measured: &Measured) -> Vec<usize> {
    let chi2 = &measured.reduced_chi2;
    let usable =
        |&image: &usize| chi2[image].is_finite() && measured.phase_nm.row(image).iter().all(|nm| nm.is_finite());
    let usable: Vec<usize> = (0..chi2.len()).filter(usable).collect();
    let middle = median(usable.iter().map(|&image| chi2[image]).collect());
    let deviation =
        median(usable.iter().map(|&image| (chi2[image] - middle).abs()).collect()) / NORMAL_MEDIAN_DEVIATION;
    usable.into_iter().filter(|&image| chi2[image] <= middle + CLIPPED_AT * deviation).collect()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_that_stand_out_are_left_out() {
        let mut reduced_chi2 = vec![2.0, 2.1, 1.9, 2.05, 1.95, 2.0, 60.0, f64::NAN];
        let mut phase_nm = Array2::zeros((8, 3));
        phase_nm[[0, 1]] = f64::NAN;
        let measured = Measured { phase_nm, reduced_chi2: reduced_chi2.clone(), slopes_mas: None };
        assert_eq!(unclipped(&measured), [1, 2, 3, 4, 5]);
        reduced_chi2.fill(1.0);
        let alike = Measured { phase_nm: Array2::zeros((8, 3)), reduced_chi2, slopes_mas: None };
        assert_eq!(unclipped(&alike).len(), 8);
    }
}

//! Selection of the images of a sequence by χ², with the mean and the residuals of their
//! wavefronts.

use super::wavefront_source::RetrievedSequence;
use crate::statistics::{NORMAL_MEDIAN_DEVIATION, upper_median};
use crate::{Error, Result};
use ndarray::{Array1, Array2, Axis};

/// Deviation of χ² above the median at which an image is rejected, in standard deviations, from the
/// median absolute deviation.
const MAX_DEVIATION: f64 = 5.0;

/// Selected images, the mean of their wavefronts, and the residual of each about it.
pub(super) struct SelectedImages {
    pub(super) used: Vec<usize>,
    pub(super) mean_nm: Array1<f64>,
    pub(super) residuals_nm: Array2<f64>,
    /// Median over the images.
    pub(super) reduced_chi2: f64,
}

impl SelectedImages {
    /// Selects images of `sequence` and takes the samples `kept` of their wavefronts, each without
    /// its mean.
    ///
    /// # Errors
    /// [`Error::Image`] for fewer than two usable images.
    pub(super) fn new(sequence: &RetrievedSequence, kept: &[usize]) -> Result<Self> {
        let used = select_images(sequence);
        if used.len() < 2 {
            let (used, all) = (used.len(), sequence.reduced_chi2.len());
            return Err(Error::Image(format!("{used} of {all} images can be used: at least 2 are needed")));
        }
        let mut residuals_nm = sequence.wavefront_nm.select(Axis(0), &used).select(Axis(1), kept);
        for mut row in residuals_nm.outer_iter_mut() {
            let mean = row.mean().unwrap_or(0.0);
            row -= mean;
        }
        let count = used.len() as f64;
        let mean_nm = residuals_nm.sum_axis(Axis(0)) / count;
        residuals_nm -= &mean_nm;
        let chi2: Vec<f64> = used.iter().map(|&image| sequence.reduced_chi2[image]).collect();
        Ok(Self { used, mean_nm, residuals_nm, reduced_chi2: upper_median(&chi2) })
    }
}

/// Selects the images with finite wavefronts whose χ² is no outlier.
fn select_images(sequence: &RetrievedSequence) -> Vec<usize> {
    let chi2 = &sequence.reduced_chi2;
    let is_usable =
        |&image: &usize| chi2[image].is_finite() && sequence.wavefront_nm.row(image).iter().all(|nm| nm.is_finite());
    let usable: Vec<usize> = (0..chi2.len()).filter(is_usable).collect();
    let values: Vec<f64> = usable.iter().map(|&image| chi2[image]).collect();
    let middle = upper_median(&values);
    let deviations: Vec<f64> = values.iter().map(|value| (value - middle).abs()).collect();
    let deviation = upper_median(&deviations) / NORMAL_MEDIAN_DEVIATION;
    usable.into_iter().filter(|&image| chi2[image] <= middle + MAX_DEVIATION * deviation).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn outliers_and_unusable_images_are_rejected() {
        let mut reduced_chi2 = vec![2.0, 2.1, 1.9, 2.05, 1.95, 2.0, 60.0, f64::NAN];
        let mut wavefront_nm = Array2::zeros((8, 3));
        wavefront_nm[[0, 1]] = f64::NAN;
        let sequence = RetrievedSequence { wavefront_nm, reduced_chi2: reduced_chi2.clone(), slopes_mas: None };
        assert_eq!(select_images(&sequence), [1, 2, 3, 4, 5]);
        reduced_chi2.fill(1.0);
        let alike = RetrievedSequence { wavefront_nm: Array2::zeros((8, 3)), reduced_chi2, slopes_mas: None };
        assert_eq!(select_images(&alike).len(), 8);
    }
}

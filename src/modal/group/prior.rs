//! Prior of the modes of a group.
//!
//! A few images with weak differences leave some directions of the modes all but open. Free, these
//! are fitted to the noise, further than the images are linear in them, and then no error bar
//! holds. So the modes have zero-mean normal priors in sets of like modes: each motion of the
//! segments, and the NCPA modes in bands of a factor of [`BAND_RATIO`] in number, since the power
//! law of the NCPA is not known. The level of each set follows from the images
//! ([`crate::empirical_bayes`], with a uniform prior of the level). Where the images show the modes
//! well, it moves them by a small share of their error bars. Tip and tilt of the whole wavefront
//! have no prior.

use crate::Result;
use crate::empirical_bayes::{CoefficientGroup, NEGLIGIBLE_NM2, VarianceRule, maximise_marginal_likelihood};
use crate::modal::assess::fisher::without;
use crate::modal::model::Model;
use ndarray::{Array1, Array2, s};
use std::ops::Range;

/// NCPA modes of the first band.
const FIRST_BAND: usize = 8;
/// Ratio of the numbers of the modes at the two ends of a band.
const BAND_RATIO: usize = 2;
/// RMS of the first NCPA mode before the images say more, waves; mode k of the NCPA has this times
/// k to the power [`NCPA_POWER`]. Together some 0.1 waves RMS.
const NCPA_WAVES: f64 = 0.06;
/// The same of a segment mode.
const SEGMENT_WAVES: f64 = 0.05;
/// See [`NCPA_WAVES`].
const NCPA_POWER: f64 = -0.75;
/// Largest level, waves RMS of a mode: pistons that are known to a wavelength only have 0.29, and
/// a level that the images do not determine must end somewhere. In several wavelengths pistons may
/// be as large as `modes.piston_range_nm`.
const LARGEST_WAVES: f64 = 0.3;
/// Standard deviation of an unknown without a prior, nm: more than a model's range.
const FLAT_NM: f64 = 1e4;

/// Priors of all modes.
#[derive(Debug, Clone)]
pub(in crate::modal) struct Prior {
    sets: Vec<Set>,
    /// Relative standard deviation of each mode.
    relative: Array1<f64>,
    /// Coefficients of tip and tilt, `[axis, mode]`, which have no prior.
    tilts: Array2<f64>,
}

/// Modes with one level.
#[derive(Debug, Clone)]
struct Set {
    modes: Range<usize>,
    /// Standard deviation of a mode with the relative one 1, nm.
    level_nm: f64,
    /// Largest one, nm.
    largest_nm: f64,
}

impl Prior {
    /// The prior before the images say more; `piston_range_nm` where they show whole wavelengths.
    pub(in crate::modal) fn new(model: &Model, tilts: Array2<f64>, piston_range_nm: Option<f64>) -> Self {
        let wavelength_nm = model.optics.parts().wavelength_nm;
        let (segment_modes, modes) = (model.segment_modes, model.optics.modes());
        let of_a_motion = model.pistons().max(1);
        let usual_nm = LARGEST_WAVES * wavelength_nm;
        let motions = (0..segment_modes).step_by(of_a_motion);
        let mut sets: Vec<Set> = motions
            .map(|first| Set {
                modes: first..(first + of_a_motion).min(segment_modes),
                level_nm: SEGMENT_WAVES * wavelength_nm,
                largest_nm: piston_range_nm.filter(|_| first == 0).map_or(usual_nm, |range_nm| range_nm.max(usual_nm)),
            })
            .collect();
        let (mut first, mut next) = (0, FIRST_BAND);
        while segment_modes + first < modes {
            let end = next.min(modes - segment_modes);
            let level_nm = NCPA_WAVES * wavelength_nm;
            sets.push(Set { modes: segment_modes + first..segment_modes + end, level_nm, largest_nm: usual_nm });
            (first, next) = (end, next * BAND_RATIO);
        }
        let relative = |mode: usize| match mode.checked_sub(segment_modes) {
            None => 1.0,
            // Modes of files may have any unit.
            Some(ncpa) => (ncpa as f64 + 1.0).powf(NCPA_POWER) / model.mean_squares[mode].sqrt(),
        };
        let relative = (0..modes).map(relative).collect();
        Self { sets, relative, tilts }
    }

    /// Level of each set, nm.
    pub(super) fn levels_nm(&self) -> Vec<f64> {
        self.sets.iter().map(|set| set.level_nm).collect()
    }

    /// The same prior with these levels of its sets.
    pub(super) fn with_levels(mut self, levels_nm: &[f64]) -> Self {
        self.sets.iter_mut().zip(levels_nm).for_each(|(set, nm)| set.level_nm = *nm);
        self
    }

    /// Standard deviation of each mode, nm.
    pub(super) fn sigma_nm(&self) -> Array1<f64> {
        let mut sigma_nm = self.relative.clone();
        for set in &self.sets {
            sigma_nm.slice_mut(s![set.modes.clone()]).mapv_inplace(|relative| relative * set.level_nm);
        }
        sigma_nm
    }

    /// Inverse covariance of the first of `unknowns`, the modes, nm⁻²; 0 for the others.
    pub(in crate::modal) fn precision(&self, unknowns: usize) -> Array2<f64> {
        self.precision_but(unknowns, 0..0)
    }

    /// The same where the modes `free` have no prior.
    pub(super) fn precision_but(&self, unknowns: usize, free: Range<usize>) -> Array2<f64> {
        let mut own = self.sigma_nm().mapv(|nm| nm.powi(-2));
        own.slice_mut(s![free]).fill(0.0);
        let own = without(Array2::from_diag(&own), &self.tilts);
        let mut padded = Array2::zeros((unknowns, unknowns));
        padded.slice_mut(s![..own.nrows(), ..own.ncols()]).assign(&own);
        padded
    }

    /// Finds the levels from the normal equations of all unknowns, `information` x = `right`.
    ///
    /// # Errors
    /// [`crate::Error::Internal`] for values that are not finite.
    pub(super) fn learn(&mut self, information: &Array2<f64>, right: &Array1<f64>) -> Result<()> {
        // Modes with a relative standard deviation of 1, and tip and tilt once more without a
        // prior.
        let (modes, unknowns) = (self.relative.len(), right.len());
        let mut design = Array2::zeros((unknowns + self.tilts.nrows(), unknowns));
        design.slice_mut(s![..unknowns, ..]).diag_mut().fill(1.0);
        design.slice_mut(s![..modes, ..modes]).diag_mut().assign(&self.relative);
        design.slice_mut(s![unknowns.., ..modes]).assign(&self.tilts);
        let levels = self.sets.iter().map(|set| CoefficientGroup {
            columns: set.modes.clone(),
            variance_nm2: set.level_nm.powi(2),
            range_nm2: [NEGLIGIBLE_NM2, set.largest_nm.powi(2)],
            rule: VarianceRule::UniformRms,
        });
        let flat = CoefficientGroup {
            columns: modes..design.nrows(),
            variance_nm2: FLAT_NM.powi(2),
            range_nm2: [NEGLIGIBLE_NM2, f64::INFINITY],
            rule: VarianceRule::Fixed,
        };
        let groups: Vec<CoefficientGroup> = levels.chain([flat]).collect();
        let information = design.dot(&information.dot(&design.t()));
        let found = maximise_marginal_likelihood(&information, &design.dot(right), &groups)?;
        for (set, rms_nm) in self.sets.iter_mut().zip(found.prior_rms_nm) {
            set.level_nm = rms_nm;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn levels_follow_the_images_and_tilts_have_none() {
        // Nine modes, the first a tip; the others are known to 1 nm, and of 5 nm.
        let mut information = Array2::eye(9);
        information[[0, 0]] = 4.0;
        let mean = array![300.0, 5.0, -5.0, 4.0, -6.0, 5.0, -4.0, 6.0, -5.0];
        let mut tilts = Array2::zeros((1, 9));
        tilts[[0, 0]] = 1.0;
        let sets = vec![Set { modes: 0..9, level_nm: 30.0, largest_nm: 100.0 }];
        let mut prior = Prior { sets, relative: Array1::ones(9), tilts };
        prior.learn(&information, &information.dot(&mean)).unwrap();
        // The squares less the variances: √(204/8 − 1), of eight modes known to a quarter.
        assert!((4.5..6.0).contains(&prior.sets[0].level_nm), "{}", prior.sets[0].level_nm);
        let precision = prior.precision(10);
        assert_eq!((precision[[0, 0]], precision[[9, 9]]), (0.0, 0.0));
        assert!((precision[[3, 3]] * prior.sets[0].level_nm.powi(2) - 1.0).abs() < 1e-12);
    }
}

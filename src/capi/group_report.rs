//! Report on a group: one frame of each channel.

use super::image_report::number;
use crate::modal::{GroupResult, RefinedGroup, Status};

/// Report on a group: one frame of each channel of a model.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct cophase_group_report {
    /// The worst status of its images, a COPHASE_IMAGE_ number; of several channels there is no
    /// joint result above COPHASE_IMAGE_WRONG_MINIMUM.
    pub status: i32,
    /// 1 if the channels differ by more than their noise: one is flipped, of another wavelength or
    /// diversity than the scene says, of another wavefront, or in another minimum; in several
    /// wavelengths also where a piston is more than half a wavelength from the start.
    pub is_contradictory: i32,
    /// Chi-square per degree of freedom of the differences of the channels, 1 where they agree; NaN
    /// for one channel, and without a joint result.
    pub reduced_chi2: f64,
    /// Its degrees of freedom; 0 where the channels have no mode in common that both determine.
    pub freedom: f64,
    /// The smallest probability of the whole wavelengths of a piston; NaN where they were not
    /// sought: in one wavelength, and in a fit.
    pub piston_probability: f64,
    /// Duration of the fits, s; NaN of a refinement.
    pub seconds: f64,
}

impl From<&GroupResult> for cophase_group_report {
    fn from(result: &GroupResult) -> Self {
        let (reduced_chi2, freedom) = result.disagreement;
        Self {
            status: number(&result.status),
            is_contradictory: result.is_contradictory.into(),
            reduced_chi2,
            freedom,
            piston_probability: f64::NAN,
            seconds: result.seconds,
        }
    }
}

impl cophase_group_report {
    pub(super) fn of_refined(refined: &RefinedGroup, status: &Status) -> Self {
        let (reduced_chi2, freedom) = refined.disagreement;
        let probabilities = refined.integers.iter().map(|integer| integer.probability);
        Self {
            status: number(status),
            is_contradictory: refined.is_contradictory.into(),
            reduced_chi2,
            freedom,
            piston_probability: probabilities.fold(f64::NAN, f64::min),
            seconds: f64::NAN,
        }
    }
}

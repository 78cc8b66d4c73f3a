//! Report on one image of a fit or an estimate.

use super::policy::COPHASE_POLICY_REALTIME;
use super::status::{
    COPHASE_IMAGE_CONTRADICTORY, COPHASE_IMAGE_DEADLINE, COPHASE_IMAGE_MISFIT, COPHASE_IMAGE_NOT_CONVERGED,
    COPHASE_IMAGE_OK, COPHASE_IMAGE_UNUSABLE, COPHASE_IMAGE_WRONG_MINIMUM,
};
use crate::modal::{ImageReport, ImageResult, Status};
use crate::optimize::StopReason;
use crate::pipeline::ImageOutcome;

/// Report on one image.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct cophase_image_report {
    /// COPHASE_IMAGE_OK or another COPHASE_IMAGE_ number.
    pub status: i32,
    /// 1 if the image was combined into the estimate, or with other channels into the result of a
    /// session, else 0.
    pub is_used: i32,
    /// 1 if it was fitted and then left out as an outlier among the images, else 0; 0 in a session.
    pub is_clipped: i32,
    /// Pixels of the fitted part that were bad in the frame or in the calibration.
    pub bad_pixels: i32,
    /// Outlier pixels that were found and rejected.
    pub rejected_pixels: i32,
    /// Policy of the fit: COPHASE_POLICY_FULL, or COPHASE_POLICY_REALTIME, which a session follows.
    pub policy: i32,
    /// Evaluations of objective and gradient; of a MAP retrieval, in its last iteration.
    pub evaluations: u64,
    /// Chi-square per degree of freedom, 1 where the model is right; NaN for an unusable image.
    pub reduced_chi2: f64,
    /// Flux of the star, electrons.
    pub flux_e: f64,
    /// Background, electrons per pixel of the frame.
    pub background_e: f64,
    /// Tilt along x of the fitted wavefront and of the shift onto the axis, nm RMS over the pupil;
    /// NaN in a MAP estimate.
    pub tip_nm: f64,
    /// The same along y.
    pub tilt_nm: f64,
    /// Duration of the fit, s; NaN in an estimate, which fits images together.
    pub seconds: f64,
    /// Number of its channel in the scene, from 0; 0 for a scene without channels.
    pub channel: i64,
}

impl cophase_image_report {
    pub(super) fn from_session(result: &ImageResult, channel: usize, is_used: bool) -> Self {
        Self {
            is_used: is_used.into(),
            seconds: result.seconds,
            channel: channel as i64,
            ..Self::new(&result.report, COPHASE_POLICY_REALTIME)
        }
    }

    pub(super) fn from_estimate(image: &ImageOutcome, policy: i32) -> Self {
        Self {
            is_used: image.is_used.into(),
            is_clipped: image.is_clipped.into(),
            channel: image.channel as i64,
            ..Self::new(&image.report, policy)
        }
    }

    /// That of an image which was not combined with others.
    fn new(report: &ImageReport, policy: i32) -> Self {
        let [tip_nm, tilt_nm] = report.tip_tilt_nm;
        Self {
            status: number(&report.status),
            is_used: 0,
            is_clipped: 0,
            bad_pixels: i32::try_from(report.bad_pixels).unwrap_or(i32::MAX),
            rejected_pixels: i32::try_from(report.rejected.total()).unwrap_or(i32::MAX),
            policy,
            evaluations: report.evaluations as u64,
            reduced_chi2: report.reduced_chi2,
            flux_e: report.flux_e,
            background_e: report.background_e,
            tip_nm,
            tilt_nm,
            seconds: f64::NAN,
            channel: 0,
        }
    }
}

pub(super) fn number(status: &Status) -> i32 {
    match status {
        Status::Ok => COPHASE_IMAGE_OK,
        Status::Misfit => COPHASE_IMAGE_MISFIT,
        Status::WrongMinimum => COPHASE_IMAGE_WRONG_MINIMUM,
        Status::Contradictory => COPHASE_IMAGE_CONTRADICTORY,
        Status::NotConverged(StopReason::DeadlineReached) => COPHASE_IMAGE_DEADLINE,
        Status::NotConverged(_) => COPHASE_IMAGE_NOT_CONVERGED,
        Status::Unusable(_) => COPHASE_IMAGE_UNUSABLE,
    }
}

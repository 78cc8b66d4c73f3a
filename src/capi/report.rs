//! What became of each image.

use crate::estimate::{ImageResult, Status};
use std::ffi::{CStr, c_char};

/// Status of an image: fitted, and the model explains it.
pub const COPHASE_IMAGE_OK: i32 = 0;
/// Status of an image: fitted, but the residual is larger than the noise.
pub const COPHASE_IMAGE_MISFIT: i32 = 1;
/// Status of an image: the residual is so large that the fit probably sits in a wrong minimum.
pub const COPHASE_IMAGE_WRONG_MINIMUM: i32 = 2;
/// Status of an image: the optimiser gave up before it converged.
pub const COPHASE_IMAGE_NOT_CONVERGED: i32 = 3;
/// Status of an image: it could not be used, and its coefficients are NaN.
pub const COPHASE_IMAGE_UNUSABLE: i32 = 4;
/// Status of an image: time was up, and its coefficients are the best so far.
pub const COPHASE_IMAGE_DEADLINE: i32 = 5;

/// What became of an image. Later versions may append fields.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct cophase_report {
    /// COPHASE_IMAGE_OK, or another of the COPHASE_IMAGE_ numbers.
    pub status: i32,
    /// Pixels of the fitted part that took no part.
    pub bad_pixels: i32,
    /// Evaluations of the model.
    pub evaluations: u64,
    /// χ² per degree of freedom: 1 where the model is right.
    pub reduced_chi2: f64,
    /// The star, electrons.
    pub flux_e: f64,
    /// Background, electrons per pixel of the frame.
    pub background_e: f64,
    /// Tilt of the fitted wavefront along x, nm RMS over the pupil, the shift onto the axis included.
    pub tip_nm: f64,
    /// Likewise along y.
    pub tilt_nm: f64,
    /// Time that its fit took, s.
    pub seconds: f64,
}

impl cophase_report {
    pub(super) fn of(result: &ImageResult) -> Self {
        let report = &result.report;
        let [tip_nm, tilt_nm] = report.tip_tilt_nm;
        Self {
            status: number(&report.status),
            bad_pixels: i32::try_from(report.bad_pixels).unwrap_or(i32::MAX),
            evaluations: report.evaluations as u64,
            reduced_chi2: report.reduced_chi2,
            flux_e: report.flux_e,
            background_e: report.background_e,
            tip_nm,
            tilt_nm,
            seconds: result.seconds,
        }
    }
}

fn number(status: &Status) -> i32 {
    match status {
        Status::Ok => COPHASE_IMAGE_OK,
        Status::Misfit => COPHASE_IMAGE_MISFIT,
        Status::WrongMinimum => COPHASE_IMAGE_WRONG_MINIMUM,
        Status::NotConverged(crate::optimize::StopReason::DeadlineReached) => COPHASE_IMAGE_DEADLINE,
        Status::NotConverged(_) => COPHASE_IMAGE_NOT_CONVERGED,
        Status::Unusable(_) => COPHASE_IMAGE_UNUSABLE,
    }
}

/// Name of an image's status: `OK`, `MISFIT`, …; `UNKNOWN` for a number of a later version.
///
/// Returns a static string that the caller must not free. Never NULL.
#[unsafe(no_mangle)]
pub extern "C" fn cophase_image_status_name(status: i32) -> *const c_char {
    let name: &CStr = match status {
        COPHASE_IMAGE_OK => c"OK",
        COPHASE_IMAGE_MISFIT => c"MISFIT",
        COPHASE_IMAGE_WRONG_MINIMUM => c"WRONG_MINIMUM",
        COPHASE_IMAGE_NOT_CONVERGED => c"NOT_CONVERGED",
        COPHASE_IMAGE_UNUSABLE => c"UNUSABLE",
        COPHASE_IMAGE_DEADLINE => c"DEADLINE",
        _ => c"UNKNOWN",
    };
    name.as_ptr()
}

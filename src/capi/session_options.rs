//! Options of sessions and of their fits.

use super::calibration::read_noise_e;
use super::input::{COPHASE_F32, COPHASE_F64};
use super::pointer::{numbers, text};
use super::sized::Options;
use crate::imaging::Precision;
use crate::modal::{FitOptions, SessionOptions};
use crate::{Error, Result};
use ndarray::ArrayView2;
use std::ffi::c_char;
use std::time::Duration;

/// Options of a session.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_session_options {
    /// sizeof(cophase_session_options).
    pub struct_size: usize,
    /// Largest number of groups of a call, which are images of a model with one channel; 0 means 1.
    pub capacity: usize,
    /// Where it runs: "auto", "cpu", "opencl" or "opencl:P:D", see cophase_device_list; NULL for
    /// the scene's estimate.device. [RT] calls need "cpu".
    pub device: *const c_char,
    /// COPHASE_F64 or COPHASE_F32 (half the memory, a third to half of the time, errors of 0.02
    /// nm); 0 for the scene's estimate.precision.
    pub precision: i32,
    /// Threads of the CPU chain: 0 or 1 for the caller's own, which [RT] calls need; -1 for one per
    /// processor.
    pub threads: i32,
    /// Largest number of evaluations for one image; 0 for the scene's.
    pub max_evaluations: usize,
    /// A fit stops where neither a coefficient nor the RMS of the wavefront would change by more
    /// than this, nm; 0 for the scene's.
    pub step_tolerance_nm: f64,
}

unsafe impl Options for cophase_session_options {}

/// Options of a fit.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_fit_options {
    /// sizeof(cophase_fit_options).
    pub struct_size: usize,
    /// Time for the whole call, s; images that are not done by then have COPHASE_IMAGE_DEADLINE. 0
    /// for no limit.
    pub deadline_s: f64,
    /// Read noise of a pixel, electrons RMS; 0 for the scene's, unless has_read_noise is 1.
    pub read_noise_e: f64,
    /// Starts of the fits, nm: count x modes in C order, each that of all channels of a group. NULL
    /// for a flat wavefront.
    pub start_nm: *const f64,
    /// 1: read_noise_e holds even if it is 0 (no read noise). 0: a read_noise_e of 0 means the
    /// scene's.
    pub has_read_noise: i64,
}

unsafe impl Options for cophase_fit_options {}

pub(super) fn precision_number(precision: Precision) -> i32 {
    match precision {
        Precision::F64 => COPHASE_F64,
        Precision::F32 => COPHASE_F32,
    }
}

/// A caller's options, checked.
pub(super) unsafe fn session_options(options: &cophase_session_options) -> Result<SessionOptions> {
    let device = if options.device.is_null() {
        None
    } else {
        Some(unsafe { text(options.device, "options->device") }?.parse()?)
    };
    let precision = match options.precision {
        0 => None,
        COPHASE_F64 => Some(Precision::F64),
        COPHASE_F32 => Some(Precision::F32),
        other => {
            let known = "COPHASE_F64, COPHASE_F32, or 0 for the scene's";
            return Err(Error::Value(format!("options->precision is {other}: {known} is accepted")));
        }
    };
    let threads = match options.threads {
        0 | 1 => 1,
        -1 => 0,
        other => return Err(Error::Value(format!("options->threads is {other}: 0, 1 or -1 is accepted"))),
    };
    let step = options.step_tolerance_nm;
    if !(step.is_finite() && step >= 0.0) {
        return Err(Error::Value(format!("options->step_tolerance_nm is {step}: 0 or more is accepted")));
    }
    Ok(SessionOptions {
        capacity: options.capacity.max(1),
        precision,
        device,
        threads,
        max_evaluations: (options.max_evaluations > 0).then_some(options.max_evaluations),
        step_tolerance_nm: (step > 0.0).then_some(step),
    })
}

/// A caller's options, checked. The caller's promise: `count` x `modes` numbers at `start_nm`.
pub(super) unsafe fn fit_options<'a>(
    options: &cophase_fit_options,
    count: usize,
    modes: usize,
) -> Result<FitOptions<'a>> {
    let deadline_s = options.deadline_s;
    if deadline_s.is_nan() || deadline_s < 0.0 {
        return Err(Error::Value(format!("options->deadline_s is {deadline_s}: 0 or more is accepted")));
    }
    let start_nm = if options.start_nm.is_null() {
        None
    } else {
        let start = unsafe { numbers(options.start_nm, count * modes, "options->start_nm") }?;
        let start = ArrayView2::from_shape((count, modes), start);
        Some(start.map_err(|error| Error::Internal(format!("the start of a fit: {error}")))?)
    };
    Ok(FitOptions {
        // A deadline beyond what a clock can hold is none.
        deadline: (deadline_s > 0.0).then(|| Duration::try_from_secs_f64(deadline_s).ok()).flatten(),
        read_noise_e: read_noise_e(options.read_noise_e, options.has_read_noise)?,
        start_nm,
    })
}

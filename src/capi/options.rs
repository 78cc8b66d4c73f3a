//! What a caller may choose of sessions, calibrations and fits.

use super::handle::fence;
use super::input::{COPHASE_F32, COPHASE_F64, Input, cophase_input};
use super::pointer::numbers;
use super::sized::{self, Options};
use super::status::cophase_status;
use crate::device::Choice;
use crate::estimate::{Calibration, CameraMaps, FitOptions, SessionOptions};
use crate::imaging::Precision;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2};
use std::time::Duration;

/// How a session is made.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_session_options {
    /// Filled in by cophase_session_options_init.
    pub struct_size: usize,
    /// Most images of a call. Default: 1.
    pub capacity: usize,
    /// COPHASE_F64, or COPHASE_F32: half the memory, a third to half of the time, 0.02 nm. Default:
    /// COPHASE_F64.
    pub precision: i32,
    /// Threads of the CPU chain: 1 for the caller's own, which calls marked [RT] need; 0 for all that there are.
    /// Default: 1.
    pub threads: i32,
    /// Most evaluations of the model for one image; 0 for what the scene says. Default: 0.
    pub max_evaluations: usize,
    /// A fit stops where neither a coefficient nor the RMS of the wavefront would move by more than this; 0 for what
    /// the scene says. Default: 0.
    pub step_tolerance_nm: f64,
}

unsafe impl Options for cophase_session_options {
    fn defaults() -> Self {
        Self {
            struct_size: size_of::<Self>(),
            capacity: 1,
            precision: COPHASE_F64,
            threads: 1,
            max_evaluations: 0,
            step_tolerance_nm: 0.0,
        }
    }
}

/// What a camera's raw values mean: electrons = (raw − dark)·gain/flat.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_calibration {
    /// Filled in by cophase_calibration_init.
    pub struct_size: usize,
    /// 1 x rows x cols: signal without light, raw units. Data NULL: none.
    pub dark: cophase_input,
    /// 1 x rows x cols: relative response, about 1. Data NULL: all alike.
    pub flat: cophase_input,
    /// 1 x rows x cols: pixels that are not 0 take no part. Data NULL: all do.
    pub bad: cophase_input,
    /// Electrons per raw unit. Default: 1.
    pub gain_e: f64,
    /// Pixels that read as much or more take no part, raw units. Default: infinity.
    pub saturation: f64,
}

unsafe impl Options for cophase_calibration {
    fn defaults() -> Self {
        let none = cophase_input::NONE;
        let struct_size = size_of::<Self>();
        Self { struct_size, dark: none, flat: none, bad: none, gain_e: 1.0, saturation: f64::INFINITY }
    }
}

/// How frames are fitted.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_fit_options {
    /// Filled in by cophase_fit_options_init.
    pub struct_size: usize,
    /// Time for the whole call, s; what is not done by then is reported as COPHASE_IMAGE_DEADLINE. 0 for no limit.
    /// Default: 0.
    pub deadline_s: f64,
    /// Read noise of a pixel, RMS electrons; NaN for what the scene says. Default: NaN.
    pub read_noise_e: f64,
    /// Where the fits begin, nm: count x modes in C order. NULL for a flat wavefront. Default:
    /// NULL.
    pub start_nm: *const f64,
}

unsafe impl Options for cophase_fit_options {
    fn defaults() -> Self {
        let struct_size = size_of::<Self>();
        Self { struct_size, deadline_s: 0.0, read_noise_e: f64::NAN, start_nm: std::ptr::null() }
    }
}

/// Fills in `struct_size` and the defaults. struct_size:
/// sizeof(cophase_session_options).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_options_init(
    options: *mut cophase_session_options,
    struct_size: usize,
) -> cophase_status {
    fence(|| unsafe { sized::init(options, "options", struct_size) })
}

/// Fills in `struct_size` and the defaults. struct_size: sizeof(cophase_calibration).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_calibration_init(
    calibration: *mut cophase_calibration,
    struct_size: usize,
) -> cophase_status {
    fence(|| unsafe { sized::init(calibration, "calibration", struct_size) })
}

/// Fills in `struct_size` and the defaults. struct_size: sizeof(cophase_fit_options).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_fit_options_init(
    options: *mut cophase_fit_options,
    struct_size: usize,
) -> cophase_status {
    fence(|| unsafe { sized::init(options, "options", struct_size) })
}

/// A caller's options, checked.
pub(super) fn session_options(options: &cophase_session_options, device: Choice) -> Result<SessionOptions> {
    let precision = match options.precision {
        COPHASE_F64 => Precision::F64,
        COPHASE_F32 => Precision::F32,
        other => {
            let known = "COPHASE_F64 or COPHASE_F32";
            return Err(Error::Value(format!("options->precision is {other}: {known} is accepted")));
        }
    };
    let threads = match options.threads {
        0 => 0,
        1 => 1,
        other => return Err(Error::Value(format!("options->threads is {other}: 0 or 1 is accepted"))),
    };
    let step = options.step_tolerance_nm;
    if !(step.is_finite() && step >= 0.0) {
        return Err(Error::Value(format!("options->step_tolerance_nm is {step}: 0 or more is accepted")));
    }
    Ok(SessionOptions {
        capacity: options.capacity,
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
        read_noise_e: read_noise_e(options.read_noise_e)?,
        start_nm,
    })
}

/// A caller's read noise, checked; `None` for what the scene says.
pub(super) fn read_noise_e(given: f64) -> Result<Option<f64>> {
    if given < 0.0 || given.is_infinite() {
        return Err(Error::Value(format!("options->read_noise_e is {given}: 0 or more, or NaN, is accepted")));
    }
    Ok((!given.is_nan()).then_some(given))
}

/// A caller's calibration for frames of `shape` (rows, columns); electrons for NULL.
pub(super) unsafe fn calibration(
    calibration: *const cophase_calibration,
    shape @ (rows, cols): (usize, usize),
) -> Result<Calibration> {
    let given = unsafe { sized::read(calibration, "calibration") }?;
    let map = |array: &cophase_input, name: &'static str| -> Result<Option<Array2<f64>>> {
        let Some(input) = (unsafe { Input::optional(array, name) })? else { return Ok(None) };
        input.must_be([1, rows, cols])?.map().map(Some)
    };
    let maps = CameraMaps {
        dark: map(&given.dark, "calibration->dark")?,
        flat: map(&given.flat, "calibration->flat")?,
        bad: map(&given.bad, "calibration->bad")?.map(|bad| bad.mapv(|value| value != 0.0)),
    };
    Calibration::new(shape, maps, given.gain_e, given.saturation)
}

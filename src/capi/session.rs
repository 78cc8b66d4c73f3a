//! Sessions: fits with a deadline, in memory that is allocated beforehand.

use super::calibration::{calibration, cophase_calibration, read_noise_e};
use super::handle::{Handle, Object, fence, find, give_back};
use super::image_report::cophase_image_report;
use super::input::{COPHASE_F32, COPHASE_F64, Input, cophase_input};
use super::model::{check_modes, cophase_model, estimator};
use super::pointer::{numbers, numbers_mut, place, put_text, text};
use super::sized::{self, Options, Outputs};
use super::status::{COPHASE_OK, cophase_status};
use super::text::*;
use crate::imaging::Precision;
use crate::machine::start_threads;
use crate::modal::{Calibration, CameraMaps, FitOptions, ModalFitter, Session, SessionOptions};
use crate::optimize::CancelFlag;
use crate::{Error, Result};
use ndarray::{ArrayView2, ArrayViewMut2};
use std::ffi::c_char;
use std::sync::atomic::Ordering;
use std::time::Duration;

/// Session: fits of single images with a model, in memory that is allocated when it is created. It follows the policy
/// COPHASE_POLICY_REALTIME: no modes with a prior, no restarts; outlier pixels are rejected in the fit. The same frame gives the same bits,
/// with any other frames in the call.
///
/// One call at a time (COPHASE_BUSY otherwise), except cophase_session_cancel, which any thread may call at any time.
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_session(Handle<Working, CancelFlag>);

impl Object for cophase_session {
    const KIND: u64 = 3;
}

/// What a call works on.
pub(super) struct Working {
    session: Session,
    calibration: Calibration,
}

/// Options of a session.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Clone, Copy)]
pub struct cophase_session_options {
    /// sizeof(cophase_session_options).
    pub struct_size: usize,
    /// Largest number of images of a call; 0 means 1.
    pub capacity: usize,
    /// Where it runs: "auto", "cpu", "opencl" or "opencl:P:D", see cophase_device_list; NULL for the scene's
    /// estimate.device. [RT] calls need "cpu".
    pub device: *const c_char,
    /// COPHASE_F64 or COPHASE_F32 (half the memory, a third to half of the time, errors of 0.02 nm); 0 for the scene's
    /// estimate.precision.
    pub precision: i32,
    /// Threads of the CPU chain: 0 or 1 for the caller's own, which [RT] calls need; -1 for one per processor.
    pub threads: i32,
    /// Largest number of evaluations for one image; 0 for the scene's.
    pub max_evaluations: usize,
    /// A fit stops where neither a coefficient nor the RMS of the wavefront would change by more than this, nm; 0 for the
    /// scene's.
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
    /// Time for the whole call, s; images that are not done by then have COPHASE_IMAGE_DEADLINE. 0 for no limit.
    pub deadline_s: f64,
    /// Read noise of a pixel, electrons RMS; 0 for the scene's, unless has_read_noise is 1.
    pub read_noise_e: f64,
    /// Starts of the fits, nm: count x modes in C order. NULL for a flat wavefront.
    pub start_nm: *const f64,
    /// 1: read_noise_e holds even if it is 0 (no read noise). 0: a read_noise_e of 0 means the scene's.
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

impl Working {
    /// Copies a caller's frames into those of the session; how many they are.
    fn take(&mut self, frames: &Input) -> Result<usize> {
        let (rows, cols) = self.calibration.shape();
        let [count, ..] = frames.shape();
        frames.must_be([count, rows, cols])?;
        if count > self.session.capacity() {
            let capacity = self.session.capacity();
            return Err(Error::Shape(format!("frames has {count} frames: 1 to {capacity} are accepted, the capacity")));
        }
        for k in 0..count {
            copy_frame(frames, k, &self.calibration, self.session.frame_mut(k)?);
        }
        Ok(count)
    }

    fn modes(&self) -> usize {
        self.session.estimator().model().optics.modes()
    }
}

/// Copies frame `k` of a caller's, calibrated, into buffers of a session.
pub(super) fn copy_frame(
    frames: &Input,
    k: usize,
    calibration: &Calibration,
    (mut data_e, mut bad): (ArrayViewMut2<f64>, ArrayViewMut2<bool>),
) {
    frames.each(k, |y, x, raw| {
        let electrons = calibration.electrons(y, x, raw);
        data_e[[y, x]] = electrons.unwrap_or(0.0);
        bad[[y, x]] = electrons.is_none();
    });
}

/// The calibration of frames of a model before any is set: electrons, or counts where the scene has a gain.
pub(super) fn electrons_of(estimator: &ModalFitter) -> Result<Calibration> {
    let [x, y] = estimator.model().preparation.frame;
    let gain = estimator.scene().image.gain_e_per_adu.unwrap_or(1.0);
    Calibration::new((y, x), CameraMaps::default(), gain, f64::INFINITY)
}

/// A caller's calibration of frames of a model.
///
/// # Errors
/// [`Error::Value`] for bad pixels that a reduction of the sampling would smear.
pub(super) unsafe fn calibration_for(
    estimator: &ModalFitter,
    calibration: *const cophase_calibration,
) -> Result<Calibration> {
    let preparation = &estimator.model().preparation;
    let [x, y] = preparation.frame;
    let made = unsafe { self::calibration(calibration, (y, x), estimator.scene().image.gain_e_per_adu) }?;
    if made.bad_pixels() > 0 && preparation.reduced != preparation.frame {
        return Err(Error::Value(format!(
            "the calibration has {} bad pixels, which a reduction of the sampling would smear: a model of a scene with \
             estimate.sampling = \"native\" is accepted",
            made.bad_pixels()
        )));
    }
    Ok(made)
}

/// A call that works in the session.
unsafe fn change(session: *mut cophase_session, body: impl FnOnce(&mut Working) -> Result<()>) -> cophase_status {
    Handle::change(unsafe { find(session, "session") }.map(|session| &session.0), body)
}

/// A call that reads the results of its last fit.
unsafe fn read(session: *const cophase_session, body: impl FnOnce(&Working) -> Result<()>) -> cophase_status {
    // The kernels of a device belong to one thread at a time, even to be read.
    Handle::change(unsafe { find(session, "session") }.map(|session| &session.0), |working| body(working))
}

/// The session behind a handle, inside a call on another object.
pub(super) unsafe fn look<R>(session: *const cophase_session, body: impl FnOnce(&Session) -> R) -> Result<R> {
    let session = unsafe { find(session, "session") }?;
    session.0.look_alone(|working| body(&working.session))
}

/// Creates a session of a model, which need not outlive this call.
///
/// options: NULL for the defaults. session: receives the handle.
///
/// COPHASE_DEVICE if the device is absent or cannot run the model. COPHASE_BAD_VALUE for an option out of range, and for a
/// scene with estimate.optimizer = "bfgs".
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_create(
    model: *const cophase_model,
    options: *const cophase_session_options,
    session: *mut *mut cophase_session,
) -> cophase_status {
    fence(|| {
        let out = place(session, "session")?;
        start_threads()?;
        let options = unsafe { session_options(&sized::read(options, "options")?) }?;
        let estimator = unsafe { estimator(model) }?;
        let calibration = electrons_of(&estimator)?;
        let session = Session::new(estimator, &options)?;
        let cancel = session.cancel_flag();
        let handle = Handle::new::<cophase_session>(Working { session, calibration }, cancel);
        unsafe { out.write(Box::into_raw(Box::new(cophase_session(handle)))) };
        Ok(())
    })
}

/// Frees a session; NULL is fine.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_destroy(session: *mut cophase_session) {
    unsafe { give_back(session) }
}

/// Sets the calibration of the frames of later calls; the maps are copied. NULL: frames are electrons, or counts where the
/// scene has image.gain_e_per_adu, as before the first call.
///
/// COPHASE_BAD_VALUE for bad pixels if the model reduces the sampling of frames, which would smear them: such a camera
/// needs estimate.sampling = "native" in its scene.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_calibrate(
    session: *mut cophase_session,
    calibration: *const cophase_calibration,
) -> cophase_status {
    unsafe {
        change(session, |working| {
            working.calibration = calibration_for(working.session.estimator(), calibration)?;
            Ok(())
        })
    }
}

/// Makes the fit that is running in another thread, or else the next one, return COPHASE_INTERRUPTED within one evaluation.
/// A signal handler may call it. [RT]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_cancel(session: *const cophase_session) -> cophase_status {
    match unsafe { find(session, "session") } {
        Ok(session) => {
            session.0.aside.store(true, Ordering::Relaxed);
            COPHASE_OK
        }
        Err(error) => fence(|| Err(error)),
    }
}

/// Fits the model to frames. [RT]
///
/// frames: count x rows x cols, count up to the session's capacity. Values that are not finite are bad pixels. The optical
///   axis is on row rows/2 and column cols/2.
/// options: NULL for the defaults.
/// coefficients_nm: receives count x modes numbers in C order; NaN for an unusable image.
/// modes: the model's number of modes.
/// reports: receives count reports of report_size bytes each; NULL if they are not wanted. report_size:
///   sizeof(cophase_image_report).
///
/// The call succeeds where single images fail: their status is in their reports. COPHASE_INTERRUPTED after
/// cophase_session_cancel; nothing is written then.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_fit(
    session: *mut cophase_session,
    frames: *const cophase_input,
    options: *const cophase_fit_options,
    coefficients_nm: *mut f64,
    modes: usize,
    reports: *mut cophase_image_report,
    report_size: usize,
) -> cophase_status {
    unsafe {
        change(session, |working| {
            check_modes(modes, working.modes())?;
            let frames = Input::new(frames, "frames")?;
            let reports = Outputs::new(reports, report_size, ("reports", "report_size"))?;
            place(coefficients_nm, "coefficients_nm")?;
            let options = sized::read(options, "options")?;
            let count = working.take(&frames)?;
            working.session.fit(count, &fit_options(&options, count, modes)?)?;
            let out = numbers_mut(coefficients_nm, count * modes, "coefficients_nm")?;
            let found = working.session.results().iter().zip(out.chunks_exact_mut(modes));
            for (image, (result, out)) in found.enumerate() {
                out.copy_from_slice(&result.coefficients_nm);
                reports.put(image, &cophase_image_report::from_session(result));
            }
            Ok(())
        })
    }
}

/// Objective and gradient for an optimizer of the caller's: sum of weight * (flux * PSF + background - data)^2 over the
/// pixels of each image, with the flux and background that minimize it and the weights that a fit begins with. [RT]
///
/// frames: as in cophase_session_fit; NULL for those of the last evaluation, if no fit came since.
/// options: only read_noise_e and has_read_noise are used, and only with frames; NULL for the defaults.
/// coefficients_nm: count x modes numbers in C order. count: number of frames.
/// objectives: receives count numbers. gradients: receives count x modes numbers, per nm.
///
/// COPHASE_BAD_IMAGE for a frame that cannot be used. COPHASE_BAD_VALUE if frames is NULL and none are loaded.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_evaluate(
    session: *mut cophase_session,
    frames: *const cophase_input,
    options: *const cophase_fit_options,
    coefficients_nm: *const f64,
    count: usize,
    modes: usize,
    objectives: *mut f64,
    gradients: *mut f64,
) -> cophase_status {
    unsafe {
        change(session, |working| {
            check_modes(modes, working.modes())?;
            if count == 0 || count > working.session.capacity() {
                let capacity = working.session.capacity();
                return Err(Error::Shape(format!("count is {count}: 1 to {capacity} is accepted, the capacity")));
            }
            let coefficients_nm = numbers(coefficients_nm, count * modes, "coefficients_nm")?;
            let points = ArrayView2::from_shape((count, modes), coefficients_nm)
                .map_err(|error| Error::Internal(format!("the points of an evaluation: {error}")))?;
            let objectives = numbers_mut(objectives, count, "objectives")?;
            let gradients = numbers_mut(gradients, count * modes, "gradients")?;
            if !frames.is_null() {
                let frames = Input::new(frames, "frames")?;
                let options: cophase_fit_options = sized::read(options, "options")?;
                let read_noise_e = read_noise_e(options.read_noise_e, options.has_read_noise)?;
                let [given, rows, cols] = frames.shape();
                if given != count {
                    frames.must_be([count, rows, cols])?;
                }
                let count = working.take(&frames)?;
                working.session.load(count, read_noise_e)?;
            }
            working.session.evaluate(points, objectives, gradients)
        })
    }
}

/// Covariance of the coefficients of one image of the last fit, nm^2, from its noise, scaled by its chi-square where the
/// model misfits. Takes as long as some hundred evaluations.
///
/// covariance_nm2: receives modes x modes numbers. COPHASE_BAD_VALUE for an image that was not fitted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_covariance_nm2(
    session: *const cophase_session,
    image: usize,
    covariance_nm2: *mut f64,
    modes: usize,
) -> cophase_status {
    unsafe {
        read(session, |working| {
            check_modes(modes, working.modes())?;
            let out = numbers_mut(covariance_nm2, modes * modes, "covariance_nm2")?;
            let covariance_nm2 = working.session.covariance_nm2(image)?;
            out.iter_mut().zip(&covariance_nm2).for_each(|(out, value)| *out = *value);
            Ok(())
        })
    }
}

/// Writes a text of a session.
///
/// what: COPHASE_TEXT_IMAGE_MESSAGE, COPHASE_TEXT_WARNINGS, COPHASE_TEXT_DEVICE or COPHASE_TEXT_POLICY. index: image of the
/// last fit; ignored for the other texts. text, capacity, length: as in cophase_device_list.
///
/// COPHASE_BAD_VALUE for an image that was not in the last fit.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_text(
    session: *const cophase_session,
    what: i32,
    index: usize,
    text: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> cophase_status {
    unsafe {
        read(session, |working| {
            let session = &working.session;
            let sentence = match what {
                COPHASE_TEXT_IMAGE_MESSAGE => at(session.results(), index, "images of the last fit")?.report.sentence(),
                COPHASE_TEXT_WARNINGS => session.warnings().join("\n"),
                COPHASE_TEXT_DEVICE => session.device_name(),
                COPHASE_TEXT_POLICY => session.policy().name().into(),
                other => {
                    let known = "IMAGE_MESSAGE, WARNINGS, DEVICE or POLICY of the COPHASE_TEXT_ numbers is accepted";
                    return Err(Error::Value(format!("what is {other}: {known}")));
                }
            };
            put_text(text, capacity, length, &sentence)
        })
    }
}

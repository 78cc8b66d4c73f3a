//! Sessions: one thread's workspace to fit images in.

use super::device::{choice, cophase_device};
use super::handle::{Handle, fence, give_back, given_back, null};
use super::input::{Input, cophase_input};
use super::model::{check_modes, cophase_model, estimator};
use super::options::{
    self, cophase_calibration, cophase_fit_options, cophase_session_options, fit_options, session_options,
};
use super::pointer::{numbers, place, put_text, room};
use super::report::cophase_report;
use super::sized::{self, Reports};
use super::status::cophase_status;
use crate::estimate::{Calibration, CameraMaps, Session};
use crate::optimize::CancelFlag;
use crate::{Error, Result};
use ndarray::ArrayView2;
use std::sync::atomic::Ordering;

/// One thread's workspace: its memory, its kernels, its queue. Making it pays every cost that comes once.
///
/// One call at a time (COPHASE_BUSY otherwise), but for cophase_session_cancel. Calls marked [RT] allocate nothing, wait
/// for no lock and format no text while they succeed, on the CPU chain with one thread; a driver of OpenCL may do as it
/// likes. The same frame gives the same bits, whatever else is in the call, in every language.
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_session {
    inside: Handle<Working>,
    cancel: CancelFlag,
}

/// What a call works on.
pub(super) struct Working {
    session: Session,
    calibration: Calibration,
}

/// Makes a workspace for images of a model.
///
/// device: where it runs; NULL for the CPU chain. options: NULL for the defaults. session: receives the handle, which the
/// caller gives back with cophase_session_destroy. Neither device nor model need outlive this call.
///
/// COPHASE_DEVICE where the device cannot run the model.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_create(
    device: *const cophase_device,
    model: *const cophase_model,
    options: *const cophase_session_options,
    session: *mut *mut cophase_session,
) -> cophase_status {
    fence(|| {
        let out = place(session, "session")?;
        let options = unsafe { sized::read(options, "options") }?;
        let estimator = unsafe { estimator(model) }?;
        let options = session_options(&options, unsafe { choice(device) }?)?;
        let [x, y] = estimator.model().preparation.frame;
        let session = Session::new(estimator, &options)?;
        let calibration = Calibration::new((y, x), CameraMaps::default(), 1.0, f64::INFINITY)?;
        let cancel = session.cancel_flag();
        let inside = Handle::new(Working { session, calibration });
        unsafe { out.write(Box::into_raw(Box::new(cophase_session { inside, cancel }))) };
        Ok(())
    })
}

/// Frees a session; NULL is fine. No other call on it may be running, and none may follow.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_destroy(session: *mut cophase_session) {
    unsafe { give_back(session, |session| &session.inside) }
}

/// Makes the fit that is running in another thread, or else the next one, return COPHASE_INTERRUPTED within one
/// evaluation of the model. [RT], and the one call that is meant to race; a signal handler may make it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_cancel(session: *const cophase_session) -> cophase_status {
    match unsafe { session.as_ref() } {
        Some(session) if !session.inside.is_alive() => fence(|| Err(given_back())),
        Some(session) => {
            session.cancel.store(true, Ordering::Relaxed);
            super::status::COPHASE_OK
        }
        None => fence(|| Err(null("session"))),
    }
}

/// A call that works in the session.
unsafe fn change(session: *mut cophase_session, body: impl FnOnce(&mut Working) -> Result<()>) -> cophase_status {
    Handle::change(unsafe { session.as_ref() }.map(|session| &session.inside), "session", body)
}

/// A call that reads what its last fit found.
unsafe fn read(session: *const cophase_session, body: impl FnOnce(&Working) -> Result<()>) -> cophase_status {
    // A device's kernels belong to one thread at a time, even to be looked at.
    Handle::change(unsafe { session.as_ref() }.map(|session| &session.inside), "session", |working| body(working))
}

/// The session behind a handle, inside a call on another object.
pub(super) unsafe fn look<R>(session: *const cophase_session, body: impl FnOnce(&Session) -> R) -> Result<R> {
    let session = unsafe { session.as_ref() }.ok_or_else(|| null("session"))?;
    session.inside.look_alone(|working| body(&working.session))
}

/// Says what the raw values of coming frames mean. The maps are copied. NULL: frames are electrons, as they are until the
/// first call.
///
/// COPHASE_BAD_VALUE for bad pixels where the model reduces frames to its own sampling, which would smear them: a scene
/// with estimate.sampling = "native" does not.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_calibrate(
    session: *mut cophase_session,
    calibration: *const cophase_calibration,
) -> cophase_status {
    unsafe {
        change(session, |working| {
            let made = options::calibration(calibration, working.calibration.shape())?;
            let preparation = &working.session.estimator().model().preparation;
            if made.bad_pixels() > 0 && preparation.reduced != preparation.frame {
                return Err(Error::Value(format!(
                    "the calibration has {} bad pixels, which a reduction of the sampling would smear: a model of a \
                     scene with estimate.sampling = \"native\" is accepted",
                    made.bad_pixels()
                )));
            }
            working.calibration = made;
            Ok(())
        })
    }
}

impl Working {
    /// Turns a caller's frames into those of the session; how many they are.
    fn take(&mut self, frames: &Input) -> Result<usize> {
        let (rows, cols) = self.calibration.shape();
        let [count, ..] = frames.shape();
        frames.must_be([count, rows, cols])?;
        if count > self.session.capacity() {
            let capacity = self.session.capacity();
            return Err(Error::Shape(format!("frames has {count} frames: 1 to {capacity} are accepted, the capacity")));
        }
        for k in 0..count {
            let (mut data_e, mut bad) = self.session.frame_mut(k)?;
            let calibration = &self.calibration;
            frames.each(k, |y, x, raw| {
                let electrons = calibration.electrons(y, x, raw);
                data_e[[y, x]] = electrons.unwrap_or(0.0);
                bad[[y, x]] = electrons.is_none();
            });
        }
        Ok(count)
    }

    fn modes(&self) -> usize {
        self.session.estimator().model().optics.modes()
    }
}

/// Fits the model to frames. [RT]
///
/// frames: count x rows x cols, see cophase_model_frame_shape; count up to the session's capacity. Values that are not
///   finite are bad pixels. The optical axis is in row rows/2 and column cols/2.
/// options: NULL for the defaults.
/// coefficients_nm: receives count x modes numbers in C order; NaN for an image that could not be used.
/// reports: receives count reports, each in report_size bytes; NULL if they are not wanted. report_size:
///   sizeof(cophase_report).
///
/// The call succeeds where an image does not: what became of each is in its report. COPHASE_INTERRUPTED after
/// cophase_session_cancel, and then nothing is written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_fit(
    session: *mut cophase_session,
    frames: *const cophase_input,
    options: *const cophase_fit_options,
    coefficients_nm: *mut f64,
    modes: usize,
    reports: *mut cophase_report,
    report_size: usize,
) -> cophase_status {
    unsafe {
        change(session, |working| {
            check_modes(modes, working.modes())?;
            let frames = Input::of(frames, "frames")?;
            let reports = Reports::at(reports, report_size)?;
            place(coefficients_nm, "coefficients_nm")?;
            let options = sized::read(options, "options")?;
            let count = working.take(&frames)?;
            working.session.fit(count, &fit_options(&options, count, modes)?)?;
            let out = room(coefficients_nm, count * modes, "coefficients_nm")?;
            let found = working.session.results().iter().zip(out.chunks_exact_mut(modes));
            for (image, (result, out)) in found.enumerate() {
                out.copy_from_slice(&result.coefficients_nm);
                reports.put(image, &cophase_report::of(result));
            }
            Ok(())
        })
    }
}

/// Why an image of the last fit has the status that it has, in a sentence. `text`, `capacity` and `length` are as in
/// cophase_device_list.
///
/// COPHASE_BAD_VALUE for an image that was not in that fit.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_image_message(
    session: *const cophase_session,
    image: usize,
    text: *mut std::ffi::c_char,
    capacity: usize,
    length: *mut usize,
) -> cophase_status {
    unsafe {
        read(session, |working| {
            let results = working.session.results();
            let result = results.get(image).ok_or_else(|| {
                let count = results.len();
                Error::Value(format!("image is {image}: below {count} is accepted, the number in the last fit"))
            })?;
            put_text(text, capacity, length, &result.report.sentence())
        })
    }
}

/// That the device which "auto" chose was lost, and that the session goes on on the CPU, in a sentence; empty where it was
/// not. A device that was named fails with COPHASE_DEVICE instead. `text`, `capacity` and `length` are as in
/// cophase_device_list.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_device_failure(
    session: *const cophase_session,
    text: *mut std::ffi::c_char,
    capacity: usize,
    length: *mut usize,
) -> cophase_status {
    unsafe {
        read(session, |working| {
            let sentence = working.session.device_failure().unwrap_or_default();
            put_text(text, capacity, length, sentence)
        })
    }
}

/// Covariance of the coefficients of an image of the last fit, nm²: as its noise makes it, scaled by its χ² where the
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
            let out = room(covariance_nm2, modes * modes, "covariance_nm2")?;
            let covariance_nm2 = working.session.covariance_nm2(image)?;
            out.iter_mut().zip(&covariance_nm2).for_each(|(out, value)| *out = *value);
            Ok(())
        })
    }
}

/// Loads frames for cophase_session_evaluate, with the weights that a fit begins with. [RT]
///
/// frames, options: as for cophase_session_fit; of the options only read_noise_e counts. COPHASE_BAD_IMAGE where a frame
/// holds nothing to fit.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_load(
    session: *mut cophase_session,
    frames: *const cophase_input,
    options: *const cophase_fit_options,
) -> cophase_status {
    unsafe {
        change(session, |working| {
            let frames = Input::of(frames, "frames")?;
            let options = sized::read(options, "options")?;
            let count = working.take(&frames)?;
            let options = fit_options(&cophase_fit_options { start_nm: std::ptr::null(), ..options }, 0, 0)?;
            working.session.load(count, options.read_noise_e)
        })
    }
}

/// The objective and its gradient, for an optimizer of the caller's: Σ weight·(flux·PSF + background − data)² over the
/// pixels of each image that was loaded, flux and background being those that minimise it. [RT]
///
/// coefficients_nm: count x modes in C order, count being the number of frames that were loaded. objectives: receives
/// count numbers. gradients: receives count x modes, per nm. COPHASE_BAD_VALUE before cophase_session_load.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_evaluate(
    session: *mut cophase_session,
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
            let objectives = room(objectives, count, "objectives")?;
            let gradients = room(gradients, count * modes, "gradients")?;
            working.session.evaluate(points, objectives, gradients)
        })
    }
}

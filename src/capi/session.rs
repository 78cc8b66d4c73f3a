//! Sessions: fits with a deadline, in memory that is allocated beforehand.

use super::calibration::{calibration, cophase_calibration, read_noise_e};
use super::group_report::cophase_group_report;
use super::handle::{Handle, Object, fence, find, give_back};
use super::image_report::cophase_image_report;
use super::input::{Input, cophase_input};
use super::model::{check_modes, cophase_model, fitters};
use super::pointer::{numbers, numbers_mut, place, put_text, source};
use super::session_options::{cophase_fit_options, cophase_session_options, fit_options, session_options};
use super::sized::{self, Outputs};
use super::status::{COPHASE_OK, cophase_status};
use super::text::*;
use crate::machine::start_threads;
use crate::modal::{Calibration, CameraMaps, ModalFitter, Session};
use crate::pipeline::Control;
use crate::{Error, Result};
use ndarray::ArrayView2;
use std::ffi::c_char;

/// Session: fits of images with a model, in memory that is allocated when it is created. It follows
/// the policy COPHASE_POLICY_REALTIME: no modes with a prior, but for channels none of which
/// determines the wavefront by itself, no restarts; outlier pixels are rejected in the fit. The
/// same group gives the same bits, with any other groups in the call.
///
/// A group is what sees one wavefront: one frame of each channel of the model, which is one image
/// of a model with one channel. The frames of a group are fitted together, with the modes in common
/// and each its own tip, tilt, flux and background.
///
/// One call at a time (COPHASE_BUSY otherwise), except cophase_session_cancel, which any thread may
/// call at any time.
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_session(Handle<Working, Control>);

impl Object for cophase_session {
    const KIND: u64 = 3;
}

/// What a call works on.
pub(super) struct Working {
    session: Session,
    /// One for each channel.
    calibrations: Vec<Calibration>,
}

impl Working {
    fn new(session: Session) -> Result<Self> {
        let calibrations = session.channels().iter().map(|channel| electrons_of(channel.fitter()));
        Ok(Self { calibrations: calibrations.collect::<Result<_>>()?, session })
    }

    /// Copies a caller's frames of all channels into those of the session; the number of groups.
    unsafe fn take_all(&mut self, frames: *const cophase_input, channels: usize) -> Result<usize> {
        let first = source(frames, "frames")?;
        let wanted = self.calibrations.len();
        if channels != wanted {
            return Err(Error::Shape(format!("channels is {channels}: {wanted} is accepted, those of the model")));
        }
        let inputs = |channel| unsafe { Input::new(first.add(channel), "frames") };
        let [count, ..] = inputs(0)?.shape();
        for channel in 0..channels {
            let taken = inputs(channel).and_then(|frames| self.take(channel, &frames, count));
            if wanted == 1 {
                taken?;
            } else {
                taken.map_err(|error| error.of_channel(self.session.channels()[channel].name()))?;
            }
        }
        Ok(count)
    }

    /// Copies `count` frames of a channel into those of the session.
    fn take(&mut self, channel: usize, frames: &Input, count: usize) -> Result<()> {
        self.session.fitters().get(channel)?;
        let calibration = &self.calibrations[channel];
        let (rows, cols) = calibration.shape();
        frames.must_be([count, rows, cols])?;
        if count > self.session.capacity() {
            let capacity = self.session.capacity();
            return Err(Error::Shape(format!("frames has {count} frames: 1 to {capacity} are accepted, the capacity")));
        }
        for group in 0..count {
            let (mut data_e, mut bad) = self.session.frame_mut(group, channel)?;
            frames.each(group, |y, x, raw| {
                let electrons = calibration.electrons(y, x, raw);
                data_e[[y, x]] = electrons.unwrap_or(0.0);
                bad[[y, x]] = electrons.is_none();
            });
        }
        Ok(())
    }

    fn modes(&self) -> usize {
        self.session.fitters().first().model().optics.modes()
    }
}

/// The calibration of frames of a model before any is set: electrons, or counts where the scene has
/// a gain.
fn electrons_of(estimator: &ModalFitter) -> Result<Calibration> {
    let [x, y] = estimator.model().preparation.frame;
    let gain = estimator.scene().image.gain_e_per_adu.unwrap_or(1.0);
    Calibration::new((y, x), CameraMaps::default(), gain, f64::INFINITY)
}

/// A caller's calibration of frames of a model.
///
/// # Errors
/// [`Error::Value`] for bad pixels that a reduction of the sampling would smear.
unsafe fn calibration_for(estimator: &ModalFitter, calibration: *const cophase_calibration) -> Result<Calibration> {
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
    session.0.read_exclusively(|working| body(&working.session))
}

/// Creates a session of a model, which need not outlive this call.
///
/// options: NULL for the defaults. session: receives the handle.
///
/// COPHASE_DEVICE if the device is absent or cannot run the model. COPHASE_BAD_VALUE for an option
/// out of range, and for a scene with estimate.optimizer = "bfgs". COPHASE_BAD_SCENE for several
/// channels of which one is in focus, which an estimator takes.
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
        let session = Session::new(unsafe { fitters(model) }?, &options)?;
        let control = session.control().clone();
        let handle = Handle::new::<cophase_session>(Working::new(session)?, control);
        unsafe { out.write(Box::into_raw(Box::new(cophase_session(handle)))) };
        Ok(())
    })
}

/// Frees a session; NULL is fine.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_destroy(session: *mut cophase_session) {
    unsafe { give_back(session) }
}

/// Sets the calibration of later frames of a channel; the maps are copied. channel: its number in
/// the model, from 0. calibration: NULL where frames are electrons, or counts where the scene has
/// image.gain_e_per_adu, as before the first call.
///
/// COPHASE_BAD_VALUE for a channel that the model does not have, and for bad pixels if the model
/// reduces the sampling of frames, which would smear them: such a camera needs estimate.sampling =
/// "native" in its scene.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_calibrate(
    session: *mut cophase_session,
    channel: usize,
    calibration: *const cophase_calibration,
) -> cophase_status {
    unsafe {
        change(session, |working| {
            let (_, fitter) = working.session.fitters().get(channel)?;
            working.calibrations[channel] = calibration_for(fitter, calibration)?;
            Ok(())
        })
    }
}

/// Makes the fit that is running in another thread, or else the next one, return
/// COPHASE_INTERRUPTED within one evaluation. A signal handler may call it. [RT]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_cancel(session: *const cophase_session) -> cophase_status {
    match unsafe { find(session, "session") } {
        Ok(session) => {
            session.0.aside.cancel();
            COPHASE_OK
        }
        Err(error) => fence(|| Err(error)),
    }
}

/// Fits the model to frames, those of a group together. [RT]
///
/// frames: an array for each channel, in the order of the model, each count x rows x cols of its
///   channel, count up to the session's capacity: frames k of all channels are group k. Values that
///   are not finite are bad pixels. The optical axis is on row rows/2 and column cols/2.
/// channels: number of channels of the model.
/// options: NULL for the defaults. The deadline holds for all frames together.
/// coefficients_nm: receives count x modes numbers in C order: of one channel those of each image,
///   NaN for an unusable one; of several the modes that they have in common, NaN unless all frames
///   of the group can be used and the fit converged.
/// sigma_nm: receives count x modes error bars (1 sigma) of the common modes of several channels;
///   NULL if they are not wanted. They are those of a flat wavefront with the flux and the noise of
///   the frames, scaled by chi-square where a model misfits and where the channels contradict each
///   other. They hold the noise, and not what the scene
///   does not know (plate scale, defocus, gains) nor what the modes leave out:
///   cophase_estimator_estimate has these. NaN for one channel, whose covariance
///   cophase_session_refine has.
/// modes: the model's number of modes.
/// images: receives count x channels reports in C order, of image_size bytes each; NULL if they are
///   not wanted. image_size: sizeof(cophase_image_report).
/// groups: receives count reports of group_size bytes each; NULL if they are not wanted.
///   group_size: sizeof(cophase_group_report).
///
/// The call succeeds where single images fail: their status is in their reports.
/// COPHASE_INTERRUPTED after cophase_session_cancel; nothing is written then.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_fit(
    session: *mut cophase_session,
    frames: *const cophase_input,
    channels: usize,
    options: *const cophase_fit_options,
    coefficients_nm: *mut f64,
    sigma_nm: *mut f64,
    modes: usize,
    images: *mut cophase_image_report,
    image_size: usize,
    groups: *mut cophase_group_report,
    group_size: usize,
) -> cophase_status {
    unsafe {
        change(session, |working| {
            check_modes(modes, working.modes())?;
            let images = Outputs::new(images, image_size, ("images", "image_size"))?;
            let groups = Outputs::new(groups, group_size, ("groups", "group_size"))?;
            place(coefficients_nm, "coefficients_nm")?;
            if !sigma_nm.is_null() {
                place(sigma_nm, "sigma_nm")?;
            }
            let options = sized::read(options, "options")?;
            let count = working.take_all(frames, channels)?;
            working.session.fit(count, &fit_options(&options, count, modes)?)?;
            for (group, result) in working.session.results().iter().enumerate() {
                let at = group * modes;
                numbers_mut(coefficients_nm.add(at), modes, "coefficients_nm")?
                    .copy_from_slice(&result.coefficients_nm);
                if !sigma_nm.is_null() {
                    numbers_mut(sigma_nm.add(at), modes, "sigma_nm")?.copy_from_slice(&result.sigma_nm);
                }
                groups.put(group, &result.into());
                let is_used = channels > 1 && result.coefficients_nm.iter().all(|nm| nm.is_finite());
                for (channel, fits) in working.session.channels().iter().enumerate() {
                    let report = cophase_image_report::from_session(&fits.results()[group], channel, is_used);
                    images.put(group * channels + channel, &report);
                }
            }
            Ok(())
        })
    }
}

/// Objective and gradient for an optimizer of the caller's: sum of weight * (flux * PSF +
/// background - data)^2 over the pixels of each image, with the flux and background that minimize
/// it and the weights that a fit begins with. [RT]
///
/// channel: number of the channel in the model, from 0, whose images they are.
/// frames: count x rows x cols of the channel; NULL for those of its last evaluation, if no fit
///   came since.
/// options: only read_noise_e and has_read_noise are used, and only with frames; NULL for the
///   defaults.
/// coefficients_nm: count x modes numbers in C order. count: number of frames.
/// objectives: receives count numbers. gradients: receives count x modes numbers, per nm.
///
/// COPHASE_BAD_IMAGE for a frame that cannot be used. COPHASE_BAD_VALUE if frames is NULL and none
/// are loaded.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_evaluate(
    session: *mut cophase_session,
    channel: usize,
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
                working.take(channel, &frames, count)?;
                working.session.load(channel, count, read_noise_e)?;
            }
            working.session.evaluate(channel, points, objectives, gradients)
        })
    }
}

/// The result of a group of the last fit with its covariance, in some hundred evaluations of each
/// channel: of one channel that of the noise, scaled by chi-square where the model misfits. Of
/// several channels it is from the information at the fitted wavefront, with the whole wavelengths
/// of pistons found (modes.piston_range_nm): what cophase_estimator_estimate finds in these frames
/// by the policy COPHASE_POLICY_REALTIME.
///
/// group: number of the group in the last fit, from 0.
/// coefficients_nm: receives `modes` numbers. covariance_nm2: receives modes x modes numbers. Each
///   may be NULL. modes: the model's number of modes.
/// report: NULL if it is not wanted. report_size: sizeof(cophase_group_report).
///
/// COPHASE_BAD_VALUE for a group that was not fitted, and unless the fit of several channels
/// converged.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_session_refine(
    session: *const cophase_session,
    group: usize,
    coefficients_nm: *mut f64,
    covariance_nm2: *mut f64,
    modes: usize,
    report: *mut cophase_group_report,
    report_size: usize,
) -> cophase_status {
    unsafe {
        read(session, |working| {
            check_modes(modes, working.modes())?;
            let report = Outputs::new(report, report_size, ("report", "report_size"))?;
            let outputs = [(coefficients_nm, "coefficients_nm"), (covariance_nm2, "covariance_nm2")];
            // All are checked before the first is written.
            for (out, name) in outputs.into_iter().filter(|(out, _)| !out.is_null()) {
                place(out, name)?;
            }
            let refined = working.session.refine(group)?;
            let covariance_nm2 = refined.modes.covariance_nm2.iter().copied().collect();
            let values: [Vec<f64>; 2] = [refined.modes.coefficients_nm.clone(), covariance_nm2];
            for ((out, name), values) in outputs.into_iter().zip(values).filter(|((out, _), _)| !out.is_null()) {
                numbers_mut(out, values.len(), name)?.copy_from_slice(&values);
            }
            let status = &working.session.results()[group].status;
            report.put(0, &cophase_group_report::of_refined(&refined, status));
            Ok(())
        })
    }
}

/// Writes a text of a session.
///
/// what: COPHASE_TEXT_IMAGE_MESSAGE, COPHASE_TEXT_WARNINGS, with that of channels that contradict
///   each other in the last fit, COPHASE_TEXT_DEVICE or COPHASE_TEXT_POLICY. index: image of the
///   last fit, group * channels + channel; ignored for the other texts. text, capacity, length: as
///   in cophase_device_list.
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
                COPHASE_TEXT_IMAGE_MESSAGE => {
                    let channels = session.channels().len();
                    let images: Vec<_> = session.channels().iter().map(|channel| channel.results()).collect();
                    check_index(index, channels * session.results().len(), "images of the last fit")?;
                    images[index % channels][index / channels].report.sentence()
                }
                COPHASE_TEXT_WARNINGS => session.warnings().join("\n"),
                COPHASE_TEXT_DEVICE => session.device_name().into(),
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

//! Sessions of several channels: fits of one frame of each, and their combination, in memory that is allocated beforehand.

use super::calibration::cophase_calibration;
use super::handle::{Handle, Object, fence, find, give_back};
use super::image_report::{cophase_image_report, number};
use super::input::{Input, cophase_input};
use super::model::{check_modes, cophase_model, scene};
use super::pointer::{numbers_mut, place, put, put_text, source};
use super::session::{calibration_for, cophase_fit_options, cophase_session_options, copy_frame, electrons_of};
use super::session::{fit_options, session_options};
use super::sized::{self, Outputs};
use super::status::{COPHASE_OK, cophase_status};
use super::text::*;
use crate::machine::start_threads;
use crate::modal::{Calibration, JointFit, JointSession, RefinedFit};
use crate::optimize::CancelFlag;
use crate::scene::Scene;
use crate::{Error, Result, planner};
use std::ffi::c_char;
use std::sync::atomic::Ordering;

/// Session of several channels ([[image.channel]]): fits of one frame of each, and the wavefront that they have in common, in memory that
/// is allocated when it is created. Each channel is fitted as a cophase_session fits a frame, to the same bits.
///
/// One call at a time (COPHASE_BUSY otherwise), except cophase_joint_session_cancel, which any thread may call at any time.
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_joint_session(Handle<Working, CancelFlag>);

impl Object for cophase_joint_session {
    const KIND: u64 = 4;
}

/// What a call works on.
struct Working {
    session: JointSession,
    /// One for each channel.
    calibrations: Vec<Calibration>,
}

/// Report on the joint result of one frame of each channel.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct cophase_joint_report {
    /// The worst status of the channels, a COPHASE_IMAGE_ number; above COPHASE_IMAGE_WRONG_MINIMUM there is no joint result.
    pub status: i32,
    /// 1 if the channels differ by more than their noise: one is flipped, of another wavelength or diversity than the scene says, of
    /// another wavefront, or in another minimum; in several wavelengths also where a piston is more than half a wavelength from the start.
    pub is_contradictory: i32,
    /// Chi-square per degree of freedom of the differences of the channels, 1 where they agree; NaN without a joint result.
    pub reduced_chi2: f64,
    /// Its degrees of freedom; 0 where the channels have no mode in common that both determine.
    pub freedom: f64,
    /// The smallest probability of the whole wavelengths of a piston; NaN where they were not sought: in one wavelength, and in a fit.
    pub piston_probability: f64,
    /// Duration of the fit, s; NaN of a refinement.
    pub seconds: f64,
}

impl cophase_joint_report {
    fn of_fit(fit: &JointFit) -> Self {
        let (reduced_chi2, freedom) = fit.disagreement;
        Self {
            status: number(&fit.status),
            is_contradictory: fit.is_contradictory.into(),
            reduced_chi2,
            freedom,
            piston_probability: f64::NAN,
            seconds: fit.seconds,
        }
    }

    fn of_refined(refined: &RefinedFit, fit: &JointFit) -> Self {
        let (reduced_chi2, freedom) = refined.disagreement;
        let probabilities = refined.integers.iter().map(|integer| integer.probability);
        Self {
            is_contradictory: refined.is_contradictory.into(),
            reduced_chi2,
            freedom,
            piston_probability: probabilities.fold(f64::NAN, f64::min),
            seconds: f64::NAN,
            ..Self::of_fit(fit)
        }
    }
}

impl Working {
    fn new(session: JointSession) -> Result<Self> {
        let calibrations = (0..session.names().len()).map(|channel| electrons_of(session.estimator(channel)?));
        Ok(Self { calibrations: calibrations.collect::<Result<_>>()?, session })
    }

    /// Copies a caller's frames, one of each channel, into those of the session.
    unsafe fn take(&mut self, frames: *const cophase_input, channels: usize) -> Result<()> {
        let first = source(frames, "frames")?;
        let wanted = self.calibrations.len();
        if channels != wanted {
            return Err(Error::Shape(format!(
                "channels is {channels}: {wanted} is accepted, the channels of the scene"
            )));
        }
        for (channel, calibration) in self.calibrations.iter().enumerate() {
            let (rows, cols) = calibration.shape();
            let frame = unsafe { Input::new(first.add(channel), "frames") };
            let frame = frame.and_then(|frame| frame.must_be([1, rows, cols]));
            let frame = frame.map_err(|error| error.of_channel(&self.session.names()[channel]))?;
            copy_frame(&frame, 0, calibration, self.session.frame_mut(channel)?);
        }
        Ok(())
    }

    fn modes(&self) -> Result<usize> {
        Ok(self.session.estimator(0)?.model().optics.modes())
    }

    /// The joint result of the last fit.
    fn result(&self) -> Result<&JointFit> {
        self.session.result().ok_or_else(|| Error::Value("no frames are fitted: fit them first".into()))
    }
}

/// A call that works in the session.
unsafe fn change(session: *mut cophase_joint_session, body: impl FnOnce(&mut Working) -> Result<()>) -> cophase_status {
    Handle::change(unsafe { find(session, "session") }.map(|session| &session.0), body)
}

/// A call that reads it.
unsafe fn read(session: *const cophase_joint_session, body: impl FnOnce(&Working) -> Result<()>) -> cophase_status {
    // The kernels of a device belong to one thread at a time, even to be read.
    Handle::change(unsafe { find(session, "session") }.map(|session| &session.0), |working| body(working))
}

/// Creates a session of a scene with several channels; builds their models, half a second each at the size of Keck.
///
/// scene_text, directory: as in cophase_model_create. options: NULL for the defaults; a capacity of 0 or 1. session: receives the handle.
///
/// COPHASE_BAD_SCENE for a scene without channels, or with a channel in focus, which an estimator takes; else as cophase_model_create and
/// cophase_session_create.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_joint_session_create(
    scene_text: *const c_char,
    directory: *const c_char,
    options: *const cophase_session_options,
    session: *mut *mut cophase_joint_session,
) -> cophase_status {
    fence(|| {
        let out = place(session, "session")?;
        start_threads()?;
        let options = unsafe { session_options(&sized::read(options, "options")?) }?;
        let (scene_text, directory) = unsafe { scene(scene_text, directory) }?;
        let scene = planner::resolve(&Scene::from_text(scene_text, directory)?, None)?;
        let session = JointSession::new(&scene, &options)?;
        let cancel = session.cancel_flag();
        let handle = Handle::new::<cophase_joint_session>(Working::new(session)?, cancel);
        unsafe { out.write(Box::into_raw(Box::new(cophase_joint_session(handle)))) };
        Ok(())
    })
}

/// Frees a session; NULL is fine.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_joint_session_destroy(session: *mut cophase_joint_session) {
    unsafe { give_back(session) }
}

/// The model of a channel, in the order of the scene from 0: size of its frames, modes, which all channels share, and maps of them.
///
/// model: receives a handle of its own, which the caller destroys. COPHASE_BAD_VALUE for a channel that the scene does not have.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_joint_session_model(
    session: *const cophase_joint_session,
    channel: usize,
    model: *mut *mut cophase_model,
) -> cophase_status {
    unsafe {
        read(session, |working| {
            let out = place(model, "model")?;
            out.write(cophase_model::of(working.session.estimator(channel)?.clone())?);
            Ok(())
        })
    }
}

/// Sets the calibration of later frames of a channel, as cophase_session_calibrate.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_joint_session_calibrate(
    session: *mut cophase_joint_session,
    channel: usize,
    calibration: *const cophase_calibration,
) -> cophase_status {
    unsafe {
        change(session, |working| {
            let made = calibration_for(working.session.estimator(channel)?, calibration)?;
            working.calibrations[channel] = made;
            Ok(())
        })
    }
}

/// Makes the fit that is running in another thread, or else the next one, return COPHASE_INTERRUPTED within one evaluation.
/// A signal handler may call it. [RT]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_joint_session_cancel(session: *const cophase_joint_session) -> cophase_status {
    match unsafe { find(session, "session") } {
        Ok(session) => {
            session.0.aside.store(true, Ordering::Relaxed);
            COPHASE_OK
        }
        Err(error) => fence(|| Err(error)),
    }
}

/// Fits one frame of each channel, one after the other, and combines the fits. [RT]
///
/// frames: one for each channel, in the order of the scene, 1 x rows x cols as the channel says; else as in cophase_session_fit.
/// channels: their number.
/// options: NULL for the defaults. The deadline holds for all channels together; start_nm is 1 x modes, for all.
/// coefficients_nm, sigma_nm: receive the common modes and their error bars (1 sigma), `modes` numbers each; sigma_nm may be NULL. NaN
///   unless the fits of all channels converged. The channels are weighed, and error bars are, as at a flat wavefront with the flux and
///   the noise of the frames, scaled by chi-square where a model misfits or the channels contradict each other.
/// modes: number of modes of the models.
/// report: NULL if it is not wanted. report_size: sizeof(cophase_joint_report).
/// images: receives a report on each channel's own fit, of image_size bytes each; NULL if they are not wanted. image_size:
///   sizeof(cophase_image_report).
///
/// The call succeeds where single frames fail: see the reports. COPHASE_INTERRUPTED after cophase_joint_session_cancel; nothing is written
/// then.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_joint_session_fit(
    session: *mut cophase_joint_session,
    frames: *const cophase_input,
    channels: usize,
    options: *const cophase_fit_options,
    coefficients_nm: *mut f64,
    sigma_nm: *mut f64,
    modes: usize,
    report: *mut cophase_joint_report,
    report_size: usize,
    images: *mut cophase_image_report,
    image_size: usize,
) -> cophase_status {
    unsafe {
        change(session, |working| {
            check_modes(modes, working.modes()?)?;
            let report = Outputs::new(report, report_size, ("report", "report_size"))?;
            let images = Outputs::new(images, image_size, ("images", "image_size"))?;
            place(coefficients_nm, "coefficients_nm")?;
            if !sigma_nm.is_null() {
                place(sigma_nm, "sigma_nm")?;
            }
            let options = sized::read(options, "options")?;
            working.take(frames, channels)?;
            working.session.fit(&fit_options(&options, 1, modes)?)?;
            let fit = working.result()?;
            numbers_mut(coefficients_nm, modes, "coefficients_nm")?.copy_from_slice(&fit.coefficients_nm);
            if !sigma_nm.is_null() {
                numbers_mut(sigma_nm, modes, "sigma_nm")?.copy_from_slice(&fit.sigma_nm);
            }
            report.put(0, &cophase_joint_report::of_fit(fit));
            for (channel, result) in working.session.results().enumerate() {
                images.put(channel, &cophase_image_report::from_joint_session(result, channel, fit));
            }
            Ok(())
        })
    }
}

/// Combines the last fits by their information at the fitted wavefronts, and finds the whole wavelengths of pistons
/// (modes.piston_range_nm): what cophase_estimator_estimate_channels finds in these frames by the policy COPHASE_POLICY_REALTIME. It takes
/// as long as some hundred evaluations of each channel.
///
/// coefficients_nm: receives `modes` numbers. covariance_nm2: receives modes x modes numbers. Each may be NULL. modes: number of modes.
/// report: NULL if it is not wanted. report_size: sizeof(cophase_joint_report).
///
/// COPHASE_BAD_VALUE unless the last fits of all channels converged.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_joint_session_refine(
    session: *const cophase_joint_session,
    coefficients_nm: *mut f64,
    covariance_nm2: *mut f64,
    modes: usize,
    report: *mut cophase_joint_report,
    report_size: usize,
) -> cophase_status {
    unsafe {
        read(session, |working| {
            check_modes(modes, working.modes()?)?;
            let report = Outputs::new(report, report_size, ("report", "report_size"))?;
            let outputs = [(coefficients_nm, "coefficients_nm"), (covariance_nm2, "covariance_nm2")];
            // All are checked before the first is written.
            for (out, name) in outputs.into_iter().filter(|(out, _)| !out.is_null()) {
                place(out, name)?;
            }
            let refined = working.session.refine()?;
            let all = [refined.coefficients_nm.clone(), refined.covariance_nm2.iter().copied().collect()];
            for ((out, name), values) in outputs.into_iter().zip(all).filter(|((out, _), _)| !out.is_null()) {
                numbers_mut(out, values.len(), name)?.copy_from_slice(&values);
            }
            report.put(0, &cophase_joint_report::of_refined(&refined, working.result()?));
            Ok(())
        })
    }
}

/// Number of channels of a session, in `*channels`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_joint_session_channels(
    session: *const cophase_joint_session,
    channels: *mut usize,
) -> cophase_status {
    unsafe { read(session, |working| put(channels, "channels", working.calibrations.len())) }
}

/// Writes a text of a session.
///
/// what: COPHASE_TEXT_IMAGE_MESSAGE, COPHASE_TEXT_CHANNEL_NAME, COPHASE_TEXT_WARNINGS, with that of channels that contradict each other in
///   the last fit, COPHASE_TEXT_DEVICE or COPHASE_TEXT_POLICY. index: channel; ignored for the other texts. text, capacity, length: as in
///   cophase_device_list.
///
/// COPHASE_BAD_VALUE for a channel that the scene does not have, and for an image message without a fit.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_joint_session_text(
    session: *const cophase_joint_session,
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
                    let results: Vec<_> = session.results().collect();
                    at(&results, index, "channels of the last fit")?.report.sentence()
                }
                COPHASE_TEXT_CHANNEL_NAME => at(session.names(), index, "channels")?.clone(),
                COPHASE_TEXT_WARNINGS => session.warnings().join("\n"),
                COPHASE_TEXT_DEVICE => session.device_name(),
                COPHASE_TEXT_POLICY => session.policy().name().into(),
                other => {
                    let known = "IMAGE_MESSAGE, CHANNEL_NAME, WARNINGS, DEVICE or POLICY of the COPHASE_TEXT_ numbers is accepted";
                    return Err(Error::Value(format!("what is {other}: {known}")));
                }
            };
            put_text(text, capacity, length, &sentence)
        })
    }
}

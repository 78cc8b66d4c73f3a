//! Sequences: running estimate of images that are fitted one by one.

use super::handle::{Handle, Object, fence, find, give_back};
use super::model::{check_modes, cophase_model, fitters};
use super::pointer::{place, put, put_array};
use super::session::{self, cophase_session};
use super::sized::Outputs;
use super::status::cophase_status;
use crate::Result;
use crate::modal::{Accumulator, RunningEstimate};

/// Sequence: the last images that sessions of a model fitted, and their running estimate. Calls
/// that take it as const may run in several threads at once, any other only while no other call
/// runs (COPHASE_BUSY otherwise).
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_sequence(Handle<Accumulator>);

impl Object for cophase_sequence {
    const KIND: u64 = 4;
}

/// Figures of a running estimate. RMS values are over the pupil.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_sequence_report {
    /// Images in the sequence.
    pub images: usize,
    /// Images that were combined.
    pub used: usize,
    /// Images that were fitted and left out as outliers.
    pub clipped: usize,
    /// Phasing errors, nm RMS.
    pub phasing_rms_nm: f64,
    /// Their error bar, nm RMS.
    pub phasing_sigma_nm: f64,
    /// Non-common path aberrations, nm RMS.
    pub ncpa_rms_nm: f64,
    /// Their error bar, nm RMS.
    pub ncpa_sigma_nm: f64,
    /// Median chi-square per degree of freedom of the images that were combined.
    pub reduced_chi2: f64,
}

impl From<&RunningEstimate> for cophase_sequence_report {
    fn from(estimate: &RunningEstimate) -> Self {
        Self {
            images: estimate.images,
            used: estimate.used,
            clipped: estimate.clipped,
            phasing_rms_nm: estimate.phasing_rms_nm,
            phasing_sigma_nm: estimate.phasing_sigma_nm,
            ncpa_rms_nm: estimate.ncpa_rms_nm,
            ncpa_sigma_nm: estimate.ncpa_sigma_nm,
            reduced_chi2: estimate.reduced_chi2,
        }
    }
}

/// A call that reads the sequence.
unsafe fn read(sequence: *const cophase_sequence, body: impl FnOnce(&Accumulator) -> Result<()>) -> cophase_status {
    Handle::read(unsafe { find(sequence, "sequence") }.map(|sequence| &sequence.0), body)
}

/// A call that changes it.
unsafe fn change(sequence: *mut cophase_sequence, body: impl FnOnce(&mut Accumulator) -> Result<()>) -> cophase_status {
    Handle::change(unsafe { find(sequence, "sequence") }.map(|sequence| &sequence.0), body)
}

/// Creates an empty sequence that keeps the last `capacity` images of sessions of a model, which
/// need not outlive this call. sequence: receives the handle.
///
/// COPHASE_BAD_VALUE for a model of several channels.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_create(
    model: *const cophase_model,
    capacity: usize,
    sequence: *mut *mut cophase_sequence,
) -> cophase_status {
    fence(|| {
        let out = place(sequence, "sequence")?;
        let made = Accumulator::new(unsafe { fitters(model) }?.only("a sequence")?.clone(), capacity)?;
        unsafe { out.write(Box::into_raw(Box::new(cophase_sequence(Handle::new::<cophase_sequence>(made, ()))))) };
        Ok(())
    })
}

/// Frees a sequence; NULL is fine.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_destroy(sequence: *mut cophase_sequence) {
    unsafe { give_back(sequence) }
}

/// Adds all images of a session's last fit, of any status; the oldest are dropped beyond the
/// capacity. session NULL: drops all images. [RT]
///
/// COPHASE_BAD_VALUE for a session of another model, or of several channels. COPHASE_BUSY while the
/// session is in use.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_push(
    sequence: *mut cophase_sequence,
    session: *const cophase_session,
) -> cophase_status {
    unsafe {
        change(sequence, |sequence| {
            if session.is_null() {
                sequence.clear();
                return Ok(());
            }
            session::look(session, |session| sequence.push(session))?
        })
    }
}

/// The estimate from the images so far: their mean, clipped mean or median, as the scene says
/// (estimate.combine). From eight images on, outliers are found by comparing images, and error bars
/// are from the scatter between them.
///
/// coefficients_nm: receives `modes` numbers. sigma_nm: receives `modes` standard deviations.
///   covariance_nm2: receives modes x modes numbers. Each may be NULL.
/// modes: the model's number of modes.
/// report: NULL if it is not wanted. report_size: sizeof(cophase_sequence_report).
///
/// COPHASE_BAD_IMAGE if no image of the sequence was fitted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_estimate(
    sequence: *const cophase_sequence,
    coefficients_nm: *mut f64,
    sigma_nm: *mut f64,
    covariance_nm2: *mut f64,
    modes: usize,
    report: *mut cophase_sequence_report,
    report_size: usize,
) -> cophase_status {
    unsafe {
        read(sequence, |sequence| {
            check_modes(modes, sequence.fitter().model().optics.modes())?;
            let report = Outputs::new(report, report_size, ("report", "report_size"))?;
            let outputs =
                [(coefficients_nm, "coefficients_nm"), (sigma_nm, "sigma_nm"), (covariance_nm2, "covariance_nm2")];
            // All are checked before the first is written.
            for (out, name) in outputs.into_iter().filter(|(out, _)| !out.is_null()) {
                place(out, name)?;
            }
            let estimate = sequence.estimate()?;
            let modes = &estimate.modes;
            let covariance = modes.covariance_nm2.iter().copied().collect();
            let values: [Vec<f64>; 3] = [modes.coefficients_nm.clone(), modes.sigma_nm(), covariance];
            for ((out, _), values) in outputs.into_iter().zip(values).filter(|((out, _), _)| !out.is_null()) {
                put_array(out, values.len(), &[values.len()], values)?;
            }
            report.put(0, &(&estimate).into());
            Ok(())
        })
    }
}

/// Number of further images like those so far that bring both error bars (nm RMS over the pupil)
/// down to the given ones, in `*images`; 0 if they are. Infinity accepts any error bar.
///
/// COPHASE_BAD_VALUE if errors that all images share alone are larger. COPHASE_BAD_IMAGE if no
/// image was fitted.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_images_needed(
    sequence: *const cophase_sequence,
    phasing_nm: f64,
    ncpa_nm: f64,
    images: *mut u64,
) -> cophase_status {
    unsafe { read(sequence, |sequence| put(images, "images", sequence.images_needed(phasing_nm, ncpa_nm)?)) }
}

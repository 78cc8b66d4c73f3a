//! Sequences: the running static estimate of images that come one by one.

use super::handle::{Handle, fence, give_back};
use super::model::{check_modes, cophase_model, estimator};
use super::pointer::{place, put, room};
use super::session::{self, cophase_session};
use super::sized::Reports;
use super::status::cophase_status;
use crate::Result;
use crate::estimate::{Accumulator, RunningEstimate};

/// The images of one static wavefront, as they come: what they say together, how well, and how many more are needed.
///
/// Calls that take it as const may run in several threads at once; any other only while no other call runs
/// (COPHASE_BUSY otherwise).
#[allow(non_camel_case_types)] // a name of the header
pub struct cophase_sequence(Handle<Accumulator>);

/// What the images of a sequence say together. Later versions may append fields.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_sequence_report {
    /// Images that are kept.
    pub images: u64,
    /// Those that were combined.
    pub used: u64,
    /// Those that were fitted but left out as outliers.
    pub clipped: u64,
    /// The segments' part of the wavefront, nm RMS over the pupil.
    pub phasing_rms_nm: f64,
    /// Its error bar, nm RMS over the pupil.
    pub phasing_sigma_nm: f64,
    /// The non-common path aberrations, nm RMS over the pupil.
    pub ncpa_rms_nm: f64,
    /// Their error bar, nm RMS over the pupil.
    pub ncpa_sigma_nm: f64,
    /// Median χ² per degree of freedom of the images that were combined.
    pub reduced_chi2: f64,
}

impl cophase_sequence_report {
    fn of(estimate: &RunningEstimate) -> Self {
        Self {
            images: estimate.images as u64,
            used: estimate.used as u64,
            clipped: estimate.clipped as u64,
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
    Handle::read(unsafe { sequence.as_ref() }.map(|sequence| &sequence.0), "sequence", body)
}

/// A call that changes it.
unsafe fn change(sequence: *mut cophase_sequence, body: impl FnOnce(&mut Accumulator) -> Result<()>) -> cophase_status {
    Handle::change(unsafe { sequence.as_ref() }.map(|sequence| &sequence.0), "sequence", body)
}

/// Makes an empty sequence of images of a model, which keeps the last `capacity` of them. The model need not outlive this
/// call.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_create(
    model: *const cophase_model,
    capacity: usize,
    sequence: *mut *mut cophase_sequence,
) -> cophase_status {
    fence(|| {
        let out = place(sequence, "sequence")?;
        let made = Accumulator::new(unsafe { estimator(model) }?, capacity)?;
        unsafe { out.write(Box::into_raw(Box::new(cophase_sequence(Handle::new(made))))) };
        Ok(())
    })
}

/// Frees a sequence; NULL is fine. No other call on it may be running, and none may follow.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_destroy(sequence: *mut cophase_sequence) {
    unsafe { give_back(sequence, |sequence| &sequence.0) }
}

/// Takes all images of a session's last fit, whatever became of them; the oldest make way. [RT]
///
/// COPHASE_BAD_VALUE for a session of another model, COPHASE_BUSY while the session fits in another thread.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_push(
    sequence: *mut cophase_sequence,
    session: *const cophase_session,
) -> cophase_status {
    unsafe { change(sequence, |sequence| session::look(session, |session| sequence.push(session))?) }
}

/// Forgets all images. [RT]
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_clear(sequence: *mut cophase_sequence) -> cophase_status {
    unsafe {
        change(sequence, |sequence| {
            sequence.clear();
            Ok(())
        })
    }
}

/// The static estimate so far: mean or median of the images as the scene says (estimate.combine). Up to seven images are
/// judged one by one; from eight on by one another, and error bars are from the scatter between them.
///
/// coefficients_nm, sigma_nm: receive modes numbers; sigma_nm (1σ of each) may be NULL. report: NULL if it is not wanted;
/// report_size: sizeof(cophase_sequence_report). COPHASE_BAD_IMAGE where no image was fitted yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_estimate(
    sequence: *const cophase_sequence,
    coefficients_nm: *mut f64,
    sigma_nm: *mut f64,
    modes: usize,
    report: *mut cophase_sequence_report,
    report_size: usize,
) -> cophase_status {
    unsafe {
        read(sequence, |sequence| {
            check_modes(modes, sequence.estimator().model().optics.modes())?;
            let report = Reports::at(report, report_size)?;
            let coefficients_nm = room(coefficients_nm, modes, "coefficients_nm")?;
            let sigma_nm = if sigma_nm.is_null() { None } else { Some(room(sigma_nm, modes, "sigma_nm")?) };
            let estimate = sequence.estimate()?;
            coefficients_nm.copy_from_slice(&estimate.combined.coefficients_nm);
            if let Some(sigma_nm) = sigma_nm {
                sigma_nm.copy_from_slice(&estimate.combined.sigma_nm());
            }
            report.put(0, &cophase_sequence_report::of(&estimate));
            Ok(())
        })
    }
}

/// Covariance of the static estimate so far, nm². covariance_nm2: receives modes x modes numbers. COPHASE_BAD_IMAGE where
/// no image was fitted yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_covariance_nm2(
    sequence: *const cophase_sequence,
    covariance_nm2: *mut f64,
    modes: usize,
) -> cophase_status {
    unsafe {
        read(sequence, |sequence| {
            check_modes(modes, sequence.estimator().model().optics.modes())?;
            let out = room(covariance_nm2, modes * modes, "covariance_nm2")?;
            let covariance_nm2 = sequence.estimate()?.combined.covariance_nm2;
            out.iter_mut().zip(&covariance_nm2).for_each(|(out, value)| *out = *value);
            Ok(())
        })
    }
}

/// How many further images like those so far bring both error bars (nm RMS over the pupil) down to the given ones, in
/// `*images`; 0 where they are there. Infinity asks nothing. COPHASE_BAD_IMAGE where no image was fitted yet.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_sequence_images_needed(
    sequence: *const cophase_sequence,
    phasing_nm: f64,
    ncpa_nm: f64,
    images: *mut u64,
) -> cophase_status {
    unsafe { read(sequence, |sequence| put(images, "images", sequence.images_needed(phasing_nm, ncpa_nm)?)) }
}

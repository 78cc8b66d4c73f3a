//! What a full-phase estimate found, as C asks for it.

use super::array::{Output, cophase_array_f32};
use super::full_phase::{
    COPHASE_KNOWS_LOOP, COPHASE_KNOWS_NOTHING, COPHASE_KNOWS_SPECTRUM, COPHASE_KNOWS_TELEMETRY, cophase_full_phase,
    look,
};
use super::model::check_modes;
use super::pointer::{place, put, put_text, room};
use super::report::{COPHASE_IMAGE_NOT_CONVERGED, COPHASE_IMAGE_OK, COPHASE_IMAGE_UNUSABLE};
use super::sized::Reports;
use super::status::cophase_status;
use crate::loop_response::Corrections;
use crate::retrieval::RetrievalReport;
use crate::scene::Knows;
use crate::sequence_estimate::FullPhase;
use crate::statics::Iteration;
use crate::{Error, Result};
use ndarray::Axis;
use std::ffi::{CString, c_char};

/// The last estimate.
pub(super) struct Found {
    pub(super) full_phase: FullPhase,
    names: Vec<CString>,
    pub(super) commands: Option<Corrections>,
}

/// What a full-phase estimate found. Later versions may append fields.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_full_phase_report {
    /// Images that were read.
    pub images: u64,
    /// Those that were used.
    pub used: u64,
    /// Passes that were made, each about the static wavefront that the one before found.
    pub passes: u64,
    /// 1 where the last pass changed less than a fraction of the error bars; 0 where there were no more to be had.
    pub settled: i32,
    /// What was assumed of the adaptive optics: one of the COPHASE_KNOWS_ numbers, not COPHASE_KNOWS_MOST.
    pub knows: i32,
    /// The segments' part of the wavefront, nm RMS over the pupil, piston, tip and tilt removed.
    pub phasing_rms_nm: f64,
    /// Its error bar, nm RMS over the pupil.
    pub phasing_sigma_nm: f64,
    /// The non-common path aberrations, likewise.
    pub ncpa_rms_nm: f64,
    /// Their error bar, nm RMS over the pupil.
    pub ncpa_sigma_nm: f64,
    /// By how much the last pass changed the phasing, nm RMS over the pupil; NaN if it was the only one.
    pub phasing_change_nm: f64,
    /// By how much it changed the NCPA, likewise.
    pub ncpa_change_nm: f64,
    /// Median χ² per degree of freedom of the images that were used: turbulence finer than the model's samples makes it 4
    /// to 5 behind a bright star.
    pub reduced_chi2: f64,
    /// Time that it took, s.
    pub seconds: f64,
}

/// What became of an image of a full-phase estimate. Later versions may append fields.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_full_phase_image {
    /// COPHASE_IMAGE_OK, COPHASE_IMAGE_NOT_CONVERGED or COPHASE_IMAGE_UNUSABLE.
    pub status: i32,
    /// 1 where the image was used; 0 where it could not be, or where its χ² is not like the others'.
    pub used: i32,
    /// Evaluations of the model in the last pass.
    pub evaluations: u64,
    /// χ² per degree of freedom; NaN for an image that could not be used.
    pub reduced_chi2: f64,
    /// The star, electrons.
    pub flux_e: f64,
    /// Background, electrons per pixel of the frame.
    pub background_e: f64,
}

impl Found {
    pub(super) fn new(full_phase: FullPhase) -> Result<Self> {
        let name = |name: String| {
            CString::new(name).map_err(|error| Error::Internal(format!("a mode's name holds a zero: {error}")))
        };
        let names = full_phase.result()?.mode_names().into_iter().map(name).collect::<Result<_>>()?;
        Ok(Self { full_phase, names, commands: None })
    }

    pub(super) fn pass(&self) -> Result<&Iteration> {
        self.full_phase.result()
    }

    pub(super) fn report(&self) -> Result<cophase_full_phase_report> {
        let (found, pass) = (&self.full_phase, self.pass()?);
        let [phasing_rms_nm, ncpa_rms_nm] = found.rms_nm()?;
        Ok(cophase_full_phase_report {
            images: found.reports.len() as u64,
            used: pass.used_images.len() as u64,
            passes: found.passes.len() as u64,
            settled: found.settled()?.into(),
            knows: number(found.knows),
            phasing_rms_nm,
            phasing_sigma_nm: pass.error_budget.total_nm[0],
            ncpa_rms_nm,
            ncpa_sigma_nm: pass.error_budget.total_nm[1],
            phasing_change_nm: pass.change_nm[0],
            ncpa_change_nm: pass.change_nm[1],
            reduced_chi2: pass.reduced_chi2,
            seconds: found.seconds,
        })
    }

    fn image(&self, image: usize, report: &RetrievalReport) -> Result<cophase_full_phase_image> {
        let status = match &report.refusal {
            Some(_) => COPHASE_IMAGE_UNUSABLE,
            None if report.reason.converged() => COPHASE_IMAGE_OK,
            None => COPHASE_IMAGE_NOT_CONVERGED,
        };
        Ok(cophase_full_phase_image {
            status,
            used: self.pass()?.used_images.contains(&image).into(),
            evaluations: report.evaluations as u64,
            reduced_chi2: report.reduced_chi2,
            flux_e: report.flux_e,
            background_e: report.background_e,
        })
    }
}

fn number(knows: Knows) -> i32 {
    match knows {
        Knows::Nothing => COPHASE_KNOWS_NOTHING,
        Knows::Spectrum => COPHASE_KNOWS_SPECTRUM,
        Knows::Loop => COPHASE_KNOWS_LOOP,
        Knows::Telemetry => COPHASE_KNOWS_TELEMETRY,
    }
}

/// What became of each image of the last estimate.
///
/// reports: receives count reports, each in report_size bytes; report_size: sizeof(cophase_full_phase_image). count: the
///   number of images in that estimate. COPHASE_BAD_VALUE before the first estimate, here and below.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_images(
    full_phase: *const cophase_full_phase,
    reports: *mut cophase_full_phase_image,
    report_size: usize,
    count: usize,
) -> cophase_status {
    unsafe {
        look(full_phase, |found| {
            let reports = Reports::at(place(reports, "reports")?, report_size)?;
            let images = &found.full_phase.reports;
            if count != images.len() {
                let images = images.len();
                return Err(Error::Shape(format!(
                    "count is {count}: {images} is accepted, the images of the last estimate"
                )));
            }
            for (image, report) in images.iter().enumerate() {
                reports.put(image, &found.image(image, report)?);
            }
            Ok(())
        })
    }
}

/// What became of an image of the last estimate, in a sentence. `text`, `capacity` and `length` are as in
/// cophase_device_list.
///
/// COPHASE_BAD_VALUE for an image that was not in it.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_image_message(
    full_phase: *const cophase_full_phase,
    image: usize,
    text: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> cophase_status {
    unsafe {
        look(full_phase, |found| {
            let sentence = found.full_phase.about_image(image).ok_or_else(|| {
                let count = found.full_phase.reports.len();
                Error::Value(format!("image is {image}: below {count} is accepted, the number in the last estimate"))
            })?;
            put_text(text, capacity, length, &sentence)
        })
    }
}

/// What somebody should know before using the last estimate, a sentence in each line; empty where there is nothing: images
/// that were left out, a scene that does not explain the images, passes that did not settle, a loop that is not known.
/// `text`, `capacity` and `length` are as in cophase_device_list.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_warnings(
    full_phase: *const cophase_full_phase,
    text: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> cophase_status {
    unsafe { look(full_phase, |found| put_text(text, capacity, length, &found.full_phase.warnings()?.join("\n"))) }
}

/// Number of static modes of the last estimate: pistons of the segments, then NCPA.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_mode_count(
    full_phase: *const cophase_full_phase,
    modes: *mut usize,
) -> cophase_status {
    unsafe { look(full_phase, |found| put(modes, "modes", found.names.len())) }
}

/// Number of those that move segments; they come first.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_segment_mode_count(
    full_phase: *const cophase_full_phase,
    modes: *mut usize,
) -> cophase_status {
    unsafe { look(full_phase, |found| put(modes, "modes", found.pass()?.errors.pistons_nm.len())) }
}

/// Name of a mode, from 0. The text lives until the next estimate begins.
///
/// COPHASE_BAD_VALUE for a mode that there is not.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_mode_name(
    full_phase: *const cophase_full_phase,
    mode: usize,
    name: *mut *const c_char,
) -> cophase_status {
    unsafe {
        look(full_phase, |found| {
            let text = found.names.get(mode).ok_or_else(|| {
                Error::Value(format!("mode is {mode}: 0 to {} is accepted", found.names.len().saturating_sub(1)))
            })?;
            put(name, "name", text.as_ptr())
        })
    }
}

/// Coefficients of the static modes, nm.
///
/// coefficients_nm, sigma_nm: receive modes numbers; sigma_nm (1σ of each) may be NULL. modes:
/// cophase_full_phase_mode_count.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_coefficients_nm(
    full_phase: *const cophase_full_phase,
    coefficients_nm: *mut f64,
    sigma_nm: *mut f64,
    modes: usize,
) -> cophase_status {
    unsafe {
        look(full_phase, |found| {
            check_modes(modes, found.names.len())?;
            let coefficients_nm = room(coefficients_nm, modes, "coefficients_nm")?;
            if !sigma_nm.is_null() {
                room(sigma_nm, modes, "sigma_nm")?.copy_from_slice(&found.pass()?.sigma_nm());
            }
            coefficients_nm.copy_from_slice(&found.pass()?.coefficients_nm());
            Ok(())
        })
    }
}

/// Their covariance, nm². covariance_nm2: receives modes x modes numbers.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_covariance_nm2(
    full_phase: *const cophase_full_phase,
    covariance_nm2: *mut f64,
    modes: usize,
) -> cophase_status {
    unsafe {
        look(full_phase, |found| {
            check_modes(modes, found.names.len())?;
            let out = room(covariance_nm2, modes * modes, "covariance_nm2")?;
            out.iter_mut().zip(&found.pass()?.errors.covariance_nm2).for_each(|(out, value)| *out = *value);
            Ok(())
        })
    }
}

/// Rows, and columns, of a map.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_samples(
    full_phase: *const cophase_full_phase,
    samples: *mut usize,
) -> cophase_status {
    unsafe { look(full_phase, |found| put(samples, "samples", found.pass()?.ncpa_nm.len_of(Axis(0)))) }
}

/// The static errors as maps, nm: map 0 the phasing errors of the segments, map 1 the NCPA, maps 2 and 3 their error bars
/// (1σ). NaN outside the pupil.
///
/// out: 4 x samples x samples, see cophase_full_phase_samples.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_maps_nm(
    full_phase: *const cophase_full_phase,
    out: *const cophase_array_f32,
) -> cophase_status {
    unsafe {
        look(full_phase, |found| {
            let pass = found.pass()?;
            let maps = [&pass.phasing_nm, &pass.ncpa_nm, &pass.phasing_sigma_nm, &pass.ncpa_sigma_nm];
            let (rows, cols) = pass.ncpa_nm.dim();
            Output::of(out, "out", [4, rows, cols])?.fill(|k, y, x| maps[k][[y, x]] as f32);
            Ok(())
        })
    }
}

/// How many further images like those so far bring both error bars (nm RMS over the pupil) down to the given ones, in
/// `*images`; 0 where they are there. Infinity asks nothing. COPHASE_BAD_VALUE where what all images
/// share (an error of the diversity, NCPA finer than the modes) alone makes more.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_images_needed(
    full_phase: *const cophase_full_phase,
    phasing_nm: f64,
    ncpa_nm: f64,
    images: *mut u64,
) -> cophase_status {
    unsafe {
        look(full_phase, |found| {
            for (name, wanted) in [("phasing_nm", phasing_nm), ("ncpa_nm", ncpa_nm)] {
                if wanted.is_nan() || wanted <= 0.0 {
                    return Err(Error::Value(format!(
                        "{name} is {wanted}: a positive error, or infinity, is accepted"
                    )));
                }
            }
            put(images, "images", found.pass()?.further_images([phasing_nm, ncpa_nm])? as u64)
        })
    }
}

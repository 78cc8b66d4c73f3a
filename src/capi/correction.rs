//! Corrections of segments, mirror and wavefront sensor from an estimate.

use super::estimate::change;
use super::estimate_handle::cophase_estimate;
use super::pointer::text;
use super::sized::Outputs;
use super::status::cophase_status;
use crate::{Error, Result};
use std::ffi::c_char;
use std::path::Path;

/// Sizes of a correction.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_correction_report {
    /// Number of segments.
    pub segments: usize,
    /// Number of the mirror's actuators; 0 where the scene names no mirror.
    pub actuators: usize,
    /// Number of slopes of the wavefront sensor; 0 where no slopes were measured, and in a modal
    /// estimate.
    pub slopes: usize,
    /// NCPA modes that are corrected.
    pub corrected_modes: usize,
    /// Commands that were cut at a limit.
    pub limited: usize,
    /// Channels of the segments' controller; 0 where the scene describes none ([commands]).
    pub segment_commands: usize,
    /// Channels of the mirror's controller; 0 where the scene describes none.
    pub actuator_commands: usize,
    /// Tips and tilts of segments that are corrected, two of each; 0 where there are none.
    pub tilts: usize,
    /// NCPA modes, corrected or held.
    pub ncpa_modes: usize,
    /// Pistons, tips and tilts of segments that are held.
    pub held_segment_modes: usize,
    /// NCPA modes that are held.
    pub held_ncpa_modes: usize,
    /// Expected drop of the sum of squares of the segment modes (of the steps at edges by the
    /// convention edge-minimising), nm2.
    pub segments_drop_nm2: f64,
    /// Expected drop of the sum of squares of the NCPA modes, nm2.
    pub ncpa_drop_nm2: f64,
}

/// Computes what to add to segments, mirror and (MAP estimates) reference slopes to correct the
/// estimated errors, also in the terms of the controllers that the scene describes. The scene's
/// section [commands] has gain, deadband and convention; errors whose correction is not expected to
/// lower them are held, and tips and tilts of segments of a modal estimate are not corrected. About
/// a second at the size of Keck where the scene has a loop. Then cophase_estimate_array has the
/// COPHASE_ARRAY_CORRECTION_ arrays, and cophase_estimate_text says why a mode is held.
///
/// limit_nm: largest command, nm; 0 for the mirror's stroke and, for segments, a quarter of the
/// wavelength (none where the whole wavelengths are known), or commands.max_step_nm of the scene.
/// The limits of the controllers' channels hold in addition.
/// path: FITS file to write, or text for a name that ends in .txt, UTF-8; NULL for none.
/// report: NULL if it is not wanted. report_size: sizeof(cophase_correction_report).
///
/// COPHASE_BAD_VALUE for a negative limit, for segment modes that are not pistons, and for a piston
/// that would move by more than commands.max_step_nm (unset and with one wavelength: half of it);
/// COPHASE_BAD_FILE for a controller's table or matrix that cannot be read or does not fit.
/// COPHASE_BUSY while other threads read the estimate.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimate_correct(
    estimate: *mut cophase_estimate,
    limit_nm: f64,
    path: *const c_char,
    report: *mut cophase_correction_report,
    report_size: usize,
) -> cophase_status {
    unsafe {
        change(estimate, |found| -> Result<()> {
            let report = Outputs::new(report, report_size, ("report", "report_size"))?;
            let path = if path.is_null() { None } else { Some(Path::new(text(path, "path")?)) };
            if limit_nm.is_nan() || limit_nm < 0.0 {
                return Err(Error::Value(format!(
                    "limit_nm is {limit_nm}: a positive limit, or 0 for the default, is accepted"
                )));
            }
            let corrections = found.estimate.corrections((limit_nm > 0.0).then_some(limit_nm))?;
            if let Some(path) = path {
                corrections.write(path)?;
            }
            report.put(
                0,
                &cophase_correction_report {
                    segments: corrections.pistons_nm.len(),
                    actuators: corrections.actuators_nm.len(),
                    slopes: corrections.slopes_mas.len(),
                    corrected_modes: corrections.corrected_modes,
                    limited: corrections.limited,
                    segment_commands: corrections.segment_commands.as_ref().map_or(0, |one| one.channels.len()),
                    actuator_commands: corrections.actuator_commands.as_ref().map_or(0, |one| one.channels.len()),
                    tilts: corrections.tilts_nm.len(),
                    ncpa_modes: corrections.ncpa.len(),
                    held_segment_modes: corrections.segments_held.iter().flatten().count(),
                    held_ncpa_modes: corrections.ncpa.iter().filter(|mode| mode.held.is_some()).count(),
                    segments_drop_nm2: corrections.expected_drop_nm2[0],
                    ncpa_drop_nm2: corrections.expected_drop_nm2[1],
                },
            );
            found.corrections = Some(corrections);
            Ok(())
        })
    }
}

//! Corrections from a full-phase estimate, for whoever drives segments, mirror and sensor.

use super::full_phase::{change, cophase_full_phase, look};
use super::pointer::room;
use super::sized::Reports;
use super::status::cophase_status;
use crate::{Error, Result};

/// Corrections, in numbers. Later versions may append fields.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_correction_report {
    /// Segments whose pistons are to be moved.
    pub segments: u64,
    /// Actuators of the mirror; 0 without a loop in the scene.
    pub actuators: u64,
    /// Slopes of the wavefront sensor; 0 without a loop in the scene.
    pub slopes: u64,
    /// NCPA modes that are corrected: those whose estimate is above its error bar.
    pub corrected_modes: u64,
    /// Commands that were cut at the limit.
    pub limited: u64,
}

/// Works out the corrections that the last estimate calls for: what to add to segments, mirror and reference slopes. Do
/// no harm: a mode whose estimate is under its error bar is left alone. Where the scene has a loop this takes about a
/// second at the size of Keck.
///
/// limit_nm: no command is larger; NaN for the mirror's stroke and, for segments, a quarter of the wavelength.
/// report: NULL if it is not wanted; report_size: sizeof(cophase_correction_report).
///
/// COPHASE_BAD_VALUE before the first estimate.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_correct(
    full_phase: *mut cophase_full_phase,
    limit_nm: f64,
    report: *mut cophase_correction_report,
    report_size: usize,
) -> cophase_status {
    unsafe {
        change(full_phase, |working| {
            let found = working.found_mut()?;
            let report = Reports::at(report, report_size)?;
            let limit_nm = (!limit_nm.is_nan()).then_some(limit_nm);
            let commands = found.pass()?.corrections(&found.full_phase.scene, limit_nm)?;
            report.put(
                0,
                &cophase_correction_report {
                    segments: commands.pistons_nm.len() as u64,
                    actuators: commands.actuators_nm.len() as u64,
                    slopes: commands.slopes_mas.len() as u64,
                    corrected_modes: commands.corrected_modes as u64,
                    limited: commands.limited as u64,
                },
            );
            found.commands = Some(commands);
            Ok(())
        })
    }
}

/// The corrections that cophase_full_phase_correct worked out, in this library's order; a positive command raises the
/// wavefront. Any of the pointers may be NULL for what is not wanted, and its number then does not matter.
///
/// pistons_nm: receives segments numbers: what to add to each segment's piston, nm of wavefront.
/// actuators_nm: receives actuators numbers: what to add to each command of the mirror, nm of wavefront.
/// actuators_m: receives actuators x 2 numbers: where each actuator is, x and y, m.
/// slopes_mas: receives slopes numbers: what to add to the sensor's reference, along x for every subaperture, then along y;
///   it keeps the mirror where the commands put it.
///
/// COPHASE_BAD_VALUE before cophase_full_phase_correct, COPHASE_BAD_SHAPE for other numbers than its report's.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_full_phase_corrections(
    full_phase: *const cophase_full_phase,
    pistons_nm: *mut f64,
    segments: usize,
    actuators_nm: *mut f64,
    actuators_m: *mut f64,
    actuators: usize,
    slopes_mas: *mut f64,
    slopes: usize,
) -> cophase_status {
    unsafe {
        look(full_phase, |found| {
            let commands = found.commands.as_ref().ok_or_else(|| {
                Error::Value("there are no corrections yet: cophase_full_phase_correct comes first".into())
            })?;
            let (places, moves): (Vec<[f64; 2]>, Vec<f64>) = commands.actuators_nm.iter().copied().unzip();
            // All are checked before the first is written.
            let writes = [
                wanted(pistons_nm, ("pistons_nm", "segments"), segments, 1, &commands.pistons_nm)?,
                wanted(actuators_nm, ("actuators_nm", "actuators"), actuators, 1, &moves)?,
                wanted(actuators_m, ("actuators_m", "actuators"), actuators, 2, places.as_flattened())?,
                wanted(slopes_mas, ("slopes_mas", "slopes"), slopes, 1, &commands.slopes_mas)?,
            ];
            writes.into_iter().flatten().for_each(|(out, values)| out.copy_from_slice(values));
            Ok(())
        })
    }
}

/// A list and the room for it; `None` for one that is not wanted.
type Write<'a> = Option<(&'a mut [f64], &'a [f64])>;

unsafe fn wanted<'a>(
    out: *mut f64,
    (name, counted): (&str, &str),
    count: usize,
    each: usize,
    values: &'a [f64],
) -> Result<Write<'a>> {
    if out.is_null() {
        return Ok(None);
    }
    let there = values.len() / each;
    if count != there {
        return Err(Error::Shape(format!(
            "{counted} is {count}: {there} is accepted, as the report of the corrections says"
        )));
    }
    Ok(Some((unsafe { room(out, values.len(), name) }?, values)))
}

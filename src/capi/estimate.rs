//! Estimates: the result of the pipeline, as C reads it.

use super::estimate_handle::{EstimateState, cophase_estimate};
use super::handle::{Handle, find, give_back};
use super::image_report::{cophase_image_report, number};
use super::pointer::{place, put_array, put_text, text};
use super::policy::policy_number;
use super::sized::Outputs;
use super::status::cophase_status;
use super::text::*;
use crate::modal::StaticMaps;
use crate::pipeline::{Command, Commands, Corrections, Estimate, Figures, MethodResult};
use crate::scene::AoKnowledge;
use crate::{Error, Result};
use std::ffi::c_char;
use std::path::Path;

/// Method of an estimate: static modes fitted to each image, images combined.
pub const COPHASE_METHOD_MODAL: i32 = 1;
/// Method of an estimate: maximum a posteriori (MAP) wavefront behind each exposure, static errors
/// separated from the turbulence.
pub const COPHASE_METHOD_MAP: i32 = 2;

/// Knowledge of the adaptive optics that a MAP estimate assumed (estimate.ao_knowledge): only the
/// mirror's pitch and ordinary seeing.
pub const COPHASE_AO_KNOWLEDGE_NOTHING: i32 = 1;
/// Knowledge: the power spectrum of the residual wavefront, from the scene's turbulence and
/// control.
pub const COPHASE_AO_KNOWLEDGE_SPECTRUM: i32 = 2;
/// Knowledge: also the closed loop's response to the segments.
pub const COPHASE_AO_KNOWLEDGE_LOOP: i32 = 3;
/// Knowledge: also the slopes of the wavefront sensor during each exposure.
pub const COPHASE_AO_KNOWLEDGE_TELEMETRY: i32 = 4;

/// Array of an estimate: coefficients, nm; modes.
pub const COPHASE_ARRAY_COEFFICIENTS_NM: i32 = 1;
/// Array: standard deviation of each coefficient, nm; modes.
pub const COPHASE_ARRAY_SIGMA_NM: i32 = 2;
/// Array: covariance of the coefficients, nm^2; modes x modes.
pub const COPHASE_ARRAY_COVARIANCE_NM2: i32 = 3;
/// Array: coefficients of each image, nm, NaN for unusable images; images x modes. Modal estimates
/// only.
pub const COPHASE_ARRAY_IMAGE_COEFFICIENTS_NM: i32 = 4;
/// Array: maps of phasing errors, NCPA, and the standard deviation of each, nm, NaN outside the
/// pupil; 4 x samples x samples.
pub const COPHASE_ARRAY_MAPS_NM: i32 = 5;
/// Array: contribution of each term of the error budget to the error bars of phasing and NCPA, nm
/// RMS over the pupil; error_terms x 2. Their squares add up to the squares of phasing_sigma_nm and
/// ncpa_sigma_nm.
pub const COPHASE_ARRAY_ERROR_BUDGET_NM: i32 = 6;
/// Array, after cophase_estimate_correct: what to add to the piston of each segment, nm of
/// wavefront, which a positive piston raises; segments.
pub const COPHASE_ARRAY_CORRECTION_PISTONS_NM: i32 = 7;
/// Array, after cophase_estimate_correct: what to add to the command of each actuator, nm of
/// wavefront, from which the mirror is subtracted; actuators.
pub const COPHASE_ARRAY_CORRECTION_ACTUATORS_NM: i32 = 8;
/// Array, after cophase_estimate_correct: position of each actuator, x and y, m; actuators x 2.
pub const COPHASE_ARRAY_CORRECTION_ACTUATORS_M: i32 = 9;
/// Array, after cophase_estimate_correct: what to add to the sensor's reference slopes, mas, along
/// x for every subaperture, then along y; slopes. The loop then puts the correction on the mirror.
/// Without elements in a modal estimate, and without measured slopes.
pub const COPHASE_ARRAY_CORRECTION_SLOPES_MAS: i32 = 10;
/// Array: whole wavelengths of the first channel that were added to the piston of each segment,
/// their probability, and the piston of the second most probable number relative to this one, nm;
/// integers x 3. For channels of several wavelengths.
pub const COPHASE_ARRAY_PISTON_INTEGERS: i32 = 11;

/// Array, after cophase_estimate_correct: what to add to each channel of the segments' controller
/// (scene section [commands]), in its unit; segment_commands.
pub const COPHASE_ARRAY_CORRECTION_SEGMENT_COMMANDS: i32 = 12;
/// Array, after cophase_estimate_correct: what to add to each channel of the mirror's controller,
/// in its unit; actuator_commands.
pub const COPHASE_ARRAY_CORRECTION_ACTUATOR_COMMANDS: i32 = 13;
/// Array, after cophase_estimate_correct: what to add to the tip of each segment, then to the tilt
/// of each, nm of wavefront RMS over the segment; tilts. Without elements where the estimate has no
/// tilts of segments.
pub const COPHASE_ARRAY_CORRECTION_TILTS_NM: i32 = 14;

/// Array: errors of the optics and the camera that the error bars hold, within the scene's
/// [tolerance]: value, its standard deviation, that before the images, and the value by the images
/// alone over its error bar; model_errors x 4.
pub const COPHASE_ARRAY_MODEL_ERRORS: i32 = 15;
/// Array: as COPHASE_ARRAY_MAPS_NM, without focus and astigmatisms of the whole pupil, which a
/// tolerance alone divides between segments and NCPA; 4 x samples x samples. Only where
/// has_maps_without_staircases is 1.
pub const COPHASE_ARRAY_MAPS_WITHOUT_STAIRCASES_NM: i32 = 16;
/// Array: RMS and expected error of phasing, NCPA and wavefront of these maps, nm; 3 x 2.
pub const COPHASE_ARRAY_FIGURES_WITHOUT_STAIRCASES_NM: i32 = 17;

/// Sizes, status and figures of an estimate. RMS values are over the pupil, piston, tip and tilt
/// removed.
#[allow(non_camel_case_types)] // a name of the header
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct cophase_estimate_info {
    /// Number of images.
    pub images: usize,
    /// Images that were combined.
    pub used: usize,
    /// Images that were fitted and left out as outliers.
    pub clipped: usize,
    /// Number of modes.
    pub modes: usize,
    /// Number of modes that move segments; they come first, the others are NCPA modes.
    pub segment_modes: usize,
    /// Rows, and columns, of a map.
    pub samples: usize,
    /// Terms of the error budget.
    pub error_terms: usize,
    /// Number of warnings: lines of COPHASE_TEXT_WARNINGS.
    pub warnings: usize,
    /// COPHASE_METHOD_MODAL or COPHASE_METHOD_MAP.
    pub method: i32,
    /// COPHASE_POLICY_FULL or COPHASE_POLICY_REALTIME.
    pub policy: i32,
    /// Worst COPHASE_IMAGE_ status that counts for the whole.
    pub status: i32,
    /// 1 if error bars are from the scatter between images, as from eight images on, else 0.
    pub is_sequence: i32,
    /// Iterations of a MAP estimate; 0 in a modal one.
    pub iterations: i32,
    /// 1 if the last iteration of a MAP estimate changed next to nothing, else 0; 1 in a modal one.
    pub has_settled: i32,
    /// COPHASE_AO_KNOWLEDGE_ number of a MAP estimate; 0 in a modal one.
    pub ao_knowledge: i32,
    /// Precision of the imaging chain: COPHASE_F64 or COPHASE_F32.
    pub precision: i32,
    /// Evaluations of objective and gradient, all images together.
    pub evaluations: u64,
    /// Phasing errors, nm RMS.
    pub phasing_rms_nm: f64,
    /// Expected error of the phasing map, nm RMS.
    pub phasing_sigma_nm: f64,
    /// Non-common path aberrations, nm RMS.
    pub ncpa_rms_nm: f64,
    /// Expected error of the NCPA map, nm RMS.
    pub ncpa_sigma_nm: f64,
    /// Phasing and NCPA together, nm RMS.
    pub wavefront_rms_nm: f64,
    /// Expected error of both together, nm RMS; in a MAP estimate the most that it can be, the sum
    /// of both.
    pub wavefront_sigma_nm: f64,
    /// Median reduced chi-square of the images that were used. Turbulence finer than the model's
    /// samples makes it 4 to 5 behind a bright star in a MAP estimate.
    pub reduced_chi2: f64,
    /// Further images like these that halve both error bars; infinity if no number does; NaN if
    /// unknown, as in a modal estimate.
    pub images_to_halve: f64,
    /// Side of a map, m.
    pub map_width_m: f64,
    /// Duration of the estimate, s.
    pub seconds: f64,
    /// Duration of building the model, s, where that is apart.
    pub model_seconds: f64,
    /// Measured slopes over those of the retrieved wavefronts, about 1 if the telemetry belongs to
    /// the images; NaN without telemetry.
    pub telemetry_gain: f64,
    /// Their correlation; NaN without telemetry.
    pub telemetry_correlation: f64,
    /// Number of channels; 0 for a scene without ([[image.channel]]).
    pub channels: usize,
    /// Number of segments whose whole wavelengths were determined, rows of
    /// COPHASE_ARRAY_PISTON_INTEGERS; 0 for one wavelength.
    pub integers: usize,
    /// Rows of COPHASE_ARRAY_MODEL_ERRORS; 0 where the error bars hold the noise alone.
    pub model_errors: usize,
    /// 1 if COPHASE_ARRAY_MAPS_WITHOUT_STAIRCASES_NM is there, else 0.
    pub has_maps_without_staircases: usize,
}

/// A call that reads the estimate.
unsafe fn read(estimate: *const cophase_estimate, body: impl FnOnce(&EstimateState) -> Result<()>) -> cophase_status {
    Handle::read(unsafe { find(estimate, "estimate") }.map(|estimate| &estimate.0), body)
}

/// A call that changes it.
pub(super) unsafe fn change(
    estimate: *mut cophase_estimate,
    body: impl FnOnce(&mut EstimateState) -> Result<()>,
) -> cophase_status {
    Handle::change(unsafe { find(estimate, "estimate") }.map(|estimate| &estimate.0), body)
}

/// Frees an estimate; NULL is fine.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimate_destroy(estimate: *mut cophase_estimate) {
    unsafe { give_back(estimate) }
}

/// Writes sizes, status and figures of an estimate. info_size: sizeof(cophase_estimate_info).
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimate_get_info(
    estimate: *const cophase_estimate,
    info: *mut cophase_estimate_info,
    info_size: usize,
) -> cophase_status {
    unsafe {
        read(estimate, |found| {
            Outputs::new(place(info, "info")?, info_size, ("info", "info_size"))?.put(0, &summary(&found.estimate));
            Ok(())
        })
    }
}

fn summary(estimate: &Estimate) -> cophase_estimate_info {
    let map = estimate.full_phase();
    let telemetry = map.and_then(|map| map.telemetry.as_ref());
    let Figures { phasing, ncpa, wavefront } = estimate.figures;
    cophase_estimate_info {
        images: estimate.images.len(),
        used: estimate.used(),
        clipped: estimate.clipped(),
        modes: estimate.basis.names.len(),
        segment_modes: estimate.segment_modes(),
        samples: estimate.maps.phasing_nm.nrows(),
        error_terms: estimate.error_budget.len(),
        warnings: estimate.warnings.len(),
        method: match estimate.method {
            MethodResult::Modal(_) => COPHASE_METHOD_MODAL,
            MethodResult::FullPhase(_) => COPHASE_METHOD_MAP,
        },
        policy: policy_number(&estimate.policy),
        status: number(&estimate.status),
        is_sequence: estimate.is_sequence.into(),
        iterations: map.map_or(0, |map| map.iterations.len() as i32),
        has_settled: map.is_none_or(|map| map.has_settled).into(),
        ao_knowledge: map.map_or(0, |map| match map.ao_knowledge {
            AoKnowledge::Nothing => COPHASE_AO_KNOWLEDGE_NOTHING,
            AoKnowledge::Spectrum => COPHASE_AO_KNOWLEDGE_SPECTRUM,
            AoKnowledge::Loop => COPHASE_AO_KNOWLEDGE_LOOP,
            AoKnowledge::Telemetry => COPHASE_AO_KNOWLEDGE_TELEMETRY,
        }),
        precision: super::session_options::precision_number(estimate.run.precision),
        evaluations: estimate.evaluations() as u64,
        phasing_rms_nm: phasing.rms_nm,
        phasing_sigma_nm: phasing.sigma_nm,
        ncpa_rms_nm: ncpa.rms_nm,
        ncpa_sigma_nm: ncpa.sigma_nm,
        wavefront_rms_nm: wavefront.rms_nm,
        wavefront_sigma_nm: wavefront.sigma_nm,
        reduced_chi2: estimate.reduced_chi2,
        images_to_halve: images_to_halve(estimate),
        map_width_m: estimate.pupil.grid.width_m(),
        seconds: estimate.run.seconds,
        model_seconds: estimate.run.model_seconds,
        telemetry_gain: telemetry.map_or(f64::NAN, |check| check.gain),
        telemetry_correlation: telemetry.map_or(f64::NAN, |check| check.correlation),
        channels: estimate.channels.len(),
        integers: estimate.integers.len(),
        model_errors: estimate.model_errors.len(),
        has_maps_without_staircases: estimate.without_staircases.is_some().into(),
    }
}

fn images_to_halve(estimate: &Estimate) -> f64 {
    let Some(last) = estimate.full_phase().and_then(|map| map.iterations.last()) else { return f64::NAN };
    last.further_images(last.error_budget.total_nm.map(|nm| nm / 2.0)).map_or(f64::INFINITY, |images| images as f64)
}

/// Writes the reports on all images.
///
/// reports: receives `count` reports of report_size bytes each. report_size:
/// sizeof(cophase_image_report). count: images of the estimate.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimate_images(
    estimate: *const cophase_estimate,
    reports: *mut cophase_image_report,
    report_size: usize,
    count: usize,
) -> cophase_status {
    unsafe {
        read(estimate, |found| {
            let outputs = Outputs::new(place(reports, "reports")?, report_size, ("reports", "report_size"))?;
            let Estimate { images, policy, .. } = &found.estimate;
            if count != images.len() {
                let images = images.len();
                return Err(Error::Shape(format!("count is {count}: {images} is accepted, the number of images")));
            }
            let report = |image| cophase_image_report::from_estimate(image, policy_number(policy));
            images.iter().enumerate().for_each(|(index, image)| outputs.put(index, &report(image)));
            Ok(())
        })
    }
}

/// Writes an array of an estimate in C order.
///
/// what: a COPHASE_ARRAY_ number, which says shape and unit. out: receives `count` numbers.
///
/// COPHASE_BAD_SHAPE for another count than the shape's; the sentence has the right one.
/// COPHASE_BAD_VALUE for an array that this estimate does not have, and for
/// COPHASE_ARRAY_CORRECTION_ arrays before cophase_estimate_correct.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimate_array(
    estimate: *const cophase_estimate,
    what: i32,
    out: *mut f64,
    count: usize,
) -> cophase_status {
    unsafe {
        read(estimate, |found| {
            let (shape, values) = array(found, what)?;
            put_array(out, count, &shape, values)
        })
    }
}

/// The corrections, once they are computed.
fn corrected(corrections: &Option<Corrections>) -> Result<&Corrections> {
    let none = || Error::Value("there are no corrections yet: call cophase_estimate_correct first".into());
    corrections.as_ref().ok_or_else(none)
}

/// Commands to a controller; none where the scene describes none.
fn channels(commands: &Option<Commands>) -> &[Command] {
    commands.as_ref().map_or(&[], |commands| &commands.channels)
}

/// Figures and maps, with their error bars, without the shapes that a tolerance alone divides.
fn without_staircases(estimate: &Estimate) -> Result<(&Figures, [&StaticMaps; 2])> {
    let none = || {
        let why = "the images divide all shapes between segments and NCPA (has_maps_without_staircases is 0)";
        Error::Value(format!("there are no maps without staircases: {why}; the maps of the estimate are accepted"))
    };
    let without = estimate.without_staircases.as_ref().ok_or_else(none)?;
    Ok((&without.figures, [&without.maps, &without.sigma_maps]))
}

/// Shape and values of maps and of their error bars.
fn four_maps(maps: &StaticMaps, sigma_maps: &StaticMaps) -> (Vec<usize>, Vec<f64>) {
    let (rows, cols) = maps.phasing_nm.dim();
    let maps = [&maps.phasing_nm, &maps.ncpa_nm, &sigma_maps.phasing_nm, &sigma_maps.ncpa_nm];
    (vec![maps.len(), rows, cols], maps.into_iter().flatten().copied().collect())
}

/// Shape and values of an array.
fn array(found: &EstimateState, what: i32) -> Result<(Vec<usize>, Vec<f64>)> {
    let EstimateState { estimate, corrections } = found;
    let list = |values: Vec<f64>| (vec![values.len()], values);
    let matrix = |matrix: &ndarray::Array2<f64>| (matrix.shape().to_vec(), matrix.iter().copied().collect());
    let own = COPHASE_ARRAY_CORRECTION_PISTONS_NM..=COPHASE_ARRAY_CORRECTION_SLOPES_MAS;
    let later = COPHASE_ARRAY_CORRECTION_SEGMENT_COMMANDS..=COPHASE_ARRAY_CORRECTION_TILTS_NM;
    if own.contains(&what) || later.contains(&what) {
        let corrections = corrected(corrections)?;
        let actuators = &corrections.actuators_nm;
        let to = |commands| channels(commands).iter().map(|channel| channel.value).collect();
        return Ok(match what {
            COPHASE_ARRAY_CORRECTION_PISTONS_NM => list(corrections.pistons_nm.clone()),
            COPHASE_ARRAY_CORRECTION_TILTS_NM => list(corrections.tilts_nm.clone()),
            COPHASE_ARRAY_CORRECTION_ACTUATORS_NM => list(actuators.iter().map(|(_, nm)| *nm).collect()),
            COPHASE_ARRAY_CORRECTION_ACTUATORS_M => {
                (vec![actuators.len(), 2], actuators.iter().flat_map(|(place_m, _)| *place_m).collect())
            }
            COPHASE_ARRAY_CORRECTION_SEGMENT_COMMANDS => list(to(&corrections.segment_commands)),
            COPHASE_ARRAY_CORRECTION_ACTUATOR_COMMANDS => list(to(&corrections.actuator_commands)),
            _ => list(corrections.slopes_mas.clone()),
        });
    }
    Ok(match what {
        COPHASE_ARRAY_COEFFICIENTS_NM => list(estimate.modes.coefficients_nm.clone()),
        COPHASE_ARRAY_SIGMA_NM => list(estimate.modes.sigma_nm()),
        COPHASE_ARRAY_COVARIANCE_NM2 => matrix(&estimate.modes.covariance_nm2),
        COPHASE_ARRAY_IMAGE_COEFFICIENTS_NM => match &estimate.method {
            MethodResult::Modal(modal) => matrix(&modal.image_coefficients_nm),
            MethodResult::FullPhase(_) => {
                let none = "a MAP estimate fits no modes to single images: a modal one is accepted";
                return Err(Error::Value(none.into()));
            }
        },
        COPHASE_ARRAY_MAPS_NM => four_maps(&estimate.maps, &estimate.sigma_maps),
        COPHASE_ARRAY_MAPS_WITHOUT_STAIRCASES_NM => {
            let (_, [maps, sigma_maps]) = without_staircases(estimate)?;
            four_maps(maps, sigma_maps)
        }
        COPHASE_ARRAY_FIGURES_WITHOUT_STAIRCASES_NM => {
            let (Figures { phasing, ncpa, wavefront }, _) = without_staircases(estimate)?;
            (vec![3, 2], [phasing, ncpa, wavefront].iter().flat_map(|one| [one.rms_nm, one.sigma_nm]).collect())
        }
        COPHASE_ARRAY_MODEL_ERRORS => {
            let errors = &estimate.model_errors;
            let each = errors.iter().flat_map(|one| [one.value, one.sigma, one.tolerance, one.significance]);
            (vec![errors.len(), 4], each.collect())
        }
        COPHASE_ARRAY_ERROR_BUDGET_NM => {
            let terms = &estimate.error_budget;
            (vec![terms.len(), 2], terms.iter().flat_map(|term| [term.phasing_nm, term.ncpa_nm]).collect())
        }
        COPHASE_ARRAY_PISTON_INTEGERS => {
            let each = estimate.integers.iter().flat_map(|one| [one.integer as f64, one.probability, one.runner_up_nm]);
            (vec![estimate.integers.len(), 3], each.collect())
        }
        other => {
            return Err(Error::Value(format!("what is {other}: a COPHASE_ARRAY_ number of estimates is accepted")));
        }
    })
}

/// Writes a text of an estimate.
///
/// what: a COPHASE_TEXT_ number. index: which image, mode, term, channel or command; ignored for
/// the other texts. text, capacity, length: as in cophase_device_list.
///
/// COPHASE_BAD_VALUE for an index out of range.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimate_text(
    estimate: *const cophase_estimate,
    what: i32,
    index: usize,
    text: *mut c_char,
    capacity: usize,
    length: *mut usize,
) -> cophase_status {
    unsafe {
        read(estimate, |found| {
            let estimate = &found.estimate;
            let sentence = match what {
                COPHASE_TEXT_REPORT => estimate.report(),
                COPHASE_TEXT_WARNINGS => estimate.warnings.join("\n"),
                COPHASE_TEXT_REMARKS => estimate.remarks.join("\n"),
                COPHASE_TEXT_DEVICE => estimate.run.device.clone(),
                COPHASE_TEXT_POLICY => estimate.policy.name().into(),
                COPHASE_TEXT_MODEL => estimate.model.clone(),
                COPHASE_TEXT_SCENE => estimate.scene.text().into(),
                COPHASE_TEXT_IMAGE_MESSAGE => at(&estimate.images, index, "images")?.message.clone(),
                COPHASE_TEXT_MODE_NAME => at(&estimate.basis.names, index, "modes")?.clone(),
                COPHASE_TEXT_CHANNEL_NAME => at(&estimate.channels, index, "channels")?.clone(),
                COPHASE_TEXT_SEGMENT_COMMAND_NAME => {
                    at(channels(&corrected(&found.corrections)?.segment_commands), index, "commands")?.name.clone()
                }
                COPHASE_TEXT_ACTUATOR_COMMAND_NAME => {
                    at(channels(&corrected(&found.corrections)?.actuator_commands), index, "commands")?.name.clone()
                }
                COPHASE_TEXT_SEGMENT_HELD => at(&corrected(&found.corrections)?.segments_held, index, "segment modes")?
                    .map_or("", |why| why.word())
                    .into(),
                COPHASE_TEXT_NCPA_HELD => at(&corrected(&found.corrections)?.ncpa, index, "NCPA modes")?
                    .held
                    .map_or("", |why| why.word())
                    .into(),
                COPHASE_TEXT_CORRECTION_WARNINGS => corrected(&found.corrections)?.warnings.join("\n"),
                COPHASE_TEXT_MODEL_ERROR_NAME => at(&estimate.model_errors, index, "errors of the model")?.name.clone(),
                COPHASE_TEXT_ERROR_TERM_NAME => at(&estimate.error_budget, index, "terms")?.name.clone(),
                other => {
                    let known = "a COPHASE_TEXT_ number of estimates is accepted";
                    return Err(Error::Value(format!("what is {other}: {known}")));
                }
            };
            put_text(text, capacity, length, &sentence)
        })
    }
}

/// Writes the estimate as FITS, whole or not at all. path: UTF-8. COPHASE_BAD_FILE if it cannot be
/// written.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn cophase_estimate_write(
    estimate: *const cophase_estimate,
    path: *const c_char,
) -> cophase_status {
    unsafe { read(estimate, |found| found.estimate.write(Path::new(text(path, "path")?))) }
}

//! Corrections from an estimate: increments of the segments' pistons, tips and tilts, of the
//! mirror's commands and of the sensor's reference slopes.
//!
//! The scene's section `[commands]` says which modes are corrected, and by how much
//! ([`CorrectionPolicy`]). Tip and tilt, which are pointing, are left unchanged. Segments and
//! subapertures are in this program's order, wavefronts in nm. A positive piston raises the
//! wavefront; the mirror's surface is taken off the wavefront, as in the simulator. [`Commands`]
//! are the same in the terms of the controllers that the scene describes.

mod errors;
mod file;
mod mirror;

pub use errors::{CorrectableErrors, NcpaModes, SegmentLimits};

use super::controller::{Commands, Moved, commands};
use crate::ao::actuators_in_use;
use crate::scene::System;
use crate::telescope::{SegmentPlace, Telescope};
use crate::tracking::{CorrectionPolicy, HeldMode, HoldReason};
use crate::{Error, Result};
use mirror::{mirror_commands, reference_slopes};

/// Corrections.
#[derive(Debug, Clone)]
pub struct Corrections {
    /// Place of each segment; none where the estimate has no pistons.
    pub places: Vec<SegmentPlace>,
    /// Increment of each segment's piston, nm; 0 where it stays.
    pub pistons_nm: Vec<f64>,
    /// Estimate of each piston and its error bar, nm, both without the mean of all pistons, or the
    /// plane through them, which no correction changes.
    pub estimate_nm: Vec<[f64; 2]>,
    /// Increments of the tip of each segment, then of the tilt of each, nm RMS over the segment;
    /// empty where they were not estimated.
    pub tilts_nm: Vec<f64>,
    /// Estimate of each tip, then of each tilt, and its error bar, nm RMS over the segment.
    pub tilt_estimate_nm: Vec<[f64; 2]>,
    /// Why each piston, then each tip, then each tilt stays; `None` for those that move.
    pub segments_held: Vec<Option<HoldReason>>,
    /// NCPA modes, in the order of the estimate.
    pub ncpa: Vec<ModeCorrection>,
    /// Number of corrected NCPA modes.
    pub corrected_modes: usize,
    /// Expected drop of the sum of squares of the segment modes (of the steps at edges by that
    /// convention), and of the NCPA modes, nm².
    pub expected_drop_nm2: [f64; 2],
    /// The policy, from the scene's section `[commands]`.
    pub policy: CorrectionPolicy,
    /// Increments of the mirror's commands, nm, with the position of each actuator, m; empty where
    /// the scene names no mirror.
    pub actuators_nm: Vec<([f64; 2], f64)>,
    /// Increments of the sensor's reference slopes, all x then all y, mas, with which the loop puts
    /// the correction on the mirror; empty where no slopes were measured, and for maps of NCPA.
    pub slopes_mas: Vec<f64>,
    /// Pistons, and where its matrix takes them tips and tilts, in the terms of the segments'
    /// controller, where the scene describes one.
    pub segment_commands: Option<Commands>,
    /// The mirror's commands in the terms of its controller, where the scene describes one.
    pub actuator_commands: Option<Commands>,
    /// Number of commands that were clipped at a limit.
    pub limited: usize,
    /// Sentences on the corrections, to read before anything is moved.
    pub warnings: Vec<String>,
    /// Warnings and remarks of the estimate, which the files hold, too.
    pub estimate_warnings: Vec<String>,
}

/// Correction of an NCPA mode.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ModeCorrection {
    /// Estimate, nm.
    pub estimate_nm: f64,
    /// Its error bar, nm.
    pub sigma_nm: f64,
    /// What is taken off, nm; 0 where it stays.
    pub corrected_nm: f64,
    /// Why it stays.
    pub held: Option<HoldReason>,
}

/// Said where tilts of segments are to be corrected and the controller moves pistons alone.
const TILTS_LEFT: &str = "the commands of the segments hold pistons alone, and not the tips and tilts that were estimated: a \
     commands.segment_matrix_file with a column for each piston, then each tip, then each tilt takes them, too";

/// Said where the mirror is to take NCPA and no slopes show how the loop's sensor responds.
const NO_REFERENCE: &str = "reference slopes are left out: without measured slopes of the exposures it is not known how much the sensor \
     responds to the NCPA, as turbulence blurs its spots";

impl Corrections {
    /// The corrections of `errors`, no increment beyond `limit_nm` (`None`: the mirror's stroke for
    /// actuators, and the limit of the errors for segments).
    ///
    /// # Errors
    /// [`Error::Value`] for a limit that is not positive, and for a piston beyond the largest step
    /// that is sent; [`Error::File`] for a controller that
    /// does not fit; those of building the scene's loop.
    pub fn new(scene: &System, errors: &CorrectableErrors, limit_nm: Option<f64>) -> Result<Self> {
        if let Some(limit_nm) = limit_nm.filter(|limit_nm| !(limit_nm.is_finite() && *limit_nm > 0.0)) {
            return Err(Error::Value(format!("a limit of {limit_nm} nm was given: a positive one is needed")));
        }
        let telescope = Telescope::new(scene)?;
        let segments = &telescope.pupil.segments[..errors.pistons_nm.len()];
        let count = segments.len();
        let segment_limit_nm = limit_nm.unwrap_or(errors.limits.cut_nm);
        let policy = CorrectionPolicy {
            stroke_limit_nm: Some(segment_limit_nm).filter(|limit_nm| limit_nm.is_finite()),
            ..CorrectionPolicy::of_scene(scene)
        };
        let errors::Decision { correction, segments_nm: mut estimate_nm } = errors.decide(&policy, segments)?;
        let is_moved = |segment: usize| correction.coefficients_nm[segment] != 0.0;
        errors.limits.check(&estimate_nm[..count], is_moved, policy.gain)?;
        let of_segments = count + errors.tilts_nm.len();
        let tilt_estimate_nm = estimate_nm[count..of_segments].to_vec();
        estimate_nm.truncate(count);
        let mut limited = correction.limited.len();
        let mut clip = |command_nm: f64, limit_nm: f64| {
            limited += usize::from(command_nm.abs() > limit_nm);
            command_nm.clamp(-limit_nm, limit_nm)
        };
        // A zero of either sign is written as 0.
        let mut pistons_nm: Vec<f64> = correction.coefficients_nm.iter().take(of_segments).map(|nm| 0.0 - nm).collect();
        let tilts_nm = pistons_nm.split_off(count);
        let ncpa_nm: Vec<f64> = correction.coefficients_nm.iter().skip(of_segments).copied().collect();
        let held = reasons(of_segments + ncpa_nm.len(), errors.left_ncpa(), of_segments, &correction.held);
        let mut actuators_nm = Vec::new();
        if scene.has_mirror() {
            let stroke_nm = limit_nm.or(scene.mirror.stroke_limit_nm).unwrap_or(f64::INFINITY);
            let wanted_nm = mirror_commands(scene, &telescope, &errors.ncpa, &ncpa_nm)?;
            actuators_nm = wanted_nm.into_iter().map(|(at, nm)| (at, clip(nm, stroke_nm))).collect();
        }
        let additions_nm: Vec<f64> = actuators_nm.iter().map(|(_, nm)| *nm).collect();
        let in_terms = |moved, nm: &[f64], tilts_nm: &[f64]| {
            if nm.is_empty() { Ok(None) } else { commands(scene, moved, nm, tilts_nm) }
        };
        let segment_commands = in_terms(Moved::Segments, &pistons_nm, &tilts_nm)?;
        let actuator_commands = in_terms(Moved::Actuators, &additions_nm, &[])?;
        let leaves_tilts = segment_commands.as_ref().is_some_and(|commands| !commands.has_tilts);
        let says = |is_so: bool, sentence: &str| is_so.then(|| sentence.to_owned());
        let lacks_response = matches!(errors.ncpa, NcpaModes::Smooth(_)) && errors.reference_mas_per_nm.is_none();
        let has_loop = scene.control.is_some() && scene.wavefront_sensor.is_some();
        let warnings = [
            says(leaves_tilts && tilts_nm.iter().any(|nm| *nm != 0.0), TILTS_LEFT),
            says(has_loop && lacks_response && ncpa_nm.iter().any(|nm| *nm != 0.0), NO_REFERENCE),
        ];
        let channels = [&segment_commands, &actuator_commands].into_iter().flatten().flat_map(|one| &one.channels);
        limited += channels.filter(|channel| channel.is_limited).count();
        Ok(Self {
            places: SegmentPlace::all(scene, segments),
            pistons_nm,
            estimate_nm,
            tilts_nm,
            tilt_estimate_nm,
            ncpa: (0..ncpa_nm.len())
                .map(|mode| ModeCorrection {
                    estimate_nm: errors.ncpa_nm[mode],
                    sigma_nm: errors.ncpa_sigma_nm[mode],
                    corrected_nm: ncpa_nm[mode],
                    held: held[of_segments + mode],
                })
                .collect(),
            segments_held: held[..of_segments].to_vec(),
            corrected_modes: ncpa_nm.iter().filter(|nm| **nm != 0.0).count(),
            expected_drop_nm2: correction.expected_drop_nm2,
            policy,
            actuators_nm,
            slopes_mas: errors.reference_mas_per_nm.map_or(Vec::new(), |response| reference_slopes(response, &ncpa_nm)),
            segment_commands,
            actuator_commands,
            limited,
            warnings: warnings.into_iter().flatten().collect(),
            estimate_warnings: Vec::new(),
        })
    }

    /// Reads the controllers that `scene` describes, so that a mistake in them is found before an
    /// estimate.
    ///
    /// # Errors
    /// [`Error::File`] as [`Corrections::new`]; those of building the telescope.
    pub fn check_controllers(scene: &System) -> Result<()> {
        let telescope = Telescope::new(scene)?;
        commands(scene, Moved::Segments, &vec![0.0; telescope.pupil.segments.len()], &[])?;
        if scene.has_mirror() {
            commands(scene, Moved::Actuators, &vec![0.0; actuators_in_use(scene, &telescope)?.len()], &[])?;
        }
        Ok(())
    }
}

/// Why each of `count` modes stays: as `held` says, and of `left` modes from number `first` on
/// because they are never corrected.
fn reasons(count: usize, left: usize, first: usize, held: &[HeldMode]) -> Vec<Option<HoldReason>> {
    let mut reasons = vec![None; count];
    held.iter().for_each(|one| reasons[one.mode] = Some(one.reason));
    reasons[first..first + left].fill(Some(HoldReason::NeverCorrected));
    reasons
}

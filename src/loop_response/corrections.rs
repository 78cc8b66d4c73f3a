//! Corrections from an estimate: increments of the segments' pistons, tips and tilts, of the mirror's commands and of the sensor's
//! reference slopes.
//!
//! A mode whose estimate is below its error bar is left unchanged, so that corrections do not add noise. The plane through the
//! segments, of which images hold little information, and tip and tilt, which are pointing, are left unchanged too. Segments and
//! subapertures are in this program's order, wavefronts in nm; a positive command raises the wavefront.

use super::sensor_model::SensorModel;
use crate::ao::Simulator;
use crate::io::{Column, FitsWriter};
use crate::linear_algebra::SpdInverse;
use crate::modes::{Samples, SmoothBasis};
use crate::pupil::Segment;
use crate::retrieval::IlluminatedSamples;
use crate::scene::Scene;
use crate::telescope::{SegmentPlace, Telescope};
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, Axis, s};
use std::path::Path;

/// Estimated static errors, as far as corrections need them.
pub struct CorrectableErrors<'a> {
    /// Piston of each segment, nm.
    pub pistons_nm: &'a [f64],
    /// Tip of each segment, then tilt of each, nm RMS over the segment; empty where they were not estimated. With them the segments have
    /// no common tip and tilt.
    pub tilts_nm: &'a [f64],
    /// Coefficients of the NCPA in `ncpa_basis`, tip and tilt first, nm.
    pub ncpa_nm: &'a [f64],
    /// Covariance of all three in turn, nm².
    pub covariance_nm2: &'a Array2<f64>,
    /// Basis of the NCPA.
    pub ncpa_basis: &'a SmoothBasis,
}

/// Corrections.
#[derive(Debug, Clone)]
pub struct Corrections {
    /// Place of each segment.
    pub places: Vec<SegmentPlace>,
    /// Increment of each segment's piston, nm; 0 where its estimate is below its error bar.
    pub pistons_nm: Vec<f64>,
    /// Estimate of each piston and its error bar, nm, both without the plane through all segments.
    pub estimate_nm: Vec<[f64; 2]>,
    /// Increments of the tip of each segment, then of the tilt of each, nm RMS over the segment; empty where they were not estimated.
    pub tilts_nm: Vec<f64>,
    /// Estimate of each tip, then of each tilt, and its error bar, nm RMS over the segment.
    pub tilt_estimate_nm: Vec<[f64; 2]>,
    /// Number of corrected NCPA modes.
    pub corrected_modes: usize,
    /// Increments of the mirror's commands, nm, with the position of each actuator, m; empty without a loop in the scene.
    pub actuators_nm: Vec<([f64; 2], f64)>,
    /// Increments of the sensor's reference slopes, all x then all y, mas.
    pub slopes_mas: Vec<f64>,
    /// Number of commands that were clipped at the limit.
    pub limited: usize,
}

/// Regularisation of the fit of the mirror's commands, as a fraction of the strongest actuator's: bounds the commands of actuators
/// at the edge of the pupil.
const REGULARISATION: f64 = 1e-4;

impl Corrections {
    /// The corrections of `errors`, no command beyond `limit_nm` (`None`: the mirror's stroke for actuators, and for pistons a
    /// quarter of the images' wavelength, half of the distance to the next fringe).
    ///
    /// # Errors
    /// [`Error::Value`] for a limit that is not positive; those of building the scene's loop.
    pub fn new(scene: &Scene, errors: &CorrectableErrors, limit_nm: Option<f64>) -> Result<Self> {
        if let Some(limit_nm) = limit_nm.filter(|limit_nm| !(limit_nm.is_finite() && *limit_nm > 0.0)) {
            return Err(Error::Value(format!("a limit of {limit_nm} nm was given: a positive one is needed")));
        }
        let (segments, tilts) = (errors.pistons_nm.len(), errors.tilts_nm.len());
        let telescope = Telescope::new(scene)?;
        let sigma = |mode: usize| errors.covariance_nm2[[mode, mode]].max(0.0).sqrt();
        let mut limited = 0;
        let mut clip = |command_nm: f64, limit_nm: f64| {
            limited += usize::from(command_nm.abs() > limit_nm);
            command_nm.clamp(-limit_nm, limit_nm)
        };
        // With tilts the segments have no common plane, and one through the pistons alone is a shape of the whole mirror.
        let flat = if tilts > 0 { Array2::eye(segments) } else { without_plane(&telescope.pupil.segments) };
        let pistons_nm = flat.dot(&ArrayView1::from(errors.pistons_nm));
        let covariance_nm2 = flat.dot(&errors.covariance_nm2.slice(s![..segments, ..segments])).dot(&flat);
        let estimate_nm: Vec<[f64; 2]> =
            pistons_nm.iter().zip(covariance_nm2.diag()).map(|(&nm, nm2)| [nm, nm2.max(0.0).sqrt()]).collect();
        let tilt = |(mode, &nm): (usize, &f64)| [nm, sigma(segments + mode)];
        let tilt_estimate_nm: Vec<[f64; 2]> = errors.tilts_nm.iter().enumerate().map(tilt).collect();
        let segment_limit_nm = limit_nm.unwrap_or(scene.image.wavelength_nm / 4.0);
        let mut command =
            |[nm, sigma_nm]: &[f64; 2]| if nm.abs() > *sigma_nm { clip(-nm, segment_limit_nm) } else { 0.0 };
        let [pistons_nm, tilts_nm] =
            [&estimate_nm, &tilt_estimate_nm].map(|estimates| estimates.iter().map(&mut command).collect());
        let significant = |(mode, &nm): (usize, &f64)| if nm.abs() > sigma(segments + tilts + mode) { nm } else { 0.0 };
        let mut ncpa_nm: Vec<f64> = errors.ncpa_nm.iter().enumerate().map(significant).collect();
        // Tip and tilt are pointing.
        ncpa_nm.iter_mut().take(2).for_each(|nm| *nm = 0.0);
        let corrected_modes = ncpa_nm.iter().filter(|nm| **nm != 0.0).count();
        let mut corrections = Self {
            places: SegmentPlace::all(scene, &telescope.pupil.segments),
            pistons_nm,
            estimate_nm,
            tilts_nm,
            tilt_estimate_nm,
            corrected_modes,
            actuators_nm: Vec::new(),
            slopes_mas: Vec::new(),
            limited: 0,
        };
        if scene.control.is_some() && scene.wavefront_sensor.is_some() {
            let offsets = LoopOffsets::new(scene, &telescope, errors.ncpa_basis, &ncpa_nm)?;
            let stroke_nm = limit_nm.or(scene.mirror.stroke_limit_nm).unwrap_or(f64::INFINITY);
            corrections.actuators_nm =
                offsets.commands_nm.into_iter().map(|(at, nm)| (at, clip(nm, stroke_nm))).collect();
            corrections.slopes_mas = offsets.slopes_mas;
        }
        corrections.limited = limited;
        Ok(corrections)
    }

    /// Writes the corrections as FITS: table `SEGMENTS`, and where there is a loop `ACTUATORS` and `REFERENCE`.
    ///
    /// # Errors
    /// [`Error::File`] where the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut file = FitsWriter::create(path)?;
        file.card("PRIMARY", "NCPAMODE", self.corrected_modes as i64, "NCPA modes corrected")?;
        file.card("PRIMARY", "NLIMITED", self.limited as i64, "commands cut at the limit")?;
        let column = |of: &[[f64; 2]], i: usize| of.iter().map(|pair| pair[i]).collect::<Vec<f64>>();
        let mut segments = SegmentPlace::columns(&self.places);
        segments.push(Column::f64("ADD_NM", "nm", self.pistons_nm.clone()));
        segments.push(Column::f64("ESTIMATE_NM", "nm", column(&self.estimate_nm, 0)));
        segments.push(Column::f64("SIGMA_NM", "nm", column(&self.estimate_nm, 1)));
        let count = self.pistons_nm.len();
        let tilts = self.tilts_nm.chunks(count).zip(self.tilt_estimate_nm.chunks(count));
        for ((add_nm, estimate_nm), name) in tilts.zip(["TIP", "TILT"]) {
            segments.push(Column::f64(&format!("ADD_{name}_NM"), "nm", add_nm.to_vec()));
            segments.push(Column::f64(&format!("{name}_NM"), "nm", column(estimate_nm, 0)));
            segments.push(Column::f64(&format!("{name}_SIGMA_NM"), "nm", column(estimate_nm, 1)));
        }
        file.table("SEGMENTS", &segments)?;
        if !self.actuators_nm.is_empty() {
            let actuators = [
                Column::f64("X_M", "m", self.actuators_nm.iter().map(|(at, _)| at[0]).collect()),
                Column::f64("Y_M", "m", self.actuators_nm.iter().map(|(at, _)| at[1]).collect()),
                Column::f64("ADD_NM", "nm", self.actuators_nm.iter().map(|(_, nm)| *nm).collect()),
            ];
            file.table("ACTUATORS", &actuators)?;
            let (x, y) = self.slopes_mas.split_at(self.slopes_mas.len() / 2);
            let reference = [Column::f64("X_MAS", "mas", x.to_vec()), Column::f64("Y_MAS", "mas", y.to_vec())];
            file.table("REFERENCE", &reference)?;
        }
        file.finish()
    }
}

/// Projection that removes the plane through all pistons, `[segment, segment]`; only their mean where three segments or fewer
/// define any plane.
fn without_plane(segments: &[Segment]) -> Array2<f64> {
    let count = segments.len();
    let values = |value: &dyn Fn(&Segment) -> f64| segments.iter().map(value).collect::<Array1<f64>>();
    let plane = [values(&|_| 1.0), values(&|segment| segment.x_m), values(&|segment| segment.y_m)];
    let mut projection = Array2::eye(count);
    for direction in plane.into_iter().take(if count > 3 { 3 } else { 1 }) {
        let new: Array1<f64> = projection.dot(&direction);
        let (left, all) = (new.dot(&new), direction.dot(&direction));
        // Segments in a row along an axis have no such direction.
        if left > 1e-12 * all {
            projection -= &(&new.view().insert_axis(Axis(1)) * &new.view().insert_axis(Axis(0)) / left);
        }
    }
    projection
}

/// Offsets of the mirror's commands, and of the sensor's reference that holds them. The mirror is subtracted from the wavefront, so
/// it takes the shape of the NCPA, and the sensor measures the opposite.
struct LoopOffsets {
    /// Position of each actuator, m, and its offset, nm.
    commands_nm: Vec<([f64; 2], f64)>,
    slopes_mas: Vec<f64>,
}

impl LoopOffsets {
    /// Fits the commands to NCPA `ncpa_nm` of `basis`, least squares over the pupil.
    fn new(scene: &Scene, telescope: &Telescope, basis: &SmoothBasis, ncpa_nm: &[f64]) -> Result<Self> {
        let samples = Samples::from_pupil(&telescope.pupil)?;
        let simulator = Simulator::new(scene)?;
        let influence = simulator.influence();
        let shapes = influence.evaluate(&samples.xs_m, &samples.ys_m)?;
        let weighted = &shapes * &ArrayView1::from(&samples.weights);
        let wanted_nm = ArrayView1::from(ncpa_nm).dot(&basis.evaluate(&samples.xs_m, &samples.ys_m)?);
        let mut gram = weighted.dot(&shapes.t());
        let strongest = gram.diag().iter().copied().fold(0.0, f64::max);
        gram.diag_mut().iter_mut().for_each(|value| *value += REGULARISATION * strongest);
        let commands_nm: Array1<f64> = SpdInverse::new(&gram)?.inverse.dot(&weighted.dot(&wanted_nm));
        let positions = influence.positions_m().into_iter().map(|(x_m, y_m)| [x_m, y_m]);
        let grid = telescope.pupil.grid;
        let illuminated = IlluminatedSamples::new(grid.samples(), grid.pitch_m(), &telescope.area_weights(grid)?)?;
        let opposite_nm: Vec<f64> = ncpa_nm.iter().map(|nm| -nm).collect();
        let mut sensor = SensorModel::new(scene, telescope, &illuminated, basis)?;
        let slopes_mas = sensor.slopes_mas(&opposite_nm)?.to_vec();
        Ok(Self { commands_nm: positions.zip(commands_nm).collect(), slopes_mas })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_projection_removes_the_plane_alone() {
        let at = |x_m: f64, y_m: f64| Segment { x_m, y_m };
        let segments = [at(0.0, 0.0), at(1.0, 0.0), at(0.5, 0.9), at(-0.5, 0.9), at(-1.0, 0.1), at(0.4, -0.9)];
        let flat = without_plane(&segments);
        let plane: Array1<f64> = segments.iter().map(|segment| 3.0 - 7.0 * segment.x_m + 2.0 * segment.y_m).collect();
        assert!(flat.dot(&plane).iter().all(|nm| nm.abs() < 1e-13));
        // A projection whose rank lacks three.
        assert!((&flat.dot(&flat) - &flat).iter().all(|off| off.abs() < 1e-14));
        assert!((flat.diag().sum() - 3.0).abs() < 1e-13);
        let mean = without_plane(&segments[..3]);
        assert!((mean.diag().sum() - 2.0).abs() < 1e-14);
        let row = without_plane(&[at(-1.5, 0.0), at(-0.5, 0.0), at(0.5, 0.0), at(1.5, 0.0)]);
        assert!((row.diag().sum() - 2.0).abs() < 1e-14);
    }
}

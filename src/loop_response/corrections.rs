//! Corrections from an estimate: what to add to the segments' pistons, to the mirror's commands, to the sensor's reference.
//!
//! Do no harm: a mode whose estimate is under its error bar is left alone, and so is where the star stands: the plane through the
//! pistons, which images hardly see, and tip and tilt. Segments and subapertures are in this program's order, wavefront in
//! nm, a positive command raises the wavefront.

use super::sensor_model::SensorModel;
use crate::ao::Simulator;
use crate::io::{Column, FitsWriter};
use crate::linear_algebra::Spd;
use crate::modes::Samples;
use crate::pupil::Segment;
use crate::retrieval::LitSamples;
use crate::scene::Scene;
use crate::statics::Family;
use crate::statics::NcpaModes;
use crate::statics::Pass;
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, Axis, s};
use std::path::Path;

/// Corrections.
#[derive(Debug, Clone)]
pub struct Commands {
    /// To add to each segment's piston, nm; 0 where its estimate is under its error bar.
    pub pistons_nm: Vec<f64>,
    /// Estimate of each piston and its error bar, nm; both without the plane through all of them.
    pub estimate_nm: Vec<[f64; 2]>,
    /// NCPA modes that are corrected.
    pub corrected_modes: usize,
    /// To add to the mirror's commands, with the position of each actuator in m, nm; none without a loop in the scene.
    pub actuators_nm: Vec<([f64; 2], f64)>,
    /// To add to the sensor's reference slopes, all x then all y, mas.
    pub slopes_mas: Vec<f64>,
    /// Commands that were cut at the limit.
    pub limited: usize,
}

/// Weight that keeps actuators which the pupil hardly shows from flying off, of the strongest one's.
const HELD: f64 = 1e-4;

impl Commands {
    /// Those that `pass` calls for, no command beyond `limit_nm` (`None`: the mirror's stroke for actuators, a quarter of the
    /// images' wavelength for pistons, half of what they can be told from the next fringe by).
    ///
    /// # Errors
    /// [`Error::Value`] for a limit that is not positive; those of building the scene's loop.
    pub fn of(scene: &Scene, pass: &Pass, limit_nm: Option<f64>) -> Result<Self> {
        if let Some(limit_nm) = limit_nm.filter(|limit_nm| !(limit_nm.is_finite() && *limit_nm > 0.0)) {
            return Err(Error::Value(format!("a limit of {limit_nm} nm leaves no command: a positive one is needed")));
        }
        let errors = &pass.errors;
        let segments = errors.pistons_nm.len();
        let telescope = Telescope::of(scene)?;
        let sigma = |mode: usize| errors.covariance_nm2[[mode, mode]].max(0.0).sqrt();
        let mut limited = 0;
        let mut cut = |command_nm: f64, limit_nm: f64| {
            limited += usize::from(command_nm.abs() > limit_nm);
            command_nm.clamp(-limit_nm, limit_nm)
        };
        let flat = without_plane(&telescope.pupil.segments);
        let pistons_nm = flat.dot(&ArrayView1::from(&errors.pistons_nm));
        let covariance_nm2 = flat.dot(&errors.covariance_nm2.slice(s![..segments, ..segments])).dot(&flat);
        let estimate_nm: Vec<[f64; 2]> =
            pistons_nm.iter().zip(covariance_nm2.diag()).map(|(&nm, nm2)| [nm, nm2.max(0.0).sqrt()]).collect();
        let piston_limit_nm = limit_nm.unwrap_or(scene.image.wavelength_nm / 4.0);
        let piston = |[nm, sigma_nm]: &[f64; 2]| if nm.abs() > *sigma_nm { cut(-nm, piston_limit_nm) } else { 0.0 };
        let pistons_nm = estimate_nm.iter().map(piston).collect();
        let seen = |(mode, &nm): (usize, &f64)| if nm.abs() > sigma(segments + mode) { nm } else { 0.0 };
        let mut ncpa_nm: Vec<f64> = errors.ncpa_nm.iter().enumerate().map(seen).collect();
        // Where the star stands is the telescope's affair.
        ncpa_nm.iter_mut().take(2).for_each(|nm| *nm = 0.0);
        let corrected_modes = ncpa_nm.iter().filter(|nm| **nm != 0.0).count();
        let mut this = Self {
            pistons_nm,
            estimate_nm,
            corrected_modes,
            actuators_nm: Vec::new(),
            slopes_mas: Vec::new(),
            limited: 0,
        };
        if scene.control.is_some() && scene.wavefront_sensor.is_some() {
            let (commands_nm, slopes_mas) = behind_a_loop(scene, &telescope, pass.family, &ncpa_nm, segments)?;
            let stroke_nm = limit_nm.or(scene.mirror.stroke_limit_nm).unwrap_or(f64::INFINITY);
            this.actuators_nm = commands_nm.into_iter().map(|(at, nm)| (at, cut(nm, stroke_nm))).collect();
            this.slopes_mas = slopes_mas;
        }
        this.limited = limited;
        Ok(this)
    }

    /// Writes them as FITS: tables `SEGMENTS`, and where there is a loop `ACTUATORS` and `REFERENCE`.
    ///
    /// # Errors
    /// [`Error::File`] where the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut file = FitsWriter::create(path)?;
        file.card("PRIMARY", "CREATOR", concat!("cophase ", env!("CARGO_PKG_VERSION")), "program and version")?;
        file.card("PRIMARY", "NCPAMODE", self.corrected_modes as i64, "NCPA modes corrected")?;
        file.card("PRIMARY", "NLIMITED", self.limited as i64, "commands cut at the limit")?;
        let column = |i: usize| self.estimate_nm.iter().map(|pair| pair[i]).collect::<Vec<f64>>();
        let segments = [
            Column::i64("SEGMENT", (0..self.pistons_nm.len() as i64).collect()),
            Column::f64("ADD_NM", "nm", self.pistons_nm.clone()),
            Column::f64("ESTIMATE_NM", "nm", column(0)),
            Column::f64("SIGMA_NM", "nm", column(1)),
        ];
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

/// What takes the plane through all pistons out of them, `[segment, segment]`; only their mean where three segments or fewer
/// are nothing but a plane.
fn without_plane(segments: &[Segment]) -> Array2<f64> {
    let count = segments.len();
    let of = |value: &dyn Fn(&Segment) -> f64| segments.iter().map(value).collect::<Array1<f64>>();
    let plane = [of(&|_| 1.0), of(&|segment| segment.x_m), of(&|segment| segment.y_m)];
    let mut flat = Array2::eye(count);
    for direction in plane.into_iter().take(if count > 3 { 3 } else { 1 }) {
        let new: Array1<f64> = flat.dot(&direction);
        let (left, all) = (new.dot(&new), direction.dot(&direction));
        // Segments in a row along an axis have no such direction.
        if left > 1e-12 * all {
            flat -= &(&new.view().insert_axis(Axis(1)) * &new.view().insert_axis(Axis(0)) / left);
        }
    }
    flat
}

/// Offsets of the mirror, and of the sensor's reference that keeps them there. The mirror is subtracted, so it takes the
/// shape of the NCPA; the sensor then sees their opposite.
#[allow(clippy::type_complexity)] // two lists, used once
fn behind_a_loop(
    scene: &Scene,
    telescope: &Telescope,
    family: Family,
    ncpa_nm: &[f64],
    segments: usize,
) -> Result<(Vec<([f64; 2], f64)>, Vec<f64>)> {
    let modes = NcpaModes::of(family, scene, telescope)?;
    let samples = Samples::of(&telescope.pupil)?;
    let simulator = Simulator::new(scene)?;
    let influence = simulator.influence();
    let shapes = influence.evaluate(&samples.xs_m, &samples.ys_m)?;
    let weighted = &shapes * &ArrayView1::from(&samples.weights);
    let wanted_nm = ArrayView1::from(ncpa_nm).dot(&modes.basis.evaluate(&samples.xs_m, &samples.ys_m)?);
    let mut gram = weighted.dot(&shapes.t());
    let strongest = gram.diag().iter().copied().fold(0.0, f64::max);
    gram.diag_mut().iter_mut().for_each(|value| *value += HELD * strongest);
    let commands_nm: Array1<f64> = Spd::of(&gram)?.inverse.dot(&weighted.dot(&wanted_nm));
    let at = influence.positions_m().into_iter().map(|(x_m, y_m)| [x_m, y_m]);
    let grid = telescope.pupil.grid;
    let lit = LitSamples::of(grid.samples(), grid.pitch_m(), &telescope.area_weights(grid)?)?;
    let opposite_nm: Vec<f64> = ncpa_nm.iter().map(|nm| -nm).collect();
    let slopes_mas = SensorModel::of(scene, telescope, &lit, &modes.basis)?.slopes_mas(segments, &opposite_nm)?;
    Ok((at.zip(commands_nm).collect(), slopes_mas.to_vec()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_taken_out_of_pistons_and_nothing_else() {
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

//! Corrections from an estimate: increments of the segments' pistons, tips and tilts, of the mirror's commands and of the sensor's
//! reference slopes.
//!
//! A mode whose estimate is below its error bar is left unchanged, so that corrections do not add noise; a [`CorrectionPolicy`] says more. Tip and tilt, which are
//! pointing, are left unchanged too, and behind adaptive optics the plane through the segments, of which images there hold little
//! information. Segments and
//! subapertures are in this program's order, wavefronts in nm. A positive piston raises the wavefront; the mirror's surface is taken off
//! the wavefront, as in the simulator. [`Commands`] are the same in the terms of the controllers that the scene describes.

use super::controller::{Commands, Moved, commands};
use super::segment_layout::{edges, without_plane};
use super::sensor_model::SensorModel;
use crate::ao::actuators_in_use;
use crate::io::{Column, FitsWriter, write_atomically};
use crate::linear_algebra::SpdInverse;
use crate::modes::{Samples, SmoothBasis};
use crate::pupil::{Pupil, Segment};
use crate::retrieval::IlluminatedSamples;
use crate::scene::Scene;
use crate::telescope::{SegmentPlace, Telescope};
use crate::tracking::{Correctable, CorrectionPolicy, correction};
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, s};
use std::path::Path;

/// Estimated static errors, as far as corrections need them.
pub struct CorrectableErrors<'a> {
    /// Piston of each segment, nm; none where the estimate has none.
    pub pistons_nm: &'a [f64],
    /// Tip of each segment, then tilt of each, nm RMS over the segment; empty where they are not corrected. With them the segments have
    /// no common tip and tilt.
    pub tilts_nm: &'a [f64],
    /// Covariance of pistons and tilts in turn, nm².
    pub segment_covariance_nm2: ArrayView2<'a, f64>,
    /// Whether the plane through all pistons is left as it is, and not only their mean; without tilts and without a policy.
    pub leaves_plane: bool,
    /// Largest correction of a piston, or of a tilt, unless a caller names one, nm.
    pub segment_limit_nm: f64,
    /// Coefficients of the NCPA, nm.
    pub ncpa_nm: &'a [f64],
    /// Their error bars, nm.
    pub ncpa_sigma_nm: &'a [f64],
    /// What they are coefficients of.
    pub ncpa: NcpaModes<'a>,
    /// Gain, deadband, convention and no harm; `None` corrects all of each mode above its error bar.
    pub policy: Option<CorrectionPolicy>,
}

/// Modes of the NCPA.
pub enum NcpaModes<'a> {
    /// Functions of the place in the pupil; tip and tilt are the first two.
    Smooth(&'a SmoothBasis),
    /// Maps on the scene's grid: the map of such coefficients, `[y, x]`, nm, NaN outside the pupil.
    Maps(&'a dyn Fn(&[f64]) -> Array2<f64>),
}

/// Corrections.
#[derive(Debug, Clone)]
pub struct Corrections {
    /// Place of each segment; none where the estimate has no pistons.
    pub places: Vec<SegmentPlace>,
    /// Increment of each segment's piston, nm; 0 where it stays.
    pub pistons_nm: Vec<f64>,
    /// Estimate of each piston and its error bar, nm, both without what is left as it is: the mean of all pistons, or the plane through
    /// them.
    pub estimate_nm: Vec<[f64; 2]>,
    /// Increments of the tip of each segment, then of the tilt of each, nm RMS over the segment; empty where they were not estimated.
    pub tilts_nm: Vec<f64>,
    /// Estimate of each tip, then of each tilt, and its error bar, nm RMS over the segment.
    pub tilt_estimate_nm: Vec<[f64; 2]>,
    /// Number of corrected NCPA modes.
    pub corrected_modes: usize,
    /// Increments of the mirror's commands, nm, with the position of each actuator, m; empty where the scene names no mirror.
    pub actuators_nm: Vec<([f64; 2], f64)>,
    /// Increments of the sensor's reference slopes, all x then all y, mas; empty without a loop in the scene, and for maps of NCPA.
    pub slopes_mas: Vec<f64>,
    /// Pistons, and where its matrix takes them tips and tilts, in the terms of the segments' controller, where the scene describes one.
    pub segment_commands: Option<Commands>,
    /// The mirror's commands in the terms of its controller, where the scene describes one.
    pub actuator_commands: Option<Commands>,
    /// Number of commands that were clipped at a limit.
    pub limited: usize,
    /// Sentences to read before anything is moved: the estimate adds its warnings and remarks.
    pub warnings: Vec<String>,
}

/// Regularisation of the fit of the mirror's commands, as a fraction of the strongest actuator's: bounds the commands of actuators
/// at the edge of the pupil.
const REGULARISATION: f64 = 1e-4;
/// Extension of a file of corrections that is text.
const TEXT: &str = "txt";
/// Said where tilts of segments are to be corrected and the controller moves pistons alone.
const TILTS_LEFT: &str = "the commands of the segments hold pistons alone, and not the tips and tilts that were estimated: a \
     commands.segment_matrix_file with a column for each piston, then each tip, then each tilt takes them, too";

impl Corrections {
    /// The corrections of `errors`, no increment beyond `limit_nm` (`None`: the mirror's stroke for actuators, and the limit of the
    /// errors for segments).
    ///
    /// # Errors
    /// [`Error::Value`] for a limit that is not positive; [`Error::File`] for a controller that does not fit; those of building the
    /// scene's loop.
    pub fn new(scene: &Scene, errors: &CorrectableErrors, limit_nm: Option<f64>) -> Result<Self> {
        if let Some(limit_nm) = limit_nm.filter(|limit_nm| !(limit_nm.is_finite() && *limit_nm > 0.0)) {
            return Err(Error::Value(format!("a limit of {limit_nm} nm was given: a positive one is needed")));
        }
        let telescope = Telescope::new(scene)?;
        let segments = &telescope.pupil.segments[..errors.pistons_nm.len()];
        let mut limited = 0;
        let mut clip = |command_nm: f64, limit_nm: f64| {
            limited += usize::from(command_nm.abs() > limit_nm);
            command_nm.clamp(-limit_nm, limit_nm)
        };
        let count = segments.len();
        // Segments with tilts have no common motion, and a plane through their pistons alone is a shape of the whole mirror.
        // A policy weighs the plane by its error bars, and needs no rule for it.
        let leaves_plane = errors.leaves_plane && errors.policy.is_none();
        let flat = match errors.tilts_nm {
            [] => without_plane(segments, leaves_plane),
            _ => Array2::eye(count),
        };
        let pistons_nm = flat.dot(&ArrayView1::from(errors.pistons_nm));
        let covariance_nm2 = flat.dot(&errors.segment_covariance_nm2.slice(s![..count, ..count])).dot(&flat);
        let estimate_nm: Vec<[f64; 2]> =
            pistons_nm.iter().zip(covariance_nm2.diag()).map(|(&nm, nm2)| [nm, nm2.max(0.0).sqrt()]).collect();
        let variances_nm2 = errors.segment_covariance_nm2.diag();
        let tilts = errors.tilts_nm.iter().zip(variances_nm2.iter().skip(count));
        let tilt_estimate_nm: Vec<[f64; 2]> = tilts.map(|(&nm, nm2)| [nm, nm2.max(0.0).sqrt()]).collect();
        let segment_limit_nm = limit_nm.unwrap_or(errors.segment_limit_nm);
        let mut covariance_of_segments_nm2 = errors.segment_covariance_nm2.to_owned();
        covariance_of_segments_nm2.slice_mut(s![..count, ..count]).assign(&covariance_nm2);
        let segments_nm: Vec<f64> = estimate_nm.iter().chain(&tilt_estimate_nm).map(|[nm, _]| *nm).collect();
        let (segments_nm, ncpa_nm) = errors.chosen(&segments_nm, &covariance_of_segments_nm2, segments)?;
        let mut additions_nm = segments_nm.iter().map(|nm| clip(-nm, segment_limit_nm)).collect::<Vec<f64>>();
        let tilts_nm = additions_nm.split_off(count);
        let pistons_nm = additions_nm;
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
        let warnings = (leaves_tilts && tilts_nm.iter().any(|nm| *nm != 0.0)).then(|| TILTS_LEFT.to_owned());
        let channels = [&segment_commands, &actuator_commands].into_iter().flatten().flat_map(|one| &one.channels);
        limited += channels.filter(|channel| channel.is_limited).count();
        Ok(Self {
            places: SegmentPlace::all(scene, segments),
            pistons_nm,
            estimate_nm,
            tilts_nm,
            tilt_estimate_nm,
            corrected_modes: ncpa_nm.iter().filter(|nm| **nm != 0.0).count(),
            actuators_nm,
            slopes_mas: reference_slopes(scene, &telescope, errors, &ncpa_nm)?,
            segment_commands,
            actuator_commands,
            limited,
            warnings: warnings.into_iter().collect(),
        })
    }

    /// Reads the controllers that `scene` describes, so that a mistake in them is found before an estimate.
    ///
    /// # Errors
    /// [`Error::File`] as [`Corrections::new`]; those of building the telescope.
    pub fn check_controllers(scene: &Scene) -> Result<()> {
        let telescope = Telescope::new(scene)?;
        commands(scene, Moved::Segments, &vec![0.0; telescope.pupil.segments.len()], &[])?;
        if scene.has_mirror() {
            commands(scene, Moved::Actuators, &vec![0.0; actuators_in_use(scene, &telescope)?.len()], &[])?;
        }
        Ok(())
    }

    /// Writes the corrections: as text for a path that ends in `.txt`, else as FITS with the table `SEGMENTS`, where there is a mirror
    /// `ACTUATORS`, where there is a loop `REFERENCE`, where the scene describes controllers `SEGMENT_COMMANDS` and
    /// `ACTUATOR_COMMANDS`, and `WARNINGS`.
    ///
    /// # Errors
    /// [`Error::File`] where the file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        if path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case(TEXT)) {
            return write_atomically(path, self.text().as_bytes());
        }
        let mut file = FitsWriter::create(path)?;
        file.card("PRIMARY", "NCPAMODE", self.corrected_modes as i64, "NCPA modes corrected")?;
        file.card("PRIMARY", "NLIMITED", self.limited as i64, "commands cut at the limit")?;
        let column = |of: &[[f64; 2]], i: usize| of.iter().map(|pair| pair[i]).collect::<Vec<f64>>();
        let mut segments = SegmentPlace::columns(&self.places);
        segments.push(Column::f64("ADD_NM", "nm", self.pistons_nm.clone()));
        segments.push(Column::f64("ESTIMATE_NM", "nm", column(&self.estimate_nm, 0)));
        segments.push(Column::f64("SIGMA_NM", "nm", column(&self.estimate_nm, 1)));
        for (of, name) in [(0, "TIP"), (1, "TILT")] {
            if let Some((add_nm, estimate_nm)) = self.tilts_of_axis(of) {
                segments.push(Column::f64(&format!("ADD_{name}_NM"), "nm", add_nm.to_vec()));
                segments.push(Column::f64(&format!("{name}_NM"), "nm", column(estimate_nm, 0)));
                segments.push(Column::f64(&format!("{name}_SIGMA_NM"), "nm", column(estimate_nm, 1)));
            }
        }
        if !self.places.is_empty() {
            file.table("SEGMENTS", &segments)?;
        }
        if !self.actuators_nm.is_empty() {
            let actuators = [
                Column::f64("X_M", "m", self.actuators_nm.iter().map(|(at, _)| at[0]).collect()),
                Column::f64("Y_M", "m", self.actuators_nm.iter().map(|(at, _)| at[1]).collect()),
                Column::f64("ADD_NM", "nm", self.actuators_nm.iter().map(|(_, nm)| *nm).collect()),
            ];
            file.table("ACTUATORS", &actuators)?;
        }
        if !self.slopes_mas.is_empty() {
            let (x, y) = self.slopes_mas.split_at(self.slopes_mas.len() / 2);
            let reference = [Column::f64("X_MAS", "mas", x.to_vec()), Column::f64("Y_MAS", "mas", y.to_vec())];
            file.table("REFERENCE", &reference)?;
        }
        let controllers =
            [("SEGMENT_COMMANDS", &self.segment_commands), ("ACTUATOR_COMMANDS", &self.actuator_commands)];
        for (name, commands) in controllers {
            if let Some(commands) = commands {
                file.table(name, &commands.columns())?;
            }
        }
        if !self.warnings.is_empty() {
            file.table("WARNINGS", &[Column::text("SENTENCE", &self.warnings)])?;
        }
        file.finish()
    }

    /// The commands as text: the warnings as comments, and a line with the name of each channel and what to add to it.
    fn text(&self) -> String {
        let mut text = String::from("# Corrections by cophase: what to add to each channel.\n");
        self.warnings.iter().for_each(|sentence| text += &format!("# {}\n", sentence.replace('\n', " ")));
        let own = |nm: &mut dyn Iterator<Item = f64>| Commands::in_nm(nm);
        let segments = own(&mut self.pistons_nm.iter().copied());
        let [tips, tilts] = [0, 1].map(|axis| {
            let is_own = self.segment_commands.is_none();
            own(&mut self
                .tilts_of_axis(axis)
                .filter(|_| is_own)
                .into_iter()
                .flat_map(|(add_nm, _)| add_nm.iter().copied()))
        });
        let actuators = own(&mut self.actuators_nm.iter().map(|(_, nm)| *nm));
        for (what, commands) in [
            ("segments", self.segment_commands.as_ref().unwrap_or(&segments)),
            ("tips of segments, RMS over each", &tips),
            ("tilts of segments, RMS over each", &tilts),
            ("actuators", self.actuator_commands.as_ref().unwrap_or(&actuators)),
        ] {
            text += &commands.text(what);
        }
        text
    }

    /// Increments of the tips (axis 0) or tilts (axis 1) of all segments, and their estimates; `None` where there are none.
    fn tilts_of_axis(&self, axis: usize) -> Option<(&[f64], &[[f64; 2]])> {
        let count = self.tilts_nm.len() / 2;
        let of_axis = axis * count..(axis + 1) * count;
        (count > 0).then(|| (&self.tilts_nm[of_axis.clone()], &self.tilt_estimate_nm[of_axis]))
    }
}

impl CorrectableErrors<'_> {
    /// What is corrected of the segments' pistons and tilts and of the NCPA, nm: 0 for modes that stay.
    fn chosen(
        &self,
        segments_nm: &[f64],
        covariance_nm2: &Array2<f64>,
        segments: &[Segment],
    ) -> Result<(Vec<f64>, Vec<f64>)> {
        let Some(policy) = &self.policy else {
            let significant = segments_nm.iter().zip(covariance_nm2.diag());
            let significant = significant.map(|(&nm, nm2)| if nm.abs() > nm2.max(0.0).sqrt() { nm } else { 0.0 });
            return Ok((significant.collect(), self.significant_ncpa_nm()));
        };
        let (count, modes) = (segments_nm.len(), segments_nm.len() + self.ncpa_nm.len());
        let coefficients_nm: Array1<f64> = segments_nm.iter().chain(self.ncpa_nm).copied().collect();
        let mut all_nm2 = Array2::zeros((modes, modes));
        all_nm2.slice_mut(s![..count, ..count]).assign(covariance_nm2);
        all_nm2.diag_mut().iter_mut().skip(count).zip(self.ncpa_sigma_nm).for_each(|(nm2, nm)| *nm2 = nm * nm);
        let pointing = if let NcpaModes::Smooth(_) = self.ncpa { 2.min(modes - count) } else { 0 };
        let sent = correction(
            policy,
            &Correctable {
                coefficients_nm: coefficients_nm.view(),
                covariance_nm2: all_nm2.view(),
                segment_modes: &(0..count),
                segment_of_mode: &(0..count).map(|mode| mode % segments.len().max(1)).collect::<Vec<usize>>(),
                edges: &edges(segments),
                left_modes: &(count..count + pointing).collect::<Vec<usize>>(),
            },
        )?;
        let mut segments_nm = sent.coefficients_nm.to_vec();
        let ncpa_nm = segments_nm.split_off(count);
        Ok((segments_nm, ncpa_nm))
    }

    /// Coefficients of the NCPA that are corrected: 0 for those below their error bars, and for tip and tilt, which are pointing.
    fn significant_ncpa_nm(&self) -> Vec<f64> {
        let pairs = self.ncpa_nm.iter().zip(self.ncpa_sigma_nm);
        let mut ncpa_nm: Vec<f64> = pairs.map(|(&nm, &sigma_nm)| if nm.abs() > sigma_nm { nm } else { 0.0 }).collect();
        if let NcpaModes::Smooth(_) = self.ncpa {
            ncpa_nm.iter_mut().take(2).for_each(|nm| *nm = 0.0);
        }
        ncpa_nm
    }
}

/// Position of each actuator, m, and the command, nm, with which the mirror takes the shape of the NCPA `ncpa_nm`: least squares over the
/// pupil. The mirror is subtracted from the wavefront.
fn mirror_commands(
    scene: &Scene,
    telescope: &Telescope,
    modes: &NcpaModes,
    ncpa_nm: &[f64],
) -> Result<Vec<([f64; 2], f64)>> {
    let samples = Samples::from_pupil(&telescope.pupil)?;
    let influence = actuators_in_use(scene, telescope)?;
    let shapes = influence.evaluate(&samples.xs_m, &samples.ys_m)?;
    let weighted = &shapes * &ArrayView1::from(&samples.weights);
    let wanted_nm = match modes {
        NcpaModes::Smooth(basis) => ArrayView1::from(ncpa_nm).dot(&basis.evaluate(&samples.xs_m, &samples.ys_m)?),
        NcpaModes::Maps(map_nm) => without_pointing(&telescope.pupil, &samples, &map_nm(ncpa_nm))?,
    };
    let mut gram = weighted.dot(&shapes.t());
    let strongest = gram.diag().iter().copied().fold(0.0, f64::max);
    gram.diag_mut().iter_mut().for_each(|value| *value += REGULARISATION * strongest);
    let commands_nm: Array1<f64> = SpdInverse::new(&gram)?.inverse.dot(&weighted.dot(&wanted_nm));
    let positions_m = influence.positions_m().into_iter().map(|(x_m, y_m)| [x_m, y_m]);
    Ok(positions_m.zip(commands_nm).collect())
}

/// The map at the samples, without piston, tip and tilt.
fn without_pointing(pupil: &Pupil, samples: &Samples, map_nm: &Array2<f64>) -> Result<Array1<f64>> {
    let columns = map_nm.ncols();
    let flat_nm = pupil.remove_piston_tip_tilt(map_nm.view())?;
    Ok(samples.indices.iter().map(|&at| flat_nm[[at / columns, at % columns]]).collect())
}

/// Offsets of the sensor's reference slopes that hold the mirror where [`mirror_commands`] puts it, mas: the sensor measures the opposite
/// of the NCPA.
fn reference_slopes(
    scene: &Scene,
    telescope: &Telescope,
    errors: &CorrectableErrors,
    ncpa_nm: &[f64],
) -> Result<Vec<f64>> {
    let NcpaModes::Smooth(basis) = errors.ncpa else { return Ok(Vec::new()) };
    if scene.control.is_none() || scene.wavefront_sensor.is_none() {
        return Ok(Vec::new());
    }
    let grid = telescope.pupil.grid;
    let illuminated = IlluminatedSamples::new(grid.samples(), grid.pitch_m(), &telescope.area_weights(grid)?)?;
    let opposite_nm: Vec<f64> = ncpa_nm.iter().map(|nm| -nm).collect();
    let mut sensor = SensorModel::new(scene, telescope, &illuminated, basis)?;
    Ok(sensor.slopes_mas(&opposite_nm)?.to_vec())
}

//! Deformable mirror of a scene: its actuators near the pupil or in its map, and influence
//! functions from a file.
//!
//! | Card of the file | What it says |
//! |---|---|
//! | `BUNIT` | unit of the wavefront that a command of 1 makes: nm, um or m; without it the functions are relative to the command |
//! | `GRID_M`, else `PUPLSCAL`, else `PIXELSCL` | width of the maps; distance of their samples, m |

use super::model::Telescope;
use super::opd::{check_width, unit_nm, width_m};
use super::valid_map;
use crate::io::{self, FitsReader, aot};
use crate::modes::{InfluenceFunctions, MeasuredInfluence, Mirror};
use crate::scene::System;
use crate::{Error, Result};
use ndarray::{ArrayD, Ix2, Ix3};
use std::path::Path;
use std::sync::Arc;

/// Accepted medians of the peaks of influence functions, nm per nm of command: of commands in
/// mirror surface (2) and between samples (a half), and several times these. The interaction matrix
/// is measured with strokes that suit a peak of 1.
const PEAKS: std::ops::RangeInclusive<f64> = 0.1..=10.0;

impl Telescope {
    /// The square grid of actuators of the scene's mirror.
    ///
    /// # Errors
    /// Those of [`Mirror::new`].
    pub fn mirror(scene: &System) -> Result<Mirror> {
        Mirror::new(scene.mirror.actuators_across, scene.mirror.pitch_m, scene.mirror.coupling)
    }

    /// Influence functions of the scene's mirror that overlap this pupil; where a file has measured
    /// functions, those of the file.
    ///
    /// # Errors
    /// Those of [`Telescope::mirror`], [`Mirror::near`], [`Telescope::mapped_actuators`] and
    /// [`Telescope::measured_influence`].
    pub fn influence(&self, scene: &System) -> Result<InfluenceFunctions> {
        let mirror = Self::mirror(scene)?;
        let near = mirror.near(&self.pupil, Mirror::DEFAULT_MARGIN_PITCHES)?;
        let Some((path, measured)) = self.read_influence(scene)? else { return Ok(near) };
        let Some(count) = measured.count() else { return near.measured(measured) };
        // The file has the actuators in use, which the wavefront sensor decides where there is no
        // map of them.
        let chosen = match Self::mapped_actuators(scene)? {
            Some(mapped) => Ok(mapped),
            None if count == near.len() => Ok(near),
            None => mirror.nearest(&measured.peaks_m()).map_err(|_| {
                Error::Value(format!(
                    "{count} influence functions were given, where {} actuators are near the pupil, and the peaks do not tell which: a map \
                     of the actuators in use (mirror.actuator_file) is needed",
                    near.len()
                ))
            }),
        };
        chosen.and_then(|chosen| chosen.measured(measured)).map_err(|error| Error::file(&path, error))
    }

    /// Actuators of the scene's map `mirror.actuator_file`, or those whose places a file of AOT
    /// has; `None` where it names none.
    ///
    /// # Errors
    /// [`Error::File`] for a map that cannot be read; those of [`Telescope::mirror`].
    pub fn mapped_actuators(scene: &System) -> Result<Option<InfluenceFunctions>> {
        let Some(file) = &scene.mirror.actuator_file else { return Ok(None) };
        let path = scene.resolve(file);
        let mirror = Self::mirror(scene)?;
        let found = match actuators_of_aot(&path)? {
            Some(places_m) => mirror.nearest(&places_m),
            None => mirror.at(valid_map::read(&path, mirror.actuators_across())?),
        };
        found.map(Some).map_err(|error| Error::file(&path, error))
    }

    /// The `actuators` in use with the functions of the scene's file; as they are where it names
    /// none.
    ///
    /// # Errors
    /// [`Error::File`] for a file that cannot be read, or whose functions are not finite, 0
    /// everywhere, of another unit than a length, far from 1 relative to the command, narrower than
    /// the pupil, or of other actuators.
    pub fn measured_influence(&self, scene: &System, actuators: InfluenceFunctions) -> Result<InfluenceFunctions> {
        match self.read_influence(scene)? {
            Some((path, measured)) => actuators.measured(measured).map_err(|error| Error::file(&path, error)),
            None => Ok(actuators),
        }
    }

    /// The functions of the scene's file, and its path; `None` where it names none.
    fn read_influence(&self, scene: &System) -> Result<Option<(std::path::PathBuf, Arc<MeasuredInfluence>)>> {
        let Some(file) = &scene.mirror.influence_file else { return Ok(None) };
        let path = scene.resolve(file);
        let command_nm = scene.control.as_ref().map_or(1.0, |control| control.matrix_command_nm);
        let measured = self.read(&path, command_nm)?;
        Ok(Some((path, Arc::new(measured))))
    }

    fn read(&self, path: &Path, command_nm: f64) -> Result<MeasuredInfluence> {
        let mut file = FitsReader::open(path)?;
        let scale = unit_nm(&mut file, None)?.map_or(1.0, |nm| nm / command_nm);
        let values: ArrayD<f64> = file.map_or_cube()? * scale;
        let columns = values.shape().last().copied().unwrap_or(0);
        let width_m = width_m(&mut file, columns)?;
        let internal = |error: ndarray::ShapeError| Error::Internal(error.to_string());
        let measured = if values.ndim() == 3 {
            let width_m = width_m.unwrap_or(self.pupil.grid.width_m());
            check_width(width_m, &self.pupil).map_err(|error| Error::file(path, error))?;
            MeasuredInfluence::of_each(values.into_dimensionality::<Ix3>().map_err(internal)?.view(), width_m)
        } else {
            let sentence = "a single influence function needs the distance of its samples: a card PUPLSCAL, m";
            let width_m = width_m.ok_or_else(|| Error::file(path, sentence))?;
            let values = values.into_dimensionality::<Ix2>().map_err(internal)?;
            MeasuredInfluence::common(values.view(), width_m / columns as f64)
        };
        let measured = measured.map_err(|error| Error::file(path, error))?;
        let peak = measured.median_peak();
        if !PEAKS.contains(&peak) {
            let sentence = format_args!(
                "its influence functions have peaks of {peak:.3} nm per nm of command (median), where {} to {} are accepted: functions \
                 relative to the command, or with BUNIT = 'nm' the wavefront of a command of 1, which is control.matrix_command_nm at the \
                 actuator",
                PEAKS.start(),
                PEAKS.end()
            );
            return Err(Error::file(path, sentence));
        }
        Ok(measured)
    }
}

/// Places (x, y) of the actuators of the mirror in a file of AOT, m; `None` for another file.
fn actuators_of_aot(path: &Path) -> Result<Option<Vec<[f64; 2]>>> {
    if !io::is_fits(path)? {
        return Ok(None);
    }
    let mut file = FitsReader::open(path)?;
    if !aot::is_aot(&file) {
        return Ok(None);
    }
    let places_m = aot::system(&mut file)?.mirror.map_or_else(Vec::new, |mirror| mirror.actuators_m);
    if places_m.is_empty() {
        let sentence = "it is a file of AOT without the places of one mirror's actuators (ACTUATORS_X, ACTUATORS_Y)";
        return Err(Error::file(path, sentence));
    }
    Ok(Some(places_m.into_iter().map(|(x_m, y_m)| [x_m, y_m]).collect()))
}

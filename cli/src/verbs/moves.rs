//! Corrections as a picture: what would move.

use cophase::pipeline::{Commands, Corrections, Estimate};
use cophase::{Result, ao};
use cophase_view::plot::{CaptionedMap, MapScale, MapsPicture};
use cophase_view::terminal::counted;
use ndarray::{Array1, Array2};
use std::path::Path;

/// The picture of the corrections of `estimate`, which is of the images in the file `name`: the
/// pistons to add, with the names of their channels, and the surface that the mirror would add.
pub fn picture(name: &Path, estimate: &Estimate, corrections: &Corrections) -> Result<MapsPicture> {
    let mut maps = Vec::new();
    if !corrections.pistons_nm.is_empty() {
        maps.push(segments(estimate, corrections));
    }
    if !corrections.actuators_nm.is_empty() {
        maps.push(mirror(estimate, corrections)?);
    }
    let name = name.file_name().unwrap_or(name.as_os_str()).to_string_lossy().into_owned();
    Ok(MapsPicture { title: format!("What the corrections of {name} would move"), columns: maps.len().max(1), maps })
}

/// How many of `channels` move, and the largest command.
fn figures(commands: &Commands) -> String {
    let moving = commands.channels.iter().filter(|channel| channel.value != 0.0).count();
    let largest = commands.channels.iter().max_by(|a, b| a.value.abs().total_cmp(&b.value.abs()));
    let largest = largest.map(|one| format!(", at most {:.3} {} ({})", one.value.abs(), commands.unit, one.name));
    let limited = commands.channels.iter().filter(|channel| channel.is_limited).count();
    let limited = if limited > 0 { format!(", {limited} at the limit") } else { String::new() };
    format!("{moving} of {}{}{limited}", counted(commands.channels.len(), "channel"), largest.unwrap_or_default())
}

/// As [`figures`] of increments in nm.
fn figures_nm(noun: &str, additions_nm: &[f64]) -> String {
    let moving = additions_nm.iter().filter(|nm| **nm != 0.0).count();
    let largest_nm = additions_nm.iter().fold(0.0, |largest: f64, nm| largest.max(nm.abs()));
    format!("{moving} of {}, at most {largest_nm:.0} nm", counted(additions_nm.len(), noun))
}

/// The piston that each segment would get.
fn segments(estimate: &Estimate, corrections: &Corrections) -> CaptionedMap {
    let (pupil, pistons_nm) = (&estimate.pupil, &corrections.pistons_nm);
    let values = pupil.owner.mapv(|owner| usize::try_from(owner).map_or(f64::NAN, |owner| pistons_nm[owner]));
    let figures = match &corrections.segment_commands {
        Some(commands) => figures(commands),
        None => figures_nm("segment", pistons_nm),
    };
    // One channel a segment has its name; several do not fit.
    let channels = corrections.segment_commands.iter().flat_map(|commands| &commands.channels);
    let names: Vec<(usize, &str)> = channels.map(|channel| (channel.number, channel.name.as_str())).collect();
    let own = names.len() == pistons_nm.len();
    let label = |number: usize| {
        let name = names.iter().find(|(of, _)| own && *of == number).map(|(_, name)| (*name).to_owned());
        name.unwrap_or_else(|| number.to_string())
    };
    let places = corrections.places.iter().map(|place| ((place.x_m, place.y_m), label(place.number)));
    CaptionedMap {
        caption: format!("Pistons to add: {figures}"),
        values,
        unit: "nm".into(),
        width_m: Some(pupil.grid.width_m()),
        scale: MapScale::Diverging,
        labels: places.collect(),
    }
}

/// The surface that the mirror would add, which is subtracted from the wavefront.
fn mirror(estimate: &Estimate, corrections: &Corrections) -> Result<CaptionedMap> {
    let pupil = &estimate.pupil;
    let (grid, n) = (pupil.grid, pupil.grid.samples());
    let telescope = cophase::telescope::Telescope::new(&estimate.scene)?;
    let coordinate_m = |at: usize| (grid.coordinate_m(at % n), grid.coordinate_m(at / n));
    let (xs_m, ys_m): (Vec<f64>, Vec<f64>) = (0..n * n).map(coordinate_m).unzip();
    let additions_nm: Array1<f64> = corrections.actuators_nm.iter().map(|(_, nm)| *nm).collect();
    let surface_nm = additions_nm.dot(&ao::actuators_in_use(&estimate.scene, &telescope)?.evaluate(&xs_m, &ys_m)?);
    let figures = match &corrections.actuator_commands {
        Some(commands) => figures(commands),
        None => figures_nm("actuator", additions_nm.as_slice().unwrap_or_default()),
    };
    Ok(CaptionedMap {
        caption: format!("Mirror, subtracted: {figures}"),
        values: Array2::from_shape_fn((n, n), |(y, x)| surface_nm[y * n + x]),
        unit: "nm".into(),
        width_m: Some(grid.width_m()),
        scale: MapScale::Diverging,
        labels: Vec::new(),
    })
}

//! First scene of an adaptive optics system, from a file of AOT: telescope, turbulence, sensor,
//! mirror and loop in the scene's words. Maps and matrices stay in the file, which the scene names
//! with the HDU in brackets.

use super::scene_text::{Lines, UNKNOWN, counted, float};
use crate::hexagons::HexagonLayout;
use crate::io::FitsReader;
use crate::io::aot::{self, AotControl, AotImage, AotMirror, AotSensor, AotSystem, AotTelescope, AotTurbulence};
use crate::scene::{MAS_PER_RADIAN, SensorDetector};
use crate::{Error, Result};

/// Sections of a first scene, and the side of the grid of its pupil, m.
pub(super) struct AotSections {
    pub(super) telescope: String,
    pub(super) grid_m: f64,
    /// The section `[pupil]`.
    pub(super) pupil: String,
    /// The sections `[modes]`, `[turbulence]`, `[wavefront_sensor]`, `[mirror]` and `[control]`, as
    /// far as the file has them.
    pub(super) others: String,
}

/// Largest number of Karhunen-Loève modes of the NCPA that a first scene asks for: that of the
/// presets.
const NCPA_MODES: usize = 66;

/// The sections that `file` gives; `name` is its name in the scene.
///
/// # Errors
/// Those of [`aot::system`]; [`Error::File`] for a pupil without any extent.
pub(super) fn sections(file: &mut FitsReader, name: &str) -> Result<AotSections> {
    let system = aot::system(file)?;
    let mut grid = system.mirror.as_ref().and_then(|mirror| ActuatorGrid::of(&mirror.actuators_m));
    let (grid_m, whence) = grid_m(file, &system, grid.as_mut())?;
    let others = [
        modes(&system),
        system.turbulence.as_ref().map_or_else(String::new, turbulence),
        system.sensor.as_ref().map_or_else(String::new, |sensor| self::sensor(sensor, name)),
        system.mirror.as_ref().map_or_else(String::new, |mirror| self::mirror(mirror, grid.as_ref(), name)),
        system.control.as_ref().map_or_else(String::new, |control| self::control(control, &system, name)),
    ];
    Ok(AotSections {
        telescope: system.telescope.uid.clone(),
        grid_m,
        pupil: pupil(&system.telescope, (grid_m, &whence), name),
        others: others.concat(),
    })
}

/// The name of an image of the file, as a text of TOML.
fn in_file(name: &str, image: &AotImage) -> String {
    format!("{:?}", format!("{name}[{}]", image.hdu))
}

/// Square grid of actuators about the axis.
struct ActuatorGrid {
    across: usize,
    pitch_m: f64,
    /// Whether the actuators are listed row by row from the smallest y.
    is_row_by_row: bool,
}

impl ActuatorGrid {
    /// That of actuators at `places_m`, if they lie on one to a twentieth of a pitch.
    fn of(places_m: &[(f64, f64)]) -> Option<Self> {
        let mut x_m: Vec<f64> = places_m.iter().map(|place| place.0).collect();
        x_m.sort_by(f64::total_cmp);
        let span_m = x_m.last()? - x_m.first()?;
        // Steps between columns; those within a column are rounding.
        let steps = x_m.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 1e-3 * span_m);
        let least_m = steps.fold(f64::INFINITY, f64::min);
        let columns = (span_m / least_m).round();
        let pitch_m = span_m / columns;
        let farthest_m = places_m.iter().map(|(x, y)| x.abs().max(y.abs())).fold(0.0, f64::max);
        let across = (2.0 * farthest_m / pitch_m).round() + 1.0;
        if !(pitch_m > 0.0 && (2.0..=257.0).contains(&across)) {
            return None;
        }
        let line = |c_m: f64| c_m / pitch_m + (across - 1.0) / 2.0;
        let is_on_it = |c_m: f64| (line(c_m) - line(c_m).round()).abs() < 0.05;
        let cells: Vec<f64> = places_m.iter().map(|(x, y)| line(*y).round() * across + line(*x).round()).collect();
        places_m.iter().all(|(x, y)| is_on_it(*x) && is_on_it(*y)).then_some(Self {
            across: across as usize,
            pitch_m,
            is_row_by_row: cells.windows(2).all(|pair| pair[0] < pair[1]),
        })
    }
}

/// Largest deviation of the side of the pupil's grid from that of the lenslets between actuators,
/// relative: an extent is known to a sample, and a circle around the pupil is not always that of
/// its corners.
const SIDE_TOLERANCE: f64 = 0.1;

/// Side of the grid of pupil and lenslets, m, and where it is from. Where actuators lie on the
/// corners of lenslets (Fried's geometry), the grid of actuators is widened to that of all
/// lenslets.
fn grid_m(file: &mut FitsReader, system: &AotSystem, grid: Option<&mut ActuatorGrid>) -> Result<(f64, String)> {
    let of_pupil = of_pupil(file, &system.telescope)?;
    let lenslets = system.sensor.as_ref().map_or(0, |sensor| sensor.across);
    if let Some(grid) =
        grid.filter(|grid| lenslets >= grid.across - 1 && (lenslets + 1 - grid.across).is_multiple_of(2))
    {
        let side_m = lenslets as f64 * grid.pitch_m;
        if of_pupil.as_ref().is_none_or(|(known_m, _)| (known_m / side_m - 1.0).abs() < SIDE_TOLERANCE) {
            grid.across = lenslets + 1;
            return Ok((side_m, format!("{lenslets} lenslets between actuators")));
        }
    }
    let unknown = || {
        let comment = format!("{UNKNOWN}: side of the grid of the pupil; lenslets_across times the side of a lenslet");
        (if system.telescope.enclosing_m > 0.0 { system.telescope.enclosing_m } else { 10.0 }, comment)
    };
    Ok(of_pupil.unwrap_or_else(unknown))
}

/// Side of the grid of the pupil's mask by the circle around the pupil, m.
fn of_pupil(file: &mut FitsReader, telescope: &AotTelescope) -> Result<Option<(f64, String)>> {
    let Some(mask) = telescope.pupil.as_ref().filter(|_| telescope.enclosing_m > 0.0) else { return Ok(None) };
    let map = file.map(Some(&mask.hdu))?;
    let (rows, columns) = map.dim();
    // To the outer edge of a sample.
    let radius = |((y, x), _): ((usize, usize), &f64)| {
        let from = |at: usize, side: usize| (at as f64 - (side - 1) as f64 / 2.0).abs() + 0.5;
        from(y, rows).hypot(from(x, columns))
    };
    let largest = map.indexed_iter().filter(|(_, value)| **value > 0.0).map(radius).fold(0.0, f64::max);
    if largest == 0.0 {
        return Err(Error::file(file.path(), format_args!("its pupil {} is 0 everywhere", mask.hdu)));
    }
    let side_m = telescope.enclosing_m * columns as f64 / (2.0 * largest);
    Ok(Some((side_m, format!("{} m over the extent of {}", telescope.enclosing_m, mask.hdu))))
}

fn pupil(telescope: &AotTelescope, (grid_m, whence): (f64, &str), name: &str) -> String {
    let mut lines = Lines::of_section("pupil");
    let found = HexagonLayout::of_centres(&telescope.segments_m).filter(|_| telescope.segment_size_m > 0.0);
    let is_round = telescope.segment_type == "Circle";
    match (found, &telescope.pupil) {
        (Some((layout, places)), mask) => {
            let side_m = telescope.segment_size_m / 2.0;
            let gap_m = (layout.pitch_m - if is_round { 2.0 } else { 3f64.sqrt() } * side_m).max(0.0);
            let aperture = if is_round { "\"round\"" } else { "\"hexagonal\"" };
            lines.add("aperture", aperture, &format!("{} of {}", counted(places.len(), "segment"), telescope.uid));
            lines.add("rings", layout.rings, "");
            lines.add("removed_rings", layout.removed_rings, "");
            lines.add("central_segment", layout.has_centre, "");
            if let Some(radius_m) = layout.outer_radius_m {
                lines.add("outer_radius_m", float(radius_m), "");
            }
            lines.add("rotation_deg", float(layout.rotation_deg), "");
            lines.add("segment_side_m", float(side_m), "half of SEGMENT_SIZE");
            lines.add("segment_gap_m", float(gap_m), "what is left between neighbours");
            if places.iter().enumerate().any(|(at, place)| at != *place) {
                lines.add("segment_labels", format!("{places:?}"), "numbers of the file, from 0");
            }
            let obscuration_m = if telescope.obstruction_m > 0.0 { telescope.obstruction_m } else { 0.0 };
            lines.add("central_obscuration_m", float(obscuration_m), "OBSTRUCTION_D");
            let shown = mask.as_ref().map_or_else(String::new, |mask| format!("; {name}[{}] shows it", mask.hdu));
            lines.add("spider_width_m", "0.0", &format!("{UNKNOWN}: AOT has no spider{shown}"));
        }
        (None, Some(mask)) => {
            lines.add("file", in_file(name, mask), "without segments");
        }
        (None, None) => {
            lines.add("aperture", "\"keck\"", &format!("{UNKNOWN}: the file has neither segments nor a pupil"));
        }
    }
    lines.add("grid_m", float(grid_m), whence);
    lines.text
}

fn modes(system: &AotSystem) -> String {
    let mut lines = Lines::of_section("modes");
    let segments = system.telescope.segments_m.len();
    lines.add("segment", if segments > 1 { "\"piston\"" } else { "\"none\"" }, "");
    let actuators = system.mirror.as_ref().map_or(0, |mirror| mirror.actuators_m.len());
    if actuators > 1 {
        lines.add("ncpa", "\"kl\"", "of the mirror");
        lines.add("ncpa_count", NCPA_MODES.min(actuators / 2), "");
    } else {
        lines.add("ncpa", "\"zernike\"", "");
    }
    lines.text
}

fn turbulence(turbulence: &AotTurbulence) -> String {
    let mut lines = Lines::of_section("turbulence");
    if turbulence.r0_m > 0.0 {
        // Fried's parameter grows with the 6/5th power of the wavelength.
        let known = turbulence.wavelength_m > 0.0;
        let factor = if known { (500e-9 / turbulence.wavelength_m).powf(1.2) } else { 1.0 };
        let comment =
            if known { "at 500 nm".into() } else { format!("{UNKNOWN}: the file does not say at which wavelength") };
        lines.add("r0_m", float(turbulence.r0_m * factor), &comment);
    } else {
        lines.add("r0_m", "0.16", &format!("{UNKNOWN}: at 500 nm"));
    }
    let known: Vec<f64> = turbulence.outer_scales_m.iter().copied().filter(|scale_m| *scale_m > 0.0).collect();
    match known.as_slice() {
        [] => lines.add("outer_scale_m", "50.0", UNKNOWN),
        known => lines.add("outer_scale_m", float(known.iter().sum::<f64>() / known.len() as f64), "mean of LAYERS_LO"),
    }
    let columns = [&turbulence.heights_m, &turbulence.wind_m_s, &turbulence.wind_azimuth_deg];
    let sum: f64 = turbulence.weights.iter().sum();
    if sum > 0.0 && columns.iter().all(|column| !column.is_empty() && column.iter().all(|value| value.is_finite())) {
        let list = |values: &[f64]| format!("[{}]", values.iter().map(|v| float(*v)).collect::<Vec<_>>().join(", "));
        lines.add("fractions", list(&turbulence.weights.iter().map(|w| w / sum).collect::<Vec<_>>()), "");
        lines.add("heights_m", list(&turbulence.heights_m), "");
        lines.add("wind_m_s", list(&turbulence.wind_m_s), "");
        let radians = |deg: &f64| (270.0 - deg).rem_euclid(360.0).to_radians() - std::f64::consts::PI;
        let radians: Vec<f64> = turbulence.wind_azimuth_deg.iter().map(radians).collect();
        lines.add("wind_dir_rad", list(&radians), "with North along the pupil's +y and East along its +x");
    }
    lines.text
}

fn sensor(sensor: &AotSensor, name: &str) -> String {
    let mut lines = Lines::of_section("wavefront_sensor");
    lines.add("kind", "\"shack-hartmann\"", "");
    if sensor.across > 0 {
        lines.add("lenslets_across", sensor.across, "side of the mask");
    } else {
        lines.add("lenslets_across", 20, UNKNOWN);
    }
    if let Some(mask) = &sensor.mask {
        lines.add("subaperture_file", in_file(name, mask), "");
    }
    let words = [SensorDetector::QuadCell, SensorDetector::Pixels, SensorDetector::Geometric].map(|kind| kind.word());
    match words.into_iter().find(|word| *word == sensor.centroiding) {
        Some(word) => lines.add("detector", format!("\"{word}\""), "CENTROIDING_ALGORITHM"),
        None => lines.add(
            "detector",
            "\"quad-cell\"",
            &format!("{UNKNOWN}: how slopes are calculated; the file says '{}'", sensor.centroiding),
        ),
    }
    if sensor.wavelength_m > 0.0 {
        lines.add("wavelength_nm", float(sensor.wavelength_m * 1e9), "");
    }
    if sensor.measurements.as_ref().is_some_and(|slopes| slopes.unit.is_empty()) {
        lines.add("slope_unit_mas", "1.0", &format!("{UNKNOWN}: mas that a slope of 1 means; the file has no unit"));
    }
    lines.text
}

fn mirror(mirror: &AotMirror, grid: Option<&ActuatorGrid>, name: &str) -> String {
    let mut lines = Lines::of_section("mirror");
    match grid {
        Some(grid) => {
            lines.add("actuators_across", grid.across, "from ACTUATORS_X, ACTUATORS_Y");
            lines.add("pitch_m", float(grid.pitch_m), "");
            if grid.is_row_by_row {
                lines.add("actuator_file", format!("{name:?}"), "");
            } else {
                lines.note(&format!(
                    "{UNKNOWN}: actuators are not listed row by row from the smallest y, as matrices need it"
                ));
            }
        }
        None => {
            lines.add(
                "actuators_across",
                21,
                &format!("{UNKNOWN}: the file has no square grid of actuators about the axis"),
            );
            lines.add("pitch_m", "0.5625", UNKNOWN);
        }
    }
    match &mirror.influence {
        Some(influence) => lines.add("influence_file", in_file(name, influence), ""),
        None => lines.add("coupling", "0.1458", &format!("{UNKNOWN}: influence of an actuator at its neighbour")),
    }
    if mirror.stroke_m > 0.0 {
        lines.add("stroke_limit_nm", float(mirror.stroke_m * 1e9), &format!("STROKE; {UNKNOWN} if that is surface"));
    }
    lines.text
}

fn control(control: &AotControl, system: &AotSystem, name: &str) -> String {
    let mut lines = Lines::of_section("control");
    match control.integrator {
        Some((gain, leak)) => {
            lines.add("gain", float(gain), "TIME_FILTER_NUM");
            lines.add("leak", float(leak), "TIME_FILTER_DEN");
        }
        None => lines.add("gain", "0.3", &format!("{UNKNOWN}: the file has no filter of an integrator for all modes")),
    }
    match control.frame_rate_hz {
        rate_hz if rate_hz > 0.0 => lines.add("frame_rate_hz", float(rate_hz), "FRAMERATE"),
        _ => lines.add("frame_rate_hz", "1000.0", UNKNOWN),
    }
    match control.delay_frames {
        frames if frames >= 1.0 => lines.add("lag_frames", float(frames), "DELAY"),
        _ => lines.add("lag_frames", "1.0", &format!("{UNKNOWN}: frames from a measurement to its correction")),
    }
    matrices(&mut lines, control, system, name);
    lines.text
}

/// The keys of the matrices, where their rows and columns are in the order of the model's.
fn matrices(lines: &mut Lines, control: &AotControl, system: &AotSystem, name: &str) {
    let Some(sensor) = &system.sensor else { return };
    if control.interaction.is_none() && control.command.is_none() {
        return;
    }
    if !sensor.is_row_by_row {
        lines.note(&format!(
            "{UNKNOWN}: subapertures are not numbered row by row; matrices in that order are needed as interaction_file and command_matrix_file"
        ));
        return;
    }
    let keys = [("interaction_file", &control.interaction), ("command_matrix_file", &control.command)];
    for (key, matrix) in keys.into_iter().filter_map(|(key, matrix)| Some((key, matrix.as_ref()?))) {
        lines.add(key, in_file(name, matrix), "");
    }
    match matrix_command_nm(control, sensor) {
        Some(nm) => lines.add(
            "matrix_command_nm",
            float(nm),
            "units of the matrices; commands are taken for wavefront, not surface",
        ),
        None => lines.add(
            "matrix_command_nm",
            "1.0",
            &format!(
                "{UNKNOWN}: wavefront of a command of 1, over mas of a slope of 1; the matrices have no known unit"
            ),
        ),
    }
}

/// `control.matrix_command_nm` for the units of the matrices: nm that a command of 1 means, over
/// mas that a slope of 1 means, because slopes are read in mas. `None` for units that are not
/// known.
fn matrix_command_nm(control: &AotControl, sensor: &AotSensor) -> Option<f64> {
    let of = |matrix: &Option<AotImage>| {
        let unit = matrix.as_ref()?.unit.clone();
        unit.split_once('/').map(|(a, b)| (a.trim().to_owned(), b.trim().to_owned()))
    };
    let (slope, command) = of(&control.interaction).or_else(|| of(&control.command).map(|(a, b)| (b, a)))?;
    let command_nm = match command.as_str() {
        "nm" => 1.0,
        "um" => 1e3,
        "m" => 1e9,
        _ => return None,
    };
    let slope_mas = match slope.as_str() {
        "mas" => 1.0,
        "arcsec" => 1e3,
        "rad" => MAS_PER_RADIAN,
        "pix" | "pixel" if sensor.pixel_scale_rad > 0.0 => sensor.pixel_scale_rad * MAS_PER_RADIAN,
        _ => return None,
    };
    Some(command_nm / slope_mas)
}

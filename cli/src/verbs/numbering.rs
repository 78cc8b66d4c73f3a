//! Segments, actuators and subapertures of a scene as a picture.

use cophase::ao::{self, Lenslets};
use cophase::modes::InfluenceFunctions;
use cophase::pupil::{Grid, Pupil};
use cophase::scene::{Aperture, Scene, SensorScene};
use cophase::telescope::Telescope;
use cophase::{Error, Result, machine};
use cophase_view::plot::{Lattice, NumberingPicture};
use cophase_view::terminal::{Terminal, counted};
use ndarray::Array2;

/// Samples along a side on which hexagons are drawn: about the pixels of the picture.
const SAMPLES: usize = 1200;

/// The picture of `scene`. What cannot be drawn is left out with a warning.
pub fn picture(scene: &Scene, terminal: &Terminal) -> Result<NumberingPicture> {
    let telescope = Telescope::new(scene)?;
    let samples = if is_from_file(scene) { telescope.truth_samples() } else { SAMPLES };
    let width_m = telescope.pupil.grid.width_m();
    let pupil = telescope.pupil_on(Grid::new(samples, width_m)?)?;
    let lenslets = lenslets(scene, &telescope, terminal)?;
    let actuators = if scene.has_mirror() { Some(actuators(scene, &telescope, lenslets.as_ref())?) } else { None };
    let count = pupil.segments.len();
    let segments = counted(count, "segment");
    let title = match scene.name() {
        "/dev/stdin" => segments.clone(),
        name => format!("{segments} of {name}"),
    };
    Ok(NumberingPicture {
        title,
        notes: notes(scene, actuators.is_some() || lenslets.is_some()),
        segments: match (count, &scene.pupil.segment_labels) {
            (_, Some(_)) => segments,
            (1, None) => format!("{segments}, number 0"),
            _ => format!("{segments}, 0 to {}", count - 1),
        },
        numbers: match &scene.pupil.segment_labels {
            Some(labels) => labels.iter().map(str::to_owned).collect(),
            None => (0..count).map(|number| number.to_string()).collect(),
        },
        numbers_m: number_places(scene, &pupil),
        amplitude: pupil.amplitude,
        owner: pupil.owner,
        width_m,
        actuators: actuators.map(|influence| Lattice {
            name: counted(influence.len(), "actuator"),
            centres_m: influence.positions_m(),
            pitch_m: influence.mirror().pitch_m(),
        }),
        subapertures: lenslets.map(|lenslets| Lattice {
            name: format!("{} in use", counted(lenslets.subapertures.len(), "subaperture")),
            centres_m: lenslets.subapertures.iter().map(|&place| centre_m(&lenslets, place)).collect(),
            pitch_m: lenslets.pitch_m,
        }),
    })
}

/// What `picture` shows, in a line.
pub fn summary(picture: &NumberingPicture) -> String {
    let lattices = [&picture.actuators, &picture.subapertures].into_iter().flatten();
    let drawn: Vec<&str> =
        std::iter::once(picture.segments.as_str()).chain(lattices.map(|lattice| lattice.name.as_str())).collect();
    drawn.join("; ")
}

fn is_from_file(scene: &Scene) -> bool {
    matches!(scene.pupil.aperture, Aperture::File(_))
}

/// The lenslets of the scene's wavefront sensor, if it has one, as the AO loop has them.
fn lenslets(scene: &Scene, telescope: &Telescope, terminal: &Terminal) -> Result<Option<Lenslets>> {
    /// An amplitude in double precision, and a segment.
    const BYTES_PER_SAMPLE: u64 = 8 + 4;
    let Some(sensor) = &scene.wavefront_sensor else { return Ok(None) };
    let samples = sensor.lenslets_across * sensor.samples_per_lenslet;
    let what = format!("{}: a pupil of {samples}x{samples} samples", scene.name());
    let bytes = (samples * samples) as u64 * BYTES_PER_SAMPLE;
    machine::check_memory(what, bytes, "lower wavefront_sensor.samples_per_lenslet")?;
    match telescope.pupil_on(Grid::new(samples, telescope.pupil.grid.width_m())?) {
        Ok(pupil) => Lenslets::new(sensor, &pupil, scene.directory()).map(Some),
        Err(Error::Value(reason)) => {
            terminal.warn(&format!("{}: subapertures are not drawn: {reason}", scene.name()));
            Ok(None)
        }
        Err(other) => Err(other),
    }
}

/// Centre (x, y) of the lenslet `row·across + column`, m.
fn centre_m(lenslets: &Lenslets, place: usize) -> (f64, f64) {
    let coordinate_m = |i: usize| (i as f64 - (lenslets.across as f64 - 1.0) / 2.0) * lenslets.pitch_m;
    (coordinate_m(place % lenslets.across), coordinate_m(place / lenslets.across))
}

/// Actuators in use, as in the tables ACTUATORS; those near the pupil where the subapertures cannot
/// be drawn.
fn actuators(scene: &Scene, telescope: &Telescope, lenslets: Option<&Lenslets>) -> Result<InfluenceFunctions> {
    let is_known = lenslets.is_some() || scene.wavefront_sensor.is_none() || scene.mirror.actuator_file.is_some();
    if is_known { ao::actuators_in_use(scene, telescope) } else { telescope.influence(scene) }
}

/// Where the numbers stand, m: at the centre of each segment, or within it where a segment from a
/// file does not contain its centre, as a ring.
fn number_places(scene: &Scene, pupil: &Pupil) -> Vec<(f64, f64)> {
    let grid = &pupil.grid;
    let last = grid.samples() as f64 - 1.0;
    let index = |c_m: f64| (c_m / grid.pitch_m() + last / 2.0).round().clamp(0.0, last) as usize;
    let place = |(number, segment): (usize, &cophase::pupil::Segment)| {
        let centre = (segment.x_m, segment.y_m);
        let is_inside = pupil.owner[[index(centre.1), index(centre.0)]] == number as i32;
        if is_from_file(scene) && !is_inside { innermost_place(pupil, number) } else { centre }
    };
    pupil.segments.iter().enumerate().map(place).collect()
}

/// The place in a segment that is farthest from its edge, counted in samples along rows and
/// columns, m.
fn innermost_place(pupil: &Pupil, number: usize) -> (f64, f64) {
    let (n, grid) = (pupil.grid.samples(), &pupil.grid);
    let is_own = |y: usize, x: usize| pupil.owner[[y, x]] == number as i32;
    // Distance to the nearest sample of another segment: over the neighbours below and on the left,
    // then over the others.
    let mut depth = Array2::<u32>::zeros((n, n));
    for (y, x) in (0..n).flat_map(|y| (0..n).map(move |x| (y, x))).filter(|&(y, x)| is_own(y, x)) {
        let below = if y > 0 { depth[[y - 1, x]] } else { 0 };
        let left = if x > 0 { depth[[y, x - 1]] } else { 0 };
        depth[[y, x]] = 1 + below.min(left);
    }
    let (mut deepest, mut place) = (0, (0, 0));
    for (y, x) in (0..n).rev().flat_map(|y| (0..n).rev().map(move |x| (y, x))).filter(|&(y, x)| is_own(y, x)) {
        let above = if y + 1 < n { depth[[y + 1, x]] } else { 0 };
        let right = if x + 1 < n { depth[[y, x + 1]] } else { 0 };
        depth[[y, x]] = depth[[y, x]].min(1 + above.min(right));
        if depth[[y, x]] > deepest {
            (deepest, place) = (depth[[y, x]], (y, x));
        }
    }
    (grid.coordinate_m(place.1), grid.coordinate_m(place.0))
}

/// What a reader should know before a number is sent to a mirror.
fn notes(scene: &Scene, has_lattice: bool) -> Vec<String> {
    let counted = match is_from_file(scene) {
        _ if scene.pupil.segment_labels.is_some() => {
            "Segments have the labels of pupil.segment_labels, which are the column LABEL of the table SEGMENTS."
        }
        true => {
            "Segments are counted from 0, by the ascending labels of the pupil's file (column LABEL of the table SEGMENTS)."
        }
        false => "Segments are counted from 0, ring by ring from the innermost, counter-clockwise from +x.",
    };
    let table = "Numbers and coordinates are those of the table SEGMENTS of an estimate, and of its maps: x to the right \
                 (columns), y up (rows).";
    let mut notes = vec![counted.to_string(), table.to_string()];
    if has_lattice {
        let order = "Actuators and subapertures in use are counted row by row from the smallest y, along +x.";
        notes.push(order.to_string());
    }
    let flips = [("image.flip_x", scene.image.flip_x), ("image.flip_y", scene.image.flip_y)];
    for (key, _) in flips.into_iter().filter(|(_, is_set)| *is_set) {
        notes.push(format!(
            "{key} is set: images are flipped when they are read. The pupil is drawn as the telescope has it."
        ));
    }
    let rotation_deg = scene.pupil.rotation_deg;
    if rotation_deg != 0.0 {
        notes.push(format!(
            "pupil.rotation_deg = {rotation_deg}: segments, numbers and spider are turned counter-clockwise, actuators and \
             subapertures are not."
        ));
    }
    let is_moved = |sensor: &SensorScene| {
        let is_shifted = sensor.shift_subapertures.iter().any(|shift| *shift != 0.0);
        is_shifted || sensor.rotation_deg != 0.0 || sensor.magnification != 1.0
    };
    if scene.wavefront_sensor.as_ref().is_some_and(is_moved) {
        notes.push(
            "lenslets are shifted, rotated or magnified: subapertures are drawn where they were calibrated.".into(),
        );
    }
    notes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_number_of_a_ring_is_in_the_middle_of_its_width() {
        let grid = Grid::new(80, 8.0).unwrap();
        let radius_m = |y: usize, x: usize| grid.coordinate_m(x).hypot(grid.coordinate_m(y));
        let label = |(y, x)| match radius_m(y, x) {
            r if r < 1.0 => 0,
            r if r > 2.0 && r < 4.0 => 1,
            _ => -1,
        };
        let labels = Array2::from_shape_fn((80, 80), label);
        let amplitude = labels.mapv(|label| if label >= 0 { 1.0 } else { 0.0 });
        let pupil = Pupil::from_maps(grid, amplitude, Some(labels)).unwrap();
        let (x_m, y_m) = innermost_place(&pupil, 1);
        // Half a metre from either edge: half of the width of the ring.
        assert!((2.5..3.5).contains(&x_m.hypot(y_m)), "{x_m} {y_m}");
        let (x_m, y_m) = innermost_place(&pupil, 0);
        assert!(x_m.hypot(y_m) < 0.2, "{x_m} {y_m}");
    }
}

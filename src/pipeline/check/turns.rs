//! Orientations that the pupil's own shape shows, and those that a poke shows.
//!
//! An image in a wrong orientation is that of the pupil in this orientation. Where the pupil equals itself turned or flipped so, the image is
//! explained as well, by a wavefront that is turned or flipped: only a poke determines such an orientation. The conjugate of the field at −u,
//! with the wavefront −W(−u), has the same image: with a pupil of point symmetry and an even diversity the sign of the diversity is as
//! little determined, and its wrong sign asks for a wavefront of the same size, so that no prior helps.

use super::finding::{CheckedQuantity, Finding, Verdict};
use crate::pipeline::control::Control;
use crate::pipeline::images::Images;
use crate::pipeline::orientation::{Poke, check_orientation};
use crate::scene::{Aperture, Scene};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array2, Axis};

/// Part of the pupil's light in which two pupils differ that images tell apart.
const DIFFERENT: f64 = 0.01;

/// A scene whose images are turned or flipped, and how.
pub(super) struct Turn {
    /// Keys and values.
    pub(super) settings: Vec<(String, String)>,
    pub(super) quantity: CheckedQuantity,
    pub(super) name: String,
}

/// Orientations of the images, and signs of the defocus, that the pupil of `scene` distinguishes from the scene's own; the first of equal
/// ones. The second value has the names of those that it does not distinguish.
pub(super) fn turns(scene: &Scene) -> Result<(Vec<Turn>, Vec<String>)> {
    let amplitude = Telescope::new(scene)?.pupil.amplitude;
    let differs = |one: &Array2<f64>, other: &Array2<f64>| {
        let difference = one.iter().zip(other).map(|(a, b)| (a - b).abs()).sum::<f64>();
        difference > DIFFERENT * one.sum()
    };
    let (rows, columns) = scene.image.frame_shape();
    let has_geometry = !matches!(scene.pupil.aperture, Aperture::File(_)) && rows == columns;
    let is_focus = scene.image.diversity_file.is_none();
    let mut seen = vec![amplitude.clone()];
    let (mut turns, mut hidden) = (Vec::new(), Vec::new());
    for quarter in [false, true] {
        for flip in [[false, false], [true, false], [false, true], [true, true]] {
            if (!quarter && flip == [false, false]) || (quarter && !(has_geometry && is_focus)) {
                continue;
            }
            let mut map = amplitude.clone();
            if quarter {
                // Counter-clockwise: (x, y) to (−y, x).
                map = map.reversed_axes();
                map.invert_axis(Axis(1));
            }
            for (axis, _) in [Axis(1), Axis(0)].into_iter().zip(flip).filter(|(_, flip)| *flip) {
                map.invert_axis(axis);
            }
            let name = name(quarter, flip);
            if !is_focus || !seen.iter().all(|other| differs(other, &map)) {
                hidden.push(name);
                continue;
            }
            seen.push(map);
            let mut settings = Vec::new();
            let keys = [("image.flip_x", scene.image.flip_x), ("image.flip_y", scene.image.flip_y)];
            for ((key, now), flip) in keys.into_iter().zip(flip) {
                settings.extend(flip.then(|| (key.to_string(), (!now).to_string())));
            }
            if quarter {
                settings.push(("pupil.rotation_deg".into(), (scene.pupil.rotation_deg + 90.0).to_string()));
            }
            turns.push(Turn { settings, quantity: CheckedQuantity::Orientation, name });
        }
    }
    let mut opposite = amplitude.clone();
    opposite.invert_axis(Axis(0));
    opposite.invert_axis(Axis(1));
    let waves = scene.image.diversity_focus_waves_rms;
    if is_focus && waves != 0.0 && differs(&amplitude, &opposite) {
        let settings = vec![("image.diversity_focus_waves_rms".into(), (-waves).to_string())];
        turns.push(Turn {
            settings,
            quantity: CheckedQuantity::DefocusSign,
            name: "the opposite sign of the defocus".into(),
        });
    }
    Ok((turns, hidden))
}

fn name(quarter: bool, flip: [bool; 2]) -> String {
    let flips = match flip {
        [false, false] => "",
        [true, false] => "a flip left to right",
        [false, true] => "a flip up to down",
        [true, true] => "a turn by 180°",
    };
    match (quarter, flips) {
        (true, "") => "a turn by 90°".into(),
        (true, flips) => format!("{flips} after a turn by 90°"),
        (false, flips) => flips.into(),
    }
}

/// Finding of a poke: images before it, where there are some, and images behind it, which are checked.
pub(super) fn of_poke(
    scene: &Scene,
    (before, after): (Option<&Images>, &Images),
    poke: Poke,
    control: &Control,
) -> Result<[Finding; 2]> {
    let found = match check_orientation(scene, before, after, poke, control) {
        Ok(found) => found,
        Err(Error::Value(sentence)) => {
            return Ok([CheckedQuantity::Orientation, CheckedQuantity::DefocusSign]
                .map(|what| Finding::open(what, sentence.as_str())));
        }
        Err(error) => return Err(error),
    };
    let is_sign = found.settings.iter().any(|(key, _)| key == "image.diversity_focus_waves_rms");
    let mut explanation = format!(
        "the poke shows {} (correlation {:.3}; the next orientation {:.3})",
        found.best.description(),
        found.best.correlation,
        found.runner_up.correlation
    );
    for warning in &found.warnings {
        explanation += &format!("; {warning}");
    }
    let is_wrong = |is_this: bool| is_this && !found.settings.is_empty();
    let one = |quantity: CheckedQuantity, is_this: bool| {
        let verdict = if is_wrong(is_this) { Verdict::Fault } else { Verdict::Agrees };
        let settings = if is_wrong(is_this) { found.settings.clone() } else { Vec::new() };
        // Twice the difference of logarithms of likelihoods, as one of χ², without a parameter that was fitted.
        let gain = 2.0 * (found.best.log_likelihood - found.runner_up.log_likelihood);
        Finding { gain, settings, ..Finding::new(quantity, verdict, explanation.as_str()) }
    };
    Ok([one(CheckedQuantity::Orientation, !is_sign), one(CheckedQuantity::DefocusSign, is_sign)])
}

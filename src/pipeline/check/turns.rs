//! Orientations that the pupil's own shape shows, and those that a poke shows.
//!
//! An image in a wrong orientation is that of the pupil in this orientation. Where the pupil equals
//! itself turned or flipped so, the image is explained as well, by a wavefront that is turned or
//! flipped: only a poke determines such an orientation. The conjugate of the field at −u, with the
//! wavefront −W(−u), has the same image: with a pupil of point symmetry and an even diversity the
//! sign of the diversity is as little determined, and its wrong sign asks for a wavefront of the
//! same size, so that no prior helps.

use super::finding::{CheckedQuantity, FOCUS, Finding, Verdict};
use crate::Result;
use crate::control::Control;
use crate::pipeline::images::Images;
use crate::pipeline::orientation::{Poke, PokeResult, check_orientation};
use crate::scene::{Aperture, Scene, Setting};
use crate::telescope::Telescope;
use ndarray::{Array2, Axis};

/// Part of the pupil's light in which two pupils differ that images distinguish.
const DIFFERENT: f64 = 0.01;
/// Part of the light above which bright images may distinguish two pupils. Two vanes of 3 cm on 8.8
/// m that are 5° from point symmetry are 0.7 % of the light, and leave a reduced χ² of 7.5 at a
/// peak S/N of 190. Differences below it are those of the sampling of the pupil.
const NEARLY_EQUAL: f64 = 1e-3;

/// Keys of the orientation.
const FLIPS: [&str; 2] = ["image.flip_x", "image.flip_y"];
pub(super) const ROTATION: &str = "pupil.rotation_deg";

/// A turn or flip of the images.
pub(super) struct Turn {
    /// Keys and values.
    pub(super) settings: Vec<Setting>,
    /// Whether the opposite sign of the defocus has the same images. The images of a pupil turned
    /// by 180° are those of the opposite sign, so this holds for a turn by 180°, and for a flip
    /// where the pupil equals its mirror image.
    pub(super) is_also_sign: bool,
    /// Whether the pupils differ by more than `DIFFERENT`; by less, bright images alone distinguish
    /// them.
    pub(super) is_plain: bool,
    pub(super) name: String,
}

/// What the shape of a pupil shows.
pub(super) struct Shape {
    /// Turns that it may distinguish from the scene's orientation; the first of equal ones.
    pub(super) turns: Vec<Turn>,
    /// Names of those that it does not distinguish.
    pub(super) hidden: Vec<String>,
    /// Whether it shows the sign of the defocus, where the orientation is known; `None` where
    /// bright images may.
    pub(super) shows_sign: Option<bool>,
}

/// Orientations of the images that the pupil of `scene` shows.
pub(super) fn turns(scene: &Scene) -> Result<Shape> {
    let amplitude = Telescope::new(scene)?.pupil.amplitude;
    let difference = |one: &Array2<f64>, other: &Array2<f64>| {
        one.iter().zip(other).map(|(a, b)| (a - b).abs()).sum::<f64>() / one.sum()
    };
    let (rows, columns) = scene.image.frame_shape();
    let has_geometry = !matches!(scene.pupil.aperture, Aperture::File(_)) && rows == columns;
    let is_focus = scene.image.diversity_file.is_none();
    let mut opposite = amplitude.clone();
    opposite.invert_axis(Axis(0));
    opposite.invert_axis(Axis(1));
    let has_sign = is_focus && scene.image.diversity_focus_waves_rms != 0.0;
    let of_sign = if has_sign { difference(&amplitude, &opposite) } else { 0.0 };
    let shows_sign = (of_sign <= NEARLY_EQUAL || of_sign > DIFFERENT).then_some(of_sign > DIFFERENT);
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
            let nearest = seen.iter().map(|other| difference(other, &map)).fold(f64::INFINITY, f64::min);
            if !is_focus || nearest <= NEARLY_EQUAL {
                hidden.push(name);
                continue;
            }
            let is_plain = nearest > DIFFERENT;
            let is_also_sign = of_sign > NEARLY_EQUAL && difference(&map, &opposite) <= NEARLY_EQUAL;
            seen.push(map);
            let mut settings = Vec::new();
            let keys = FLIPS.into_iter().zip([scene.image.flip_x, scene.image.flip_y]);
            for ((key, now), flip) in keys.zip(flip) {
                settings.extend(flip.then(|| Setting::new(key, !now)));
            }
            if quarter {
                settings.push(Setting::new(ROTATION, scene.pupil.rotation_deg + 90.0));
            }
            turns.push(Turn { settings, is_also_sign, is_plain, name });
        }
    }
    if has_geometry && scene.pupil.rotation_deg != 0.0 {
        let settings = vec![Setting::new(ROTATION, -scene.pupil.rotation_deg)];
        // A pupil that is larger than its grid is no candidate.
        if let Some(map) =
            scene.with_settings(&settings).and_then(|other| Telescope::new(&other)).ok().map(|of| of.pupil.amplitude)
            && seen.iter().all(|other| difference(other, &map) > NEARLY_EQUAL)
        {
            let is_also_sign = of_sign > NEARLY_EQUAL && difference(&map, &opposite) <= NEARLY_EQUAL;
            turns.push(Turn {
                settings,
                is_also_sign,
                is_plain: true,
                name: "the opposite sense of the rotation".into(),
            });
        }
    }
    Ok(Shape { turns, hidden, shows_sign })
}

impl Turn {
    /// Findings of this turn, with which the images are explained.
    pub(super) fn findings(&self, scene: &Scene, gain: f64, chi2s: &str, shows_sign: bool) -> Vec<Finding> {
        let fault = |quantity: CheckedQuantity, sentence: String| Finding {
            gain,
            ..Finding::new(quantity, Verdict::Fault, sentence)
        };
        let name = &self.name;
        if !self.is_also_sign {
            let sentence = format!("{name} explains the images: {chi2s}");
            let turned = Finding { settings: self.settings.clone(), ..fault(CheckedQuantity::Orientation, sentence) };
            return vec![turned, sign(shows_sign)];
        }
        let set: Vec<String> = self.settings.iter().map(Setting::to_string).collect();
        let (focus, opposite) = scene.own_form(FOCUS, -scene.image.diversity_focus_waves_rms);
        let sentence = format!(
            "{name} explains the images ({chi2s}), and so does the opposite sign of the defocus, with other maps: set either {}, or {focus} = \
             {opposite}; a known poke of a segment or actuator decides (--segment or --actuator, --poke-nm)",
            set.join(" and ")
        );
        vec![fault(CheckedQuantity::OrientationOrDefocusSign, sentence)]
    }
}

/// Finding of a sign of the defocus that no image contradicts.
pub(super) fn sign(shows_sign: bool) -> Finding {
    let quantity = CheckedQuantity::DefocusSign;
    if shows_sign {
        Finding::new(quantity, Verdict::Agrees, "the pupil's shape shows it, in this orientation")
    } else {
        Finding::open(
            quantity,
            "the opposite sign, with the wavefront −W(−x, −y), gives the same images: a known poke of a segment or actuator shows it",
        )
    }
}

/// The keys of orientation and sign in which `other` differs from `scene`, with the values of
/// `other`.
pub(super) fn differences(scene: &Scene, other: &Scene) -> Vec<Setting> {
    let keys = [FLIPS[0], FLIPS[1], ROTATION, FOCUS];
    keys.into_iter()
        .filter_map(|key| other.setting(key).filter(|its| scene.setting(key).as_ref() != Some(its)))
        .collect()
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

/// Orientation that follows from a poke.
pub(super) struct PokeFinding {
    /// Keys to set, with their values; `None` where the poke does not decide.
    pub(super) settings: Option<Vec<Setting>>,
    /// Whether another segment or actuator moved than was stated.
    pub(super) is_other_part: bool,
    /// Decrease of Schwarz's criterion by them.
    pub(super) gain: f64,
    pub(super) explanation: String,
}

/// What a poke shows of images before it, where there are some, and behind it. `is_ambiguous` says
/// that `scene` has a turn in the place of which the opposite sign of the defocus has the same
/// images: the sign of the poke decides between them.
pub(super) fn of_poke(
    scene: &Scene,
    (before, after): (Option<&Images>, &Images),
    poke: Poke,
    is_ambiguous: bool,
    control: &Control,
) -> Result<PokeFinding> {
    let without =
        |is_other_part, explanation| Ok(PokeFinding { settings: None, is_other_part, gain: 0.0, explanation });
    let mut found = match check_orientation(scene, before, after, poke, control)? {
        PokeResult::Orientation(found) => found,
        PokeResult::OtherPart(explanation) => return without(true, explanation),
        PokeResult::Undecided(explanation) => return without(false, explanation),
    };
    // Of any form of the defocus.
    let is_sign = |settings: &[Setting]| settings.iter().any(|one| one.key().starts_with("image.diversity_"));
    let (best, runner_up) = (&found.best, &found.runner_up);
    if is_ambiguous && best.sign < 0.0 && !is_sign(&found.settings) {
        // A reversed poke in turned images: a turn by 180° more and the opposite sign of the
        // defocus have the same images, and its own sign.
        let waves = scene.image.diversity_focus_waves_rms;
        let flips = FLIPS.into_iter().zip([scene.image.flip_x, scene.image.flip_y]).zip(best.flip);
        found.settings.retain(|setting| setting.key() == ROTATION);
        found.settings.extend(flips.map(|((key, now), flip)| Setting::new(key, now == flip)));
        found.settings.push(Setting::new(FOCUS, -waves));
        found.warnings.clear();
    }
    let shown = match (is_ambiguous, is_sign(&found.settings)) {
        (true, true) => "the opposite sign of the defocus, and not a turn with the same images".into(),
        (true, false) => "a turn, and not the opposite sign of the defocus with the same images".into(),
        (false, _) => best.description(),
    };
    let mut explanation = format!(
        "the poke shows {shown} (correlation {:.3}; the next orientation {:.3})",
        best.correlation.abs(),
        runner_up.correlation
    );
    // A mirror image of a mirror's mirror image is the same: only who moved the segment knows which
    // one it was.
    if let Some(other) = found.other_part().filter(|_| !found.settings.is_empty()) {
        explanation = format!(
            "in the scene's own orientation {} moved (correlation {:.3}); if it was the one that was stated, {explanation}",
            other.name,
            other.correlation.abs()
        );
    }
    for warning in &found.warnings {
        explanation += &format!("; {warning}");
    }
    // Twice the difference of logarithms of likelihoods, as one of χ², without a parameter that was
    // fitted.
    let gain = 2.0 * (best.log_likelihood - runner_up.log_likelihood);
    Ok(PokeFinding { settings: Some(found.settings), is_other_part: false, gain, explanation })
}

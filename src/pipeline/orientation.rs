//! Orientation of images from a known poke: flips, rotation and sign under which the map of a moved
//! segment or actuator is what the images show.
//!
//! Where pupil and diversity equal their mirror images, a flipped image is the image of the flipped
//! wavefront, and no single image determines the orientation. A poke at a known place does. With
//! telescope coordinates x and the scene's u = g·x, the images show `E(g⁻¹u)` of an expected map E,
//! where g is a rotation followed by flips; each g of the pupil's symmetry group is compared.

mod candidates;
#[cfg(test)]
mod tests;

pub use candidates::{MovedPart, OrientationCandidate, Poke};

use super::estimate::Estimate;
use super::estimator::Estimator;
use super::images::Images;
use super::policy::Policy;
use crate::control::Control;
use crate::modal::Status;
use crate::pupil::Pupil;
use crate::scene::{Scene, Setting};
use crate::telescope::Telescope;
use crate::{Error, Result};
use candidates::{ExpectedMap, compare, described};
use ndarray::Array3;

/// Correlation of two expected maps from which a poke does not distinguish them.
const SAME_MAP: f64 = 0.97;
/// Least correlation of the difference with the expected map.
const LEAST_CORRELATION: f64 = 0.5;
/// Least ratio of the likelihoods of the best orientation and the next one.
const LEAST_RATIO: f64 = 1000.0;
/// Amplitudes, found over expected, without a warning: half or twice is a confusion of surface and
/// wavefront.
const USUAL_AMPLITUDE: std::ops::RangeInclusive<f64> = 0.7..=1.4;
/// Ratio of χ² from which images that are turned by 90° are explained better.
const BETTER_TURNED: f64 = 0.5;

/// Orientation of images.
#[derive(Debug, Clone)]
pub struct Orientation {
    /// The likeliest orientation.
    pub best: OrientationCandidate,
    /// The next one that the poke distinguishes from it.
    pub runner_up: OrientationCandidate,
    /// Orientations that the poke does not distinguish from the best, which is the simplest of
    /// them.
    pub equivalent: Vec<OrientationCandidate>,
    /// Keys of the scene to set, with their values; empty where the scene's are right.
    pub settings: Vec<Setting>,
    /// The segment or actuator that moved, if the scene has the orientation of the images; `None`
    /// for images that are turned by 90°.
    pub moved: Option<MovedPart>,
    /// What a user should know.
    pub warnings: Vec<String>,
}

impl Orientation {
    /// The part that moved in the scene's own orientation, where it is another one than was stated.
    pub fn other_part(&self) -> Option<&MovedPart> {
        self.moved.as_ref().filter(|moved| !moved.is_stated && moved.correlation.abs() >= LEAST_CORRELATION)
    }
}

/// What a poke shows.
#[derive(Debug, Clone)]
pub enum PokeResult {
    /// The orientation.
    Orientation(Box<Orientation>),
    /// Another segment or actuator moved than was stated, in the scene's own orientation, which no
    /// orientation explains as well; a sentence.
    OtherPart(String),
    /// It does not decide; the reason.
    Undecided(String),
}

/// Finds the orientation of `after`, images behind a poke, against `before`, images without it;
/// without those, the poke must be larger than the errors of the wavefront.
///
/// # Errors
/// Those of [`Estimator::estimate`]; [`Error::Value`] for a poke of nothing, or of a part that the
/// scene does not have.
pub fn check_orientation(
    scene: &Scene,
    before: Option<&Images>,
    after: &Images,
    poke: Poke,
    control: &Control,
) -> Result<PokeResult> {
    let telescope = Telescope::new(scene)?;
    let expected = ExpectedMap::new(scene, &telescope, poke)?;
    let estimator = Estimator::with_policy(scene, Policy::default(), control.clone())?;
    let estimate = |quarter_turn: bool| -> Result<(Estimate, Option<Estimate>)> {
        let oriented = |images: &Images| if quarter_turn { turned(images) } else { images.clone() };
        let before = before.map(|before| estimator.estimate(&oriented(before))).transpose()?;
        Ok((estimator.estimate(&oriented(after))?, before))
    };
    let (rows, columns) = scene.image.frame_shape();
    let (mut found, mut quarter_turn) = (estimate(false)?, false);
    if found.0.status != Status::Ok && rows == columns {
        let other = estimate(true)?;
        if other.0.reduced_chi2 < BETTER_TURNED * found.0.reduced_chi2 {
            (found, quarter_turn) = (other, true);
        }
    }
    let pupil = &telescope.pupil;
    let difference_nm = match &found.1 {
        Some(before) => found.0.maps.wavefront_nm() - before.maps.wavefront_nm(),
        None => found.0.maps.wavefront_nm(),
    };
    let difference_nm = pupil.remove_piston_tip_tilt(difference_nm.view())?;
    let modes = found.0.basis.names.len();
    let candidates = expected.candidates(pupil, scene, &difference_nm, modes)?;
    let moved = if quarter_turn { None } else { expected.moved(pupil, &difference_nm, modes)? };
    let mut orientation = match selected(candidates, moved, &expected, pupil, scene, quarter_turn)? {
        PokeResult::Orientation(orientation) => orientation,
        other => return Ok(other),
    };
    for (name, estimate) in [("after", Some(&found.0)), ("before", found.1.as_ref())] {
        if let Some(estimate) = estimate.filter(|estimate| estimate.status != Status::Ok) {
            orientation.warnings.push(format!(
                "the images {name} the poke are not explained (reduced χ² {:.1}, {}): their maps, and this answer, are less certain",
                estimate.reduced_chi2,
                estimate.status.word()
            ));
        }
    }
    Ok(PokeResult::Orientation(orientation))
}

/// The images turned by −90° about the axis, pixel M/2: the line that wraps around is bad.
fn turned(images: &Images) -> Images {
    let (count, rows, columns) = images.images_e.dim();
    // u' = R(−90°)u: (u', v') = (v, −u), so the new pixel (row v', column u') has the old one of
    // row u', column −v'.
    let source = |row: usize, column: usize| (row > 0 && column < rows).then(|| (column, columns / 2 * 2 - row));
    let shape = (count, columns, rows);
    let at = |image: usize, row: usize, column: usize| source(row, column).map(|(v, u)| [image, v, u]);
    Images {
        images_e: Array3::from_shape_fn(shape, |(i, v, u)| at(i, v, u).map_or(0.0, |at| images.images_e[at])),
        bad: Array3::from_shape_fn(shape, |(i, v, u)| at(i, v, u).is_none_or(|at| images.bad[at])),
        slopes_mas: None,
        moved_reference_mas: None,
        truth: None,
        ..images.clone()
    }
}

/// The likeliest orientation, the simplest of those that the poke does not distinguish.
fn selected(
    candidates: Vec<OrientationCandidate>,
    moved: Option<MovedPart>,
    expected: &ExpectedMap,
    pupil: &Pupil,
    scene: &Scene,
    quarter_turn: bool,
) -> Result<PokeResult> {
    let name = expected.name();
    let undecided = |sentence: String| Ok(PokeResult::Undecided(sentence));
    let Some(likeliest) = candidates.first().copied() else {
        return Err(Error::Internal("no orientation was compared".into()));
    };
    let is_likelier = |moved: &&MovedPart| moved.log_likelihood - likeliest.log_likelihood > LEAST_RATIO.ln();
    if let Some(moved) = moved
        .as_ref()
        .filter(|moved| !moved.is_stated && moved.correlation.abs() >= LEAST_CORRELATION)
        .filter(is_likelier)
    {
        return Ok(PokeResult::OtherPart(format!(
            "{} moved, in the scene's own orientation (correlation {:.3}, {:.2} times the poke): the images do not show {name} as well in any \
             orientation ({:.3} at most, in {})",
            moved.name,
            moved.correlation.abs(),
            moved.amplitude,
            likeliest.correlation,
            described(&likeliest)
        )));
    }
    if likeliest.correlation < LEAST_CORRELATION {
        return undecided(format!(
            "the images do not show {name}: its largest correlation with their difference is {:.2} in any orientation, where \
             {LEAST_CORRELATION} or more is needed; give the images before and after, or a larger poke",
            likeliest.correlation
        ));
    }
    let map = |candidate: &OrientationCandidate| expected.map_nm(pupil, candidate.flip, candidate.rotation_deg);
    let own = map(&likeliest)?;
    let (mut equivalent, mut others) = (Vec::new(), Vec::new());
    for candidate in candidates {
        let same = likeliest.sign * candidate.sign * compare(pupil, &own, &map(&candidate)?).0 > SAME_MAP;
        if same { equivalent.push(candidate) } else { others.push(candidate) }
    }
    let complexity = |candidate: &OrientationCandidate| {
        (candidate.rotation_deg.abs() as i64, candidate.flip.iter().filter(|flip| **flip).count())
    };
    equivalent.sort_by_key(complexity);
    let best = equivalent.remove(0);
    if let Some(other) = equivalent.iter().find(|other| other.rotation_deg == 0.0 && best.rotation_deg == 0.0) {
        return undecided(format!(
            "{name} does not distinguish {} from {}: it is on a symmetry axis of the pupil, poke one that is not",
            described(&best),
            described(other)
        ));
    }
    let Some(runner_up) = others.first().copied() else {
        return undecided(format!("{name} does not distinguish any orientation: poke one off the axis"));
    };
    if best.log_likelihood - runner_up.log_likelihood < LEAST_RATIO.ln() {
        return undecided(format!(
            "{name} does not distinguish {} (correlation {:.2}) from {} ({:.2}): give the images before and after, or a larger poke",
            described(&best),
            best.correlation,
            described(&runner_up),
            runner_up.correlation
        ));
    }
    let mut warnings = Vec::new();
    if best.sign > 0.0 && !USUAL_AMPLITUDE.contains(&best.amplitude) {
        warnings.push(format!(
            "the poke is {:.2} times the expected one in the images: nm of wavefront are expected, twice those of a mirror's \
             surface",
            best.amplitude
        ));
    }
    let turn = |candidate| if quarter_turn { after_quarter_turn(candidate) } else { candidate };
    let (best, runner_up) = (turn(best), turn(runner_up));
    let equivalent = equivalent.into_iter().map(turn).collect();
    let mut settings = Vec::new();
    let is_reversed_diversity = best.sign < 0.0 && best.flip == [true, true] && best.rotation_deg == 0.0;
    if is_reversed_diversity && scene.image.diversity_file.is_none() {
        let waves = -scene.image.diversity_focus_waves_rms;
        let (key, value) = scene.own_form("image.diversity_focus_waves_rms", waves);
        settings.push(Setting::new(key, value));
    } else {
        let keys = [("image.flip_x", scene.image.flip_x), ("image.flip_y", scene.image.flip_y)];
        for ((key, now), flip) in keys.into_iter().zip(best.flip) {
            settings.extend(flip.then(|| Setting::new(key, !now)));
        }
        if best.rotation_deg != 0.0 {
            let rotation_deg = scene.pupil.rotation_deg + best.rotation_deg;
            settings.push(Setting::new("pupil.rotation_deg", rotation_deg));
        }
        if best.sign < 0.0 {
            let (diversity, _) =
                scene.own_form("image.diversity_focus_waves_rms", scene.image.diversity_focus_waves_rms);
            warnings.push(format!(
                "the poke has the opposite sign in the images: it lowers the wavefront (a positive one raises it), or else {diversity} has \
                 the wrong sign and the images are rotated by 180° in addition"
            ));
        }
    }
    Ok(PokeResult::Orientation(Box::new(Orientation { best, runner_up, equivalent, settings, moved, warnings })))
}

/// The orientation of images that were turned by −90° before: R(90°)·F·R(θ) = F·R(±90° + θ), − for
/// a single flip.
fn after_quarter_turn(candidate: OrientationCandidate) -> OrientationCandidate {
    let is_mirrored = candidate.flip[0] != candidate.flip[1];
    let turn = if is_mirrored { -90.0 } else { 90.0 };
    OrientationCandidate { rotation_deg: candidate.rotation_deg + turn, ..candidate }
}

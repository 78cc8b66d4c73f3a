//! Light that a pupil lacks and the scene has: segments without any, a stop of the camera, a
//! central obscuration, a spider.
//!
//! From the model with all light no fit leads there, because the image is of another shape: each is
//! tried, by a coarse model with the first Zernikes, whose χ² has to fall by much.

use crate::Result;
use crate::scene::{NcpaBasis, NollRange, PupilScene, Scene};
use crate::telescope::Telescope;
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::mem::discriminant;

/// Most segments of a mirror of which each is tried: a fit of the coarse model takes a tenth of a
/// second.
const MOST_TRIED: usize = 61;
/// Most segments without light that are found.
const MOST_DARK: usize = 5;
/// Part of χ² that one more may leave.
const MOST_LEFT: f64 = 0.8;
/// Samples of the coarse model along a side, and its Zernikes, to radial order 5.
const SAMPLES: usize = 64;
const ZERNIKES: usize = 20;
/// Diameters of a stop that are tried, relative to the pupil's width: about the axis, and off it by
/// this much in each of some directions. A fit reaches those between.
const STOPS: [f64; 4] = [0.96, 0.92, 0.87, 0.82];
const STOPS_OFF_AXIS: [f64; 3] = [0.96, 0.92, 0.87];
const OFFSET: f64 = 0.025;
const DIRECTIONS: usize = 8;
/// Diameters of a central obscuration that are tried, relative to the pupil's width: those of
/// telescopes are 0.1 to 0.35.
const OBSCURATIONS: [f64; 6] = [0.11, 0.14, 0.175, 0.22, 0.275, 0.35];
/// Widths of a spider's vanes that are tried, relative to the pupil's width: 0.002 to 0.02.
const SPIDERS: [f64; 3] = [0.003, 0.008, 0.02];

/// Segments that are tried beside those that were found: those that alone lowered χ² most.
const CANDIDATES: usize = 8;

/// What a pupil lacks.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum LostLight {
    /// These segments.
    Dark(Vec<i64>),
    /// What is beyond a circle of about this diameter, centre x and y, m.
    Stop([f64; 3]),
    /// What is within about this diameter, m.
    Obscuration(f64),
    /// What is behind vanes of about this width, m.
    Spider(f64),
}

impl LostLight {
    /// Takes this light from a pupil.
    pub(super) fn take_from(&self, pupil: &mut PupilScene) {
        match *self {
            Self::Dark(ref segments) => pupil.dark_segments.clone_from(segments),
            Self::Stop(stop_m) => [pupil.stop_diameter_m, pupil.stop_x_m, pupil.stop_y_m] = stop_m,
            Self::Obscuration(diameter_m) => pupil.central_obscuration_m = diameter_m,
            Self::Spider(width_m) => pupil.spider_width_m = width_m,
        }
    }
}

/// What lowers the χ² of an image most: segments without light, or shadows of different kinds;
/// none where nothing lowers it by much. `fitted` is the reduced χ² with a scene, where it can be
/// fitted.
///
/// # Errors
/// Those of `fitted`.
pub(super) fn find(scene: &Scene, fitted: &(dyn Fn(&Scene) -> Result<Option<f64>> + Sync)) -> Result<Vec<LostLight>> {
    let Some(width_m) = scene.pupil.extent_m() else { return Ok(Vec::new()) };
    if !scene.pupil.dark_segments.is_empty() || scene.pupil.stop_diameter_m > 0.0 {
        return Ok(Vec::new());
    }
    let coarse = scene.changed(|sections| {
        (sections.modes.ncpa, sections.modes.ncpa_count) = (NcpaBasis::Zernike, ZERNIKES);
        sections.modes.exact_zernikes = Some(NollRange::None);
        sections.estimate.samples = Some(SAMPLES);
        sections.leave_out_posterior();
    })?;
    let chi2 = |lost: &[LostLight]| -> Result<f64> {
        let changed = coarse.changed(|sections| lost.iter().for_each(|lost| lost.take_from(&mut sections.pupil)));
        // Such as a stop that hides a segment.
        let Ok(changed) = changed else { return Ok(f64::INFINITY) };
        Ok(fitted(&changed)?.filter(|chi2| chi2.is_finite()).unwrap_or(f64::INFINITY))
    };
    // The trials, from the smallest χ² on.
    let ranked = |trials: Vec<Result<(f64, usize)>>| -> Result<Vec<(f64, usize)>> {
        let mut found = trials.into_iter().collect::<Result<Vec<_>>>()?;
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        Ok(found)
    };
    let own = chi2(&[])?;
    let (mut shadows, mut least_shaded) = (Vec::new(), own);
    let mut tried = all_shadows(scene, width_m);
    while !tried.is_empty() {
        let beside = |number: usize| Ok((chi2(&[&shadows[..], &tried[number..=number]].concat())?, number));
        let found = ranked((0..tried.len()).into_par_iter().map(beside).collect())?;
        let [(chi2, number), ..] = found[..] else { break };
        if chi2 > MOST_LEFT * least_shaded {
            break;
        }
        least_shaded = chi2;
        shadows.push(tried.swap_remove(number));
        tried.retain(|other| shadows.iter().all(|shadow| discriminant(other) != discriminant(shadow)));
    }
    let segments = Telescope::new(scene)?.pupil.segments.len();
    let mut candidates: Vec<usize> = if segments <= MOST_TRIED { (0..segments).collect() } else { Vec::new() };
    let (mut dark, mut least) = (Vec::new(), own);
    while dark.len() < MOST_DARK && !candidates.is_empty() {
        let beside = |&number: &usize| {
            let all = [&dark[..], &[number as i64]].concat();
            Ok((chi2(&[LostLight::Dark(all)])?, number))
        };
        let found = ranked(candidates.par_iter().map(beside).collect())?;
        let [(chi2, number), ..] = found[..] else { break };
        if chi2 > MOST_LEFT * least {
            break;
        }
        least = chi2;
        dark.push(number as i64);
        candidates = found[1..].iter().take(CANDIDATES).map(|(_, number)| *number).collect();
    }
    if dark.is_empty() || least_shaded < least {
        return Ok(shadows);
    }
    dark.sort_unstable();
    Ok(vec![LostLight::Dark(dark)])
}

/// The shadows that are tried for a scene whose pupil has this width: those that it has none of.
fn all_shadows(scene: &Scene, width_m: f64) -> Vec<LostLight> {
    let mut shadows: Vec<LostLight> = stops_m(width_m).into_iter().map(LostLight::Stop).collect();
    if scene.pupil.central_obscuration_m == 0.0 {
        shadows.extend(OBSCURATIONS.map(|diameter| LostLight::Obscuration(diameter * width_m)));
    }
    if scene.pupil.spider_width_m == 0.0 {
        shadows.extend(SPIDERS.map(|width| LostLight::Spider(width * width_m)));
    }
    shadows
}

/// Diameter and centre of the stops that are tried for a pupil of this width, m.
fn stops_m(width_m: f64) -> Vec<[f64; 3]> {
    let directions = (0..DIRECTIONS).map(|number| TAU * number as f64 / DIRECTIONS as f64);
    let places = directions.map(|angle| [OFFSET * angle.cos(), OFFSET * angle.sin()]);
    let stops = STOPS.map(|diameter| [diameter, 0.0, 0.0]).into_iter();
    let off_axis = places.flat_map(|[x, y]| STOPS_OFF_AXIS.map(|diameter| [diameter, x, y]));
    let stops = stops.chain(off_axis);
    stops.map(|stop| stop.map(|part| part * width_m)).collect()
}

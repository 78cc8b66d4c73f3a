//! Light that a pupil lacks and the scene has: segments without any, a stop of the camera.
//!
//! From the model with all light no fit leads there, because the image is of another shape: each is
//! tried, by a coarse model with the first Zernikes, whose χ² has to fall by much.

use crate::Result;
use crate::scene::{NcpaBasis, NollRange, Scene};
use crate::telescope::Telescope;
use rayon::prelude::*;
use std::f64::consts::TAU;

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

/// Segments that are tried beside those that were found: those that alone lowered χ² most.
const CANDIDATES: usize = 8;

/// What a pupil lacks.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum LostLight {
    /// These segments.
    Dark(Vec<i64>),
    /// What is beyond a circle of about this diameter, centre x and y, m.
    Stop([f64; 3]),
}

/// What lowers the χ² of an image most: segments without light, or a stop; `None` where neither
/// lowers it by much. `fitted` is the reduced χ² with a scene, where it can be fitted.
///
/// # Errors
/// Those of `fitted`.
pub(super) fn find(
    scene: &Scene,
    fitted: &(dyn Fn(&Scene) -> Result<Option<f64>> + Sync),
) -> Result<Option<LostLight>> {
    let Some(width_m) = scene.pupil.extent_m() else { return Ok(None) };
    if !scene.pupil.dark_segments.is_empty() || scene.pupil.stop_diameter_m > 0.0 {
        return Ok(None);
    }
    let coarse = scene.changed(|sections| {
        (sections.modes.ncpa, sections.modes.ncpa_count) = (NcpaBasis::Zernike, ZERNIKES);
        sections.modes.exact_zernikes = Some(NollRange::None);
        sections.estimate.samples = Some(SAMPLES);
        sections.leave_out_posterior();
    })?;
    let chi2 = |dark: &[i64], stop_m: [f64; 3]| -> Result<f64> {
        let changed = coarse.changed(|sections| {
            let pupil = &mut sections.pupil;
            pupil.dark_segments = dark.to_vec();
            [pupil.stop_diameter_m, pupil.stop_x_m, pupil.stop_y_m] = stop_m;
        });
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
    let no_stop = [0.0; 3];
    let own = chi2(&[], no_stop)?;
    let stops_m = stops_m(width_m);
    let of_stop = |number: usize| Ok((chi2(&[], stops_m[number])?, number));
    let stop = ranked((0..stops_m.len()).into_par_iter().map(of_stop).collect())?.first().copied();
    let segments = Telescope::new(scene)?.pupil.segments.len();
    let mut candidates: Vec<usize> = if segments <= MOST_TRIED { (0..segments).collect() } else { Vec::new() };
    let (mut dark, mut least) = (Vec::new(), own);
    while dark.len() < MOST_DARK && !candidates.is_empty() {
        let beside = |&number: &usize| Ok((chi2(&[&dark[..], &[number as i64]].concat(), no_stop)?, number));
        let found = ranked(candidates.par_iter().map(beside).collect())?;
        let [(chi2, number), ..] = found[..] else { break };
        if chi2 > MOST_LEFT * least {
            break;
        }
        least = chi2;
        dark.push(number as i64);
        candidates = found[1..].iter().take(CANDIDATES).map(|(_, number)| *number).collect();
    }
    dark.sort_unstable();
    Ok(match stop {
        Some((chi2, number)) if chi2 < (MOST_LEFT * own).min(least) => Some(LostLight::Stop(stops_m[number])),
        _ if !dark.is_empty() => Some(LostLight::Dark(dark)),
        _ => None,
    })
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

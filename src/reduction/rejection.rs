//! Frames that are not used, and why.

use super::cut_out::CutOut;
use super::frame::RawFrame;
use super::log::LogRow;
use super::star::Spot;
use crate::statistics::{NORMAL_MEDIAN_DEVIATION, median};
use ndarray::{Array2, Zip};

/// Least signal-to-noise ratio of the box in which the star is found. The best of all boxes of a
/// frame of noise has about 4.5.
const LEAST_SNR: f64 = 10.0;
/// Pixels with one largest value that are saturation where no level is known.
const PLATEAU: usize = 4;
/// Elongation over the median of its channel from which a frame is trailed, whatever the others
/// scatter: a segmented telescope's spot is round to 10 or 20 %.
const TRAILED: f64 = 1.5;
/// Deviations from the median elongation, in robust standard deviations, from which a frame is
/// trailed, among enough frames.
const TRAILED_SIGMAS: f64 = 8.0;
/// Frames from which their scatter is known.
const ENOUGH: usize = 5;
/// Least excess of elongation that counts.
const LEAST_EXCESS: f64 = 0.1;

/// Excess of a background over that of the frame's equals, relative to it, from which it is another
/// light: the sky of the infrared changes by tens of per cent in a night.
const OTHER_LIGHT: f64 = 1.0;
/// The same in standard deviations of a pixel, for a background near 0.
const OTHER_LIGHT_SIGMAS: f64 = 5.0;
/// Least light of a star over that of the other frames: behind clouds that take more, an image adds
/// next to nothing to a sequence.
const FAINT: f64 = 0.1;

/// Why a frame with this spot has no star to use.
pub(super) fn starless(spot: Option<Spot>) -> Option<String> {
    match spot {
        None => Some("no good pixels".into()),
        Some(spot) if spot.snr < LEAST_SNR => Some(format!(
            "no star: the brightest spot has a signal-to-noise ratio of {:.1}, where {LEAST_SNR} is needed (--darks, --flats and --skies name \
             the class of a frame without one)",
            spot.snr
        )),
        Some(_) => None,
    }
}

/// Why a frame with this background is none of the star, by the backgrounds, with the scatter of a
/// pixel, of those of its filter and exposure: a flat that no card names is brighter. The lower
/// quartile is compared, which neither one frame that was read in part nor as many flats as stars
/// change.
pub(super) fn other_background(own_e: f64, mut alike: Vec<(f64, f64)>) -> Option<String> {
    alike.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (usual_e, scatter_e) = *alike.get(alike.len().saturating_sub(1) / 4)?;
    let most_e = usual_e + (OTHER_LIGHT * usual_e.abs()).max(OTHER_LIGHT_SIGMAS * scatter_e);
    (own_e > most_e).then(|| {
        format!(
            "its background is {own_e:.0} electrons a pixel, where others of its exposure have {usual_e:.0} and {most_e:.0} at most are \
             accepted: a flat, or another sky (--flats, --skies and --stars name the class)"
        )
    })
}

/// Why a frame with a spot of this light is none of the star, by those of its filter and exposure:
/// a dark has structure, too. The upper quartile is compared, which as many as two darks for one
/// star do not change.
pub(super) fn faint(own_e: f64, mut alike: Vec<f64>) -> Option<String> {
    alike.sort_by(f64::total_cmp);
    let last = alike.len().checked_sub(1)?;
    let usual_e = alike[last - last / 4];
    (own_e < FAINT * usual_e).then(|| {
        format!(
            "no star: its brightest spot has {own_e:.1e} electrons, where others of its exposure have {usual_e:.1e} and a part of {FAINT} is \
             needed: clouds, or a frame without the star (--darks and --skies name the class)"
        )
    })
}

/// Largest value of one coadd in a cut-out, in the unit of the file, and why the frame is
/// saturated.
pub(super) fn saturation(
    frame: &RawFrame,
    bad: &Array2<bool>,
    part: CutOut,
    saturation_adu: Option<f64>,
) -> (f64, Option<String>) {
    let mut values = Vec::with_capacity(part.rows * part.columns);
    Zip::from(&part.of(&frame.data)).and(&part.of(bad)).for_each(|counts, bad| {
        if !bad {
            values.push(counts / frame.coadds());
        }
    });
    let peak = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let above = saturation_adu.map_or(0, |limit| values.iter().filter(|value| **value >= limit).count());
    let reason = match (saturation_adu, plateau(&values, peak, saturation_adu.is_some())) {
        (Some(limit), _) if above > 0 => {
            Some(format!("saturated: {above} pixels of the star at {limit} counts or more in one coadd"))
        }
        (limit, Some(equal)) => {
            let of_mean =
                limit.filter(|limit| frame.coadds() > 1.0 && (frame.coadds() * peak / limit - 1.0).abs() < 1e-3);
            let of_mean = of_mean.map(|limit| {
                let coadds = frame.coadds();
                format!(
                    ", which is {limit} in the file and the level of saturation: a camera that averages its {coadds} coadds needs \
                     image.coadds_are_averaged = true"
                )
            });
            Some(format!(
                "saturated: {equal} pixels of the star have the same largest value, {peak} counts in one coadd{}",
                of_mean.unwrap_or_default()
            ))
        }
        _ => None,
    };
    (peak, reason)
}

/// Number of pixels of `values` that have one largest value, `peak`, where they are a plateau.
/// Where the level of saturation `is_known` few faint pixels of whole counts are none: fewer must
/// be just below than on it.
fn plateau(values: &[f64], peak: f64, is_known: bool) -> Option<usize> {
    let equal = values.iter().filter(|value| **value == peak).count();
    // 2 % of a clipped peak, and more than the noise of a few counts.
    let edge = peak - (0.02 * peak.abs()).max(3.0);
    let below = values.iter().filter(|value| **value < peak && **value >= edge).count();
    (equal >= PLATEAU && (!is_known || below < equal)).then_some(equal)
}

/// Rejects the trailed ones of the frames of a channel, whose rows are `rows[which]`.
pub(super) fn reject_trailed(rows: &mut [LogRow], which: &[usize]) {
    let elongations: Vec<f64> = which.iter().map(|&index| rows[index].elongation).collect();
    let typical = if elongations.len() < 3 { 1.0 } else { median(&elongations) };
    let deviations: Vec<f64> = elongations.iter().map(|elongation| (elongation - typical).abs()).collect();
    let spread = median(&deviations) / NORMAL_MEDIAN_DEVIATION;
    let by_spread = typical + (TRAILED_SIGMAS * spread).max(LEAST_EXCESS);
    let limit = if which.len() < ENOUGH { TRAILED * typical } else { by_spread.min(TRAILED * typical) };
    for &index in which {
        let elongation = rows[index].elongation;
        if elongation > limit {
            let sentence = format!(
                "trailed: its spot is {elongation:.2} times as long as wide, where {limit:.2} is accepted here"
            );
            rows[index].reject(sentence);
        }
    }
}

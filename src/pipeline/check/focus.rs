//! Size of the defocus, from the concentration of the light: an image in focus where the scene has
//! a defocus, or the reverse.
//!
//! The Strehl ratio of the whole wavefront, defocus included, is the peak's part of the light over
//! that of the pupil's image in focus, (ΣA)²/(M²·ΣA²) with the amplitude A on N samples and M =
//! N·s, s pixels per λ/grid_m (Parseval). About exp(−(2πw)²) at w waves RMS, where it is not small
//! (Maréchal), and a few hundredths at most, at a caustic, with a defocus of a wave.

use super::finding::{CheckedQuantity, FOCUS, Finding, Verdict};
use crate::Result;
use crate::scene::{Optic, Scene, Setting};
use crate::telescope::Telescope;
use ndarray::{ArrayView2, s};

/// Strehl ratio from which an image is in focus: at most 0.24 waves RMS of wavefront, defocus
/// included.
const IN_FOCUS: f64 = 0.1;
/// Strehl ratio below which an image is not: 0.3 waves RMS or more.
const OUT_OF_FOCUS: f64 = 0.03;
/// Defocus with which no image is in focus, and up to which every sharp image is, waves RMS.
const DEFOCUSED_WAVES: f64 = 0.75;
const FOCUSED_WAVES: f64 = 0.25;

/// The fault of `scene`'s defocus that the concentration of `frame_e` shows, with a gain of 0.
///
/// # Errors
/// Those of making the pupil.
pub(super) fn fault(scene: &Scene, frame_e: ArrayView2<f64>) -> Result<Option<Finding>> {
    let waves = scene.image.diversity_focus_waves_rms;
    let part = if scene.image.diversity_file.is_some() { None } else { peak_part(frame_e) };
    let Some(part) = part else { return Ok(None) };
    let amplitude = Telescope::new(scene)?.pupil.amplitude;
    let side = amplitude.nrows() as f64 * scene.image.samples_per_lambda_over_d;
    let ideal = amplitude.sum().powi(2) / (amplitude.mapv(|a| a * a).sum() * side * side);
    let strehl = part / ideal;
    let largest_waves = (-strehl.min(1.0).ln()).sqrt() / std::f64::consts::TAU;
    let (found, sentence) = if waves.abs() > DEFOCUSED_WAVES && strehl > IN_FOCUS {
        let sentence = format!(
            "the image has a Strehl ratio of {strehl:.2}, and with a defocus of {waves} waves RMS a few hundredths at most: it is in focus, \
             or within some {largest_waves:.2} waves RMS"
        );
        (Some(0.0), sentence)
    } else if waves.abs() < FOCUSED_WAVES && strehl < OUT_OF_FOCUS {
        let sentence = format!(
            "the image has a Strehl ratio of {strehl:.3}: it is out of focus, or blurred by turbulence, where the scene has it in focus"
        );
        (None, sentence)
    } else {
        return Ok(None);
    };
    let settings = found.map(|waves: f64| Setting::new(FOCUS, waves));
    Ok(Some(Finding {
        scene: Some(waves),
        found,
        settings: settings.into_iter().collect(),
        ..Finding::new(CheckedQuantity::Optic(Optic::DEFOCUS), Verdict::Fault, sentence)
    }))
}

/// Part of the star's light in the brightest pixel; `None` where there is no star. The background
/// is the median of the frame's edge, and a pixel counts no more than the brightest of its
/// neighbours, as a hot one is alone.
fn peak_part(frame_e: ArrayView2<f64>) -> Option<f64> {
    let (rows, columns) = frame_e.dim();
    let is_edge = |(y, x): (usize, usize)| y == 0 || x == 0 || y + 1 == rows || x + 1 == columns;
    let mut edge: Vec<f64> =
        frame_e.indexed_iter().filter(|(at, e)| is_edge(*at) && e.is_finite()).map(|(_, e)| *e).collect();
    edge.sort_by(f64::total_cmp);
    let background_e = *edge.get(edge.len() / 2)?;
    let star_e = frame_e.mapv(|e| if e.is_finite() { e - background_e } else { 0.0 });
    let mut peak_e = 0f64;
    for y in 1..rows.saturating_sub(1) {
        for x in 1..columns.saturating_sub(1) {
            let around = star_e.slice(s![y - 1..y + 2, x - 1..x + 2]);
            let neighbours = around.indexed_iter().filter(|(at, _)| *at != (1, 1));
            peak_e = peak_e.max(star_e[[y, x]].min(neighbours.map(|(_, e)| *e).fold(f64::MIN, f64::max)));
        }
    }
    let flux_e = star_e.sum();
    (flux_e > 0.0 && peak_e > 0.0).then_some(peak_e / flux_e)
}

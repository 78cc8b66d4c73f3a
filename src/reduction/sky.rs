//! Sky of a frame: from frames of the sky, else from the other positions of the dithered star.

use super::calibration::Calibrated;
use super::cut_out::CutOut;
use super::masters::median_of;
use super::noise::{SkyTerms, median_variance};
use super::star_frame::StarFrame;
use crate::statistics::median;
use ndarray::Array2;

/// Largest part of a cut-out without a sky: those pixels are bad. Where more is missing, the
/// dithers overlap.
const MOST_MISSING: f64 = 0.02;

/// Sky in the cut-out of a frame.
pub(super) struct Sky {
    /// Electrons in the frame, NaN where none is known.
    pub(super) electrons: Array2<f64>,
    /// Its noise.
    pub(super) terms: SkyTerms,
}

/// Ratio of the exposure of `frame` to that of `other`; `None` where their signals are not
/// proportional. The counts of coadds are summed; other integration times are proportional where
/// both are without bias.
fn scale(frame: &Calibrated, other: &Calibrated) -> Option<f64> {
    let coadds = frame.frame.coadds() / other.frame.coadds();
    if frame.frame.header.has_exposure_of(&other.frame.header) {
        return Some(coadds).filter(|_| frame.dark.is_some() == other.dark.is_some());
    }
    let has_darks = frame.dark.is_some() && other.dark.is_some();
    let (own, its) = (frame.frame.header.itime_s?, other.frame.header.itime_s.filter(|seconds| *seconds > 0.0)?);
    has_darks.then_some(coadds * own / its)
}

/// The sky of `frame` in `part`, as the median of `skies`; `None` where none of them fits its
/// filter and exposure.
pub(super) fn of_sky_frames(frame: &Calibrated, part: CutOut, skies: &[Calibrated]) -> Option<Sky> {
    let fitting: Vec<(&Calibrated, f64)> =
        skies.iter().filter(|sky| frame.has_filter_of(sky)).filter_map(|sky| Some((sky, scale(frame, sky)?))).collect();
    let (first, scale) = *fitting.first()?;
    // Frames of one exposure: that of the first.
    let same: Vec<Array2<f64>> = fitting
        .iter()
        .filter(|(sky, _)| {
            sky.frame.header.has_exposure_of(&first.frame.header) && sky.frame.coadds() == first.frame.coadds()
        })
        .map(|(sky, _)| part.of(&sky.electrons))
        .collect();
    sky(frame, first, median_of(&same), scale, median_variance(same.len()))
}

/// The sky in the cut-out of `one`, as the median of the other frames of `all` where their stars
/// are not; `None` where they overlap.
pub(super) fn of_dithers(one: &StarFrame, all: &[StarFrame]) -> Option<Sky> {
    let (frame, part) = (one.frame, one.part);
    let others: Vec<&StarFrame> =
        all.iter().filter(|other| !std::ptr::eq(other.frame, frame) && frame.is_alike(other.frame)).collect();
    let first = others.first()?.frame;
    let (half_height, half_width) = (part.rows as f64 / 2.0, part.columns as f64 / 2.0);
    let free: Vec<Array2<f64>> = others
        .iter()
        .map(|StarFrame { frame: other, star: (at_x, at_y), .. }| {
            let is_star =
                |y: usize, x: usize| (x as f64 - at_x).abs() <= half_width && (y as f64 - at_y).abs() <= half_height;
            Array2::from_shape_fn((part.rows, part.columns), |(j, i)| {
                let (y, x) = (part.top + j, part.left + i);
                if is_star(y, x) { f64::NAN } else { other.electrons[[y, x]] }
            })
        })
        .collect();
    let values = free.iter().flatten().filter(|value| value.is_finite()).count();
    let count = values as f64 / (part.rows * part.columns) as f64;
    sky(frame, first, median_of(&free), 1.0, median_variance(count.round().max(1.0) as usize))
}

/// The sky whose median in a frame `like` is `electrons`.
fn sky(frame: &Calibrated, like: &Calibrated, electrons: Array2<f64>, scale: f64, variance: f64) -> Option<Sky> {
    let known: Vec<f64> = electrons.iter().copied().filter(|value| value.is_finite()).collect();
    if known.len() as f64 <= (1.0 - MOST_MISSING) * electrons.len() as f64 {
        return None;
    }
    let level_e = median(&known);
    let terms = SkyTerms {
        variance,
        scale,
        coadds: like.frame.coadds(),
        level_e,
        dark: like.dark_variance,
        has_same_dark: like.dark == frame.dark,
    };
    Some(Sky { electrons: electrons * scale, terms })
}

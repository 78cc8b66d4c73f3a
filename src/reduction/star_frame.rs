//! Frames in which a star was found, and the rejections that come before the sky: that of the
//! dithers is made of frames that are used.

use super::calibration::Calibrated;
use super::cut_out::CutOut;
use super::log::LogRow;
use super::noise::scatter;
use super::{rejection, star};
use crate::scene::Scene;
use crate::statistics::median;
use ndarray::Array2;

/// Frame with a star to use.
pub(super) struct StarFrame<'a> {
    pub(super) frame: &'a Calibrated<'a>,
    /// Column and row of the star.
    pub(super) star: (f64, f64),
    /// Its cut-out.
    pub(super) part: CutOut,
    /// Median and scatter of the pixels outside of it, electrons.
    pub(super) background_e: f64,
    pub(super) scatter_e: f64,
    /// Light of the star above what is around it, electrons.
    pub(super) light_e: f64,
}

/// The frames of `group`, a channel whose scene is `scene`, with a star to use; `rows` has the
/// reasons of the others.
pub(super) fn usable<'a>(group: &'a [Calibrated<'a>], scene: &Scene, rows: &mut [LogRow]) -> Vec<StarFrame<'a>> {
    let shape = scene.image.frame_shape();
    let mut found: Vec<StarFrame> =
        group.iter().filter_map(|frame| find(frame, shape, &mut rows[frame.index])).collect();
    // A flat is brighter than a detector counts, and a star that saturates it no measure of the
    // light of others: in this order.
    reject(&mut found, rows, |one, alike| {
        rejection::other_background(
            one.background_e,
            alike.map(|other| (other.background_e, other.scatter_e)).collect(),
        )
    });
    for one in &found {
        let (frame, row) = (one.frame.frame, &mut rows[one.frame.index]);
        let saturation_adu = scene.image.saturation_adu.or(frame.header.saturation_adu);
        let bad = one.frame.electrons.mapv(|electrons| !electrons.is_finite());
        let (peak_adu, reason) = rejection::saturation(frame, &bad, one.part, saturation_adu);
        row.peak_adu = peak_adu;
        reason.into_iter().for_each(|reason| row.reject(reason));
    }
    found.retain(|one| rows[one.frame.index].reason.is_empty());
    reject(&mut found, rows, |one, alike| rejection::faint(one.light_e, alike.map(|other| other.light_e).collect()));
    let left: Vec<usize> = found.iter().map(|one| one.frame.index).collect();
    rejection::reject_trailed(rows, &left);
    found.retain(|one| rows[one.frame.index].reason.is_empty());
    found
}

/// Looks for the star of a frame; `None`, with the reason in `row`, where there is none to use.
fn find<'a>(frame: &'a Calibrated<'a>, shape: (usize, usize), row: &mut LogRow) -> Option<StarFrame<'a>> {
    let spot = star::find(&frame.electrons, shape.0.max(shape.1));
    if let Some(reason) = rejection::starless(spot) {
        row.reject(reason);
        return None;
    }
    let spot = spot?;
    let star = (spot.x, spot.y);
    (row.x, row.y, row.elongation) = (spot.x, spot.y, spot.elongation);
    let part = CutOut::about(star, shape, frame.electrons.dim()).map_err(|reason| row.reject(reason)).ok()?;
    let around = outside(&frame.electrons, part);
    let (background_e, scatter_e) = (median(&around), scatter(around.into_iter()));
    row.background_e = background_e;
    Some(StarFrame { frame, star, part, background_e, scatter_e, light_e: spot.light_e })
}

/// Rejects the frames that are not like those of their filter and exposure, themselves included, by
/// `reason`: no card names every dark and flat. Those that the user names are not doubted.
fn reject(
    found: &mut Vec<StarFrame>,
    rows: &mut [LogRow],
    reason: impl Fn(&StarFrame, &mut dyn Iterator<Item = &StarFrame>) -> Option<String>,
) {
    for one in found.iter().filter(|one| !one.frame.frame.is_listed) {
        let alike = &mut found.iter().filter(|other| one.frame.is_alike(other.frame));
        reason(one, alike).into_iter().for_each(|reason| rows[one.frame.index].reject(reason));
    }
    found.retain(|one| rows[one.frame.index].reason.is_empty());
}

/// The good pixels outside of a cut-out; all of them where there are too few for a median.
fn outside(map: &Array2<f64>, part: CutOut) -> Vec<f64> {
    const ENOUGH: usize = 100;
    let good = map.indexed_iter().filter(|(_, value)| value.is_finite());
    let outside: Vec<f64> =
        good.clone().filter(|((y, x), _)| !part.contains(*y, *x)).map(|(_, value)| *value).collect();
    if outside.len() >= ENOUGH { outside } else { good.map(|(_, value)| *value).collect() }
}

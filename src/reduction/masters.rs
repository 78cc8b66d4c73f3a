//! Master darks and flats, and the bad pixels that they show.

use super::classify::FrameClass;
use super::frame::{FrameHeader, RawFrame};
use super::log::LogRow;
use super::noise::{clipped_scatter, median_variance, scatter};
use crate::statistics::median;
use ndarray::{Array2, Zip, s};

/// Deviations of a pixel from its surroundings, in robust standard deviations, from which it is
/// bad. Of a million pixels with normal noise none is by chance (6e-16 each); the pixels of real
/// detectors have wider tails, and lose their worst part.
const OUTLIER: f64 = 8.0;
/// Responses relative to the surroundings that are accepted. Dust and gradients within 50 % are
/// what a flat is for.
const RESPONSES: [f64; 2] = [0.5, 1.5];
/// Least scatters of a dark, in counts, and of a flat: the median of whole counts may not scatter
/// at all.
const LEAST_SPREAD_ADU: f64 = 0.3;
const LEAST_SPREAD: f64 = 1e-3;
/// Least response relative to the median of the flat: the vignetted part of a field is no detector.
const LEAST_RESPONSE: f64 = 0.1;

/// Dark signal of one coadd.
pub(super) struct Dark {
    /// Counts of one coadd, `[y, x]`.
    pub(super) counts: Array2<f64>,
    /// Number of frames behind it.
    pub(super) frames: usize,
    /// Header of a frame behind it.
    header: FrameHeader,
    /// Read noise of one coadd, with the noise of the dark current: from the differences of frames,
    /// counts RMS; `None` of one frame.
    pub(super) read_noise_adu: Option<f64>,
    /// Variance of `counts` over that of one coadd.
    pub(super) variance: f64,
}

/// Pixel responses, median 1.
pub(super) struct Flat {
    pub(super) response: Array2<f64>,
    pub(super) filter: String,
}

/// Median over frames, `[y, x]`: cosmic rays and stars in a few of them have no effect. NaN where
/// no frame has a value.
pub(super) fn median_of(frames: &[Array2<f64>]) -> Array2<f64> {
    let Some(first) = frames.first() else { return Array2::zeros((0, 0)) };
    let mut out = Array2::zeros(first.dim());
    Zip::indexed(&mut out).par_for_each(|(y, x), out| {
        let values: Vec<f64> = frames.iter().map(|frame| frame[[y, x]]).filter(|value| value.is_finite()).collect();
        *out = median(&values);
    });
    out
}

/// A frame over its coadds, NaN where it is bad.
pub(super) fn of_one_coadd(frame: &RawFrame) -> Array2<f64> {
    let mut counts = &frame.data / frame.coadds();
    Zip::from(&mut counts).and(&frame.bad).for_each(|counts, bad| {
        if *bad {
            *counts = f64::NAN;
        }
    });
    counts
}

/// The darks, one for each integration time and read mode.
pub(super) fn darks(frames: &[RawFrame], rows: &mut [LogRow]) -> Vec<Dark> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (index, frame) in frames.iter().enumerate().filter(|(_, frame)| frame.class == FrameClass::Dark) {
        if !rows[index].reason.is_empty() {
            continue;
        }
        rows[index].accept(format!("dark {}", frame.header.exposure()));
        match groups.iter_mut().find(|group| frames[group[0]].header.has_exposure_of(&frame.header)) {
            Some(group) => group.push(index),
            None => groups.push(vec![index]),
        }
    }
    let of_group = |group: &Vec<usize>| {
        let each: Vec<Array2<f64>> = group.iter().map(|&index| of_one_coadd(&frames[index])).collect();
        let coadds = group.iter().map(|&index| frames[index].coadds()).sum::<f64>() / group.len() as f64;
        let differences: Vec<f64> =
            each.windows(2).map(|pair| clipped_scatter((&pair[1] - &pair[0]).iter().copied())).collect();
        let read_noise_adu = (!differences.is_empty()).then(|| median(&differences) / 2f64.sqrt() * coadds.sqrt());
        let counts = median_of(&each);
        let variance = median_variance(group.len()) / coadds;
        Dark { counts, frames: group.len(), header: frames[group[0]].header.clone(), read_noise_adu, variance }
    };
    groups.iter().map(of_group).collect()
}

/// The dark that belongs to a frame: of its integration time and read mode. The counts of coadds
/// are summed, so the number of coadds may differ; the bias of a detector, which does not grow with
/// time, forbids to scale the time.
pub(super) fn dark_of<'a>(darks: &'a [Dark], frame: &RawFrame) -> Option<&'a Dark> {
    darks.iter().find(|dark| dark.header.has_exposure_of(&frame.header))
}

/// The integration times of `darks`, for messages.
pub(super) fn exposures(darks: &[Dark]) -> String {
    darks.iter().map(|dark| dark.header.exposure()).collect::<Vec<_>>().join(", ")
}

/// The flats, one for each filter, with warnings. The dark signal of a flat is that of frames with
/// the lamp off, else a dark's.
pub(super) fn flats(frames: &[RawFrame], darks: &[Dark], rows: &mut [LogRow], warnings: &mut Vec<String>) -> Vec<Flat> {
    let filter = |frame: &RawFrame| frame.header.filter.clone().unwrap_or_default();
    let with = |class: FrameClass| frames.iter().enumerate().filter(move |(_, frame)| frame.class == class);
    let mut made: Vec<(String, Vec<Array2<f64>>)> = Vec::new();
    let mut without_dark = 0;
    for (index, frame) in with(FrameClass::Flat) {
        if !rows[index].reason.is_empty() {
            continue;
        }
        let is_its_own = |other: &&(usize, &RawFrame)| {
            filter(other.1) == filter(frame) && other.1.header.has_exposure_of(&frame.header)
        };
        let off: Vec<usize> =
            with(FrameClass::LampOff).filter(|other| is_its_own(&other)).map(|other| other.0).collect();
        let mut counts = of_one_coadd(frame);
        if !off.is_empty() {
            let each: Vec<Array2<f64>> = off.iter().map(|&other| of_one_coadd(&frames[other])).collect();
            counts -= &median_of(&each);
            off.iter().for_each(|&other| rows[other].accept("lamp off, of a flat"));
        } else if let Some(dark) = dark_of(darks, frame) {
            counts -= &dark.counts;
        } else {
            without_dark += 1;
        }
        let level = median(&counts.iter().copied().filter(|value| value.is_finite()).collect::<Vec<_>>());
        if level.is_nan() || level <= 0.0 {
            rows[index].reject(format!("no light: its median is {level:.1} counts above the dark"));
            continue;
        }
        rows[index].accept(format!("flat, {level:.0} counts in one coadd"));
        counts /= level;
        match made.iter_mut().find(|(known, _)| *known == filter(frame)) {
            Some((_, group)) => group.push(counts),
            None => made.push((filter(frame), vec![counts])),
        }
    }
    if without_dark > 0 {
        warnings.push(format!(
            "{without_dark} flats have neither a dark of their integration time nor frames with the lamp off: their bias lowers the \
             pixel responses"
        ));
    }
    let of_group = |(filter, group): (String, Vec<Array2<f64>>)| Flat { response: median_of(&group), filter };
    made.into_iter().map(of_group).collect()
}

/// Pixels of a dark that deviate from their surroundings.
pub(super) fn bad_in_dark(dark: &Dark) -> Array2<bool> {
    outliers(&(&dark.counts - &surroundings(&dark.counts)), LEAST_SPREAD_ADU)
}

/// Pixels of a flat that respond otherwise than their surroundings, or not.
pub(super) fn bad_in_flat(flat: &Flat) -> Array2<bool> {
    let relative = &flat.response / &surroundings(&flat.response);
    let mut bad = outliers(&(&relative - 1.0), LEAST_SPREAD);
    Zip::from(&mut bad).and(&relative).and(&flat.response).for_each(|bad, relative, response| {
        let is_accepted = (RESPONSES[0]..=RESPONSES[1]).contains(relative) && *response >= LEAST_RESPONSE;
        *bad |= !is_accepted;
    });
    bad
}

/// Pixels whose deviation exceeds [`OUTLIER`] times the scatter of all, which is at least `least`.
fn outliers(deviation: &Array2<f64>, least: f64) -> Array2<bool> {
    let limit = OUTLIER * scatter(deviation.iter().copied()).max(least);
    deviation.mapv(|deviation| deviation.is_nan() || deviation.abs() > limit)
}

/// Median of the 5×5 pixels about each one, without itself.
fn surroundings(map: &Array2<f64>) -> Array2<f64> {
    let (rows, columns) = map.dim();
    let mut out = Array2::zeros(map.dim());
    Zip::indexed(&mut out).par_for_each(|(y, x), out| {
        let (top, left) = (y.saturating_sub(2), x.saturating_sub(2));
        let part = map.slice(s![top..(y + 3).min(rows), left..(x + 3).min(columns)]);
        let near = part.indexed_iter().filter(|((j, i), value)| (j + top, i + left) != (y, x) && value.is_finite());
        *out = median(&near.map(|(_, value)| *value).collect::<Vec<_>>());
    });
    out
}

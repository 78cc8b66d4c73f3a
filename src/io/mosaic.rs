//! A detector that is read by several amplifiers, an image HDU each: the cards `DETSEC` (the part
//! of the detector, unbinned pixels; `CCDSEC`, that of one chip, where there is none) and `DATASEC`
//! (the illuminated part of the HDU) put them together, `BIASSEC` (overscan) gives the bias of
//! each.

use super::header;
use super::layout::HduKind;
use super::mask::BADPIX;
use super::read::FitsReader;
use super::{Quantity, card};
use crate::Result;
use crate::statistics::median;
use ndarray::{Array2, Array3, Axis, s};

/// Names of image HDUs that go with an image: its uncertainty, quality, weight and what was derived
/// from it.
const COMPANIONS: [&str; 25] = [
    "ERR",
    "DQ",
    "VAR",
    "UNCERT",
    "MASK",
    BADPIX,
    "WHT",
    "WEIGHT",
    "AREA",
    "CON",
    "VAR_POISSON",
    "VAR_RNOISE",
    "VAR_FLAT",
    "SAMP",
    "TIME",
    "SIGMA",
    "EXP",
    "IVAR",
    "NOISE",
    "BKG",
    "FLAT",
    "DARK",
    "SKY",
    "PSF",
    "QUALITY",
];

/// HDUs of cophase beside its images, which are read for themselves.
const OURS: [&str; 4] = ["TRUTH_", "SLOPES", "MOVED_", "SCENE"];

/// Pixels from 0 along an axis: the first, and the one behind the last; whether the section counts
/// down.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Range {
    from: usize,
    to: usize,
    is_reversed: bool,
}

impl Range {
    fn len(&self) -> usize {
        self.to - self.from
    }
}

/// Columns and rows of a section `[x1:x2,y1:y2]`, which counts from 1.
fn section(text: &str) -> Option<[Range; 2]> {
    let (x, y) = text.trim().strip_prefix('[')?.strip_suffix(']')?.split_once(',')?;
    let range = |text: &str| {
        let (one, other) = text.split_once(':')?;
        let ends: [usize; 2] = [one.trim().parse().ok()?, other.trim().parse().ok()?];
        let (from, to) = (ends[0].min(ends[1]), ends[0].max(ends[1]));
        Some(Range { from: from.checked_sub(1)?, to, is_reversed: ends[0] > ends[1] })
    };
    Some([range(x)?, range(y)?])
}

/// An amplifier's HDU.
struct Part {
    index: usize,
    detector: [Range; 2],
    data: [Range; 2],
    bias: Option<[Range; 2]>,
}

/// Images of a detector that were put together.
pub(super) struct Mosaic {
    /// HDU of the first amplifier, whose cards are those of all.
    pub index: usize,
    /// `[1, y, x]`, in the counts of the first amplifier; NaN where no amplifier reads.
    pub data: Array3<f64>,
    /// What was done.
    pub remark: String,
}

/// The images of `file` put together; `None` where they are not the amplifiers of one detector.
pub(super) fn assembled(file: &mut FitsReader) -> Result<Option<Mosaic>> {
    let Some(parts) = parts(file) else { return Ok(None) };
    let end = |axis: usize| parts.iter().map(|part| part.detector[axis].to).max().unwrap_or(0);
    let start = |axis: usize| parts.iter().map(|part| part.detector[axis].from).min().unwrap_or(0);
    let ([left, low], [right, top]) = ([start(0), start(1)], [end(0), end(1)]);
    // A mosaic of many detectors with gaps between them is no single image.
    let covered: usize = parts.iter().map(|part| part.detector[0].len() * part.detector[1].len()).sum();
    if 2.0 * (covered as f64) < (right - left) as f64 * (top - low) as f64 {
        return Ok(None);
    }
    let mut data = Array2::from_elem((top - low, right - left), f64::NAN);
    let (mut names, mut has_bias, mut first_gain) = (Vec::new(), true, None);
    for part in &parts {
        let whole = file.cube_at(part.index)?.index_axis_move(Axis(0), 0);
        let of = |[x, y]: [Range; 2]| whole.slice(s![y.from..y.to, x.from..x.to]);
        let bias: Option<Vec<f64>> = part.bias.map(|bias| of(bias).iter().copied().filter(|v| v.is_finite()).collect());
        let bias = bias.filter(|bias| !bias.is_empty()).map(|bias| median(&bias));
        has_bias &= bias.is_some();
        let facts = header::facts(file, part.index)?.facts;
        let gain = facts.iter().find(|fact| fact.quantity == Quantity::GainEPerAdu).map_or(1.0, |fact| fact.values[0]);
        let relative = gain / *first_gain.get_or_insert(gain);
        let relative = if relative.is_finite() && relative > 0.0 { relative } else { 1.0 };
        let mut own = of(part.data).mapv(|value| (value - bias.unwrap_or(0.0)) * relative);
        for (axis, of_data, of_detector) in [(1, part.data[0], part.detector[0]), (0, part.data[1], part.detector[1])] {
            if of_data.is_reversed != of_detector.is_reversed {
                own.invert_axis(Axis(axis));
            }
        }
        let [x, y] = part.detector;
        data.slice_mut(s![y.from - low..y.to - low, x.from - left..x.to - left]).assign(&own);
        names.push(file.described(part.index));
    }
    let bias = if has_bias { ", less the median of its overscan (BIASSEC)" } else { "" };
    let remark = format!(
        "The image was put together from {} by their cards DETSEC (or CCDSEC) and DATASEC{bias}.",
        names.join(", ")
    );
    Ok(Some(Mosaic { index: parts[0].index, data: data.insert_axis(Axis(0)), remark }))
}

/// The amplifiers; `None` unless at least two image HDUs have sections that fit, and none overlaps
/// another.
fn parts(file: &FitsReader) -> Option<Vec<Part>> {
    let images = others(file, None).into_iter().filter(|&index| !is_companion(file, index));
    let parts: Vec<Part> = images.map(|index| part(file, index)).collect::<Option<_>>()?;
    let overlaps = |a: Range, b: Range| a.from < b.to && b.from < a.to;
    let clash = |a: &Part, b: &Part| (0..2).all(|axis| overlaps(a.detector[axis], b.detector[axis]));
    let is_free = parts.iter().enumerate().all(|(at, part)| parts[..at].iter().all(|other| !clash(part, other)));
    (parts.len() > 1 && is_free).then_some(parts)
}

fn part(file: &FitsReader, index: usize) -> Option<Part> {
    let hdu = &file.layout.hdus[index];
    let [columns, rows] = hdu.axes[..] else { return None };
    let text = |key: &str| hdu.value(key).map(card::text);
    let whole = [columns, rows].map(|size| Range { from: 0, to: size as usize, is_reversed: false });
    let data = text("DATASEC").map_or(Some(whole), |text| section(&text))?;
    let bias = text("BIASSEC").and_then(|text| section(&text));
    let fits = |section: &[Range; 2]| (0..2).all(|axis| section[axis].to <= whole[axis].to);
    let binning: Vec<usize> =
        text("CCDSUM").map(|text| text.split_whitespace().filter_map(|n| n.parse().ok()).collect()).unwrap_or_default();
    let mut detector = section(&text("DETSEC").or_else(|| text("CCDSEC"))?)?;
    for (axis, range) in detector.iter_mut().enumerate() {
        let bin = binning.get(axis).copied().unwrap_or(1).max(1);
        (range.from, range.to) = (range.from / bin, range.from / bin + range.len() / bin);
    }
    let is_same = (0..2).all(|axis| detector[axis].len() == data[axis].len());
    (is_same && fits(&data)).then_some(Part { index, detector, data, bias: bias.filter(fits) })
}

/// The image HDUs with data beside the HDU `read` and cophase's own.
fn others(file: &FitsReader, read: Option<usize>) -> Vec<usize> {
    let hdus = &file.layout.hdus;
    let is_image = |index: &usize| hdus[*index].kind == HduKind::Image && !hdus[*index].axes.is_empty();
    let is_ours = |index: &usize| OURS.iter().any(|ours| hdus[*index].name.starts_with(ours));
    (0..hdus.len()).filter(|index| Some(*index) != read && is_image(index) && !is_ours(index)).collect()
}

fn is_companion(file: &FitsReader, index: usize) -> bool {
    COMPANIONS.contains(&file.layout.hdus[index].name.as_str())
}

/// Notes and remarks on the image HDUs beside `read` that are not read: another image of its shape
/// may be the one that is meant.
pub(super) fn unread(file: &FitsReader, read: usize) -> (Option<String>, Option<String>) {
    let plane = |index: usize| file.layout.hdus[index].axes.iter().take(2).copied().collect::<Vec<_>>();
    let others: Vec<usize> =
        others(file, Some(read)).into_iter().filter(|&index| file.layout.hdus[index].name != BADPIX).collect();
    let (equals, rest): (Vec<usize>, Vec<usize>) =
        others.into_iter().partition(|&index| plane(index) == plane(read) && !is_companion(file, index));
    let names = |which: &[usize]| which.iter().map(|&index| file.described(index)).collect::<Vec<_>>().join(", ");
    let own = file.described(read);
    let note = (!equals.is_empty()).then(|| {
        format!("of the images in the file {own} alone was read, and not {}: FILE[HDU] names another", names(&equals))
    });
    let remark =
        (!rest.is_empty()).then(|| format!("Of the images in the file {own} was read; {} was not used.", names(&rest)));
    (note, remark)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sections_count_from_one_and_may_count_down() {
        let range = |from, to, is_reversed| Range { from, to, is_reversed };
        assert_eq!(section("[1:256,1:512]"), Some([range(0, 256, false), range(0, 512, false)]));
        assert_eq!(section(" [512:257, 1024:1] "), Some([range(256, 512, true), range(0, 1024, true)]));
        for wrong in ["", "[1:2]", "[0:2,1:2]", "1:2,1:2", "[a:2,1:2]"] {
            assert_eq!(section(wrong), None, "{wrong}");
        }
    }
}

//! Images in one HDU, with their bad pixels and what its cards state.

use std::path::Path;

use ndarray::Array3;

use super::header::{self, Facts, HeaderFact, PixelUnit};
use super::mask::{self, MaskFile};
use super::read::FitsReader;
use super::value::Card;
use crate::{Error, Result};

/// Card with the name of the channel that images are of.
pub const CHANNEL: &str = "CHANNEL";

/// Images as they were read, in the unit of the file.
#[derive(Debug, Clone)]
pub struct HduImages {
    /// Card `CHANNEL`: the channel that they are of.
    pub channel: Option<String>,
    /// `[image, y, x]`. Pixels that are not finite are kept as read; `BLANK` pixels are NaN.
    pub data: Array3<f64>,
    /// `[image, y, x]`: true for pixels that are not finite or that are marked in `BADPIX` or in
    /// the mask file.
    pub bad: Array3<bool>,
    /// Card `RON_E` of the image HDU, else of the primary HDU: read noise per pixel, electrons RMS.
    pub read_noise_e: Option<f64>,
    /// Card `BUNIT` of the image HDU, else of a primary HDU without an image: unit of the pixels.
    pub unit: PixelUnit,
    /// What the cards of the image HDU, else of the primary HDU, state of the instrument.
    pub facts: Vec<HeaderFact>,
    /// Number of pixels that are not finite and that nothing marks.
    pub non_finite: usize,
    /// Name of the HDU of the images.
    pub hdu_name: String,
    /// Its `EXTVER`; where it has none, its place from 1 among the HDUs `IMAGES` that are read.
    pub version: i64,
    /// Repairs of a file that is not standard FITS, or of the mask file, as one sentence.
    pub repaired: Option<String>,
    /// What the file has besides the images that is not used, a sentence each.
    pub notes: Vec<String>,
    /// What a user should know without doubting the images, a sentence each: cards that are not
    /// read, other HDUs.
    pub remarks: Vec<String>,
}

/// Reads the images in HDU `index` of `file`, which are at `place` among those that are read, with
/// the bad pixels in its HDU `marks` and in the file `mask`.
pub(super) fn read_hdu(
    file: &mut FitsReader,
    (place, index): (usize, usize),
    marks: Option<usize>,
    mask: Option<&Path>,
) -> Result<HduImages> {
    let data = file.cube_at(index)?;
    of_data(file, (place, index), data, marks, mask)
}

/// As [`read_hdu`], of images whose pixels are `data` and whose cards are those of HDU `index`.
pub(super) fn of_data(
    file: &mut FitsReader,
    (place, index): (usize, usize),
    data: Array3<f64>,
    marks: Option<usize>,
    mask: Option<&Path>,
) -> Result<HduImages> {
    let mut bad = Array3::from_elem(data.dim(), false);
    let mut repaired = file.repaired();
    if let Some(marks) = marks {
        mask::mark(file, (marks, None), &mut bad)?;
    }
    if let Some(path) = mask {
        let mut mask = MaskFile::open(path)?;
        mask.mark(&mut bad)?;
        let mask_repairs = mask.file.repaired().map(|sentence| format!("in the mask {}, {sentence}", path.display()));
        repaired = [repaired, mask_repairs].into_iter().flatten().reduce(|both, more| format!("{both}; {more}"));
    }
    let mut non_finite = 0;
    bad.zip_mut_with(&data, |is_bad, value| {
        non_finite += usize::from(!*is_bad && !value.is_finite());
        *is_bad |= !value.is_finite();
    });
    let read_noise_e = read_noise(file, index)?;
    let (unit, Facts { facts, unread }) = (header::unit(file, index)?, header::facts(file, index)?);
    let channel = match file.card_at(index, CHANNEL)? {
        Some(Card::Text(name)) => Some(name.trim().to_owned()),
        other => other.map(|card| card.to_string()),
    };
    let hdu_name = file.name_of(index).to_string();
    let version = file.version_of(index).unwrap_or(place as i64 + 1);
    Ok(HduImages {
        channel,
        data,
        bad,
        read_noise_e,
        unit,
        facts,
        non_finite,
        hdu_name,
        version,
        repaired,
        notes: Vec::new(),
        remarks: unread,
    })
}

/// Card `RON_E` of the HDU at `index`, else of the primary HDU.
fn read_noise(file: &mut FitsReader, index: usize) -> Result<Option<f64>> {
    let card = match file.card_at(index, "RON_E")? {
        None => file.card_at(0, "RON_E")?,
        found => found,
    };
    let Some(card) = card else { return Ok(None) };
    let number = match &card {
        Card::Integer(n) => Some(*n as f64),
        Card::Real(x) => Some(*x),
        Card::Text(text) => text.trim().parse().ok(),
        Card::Logical(_) => None,
    };
    let accepted = number.filter(|x: &f64| x.is_finite() && *x >= 0.0);
    let refused = || -> Error {
        file.refuse(format!("the card RON_E is {card}, where a read noise of 0 or more electrons is needed"))
    };
    accepted.map(Some).ok_or_else(refused)
}

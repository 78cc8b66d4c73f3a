//! Masks of bad pixels: which pixels of an image HDU are marked, and masks that cannot be meant so.
//!
//! A value other than 0 marks a pixel. In the data quality planes of space telescopes (`DQ`) a
//! value is a sum of flags, most of which only inform; `dq.fits[DQ&1]` names those that mean bad by
//! their sum.

use super::layout::HduKind;
use super::read::FitsReader;
use crate::{Error, Result};
use ndarray::{Array2, Array3, ArrayView2, Axis, Zip};
use std::path::{Path, PathBuf};

/// Name of the HDU with bad pixels.
pub(super) const BADPIX: &str = "BADPIX";

/// Largest share of pixels that a mask may mark: what is left of an image of 64 pixels then has 14
/// on a side.
pub const MOST_MARKED: f64 = 0.95;
/// The same for values that are sums of flags: detectors have 0.2 to 2 % of bad pixels.
const MOST_FLAGGED: f64 = 0.2;
/// Flags that are named in a message, those of most pixels first.
const NAMED: usize = 6;

/// Mask in a file of its own.
pub(super) struct MaskFile {
    pub file: FitsReader,
    /// HDU of the marks.
    index: usize,
    /// Sum of the flags that mean bad; `None` for any.
    flags: Option<u64>,
}

impl MaskFile {
    /// The mask in `path`: the HDU in brackets behind its name, with the flags behind `&`, else its
    /// HDU `BADPIX`, else its first image.
    pub fn open(path: &Path) -> Result<Self> {
        let (plain, flags) = split_flags(path)?;
        let file = FitsReader::open(plain)?;
        let index = match file.selected_image()? {
            Some(selected) => selected,
            None if file.has(BADPIX) => file.find(BADPIX, HduKind::Image)?,
            None => file.first_image(&[])?,
        };
        Ok(Self { file, index, flags })
    }

    /// Adds its bad pixels to `bad`.
    pub fn mark(&mut self, bad: &mut Array3<bool>) -> Result<()> {
        mark(&mut self.file, (self.index, self.flags), bad)
    }
}

/// The bad pixels of a detector, `[y, x]`, in the FITS file `path`, which may be named as
/// `FILE[HDU]` or `FILE[HDU&FLAGS]`.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read, a mask that is not 2-D, and one that marks
/// nearly everything.
pub fn read_mask(path: &Path) -> Result<Array2<bool>> {
    let MaskFile { mut file, index, flags } = MaskFile::open(path)?;
    let marks = marks(&mut file, index, flags)?;
    if marks.dim().0 != 1 {
        return Err(file.refuse(format!("the mask has {} planes, where one is accepted", marks.dim().0)));
    }
    Ok(marks.index_axis_move(Axis(0), 0))
}

/// Adds the bad pixels marked in the image at `index` of `file`, by any of `flags` where they are
/// given, to `bad`.
pub(super) fn mark(file: &mut FitsReader, (index, flags): (usize, Option<u64>), bad: &mut Array3<bool>) -> Result<()> {
    let marks = marks(file, index, flags)?;
    let (images, height, width) = bad.dim();
    if marks.dim() == bad.dim() {
        Zip::from(bad).and(&marks).for_each(|bad, &mark| *bad |= mark);
        return Ok(());
    }
    if marks.dim() != (1, height, width) {
        let name = file.name_of(index);
        return Err(file.refuse(format!(
            "the mask {name} has the shape {:?}, where ({height}, {width}) or ({images}, {height}, {width}) is accepted",
            marks.dim()
        )));
    }
    let marks: ArrayView2<bool> = marks.index_axis(Axis(0), 0);
    for image in bad.axis_iter_mut(Axis(0)) {
        Zip::from(image).and(marks).for_each(|bad, &mark| *bad |= mark);
    }
    Ok(())
}

/// The marked pixels of the image at `index`, `[image, y, x]`.
fn marks(file: &mut FitsReader, index: usize, flags: Option<u64>) -> Result<Array3<bool>> {
    let values = file.cube_at(index)?;
    let marks = match flags {
        None => values.mapv(|value| value != 0.0),
        Some(flags) => values.mapv(|value| flags_of(value).is_none_or(|own| own & flags != 0)),
    };
    let share = marks.iter().filter(|mark| **mark).count() as f64 / marks.len().max(1) as f64;
    let known = values.iter().copied().filter(|value| *value != 0.0);
    let one = known.clone().next();
    let is_of_flags =
        known.clone().all(|value| flags_of(value).is_some()) && known.clone().any(|value| Some(value) != one);
    let most = if is_of_flags && flags.is_none() { MOST_FLAGGED } else { MOST_MARKED };
    if share <= most {
        return Ok(marks);
    }
    let what = file.name_of(index).to_owned();
    let percent = 100.0 * share;
    Err(file.refuse(if is_of_flags || flags.is_some() {
        let counted = counted_flags(&values);
        format!(
            "the mask {what} marks {percent:.1} % of the pixels, by flags ({counted}): the sum of those that mean a bad pixel is needed \
             behind the name of the HDU, as FILE[{what}&1]"
        )
    } else {
        format!(
            "the mask {what} marks {percent:.1} % of the pixels: values other than 0 mark a bad pixel, and at most {} % are accepted; in a \
             map of good pixels 0 and 1 must change places",
            100.0 * MOST_MARKED
        )
    }))
}

/// A value as a sum of flags.
fn flags_of(value: f64) -> Option<u64> {
    // 2^53: beyond, an f64 does not represent every integer.
    (value >= 0.0 && value.fract() == 0.0 && value <= 9_007_199_254_740_992.0).then_some(value as u64)
}

/// The flags with the share of pixels that have them, those of most pixels first.
fn counted_flags(values: &Array3<f64>) -> String {
    let mut counts = [0usize; 64];
    for flags in values.iter().filter_map(|value| flags_of(*value)).filter(|flags| *flags != 0) {
        counts.iter_mut().enumerate().for_each(|(bit, count)| *count += (flags >> bit & 1) as usize);
    }
    let mut there: Vec<(usize, usize)> = counts.into_iter().enumerate().filter(|(_, count)| *count > 0).collect();
    there.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
    let share = |count: usize| 100.0 * count as f64 / values.len() as f64;
    let named = there.iter().take(NAMED).map(|(bit, count)| format!("{}: {:.1} %", 1u64 << bit, share(*count)));
    named.collect::<Vec<_>>().join(", ")
}

/// The path without the flags behind `&` in its brackets, and the flags.
fn split_flags(path: &Path) -> Result<(PathBuf, Option<u64>)> {
    let parts = path.to_str().filter(|_| !path.exists()).and_then(|text| text.strip_suffix(']')?.rsplit_once('&'));
    let Some((before, flags)) = parts else { return Ok((path.to_path_buf(), None)) };
    let flags = flags.trim().parse().ok().filter(|flags| *flags > 0u64).ok_or_else(|| {
        Error::file(
            path,
            format_args!("the flags `{flags}` behind & are no sum of flags: a whole number above 0 is accepted"),
        )
    })?;
    let plain = before.strip_suffix('[').map_or_else(|| format!("{before}]"), str::to_owned);
    Ok((plain.into(), Some(flags)))
}

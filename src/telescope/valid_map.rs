//! Maps of the subapertures or actuators in use: text with lines of 0s and 1s, smallest y first, or a FITS image.

use crate::io::{FitsReader, is_fits, read_text};
use crate::modes::marked_cells;
use crate::{Error, Result};
use std::path::Path;

/// Reads the marked cells `row·across + column`, ascending. In a FITS image, which may be named in brackets behind the file, cells above 0
/// are marked; where it has negative values, which AOT's maps have outside, those from 0 on.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read or is not such a map.
pub fn read(path: &Path, across: usize) -> Result<Vec<usize>> {
    if is_fits(path)? {
        return read_image(path, across);
    }
    let text = read_text(path, "it is a map of cells in use")?;
    marked_cells(&text, across).map_err(|error| Error::file(path, error))
}

fn read_image(path: &Path, across: usize) -> Result<Vec<usize>> {
    let map = FitsReader::open(path)?.map(None)?;
    if map.dim() != (across, across) {
        let (rows, columns) = map.dim();
        let sentence = format_args!("a map of {rows}×{columns} cells was given: {across}×{across} are needed");
        return Err(Error::file(path, sentence));
    }
    let has_numbers = map.iter().any(|value| *value < 0.0);
    let is_marked = |value: f64| value > 0.0 || has_numbers && value == 0.0;
    Ok(map.iter().enumerate().filter(|(_, value)| is_marked(**value)).map(|(cell, _)| cell).collect())
}

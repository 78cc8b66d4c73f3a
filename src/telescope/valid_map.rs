//! Maps of the subapertures or actuators in use: text with lines of 0s and 1s, smallest y first, or
//! a FITS image.

use crate::io::{FitsReader, TextRow, TextTable, is_fits, read_text};
use crate::modes::marked_cells;
use crate::{Error, Result};
use std::path::Path;

/// Reads the marked cells `row·across + column`, ascending. In a FITS image, which may be named in
/// brackets behind the file, cells above 0 are marked; where it has negative values, which AOT's
/// maps have outside, those from 0 on.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read or is not such a map.
pub fn read(path: &Path, across: usize) -> Result<Vec<usize>> {
    if is_fits(path)? {
        return read_image(path, across);
    }
    let text = read_text(path, "it is a map of cells in use")?;
    marked_cells(&plain(text), across).map_err(|error| Error::file(path, error))
}

/// A map with its entries as NumPy and spreadsheets write them, as 0s and 1s; another text is kept.
fn plain(text: String) -> String {
    if !text.contains(['.', ',', ';']) {
        return text;
    }
    let entry = |row: &TextRow, column: usize| row.integer(column).map_or(row.words[column].clone(), |n| n.to_string());
    let line = |row: &TextRow| (0..row.words.len()).map(|column| entry(row, column)).collect::<Vec<_>>().join(" ");
    TextTable::new(&text).rows.iter().map(|row| line(row) + "\n").collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_of_other_programs_are_read() {
        for text in ["0 1\n1 0\n", "01\n10\n", "0.000e+00 1.000e+00\n1.000e+00 0.000e+00\n", "0,1\n1,0\n", "0;1\n1;0\n"]
        {
            assert_eq!(marked_cells(&plain(text.into()), 2).unwrap(), [1, 2], "{text:?}");
        }
        assert!(marked_cells(&plain("0.5,1\n1,0\n".into()), 2).unwrap_err().to_string().contains("0.5"));
    }
}

//! Maps of what is in use: lines of 0s and 1s, smallest y first.

use crate::{Error, Result};
use std::path::Path;

/// Bytes of the largest map that is read: 256 × 256 entries with room to spare.
const LARGEST: u64 = 1 << 20;

/// The marked cells `row·across + column`, ascending.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read or holds something else.
pub fn read(path: &Path, across: usize) -> Result<Vec<usize>> {
    let text = text(path)?;
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).collect();
    if lines.len() != across {
        return Err(Error::file(path, format_args!("the map has {} lines; {across} are needed", lines.len())));
    }
    let mut marked = Vec::new();
    for (row, line) in lines.iter().enumerate() {
        let entries: Vec<&str> = line.split_whitespace().collect();
        if entries.len() != across {
            let text = format!("line {} of the map has {} entries; {across} are needed", row + 1, entries.len());
            return Err(Error::file(path, text));
        }
        for (column, entry) in entries.iter().enumerate() {
            match *entry {
                "0" => {}
                "1" => marked.push(row * across + column),
                other => {
                    let text = format!("line {} of the map holds {other:.20?}; only 0 and 1 are accepted", row + 1);
                    return Err(Error::file(path, text));
                }
            }
        }
    }
    Ok(marked)
}

/// The text of a map.
pub fn text(path: &Path) -> Result<String> {
    let size = std::fs::metadata(path).map_err(|error| Error::file(path, error))?.len();
    if size > LARGEST {
        return Err(Error::file(path, format_args!("{size} bytes are too many for a map; at most {LARGEST} are read")));
    }
    std::fs::read_to_string(path).map_err(|error| Error::file(path, error))
}

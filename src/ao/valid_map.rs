//! Maps of what is in use: lines of 0s and 1s, smallest y first.

use crate::modes::marked_cells;
use crate::{Error, Result};
use std::path::Path;

/// Bytes of the largest map that is read: 256 × 256 entries with room to spare.
const LARGEST: u64 = 1 << 20;

/// The marked cells `row·across + column`, ascending.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read or holds something else.
pub fn read(path: &Path, across: usize) -> Result<Vec<usize>> {
    marked_cells(&text(path)?, across).map_err(|error| Error::file(path, error))
}

/// The text of a map.
pub fn text(path: &Path) -> Result<String> {
    let size = std::fs::metadata(path).map_err(|error| Error::file(path, error))?.len();
    if size > LARGEST {
        return Err(Error::file(path, format_args!("{size} bytes are too many for a map; at most {LARGEST} are read")));
    }
    std::fs::read_to_string(path).map_err(|error| Error::file(path, error))
}

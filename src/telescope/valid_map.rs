//! Maps of the subapertures or actuators in use: lines of 0s and 1s, smallest y first.

use crate::modes::marked_cells;
use crate::{Error, Result};
use std::path::Path;

/// Bytes of the largest map that is read: 256 × 256 entries take at most half of it.
const LARGEST: u64 = 1 << 20;

/// Reads the marked cells `row·across + column`, ascending.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read or is not such a map.
pub fn read(path: &Path, across: usize) -> Result<Vec<usize>> {
    marked_cells(&read_text(path)?, across).map_err(|error| Error::file(path, error))
}

/// Reads the text of a map.
pub fn read_text(path: &Path) -> Result<String> {
    let size = std::fs::metadata(path).map_err(|error| Error::file(path, error))?.len();
    if size > LARGEST {
        return Err(Error::file(
            path,
            format_args!("{size} bytes are too many for a map; at most {LARGEST} are accepted"),
        ));
    }
    std::fs::read_to_string(path).map_err(|error| Error::file(path, error))
}

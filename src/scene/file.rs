//! Files of scenes.

use crate::{Error, Result};
use std::fs::FileType;
use std::io::Read;
use std::os::unix::fs::FileTypeExt;
use std::path::Path;

/// Longest scene file that is read, bytes: some hundred times a preset.
const LONGEST_FILE_BYTES: u64 = 1 << 20;

/// Text of a scene's file, and the type of the file.
///
/// # Errors
/// [`Error::File`] for a directory or a device, a file that is too long, or one that is not a text.
pub(super) fn read_text(path: &Path) -> Result<(String, FileType)> {
    let failed = |error: std::io::Error| Error::file(path, error);
    let kind = std::fs::metadata(path).map_err(failed)?.file_type();
    if !kind.is_file() && !kind.is_fifo() {
        return Err(Error::file(path, "is a directory or a device, where a scene is needed: a regular file or a pipe"));
    }
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(failed)?;
    file.take(LONGEST_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > LONGEST_FILE_BYTES {
        let reason = format!("has more bytes than a scene can have; at most {LONGEST_FILE_BYTES} are accepted");
        return Err(Error::file(path, reason));
    }
    let text = String::from_utf8(bytes).map_err(|error| {
        Error::file(path, format_args!("not a text in UTF-8 (byte {})", error.utf8_error().valid_up_to()))
    })?;
    Ok((text, kind))
}

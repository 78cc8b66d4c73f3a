//! Regular files: what a user or a scene names may be a device without an end, or a pipe that waits
//! for its writer.

use crate::{Error, Result};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Opens a regular file for reading. `wanted` is what is needed in place of a directory or device,
/// with its article.
///
/// # Errors
/// [`Error::File`] for a file that is missing or cannot be opened, and for anything but a regular
/// one.
pub(super) fn open(path: &Path, wanted: &str) -> Result<File> {
    let refused = |error: std::io::Error| match error.kind() {
        std::io::ErrorKind::NotFound => Error::file(path, "there is no such file"),
        _ => Error::file(path, format_args!("cannot be opened: {error}")),
    };
    // Checked before opening: opening a pipe would wait for its writer.
    let metadata = std::fs::metadata(path).map_err(refused)?;
    if metadata.is_dir() {
        return Err(Error::file(path, format_args!("is a directory, where {wanted} is needed")));
    }
    if !metadata.is_file() {
        return Err(Error::file(path, format_args!("is a device or a pipe, where {wanted} is needed: a regular file")));
    }
    File::open(path).map_err(refused)
}

/// Reads a regular file of at most `most` bytes; they are counted, because a device states a length
/// of 0. `wanted` is as for [`open`].
///
/// # Errors
/// As [`open`]; [`Error::File`] for a longer file.
pub(super) fn read_bytes(path: &Path, wanted: &str, most: u64) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = open(path, wanted)?.take(most + 1).read_to_end(&mut bytes);
    read.map_err(|error| Error::file(path, format_args!("cannot be read: {error}")))?;
    if bytes.len() as u64 > most {
        return Err(Error::file(
            path,
            format_args!("has more than {most} bytes; at most that many are accepted for {wanted}"),
        ));
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_folders_and_long_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let long = folder.path().join("long.txt");
        std::fs::write(&long, "0123456789\n").unwrap();
        assert_eq!(read_bytes(&long, "a table", 11).unwrap(), b"0123456789\n");
        for (path, fact) in [
            (Path::new("/dev/zero"), "device"),
            (folder.path(), "directory"),
            (&folder.path().join("absent"), "no such file"),
            (&long, "more than 10 bytes"),
        ] {
            let refused = read_bytes(path, "a table", 10).unwrap_err().to_string();
            assert!(refused.contains(fact) && refused.contains(&path.display().to_string()), "{refused}");
        }
    }
}

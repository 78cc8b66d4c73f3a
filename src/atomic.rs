//! Atomic writes: a file is written under a temporary name in the target's directory, then renamed to the target.

use crate::{Error, Result, fault};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

/// Writes `bytes` to `path`: the whole file appears by a rename, or what was there stays. A symbolic link is followed.
///
/// # Errors
/// [`Error::File`] for a directory, a device, a pipe or a read-only file, or with the operating system's reason.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    Target::new(path)?.write(bytes)
}

/// Target of an atomic write.
pub(crate) struct Target {
    path: PathBuf,
    /// `path` with symbolic links resolved: a rename to a link would replace the link.
    real: PathBuf,
}

impl Target {
    /// Target at `path`.
    ///
    /// # Errors
    /// [`Error::File`] for a directory, a device, a pipe or a read-only file.
    pub(crate) fn new(path: &Path) -> Result<Self> {
        let real = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
        match std::fs::metadata(&real) {
            Ok(metadata) if metadata.is_dir() => Err(Error::file(path, "is a directory; a file name is needed")),
            Ok(metadata) if !metadata.is_file() => {
                Err(Error::file(path, "is a device or a pipe; a regular file is needed"))
            }
            // A rename needs no permission to write the file that it replaces; the user's protection counts all the same.
            Ok(metadata) if metadata.permissions().readonly() => {
                let mode = metadata.permissions().mode() & 0o7777;
                let reason = format!(
                    "exists and is read-only (mode {mode:04o}), and is not replaced: give another name, or make it writable \
                     with chmod u+w"
                );
                Err(Error::file(path, reason))
            }
            _ => Ok(Self { path: path.to_path_buf(), real }),
        }
    }

    fn directory(&self) -> &Path {
        self.real.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
    }

    /// Creates a temporary file in the target's directory; it is removed when dropped.
    ///
    /// # Errors
    /// [`Error::File`] if the directory does not exist or cannot be written.
    pub(crate) fn temporary(&self) -> Result<tempfile::NamedTempFile> {
        let mut builder = tempfile::Builder::new();
        // The permissions of any new file, before the umask.
        builder.prefix(".cophase-").suffix(".tmp").permissions(std::fs::Permissions::from_mode(0o666));
        builder.tempfile_in(self.directory()).map_err(|error| {
            let directory = self.directory().display();
            match error.kind() {
                std::io::ErrorKind::NotFound => {
                    Error::file(&self.path, format!("its directory {directory} does not exist"))
                }
                _ => Error::file(&self.path, format!("its directory {directory} cannot be written: {}", cause(&error))),
            }
        })
    }

    /// Writes `bytes` atomically.
    ///
    /// # Errors
    /// [`Error::File`] with the operating system's reason.
    pub(crate) fn write(&self, bytes: &[u8]) -> Result<()> {
        let failed = |error: std::io::Error| {
            Error::file(&self.path, format!("cannot be written: {}; no partial file is left", cause(&error)))
        };
        let mut temporary = self.temporary()?;
        let (first, second) = bytes.split_at(bytes.len() / 2);
        temporary.write_all(first).map_err(failed)?;
        fault::kill_process(1);
        temporary.write_all(second).map_err(failed)?;
        temporary.as_file().sync_all().map_err(failed)?;
        fault::kill_process(2);
        temporary.persist(&self.real).map_err(|error| failed(error.error))?;
        fault::kill_process(3);
        // Syncing the directory makes the rename durable; not every file system supports it, and the rename is done
        // anyway.
        let _ = std::fs::File::open(self.directory()).and_then(|directory| directory.sync_all());
        Ok(())
    }
}

/// The operating system's reason, without the temporary name that `tempfile` adds.
fn cause(error: &std::io::Error) -> String {
    use std::error::Error;
    error.source().map_or_else(|| error.to_string(), ToString::to_string)
}

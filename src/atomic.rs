//! Files that appear whole or not at all: written under a temporary name beside their target, then renamed onto it.

use crate::{Error, Result, fault};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Writes `bytes` to `path`: the whole file appears by a rename, or what was there stays. A symbolic link is followed.
///
/// # Errors
/// [`Error::File`] for a directory, a device or a pipe, or with the operating system's reason.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    Target::of(path)?.write(bytes)
}

/// Where a finished file goes.
pub(crate) struct Target {
    path: PathBuf,
    /// `path` with symbolic links followed: renaming onto a link would replace the link.
    real: PathBuf,
}

impl Target {
    /// Where `path` leads.
    ///
    /// # Errors
    /// [`Error::File`] for a directory, a device or a pipe.
    pub(crate) fn of(path: &Path) -> Result<Self> {
        let real = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf());
        match std::fs::metadata(&real) {
            Ok(metadata) if metadata.is_dir() => Err(Error::file(path, "is a directory, where a file name is needed")),
            Ok(metadata) if !metadata.is_file() => {
                Err(Error::file(path, "is a device or a pipe: only plain files are replaced"))
            }
            _ => Ok(Self { path: path.to_path_buf(), real }),
        }
    }

    fn directory(&self) -> &Path {
        self.real.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."))
    }

    /// A temporary file beside the target; it is removed when dropped.
    ///
    /// # Errors
    /// [`Error::File`] where the directory is not there or cannot be written.
    pub(crate) fn temporary(&self) -> Result<tempfile::NamedTempFile> {
        use std::os::unix::fs::PermissionsExt;
        let mut builder = tempfile::Builder::new();
        // What a new file gets otherwise: the umask takes its part.
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

    /// Writes `bytes` there, whole or not at all.
    ///
    /// # Errors
    /// [`Error::File`] with the operating system's reason.
    pub(crate) fn write(&self, bytes: &[u8]) -> Result<()> {
        let failed = |error: std::io::Error| {
            Error::file(&self.path, format!("cannot be written: {}; nothing was left behind", cause(&error)))
        };
        let mut temporary = self.temporary()?;
        let (first, second) = bytes.split_at(bytes.len() / 2);
        temporary.write_all(first).map_err(failed)?;
        fault::killed(1);
        temporary.write_all(second).map_err(failed)?;
        temporary.as_file().sync_all().map_err(failed)?;
        fault::killed(2);
        temporary.persist(&self.real).map_err(|error| failed(error.error))?;
        fault::killed(3);
        // The rename is on the disk once the directory is; a file system that cannot do this has still renamed.
        let _ = std::fs::File::open(self.directory()).and_then(|directory| directory.sync_all());
        Ok(())
    }
}

/// The operating system's reason, without the temporary name that `tempfile` adds.
fn cause(error: &std::io::Error) -> String {
    use std::error::Error;
    error.source().map_or_else(|| error.to_string(), ToString::to_string)
}

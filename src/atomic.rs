//! Atomic writes: a file is written under a temporary name in the target's directory, then renamed
//! to the target.

use crate::{Error, Result, fault};
use std::io::Write;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Temporary files of this process that are not renamed yet.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Symbolic links of a path that are followed, as many as Linux follows.
const MOST_LINKS: usize = 40;

/// Writes `bytes` to `path`: the whole file appears by a rename, or what was there stays. A
/// symbolic link is followed.
///
/// # Errors
/// [`Error::File`] for a directory, a device, a pipe or a read-only file, or with the operating
/// system's reason.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    Target::new(path)?.write(bytes)
}

fn unfinished() -> MutexGuard<'static, Vec<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes the files that are not complete, and lets no further one appear: for a process that ends
/// now, while other threads still work. A thread that is about to write waits from then on.
pub fn abandon() {
    static ONCE: AtomicBool = AtomicBool::new(false);
    if ONCE.swap(true, Ordering::SeqCst) {
        return;
    }
    let mut paths = unfinished();
    for path in paths.drain(..) {
        // What is left of a file that cannot be removed has a name that says what it is.
        let _ = if path.is_dir() { std::fs::remove_dir_all(path) } else { std::fs::remove_file(path) };
    }
    std::mem::forget(paths);
}

/// Lets [`abandon`] remove the folder `path`, too, which is temporary.
pub fn abandon_with(path: &Path) {
    unfinished().push(path.to_path_buf());
}

/// Temporary file that [`abandon`] removes, too.
pub(crate) struct Temporary(tempfile::NamedTempFile);

impl Temporary {
    /// Renames the file to `path`.
    fn appear_as(self, path: &Path) -> std::io::Result<()> {
        // Held meanwhile: `abandon` comes before the rename or after it.
        let mut paths = unfinished();
        paths.retain(|known| known != self.0.path());
        self.0.persist(path).map(drop).map_err(|error| error.error)
    }

    /// Removes the file.
    pub(crate) fn discard(self) {
        let mut paths = unfinished();
        paths.retain(|known| known != self.0.path());
        drop(self.0);
    }
}

/// Where a write to `path` goes: symbolic links are followed, also those to a file that is not
/// there yet. A rename to a link would replace the link.
fn behind_links(path: &Path) -> Result<PathBuf> {
    let mut real = path.to_path_buf();
    for _ in 0..MOST_LINKS {
        let Ok(next) = std::fs::read_link(&real) else { return Ok(real) };
        real = real.parent().unwrap_or(Path::new("")).join(next);
    }
    Err(Error::file(path, "is a symbolic link of a circle of links; a file name is needed"))
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
        let real = behind_links(path)?;
        match std::fs::metadata(&real) {
            Ok(metadata) if metadata.is_dir() => Err(Error::file(path, "is a directory; a file name is needed")),
            Ok(metadata) if !metadata.is_file() => {
                Err(Error::file(path, "is a device or a pipe; a regular file is needed"))
            }
            // A rename needs no permission to write the file that it replaces; the user's
            // protection counts all the same.
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
    pub(crate) fn temporary(&self) -> Result<Temporary> {
        let mut builder = tempfile::Builder::new();
        // The permissions of any new file, before the umask.
        builder.prefix(".cophase-").suffix(".tmp").permissions(std::fs::Permissions::from_mode(0o666));
        // Held until the name is in the list: `abandon` misses no file.
        let mut paths = unfinished();
        let made = builder.tempfile_in(self.directory()).map_err(|error| {
            let directory = self.directory().display();
            match error.kind() {
                std::io::ErrorKind::NotFound => {
                    Error::file(&self.path, format!("its directory {directory} does not exist"))
                }
                _ => Error::file(&self.path, format!("its directory {directory} cannot be written: {}", cause(&error))),
            }
        })?;
        paths.push(made.path().to_path_buf());
        Ok(Temporary(made))
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
        let written = temporary.0.write_all(first).and_then(|()| {
            fault::kill_process(1);
            temporary.0.write_all(second)?;
            temporary.0.as_file().sync_all()
        });
        if let Err(error) = written {
            temporary.discard();
            return Err(failed(error));
        }
        fault::kill_process(2);
        temporary.appear_as(&self.real).map_err(failed)?;
        fault::kill_process(3);
        // Syncing the directory makes the rename durable; not every file system supports it, and
        // the rename is done anyway.
        let _ = std::fs::File::open(self.directory()).and_then(|directory| directory.sync_all());
        Ok(())
    }
}

/// The operating system's reason, without the temporary name that `tempfile` adds.
fn cause(error: &std::io::Error) -> String {
    use std::error::Error;
    error.source().map_or_else(|| error.to_string(), ToString::to_string)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_are_written_through() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("store")).unwrap();
        // To a file that is not there yet, by way of another link, relative to the folder of each.
        std::os::unix::fs::symlink("store/second", at("first")).unwrap();
        std::os::unix::fs::symlink("real", at("store/second")).unwrap();
        for text in ["new", "replaced"] {
            write(&at("first"), text.as_bytes()).unwrap();
            assert_eq!(std::fs::read_to_string(at("store/real")).unwrap(), text);
            assert!(at("first").is_symlink() && at("store/second").is_symlink());
        }
        std::os::unix::fs::symlink("b", at("a")).unwrap();
        std::os::unix::fs::symlink("a", at("b")).unwrap();
        let refused = write(&at("a"), b"").unwrap_err().to_string();
        assert!(refused.contains("symbolic link"), "{refused}");
        std::os::unix::fs::symlink("absent/file", at("lost")).unwrap();
        let refused = write(&at("lost"), b"").unwrap_err().to_string();
        assert!(refused.contains("lost") && refused.contains("does not exist"), "{refused}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 5);
    }
}

//! Lock of a store: one watcher at a time. The kernel holds it for the process, so that a killed
//! one leaves none.

use cophase::{Error, Result};
use std::ffi::OsString;
use std::fs::File;
use std::io::{Read, Seek, Write};
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

/// Held until it is dropped. It is on a file of its own beside the store: SQLite has locks of its
/// own on the store itself.
pub struct Lock {
    _file: File,
}

impl Lock {
    /// Takes the lock of the store `path`.
    ///
    /// # Errors
    /// [`Error::File`] where another process has it, with that process's number.
    pub fn take(path: &Path) -> Result<Self> {
        let name = name_of(path);
        let failed = |error: std::io::Error| Error::file(&name, format_args!("cannot be opened: {error}"));
        let mut file =
            File::options().read(true).write(true).create(true).truncate(false).open(&name).map_err(failed)?;
        // SAFETY: a plain system call on a descriptor that is open.
        if unsafe { libc::flock(file.as_raw_fd(), libc::LOCK_EX | libc::LOCK_NB) } != 0 {
            let mut holder = String::new();
            // The number is for the sentence only.
            let _ = file.read_to_string(&mut holder);
            let holder = holder.trim();
            let holder = if holder.is_empty() { "another process".into() } else { format!("process {holder}") };
            return Err(Error::file(
                path,
                format_args!(
                    "is in use by another cophase watch ({holder}): stop it, or name another file with --state"
                ),
            ));
        }
        // As above: a full disk does not hinder the lock.
        let _ = file.set_len(0).and_then(|()| file.rewind()).and_then(|()| write!(file, "{}", std::process::id()));
        Ok(Self { _file: file })
    }
}

fn name_of(path: &Path) -> PathBuf {
    let mut name = OsString::from(path);
    name.push(".lock");
    name.into()
}

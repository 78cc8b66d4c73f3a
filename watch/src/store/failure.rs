//! Errors of SQLite as ours.

use cophase::Error;
use std::path::Path;

/// An error of SQLite about the file `path`, as ours.
pub(super) fn failed(path: &Path) -> impl Fn(rusqlite::Error) -> Error + use<> {
    let path = path.to_path_buf();
    move |error| {
        use rusqlite::ErrorCode::{DiskFull, NotADatabase, SystemIoFailure};
        let reason = match error.sqlite_error_code() {
            Some(NotADatabase) => "is not a database of cophase watch: name another file with --state".to_string(),
            Some(DiskFull | SystemIoFailure) => format!("cannot be written or read: {error} (is the disk full?)"),
            _ => format!("the database failed: {error}"),
        };
        Error::file(&path, reason)
    }
}

//! Store of a watch that was killed: its last frames are in the write-ahead log beside it, of which
//! a copy of the store alone lacks them. While a watch writes, the store itself holds the name of
//! its log.

use rusqlite::{Connection, OptionalExtension};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// Key of the log's name among what the store says of itself.
const KEY: &str = "log";

/// The log beside the store `path`.
fn log_of(path: &Path) -> PathBuf {
    // SQLite follows links: the log is beside the file that they lead to.
    let mut name = OsString::from(path.canonicalize().unwrap_or_else(|_| path.to_path_buf()));
    name.push("-wal");
    name.into()
}

/// Whether the log is there. To be asked before the store is opened, which makes one.
pub(super) fn has_log(path: &Path) -> bool {
    log_of(path).exists()
}

/// The store notes that it has a log.
pub(super) fn begin(path: &Path, connection: &Connection) -> rusqlite::Result<()> {
    let log = log_of(path).file_name().unwrap_or_default().to_string_lossy().into_owned();
    connection.execute("INSERT OR REPLACE INTO about VALUES (?1, ?2)", [KEY, &log])?;
    // Into the store itself, not into the log that it names. Readers that hold it up do no harm:
    // then the log has frames, too.
    connection.query_row("PRAGMA wal_checkpoint(TRUNCATE)", [], |_| Ok(()))
}

/// The store notes that it is whole.
pub(super) fn end(connection: &Connection) -> rusqlite::Result<()> {
    connection.execute("DELETE FROM about WHERE key = ?1", [KEY]).map(drop)
}

/// That frames may be missing, as a sentence, where the watch did not end and its log was not
/// there.
pub(super) fn sentence(connection: &Connection, has_log: bool) -> rusqlite::Result<Option<String>> {
    let name: Option<String> =
        connection.query_row("SELECT value FROM about WHERE key = ?1", [KEY], |row| row.get(0)).optional()?;
    Ok(name.filter(|_| !has_log).map(|name| {
        format!("its watch was killed, and its last frames may be missing: the file {name} of the same folder belongs to it, under the name of the store with -wal behind it")
    }))
}

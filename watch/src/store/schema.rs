//! Schema of the store, with its version.

use super::failure::failed;
use cophase::{Error, Result};
use rusqlite::Connection;
use std::path::Path;

/// `application_id` of the file: "CoWa".
const APPLICATION: i64 = 0x436f_5761;
/// Version of the tables below.
const VERSION: i64 = 2;

/// Times are seconds since 1970 (UTC), vectors are doubles in little-endian order; a number that is
/// not known is NULL. Coefficients are those of the wavefront, without tip and tilt of the whole
/// pupil: these are the pointing, in pixels of the frame from its axis.
///
/// A correction holds what it changes of the coefficients, the tracked state and its error bars
/// when it was written, and what was seen of it.
const TABLES: &str = "
CREATE TABLE about (key TEXT PRIMARY KEY, value TEXT NOT NULL) WITHOUT ROWID;
CREATE TABLE frames (
    id INTEGER PRIMARY KEY,
    content BLOB NOT NULL,
    image INTEGER NOT NULL,
    name TEXT NOT NULL,
    observed_s REAL NOT NULL,
    taken_s REAL NOT NULL,
    latency_s REAL,
    status TEXT NOT NULL CHECK (status IN ('done', 'refused')),
    reason TEXT,
    fit TEXT,
    chi2 REAL,
    flux_e REAL,
    background_e REAL,
    phasing_rms_nm REAL,
    ncpa_rms_nm REAL,
    pointing_x_pixels REAL,
    pointing_y_pixels REAL,
    coefficients_nm BLOB,
    sigma_nm BLOB,
    tracked_nm BLOB,
    tracked_sigma_nm BLOB,
    warnings TEXT NOT NULL,
    UNIQUE (content, image)
);
CREATE INDEX frames_by_status ON frames (status, id);
CREATE TABLE files (
    path BLOB PRIMARY KEY,
    size INTEGER NOT NULL,
    mtime_ns INTEGER NOT NULL,
    inode INTEGER NOT NULL,
    content BLOB NOT NULL
) WITHOUT ROWID;
CREATE INDEX files_by_content ON files (content);
CREATE TABLE tracker (id INTEGER PRIMARY KEY CHECK (id = 1), state BLOB NOT NULL);
CREATE TABLE events (
    id INTEGER PRIMARY KEY,
    time_s REAL NOT NULL,
    kind TEXT NOT NULL,
    sentence TEXT NOT NULL,
    frame INTEGER REFERENCES frames (id),
    segment INTEGER,
    size_nm REAL,
    size_error_nm REAL,
    since_s REAL
);
CREATE TABLE corrections (
    id INTEGER PRIMARY KEY,
    frame INTEGER NOT NULL REFERENCES frames (id),
    written_s REAL NOT NULL,
    change_nm BLOB NOT NULL,
    state_nm BLOB NOT NULL,
    state_sigma_nm BLOB NOT NULL,
    phasing_rms_nm REAL NOT NULL,
    ncpa_rms_nm REAL NOT NULL,
    segment_modes INTEGER NOT NULL,
    ncpa_modes INTEGER NOT NULL,
    replaced_by INTEGER,
    applied_frame INTEGER REFERENCES frames (id),
    applied_s REAL,
    applied_part TEXT,
    applied_fraction REAL,
    applied_fraction_error REAL
);
";

/// Makes the tables in a new file; checks those of another.
pub(super) fn prepare(path: &Path, connection: &mut Connection) -> Result<()> {
    let failed = failed(path);
    let is_new = is_empty(path, connection)?;
    // The log takes a frame with one write and one synchronisation; FULL makes that survive a power
    // cut.
    connection.pragma_update(None, "journal_mode", "WAL").map_err(&failed)?;
    connection.pragma_update(None, "synchronous", "FULL").map_err(&failed)?;
    if is_new {
        let transaction = connection.transaction().map_err(&failed)?;
        transaction.execute_batch(TABLES).map_err(&failed)?;
        transaction.pragma_update(None, "application_id", APPLICATION).map_err(&failed)?;
        transaction.pragma_update(None, "user_version", VERSION).map_err(&failed)?;
        transaction.commit().map_err(&failed)?;
    }
    Ok(())
}

/// Whether the file is empty, as a new one is; otherwise it is a store of this version.
///
/// # Errors
/// [`Error::File`] for a file that is no store, or one of another version.
pub(super) fn is_empty(path: &Path, connection: &Connection) -> Result<bool> {
    let failed = failed(path);
    let number = |query: &str| connection.query_row(query, [], |row| row.get::<_, i64>(0)).map_err(&failed);
    let (application, version) = (number("PRAGMA application_id")?, number("PRAGMA user_version")?);
    if application == 0 && version == 0 && number("SELECT count(*) FROM sqlite_master")? == 0 {
        return Ok(true);
    }
    if application != APPLICATION {
        return Err(Error::file(path, "is a database of another program: name another file with --state"));
    }
    if version != VERSION {
        return Err(Error::file(
            path,
            format_args!("has version {version} of the tables, where this version of cophase accepts {VERSION}"),
        ));
    }
    Ok(false)
}

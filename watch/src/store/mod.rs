//! Store of a night watch: one SQLite file with every frame, the tracker's state, and the events.
//!
//! A frame's result and the tracker's state that it led to are one transaction, in a write-ahead
//! log that is synchronised with the disk: after a kill or a power cut either both are there or
//! neither.

mod corrections;
mod failure;
mod lock;
mod read;
mod records;
mod schema;
mod unfinished;

pub use corrections::{Correction, StoredCorrection};
pub use lock::Lock;
pub use read::{Columns, Reader};
pub use records::{About, Content, Event, FileRecord, Frame, StoredFrame};
pub use rusqlite;

use cophase::tracking::Applied;
use cophase::{Error, Result};
use failure::failed;
use records::{blob, path_bytes, path_of};
use rusqlite::{Connection, OptionalExtension, params};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// The store, as the one watcher that writes it holds it.
pub struct Store {
    path: PathBuf,
    connection: Connection,
    about: About,
    /// That frames may be missing, as a sentence.
    incomplete: Option<String>,
    _lock: Lock,
}

/// A frame with all that it led to.
pub struct Entry<'a> {
    pub frame: &'a Frame,
    /// State of the tracker after it.
    pub tracker: Option<&'a [u8]>,
    pub events: &'a [Event],
    /// The correction that it shows to be applied.
    pub applied: Option<&'a Applied>,
    /// The correction that was written.
    pub correction: Option<&'a Correction>,
    /// The file, with its last frame.
    pub file: Option<&'a FileRecord>,
}

impl Store {
    /// Opens the store in the file `path`, or makes one there, for the model that `about`
    /// describes.
    ///
    /// # Errors
    /// [`Error::File`] where another watcher has it; for a file that is no store, or one of another
    /// version, or of another model; where it cannot be written.
    pub fn open(path: &Path, about: About) -> Result<Self> {
        let lock = Lock::take(path)?;
        let failed = failed(path);
        let has_log = unfinished::has_log(path);
        let mut connection = Connection::open(path).map_err(&failed)?;
        schema::prepare(path, &mut connection)?;
        let incomplete = unfinished::sentence(&connection, has_log).map_err(&failed)?;
        let mut store = Self { path: path.to_path_buf(), connection, about, incomplete, _lock: lock };
        store.agree()?;
        unfinished::begin(path, &store.connection).map_err(&failed)?;
        Ok(store)
    }

    /// That frames of an earlier watch may be missing, as a sentence.
    pub fn incomplete(&self) -> Option<&str> {
        self.incomplete.as_deref()
    }

    /// Compares the model with the one that the store was made for; a new store takes it.
    fn agree(&mut self) -> Result<()> {
        let failed = failed(&self.path);
        let known = read::about(&self.connection).map_err(&failed)?;
        let Some(known) = known else {
            let transaction = self.connection.transaction().map_err(&failed)?;
            for (key, value) in self.about.pairs() {
                transaction.execute("INSERT INTO about VALUES (?1, ?2)", params![key, value]).map_err(&failed)?;
            }
            return transaction.commit().map_err(&failed);
        };
        match self.about.difference(&known) {
            None => Ok(()),
            Some(difference) => Err(Error::file(
                &self.path,
                format_args!(
                    "holds the night of another model ({difference}): name another file with --state, or the same scene"
                ),
            )),
        }
    }

    /// Numbers of the images of `content` that are in the store.
    pub fn images_of(&self, content: Content) -> Result<Vec<usize>> {
        let failed = failed(&self.path);
        let mut query =
            self.connection.prepare_cached("SELECT image FROM frames WHERE content = ?1").map_err(&failed)?;
        let rows = query.query_map([&content.0[..]], |row| row.get::<_, i64>(0)).map_err(&failed)?;
        rows.map(|row| row.map(|image| image as usize).map_err(&failed)).collect()
    }

    /// Whether all images of a file with this content are in the store.
    pub fn has_file(&self, content: Content) -> Result<bool> {
        let query = "SELECT 1 FROM files WHERE content = ?1";
        let found = self.connection.query_row(query, [&content.0[..]], |_| Ok(())).optional();
        found.map(|found| found.is_some()).map_err(failed(&self.path))
    }

    /// Names of the files with this content.
    pub fn names_of(&self, content: Content) -> Result<Vec<PathBuf>> {
        let failed = failed(&self.path);
        let query = "SELECT path FROM files WHERE content = ?1";
        let mut query = self.connection.prepare_cached(query).map_err(&failed)?;
        let rows = query.query_map([&content.0[..]], |row| row.get(0).map(path_of)).map_err(&failed)?;
        rows.map(|row| row.map_err(&failed)).collect()
    }

    /// The files that were taken, as they were then.
    pub fn files(&self) -> Result<HashMap<PathBuf, FileRecord>> {
        let failed = failed(&self.path);
        let query = "SELECT path, size, mtime_ns, inode, content FROM files";
        let mut query = self.connection.prepare(query).map_err(&failed)?;
        let rows = query.query_map([], |row| {
            let record = FileRecord {
                path: path_of(row.get(0)?),
                size: row.get::<_, i64>(1)? as u64,
                mtime_ns: row.get(2)?,
                inode: row.get::<_, i64>(3)? as u64,
                content: Content(row.get(4)?),
            };
            Ok((record.path.clone(), record))
        });
        rows.map_err(&failed)?.map(|row| row.map_err(&failed)).collect()
    }

    /// State of the tracker after the last frame.
    pub fn tracker(&self) -> Result<Option<Vec<u8>>> {
        let state = self.connection.query_row("SELECT state FROM tracker", [], |row| row.get(0)).optional();
        state.map_err(failed(&self.path))
    }

    /// Number of the next correction.
    pub fn next_correction(&self) -> Result<i64> {
        corrections::next(&self.connection).map_err(failed(&self.path))
    }

    /// The tracked state from which the correction `number` was made, and its error bars, nm.
    pub fn correction_state(&self, number: i64) -> Result<Option<[Vec<f64>; 2]>> {
        corrections::state(&self.connection, number).map_err(failed(&self.path))
    }

    /// Adds, in one transaction, a frame with all that it led to. Gives the frame's number; a frame
    /// that is there already is not added again, and nothing changes.
    ///
    /// # Errors
    /// [`Error::File`] where the disk does not take it: then nothing is there.
    pub fn commit(&mut self, entry: &Entry) -> Result<Option<i64>> {
        let failed = failed(&self.path);
        let transaction = self.connection.transaction().map_err(&failed)?;
        let changed = insert_frame(&transaction, entry.frame).map_err(&failed)?;
        if changed == 0 {
            return Ok(None);
        }
        let id = transaction.last_insert_rowid();
        if let Some(state) = entry.tracker {
            let query = "INSERT INTO tracker VALUES (1, ?1) ON CONFLICT (id) DO UPDATE SET state = excluded.state";
            transaction.prepare_cached(query).and_then(|mut query| query.execute([state])).map_err(&failed)?;
        }
        for event in entry.events {
            insert_event(&transaction, event, Some(id)).map_err(&failed)?;
        }
        if let Some(applied) = entry.applied {
            corrections::apply(&transaction, applied, id, entry.frame.observed_s).map_err(&failed)?;
        }
        if let Some(correction) = entry.correction {
            corrections::insert(&transaction, correction, id).map_err(&failed)?;
        }
        if let Some(file) = entry.file {
            insert_file(&transaction, file).map_err(&failed)?;
        }
        transaction.commit().map_err(&failed)?;
        Ok(Some(id))
    }

    /// Adds an event of no frame.
    pub fn add_event(&mut self, event: &Event) -> Result<i64> {
        insert_event(&self.connection, event, None).map_err(failed(&self.path))?;
        Ok(self.connection.last_insert_rowid())
    }

    /// Adds the name of a file whose content is in the store. Where `former` is the name that it
    /// had, its frames get the new one.
    pub fn add_file(&mut self, file: &FileRecord, former: Option<&Path>) -> Result<()> {
        let failed = failed(&self.path);
        let transaction = self.connection.transaction().map_err(&failed)?;
        insert_file(&transaction, file).map_err(&failed)?;
        if let Some(former) = former {
            let query = "DELETE FROM files WHERE path = ?1";
            transaction.execute(query, [path_bytes(former)]).map_err(&failed)?;
            let query = "UPDATE frames SET name = ?1 WHERE content = ?2";
            let name = file.path.display().to_string();
            transaction.execute(query, params![name, &file.content.0[..]]).map_err(&failed)?;
        }
        transaction.commit().map_err(&failed)
    }

    /// Ends: moves the log into the file, so that one file is left.
    pub fn close(self) -> Result<()> {
        unfinished::end(&self.connection).map_err(failed(&self.path))?;
        self.connection.close().map_err(|(_, error)| failed(&self.path)(error))
    }
}

fn insert_frame(connection: &Connection, frame: &Frame) -> rusqlite::Result<usize> {
    let query = "INSERT OR IGNORE INTO frames (content, image, name, observed_s, taken_s, latency_s, status, reason, fit, chi2, flux_e, \
                 background_e, phasing_rms_nm, ncpa_rms_nm, pointing_x_pixels, pointing_y_pixels, coefficients_nm, sigma_nm, tracked_nm, \
                 tracked_sigma_nm, warnings) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13, ?14, ?15, ?16, ?17, ?18, \
                 ?19, ?20, ?21)";
    connection.prepare_cached(query)?.execute(params![
        &frame.content.0[..],
        frame.image as i64,
        frame.name,
        frame.observed_s,
        frame.taken_s,
        frame.latency_s,
        if frame.reason.is_some() { "refused" } else { "done" },
        frame.reason,
        frame.fit,
        frame.chi2,
        frame.flux_e,
        frame.background_e,
        frame.phasing_rms_nm,
        frame.ncpa_rms_nm,
        frame.pointing_pixels[0],
        frame.pointing_pixels[1],
        blob(&frame.coefficients_nm),
        blob(&frame.sigma_nm),
        blob(&frame.tracked_nm),
        blob(&frame.tracked_sigma_nm),
        serde_json::to_string(&frame.warnings).unwrap_or_default(),
    ])
}

fn insert_event(connection: &Connection, event: &Event, frame: Option<i64>) -> rusqlite::Result<usize> {
    let query = "INSERT INTO events (time_s, kind, sentence, frame, segment, size_nm, size_error_nm, since_s) VALUES \
                 (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8)";
    connection.prepare_cached(query)?.execute(params![
        event.time_s,
        event.kind,
        event.sentence,
        frame,
        event.segment.map(|segment| segment as i64),
        event.size_nm,
        event.size_error_nm,
        event.since_s,
    ])
}

fn insert_file(connection: &Connection, file: &FileRecord) -> rusqlite::Result<usize> {
    let query = "INSERT OR REPLACE INTO files (path, size, mtime_ns, inode, content) VALUES (?1, ?2, ?3, ?4, ?5)";
    connection.prepare_cached(query)?.execute(params![
        path_bytes(&file.path),
        file.size as i64,
        file.mtime_ns,
        file.inode as i64,
        &file.content.0[..],
    ])
}

//! Reading a store, also while a watcher writes it.

use super::failure::failed;
use super::records::{About, StoredEvent, StoredFrame, numbers};
use super::{schema, unfinished};
use cophase::{Error, Result};
use rusqlite::{Connection, OpenFlags, OptionalExtension, Row, params};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// A connection that reads.
pub struct Reader {
    pub(super) path: PathBuf,
    pub(super) connection: Connection,
    incomplete: Option<String>,
}

/// Numbers of frames.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Counts {
    pub done: i64,
    pub refused: i64,
}

/// One value of a segment.
#[derive(Debug, Clone, Serialize)]
pub struct SegmentPoint {
    pub frame: i64,
    pub time_s: f64,
    pub value_nm: f64,
    pub sigma_nm: f64,
    pub tracked_nm: Option<f64>,
    pub tracked_sigma_nm: Option<f64>,
}

const FIGURES: &str = "id, name, image, observed_s, taken_s, latency_s, status, reason, fit, chi2, flux_e, background_e, \
                       phasing_rms_nm, ncpa_rms_nm, pointing_x_pixels, pointing_y_pixels, warnings";

/// What is read of a frame: vectors are most of its bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Columns {
    /// All but the vectors, which are left empty.
    Figures,
    All,
}

impl Columns {
    fn list(self) -> String {
        match self {
            Self::Figures => format!("{FIGURES}, NULL, NULL, NULL, NULL"),
            Self::All => format!("{FIGURES}, coefficients_nm, sigma_nm, tracked_nm, tracked_sigma_nm"),
        }
    }
}

impl Reader {
    /// Opens the store in the file `path`.
    ///
    /// # Errors
    /// [`Error::File`] for a file that is not there or no store, or one of another version.
    pub fn open(path: &Path) -> Result<Self> {
        if !path.exists() {
            return Err(Error::file(path, "does not exist: the --state file of a cophase watch is needed"));
        }
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let has_log = unfinished::has_log(path);
        let connection = Connection::open_with_flags(path, flags).map_err(failed(path))?;
        if schema::is_empty(path, &connection)? {
            return Err(Error::file(path, "is empty: the --state file of a cophase watch is needed"));
        }
        let incomplete = unfinished::sentence(&connection, has_log).map_err(failed(path))?;
        Ok(Self { path: path.to_path_buf(), connection, incomplete })
    }

    /// That frames may be missing, as a sentence.
    pub fn incomplete(&self) -> Option<&str> {
        self.incomplete.as_deref()
    }

    /// The model of the store.
    pub fn about(&self) -> Result<About> {
        let about = about(&self.connection).map_err(failed(&self.path))?;
        about.ok_or_else(|| Error::file(&self.path, "does not say of which model it is"))
    }

    /// How many frames there are.
    pub fn counts(&self) -> Result<Counts> {
        let count = |status: &str| {
            let query = "SELECT count(*) FROM frames WHERE status = ?1";
            self.connection.prepare_cached(query)?.query_row([status], |row| row.get(0))
        };
        let counts = || Ok(Counts { done: count("done")?, refused: count("refused")? });
        counts().map_err(failed(&self.path))
    }

    /// Up to `limit` frames after the frame `after`, the oldest first.
    pub fn frames_after(&self, after: i64, limit: usize, columns: Columns) -> Result<Vec<StoredFrame>> {
        let query = format!("SELECT {} FROM frames WHERE id > ?1 ORDER BY id LIMIT ?2", columns.list());
        self.frames(&query, after, limit)
    }

    /// The last `limit` frames, the oldest first; only those with a result, or only those that were
    /// refused, where `status` says so.
    pub fn last_frames(&self, status: Option<&str>, limit: usize, columns: Columns) -> Result<Vec<StoredFrame>> {
        let condition = match status {
            Some("done") => "WHERE status = 'done' AND id > ?1",
            Some(_) => "WHERE status = 'refused' AND id > ?1",
            None => "WHERE id > ?1",
        };
        let query = format!("SELECT {} FROM frames {condition} ORDER BY id DESC LIMIT ?2", columns.list());
        let mut frames = self.frames(&query, 0, limit)?;
        frames.reverse();
        Ok(frames)
    }

    fn frames(&self, query: &str, after: i64, limit: usize) -> Result<Vec<StoredFrame>> {
        let failed = failed(&self.path);
        let mut query = self.connection.prepare_cached(query).map_err(&failed)?;
        let rows = query.query_map(params![after, limit as i64], frame).map_err(&failed)?;
        rows.map(|row| row.map_err(&failed)).collect()
    }

    /// The last `limit` values of the mode `mode`, the oldest first.
    pub fn history(&self, mode: usize, limit: usize) -> Result<Vec<SegmentPoint>> {
        let frames = self.last_frames(Some("done"), limit, Columns::All)?;
        let point = |frame: StoredFrame| {
            Some(SegmentPoint {
                frame: frame.id,
                time_s: frame.observed_s,
                value_nm: *frame.coefficients_nm.get(mode)?,
                sigma_nm: *frame.sigma_nm.get(mode)?,
                tracked_nm: frame.tracked_nm.get(mode).copied(),
                tracked_sigma_nm: frame.tracked_sigma_nm.get(mode).copied(),
            })
        };
        Ok(frames.into_iter().filter_map(point).collect())
    }

    /// The last `limit` events, the newest first.
    pub fn events(&self, limit: usize) -> Result<Vec<StoredEvent>> {
        let failed = failed(&self.path);
        let query = "SELECT id, time_s, kind, sentence, frame, segment, size_nm, size_error_nm, since_s FROM events ORDER BY id DESC \
                     LIMIT ?1";
        let mut query = self.connection.prepare_cached(query).map_err(&failed)?;
        let rows = query.query_map([limit as i64], |row| {
            Ok(StoredEvent {
                id: row.get(0)?,
                time_s: row.get(1)?,
                kind: row.get(2)?,
                sentence: row.get(3)?,
                frame: row.get(4)?,
                segment: row.get(5)?,
                size_nm: row.get(6)?,
                size_error_nm: row.get(7)?,
                since_s: row.get(8)?,
            })
        });
        rows.map_err(&failed)?.map(|row| row.map_err(&failed)).collect()
    }
}

fn frame(row: &Row) -> rusqlite::Result<StoredFrame> {
    let vector = |column: usize| row.get::<_, Option<Vec<u8>>>(column).map(|blob| numbers(blob.as_deref()));
    Ok(StoredFrame {
        id: row.get(0)?,
        name: row.get(1)?,
        image: row.get(2)?,
        observed_s: row.get(3)?,
        taken_s: row.get(4)?,
        latency_s: row.get(5)?,
        status: row.get(6)?,
        reason: row.get(7)?,
        fit: row.get(8)?,
        chi2: row.get(9)?,
        flux_e: row.get(10)?,
        background_e: row.get(11)?,
        phasing_rms_nm: row.get(12)?,
        ncpa_rms_nm: row.get(13)?,
        pointing_x_pixels: row.get(14)?,
        pointing_y_pixels: row.get(15)?,
        warnings: serde_json::from_str(&row.get::<_, String>(16)?).unwrap_or_default(),
        coefficients_nm: vector(17)?,
        sigma_nm: vector(18)?,
        tracked_nm: vector(19)?,
        tracked_sigma_nm: vector(20)?,
    })
}

/// The model of a store; `None` for a new one.
pub(super) fn about(connection: &Connection) -> rusqlite::Result<Option<About>> {
    let mut found = Vec::new();
    for key in ["scene", "policy", "source", "modes", "segment_modes", "segments"] {
        let query = "SELECT value FROM about WHERE key = ?1";
        let value: Option<String> = connection.query_row(query, [key], |row| row.get(0)).optional()?;
        found.push((key, value));
    }
    Ok(About::from_pairs(|key| found.iter().find(|(known, _)| *known == key).and_then(|(_, value)| value.clone())))
}

//! Corrections in the store.

use super::failure::failed;
use super::read::Reader;
use super::records::{blob, numbers};
use cophase::Result;
use cophase::tracking::{Applied, AppliedPart};
use rusqlite::{Connection, OptionalExtension, params};
use serde::Serialize;

/// A correction that was written.
#[derive(Debug, Clone)]
pub struct Correction {
    /// Its number, from 1.
    pub number: i64,
    /// When it was written, s since 1970.
    pub written_s: f64,
    /// What it changes of each coefficient, nm.
    pub change_nm: Vec<f64>,
    /// The tracked state from which it was made, nm, and its error bars.
    pub state_nm: Vec<f64>,
    pub state_sigma_nm: Vec<f64>,
    /// RMS over the pupil of what it takes off the segment errors and the NCPA.
    pub phasing_rms_nm: f64,
    pub ncpa_rms_nm: f64,
    /// Segment modes and NCPA modes that it corrects.
    pub segment_modes: usize,
    pub ncpa_modes: usize,
}

/// A correction as the page and the export read it.
#[derive(Debug, Clone, Serialize)]
pub struct StoredCorrection {
    pub number: i64,
    pub frame: i64,
    pub written_s: f64,
    pub phasing_rms_nm: f64,
    pub ncpa_rms_nm: f64,
    pub segment_modes: i64,
    pub ncpa_modes: i64,
    pub replaced_by: Option<i64>,
    pub applied_frame: Option<i64>,
    pub applied_s: Option<f64>,
    pub applied_part: Option<String>,
    pub applied_fraction: Option<f64>,
    pub applied_fraction_error: Option<f64>,
    #[serde(skip)]
    pub change_nm: Vec<f64>,
}

/// Number of the next correction.
pub(super) fn next(connection: &Connection) -> rusqlite::Result<i64> {
    connection.query_row("SELECT coalesce(max(id), 0) + 1 FROM corrections", [], |row| row.get(0))
}

/// The tracked state from which the correction `number` was made, and its error bars, nm.
pub(super) fn state(connection: &Connection, number: i64) -> rusqlite::Result<Option<[Vec<f64>; 2]>> {
    let query = "SELECT state_nm, state_sigma_nm FROM corrections WHERE id = ?1";
    let vector = |bytes: Vec<u8>| numbers(Some(&bytes));
    connection.query_row(query, [number], |row| Ok([vector(row.get(0)?), vector(row.get(1)?)])).optional()
}

/// Adds a correction that a frame led to; it replaces those that were not applied.
pub(super) fn insert(connection: &Connection, correction: &Correction, frame: i64) -> rusqlite::Result<()> {
    let query = "UPDATE corrections SET replaced_by = ?1 WHERE replaced_by IS NULL AND applied_s IS NULL";
    connection.prepare_cached(query)?.execute([correction.number])?;
    let query = "INSERT INTO corrections (id, frame, written_s, change_nm, state_nm, state_sigma_nm, phasing_rms_nm, ncpa_rms_nm, \
                 segment_modes, ncpa_modes) VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10)";
    connection.prepare_cached(query)?.execute(params![
        correction.number,
        frame,
        correction.written_s,
        blob(&correction.change_nm),
        blob(&correction.state_nm),
        blob(&correction.state_sigma_nm),
        correction.phasing_rms_nm,
        correction.ncpa_rms_nm,
        correction.segment_modes as i64,
        correction.ncpa_modes as i64,
    ])?;
    Ok(())
}

/// Notes that a frame, observed at `observed_s`, shows a correction to be applied; one part after
/// the other is the whole.
pub(super) fn apply(connection: &Connection, applied: &Applied, frame: i64, observed_s: f64) -> rusqlite::Result<()> {
    let query = "UPDATE corrections SET applied_frame = ?2, applied_s = ?3, applied_fraction = ?5, applied_fraction_error = ?6, \
                 applied_part = CASE WHEN applied_part IS NULL THEN ?4 ELSE ?7 END WHERE id = ?1";
    connection.prepare_cached(query)?.execute(params![
        applied.number,
        frame,
        observed_s,
        applied.part.word(),
        applied.fraction,
        applied.fraction_error,
        AppliedPart::Whole.word(),
    ])?;
    Ok(())
}

impl Reader {
    /// The last `limit` corrections, the newest first.
    pub fn corrections(&self, limit: usize) -> Result<Vec<StoredCorrection>> {
        let failed = failed(&self.path);
        let query = "SELECT id, frame, written_s, phasing_rms_nm, ncpa_rms_nm, segment_modes, ncpa_modes, replaced_by, applied_frame, \
                     applied_s, applied_part, applied_fraction, applied_fraction_error, change_nm FROM corrections ORDER BY id DESC LIMIT ?1";
        let mut query = self.connection.prepare_cached(query).map_err(&failed)?;
        let rows = query.query_map([limit as i64], |row| {
            Ok(StoredCorrection {
                number: row.get(0)?,
                frame: row.get(1)?,
                written_s: row.get(2)?,
                phasing_rms_nm: row.get(3)?,
                ncpa_rms_nm: row.get(4)?,
                segment_modes: row.get(5)?,
                ncpa_modes: row.get(6)?,
                replaced_by: row.get(7)?,
                applied_frame: row.get(8)?,
                applied_s: row.get(9)?,
                applied_part: row.get(10)?,
                applied_fraction: row.get(11)?,
                applied_fraction_error: row.get(12)?,
                change_nm: numbers(Some(&row.get::<_, Vec<u8>>(13)?)),
            })
        });
        rows.map_err(&failed)?.map(|row| row.map_err(&failed)).collect()
    }
}

//! Log of a reduction: one row for each frame.

use super::classify::FrameClass;
use super::frame::RawFrame;
use crate::Result;
use crate::io::{Column, FitsWriter};

/// Row of the log. Numbers that were not measured are NaN.
#[derive(Debug, Clone, PartialEq)]
pub struct LogRow {
    /// File, with the number of the plane in a cube.
    pub file: String,
    /// What it shows.
    pub class: FrameClass,
    /// Channel; empty for a frame without one.
    pub channel: String,
    /// Integration time of a coadd, s.
    pub itime_s: f64,
    /// Coadds.
    pub coadds: u32,
    /// Column of the star, from 0.
    pub x: f64,
    /// Row of the star, from 0.
    pub y: f64,
    /// Electrons of the star in the cut-out.
    pub flux_e: f64,
    /// Largest raw value of the cut-out in one coadd.
    pub peak_adu: f64,
    /// Background of a pixel before the sky was subtracted, electrons.
    pub background_e: f64,
    /// Ratio of the spot's larger to its smaller width.
    pub elongation: f64,
    /// Whether the frame is in the cube, or in a master.
    pub is_used: bool,
    /// Why it was rejected, or what it was used for.
    pub reason: String,
}

impl LogRow {
    /// Row of a file that is no frame.
    pub(super) fn unreadable(file: String, reason: String) -> Self {
        Self {
            file,
            class: FrameClass::Other,
            channel: String::new(),
            itime_s: f64::NAN,
            coadds: 0,
            x: f64::NAN,
            y: f64::NAN,
            flux_e: f64::NAN,
            peak_adu: f64::NAN,
            background_e: f64::NAN,
            elongation: f64::NAN,
            is_used: false,
            reason,
        }
    }

    /// Row of a frame that nothing is known of yet.
    pub(super) fn of(frame: &RawFrame) -> Self {
        Self {
            class: frame.class,
            channel: frame.channel.clone().unwrap_or_default(),
            itime_s: frame.header.itime_s.unwrap_or(f64::NAN),
            coadds: frame.header.coadds,
            ..Self::unreadable(frame.name.clone(), String::new())
        }
    }

    pub(super) fn reject(&mut self, reason: impl Into<String>) {
        (self.is_used, self.reason) = (false, reason.into());
    }

    pub(super) fn accept(&mut self, reason: impl Into<String>) {
        (self.is_used, self.reason) = (true, reason.into());
    }
}

/// Writes the table `REDUCTION`.
pub(super) fn write(file: &mut FitsWriter, rows: &[LogRow]) -> Result<()> {
    let numbers = |of: fn(&LogRow) -> f64| rows.iter().map(of).collect::<Vec<_>>();
    let columns = [
        Column::text("FILE", rows.iter().map(|row| row.file.as_str())),
        Column::text("CLASS", rows.iter().map(|row| row.class.name())),
        Column::text("CHANNEL", rows.iter().map(|row| row.channel.as_str())),
        Column::f64("ITIME_S", "s", numbers(|row| row.itime_s)),
        Column::i64("COADDS", rows.iter().map(|row| i64::from(row.coadds)).collect()),
        Column::f64("X", "pixel", numbers(|row| row.x)),
        Column::f64("Y", "pixel", numbers(|row| row.y)),
        Column::f64("FLUX_E", crate::io::ELECTRON, numbers(|row| row.flux_e)),
        Column::f64("PEAK_ADU", "adu", numbers(|row| row.peak_adu)),
        Column::f64("BACKGROUND_E", crate::io::ELECTRON, numbers(|row| row.background_e)),
        Column::f64("ELONGATION", "", numbers(|row| row.elongation)),
        Column::i64("USED", rows.iter().map(|row| i64::from(row.is_used)).collect()),
        Column::text("REASON", rows.iter().map(|row| row.reason.as_str())),
    ];
    file.table("REDUCTION", &columns)
}

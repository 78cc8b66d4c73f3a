//! How a target is run.

use super::Shares;
use super::table_rows::{Conditions, Segments};
use cophase::Result;
use cophase::pipeline::Part;
use std::path::PathBuf;

/// How a target is run.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Draws of aberrations and noise at each point; the target's own number unless named.
    pub seeds: Option<usize>,
    /// Where the files go; it is made where it is missing.
    pub directory: PathBuf,
    /// Two draws, and a few points or images: a look at the shape, not a result.
    pub quick: bool,
    /// The telescope behind the loop.
    pub segments: Segments,
    /// Rows of `Target::Beyond` or `Target::Pyramid`, cases of `Target::HardCases`, or parts of
    /// names of rows of `Target::Pulls` or `Target::MovingStar`; none are all.
    pub rows: Vec<String>,
    /// Folder of measured maps of NCPA, each of which is a row of `Target::Beyond`.
    pub maps: Option<PathBuf>,
    /// The part of the draws that is made, without a table; none for all. Not all targets have
    /// parts.
    pub part: Option<Part>,
}

impl Options {
    /// What all loops have in common.
    pub(super) fn conditions(&self) -> Conditions {
        let settings = if self.quick { vec![("image.count", QUICK_IMAGES)] } else { Vec::new() };
        Conditions { segments: self.segments, settings, ..Default::default() }
    }

    /// The draws of the target `name` that are kept in the folder; those of another telescope or of
    /// a quick look are not its own.
    ///
    /// # Errors
    /// As [`Shares::open`].
    pub(super) fn shares(&self, name: &str) -> Result<Shares> {
        let look = if self.quick { ", --quick" } else { "" };
        let options = format!("segments of {} m{look}", self.segments.side_m());
        Shares::open(&self.directory, name, &options, self.part)
    }
}

/// Images of a quick look at a loop: 12 s of sky.
const QUICK_IMAGES: &str = "40";

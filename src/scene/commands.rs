//! Section `[commands]`: which errors are corrected, and the terms of the controllers that take
//! corrections.

use super::table::{Check, Reader, default, section, unset};
use super::value::{ANY, above, between};
use super::words::SegmentConvention;
use crate::Result;
use std::path::PathBuf;

section! {
    /// Corrections: which errors are corrected, and the terms of the controllers of segments and
    /// mirror. Segments or NCPA whose correction is not expected to lower the error are held in any
    /// case. Estimate only.
    CommandsScene = "commands" {
        /// Part of an error that is corrected at once.
        gain: f64, above(0.0, 1.0), default(1.0);
        /// A mode that is smaller than so many of its error bars is left as it is.
        deadband_sigma: f64, between(0.0, 1e3), default(1.0);
        /// Largest correction of a segment's piston: where one is larger, none is made. Corrections
        /// beyond a quarter of the wavelength are cut to that where it is unset and the images have
        /// one wavelength.
        max_step_nm: Option<f64>, above(0.0, 1e6), unset("half of the wavelength where the images have one wavelength; no limit where two determine the whole wavelengths");
        /// What moving segments minimises: "least-squares" the sum of the squares of all segment
        /// modes, "edge-minimising" the steps at the edges that neighbours share, of pistons alone.
        /// Both are the same where all segments move.
        convention: SegmentConvention, ANY, default(SegmentConvention::LeastSquares);
        /// Channels that move the segments, as a text table: number of the segment (from 0, as this
        /// program counts), the channel's name, units per nm of wavefront (with its sign), and
        /// optionally the largest absolute command. Comments begin with #.
        segment_file: Option<PathBuf>, ANY, unset("no commands but nm of wavefront for each segment");
        /// FITS image [channel, segment] of the units per nm of a segment's piston. A table of
        /// segment_file then names its rows: its first column is a row of the matrix, from 0.
        segment_matrix_file: Option<PathBuf>, ANY, unset("each channel moves one segment");
        /// Unit of the channels of the segments.
        segment_unit: String, ANY, default("nm");
        /// Channels that move the mirror, as segment_file: the first column is the number of the
        /// actuator.
        actuator_file: Option<PathBuf>, ANY, unset("no commands but nm of wavefront for each actuator");
        /// FITS image [channel, actuator] of the units per nm of an actuator's command, as
        /// segment_matrix_file.
        actuator_matrix_file: Option<PathBuf>, ANY, unset("each channel moves one actuator");
        /// Unit of the channels of the mirror.
        actuator_unit: String, ANY, default("nm");
    }
}

impl Check for CommandsScene {
    fn complete(&mut self, reader: &Reader) -> Result<()> {
        let without = "without a table or a matrix of channels";
        if self.segment_file.is_none() && self.segment_matrix_file.is_none() {
            reader.refuse(&["segment_unit"], without)?;
        }
        if self.actuator_file.is_none() && self.actuator_matrix_file.is_none() {
            reader.refuse(&["actuator_unit"], without)?;
        }
        Ok(())
    }
}

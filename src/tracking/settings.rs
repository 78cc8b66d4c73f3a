//! Input and output of a tracker: observations, settings, changes.

use super::pointing::PointingChange;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, ArrayView2};
use std::ops::Range;

/// A night, to which rates of false alarms refer: 8 hours, s.
pub const NIGHT_S: f64 = 8.0 * 3600.0;

/// One estimate, as the tracker takes it.
#[derive(Debug, Clone, Copy)]
pub struct TimedEstimate<'a> {
    /// Time of the exposure, s, of any origin; it may stand still or go back.
    pub time_s: f64,
    /// Coefficients of segment modes and NCPA modes, nm.
    pub coefficients_nm: ArrayView1<'a, f64>,
    /// Their covariance, nm², `[mode, mode]`; it may be singular, as that of pistons about their
    /// mean is.
    pub covariance_nm2: ArrayView2<'a, f64>,
    /// Where the star was in the image: tip and tilt of the whole pupil, nm RMS, with the pixels by
    /// which the image was moved before its fit; `None` where that is not known.
    pub pointing_nm: Option<[f64; 2]>,
}

/// Settings of a [`Tracker`](super::Tracker).
#[derive(Debug, Clone, PartialEq)]
pub struct TrackerSettings {
    /// Coefficients that are segment modes; the rest are NCPA modes.
    pub segment_modes: Range<usize>,
    /// Segment of each segment mode.
    pub segment_of_mode: Vec<usize>,
    /// Pointing in terms of the modes: what 1 nm RMS of tip, and of tilt, of the whole pupil
    /// changes of the coefficients, `[tip or tilt, mode]`. Each image has a pointing of its own, so
    /// that nothing is concluded from the coefficients along these directions. No rows where the
    /// modes hold no tip and tilt.
    pub pointing_modes: Array2<f64>,
    /// Drift of a segment mode: standard deviation of its change in an hour, nm; it grows with the
    /// root of the time. `None`: learnt.
    pub drift_segments_nm_per_sqrt_hour: Option<f64>,
    /// The same of an NCPA mode; where it is learnt, a mode that moves more than the others has a
    /// rate of its own.
    pub drift_ncpa_nm_per_sqrt_hour: Option<f64>,
    /// False alarms that are accepted in a night of 8 hours, of all detectors together.
    pub false_alarms_per_night: f64,
    /// Time between estimates, s: with it the false alarms of a night become a threshold.
    pub nominal_interval_s: f64,
}

impl TrackerSettings {
    /// # Errors
    /// [`Error::Value`] for a number out of range, [`Error::Shape`] where the segments do not fit
    /// the modes.
    pub(super) fn check(&self) -> Result<()> {
        let named = self.segment_of_mode.len();
        if named != self.segment_modes.len() {
            let modes = self.segment_modes.len();
            return Err(Error::Shape(format!(
                "segments of {named} modes were given, where there are {modes} segment modes: one segment a mode is needed"
            )));
        }
        if let Some(nm) = self.pointing_modes.iter().find(|nm| !nm.is_finite()) {
            return Err(Error::Value(format!(
                "a mode changes by {nm} with the pointing, where a finite number is needed"
            )));
        }
        let rates = [self.drift_segments_nm_per_sqrt_hour, self.drift_ncpa_nm_per_sqrt_hour];
        for rate in rates.into_iter().flatten() {
            if !(rate.is_finite() && rate >= 0.0) {
                return Err(Error::Value(format!("a drift of {rate} nm/√h was given, where 0 or more is needed")));
            }
        }
        let positive = [
            ("false alarms per night are", self.false_alarms_per_night),
            ("the interval between estimates, in s, is", self.nominal_interval_s),
        ];
        match positive.into_iter().find(|(_, value)| !(value.is_finite() && *value > 0.0)) {
            Some((what, value)) => Err(Error::Value(format!("{what} {value}, where a positive number is needed"))),
            None => Ok(()),
        }
    }

    /// False alarms that each detector may raise with one estimate: there is one of each segment
    /// mode, one of all modes together, and one of the pointing.
    pub(super) fn false_alarms_per_step(&self) -> f64 {
        let per_step = self.false_alarms_per_night * self.nominal_interval_s / NIGHT_S;
        per_step / (self.segment_modes.len() as f64 + 2.0)
    }
}

/// A step of a segment, or of more than single segments, that persists.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// The segment; `None` where no single segments explain it: the whole mirror, or the NCPA.
    pub segment: Option<usize>,
    /// The coefficient of the observation that moved; `None` as for the segment.
    pub mode: Option<usize>,
    /// Step of the mode, nm; without a segment, root of the sum of squares of the steps of all
    /// modes.
    pub size_nm: f64,
    /// Its error bar, nm.
    pub size_error_nm: f64,
    /// Time of the first estimate that has the step, s.
    pub since_s: f64,
    /// Time of the estimate that decided, s.
    pub detected_s: f64,
    /// Twice the logarithm of the generalised likelihood ratio.
    pub statistic: f64,
    /// Its threshold, from the false alarms per night.
    pub threshold: f64,
}

/// What became of an estimate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TrackerVerdict {
    /// It was used.
    Accepted,
    /// It differs from the tracked state by more than its error bars and the drift allow, and was
    /// not used. Where the next one confirms it, both are used, and a [`Change`] says so.
    Outlier {
        /// Statistic that exceeded its limit: χ² of all modes, or of the mode that differs most.
        chi2: f64,
        /// The limit.
        limit: f64,
        /// The segment that differs most, where one does by more than its own limit.
        segment: Option<usize>,
    },
}

/// What of a correction was applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AppliedPart {
    /// All of it.
    Whole,
    /// The segments alone.
    Segments,
    /// The NCPA alone.
    Ncpa,
}

impl AppliedPart {
    /// The word in files.
    pub fn word(self) -> &'static str {
        match self {
            Self::Whole => "whole",
            Self::Segments => "segments",
            Self::Ncpa => "ncpa",
        }
    }
}

/// A correction that an estimate shows to be applied.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Applied {
    /// Its number, as in [`Tracker::expect`](super::Tracker::expect).
    pub number: i64,
    /// Which part of it.
    pub part: AppliedPart,
    /// By how much of its size, 1 for all.
    pub fraction: f64,
    /// Error bar of the fraction.
    pub fraction_error: f64,
    /// Logarithm of the likelihood ratio of "applied" to "not applied".
    pub log_ratio: f64,
    /// The threshold. An alarm that the correction explains better needs less.
    pub threshold: f64,
}

/// Outcome of one estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Update {
    /// Whether it was used.
    pub verdict: TrackerVerdict,
    /// Steps that this estimate proved.
    pub changes: Vec<Change>,
    /// The correction that it shows to be applied, by which the state was moved.
    pub applied: Option<Applied>,
    /// A move of the star that it proved; it is no change of the wavefront.
    pub pointing: Option<PointingChange>,
}

impl Update {
    /// An estimate that was used and shows no change.
    pub(super) fn accepted() -> Self {
        Self { verdict: TrackerVerdict::Accepted, changes: Vec::new(), applied: None, pointing: None }
    }
}

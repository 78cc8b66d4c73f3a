//! Recognition of applied corrections by a tracker.

use super::Tracker;
use super::expected::{ACTUATOR_ERROR, Expected};
use super::memory::{ComparedEstimate, Measured, TrackerMemory};
use crate::tracking::bytes::damaged;
use crate::tracking::settings::{Applied, AppliedPart, Change, NIGHT_S, Update};
use crate::{Error, Result};
use ndarray::{Array1, ArrayView1, s};

/// Corrections that may be applied at a time: the newest, and those that it replaced.
const MOST_CORRECTIONS: usize = 4;

impl Tracker {
    /// Expects that the correction `number`, which changes the coefficients by `change_nm`, may be
    /// applied at any time: as a whole, or to segments or NCPA alone. [`Update::applied`] says
    /// which estimate showed it. Corrections before it stay possible, of which the four newest are
    /// kept; the first that is applied takes the place of all.
    ///
    /// # Errors
    /// [`Error::Value`] before the first estimate, and for a change that is not finite;
    /// [`Error::Shape`] for another number of modes.
    pub fn expect(&mut self, number: i64, change_nm: ArrayView1<f64>) -> Result<()> {
        let Some(memory) = &self.memory else {
            return Err(Error::Value("a tracker without an estimate has nothing to correct".into()));
        };
        let (modes, given) = (memory.coordinates.modes(), change_nm.len());
        if given != modes {
            return Err(Error::Shape(format!("a correction of {given} modes was given, where {modes} are needed")));
        }
        if let Some(nm) = change_nm.iter().find(|nm| !nm.is_finite()) {
            return Err(Error::Value(format!("a correction has the number {nm} nm, where finite ones are needed")));
        }
        let whole = memory.coordinates.reduce(change_nm);
        let at = memory.coordinates.of_segments;
        let (mut segments, mut ncpa) = (whole.clone(), whole.clone());
        segments.slice_mut(s![at..]).fill(0.0);
        ncpa.slice_mut(s![..at]).fill(0.0);
        let is_moved = |change: &Array1<f64>| change.iter().any(|nm| *nm != 0.0);
        let has_both = is_moved(&segments) && is_moved(&ncpa);
        let parts = [(AppliedPart::Segments, segments), (AppliedPart::Ncpa, ncpa), (AppliedPart::Whole, whole)];
        for (part, change) in parts {
            if is_moved(&change) && (has_both || part == AppliedPart::Whole) {
                self.expected.push(Expected::new(number, part, change));
            }
        }
        let mut numbers = self.expected_corrections();
        let surplus = numbers.len().saturating_sub(MOST_CORRECTIONS);
        numbers.truncate(surplus);
        self.expected.retain(|expected| !numbers.contains(&expected.number));
        Ok(())
    }

    /// Numbers of the corrections that may be applied, the oldest first.
    pub fn expected_corrections(&self) -> Vec<i64> {
        let mut numbers: Vec<i64> = self.expected.iter().map(|expected| expected.number).collect();
        numbers.dedup();
        numbers
    }

    /// The log-likelihood ratio at which a correction is taken to be applied: with it
    /// `false_alarms_per_night` of each night at most are taken so by chance, of all corrections
    /// that are expected.
    pub fn applied_threshold(&self) -> f64 {
        let per_night = self.expected.len().max(1) as f64 * NIGHT_S / self.settings.nominal_interval_s;
        // Rates of many alarms a frame must not make every frame an application.
        (per_night / self.settings.false_alarms_per_night).ln().max(1.0)
    }

    /// Weighs an estimate for all corrections; the place of the one that it shows to be applied.
    pub(super) fn weigh(&mut self, compared: &ComparedEstimate) -> Option<usize> {
        let limit = self.memory.as_ref().map_or(f64::INFINITY, TrackerMemory::outlier_limit);
        self.expected.iter_mut().for_each(|expected| expected.weigh(compared.tested(), limit));
        let threshold = self.applied_threshold();
        self.likeliest().filter(|&place| self.expected[place].log_ratio > threshold)
    }

    /// The place of the likeliest correction.
    fn likeliest(&self) -> Option<usize> {
        let possible = self.expected.iter().enumerate().filter(|(_, one)| one.log_ratio > 0.0 && one.is_whole());
        possible.max_by(|(_, a), (_, b)| a.log_ratio.total_cmp(&b.log_ratio)).map(|(place, _)| place)
    }

    /// The place of a correction that explains `changes` at least as well as they themselves: their
    /// statistic is twice the logarithm of their likelihood ratio, with a size that is fitted,
    /// which that of a correction is not.
    pub(super) fn explanation(&self, changes: &[Change]) -> Option<usize> {
        let most = changes.iter().map(|change| change.statistic).fold(f64::NAN, f64::max);
        self.likeliest().filter(|&place| 2.0 * self.expected[place].log_ratio >= most)
    }

    /// Takes the correction at `place` to be applied, and then the estimate.
    pub(super) fn update_applied(&mut self, place: usize, measured: Measured) -> Result<Update> {
        let threshold = self.applied_threshold();
        let taken = self.expected[place].clone();
        let [fraction, fraction_error] = taken.fraction();
        let memory = self.memory.as_mut().ok_or_else(damaged)?;
        memory.move_by(&taken);
        // Who applied the one part may apply the other.
        let rest = match taken.part {
            AppliedPart::Whole => None,
            AppliedPart::Segments => Some(AppliedPart::Ncpa),
            AppliedPart::Ncpa => Some(AppliedPart::Segments),
        };
        self.expected.retain(|one| one.number == taken.number && Some(one.part) == rest);
        self.expected.iter_mut().for_each(Expected::restart);
        let compared = memory.compare(&memory.filter, &measured)?;
        let update = self.decide(measured, compared)?;
        let Expected { number, part, log_ratio, .. } = taken;
        let applied = Applied { number, part, fraction, fraction_error, log_ratio, threshold };
        Ok(Update { applied: Some(applied), ..update })
    }
}

impl TrackerMemory {
    /// Moves the state by a correction, whose size is known to the error of actuators; the drift's
    /// rate learns nothing of it.
    fn move_by(&mut self, taken: &Expected) {
        self.filter.state_nm += taken.lead_nm();
        self.filter.open(taken.change_nm.view(), ACTUATOR_ERROR.powi(2));
        self.stepped_nm += &taken.change_nm;
        self.detector.reset();
        self.suspect = None;
        self.outliers = 0;
    }
}

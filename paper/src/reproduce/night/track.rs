//! The tracker on the estimates of the night.

use super::images::Estimated;
use super::scenario::{INTERVAL_S, Jump, Scenario};
use crate::experiment::Case;
use crate::experiment::statistics::{median, rms};
use cophase::Result;
use cophase::tracking::{Change, TimedEstimate, Tracker, TrackerSettings, TrackerVerdict};
use ndarray::{Array2, ArrayView1};

/// Images after a jump within which a change of its segment is that jump, and no false alarm.
const NAMED_WITHIN: usize = 20;

/// One image.
#[derive(Debug, Clone)]
pub struct TrackedFrame {
    /// Error of its own estimate, phasing and NCPA, nm RMS; NaN where there is none.
    pub single_nm: [f64; 2],
    /// Error of the tracked state after it.
    pub tracked_nm: [f64; 2],
    /// Whether the tracker used it.
    pub is_used: bool,
    /// One word: the status of the fit if it was refused, `outlier`, or `used`.
    pub verdict: &'static str,
}

/// What the tracker made of a night.
#[derive(Debug, Clone)]
pub struct Followed {
    /// Image by image.
    pub frames: Vec<TrackedFrame>,
    /// Changes with the numbers of the images at which they were declared.
    pub changes: Vec<(usize, Change)>,
    /// Rates of the drift at the end, segments and NCPA, nm/√h.
    pub drift_nm_per_sqrt_hour: (f64, f64),
    /// Those of the truth in the estimated modes.
    pub true_drift_nm_per_sqrt_hour: [f64; 2],
    jumps: Vec<Jump>,
}

impl Followed {
    pub(super) fn new(
        case: &Case,
        scenario: &Scenario,
        estimates: &[Option<Estimated>],
        truth_nm: &[Vec<f64>],
        false_alarms_per_night: f64,
    ) -> Result<Self> {
        let mut tracker = Tracker::new(settings(scenario.segments, false_alarms_per_night))?;
        let (mut frames, mut changes) = (Vec::with_capacity(estimates.len()), Vec::new());
        for (frame, (estimate, truth_nm)) in estimates.iter().zip(truth_nm).enumerate() {
            let error = |nm: &[f64]| {
                let error_nm: Vec<f64> = nm.iter().zip(truth_nm).map(|(nm, truth)| nm - truth).collect();
                case.error_rms_nm(&error_nm)
            };
            let mut seen = TrackedFrame {
                single_nm: [f64::NAN; 2],
                tracked_nm: [f64::NAN; 2],
                is_used: false,
                verdict: "unusable",
            };
            if let Some(estimate) = estimate {
                seen.single_nm = error(&estimate.coefficients_nm)?;
                seen.verdict = estimate.status;
                // As a service does: a fit that the model does not explain is refused before it is
                // tracked.
                if estimate.status == "ok" {
                    let update = tracker.update(TimedEstimate {
                        time_s: frame as f64 * INTERVAL_S,
                        coefficients_nm: ArrayView1::from(&estimate.coefficients_nm),
                        covariance_nm2: estimate.covariance_nm2.view(),
                        pointing_nm: None,
                    })?;
                    seen.is_used = update.verdict == TrackerVerdict::Accepted;
                    seen.verdict = if seen.is_used { "used" } else { "outlier" };
                    changes.extend(update.changes.into_iter().map(|change| (frame, change)));
                }
            }
            if let Some(tracked_nm) = tracker.coefficients_nm() {
                seen.tracked_nm = error(&tracked_nm.to_vec())?;
            }
            frames.push(seen);
        }
        let drift_nm_per_sqrt_hour = tracker.drift_nm_per_sqrt_hour();
        let true_drift_nm_per_sqrt_hour = true_drift(scenario, truth_nm);
        let jumps = scenario.jumps.clone();
        Ok(Self { frames, changes, drift_nm_per_sqrt_hour, true_drift_nm_per_sqrt_hour, jumps })
    }

    /// The change that names a jump, with the images until then.
    pub fn naming(&self, jump: &Jump) -> Option<(usize, &Change)> {
        let named = self.changes.iter().find(|(frame, change)| is_of(jump, *frame, change));
        named.map(|(frame, change)| (frame + 1 - jump.frame, change))
    }

    /// Changes that are no jump.
    pub fn false_alarms(&self) -> usize {
        let is_true = |(frame, change): &&(usize, Change)| self.jumps.iter().any(|jump| is_of(jump, *frame, change));
        self.changes.len() - self.changes.iter().filter(is_true).count()
    }

    /// Errors of the used images, root of the mean square: single and tracked, phasing (0) or NCPA
    /// (1).
    pub fn rms_nm(&self, part: usize) -> [f64; 2] {
        let used = || self.frames.iter().filter(|frame| frame.is_used);
        let of = |value: &dyn Fn(&TrackedFrame) -> f64| rms(&used().map(value).collect::<Vec<f64>>());
        [of(&|frame| frame.single_nm[part]), of(&|frame| frame.tracked_nm[part])]
    }

    /// Number of the used image whose own error is the median one.
    pub(super) fn median_frame(&self) -> Option<usize> {
        let used = || self.frames.iter().enumerate().filter(|(_, frame)| frame.is_used);
        let middle = median(&used().map(|(_, frame)| frame.single_nm[0]).collect::<Vec<f64>>());
        let off = |frame: &TrackedFrame| (frame.single_nm[0] - middle).abs();
        used().min_by(|(_, a), (_, b)| off(a).total_cmp(&off(b))).map(|(number, _)| number)
    }
}

/// Root of the mean square step of a mode between images without a jump, over the root of the time:
/// segments and NCPA, nm/√h.
fn true_drift(scenario: &Scenario, truth_nm: &[Vec<f64>]) -> [f64; 2] {
    let is_quiet = |frame: usize| scenario.jumps.iter().all(|jump| jump.frame != frame);
    let steps = |modes: std::ops::Range<usize>| {
        let pairs = truth_nm.windows(2).enumerate().filter(|(before, _)| is_quiet(before + 1));
        let steps = pairs.flat_map(|(_, pair)| modes.clone().map(move |mode| pair[1][mode] - pair[0][mode]));
        rms(&steps.collect::<Vec<f64>>()) / (INTERVAL_S / 3600.0).sqrt()
    };
    let modes = truth_nm.first().map_or(0, Vec::len);
    [steps(0..scenario.segments), steps(scenario.segments..modes)]
}

fn is_of(jump: &Jump, frame: usize, change: &Change) -> bool {
    change.segment == Some(jump.segment) && (jump.frame..jump.frame + NAMED_WITHIN).contains(&frame)
}

/// Settings of a tracker that learns both rates.
pub(super) fn settings(segments: usize, false_alarms_per_night: f64) -> TrackerSettings {
    TrackerSettings {
        segment_modes: 0..segments,
        segment_of_mode: (0..segments).collect(),
        pointing_modes: Array2::zeros((0, 0)),
        drift_segments_nm_per_sqrt_hour: None,
        drift_ncpa_nm_per_sqrt_hour: None,
        false_alarms_per_night,
        nominal_interval_s: INTERVAL_S,
    }
}

/// Root of the mean square of (estimate − truth)/σ of the used images.
pub(super) fn pull(
    case: &Case,
    estimates: &[Option<Estimated>],
    truth_nm: &[Vec<f64>],
    followed: &Followed,
) -> Result<f64> {
    let mut all = Vec::new();
    for ((estimate, truth_nm), frame) in estimates.iter().zip(truth_nm).zip(&followed.frames) {
        if let Some(estimate) = estimate.as_ref().filter(|_| frame.is_used) {
            let error_nm: Vec<f64> =
                estimate.coefficients_nm.iter().zip(truth_nm).map(|(nm, truth)| nm - truth).collect();
            all.extend(case.whitened(&error_nm, &estimate.covariance_nm2)?);
        }
    }
    Ok(rms(&all))
}

//! Tracking of a night: the state after each frame, and the sentences on what has changed.

use crate::clock;
use crate::store::Event;
use cophase::modal::Model;
use cophase::pipeline::FrameEstimate;
use cophase::tracking::{Applied, AppliedPart, Change, Observation, Tracker, TrackerSettings, Verdict};
use cophase::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1};

/// How a night is tracked.
#[derive(Debug, Clone)]
pub struct TrackingSettings {
    /// False alarms that are accepted in a night of 8 hours.
    pub false_alarms_per_night: f64,
    /// Time between frames, s.
    pub interval_s: f64,
}

/// The tracker, and the settings that its state is read with.
pub struct Tracking {
    tracker: Tracker,
}

/// What a frame did to the tracker. It takes effect by [`Tracking::adopt`], once the store has it.
pub struct Step {
    tracker: Tracker,
    /// State after the frame.
    pub state: Vec<u8>,
    /// Tracked coefficients after the frame, nm.
    pub tracked_nm: Vec<f64>,
    /// Their error bars, nm.
    pub tracked_sigma_nm: Vec<f64>,
    /// What has changed.
    pub events: Vec<Event>,
    /// Why the frame was not used; `None` where it was.
    pub outlier: Option<String>,
    /// The correction that it shows to be applied.
    pub applied: Option<Applied>,
}

impl Step {
    /// Tracked coefficients and their covariance.
    pub fn tracked(&self) -> Option<(Array1<f64>, Array2<f64>)> {
        self.tracker.coefficients_nm().zip(self.tracker.covariance_nm2())
    }

    /// Number of the newest correction that may still be applied.
    pub fn expected(&self) -> Option<i64> {
        self.tracker.expected_corrections().last().copied()
    }

    /// Expects the correction `number`, which changes the coefficients by `change_nm`.
    ///
    /// # Errors
    /// Those of [`Tracker::expect`].
    pub fn expect(&mut self, number: i64, change_nm: &[f64]) -> Result<()> {
        self.tracker.expect(number, ArrayView1::from(change_nm))?;
        self.state = self.tracker.to_bytes();
        Ok(())
    }
}

impl Tracking {
    /// A tracker of the modes of `model`, which goes on from `state` where there is one.
    ///
    /// # Errors
    /// [`Error::Value`] for settings out of range and for a state of another version.
    pub fn new(model: &Model, settings: &TrackingSettings, state: Option<&[u8]>) -> Result<Self> {
        let names = &model.basis.names()[..model.segment_modes];
        let settings = TrackerSettings {
            segment_modes: 0..model.segment_modes,
            segment_of_mode: names.iter().map(|name| segment_of(name)).collect::<Result<_>>()?,
            drift_segments_nm_per_sqrt_hour: None,
            drift_ncpa_nm_per_sqrt_hour: None,
            false_alarms_per_night: settings.false_alarms_per_night,
            nominal_interval_s: settings.interval_s,
        };
        let tracker = match state {
            None => Tracker::new(settings)?,
            Some(state) => Tracker::from_bytes(settings, state)?,
        };
        Ok(Self { tracker })
    }

    /// What an estimate that was observed at `time_s` does to the tracker.
    ///
    /// # Errors
    /// [`Error::Value`] for an estimate that is not finite.
    pub fn step(&self, time_s: f64, estimate: &FrameEstimate, labels: &[String]) -> Result<Step> {
        let mut tracker = self.tracker.clone();
        let observation = Observation {
            time_s,
            coefficients_nm: ArrayView1::from(&estimate.coefficients_nm),
            covariance_nm2: estimate.covariance_nm2.view(),
        };
        let update = tracker.update(observation)?;
        let outlier = match update.verdict {
            Verdict::Accepted => None,
            Verdict::Outlier { chi2, limit } => Some(format!(
                "differs from the tracked state by more than error bars and drift allow: the tracker leaves it out ({chi2:.0}, where \
                 {limit:.0} is the limit)"
            )),
        };
        let sigma_nm = tracker.covariance_nm2().map(|covariance| covariance.diag().mapv(|nm2| nm2.max(0.0).sqrt()));
        Ok(Step {
            state: tracker.to_bytes(),
            tracked_nm: tracker.coefficients_nm().map(|nm| nm.to_vec()).unwrap_or_default(),
            tracked_sigma_nm: sigma_nm.map(|nm| nm.to_vec()).unwrap_or_default(),
            events: update
                .applied
                .iter()
                .map(|applied| application(applied, time_s))
                .chain(update.changes.iter().map(|change| event(change, labels)))
                .collect(),
            applied: update.applied,
            outlier,
            tracker,
        })
    }

    /// Goes on from the state after `step`.
    pub fn adopt(&mut self, step: Step) {
        self.tracker = step.tracker;
    }
}

/// The segment of a mode such as `segment-07-piston`.
fn segment_of(name: &str) -> Result<usize> {
    let number = name.strip_prefix("segment-").and_then(|rest| rest.split('-').next());
    let number = number.and_then(|number| number.parse().ok());
    number.ok_or_else(|| {
        Error::Scene(format!(
            "the segment mode {name} is not of one segment, as a watch needs: modes.segment = \"piston\" is accepted"
        ))
    })
}

/// A correction that was applied before the frame of `time_s`.
fn application(applied: &Applied, time_s: f64) -> Event {
    let what = match applied.part {
        AppliedPart::Whole => "was applied",
        AppliedPart::Segments => "was applied to the segments alone",
        AppliedPart::Ncpa => "was applied to the NCPA alone",
    };
    let [percent, error] = [applied.fraction, applied.fraction_error].map(|fraction| 100.0 * fraction);
    let sentence = format!(
        "correction {} {what}: {percent:.1} ± {error:.1} % of its size is seen (log-likelihood ratio {:.1}, threshold {:.1})",
        applied.number, applied.log_ratio, applied.threshold
    );
    Event { time_s, since_s: Some(time_s), ..Event::now("correction", sentence) }
}

fn event(change: &Change, labels: &[String]) -> Event {
    let Change { size_nm, size_error_nm, since_s, detected_s, statistic, threshold, .. } = *change;
    let who = match change.segment {
        Some(segment) => {
            format!(
                "segment {} moved by {size_nm:+.1} nm",
                labels.get(segment).cloned().unwrap_or_else(|| segment.to_string())
            )
        }
        None => format!("the wavefront changed by {size_nm:.1} nm in all"),
    };
    let sentence = format!(
        "{who} ± {size_error_nm:.1} nm, since {} (statistic {statistic:.0}, threshold {threshold:.0})",
        clock::to_iso(since_s)
    );
    Event {
        time_s: detected_s,
        kind: if change.segment.is_some() { "segment" } else { "wavefront" },
        sentence,
        segment: change.segment,
        size_nm: Some(size_nm),
        size_error_nm: Some(size_error_nm),
        since_s: Some(since_s),
    }
}

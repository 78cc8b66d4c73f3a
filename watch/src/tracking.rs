//! Tracking of a night: the state after each frame, and the sentences on what has changed.

use crate::clock;
use crate::store::Event;
use cophase::modal::{ModalFitter, Pointing};
use cophase::pipeline::FrameEstimate;
use cophase::tracking::{
    Applied, AppliedPart, Change, PointingChange, TimedEstimate, Tracker, TrackerSettings, TrackerVerdict,
};
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

/// The tracker, and where it takes the star to be.
pub struct Tracking {
    tracker: Tracker,
    pointing: Pointing,
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
    /// A tracker of the modes of `fitter`, which goes on from `state` where there is one.
    ///
    /// # Errors
    /// [`Error::Value`] for settings out of range and for a state of another version.
    pub fn new(fitter: &ModalFitter, settings: &TrackingSettings, state: Option<&[u8]>) -> Result<Self> {
        let (model, pointing) = (fitter.model(), fitter.pointing()?);
        let names = &model.basis.names()[..model.segment_modes];
        let settings = TrackerSettings {
            segment_modes: 0..model.segment_modes,
            segment_of_mode: names.iter().map(|name| segment_of(name)).collect::<Result<_>>()?,
            pointing_modes: pointing.modes.clone(),
            drift_segments_nm_per_sqrt_hour: None,
            drift_ncpa_nm_per_sqrt_hour: None,
            false_alarms_per_night: settings.false_alarms_per_night,
            nominal_interval_s: settings.interval_s,
        };
        let tracker = match state {
            None => Tracker::new(settings)?,
            Some(state) => Tracker::from_bytes(settings, state)?,
        };
        Ok(Self { tracker, pointing })
    }

    /// Why the star's motion may be taken for a change of the wavefront; `None` where it is not.
    pub fn warning(&self) -> Option<String> {
        let remedy = "modes.exact_zernikes = [2, 3] adds them";
        if self.pointing.modes.nrows() == 0 {
            let what = "the modes hold no tip and tilt of the whole pupil: where the star moves, the wavefront seems to change";
            return Some(format!("{what}; {remedy}"));
        }
        (!self.pointing.is_exact).then(|| {
            format!("the modes hold tip and tilt of the whole pupil nearly, not exactly: a part of the star's motion is left in them; {remedy}")
        })
    }

    /// The star of an estimate, pixels of the frame from the axis along x and y; NaN where it is
    /// not known.
    pub fn pointing_pixels(&self, estimate: &FrameEstimate) -> [f64; 2] {
        let nm = self.pointing.of(&estimate.modes.coefficients_nm, estimate.report.tip_tilt_nm);
        [0, 1].map(|axis| nm[axis] / self.pointing.nm_per_pixel[axis])
    }

    /// Coefficients of an estimate without its pointing.
    pub fn without_pointing(&self, coefficients_nm: &[f64]) -> Vec<f64> {
        self.pointing.removed_from(coefficients_nm)
    }

    /// What an estimate that was observed at `time_s` does to the tracker.
    ///
    /// # Errors
    /// [`Error::Value`] for an estimate that is not finite.
    pub fn step(&self, time_s: f64, estimate: &FrameEstimate, labels: &[String]) -> Result<Step> {
        let mut tracker = self.tracker.clone();
        let observation = TimedEstimate {
            time_s,
            coefficients_nm: ArrayView1::from(&estimate.modes.coefficients_nm),
            covariance_nm2: estimate.modes.covariance_nm2.view(),
            pointing_nm: Some(self.pointing.of(&estimate.modes.coefficients_nm, estimate.report.tip_tilt_nm))
                .filter(|nm| nm.iter().all(|nm| nm.is_finite())),
        };
        let update = tracker.update(observation)?;
        let outlier = match update.verdict {
            TrackerVerdict::Accepted => None,
            TrackerVerdict::Outlier { chi2, limit, segment } => {
                let most = segment.map(|segment| format!(", most in segment {}", label(segment, labels)));
                Some(format!(
                    "the wavefront of this frame differs from the tracked one {} error bars and drift allow{}: the tracker leaves it out, \
                     unless the next frame shows the same",
                    by_how_much(chi2, limit),
                    most.unwrap_or_default()
                ))
            }
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
                .chain(update.pointing.iter().map(|change| self.pointing_event(change)))
                .collect(),
            applied: update.applied,
            outlier,
            tracker,
        })
    }

    /// A star that went elsewhere.
    fn pointing_event(&self, change: &PointingChange) -> Event {
        let PointingChange { moved_nm, error_nm, rms_nm, since_s, detected_s } = *change;
        let per_pixel_nm = self.pointing.nm_per_pixel;
        let [x, y] = [0, 1].map(|axis| moved_nm[axis] / per_pixel_nm[axis]);
        let [error, rms] = [error_nm, rms_nm].map(|nm| nm / per_pixel_nm[0].min(per_pixel_nm[1]));
        let sentence = format!(
            "the star moved by {:.2} ± {error:.2} pixels (x {x:+.2}, y {y:+.2}), since {}; before, it moved by {rms:.2} pixels RMS along \
             each axis",
            x.hypot(y),
            clock::to_iso(since_s)
        );
        Event {
            time_s: detected_s,
            kind: "pointing",
            sentence,
            size_nm: Some(moved_nm[0].hypot(moved_nm[1])),
            size_error_nm: Some(error_nm),
            since_s: Some(since_s),
            segment: None,
        }
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
            format!("segment {} moved by {size_nm:+.1} nm", label(segment, labels))
        }
        None => format!("the wavefront changed by {size_nm:.1} nm in all"),
    };
    let sentence = format!(
        "{who} ± {size_error_nm:.1} nm, since {}: {} noise and drift explain",
        clock::to_iso(since_s),
        by_how_much(statistic, threshold)
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

/// The label of a segment.
fn label(segment: usize, labels: &[String]) -> String {
    labels.get(segment).cloned().unwrap_or_else(|| segment.to_string())
}

/// By how much a statistic, a square, exceeds its threshold, in words: some error bars, or many.
fn by_how_much(statistic: f64, threshold: f64) -> &'static str {
    match (statistic / threshold).sqrt() {
        ratio if ratio < 1.5 => "by a little more than",
        ratio if ratio < 5.0 => "by more than",
        _ => "by far more than",
    }
}

//! The tracker: filter, rates, detector and the rejection of outliers in turn.

mod expected;
mod memory;
mod memory_bytes;
mod recognition;

use super::bytes::{ByteReader, Writer, damaged};
use super::motion::Motion;
use super::settings::{Change, TimedEstimate, TrackerSettings, TrackerVerdict, Update};
use crate::{Error, Result};
use expected::Expected;
use memory::{ComparedEstimate, MOST_OUTLIERS, Measured, TrackerMemory};
use ndarray::{Array1, Array2};

/// First bytes of a state, with the version of its format.
const MAGIC: &[u8; 8] = b"CPTRACK2";

/// Kalman filter with a detector of changes: estimates in, tracked state and alarms out. See the
/// [module](super).
///
/// The cost of an estimate is that of some dense products of its modes: 1 ms for 56 modes, 0.7 s
/// for 850 (`docs/tracking.md`).
#[derive(Debug, Clone)]
pub struct Tracker {
    settings: TrackerSettings,
    memory: Option<TrackerMemory>,
    /// Corrections that may be applied.
    expected: Vec<Expected>,
}

impl Tracker {
    /// A tracker without a state: the first observation is it.
    ///
    /// # Errors
    /// [`Error::Value`] for a number out of range, [`Error::Shape`] where the segments do not fit
    /// the modes.
    pub fn new(settings: TrackerSettings) -> Result<Self> {
        settings.check()?;
        Ok(Self { settings, memory: None, expected: Vec::new() })
    }

    /// The settings.
    pub fn settings(&self) -> &TrackerSettings {
        &self.settings
    }

    /// Takes an estimate. An estimate at the time of the one before, or earlier, is used as if no
    /// time had passed. One that shows that an expected correction was applied
    /// ([`Tracker::expect`]) moves the state by it, and is no alarm.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of modes, [`Error::Value`] for numbers that are not
    /// finite and for a covariance that is negative along a direction; the state is then as before.
    pub fn update(&mut self, observation: TimedEstimate<'_>) -> Result<Update> {
        self.check(&observation)?;
        let Some(memory) = &self.memory else {
            let mut memory = TrackerMemory::new(&self.settings, &observation)?;
            let first = memory.measure(&observation);
            memory.learn(&first);
            let pointing = memory.point(&observation);
            self.memory = Some(memory);
            return Ok(Update { pointing, ..Update::accepted() });
        };
        let measured = memory.measure(&observation);
        let hours = (measured.time_s - memory.time_s).max(0.0) / 3600.0;
        let mut filter = memory.filter.clone();
        filter.predict(memory.motion.added_nm2(hours).into_iter());
        // A covariance that is bad is found here, before anything is changed.
        let compared = memory.compare(&filter, &measured)?;
        let memory = self.memory.as_mut().ok_or_else(damaged)?;
        (memory.filter, memory.time_s) = (filter, measured.time_s);
        // The star is where it is in an image whose wavefront is an outlier, too.
        let pointing = memory.point(&observation);
        Ok(Update { pointing, ..self.update_wavefront(measured, compared)? })
    }

    /// Takes an estimate without its pointing.
    fn update_wavefront(&mut self, measured: Measured, compared: ComparedEstimate) -> Result<Update> {
        if let Some(place) = self.weigh(&compared) {
            return self.update_applied(place, measured);
        }
        if self.expected.iter().all(|expected| expected.log_ratio == 0.0) {
            return self.decide(measured, compared);
        }
        // What looks like a change may be a correction that is not proven yet.
        let before = self.clone();
        let update = self.decide(measured.clone(), compared)?;
        match before.explanation(&update.changes) {
            None => Ok(update),
            Some(place) => {
                *self = before;
                self.update_applied(place, measured)
            }
        }
    }

    /// Accepts an observation, holds it back as an outlier, or confirms the one before.
    fn decide(&mut self, measured: Measured, compared: ComparedEstimate) -> Result<Update> {
        let memory = self.memory.as_mut().ok_or_else(damaged)?;
        if let Some(suspect) = memory.suspect.take()
            && let Some(changes) = memory.confirm(&suspect, &measured, &compared)?
        {
            memory.learn(&suspect);
            memory.learn(&measured);
            return Ok(self.changed(changes));
        }
        if let Some((chi2, limit)) = compared.outlier {
            memory.outliers += 1;
            if memory.outliers < MOST_OUTLIERS {
                memory.suspect = Some(measured);
                let segment = compared.largest.map(|mode| self.settings.segment_of_mode[mode]);
                return Ok(Update { verdict: TrackerVerdict::Outlier { chi2, limit, segment }, ..Update::accepted() });
            }
            let change = memory.start_again(&measured, &compared)?;
            memory.learn(&measured);
            return Ok(self.changed(vec![change]));
        }
        let changes = memory.accept(&measured, compared, &mut self.expected)?;
        memory.learn(&measured);
        Ok(self.changed(changes))
    }

    /// An accepted observation with its changes, which are no correction: those start again.
    fn changed(&mut self, changes: Vec<Change>) -> Update {
        if !changes.is_empty() {
            self.expected.iter_mut().for_each(Expected::restart);
        }
        let changes = changes.into_iter().map(|change| self.name(change)).collect();
        Update { changes, ..Update::accepted() }
    }

    /// Tracked coefficients, nm; `None` before the first estimate.
    pub fn coefficients_nm(&self) -> Option<Array1<f64>> {
        self.memory.as_ref().map(|memory| memory.coordinates.expand(&memory.filter.state_nm))
    }

    /// Their covariance, nm², `[mode, mode]`; `None` before the first estimate.
    pub fn covariance_nm2(&self) -> Option<Array2<f64>> {
        self.memory.as_ref().map(|memory| memory.coordinates.expand_covariance(&memory.filter.covariance_nm2))
    }

    /// Drift of a segment mode and of an NCPA mode, nm/√h: standard deviation of the change of one
    /// coefficient in an hour.
    pub fn drift_nm_per_sqrt_hour(&self) -> (f64, f64) {
        match &self.memory {
            Some(memory) => memory.motion.nm_per_sqrt_hour(),
            None => Motion::new(&self.settings, [0; 2]).nm_per_sqrt_hour(),
        }
    }

    /// Scatter of the star's pointing about where it is expected, along each axis, nm RMS of tip or
    /// tilt; `None` before the second estimate with a pointing.
    pub fn pointing_rms_nm(&self) -> Option<f64> {
        self.memory.as_ref().and_then(|memory| memory.pointing.rms_nm())
    }

    /// The state, from which [`Tracker::from_bytes`] goes on to the same bits.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut writer = Writer(MAGIC.to_vec());
        writer.number(self.settings.segment_modes.start);
        writer.number(self.settings.segment_modes.end);
        writer.number(usize::from(self.memory.is_some()));
        if let Some(memory) = &self.memory {
            memory.write(&mut writer);
            writer.number(self.expected.len());
            self.expected.iter().for_each(|expected| expected.write(&mut writer));
        }
        writer.0
    }

    /// The tracker whose [`Tracker::to_bytes`] wrote `bytes`. Rates, alarms and the interval of
    /// `settings` may differ from those of then.
    ///
    /// # Errors
    /// [`Error::Value`] for bytes of another format or version, damaged ones, and those of other
    /// segment modes.
    pub fn from_bytes(settings: TrackerSettings, bytes: &[u8]) -> Result<Self> {
        let mut tracker = Self::new(settings)?;
        let settings = &tracker.settings;
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| {
            Error::Value("the state of a tracker is of another version: that of this program is needed".into())
        })?;
        let mut reader = ByteReader(rest);
        let range = reader.number()?..reader.number()?;
        if range != settings.segment_modes {
            return Err(Error::Value(format!(
                "the state of a tracker has the segment modes {range:?}, the settings {:?}: the same are needed",
                settings.segment_modes
            )));
        }
        if reader.number()? == 1 {
            let memory = TrackerMemory::read(settings, &mut reader)?;
            if !memory.coordinates.are_without(settings.pointing_modes.view()) {
                return Err(Error::Value(
                    "the state of a tracker has the pointing in other modes than the settings: the same are needed"
                        .into(),
                ));
            }
            for _ in 0..reader.number()? {
                tracker.expected.push(Expected::read(memory.coordinates.len(), &mut reader)?);
            }
            tracker.memory = Some(memory);
        }
        reader.finish()?;
        Ok(tracker)
    }

    fn check(&self, observation: &TimedEstimate<'_>) -> Result<()> {
        let modes = observation.coefficients_nm.len();
        let segments = &self.settings.segment_modes;
        let known = self.memory.as_ref().map(|memory| memory.coordinates.modes());
        if known.is_some_and(|known| known != modes) || segments.end > modes || modes == 0 {
            let wanted = known.map_or(format!("{} or more", segments.end.max(1)), |known| known.to_string());
            return Err(Error::Shape(format!("an estimate of {modes} modes was given, where {wanted} are needed")));
        }
        let pointing = &self.settings.pointing_modes;
        if pointing.nrows() > 0 && pointing.ncols() != modes {
            let given = pointing.ncols();
            return Err(Error::Shape(format!(
                "the pointing is given in {given} modes, where an estimate has {modes}: the same modes are needed"
            )));
        }
        if observation.covariance_nm2.dim() != (modes, modes) {
            let (rows, columns) = observation.covariance_nm2.dim();
            return Err(Error::Shape(format!(
                "a covariance of {rows}x{columns} was given for {modes} modes; {modes}x{modes} is needed"
            )));
        }
        let numbers = observation.coefficients_nm.iter().chain(&observation.covariance_nm2);
        let numbers = numbers.chain(observation.pointing_nm.iter().flatten());
        match numbers.chain([&observation.time_s]).find(|value| !value.is_finite()) {
            Some(value) => {
                Err(Error::Value(format!("an estimate has the number {value}, where finite ones are needed")))
            }
            None => Ok(()),
        }
    }

    /// Turns the number of a segment mode into the mode and its segment.
    fn name(&self, change: Change) -> Change {
        let segment = change.mode.map(|mode| self.settings.segment_of_mode[mode]);
        let mode = change.mode.map(|mode| mode + self.settings.segment_modes.start);
        Change { segment, mode, ..change }
    }
}

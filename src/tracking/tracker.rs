//! The tracker: filter, rates, detector and the rejection of outliers in turn.

mod memory_bytes;

use super::bytes::{Reader, Writer, damaged};
use super::change_detector::{Alarm, ChangeDetector};
use super::coordinates::Coordinates;
use super::drift_rate::DriftRate;
use super::filter::{Filter, Innovation};
use super::settings::{Change, NIGHT_S, Observation, TrackerSettings, Update, Verdict};
use super::steps::{Step, attribute, most_likely_step};
use super::threshold::chi2_limit;
use crate::{Error, Result};
use ndarray::{Array1, Array2, s};

/// An estimate is an outlier where χ² exceeds that of 4 standard deviations: of a night of one every 10 s, 0.1 by chance. It costs no more
/// than the estimate.
const OUTLIER_Z: f64 = 4.0;
/// The step in one mode that an outlier has is confirmed where the next estimate has it at 3 standard deviations.
const CONFIRMING_CHI2: f64 = 9.0;
/// Outliers in a row that do not confirm each other, after which the state is given up.
const MOST_OUTLIERS: usize = 10;
/// Error bars, in terms of those of the step, to which the state is opened along a step: what was there before has no weight.
const OPENING: f64 = 100.0;
/// First bytes of a state, with the version of its format.
const MAGIC: &[u8; 8] = b"CPTRACK1";

/// Kalman filter with a detector of changes: estimates in, tracked state and alarms out. See the [module](super).
///
/// The cost of an estimate is that of some dense products of its modes: 1 ms for 56 modes, 0.7 s for 850 (`docs/tracking.md`).
#[derive(Debug, Clone)]
pub struct Tracker {
    settings: TrackerSettings,
    rates: [DriftRate; 2],
    memory: Option<Memory>,
}

/// All that observations have left.
#[derive(Debug, Clone)]
struct Memory {
    coordinates: Coordinates,
    /// Steps of 1 nm of each segment mode, `[coordinate, mode]`.
    steps: Array2<f64>,
    filter: Filter,
    detector: ChangeDetector,
    /// Time of the last observation, s, accepted or not, and of the last accepted one.
    time_s: f64,
    learnt_s: f64,
    /// Sum of the declared steps, which are no drift.
    stepped_nm: Array1<f64>,
    suspect: Option<Measured>,
    outliers: usize,
}

/// An observation in the coordinates.
#[derive(Debug, Clone)]
struct Measured {
    time_s: f64,
    z_nm: Array1<f64>,
    covariance_nm2: Array2<f64>,
}

/// An innovation with what follows from it.
struct Compared {
    innovation: Innovation,
    /// Steps, white.
    white_steps: Array2<f64>,
    /// Statistic and limit that were exceeded, if they were.
    outlier: Option<(f64, f64)>,
}

impl Tracker {
    /// A tracker without a state: the first observation is it.
    ///
    /// # Errors
    /// [`Error::Value`] for a number out of range, [`Error::Shape`] where the segments do not fit the modes.
    pub fn new(settings: TrackerSettings) -> Result<Self> {
        settings.check()?;
        let rates = [settings.drift_segments_nm_per_sqrt_hour, settings.drift_ncpa_nm_per_sqrt_hour];
        Ok(Self { settings, rates: rates.map(DriftRate::new), memory: None })
    }

    /// The settings.
    pub fn settings(&self) -> &TrackerSettings {
        &self.settings
    }

    /// Takes an estimate. An estimate at the time of the one before, or earlier, is used as if no time had passed.
    ///
    /// # Errors
    /// [`Error::Shape`] for another number of modes, [`Error::Value`] for numbers that are not finite and for a covariance that is negative
    /// along a direction; the state is then as before.
    pub fn update(&mut self, observation: Observation<'_>) -> Result<Update> {
        self.check(&observation)?;
        let Some(memory) = &self.memory else {
            let memory = Memory::new(&self.settings, &observation)?;
            let first = memory.measure(&observation);
            self.memory = Some(memory);
            self.learn(&first);
            return Ok(Update { verdict: Verdict::Accepted, changes: Vec::new() });
        };
        let measured = memory.measure(&observation);
        let hours = (measured.time_s - memory.time_s).max(0.0) / 3600.0;
        let mut filter = memory.filter.clone();
        filter.predict(memory.by_block(self.rates[0].added_nm2(hours), self.rates[1].added_nm2(hours)).into_iter());
        // A covariance that is bad is found here, before anything is changed.
        let compared = memory.compare(&filter, &measured)?;
        let memory = self.memory.as_mut().ok_or_else(damaged)?;
        (memory.filter, memory.time_s) = (filter, measured.time_s);
        if let Some(suspect) = memory.suspect.take() {
            let hours = (measured.time_s - suspect.time_s).max(0.0) / 3600.0;
            let [segments, ncpa] = [&self.rates[0], &self.rates[1]].map(|rate| rate.added_nm2(hours));
            let walk_nm2 = memory.by_block(segments, ncpa);
            if let Some(changes) = memory.confirm(&suspect, &measured, &compared, &walk_nm2)? {
                let changes = changes.into_iter().map(|change| self.name(change)).collect();
                self.learn(&suspect);
                self.learn(&measured);
                return Ok(Update { verdict: Verdict::Accepted, changes });
            }
        }
        if let Some((chi2, limit)) = compared.outlier {
            memory.outliers += 1;
            if memory.outliers < MOST_OUTLIERS {
                memory.suspect = Some(measured);
                return Ok(Update { verdict: Verdict::Outlier { chi2, limit }, changes: Vec::new() });
            }
            let change = memory.start_again(&measured, &compared)?;
            self.learn(&measured);
            return Ok(Update { verdict: Verdict::Accepted, changes: vec![change] });
        }
        let changes = memory.accept(&measured, compared)?;
        let changes = changes.into_iter().map(|change| self.name(change)).collect();
        self.learn(&measured);
        Ok(Update { verdict: Verdict::Accepted, changes })
    }

    /// Tracked coefficients, nm; `None` before the first estimate.
    pub fn coefficients_nm(&self) -> Option<Array1<f64>> {
        self.memory.as_ref().map(|memory| memory.coordinates.expand(&memory.filter.state_nm))
    }

    /// Their covariance, nm², `[mode, mode]`; `None` before the first estimate.
    pub fn covariance_nm2(&self) -> Option<Array2<f64>> {
        self.memory.as_ref().map(|memory| memory.coordinates.expand_covariance(&memory.filter.covariance_nm2))
    }

    /// Drift of a segment mode and of an NCPA mode, nm/√h: standard deviation of the change of one coefficient in an hour.
    pub fn drift_nm_per_sqrt_hour(&self) -> (f64, f64) {
        (self.rates[0].nm_per_sqrt_hour(), self.rates[1].nm_per_sqrt_hour())
    }

    /// The state, from which [`Tracker::from_bytes`] goes on to the same bits.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut writer = Writer(MAGIC.to_vec());
        writer.number(self.settings.segment_modes.start);
        writer.number(self.settings.segment_modes.end);
        writer.number(usize::from(self.memory.is_some()));
        if let Some(memory) = &self.memory {
            memory.write(&mut writer);
            self.rates.iter().for_each(|rate| rate.write(&mut writer));
        }
        writer.0
    }

    /// The tracker whose [`Tracker::to_bytes`] wrote `bytes`. Rates, alarms and the interval of `settings` may differ from those of then.
    ///
    /// # Errors
    /// [`Error::Value`] for bytes of another format or version, damaged ones, and those of other segment modes.
    pub fn from_bytes(settings: TrackerSettings, bytes: &[u8]) -> Result<Self> {
        let mut tracker = Self::new(settings)?;
        let settings = &tracker.settings;
        let rest = bytes.strip_prefix(MAGIC).ok_or_else(|| {
            Error::Value("the state of a tracker is of another version: that of this program is needed".into())
        })?;
        let mut reader = Reader(rest);
        let range = reader.number()?..reader.number()?;
        if range != settings.segment_modes {
            return Err(Error::Value(format!(
                "the state of a tracker has the segment modes {range:?}, the settings {:?}: the same are needed",
                settings.segment_modes
            )));
        }
        if reader.number()? == 1 {
            let memory = Memory::read(settings, &mut reader)?;
            let blocks = [memory.coordinates.of_segments, memory.coordinates.len() - memory.coordinates.of_segments];
            let given = [settings.drift_segments_nm_per_sqrt_hour, settings.drift_ncpa_nm_per_sqrt_hour];
            let [segments, ncpa] = [0, 1].map(|at| DriftRate::read(given[at], blocks[at], &mut reader));
            tracker.rates = [segments?, ncpa?];
            tracker.memory = Some(memory);
        }
        reader.finish()?;
        Ok(tracker)
    }

    fn check(&self, observation: &Observation<'_>) -> Result<()> {
        let modes = observation.coefficients_nm.len();
        let segments = &self.settings.segment_modes;
        let known = self.memory.as_ref().map(|memory| memory.coordinates.modes());
        if known.is_some_and(|known| known != modes) || segments.end > modes || modes == 0 {
            let wanted = known.map_or(format!("{} or more", segments.end.max(1)), |known| known.to_string());
            return Err(Error::Shape(format!("an estimate of {modes} modes was given, where {wanted} are needed")));
        }
        if observation.covariance_nm2.dim() != (modes, modes) {
            let (rows, columns) = observation.covariance_nm2.dim();
            return Err(Error::Shape(format!(
                "a covariance of {rows}x{columns} was given for {modes} modes; {modes}x{modes} is needed"
            )));
        }
        let numbers = observation.coefficients_nm.iter().chain(&observation.covariance_nm2);
        match numbers.chain([&observation.time_s]).find(|value| !value.is_finite()) {
            Some(value) => {
                Err(Error::Value(format!("an estimate has the number {value}, where finite ones are needed")))
            }
            None => Ok(()),
        }
    }

    /// Gives the banks of rates an accepted observation.
    fn learn(&mut self, measured: &Measured) {
        let Some(memory) = &mut self.memory else { return };
        let hours = (measured.time_s - memory.learnt_s).max(0.0) / 3600.0;
        memory.learnt_s = measured.time_s;
        let (z_nm, variances_nm2) = (&measured.z_nm - &memory.stepped_nm, measured.covariance_nm2.diag());
        let at = memory.coordinates.of_segments;
        let [segments, ncpa] = &mut self.rates;
        segments.learn(z_nm.slice(s![..at]), variances_nm2.slice(s![..at]), hours);
        ncpa.learn(z_nm.slice(s![at..]), variances_nm2.slice(s![at..]), hours);
    }

    /// Turns the number of a segment mode into the mode and its segment.
    fn name(&self, change: Change) -> Change {
        let segment = change.mode.map(|mode| self.settings.segment_of_mode[mode]);
        let mode = change.mode.map(|mode| mode + self.settings.segment_modes.start);
        Change { segment, mode, ..change }
    }
}

impl Memory {
    fn new(settings: &TrackerSettings, observation: &Observation<'_>) -> Result<Self> {
        let coordinates = Coordinates::new(observation.covariance_nm2, &settings.segment_modes)?;
        let z_nm = coordinates.reduce(observation.coefficients_nm);
        let filter = Filter::new(z_nm, coordinates.reduce_covariance(observation.covariance_nm2));
        Ok(Self::with(settings, coordinates, filter, [observation.time_s; 2]))
    }

    fn with(
        settings: &TrackerSettings,
        coordinates: Coordinates,
        filter: Filter,
        [time_s, learnt_s]: [f64; 2],
    ) -> Self {
        let steps = coordinates.steps(&settings.segment_modes);
        let per_step = settings.false_alarms_per_night * settings.nominal_interval_s / NIGHT_S;
        let detector = ChangeDetector::new(steps.ncols(), coordinates.len(), per_step);
        let stepped_nm = Array1::zeros(coordinates.len());
        Self { coordinates, steps, filter, detector, time_s, learnt_s, stepped_nm, suspect: None, outliers: 0 }
    }

    fn measure(&self, observation: &Observation<'_>) -> Measured {
        Measured {
            time_s: observation.time_s,
            z_nm: self.coordinates.reduce(observation.coefficients_nm),
            covariance_nm2: self.coordinates.reduce_covariance(observation.covariance_nm2),
        }
    }

    /// A value for each coordinate: that of its block.
    fn by_block(&self, segments: f64, ncpa: f64) -> Array1<f64> {
        let at = self.coordinates.of_segments;
        (0..self.coordinates.len()).map(|coordinate| if coordinate < at { segments } else { ncpa }).collect()
    }

    /// An observation beside what `filter` predicts.
    fn compare(&self, filter: &Filter, measured: &Measured) -> Result<Compared> {
        let innovation = filter.innovation(&measured.z_nm, &measured.covariance_nm2)?;
        let white_steps = innovation.whiten(&self.steps);
        let chi2 = innovation.chi2();
        let limit = chi2_limit(self.coordinates.len(), OUTLIER_Z);
        let mut outlier = (chi2 > limit).then_some((chi2, limit));
        let mode_limit = self.detector.mode_threshold;
        let largest = most_likely_step(&innovation, &white_steps).filter(|step| step.statistic > mode_limit);
        outlier = outlier.or(largest.map(|step| (step.statistic, mode_limit)));
        Ok(Compared { innovation, white_steps, outlier })
    }

    /// The changes that `suspect` and the next observation show together, where they do; both are then used. Modes are numbers of segment
    /// modes here.
    fn confirm(
        &mut self,
        suspect: &Measured,
        next: &Measured,
        compared: &Compared,
        walk_nm2: &Array1<f64>,
    ) -> Result<Option<Vec<Change>>> {
        // The mean of the two, and how it differs from the state.
        let mean_nm = (&suspect.z_nm + &next.z_nm) * 0.5;
        let mean_covariance_nm2 = (&suspect.covariance_nm2 + &next.covariance_nm2) * 0.25;
        let difference = self.filter.innovation(&mean_nm, &mean_covariance_nm2)?;
        let white_steps = difference.whiten(&self.steps);
        let threshold = self.detector.mode_threshold;
        let mut attribution = attribute(&difference, &white_steps, threshold);
        let is_named = match attribution.steps.as_slice() {
            [] => false,
            [first, ..] => {
                let white_step = compared.white_steps.column(first.mode);
                let alone = white_step.dot(&compared.innovation.white) / white_step.dot(&white_step).sqrt();
                alone * first.size_nm.signum() > CONFIRMING_CHI2.sqrt()
            }
        };
        let agrees = || -> Result<bool> {
            let mut covariance_nm2 = suspect.covariance_nm2.clone();
            covariance_nm2.diag_mut().iter_mut().zip(walk_nm2).for_each(|(variance, walk)| *variance += walk);
            let pair = Filter::new(suspect.z_nm.clone(), covariance_nm2);
            let chi2 = pair.innovation(&next.z_nm, &next.covariance_nm2)?.chi2();
            Ok(chi2 < chi2_limit(self.coordinates.len(), OUTLIER_Z))
        };
        if !agrees()? || !(is_named || compared.outlier.is_some()) {
            return Ok(None);
        }
        let limit = chi2_limit(self.coordinates.len(), OUTLIER_Z);
        let times_s = [suspect.time_s, next.time_s];
        let changes = if attribution.rest_chi2 < limit && !attribution.steps.is_empty() {
            attribution.steps.drain(..).map(|step| self.follow(step, times_s)).collect()
        } else {
            let moved_nm = &mean_nm - &self.filter.state_nm;
            let error_nm = (&self.filter.covariance_nm2 + &mean_covariance_nm2).diag().sum().sqrt();
            self.filter.open_all((OPENING * error_nm).powi(2));
            vec![Change {
                segment: None,
                mode: None,
                size_nm: moved_nm.dot(&moved_nm).sqrt(),
                size_error_nm: error_nm,
                since_s: suspect.time_s,
                detected_s: next.time_s,
                statistic: difference.chi2(),
                threshold: limit,
            }]
        };
        for measured in [suspect, next] {
            let innovation = self.filter.innovation(&measured.z_nm, &measured.covariance_nm2)?;
            self.filter.update(&innovation);
        }
        self.detector.reset();
        self.outliers = 0;
        Ok(Some(changes))
    }

    /// Uses an observation, and looks for changes in the window that ends with it.
    fn accept(&mut self, measured: &Measured, compared: Compared) -> Result<Vec<Change>> {
        self.outliers = 0;
        let Compared { mut innovation, white_steps, .. } = compared;
        let before = self.filter.clone();
        self.filter.update(&innovation);
        let along = |covariance_nm2: &Array2<f64>| -> Array1<f64> {
            (&covariance_nm2.dot(&self.steps) * &self.steps).sum_axis(ndarray::Axis(0))
        };
        let gain = 1.0 - along(&self.filter.covariance_nm2) / along(&before.covariance_nm2);
        self.detector.push(measured.time_s, innovation.white.clone(), &white_steps, gain);
        let Some((alarm, since_s)) = self.detector.alarm() else { return Ok(Vec::new()) };
        self.filter = before;
        let times_s = [since_s, measured.time_s];
        let change = match alarm {
            Alarm::Mode(step) => self.follow(step, times_s),
            Alarm::All(size_nm, size_error_nm, statistic) => {
                self.filter.open_all((OPENING * size_error_nm).powi(2));
                let threshold = self.detector.all_threshold;
                let [since_s, detected_s] = times_s;
                Change { segment: None, mode: None, size_nm, size_error_nm, since_s, detected_s, statistic, threshold }
            }
        };
        innovation = self.filter.innovation(&measured.z_nm, &measured.covariance_nm2)?;
        self.filter.update(&innovation);
        self.detector.reset();
        Ok(vec![change])
    }

    /// Opens the state along a step, of which the drift's rate learns nothing.
    fn follow(&mut self, step: Step, [since_s, detected_s]: [f64; 2]) -> Change {
        let Step { mode, size_nm, error_nm, statistic } = step;
        self.filter.open(self.steps.column(mode), (OPENING * error_nm).powi(2));
        self.stepped_nm.scaled_add(size_nm, &self.steps.column(mode));
        let threshold = self.detector.mode_threshold;
        let (mode, size_error_nm) = (Some(mode), error_nm);
        Change { segment: None, mode, size_nm, size_error_nm, since_s, detected_s, statistic, threshold }
    }

    /// Takes an observation for the state, after more outliers than a disturbance has.
    fn start_again(&mut self, measured: &Measured, compared: &Compared) -> Result<Change> {
        let moved_nm = &measured.z_nm - &self.filter.state_nm;
        let error_nm = (&self.filter.covariance_nm2 + &measured.covariance_nm2).diag().sum().sqrt();
        self.filter = Filter::new(measured.z_nm.clone(), measured.covariance_nm2.clone());
        self.detector.reset();
        self.outliers = 0;
        Ok(Change {
            segment: None,
            mode: None,
            size_nm: moved_nm.dot(&moved_nm).sqrt(),
            size_error_nm: error_nm,
            since_s: measured.time_s,
            detected_s: measured.time_s,
            statistic: compared.innovation.chi2(),
            threshold: chi2_limit(self.coordinates.len(), OUTLIER_Z),
        })
    }
}

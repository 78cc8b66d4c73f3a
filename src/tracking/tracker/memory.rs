//! What observations have left in a tracker: filter, detector, a suspect.

use super::expected::Expected;
use crate::Result;
use crate::tracking::change_detector::{Alarm, ChangeDetector};
use crate::tracking::coordinates::Coordinates;
use crate::tracking::filter::{Filter, Innovation};
use crate::tracking::settings::{Change, NIGHT_S, Observation, TrackerSettings};
use crate::tracking::steps::{Step, attribute, most_likely_step};
use crate::tracking::threshold::chi2_limit;
use ndarray::{Array1, Array2};

/// An estimate is an outlier where χ² exceeds that of 4 standard deviations: of a night of one every 10 s, 0.1 by chance. It costs no more
/// than the estimate.
const OUTLIER_Z: f64 = 4.0;
/// The step in one mode that an outlier has is confirmed where the next estimate has it at 3 standard deviations.
const CONFIRMING_CHI2: f64 = 9.0;
/// Outliers in a row that do not confirm each other, after which the state is given up.
pub(super) const MOST_OUTLIERS: usize = 10;
/// Error bars, in terms of those of the step, to which the state is opened along a step: what was there before has no weight.
const OPENING: f64 = 100.0;
/// All that observations have left.
#[derive(Debug, Clone)]
pub(super) struct Memory {
    pub(super) coordinates: Coordinates,
    /// Steps of 1 nm of each segment mode, `[coordinate, mode]`.
    pub(super) steps: Array2<f64>,
    pub(super) filter: Filter,
    pub(super) detector: ChangeDetector,
    /// Time of the last observation, s, accepted or not, and of the last accepted one.
    pub(super) time_s: f64,
    pub(super) learnt_s: f64,
    /// Sum of the declared steps, which are no drift.
    pub(super) stepped_nm: Array1<f64>,
    pub(super) suspect: Option<Measured>,
    pub(super) outliers: usize,
}

/// An observation in the coordinates.
#[derive(Debug, Clone)]
pub(super) struct Measured {
    pub(super) time_s: f64,
    pub(super) z_nm: Array1<f64>,
    pub(super) covariance_nm2: Array2<f64>,
}

/// An innovation with what follows from it.
pub(super) struct Compared {
    pub(super) innovation: Innovation,
    /// Steps, white.
    pub(super) white_steps: Array2<f64>,
    /// Statistic and limit that were exceeded, if they were.
    pub(super) outlier: Option<(f64, f64)>,
}

impl Memory {
    pub(super) fn new(settings: &TrackerSettings, observation: &Observation<'_>) -> Result<Self> {
        let coordinates = Coordinates::new(observation.covariance_nm2, &settings.segment_modes)?;
        let z_nm = coordinates.reduce(observation.coefficients_nm);
        let filter = Filter::new(z_nm, coordinates.reduce_covariance(observation.covariance_nm2));
        Ok(Self::with(settings, coordinates, filter, [observation.time_s; 2]))
    }

    pub(super) fn with(
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

    pub(super) fn measure(&self, observation: &Observation<'_>) -> Measured {
        Measured {
            time_s: observation.time_s,
            z_nm: self.coordinates.reduce(observation.coefficients_nm),
            covariance_nm2: self.coordinates.reduce_covariance(observation.covariance_nm2),
        }
    }

    /// A value for each coordinate: that of its block.
    pub(super) fn by_block(&self, segments: f64, ncpa: f64) -> Array1<f64> {
        let at = self.coordinates.of_segments;
        (0..self.coordinates.len()).map(|coordinate| if coordinate < at { segments } else { ncpa }).collect()
    }

    /// An observation beside what `filter` predicts.
    pub(super) fn compare(&self, filter: &Filter, measured: &Measured) -> Result<Compared> {
        let innovation = filter.innovation(&measured.z_nm, &measured.covariance_nm2)?;
        let white_steps = innovation.whiten(&self.steps);
        let chi2 = innovation.chi2();
        let limit = outlier_limit(self.coordinates.len());
        let mut outlier = (chi2 > limit).then_some((chi2, limit));
        let mode_limit = self.detector.mode_threshold;
        let largest = most_likely_step(&innovation, &white_steps).filter(|step| step.statistic > mode_limit);
        outlier = outlier.or(largest.map(|step| (step.statistic, mode_limit)));
        Ok(Compared { innovation, white_steps, outlier })
    }

    /// The changes that `suspect` and the next observation show together, where they do; both are then used. Modes are numbers of segment
    /// modes here.
    pub(super) fn confirm(
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
            Ok(chi2 < outlier_limit(self.coordinates.len()))
        };
        if !agrees()? || !(is_named || compared.outlier.is_some()) {
            return Ok(None);
        }
        let limit = outlier_limit(self.coordinates.len());
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

    /// Uses an observation, and looks for changes in the window that ends with it; corrections follow the state.
    pub(super) fn accept(
        &mut self,
        measured: &Measured,
        compared: Compared,
        expected: &mut [Expected],
    ) -> Result<Vec<Change>> {
        self.outliers = 0;
        let Compared { mut innovation, white_steps, .. } = compared;
        let before = self.filter.clone();
        let whitened_gain = self.filter.update(&innovation);
        expected.iter_mut().for_each(|expected| expected.follow(&innovation, &whitened_gain));
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
    pub(super) fn start_again(&mut self, measured: &Measured, compared: &Compared) -> Result<Change> {
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
            threshold: outlier_limit(self.coordinates.len()),
        })
    }
}

/// χ² of an outlier of so many coordinates.
pub(super) fn outlier_limit(coordinates: usize) -> f64 {
    chi2_limit(coordinates, OUTLIER_Z)
}

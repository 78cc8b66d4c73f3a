//! What observations have left in a tracker: filter, detector, a suspect.

use super::expected::Expected;
use crate::Result;
use crate::tracking::change_detector::{Alarm, ChangeDetector};
use crate::tracking::coordinates::Coordinates;
use crate::tracking::filter::{Innovation, KalmanFilter};
use crate::tracking::motion::Motion;
use crate::tracking::pointing::{PointingChange, PointingTracker};
use crate::tracking::settings::{Change, TimedEstimate, TrackerSettings};
use crate::tracking::steps::{ModeStep, attribute, most_likely_step};
use crate::tracking::threshold::chi2_limit;
use ndarray::{Array1, Array2};

/// An estimate is an outlier where χ² exceeds that of 4 standard deviations: of a night of one
/// every 10 s, 0.1 by chance. It costs no more than the estimate.
const OUTLIER_Z: f64 = 4.0;
/// The step in one mode that an outlier has is confirmed where the next estimate has it at 3
/// standard deviations.
const CONFIRMING_CHI2: f64 = 9.0;
/// Outliers in a row that do not confirm each other, after which the state is given up.
pub(super) const MOST_OUTLIERS: usize = 10;
/// Error bars, in terms of those of the step, to which the state is opened along a step: what was
/// there before has no weight.
const OPENING: f64 = 100.0;
/// All that observations have left.
#[derive(Debug, Clone)]
pub(super) struct TrackerMemory {
    pub(super) coordinates: Coordinates,
    /// Steps of 1 nm of each segment mode, `[coordinate, mode]`.
    pub(super) steps: Array2<f64>,
    pub(super) filter: KalmanFilter,
    pub(super) detector: ChangeDetector,
    pub(super) motion: Motion,
    pub(super) pointing: PointingTracker,
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
pub(super) struct ComparedEstimate {
    /// Of all coordinates, which the filter uses.
    pub(super) innovation: Innovation,
    /// The same without what unsteady modes do by themselves, which is tested; `None` where there
    /// are none.
    without_unsteady: Option<Innovation>,
    /// Steps, white in terms of what is tested.
    pub(super) white_steps: Array2<f64>,
    /// Statistic and limit that were exceeded, if they were.
    pub(super) outlier: Option<(f64, f64)>,
    /// The segment mode that differs most, where it does by more than its limit.
    pub(super) largest: Option<usize>,
}

impl ComparedEstimate {
    /// The innovation in which changes are looked for.
    pub(super) fn tested(&self) -> &Innovation {
        self.without_unsteady.as_ref().unwrap_or(&self.innovation)
    }
}

impl TrackerMemory {
    pub(super) fn new(settings: &TrackerSettings, observation: &TimedEstimate<'_>) -> Result<Self> {
        let coordinates =
            Coordinates::new(observation.covariance_nm2, &settings.segment_modes, settings.pointing_modes.view())?;
        let z_nm = coordinates.reduce(observation.coefficients_nm);
        let filter = KalmanFilter::new(z_nm, coordinates.reduce_covariance(observation.covariance_nm2));
        let motion = Motion::new(settings, coordinates.sizes());
        Ok(Self::with(settings, coordinates, filter, motion, [observation.time_s; 2]))
    }

    pub(super) fn with(
        settings: &TrackerSettings,
        coordinates: Coordinates,
        filter: KalmanFilter,
        motion: Motion,
        [time_s, learnt_s]: [f64; 2],
    ) -> Self {
        Self {
            steps: coordinates.steps(&settings.segment_modes),
            detector: ChangeDetector::new(coordinates.len(), settings.false_alarms_per_step()),
            pointing: PointingTracker::new(settings.false_alarms_per_step()),
            stepped_nm: Array1::zeros(coordinates.len()),
            coordinates,
            filter,
            motion,
            time_s,
            learnt_s,
            suspect: None,
            outliers: 0,
        }
    }

    pub(super) fn measure(&self, observation: &TimedEstimate<'_>) -> Measured {
        Measured {
            time_s: observation.time_s,
            z_nm: self.coordinates.reduce(observation.coefficients_nm),
            covariance_nm2: self.coordinates.reduce_covariance(observation.covariance_nm2),
        }
    }

    /// An observation beside what `filter` predicts.
    pub(super) fn compare(&self, filter: &KalmanFilter, measured: &Measured) -> Result<ComparedEstimate> {
        let covariance_nm2 = plus_diagonal(&measured.covariance_nm2, &self.motion.white_nm2());
        let innovation = filter.innovation(&measured.z_nm, &covariance_nm2)?;
        let unsteady = self.motion.unsteady();
        let without_unsteady = (!unsteady.is_empty())
            .then(|| filter.innovation_without(&measured.z_nm, &covariance_nm2, &unsteady))
            .transpose()?;
        let tested = without_unsteady.as_ref().unwrap_or(&innovation);
        let white_steps = tested.whiten(&self.steps);
        let (chi2, limit) = (tested.chi2(), self.outlier_limit());
        let mut outlier = (chi2 > limit).then_some((chi2, limit));
        let mode_limit = self.detector.mode_threshold;
        let largest = most_likely_step(tested, &white_steps).filter(|step| step.statistic > mode_limit);
        outlier = outlier.or(largest.map(|step| (step.statistic, mode_limit)));
        let largest = largest.map(|step| step.mode);
        Ok(ComparedEstimate { innovation, without_unsteady, white_steps, outlier, largest })
    }

    /// χ² of an outlier in the coordinates that are tested.
    pub(super) fn outlier_limit(&self) -> f64 {
        chi2_limit((self.coordinates.len() - self.motion.unsteady().len()).max(1), OUTLIER_Z)
    }

    /// The changes that `suspect` and the next observation show together, where they do; both are
    /// then used. Modes are numbers of segment modes here.
    pub(super) fn confirm(
        &mut self,
        suspect: &Measured,
        next: &Measured,
        compared: &ComparedEstimate,
    ) -> Result<Option<Vec<Change>>> {
        // The mean of the two, and how it differs from the state.
        let (white_nm2, unsteady) = (self.motion.white_nm2(), self.motion.unsteady());
        let mean_nm = (&suspect.z_nm + &next.z_nm) * 0.5;
        let mean_covariance_nm2 =
            plus_diagonal(&((&suspect.covariance_nm2 + &next.covariance_nm2) * 0.25), &(&white_nm2 * 0.5));
        let difference = self.filter.innovation_without(&mean_nm, &mean_covariance_nm2, &unsteady)?;
        let white_steps = difference.whiten(&self.steps);
        let threshold = self.detector.mode_threshold;
        let mut attribution = attribute(&difference, &white_steps, threshold);
        let is_named = match attribution.steps.as_slice() {
            [] => false,
            [first, ..] => {
                let white_step = compared.white_steps.column(first.mode);
                let alone = white_step.dot(&compared.tested().white) / white_step.dot(&white_step).sqrt();
                alone * first.size_nm.signum() > CONFIRMING_CHI2.sqrt()
            }
        };
        let limit = self.outlier_limit();
        if !self.agree(suspect, next)? || !(is_named || compared.outlier.is_some()) {
            return Ok(None);
        }
        let times_s = [suspect.time_s, next.time_s];
        let changes = if attribution.rest_chi2 < limit && !attribution.steps.is_empty() {
            attribution.steps.drain(..).map(|step| self.follow(step, times_s)).collect()
        } else {
            let [size_nm, size_error_nm] = self.moved_nm(&mean_nm, &mean_covariance_nm2);
            self.filter.open_all((OPENING * size_error_nm).powi(2));
            vec![Change {
                segment: None,
                mode: None,
                size_nm,
                size_error_nm,
                since_s: suspect.time_s,
                detected_s: next.time_s,
                statistic: difference.chi2(),
                threshold: limit,
            }]
        };
        for measured in [suspect, next] {
            let covariance_nm2 = plus_diagonal(&measured.covariance_nm2, &white_nm2);
            let innovation = self.filter.innovation(&measured.z_nm, &covariance_nm2)?;
            self.filter.update(&innovation);
        }
        self.detector.reset();
        self.outliers = 0;
        Ok(Some(changes))
    }

    /// Whether two observations, one after the other, are of the same wavefront.
    fn agree(&self, suspect: &Measured, next: &Measured) -> Result<bool> {
        let (white_nm2, unsteady) = (self.motion.white_nm2(), self.motion.unsteady());
        let walk_nm2 = self.motion.added_nm2((next.time_s - suspect.time_s).max(0.0) / 3600.0);
        let first_nm2 = plus_diagonal(&suspect.covariance_nm2, &(&white_nm2 + &walk_nm2));
        let pair = KalmanFilter::new(suspect.z_nm.clone(), first_nm2);
        let next_nm2 = plus_diagonal(&next.covariance_nm2, &white_nm2);
        let chi2 = pair.innovation_without(&next.z_nm, &next_nm2, &unsteady)?.chi2();
        Ok(chi2 < self.outlier_limit())
    }

    /// Root of the sum of the squares by which `z_nm` differs from the state in the coordinates
    /// that are tested, and its error bar.
    fn moved_nm(&self, z_nm: &Array1<f64>, covariance_nm2: &Array2<f64>) -> [f64; 2] {
        let unsteady = self.motion.unsteady();
        let (mut moved_nm2, mut error_nm2) = (0.0, 0.0);
        for at in (0..z_nm.len()).filter(|at| !unsteady.contains(at)) {
            moved_nm2 += (z_nm[at] - self.filter.state_nm[at]).powi(2);
            error_nm2 += self.filter.covariance_nm2[[at, at]] + covariance_nm2[[at, at]];
        }
        [moved_nm2.sqrt(), error_nm2.sqrt()]
    }

    /// Uses an observation, and looks for changes in the window that ends with it; corrections
    /// follow the state.
    pub(super) fn accept(
        &mut self,
        measured: &Measured,
        compared: ComparedEstimate,
        expected: &mut [Expected],
    ) -> Result<Vec<Change>> {
        self.outliers = 0;
        let tested = compared.tested().white.clone();
        let ComparedEstimate { mut innovation, white_steps, .. } = compared;
        self.detector.look_in(self.coordinates.len() - self.motion.unsteady().len());
        let before = self.filter.clone();
        let whitened_gain = self.filter.update(&innovation);
        expected.iter_mut().for_each(|expected| expected.follow(&innovation, &whitened_gain));
        let along = |covariance_nm2: &Array2<f64>| -> Array1<f64> {
            (&covariance_nm2.dot(&self.steps) * &self.steps).sum_axis(ndarray::Axis(0))
        };
        let gain = 1.0 - along(&self.filter.covariance_nm2) / along(&before.covariance_nm2);
        self.detector.push(measured.time_s, tested, &white_steps, gain);
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
        let covariance_nm2 = plus_diagonal(&measured.covariance_nm2, &self.motion.white_nm2());
        innovation = self.filter.innovation(&measured.z_nm, &covariance_nm2)?;
        self.filter.update(&innovation);
        self.detector.reset();
        Ok(vec![change])
    }

    /// Opens the state along a step, of which the drift's rate learns nothing.
    fn follow(&mut self, step: ModeStep, [since_s, detected_s]: [f64; 2]) -> Change {
        let ModeStep { mode, size_nm, error_nm, statistic } = step;
        self.filter.open(self.steps.column(mode), (OPENING * error_nm).powi(2));
        self.stepped_nm.scaled_add(size_nm, &self.steps.column(mode));
        let threshold = self.detector.mode_threshold;
        let (mode, size_error_nm) = (Some(mode), error_nm);
        Change { segment: None, mode, size_nm, size_error_nm, since_s, detected_s, statistic, threshold }
    }

    /// Takes an observation for the state, after more outliers than a disturbance has.
    pub(super) fn start_again(&mut self, measured: &Measured, compared: &ComparedEstimate) -> Result<Change> {
        let covariance_nm2 = plus_diagonal(&measured.covariance_nm2, &self.motion.white_nm2());
        let [size_nm, size_error_nm] = self.moved_nm(&measured.z_nm, &covariance_nm2);
        self.filter = KalmanFilter::new(measured.z_nm.clone(), covariance_nm2);
        self.detector.reset();
        self.outliers = 0;
        Ok(Change {
            segment: None,
            mode: None,
            size_nm,
            size_error_nm,
            since_s: measured.time_s,
            detected_s: measured.time_s,
            statistic: compared.tested().chi2(),
            threshold: self.outlier_limit(),
        })
    }

    /// Follows the star; a move that this observation proves.
    pub(super) fn point(&mut self, observation: &TimedEstimate<'_>) -> Option<PointingChange> {
        observation.pointing_nm.and_then(|place_nm| self.pointing.update(observation.time_s, place_nm))
    }

    /// Learns the motion from an accepted observation.
    pub(super) fn learn(&mut self, measured: &Measured) {
        let hours = (measured.time_s - self.learnt_s).max(0.0) / 3600.0;
        self.learnt_s = measured.time_s;
        let z_nm = &measured.z_nm - &self.stepped_nm;
        self.motion.learn(&z_nm, &measured.covariance_nm2.diag().to_owned(), hours);
    }
}

/// `matrix` with `more` on its diagonal.
fn plus_diagonal(matrix: &Array2<f64>, more: &Array1<f64>) -> Array2<f64> {
    let mut sum = matrix.clone();
    sum.diag_mut().zip_mut_with(more, |value, more| *value += more);
    sum
}

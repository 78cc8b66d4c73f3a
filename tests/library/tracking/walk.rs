//! Errors that drift, and estimates of them.

use cophase::tracking::{TimedEstimate, TrackerSettings};
use ndarray::{Array1, Array2, s};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// Time between estimates, s.
pub const INTERVAL_S: f64 = 10.0;

/// Settings for `segments` pistons.
pub fn settings(segments: usize, false_alarms_per_night: f64) -> TrackerSettings {
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

/// A random walk of pistons and NCPA modes.
pub struct Walk {
    pub truth_nm: Array1<f64>,
    /// Of an estimate, pistons about their mean.
    pub covariance_nm2: Array2<f64>,
    /// Errors of an estimate from white ones.
    root_nm: Array2<f64>,
    segments: usize,
    random: ChaCha8Rng,
}

impl Walk {
    /// Estimates with independent errors of the variance `nm2`, pistons about their mean.
    pub fn white(segments: usize, ncpa: usize, nm2: f64) -> Self {
        Self::new(segments, Array2::eye(segments + ncpa) * nm2.sqrt(), 0)
    }

    /// Estimates with errors of the mean variance `nm2`, a quarter of which every mode has in
    /// common with others.
    pub fn correlated(segments: usize, ncpa: usize, nm2: f64, seed: u64) -> Self {
        let count = segments + ncpa;
        let mut random = ChaCha8Rng::seed_from_u64(1000 + seed);
        let mut root_nm = Array2::eye(count) * (0.75 * nm2).sqrt();
        root_nm.iter_mut().for_each(|value| {
            let normal: f64 = StandardNormal.sample(&mut random);
            *value += (0.25 * nm2 / count as f64).sqrt() * normal;
        });
        Self::new(segments, root_nm, seed)
    }

    fn new(segments: usize, mut root_nm: Array2<f64>, seed: u64) -> Self {
        for mut column in root_nm.columns_mut() {
            let mut pistons = column.slice_mut(s![..segments]);
            let mean = pistons.mean().unwrap_or(0.0);
            pistons -= mean;
        }
        let covariance_nm2 = root_nm.dot(&root_nm.t());
        let truth_nm = Array1::zeros(root_nm.nrows());
        Self { truth_nm, covariance_nm2, root_nm, segments, random: ChaCha8Rng::seed_from_u64(seed) }
    }

    fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }

    /// A step of the walk, with rates of segments and NCPA, nm/√h.
    pub fn drift(&mut self, [segments, ncpa]: [f64; 2]) {
        let root_hours = (INTERVAL_S / 3600.0).sqrt();
        for mode in 0..self.truth_nm.len() {
            let rate = if mode < self.segments { segments } else { ncpa };
            self.truth_nm[mode] += rate * root_hours * self.normal();
        }
    }

    /// An estimate.
    pub fn observe(&mut self) -> Array1<f64> {
        let white: Array1<f64> = (0..self.root_nm.ncols()).map(|_| self.normal()).collect();
        self.centred() + self.root_nm.dot(&white)
    }

    /// The truth with pistons about their mean.
    pub fn centred(&self) -> Array1<f64> {
        self.centre(&self.truth_nm)
    }

    /// Pistons about their mean.
    pub fn centre(&self, coefficients_nm: &Array1<f64>) -> Array1<f64> {
        let mut centred = coefficients_nm.clone();
        let mut pistons = centred.slice_mut(s![..self.segments]);
        let mean = pistons.mean().unwrap_or(0.0);
        pistons -= mean;
        centred
    }

    pub fn observation<'a>(&'a self, time_s: f64, coefficients_nm: &'a Array1<f64>) -> TimedEstimate<'a> {
        let (coefficients_nm, covariance_nm2) = (coefficients_nm.view(), self.covariance_nm2.view());
        TimedEstimate { time_s, coefficients_nm, covariance_nm2, pointing_nm: None }
    }
}

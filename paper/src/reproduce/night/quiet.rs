//! Nights without jumps and without images: estimates drawn from the covariance of the images'
//! estimates.

use super::scenario::{DRIFT_NM_PER_SQRT_HOUR, INTERVAL_S, normal};
use super::track::settings;
use crate::experiment::Progress;
use cophase::source::stream;
use cophase::tracking::{NIGHT_S, TimedEstimate, Tracker};
use cophase::{Error, Result};
use cophase_numerics::decompositions::symmetric_eigen;
use ndarray::{Array1, Array2, ArrayView2, s};
use rayon::prelude::*;

/// Alarms of nights on which nothing happens but drift.
#[derive(Debug, Clone)]
pub struct QuietNights {
    /// False alarms of each night.
    pub alarms: Vec<usize>,
    /// False alarms a night that were asked for.
    pub asked: f64,
}

impl QuietNights {
    pub(super) fn new(
        covariance_nm2: &Array2<f64>,
        segments: usize,
        nights: usize,
        asked: f64,
        progress: &Progress,
    ) -> Result<Self> {
        let root_nm = root(covariance_nm2)?;
        let alarms = (0..nights).into_par_iter().map(|number| {
            progress.check()?;
            let alarms = one(covariance_nm2.view(), &root_nm, segments, number as u64, asked)?;
            progress.add(1);
            Ok(alarms)
        });
        Ok(Self { alarms: alarms.collect::<Result<_>>()?, asked })
    }

    /// Mean of a night.
    pub fn per_night(&self) -> f64 {
        self.alarms.iter().sum::<usize>() as f64 / self.alarms.len() as f64
    }
}

/// Alarms of one night of 8 hours.
fn one(
    covariance_nm2: ArrayView2<f64>,
    root_nm: &Array2<f64>,
    segments: usize,
    seed: u64,
    asked: f64,
) -> Result<usize> {
    let modes = root_nm.nrows();
    let mut random = stream(100_000 + seed, 0);
    let mut tracker = Tracker::new(settings(segments, asked))?;
    let step_nm = DRIFT_NM_PER_SQRT_HOUR * (INTERVAL_S / 3600.0).sqrt();
    let mut truth_nm = Array1::<f64>::zeros(modes);
    let mut alarms = 0;
    for frame in 0..(NIGHT_S / INTERVAL_S) as usize {
        truth_nm.iter_mut().for_each(|nm| *nm += step_nm * normal(&mut random));
        let mean = truth_nm.slice(s![..segments]).sum() / segments as f64;
        truth_nm.slice_mut(s![..segments]).iter_mut().for_each(|nm| *nm -= mean);
        let white: Array1<f64> = (0..modes).map(|_| normal(&mut random)).collect();
        let seen_nm = &truth_nm + &root_nm.dot(&white);
        let time_s = frame as f64 * INTERVAL_S;
        let coefficients_nm = seen_nm.view();
        let observation = TimedEstimate { time_s, coefficients_nm, covariance_nm2, pointing_nm: None };
        alarms += tracker.update(observation)?.changes.len();
    }
    Ok(alarms)
}

/// V·√Λ of the covariance V·Λ·Vᵀ, whose directions without variance are rounding.
fn root(covariance_nm2: &Array2<f64>) -> Result<Array2<f64>> {
    let size = covariance_nm2.nrows();
    let eigen = symmetric_eigen(covariance_nm2.view(), 1.0)
        .map_err(|failure| Error::Internal(format!("eigenvalues of a covariance: {failure}")))?;
    Ok(Array2::from_shape_fn((size, size), |(i, j)| eigen.vectors[[i, j]] * eigen.values[j].max(0.0).sqrt()))
}

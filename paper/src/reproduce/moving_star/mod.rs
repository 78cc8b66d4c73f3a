//! Nights in which much moves that is no step of the wavefront: the star, the focus, the flux. What
//! the tracker takes for a step is a false alarm.
//!
//! ```text
//! Disturbance ─ images (a camera on a finer grid, bad pixels) ─ session, one fit an image ─ Tracker, as a watch feeds it ─ alarms
//! ```

mod disturbance;
mod images;
mod report;

pub use disturbance::{Disturbance, MovingRow, Step};

use super::Progress;
use cophase::Result;
use cophase::modal::{ModalFitter, Pointing};
use cophase::scene::Scene;
use cophase::tracking::{Change, TimedEstimate, Tracker, TrackerSettings, TrackerVerdict};
use disturbance::INTERVAL_S;
use images::{Estimated, Observatory};
use ndarray::ArrayView1;
use std::sync::Arc;

/// The telescope of the simulated night, with tip and tilt among the modes.
const SETTINGS: [(&str, &str); 10] = [
    ("pupil.samples", "80"),
    ("image.samples_per_lambda_over_d", "2"),
    ("image.pixels", "96"),
    ("image.read_noise_e", "20"),
    ("image.count", "1"),
    ("modes.ncpa", "none"),
    ("modes.exact_zernikes", "[2, 18]"),
    ("aberrations.segment_piston_rms_nm", "30"),
    ("aberrations.ncpa_rms_nm", "40"),
    ("aberrations.truth_samples", "240"),
];
/// Images of a night of 8 hours.
const IMAGES: usize = 360;
/// False alarms a night that are asked for.
const ASKED: f64 = 1.0;
/// Images after a step within which a change of its segment is that step.
const NAMED_WITHIN: usize = 20;

/// What the tracker made of one night.
#[derive(Debug, Clone)]
pub struct MovingNight {
    /// Changes of the wavefront that are no step, segments and others.
    pub false_alarms: [usize; 2],
    /// Images until each step was named; `None` where it was not.
    pub named_after: Vec<Option<usize>>,
    /// Alarms of the pointing, of a star that went nowhere.
    pub moves: usize,
    /// Images that were refused before the tracker, and by it.
    pub refused: [usize; 2],
}

/// Nights of one row.
#[derive(Debug, Clone)]
pub struct MovingNights {
    /// What moves.
    pub row: MovingRow,
    /// Each night.
    pub nights: Vec<MovingNight>,
}

/// Nights of some rows.
#[derive(Debug, Clone)]
pub struct MovingStar {
    /// Row by row.
    pub rows: Vec<MovingNights>,
    /// False alarms a night that were asked for.
    pub asked: f64,
}

/// `nights` of each row, an eighth of a night each if `quick`.
///
/// # Errors
/// Those of simulation and estimator; [`cophase::Error::Interrupted`].
pub fn moving_star(rows: &[MovingRow], nights: usize, quick: bool, progress: &Progress) -> Result<MovingStar> {
    let images = if quick { IMAGES / 8 } else { IMAGES };
    progress.expect(rows.len() * nights * images);
    let mut found = Vec::new();
    for &row in rows {
        let scene = Scene::preset("keck-artificial")?.with(&SETTINGS)?.with(&[("image.peak_snr", row.peak_snr)])?;
        let (fitter, observatory) = (Arc::new(ModalFitter::new(&scene, false)?), Observatory::new(&scene)?);
        let mut made = Vec::new();
        for number in 0..nights {
            let night = row.disturbance.night(number as u64, images);
            let estimates = observatory.estimates(&fitter, &night, progress)?;
            made.push(followed(&fitter, &night.steps, &estimates)?);
        }
        found.push(MovingNights { row, nights: made });
    }
    Ok(MovingStar { rows: found, asked: ASKED * images as f64 / IMAGES as f64 })
}

/// The tracker on the estimates of a night.
fn followed(fitter: &ModalFitter, steps: &[Step], estimates: &[Option<Estimated>]) -> Result<MovingNight> {
    let pointing = fitter.pointing()?;
    let mut tracker = Tracker::new(settings(fitter, &pointing))?;
    let (mut changes, mut moves, mut refused) = (Vec::<(usize, Change)>::new(), 0, [0; 2]);
    for (image, estimate) in estimates.iter().enumerate() {
        let Some(estimate) = estimate else {
            refused[0] += 1;
            continue;
        };
        let update = tracker.update(TimedEstimate {
            time_s: image as f64 * INTERVAL_S,
            coefficients_nm: ArrayView1::from(&estimate.coefficients_nm),
            covariance_nm2: estimate.covariance_nm2.view(),
            pointing_nm: Some(pointing.of(&estimate.coefficients_nm, estimate.tip_tilt_nm)),
        })?;
        refused[1] += usize::from(update.verdict != TrackerVerdict::Accepted);
        moves += usize::from(update.pointing.is_some());
        changes.extend(update.changes.into_iter().map(|change| (image, change)));
    }
    let is_of = |step: &Step, image: usize, change: &Change| {
        change.segment == Some(step.segment) && (step.image..step.image + NAMED_WITHIN).contains(&image)
    };
    let is_false = |(image, change): &&(usize, Change)| !steps.iter().any(|step| is_of(step, *image, change));
    let wrong: Vec<&(usize, Change)> = changes.iter().filter(is_false).collect();
    let of_segments = wrong.iter().filter(|(_, change)| change.segment.is_some()).count();
    let named = |step: &Step| {
        let first = changes.iter().find(|(image, change)| is_of(step, *image, change));
        first.map(|(image, _)| image + 1 - step.image)
    };
    Ok(MovingNight {
        false_alarms: [of_segments, wrong.len() - of_segments],
        named_after: steps.iter().map(named).collect(),
        moves,
        refused,
    })
}

/// Settings as a watch has them.
fn settings(fitter: &ModalFitter, pointing: &Pointing) -> TrackerSettings {
    let segments = fitter.model().segment_modes;
    TrackerSettings {
        segment_modes: 0..segments,
        segment_of_mode: (0..segments).collect(),
        pointing_modes: pointing.modes.clone(),
        drift_segments_nm_per_sqrt_hour: None,
        drift_ncpa_nm_per_sqrt_hour: None,
        false_alarms_per_night: ASKED,
        nominal_interval_s: INTERVAL_S,
    }
}

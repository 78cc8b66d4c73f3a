//! The lines of `docs/tracking.md` in a function.

use ndarray::{Array1, Array2};

/// Two estimates of 36 pistons, 1 nm each.
pub fn example() -> cophase::Result<()> {
    let (time_s, coefficients_nm, covariance_nm2) = (0.0, Array1::zeros(36), Array2::eye(36));
    let (coefficients_nm, covariance_nm2) = (coefficients_nm.view(), covariance_nm2.view());

    use cophase::tracking::{TimedEstimate, Tracker, TrackerSettings};

    let mut tracker = Tracker::new(TrackerSettings {
        segment_modes: 0..36,                      // coefficients that are segment modes; the rest is NCPA
        segment_of_mode: (0..36).collect(),
        pointing_modes: Array2::zeros((0, 36)),    // what tip and tilt of the star change of them: nothing here
        drift_segments_nm_per_sqrt_hour: None,     // learnt
        drift_ncpa_nm_per_sqrt_hour: None,
        false_alarms_per_night: 1.0,
        nominal_interval_s: 10.0,
    })?;
    let update = tracker.update(TimedEstimate { time_s, coefficients_nm, covariance_nm2, pointing_nm: None })?;
    for change in &update.changes { /* segment, size, error bar, since when */ }

    assert!(update.changes.is_empty());
    Ok(())
}

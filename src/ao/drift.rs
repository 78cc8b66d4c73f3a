//! Static errors that are not quite: pistons and NCPA that drift evenly about the middle of a sequence.

use super::footprint::Footprint;
use super::lines::Lines;
use super::run::Schedule;
use crate::Result;
use crate::pupil::Pupil;
use crate::source::Truth;

/// A drift, as maps over the footprint.
pub(super) struct Drift {
    /// What pistons gain in a minute, nm.
    pistons_nm: Lines,
    /// What NCPA gain in a minute, nm.
    ncpa_nm: Lines,
    /// The segments' errors in the middle of the sequence, nm.
    segments_nm: Lines,
    frames_per_min: f64,
    middle: f64,
}

impl Drift {
    /// That of `truth`, none where it stays as it is.
    ///
    /// # Errors
    /// Those of evaluating the NCPA.
    pub(super) fn of(
        truth: &Truth,
        pupil: &Pupil,
        footprint: &Footprint,
        segments_nm: &Lines,
        schedule: &Schedule,
        frame_s: f64,
    ) -> Result<Option<Self>> {
        let Some(pistons) = truth.piston_drift_nm() else { return Ok(None) };
        let lit: Vec<((usize, usize), usize)> = pupil
            .owner
            .indexed_iter()
            .filter(|(_, owner)| **owner >= 0)
            .map(|(at, &owner)| (at, owner as usize))
            .collect();
        let xs_m: Vec<f64> = lit.iter().map(|((_, x), _)| pupil.grid.coordinate_m(*x)).collect();
        let ys_m: Vec<f64> = lit.iter().map(|((y, _), _)| pupil.grid.coordinate_m(*y)).collect();
        let (mut pistons_nm, mut ncpa_nm) = (footprint.zeros(), footprint.zeros());
        for (((y, x), owner), ncpa) in lit.into_iter().zip(truth.ncpa_drift_at(&xs_m, &ys_m)?) {
            let place = y * footprint.stride() + x;
            (pistons_nm[place], ncpa_nm[place]) = (pistons[owner] as f32, ncpa as f32);
        }
        let middle = (schedule.start(0) + schedule.frames()) as f64 / 2.0;
        Ok(Some(Self { pistons_nm, ncpa_nm, segments_nm: segments_nm.clone(), frames_per_min: 60.0 / frame_s, middle }))
    }

    /// Minutes from the middle of the sequence to a frame.
    fn minutes(&self, frame: u64) -> f32 {
        ((frame as f64 - self.middle) / self.frames_per_min) as f32
    }

    /// The segments' errors at a frame, nm.
    pub(super) fn segments_at(&self, frame: u64, segments_nm: &mut [f32]) {
        let minutes = self.minutes(frame);
        for ((out, still), drift) in segments_nm.iter_mut().zip(&*self.segments_nm).zip(&*self.pistons_nm) {
            *out = still + minutes * drift;
        }
    }

    /// Adds to `residual_nm` what the NCPA have moved by at a frame, nm.
    pub(super) fn add_ncpa(&self, frame: u64, residual_nm: &mut [f32]) {
        let minutes = self.minutes(frame);
        residual_nm.iter_mut().zip(&*self.ncpa_nm).for_each(|(out, drift)| *out += minutes * drift);
    }
}

//! Pointing of the star: where it was in each image, how much it moves about, and whether it went
//! elsewhere.
//!
//! The star moves from image to image, by guiding and vibration, and slowly, by flexure. How, is
//! not known beforehand: the prediction of the next place is an exponential mean of those before,
//! with the gain of a bank that has predicted best so far,
//!
//! ```text
//! m ← m + K·(p − m),      scatter² = mean of |p − m|²/2,
//! ```
//!
//! which is the steady state of a Kalman filter of a random walk in white noise. Innovations in
//! units of the scatter are white, and a detector of steps (see [`change_threshold`]) tells a move
//! from the scatter by the same rate of false alarms as the others. A scatter that is known from ν
//! numbers has the tails of Fisher's F: a level T of χ² with two degrees of freedom becomes
//! `ν·(exp(T/ν) − 1)`.

use super::bytes::{ByteReader, Writer, damaged};
use super::change_detector::WINDOWS;
use super::threshold::change_threshold;
use crate::Result;
use std::collections::VecDeque;

/// Gains of the bank.
const GAINS: [f64; 6] = [0.02, 0.05, 0.1, 0.2, 0.4, 0.8];
/// Images over which the scatter is averaged, and after how many of them a move is looked for.
const MEMORY: f64 = 100.0;
const LEAST: f64 = 6.0;
/// Least scatter, nm RMS of tip or tilt: a hundredth of λ/D at 1 µm. A star that stands still, as
/// in a laboratory, is no matter if it moves by less.
const LEAST_RMS_NM: f64 = 2.0;
/// One innovation counts for so much of the threshold at most, so that one image alone is no move,
/// and two are.
const LARGEST_SHARE: f64 = 0.9;

/// A move of the star, which persists.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointingChange {
    /// Along x and y: tip and tilt of the whole pupil, nm RMS.
    pub moved_nm: [f64; 2],
    /// Error bar along each, nm RMS.
    pub error_nm: f64,
    /// Scatter of the star before it along each axis, nm RMS.
    pub rms_nm: f64,
    /// Time of the first image that has it, s.
    pub since_s: f64,
    /// Time of the image that decided, s.
    pub detected_s: f64,
}

/// One gain of the bank.
#[derive(Debug, Clone, Copy, Default)]
struct Lane {
    mean_nm: [f64; 2],
    /// Mean square of the innovations along an axis, nm².
    square_nm2: f64,
}

/// A place in terms of what was expected.
#[derive(Debug, Clone, Copy)]
struct Innovation {
    time_s: f64,
    /// Limited, in units of the scatter.
    white: [f64; 2],
    place_nm: [f64; 2],
    expected_nm: [f64; 2],
}

/// The star's pointing through a night.
#[derive(Debug, Clone)]
pub(super) struct PointingTracker {
    /// Of χ² with two degrees of freedom, for a known scatter.
    threshold: f64,
    lanes: [Lane; GAINS.len()],
    /// Number of images.
    seen: f64,
    window: VecDeque<Innovation>,
}

impl PointingTracker {
    pub(super) fn new(false_alarms_per_step: f64) -> Self {
        let threshold = change_threshold(2, WINDOWS, false_alarms_per_step);
        Self { threshold, lanes: Default::default(), seen: 0.0, window: VecDeque::new() }
    }

    /// Scatter about the mean along an axis, nm RMS; `None` before the second image.
    pub(super) fn rms_nm(&self) -> Option<f64> {
        (self.seen > 1.0).then(|| self.best().square_nm2.sqrt())
    }

    /// Where the star was in the image of `time_s`.
    pub(super) fn update(&mut self, time_s: f64, place_nm: [f64; 2]) -> Option<PointingChange> {
        if self.seen == 0.0 {
            self.begin_at(place_nm);
            self.seen = 1.0;
            return None;
        }
        let numbers = 2.0 * (self.seen - 1.0).min(MEMORY);
        let threshold = numbers * (self.threshold / numbers).exp_m1();
        let change = if self.seen < LEAST { None } else { self.look(time_s, place_nm, threshold) };
        let limit = LARGEST_SHARE * self.threshold.sqrt();
        let weight = (1.0 / self.seen).max(1.0 / MEMORY);
        let is_known = self.seen >= LEAST;
        for (lane, gain) in self.lanes.iter_mut().zip(GAINS) {
            let off_nm = difference(place_nm, lane.mean_nm);
            // Not before the scatter is known: the first innovations make it.
            let share = if is_known { limited(off_nm, limit * lane.rms_nm()) } else { 1.0 };
            let off_nm = off_nm.map(|nm| nm * share);
            lane.square_nm2 += weight * (0.5 * square(off_nm) - lane.square_nm2);
            // The mean of all before the gain is reached.
            let gain = gain.max(1.0 / (self.seen + 1.0));
            (0..2).for_each(|axis| lane.mean_nm[axis] += gain * off_nm[axis]);
        }
        self.seen += 1.0;
        if change.is_some() {
            self.begin_at(place_nm);
            self.window.clear();
        }
        change
    }

    /// A move that the window with this image shows.
    fn look(&mut self, time_s: f64, place_nm: [f64; 2], threshold: f64) -> Option<PointingChange> {
        let best = *self.best();
        let (off_nm, rms_nm) = (difference(place_nm, best.mean_nm), best.rms_nm());
        let share = limited(off_nm, LARGEST_SHARE * threshold.sqrt() * rms_nm);
        if self.window.len() == WINDOWS[1] {
            self.window.pop_front();
        }
        let white = off_nm.map(|nm| nm * share / rms_nm);
        self.window.push_back(Innovation { time_s, white, place_nm, expected_nm: best.mean_nm });
        let (mut sum, mut found) = ([0.0; 2], None::<(f64, usize)>);
        for (length, one) in (1..).zip(self.window.iter().rev()) {
            (0..2).for_each(|axis| sum[axis] += one.white[axis]);
            let statistic = square(sum) / length as f64;
            if length >= WINDOWS[0] && statistic > found.map_or(threshold, |(most, _)| most) {
                found = Some((statistic, length));
            }
        }
        let (_, length) = found?;
        let first = self.window[self.window.len() - length];
        let places = self.window.iter().skip(self.window.len() - length);
        let mean_nm = [0, 1].map(|axis| places.clone().map(|one| one.place_nm[axis]).sum::<f64>() / length as f64);
        // Against what was expected before the move: later expectations follow it.
        let moved_nm = difference(mean_nm, first.expected_nm);
        let error_nm = rms_nm / (length as f64).sqrt();
        Some(PointingChange { moved_nm, error_nm, rms_nm, since_s: first.time_s, detected_s: time_s })
    }

    fn begin_at(&mut self, place_nm: [f64; 2]) {
        self.lanes.iter_mut().for_each(|lane| lane.mean_nm = place_nm);
    }

    /// The lane that has predicted best.
    fn best(&self) -> &Lane {
        self.lanes.iter().fold(&self.lanes[0], |best, lane| if lane.square_nm2 < best.square_nm2 { lane } else { best })
    }

    pub(super) fn write(&self, writer: &mut Writer) {
        writer.real(self.seen);
        for lane in &self.lanes {
            [lane.mean_nm[0], lane.mean_nm[1], lane.square_nm2].into_iter().for_each(|value| writer.real(value));
        }
        writer.number(self.window.len());
        for Innovation { time_s, white, place_nm, expected_nm } in &self.window {
            writer.real(*time_s);
            [white, place_nm, expected_nm].into_iter().flatten().for_each(|value| writer.real(*value));
        }
    }

    /// Reads what [`PointingTracker::write`] wrote into a new one.
    pub(super) fn read(&mut self, reader: &mut ByteReader) -> Result<()> {
        self.seen = reader.real()?;
        for lane in &mut self.lanes {
            *lane = Lane { mean_nm: [reader.real()?, reader.real()?], square_nm2: reader.real()? };
        }
        for _ in 0..reader.number()? {
            if self.window.len() == WINDOWS[1] {
                return Err(damaged());
            }
            let time_s = reader.real()?;
            let mut pair = || -> Result<[f64; 2]> { Ok([reader.real()?, reader.real()?]) };
            self.window.push_back(Innovation { time_s, white: pair()?, place_nm: pair()?, expected_nm: pair()? });
        }
        Ok(())
    }
}

impl Lane {
    fn rms_nm(&self) -> f64 {
        self.square_nm2.sqrt().max(LEAST_RMS_NM)
    }
}

fn difference(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] - b[0], a[1] - b[1]]
}

fn square(vector: [f64; 2]) -> f64 {
    vector[0] * vector[0] + vector[1] * vector[1]
}

/// The share of a vector that a limit of its length leaves.
fn limited(vector: [f64; 2], limit: f64) -> f64 {
    let length = square(vector).sqrt();
    if length > limit { limit / length } else { 1.0 }
}

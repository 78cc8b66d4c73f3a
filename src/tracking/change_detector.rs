//! Detector of steps that are too small for a single estimate to show: generalised likelihood ratio
//! over a window of innovations.
//!
//! Innovations are white while the model holds. A step of mode j by δ at the first of the last L
//! estimates adds δ·vⱼ to each of them (less what the filter has followed), and twice the
//! log-likelihood ratio of the most likely step is
//!
//! ```text
//! T_j(L) = (Σ vⱼᵀ S⁻¹ ν)² / Σ vⱼᵀ S⁻¹ vⱼ   ~ χ²(1),       of all modes together  T(L) = |Σ L⁻¹ν|²/L   ~ χ²(m)
//! ```
//!
//! A change is declared where T exceeds its threshold for any L from [`WINDOWS`] (Willsky & Jones
//! 1976, IEEE Trans. Autom. Control 21, 108, with the window of Lai 1995, J. R. Stat. Soc. B 57,
//! 613). One estimate alone declares none: an outlier is rejected before it comes here.

use super::bytes::{ByteReader, Writer, damaged};
use super::steps::ModeStep;
use super::threshold::change_threshold;
use crate::Result;
use ndarray::{Array1, Array2};
use std::collections::VecDeque;

/// Shortest and longest window, estimates.
pub(super) const WINDOWS: [usize; 2] = [2, 16];

/// Scores of one estimate.
#[derive(Debug, Clone)]
struct Scores {
    time_s: f64,
    /// vⱼᵀ S⁻¹ ν of each segment mode.
    score: Array1<f64>,
    /// vⱼᵀ S⁻¹ vⱼ.
    information: Array1<f64>,
    /// Part of a step of the mode that the state takes up with this estimate.
    gain: Array1<f64>,
    /// White innovation.
    white: Array1<f64>,
}

/// The last estimates' scores, and the thresholds.
#[derive(Debug, Clone)]
pub(super) struct ChangeDetector {
    window: VecDeque<Scores>,
    pub(super) mode_threshold: f64,
    pub(super) all_threshold: f64,
    false_alarms_per_step: f64,
    /// Number of components in which steps are looked for.
    components: usize,
}

/// A change that the window shows.
pub(super) enum Alarm {
    /// Of one segment mode.
    Mode(ModeStep),
    /// Of no single mode: root of the sum of the squares of all steps, nm, its error bar, and the
    /// statistic.
    All(f64, f64, f64),
}

impl ChangeDetector {
    /// Detectors of single segment modes and one of all modes, which have `components`; each raises
    /// so many false alarms with an estimate.
    pub(super) fn new(components: usize, false_alarms_per_step: f64) -> Self {
        Self {
            window: VecDeque::with_capacity(WINDOWS[1]),
            mode_threshold: change_threshold(1, WINDOWS, false_alarms_per_step),
            all_threshold: change_threshold(components.max(1), WINDOWS, false_alarms_per_step),
            false_alarms_per_step,
            components,
        }
    }

    /// Looks for steps in so many components from now on: white innovations have nothing in the
    /// others.
    pub(super) fn look_in(&mut self, components: usize) {
        if components != self.components {
            self.components = components;
            self.all_threshold = change_threshold(components.max(1), WINDOWS, self.false_alarms_per_step);
        }
    }

    /// Forgets the window, after a change.
    pub(super) fn reset(&mut self) {
        self.window.clear();
    }

    /// The innovation of an accepted estimate; `white_steps`: steps of 1 nm of each segment mode,
    /// white. `gain` as in [`Scores`].
    pub(super) fn push(&mut self, time_s: f64, white: Array1<f64>, white_steps: &Array2<f64>, gain: Array1<f64>) {
        if self.window.len() == WINDOWS[1] {
            self.window.pop_front();
        }
        let score = white_steps.t().dot(&white);
        let information = (white_steps * white_steps).sum_axis(ndarray::Axis(0));
        self.window.push_back(Scores { time_s, score, information, gain, white });
    }

    /// The change that the window shows, if any, and the time of its first estimate.
    pub(super) fn alarm(&self) -> Option<(Alarm, f64)> {
        let newest = self.window.back()?;
        let (mut score, mut information) = (Array1::zeros(newest.score.len()), Array1::zeros(newest.score.len()));
        let mut white = Array1::<f64>::zeros(newest.white.len());
        let mut best_mode: Option<(f64, usize, usize)> = None;
        let mut best_all: Option<(f64, usize)> = None;
        for (length, scores) in (1..).zip(self.window.iter().rev()) {
            score += &scores.score;
            information += &scores.information;
            white += &scores.white;
            if length < WINDOWS[0] {
                continue;
            }
            for (mode, (&score, &information)) in score.iter().zip(&information).enumerate() {
                let statistic = if information > 0.0 { score * score / information } else { 0.0 };
                if statistic > best_mode.map_or(self.mode_threshold, |(best, ..)| best) {
                    best_mode = Some((statistic, mode, length));
                }
            }
            let statistic = white.dot(&white) / length as f64;
            if statistic > best_all.map_or(self.all_threshold, |(best, _)| best) {
                best_all = Some((statistic, length));
            }
        }
        let since_s = |length: usize| self.window[self.window.len() - length].time_s;
        if let Some((statistic, mode, length)) = best_mode {
            return Some((Alarm::Mode(self.step(mode, length, statistic)), since_s(length)));
        }
        let (statistic, length) = best_all?;
        // In units of the innovations' error bars, whose root mean square over the modes is that of
        // the information.
        let unit_nm = (newest.information.len() as f64 / newest.information.sum().max(f64::MIN_POSITIVE)).sqrt();
        let error_nm = unit_nm / (length as f64).sqrt();
        let excess = (statistic - self.components as f64).max(0.0).sqrt();
        Some((Alarm::All(excess * error_nm, error_nm, statistic), since_s(length)))
    }

    /// The step of `mode` at the first of the last `length` estimates: least squares with what the
    /// filter left of it in each innovation.
    fn step(&self, mode: usize, length: usize, statistic: f64) -> ModeStep {
        let (mut score, mut information, mut left) = (0.0, 0.0, 1.0);
        for scores in self.window.iter().skip(self.window.len() - length) {
            score += left * scores.score[mode];
            information += left * left * scores.information[mode];
            left *= 1.0 - scores.gain[mode];
        }
        ModeStep { mode, size_nm: score / information, error_nm: 1.0 / information.sqrt(), statistic }
    }

    pub(super) fn write(&self, writer: &mut Writer) {
        writer.number(self.window.len());
        for scores in &self.window {
            writer.real(scores.time_s);
            for vector in [&scores.score, &scores.information, &scores.gain, &scores.white] {
                writer.vector(vector.iter());
            }
        }
    }

    /// Reads the window into a new detector.
    pub(super) fn read(&mut self, modes: usize, dimension: usize, reader: &mut ByteReader) -> Result<()> {
        let length = reader.number()?;
        for _ in 0..length {
            let time_s = reader.real()?;
            let [score, information, gain] = [reader.vector()?, reader.vector()?, reader.vector()?];
            let scores = Scores { time_s, score, information, gain, white: reader.vector()? };
            let fits = [&scores.score, &scores.information, &scores.gain].iter().all(|one| one.len() == modes);
            if !fits || scores.white.len() != dimension || self.window.len() == WINDOWS[1] {
                return Err(damaged());
            }
            self.window.push_back(scores);
        }
        Ok(())
    }
}

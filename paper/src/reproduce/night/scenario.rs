//! What happens in the night.

use cophase::source::stream;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};

/// Time between images, s.
pub const INTERVAL_S: f64 = 10.0;
/// Drift of each piston and each Zernike coefficient, nm/√h.
pub const DRIFT_NM_PER_SQRT_HOUR: f64 = 5.0;
/// Zernikes of the NCPA, first and last Noll index.
pub const NOLLS: std::ops::RangeInclusive<usize> = 4..=18;
/// Flux of the second star, over that of the first; and the least flux below clouds, over that
/// without.
const SECOND_STAR: f64 = 0.5;
const CLOUDS: f64 = 0.1;

/// A segment that jumps.
#[derive(Debug, Clone, Copy)]
pub struct Jump {
    /// Number of the first image that has it.
    pub frame: usize,
    /// The segment.
    pub segment: usize,
    /// nm.
    pub nm: f64,
}

/// What spoils a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BadFrame {
    /// Cosmic rays.
    Cosmic,
    /// A saturated core.
    Saturated,
    /// No star.
    Empty,
    /// The star eight pixels off.
    Shifted,
}

impl BadFrame {
    /// One word.
    pub fn word(self) -> &'static str {
        match self {
            Self::Cosmic => "cosmic rays",
            Self::Saturated => "saturated",
            Self::Empty => "empty",
            Self::Shifted => "shifted",
        }
    }
}

/// A night.
#[derive(Debug, Clone)]
pub struct Scenario {
    /// Number of images.
    pub frames: usize,
    /// Segments of the telescope.
    pub segments: usize,
    /// Segments that jump.
    pub jumps: Vec<Jump>,
    /// Frames that are bad.
    pub bad: Vec<(usize, BadFrame)>,
}

impl Scenario {
    /// Of `frames` images.
    pub fn new(frames: usize) -> Self {
        let at = |fraction: f64| (fraction * frames as f64).round() as usize;
        let jump = |fraction: f64, segment, nm| Jump { frame: at(fraction), segment, nm };
        let kinds = [BadFrame::Cosmic, BadFrame::Saturated, BadFrame::Empty, BadFrame::Shifted];
        let bad = (0..10).map(|place| (at(0.06 + 0.094 * f64::from(place)), kinds[place as usize % 4])).collect();
        Self { frames, segments: 36, jumps: vec![jump(0.2, 7, 20.0), jump(0.45, 22, -40.0), jump(0.7, 31, 80.0)], bad }
    }

    /// Its length.
    pub fn hours(&self) -> f64 {
        self.frames as f64 * INTERVAL_S / 3600.0
    }

    /// Flux of a frame, over that of the first star without clouds: another star from 60 % of the
    /// night on, and clouds between 80 and 90 %.
    pub fn flux(&self, frame: usize) -> f64 {
        let place = frame as f64 / self.frames as f64;
        let star = if place < 0.6 { 1.0 } else { SECOND_STAR };
        let inside = ((place - 0.8) / 0.1).clamp(0.0, 1.0);
        let clouds = 1.0 - (1.0 - CLOUDS) * (std::f64::consts::PI * inside).sin().powi(2);
        star * clouds
    }

    /// What is wrong with a frame, if anything is.
    pub fn fault(&self, frame: usize) -> Option<BadFrame> {
        self.bad.iter().find(|(at, _)| *at == frame).map(|(_, kind)| *kind)
    }

    /// Pistons and Zernike coefficients of each frame, nm, from those of the first.
    pub fn walk(&self, first_nm: &[f64]) -> Vec<Vec<f64>> {
        let mut random = stream(24, 0);
        let step_nm = DRIFT_NM_PER_SQRT_HOUR * (INTERVAL_S / 3600.0).sqrt();
        let mut now_nm = first_nm.to_vec();
        (0..self.frames)
            .map(|frame| {
                now_nm.iter_mut().for_each(|nm| *nm += step_nm * normal(&mut random));
                for jump in self.jumps.iter().filter(|jump| jump.frame == frame) {
                    now_nm[jump.segment] += jump.nm;
                }
                now_nm.clone()
            })
            .collect()
    }
}

/// A normal number.
pub fn normal(random: &mut impl Rng) -> f64 {
    StandardNormal.sample(random)
}

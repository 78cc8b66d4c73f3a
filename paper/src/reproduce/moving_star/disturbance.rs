//! What moves in a night.

use super::INTERVAL_S;
use cophase::source::stream;
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

/// Segments of the telescope, and Zernikes of its NCPA, first and last Noll index: tip, tilt, focus, ...
pub const SEGMENTS: usize = 36;
pub const NOLLS: std::ops::RangeInclusive<usize> = 2..=18;
/// Places of tip and focus among them.
const TIP: usize = SEGMENTS;
const FOCUS: usize = SEGMENTS + 2;
/// Drift of each piston and each Zernike coefficient but tip and tilt, nm/√h.
const DRIFT_NM_PER_SQRT_HOUR: f64 = 5.0;
/// Tip of one pixel, nm RMS over the circle of the Zernikes: λ/4 for each λ/D, of which a pixel is a half.
const NM_PER_PIXEL: f64 = 2168.6 / 8.0;
/// Motion of the star, pixels RMS along each axis; of the focus, nm RMS; of the flux, largest fraction.
const STAR_PIXELS: f64 = 0.5;
const FOCUS_NM: f64 = 5.0;
const FLUX: f64 = 0.2;
/// Periods of a focus that breathes slowly, h.
const PERIODS_H: [f64; 2] = [0.33, 1.5];
/// Steps, nm, and when they happen, in terms of the night.
const STEPS: [(f64, f64); 3] = [(0.3, 20.0), (0.55, -40.0), (0.8, 80.0)];

/// A segment that moves for good.
#[derive(Debug, Clone, Copy)]
pub struct Step {
    /// Number of the first image that has it.
    pub image: usize,
    /// The segment.
    pub segment: usize,
    /// nm.
    pub nm: f64,
}

/// A kind of night.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Disturbance {
    /// Nothing but the drift.
    Still,
    /// The star alone.
    Star,
    /// Star, flux, and a focus that breathes with a period of 20 to 90 minutes.
    SlowFocus,
    /// Star, flux, and a focus that is another one in each image.
    FastFocus,
}

/// One image.
#[derive(Debug, Clone)]
pub struct Moment {
    /// Pistons and Zernike coefficients, nm.
    pub aberrations_nm: Vec<f64>,
    /// Flux over that of the scene.
    pub flux: f64,
}

/// A night.
#[derive(Debug, Clone)]
pub struct DisturbedNight {
    /// Image by image.
    pub moments: Vec<Moment>,
    /// What the tracker is to name.
    pub steps: Vec<Step>,
    /// Seed of noise and bad pixels.
    pub seed: u64,
}

impl Disturbance {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Still, Self::Star, Self::SlowFocus, Self::FastFocus];

    /// A few words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Still => "nothing",
            Self::Star => "star",
            Self::SlowFocus => "star, flux, focus slowly",
            Self::FastFocus => "star, flux, focus in each image",
        }
    }

    /// Night `number`, of `images` images. Drift and steps are those of the other kinds.
    pub fn night(self, number: u64, images: usize) -> DisturbedNight {
        let (mut random, mut other) = (stream(500 + number, 0), stream(500 + number, 1));
        let mut normal = || StandardNormal.sample(&mut random);
        let mut now_nm: Vec<f64> = (0..SEGMENTS + NOLLS.count()).map(|_| 15.0 * normal()).collect();
        (0..2).for_each(|axis| now_nm[TIP + axis] = 0.0);
        let step_nm = DRIFT_NM_PER_SQRT_HOUR * (INTERVAL_S / 3600.0).sqrt();
        let segment = |random: &mut dyn FnMut() -> u32| random() as usize % SEGMENTS;
        let steps: Vec<Step> = STEPS
            .iter()
            .map(|&(place, nm)| Step {
                image: (place * images as f64) as usize,
                segment: segment(&mut || other.next_u32()),
                nm,
            })
            .collect();
        let mut uniform = || f64::from(other.next_u32()) / f64::from(u32::MAX);
        let period_h = PERIODS_H[0] + (PERIODS_H[1] - PERIODS_H[0]) * uniform();
        let phase = TAU * uniform();
        let moments = (0..images).map(|image| {
            now_nm.iter_mut().enumerate().for_each(|(mode, nm)| {
                let drift_nm = step_nm * normal();
                *nm += if (TIP..TIP + 2).contains(&mode) { 0.0 } else { drift_nm };
            });
            steps.iter().filter(|step| step.image == image).for_each(|step| now_nm[step.segment] += step.nm);
            let mut aberrations_nm = now_nm.clone();
            let (star, breath, flux) = ([normal(), normal()], normal(), 1.0 + FLUX * (2.0 * uniform() - 1.0));
            if self != Self::Still {
                (0..2).for_each(|axis| aberrations_nm[TIP + axis] += STAR_PIXELS * NM_PER_PIXEL * star[axis]);
            }
            let hours = image as f64 * INTERVAL_S / 3600.0;
            aberrations_nm[FOCUS] += match self {
                Self::Still | Self::Star => 0.0,
                Self::SlowFocus => FOCUS_NM * 2f64.sqrt() * (TAU * hours / period_h + phase).sin(),
                Self::FastFocus => FOCUS_NM * breath,
            };
            let has_flux = matches!(self, Self::SlowFocus | Self::FastFocus);
            Moment { aberrations_nm, flux: if has_flux { flux } else { 1.0 } }
        });
        DisturbedNight { moments: moments.collect(), steps: steps.clone(), seed: number }
    }
}

//! What moves in a night.

use cophase::source::stream;
use cophase::{Error, Result};
use rand::Rng;
use rand_distr::{Distribution, StandardNormal};
use std::f64::consts::TAU;

/// Time between images, s.
pub(super) const INTERVAL_S: f64 = 80.0;

/// Segments of the telescope, and Zernikes of its NCPA, first and last Noll index: tip, tilt,
/// focus, ...
pub const SEGMENTS: usize = 36;
pub const NOLLS: std::ops::RangeInclusive<usize> = 2..=18;
/// Places of tip and focus among them.
const TIP: usize = SEGMENTS;
const FOCUS: usize = SEGMENTS + 2;
/// Drift of each piston and each Zernike coefficient but tip and tilt, nm/√h.
const DRIFT_NM_PER_SQRT_HOUR: f64 = 5.0;
/// Tip of one pixel, nm RMS over the circle of the Zernikes: λ/4 for each λ/D, of which a pixel is
/// a half.
const NM_PER_PIXEL: f64 = 2168.6 / 8.0;
/// Motion of the star, pixels RMS along each axis, and largest where it goes far; of the focus, nm
/// RMS; of the flux, largest fraction.
const STAR_PIXELS: f64 = 0.5;
const FAR_PIXELS: f64 = 4.0;
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
    /// The star alone, anywhere within four pixels of the axis.
    FarStar,
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
    pub const ALL: [Self; 5] = [Self::Still, Self::Star, Self::FarStar, Self::SlowFocus, Self::FastFocus];

    /// A few words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Still => "nothing",
            Self::Star => "star",
            Self::FarStar => "star within 4 pixels",
            Self::SlowFocus => "star, flux, focus slowly",
            Self::FastFocus => "star, flux, focus in each image",
        }
    }

    /// Night `number`, of `images` images. Drift and steps are those of the other kinds.
    pub fn night(self, number: u64, images: usize) -> DisturbedNight {
        let (mut random, mut other) = (stream(500 + number, 0), stream(500 + number, 1));
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let mut now_nm: Vec<f64> = (0..SEGMENTS + NOLLS.count()).map(|_| 15.0 * normal()).collect();
        (0..2).for_each(|axis| now_nm[TIP + axis] = 0.0);
        let step_nm = DRIFT_NM_PER_SQRT_HOUR * (INTERVAL_S / 3600.0).sqrt();
        let steps: Vec<Step> = STEPS
            .iter()
            .map(|&(place, nm)| Step {
                image: (place * images as f64) as usize,
                segment: other.next_u32() as usize % SEGMENTS,
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
            let far = [0, 1].map(|_| FAR_PIXELS * (2.0 * uniform() - 1.0));
            let star_pixels = match self {
                Self::Still => [0.0; 2],
                Self::FarStar => far,
                Self::Star | Self::SlowFocus | Self::FastFocus => star.map(|normal| STAR_PIXELS * normal),
            };
            (0..2).for_each(|axis| aberrations_nm[TIP + axis] += NM_PER_PIXEL * star_pixels[axis]);
            let hours = image as f64 * INTERVAL_S / 3600.0;
            aberrations_nm[FOCUS] += match self {
                Self::Still | Self::Star | Self::FarStar => 0.0,
                Self::SlowFocus => FOCUS_NM * 2f64.sqrt() * (TAU * hours / period_h + phase).sin(),
                Self::FastFocus => FOCUS_NM * breath,
            };
            let has_flux = matches!(self, Self::SlowFocus | Self::FastFocus);
            Moment { aberrations_nm, flux: if has_flux { flux } else { 1.0 } }
        });
        DisturbedNight { moments: moments.collect(), steps: steps.clone(), seed: number }
    }
}

/// A row of the table: what moves, and how bright the star is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MovingRow {
    /// What moves.
    pub disturbance: Disturbance,
    /// Signal-to-noise ratio of the brightest pixel: 25 leaves 4 nm in a piston from one image, 500
    /// some tenths.
    pub peak_snr: &'static str,
}

impl MovingRow {
    /// Its name.
    pub fn name(self) -> String {
        format!("{}, S/N {}", self.disturbance.words(), self.peak_snr)
    }

    /// Rows whose names contain one of these texts; all for none.
    ///
    /// # Errors
    /// [`Error::Value`] for a text that no name contains.
    pub fn named(texts: &[String]) -> Result<Vec<Self>> {
        let rows = |peak_snr| Disturbance::ALL.map(|disturbance| Self { disturbance, peak_snr });
        let all: Vec<Self> = ["25", "500"].into_iter().flat_map(rows).collect();
        if let Some(odd) = texts.iter().find(|text| !all.iter().any(|row| row.name().contains(*text))) {
            let names: Vec<String> = all.iter().map(|row| row.name()).collect();
            return Err(Error::Value(format!(
                "no row of moving-star contains '{odd:.60}': parts of {} are accepted",
                names.join("; ")
            )));
        }
        let is_wanted = |row: &Self| texts.is_empty() || texts.iter().any(|text| row.name().contains(text));
        Ok(all.into_iter().filter(is_wanted).collect())
    }
}

//! Band-limited pupils: far more accurate than anti-aliased edges with the same number of samples.
//!
//! Sampling a sharp edge aliases its high frequencies into the low ones that determine the image.
//! Here each segment is low-pass filtered first, so that aliases stay outside the pass band:
//!
//! ```text
//! gain 1 ────────┐.            frequency f, in cycles per grid width, along each axis
//!                  `.          the alias of f is n − f: with stop = n − pass it never enters the pass band
//!      0 ───── pass ─`stop──
//! ```
//!
//! The filter is separable, because the pass band is a square: a focal pixel at (u, v) λ/D is the
//! frequency (u, v), and images are square. The transition is the integral of a Kaiser window
//! (Kaiser and Schafer, IEEE Trans. ASSP 28, 105, 1980), because its ringing decreases below a
//! given level within the fewest samples.
//!
//! Nothing is periodic: spectra are continuous functions (in closed form for a geometric aperture),
//! sampled so finely that the ringing does not wrap around.

use super::aperture::{Aperture, SegmentShape};
use super::maps::FinePupil;
use super::weights::SegmentWeights;
use crate::grid::Grid;
use crate::{Error, Result};
use ndarray::{Array2, Zip};
use num_complex::Complex64;
use rayon::prelude::*;
use std::f64::consts::PI;

/// The low pass of a band-limited pupil, along each axis; frequencies in cycles per grid width (λ/D
/// in the focus).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BandLimit {
    /// Frequencies up to this are unchanged. At least half the width of the image in λ/D plus half
    /// that of the defocused spot.
    pub pass: f64,
    /// Frequencies from this on are removed. `samples − pass` keeps aliases out of the pass band.
    pub stop: f64,
    /// Weights of a smaller magnitude are dropped; also the design level of the filter's ringing.
    pub drop_below: f64,
}

impl BandLimit {
    /// The low-pass filter for a grid of `samples` a side without aliases below `pass`; weights
    /// under 1e-4 are dropped.
    ///
    /// Keck at 120 samples, pass 50: 1e-4 keeps 3.1 entries per illuminated sample, with an error
    /// of the focal field of 2e-5; 1e-3 keeps 2.3 with 1.4e-4, and 1e-5 keeps 4.1 with 2e-6 (on a
    /// grid with a margin of 20 samples a side).
    ///
    /// # Errors
    /// [`Error::Value`] unless 0 < `pass` < `samples`/2.
    pub fn new(pass: f64, samples: usize) -> Result<Self> {
        let limit = Self { pass, stop: samples as f64 - pass, drop_below: 1e-4 };
        limit.check(samples)?;
        Ok(limit)
    }

    fn check(&self, samples: usize) -> Result<()> {
        let Self { pass, stop, drop_below } = *self;
        if !(pass > 0.0 && pass < stop && stop <= samples as f64) {
            return Err(Error::Value(format!(
                "a pupil of {samples} samples cannot pass {pass} and stop {stop} cycles per grid width: \
                 0 < pass < stop ≤ {samples} is needed"
            )));
        }
        if !(drop_below > 0.0 && drop_below < 1.0) {
            return Err(Error::Value(format!(
                "dropping weights below {drop_below} is impossible: a level between 0 and 1 is needed"
            )));
        }
        Ok(())
    }

    /// Kaiser's shape parameter for ringing of `drop_below`.
    fn beta(&self) -> f64 {
        (0.1102 * (-20.0 * self.drop_below.log10() - 8.7)).max(0.0)
    }

    /// Distance from an edge beyond which its ringing is below `drop_below`, in grid widths: the
    /// main lobe of the transform of the transition. At most 1, since no sample is farther away.
    fn reach(&self) -> f64 {
        ((1.0 + (self.beta() / PI).powi(2)).sqrt() / (self.stop - self.pass)).min(1.0)
    }

    fn gain(&self, frequency: f64) -> f64 {
        let t = (frequency.abs() - self.pass) / (self.stop - self.pass);
        if t <= 0.0 {
            return 1.0;
        }
        if t >= 1.0 {
            return 0.0;
        }
        let kaiser = |t: f64| bessel_i0(self.beta() * (1.0 - (2.0 * t - 1.0).powi(2)).max(0.0).sqrt());
        simpson(kaiser, t, 1.0) / simpson(kaiser, 0.0, 1.0)
    }
}

/// ∫ f by Simpson's rule with 128 panels.
fn simpson(f: impl Fn(f64) -> f64, low: f64, high: f64) -> f64 {
    let step = (high - low) / 128.0;
    let weight = |i: usize| if i == 0 || i == 128 { 1.0 } else { 2.0 + 2.0 * (i % 2) as f64 };
    (0..=128).map(|i| weight(i) * f(low + i as f64 * step)).sum::<f64>() * step / 3.0
}

/// Modified Bessel function of order 0 by its power series; all terms are positive, so that there
/// is no cancellation.
fn bessel_i0(x: f64) -> f64 {
    let (mut term, mut sum, mut k) = (1.0, 1.0, 1.0);
    while term > sum * f64::EPSILON {
        term *= (x / (2.0 * k)).powi(2);
        sum += term;
        k += 1.0;
    }
    sum
}

impl SegmentWeights {
    /// Each segment of a geometric aperture, low-pass filtered and sampled on `grid`; its spectrum
    /// is exact.
    ///
    /// Weights ring beyond the edge of the segment and may be negative there, so the grid should
    /// extend a few samples beyond the mirror. The energy is the area of the mirror in samples.
    ///
    /// # Errors
    /// [`Error::Value`] for a grid narrower than the mirror or an impossible `limit`.
    pub fn band_limited(aperture: &Aperture, grid: &Grid, limit: &BandLimit) -> Result<Self> {
        limit.check(grid.samples())?;
        aperture.check_width(grid)?;
        let column = |shape: &SegmentShape| {
            if shape.pieces.is_empty() {
                return Ok(Vec::new());
            }
            let (y, x) = (Axis::new(shape.range(1), grid, limit, false), Axis::new(shape.range(0), grid, limit, true));
            let mut spectrum = vec![Complex64::default(); y.frequencies.len() * x.frequencies.len()];
            for (sign, piece) in &shape.pieces {
                piece.add_spectrum(*sign, [x.origin, y.origin], &y.frequencies, &x.frequencies, &mut spectrum);
            }
            sample(spectrum, &y, &x, grid, limit)
        };
        let columns = aperture.shapes().par_iter().map(column).collect::<Result<Vec<_>>>()?;
        Ok(Self::from_columns(grid.samples(), &columns, aperture.energy(grid)))
    }

    /// Each segment of a pupil given as fine maps, low-pass filtered and sampled on `grid`. The
    /// energy is Σ amplitude² of the fine map, in samples of `grid`.
    ///
    /// The accuracy is that of the labels: a fine sample across a gap is assigned to one segment,
    /// which moves the border between the two by up to half a fine sample. A geometric aperture
    /// does not have this error.
    ///
    /// # Errors
    /// [`Error::Value`] for maps less than twice as fine as `grid` (see [`FinePupil::resolves`];
    /// use [`SegmentWeights::hard`] instead), or an impossible `limit`.
    pub fn band_limited_maps(fine: &FinePupil, grid: &Grid, limit: &BandLimit) -> Result<Self> {
        limit.check(grid.samples())?;
        if !fine.resolves(grid) {
            return Err(Error::Value(format!(
                "pupil maps with samples of {} m are too coarse to be band-limited onto samples of {} m: half of that \
                 or finer is needed",
                fine.grid().pitch_m(),
                grid.pitch_m()
            )));
        }
        let patches = patches(fine);
        let column = |patch: &Patch| {
            let (y, x) = (Axis::new(patch.range(0), grid, limit, false), Axis::new(patch.range(1), grid, limit, true));
            sample(patch.spectrum(&y, &x)?, &y, &x, grid, limit)
        };
        let columns = patches.par_iter().map(column).collect::<Result<Vec<_>>>()?;
        let cell = (fine.grid().pitch_m() / grid.pitch_m()).powi(2);
        let energy = fine.pupil().amplitude.iter().map(|a| a * a).sum::<f64>() * cell;
        Ok(Self::from_columns(grid.samples(), &columns, energy))
    }
}

/// One axis of the transform of a segment: its frequencies, and the samples within reach.
struct Axis {
    /// Origin of the phase of the spectrum, m.
    origin: f64,
    /// Cycles per metre.
    frequencies: Vec<f64>,
    /// Filter times quadrature weight of each frequency, 1/m.
    gains: Vec<f64>,
    /// Indices of the samples of the grid within reach.
    samples: std::ops::Range<usize>,
    /// Their coordinates from `origin`, m.
    positions: Vec<f64>,
}

impl Axis {
    /// The axis for a shape within `(low, high)`, m. A real function needs half of the frequencies
    /// along one axis: with `half` those count twice.
    fn new((low, high): (f64, f64), grid: &Grid, limit: &BandLimit, half: bool) -> Self {
        let reach = limit.reach() * grid.width_m();
        // Sampling the spectrum at 1/period repeats the shape with that period: the nearest copy is
        // at least two reaches away from every sample that is kept.
        let period = high - low + 3.0 * reach;
        let last = (limit.stop / grid.width_m() * period).floor() as i64;
        let first = if half { 0 } else { -last };
        let frequencies: Vec<f64> = (first..=last).map(|q| q as f64 / period).collect();
        let twice = |f: f64| if half && f > 0.0 { 2.0 } else { 1.0 };
        let gains = frequencies.iter().map(|&f| twice(f) * limit.gain(f * grid.width_m()) / period).collect();
        let near = |j: &usize| (low - reach..=high + reach).contains(&grid.coordinate_m(*j));
        let first = (0..grid.samples()).find(near).unwrap_or(0);
        let samples = first..(first..grid.samples()).rev().find(near).map_or(first, |j| j + 1);
        let origin = (low + high) / 2.0;
        let positions = samples.clone().map(|j| grid.coordinate_m(j) - origin).collect();
        Self { origin, frequencies, gains, samples, positions }
    }

    /// exp(2πi f·x), `[position, frequency]`.
    fn waves(&self) -> Array2<Complex64> {
        waves(&self.positions, &self.frequencies, 1.0)
    }
}

/// exp(±2πi f·x), `[position, frequency]`.
fn waves(positions: &[f64], frequencies: &[f64], sign: f64) -> Array2<Complex64> {
    Array2::from_shape_fn((positions.len(), frequencies.len()), |(x, f)| {
        let (sin, cos) = (2.0 * PI * frequencies[f] * positions[x]).sin_cos();
        Complex64::new(cos, sign * sin)
    })
}

/// Filters a spectrum `[fy, fx ≥ 0]` and evaluates it at the grid's samples within reach:
/// `(y·samples + x, weight)`.
fn sample(spectrum: Vec<Complex64>, y: &Axis, x: &Axis, grid: &Grid, limit: &BandLimit) -> Result<Vec<(u32, f64)>> {
    let mut spectrum = Array2::from_shape_vec((y.frequencies.len(), x.frequencies.len()), spectrum)
        .map_err(|error| Error::Internal(format!("the spectrum of a segment has a wrong shape: {error}")))?;
    for ((fy, fx), value) in spectrum.indexed_iter_mut() {
        *value *= y.gains[fy] * x.gains[fx];
    }
    let rows = y.waves().dot(&spectrum);
    let along_x = x.waves();
    // Only the real part of the last product is needed: two real products instead of four.
    let cosine = rows.mapv(|v| v.re).dot(&along_x.mapv(|v| v.re).t());
    let sine = rows.mapv(|v| v.im).dot(&along_x.mapv(|v| v.im).t());
    let mut map = cosine;
    Zip::from(&mut map).and(&sine).for_each(|w, s| *w -= s);
    let index = |(v, u): (usize, usize)| ((y.samples.start + v) * grid.samples() + x.samples.start + u) as u32;
    Ok(map.indexed_iter().filter(|(_, w)| w.abs() >= limit.drop_below).map(|(at, &w)| (index(at), w)).collect())
}

/// One segment of the fine maps.
struct Patch {
    /// Coordinates of the rows, then of the columns, m.
    positions: [Vec<f64>; 2],
    pitch_m: f64,
    amplitude: Array2<f64>,
}

impl Patch {
    fn range(&self, axis: usize) -> (f64, f64) {
        let along = &self.positions[axis];
        (along[0] - self.pitch_m / 2.0, along[along.len() - 1] + self.pitch_m / 2.0)
    }

    /// Spectrum of the segment, `[fy, fx]`. A sample is the mean over its cell, a blur that is
    /// divided out.
    fn spectrum(&self, y: &Axis, x: &Axis) -> Result<Vec<Complex64>> {
        let from = |along: &[f64], origin: f64| along.iter().map(|p| p - origin).collect::<Vec<_>>();
        let along_x = waves(&from(&self.positions[1], x.origin), &x.frequencies, -1.0);
        let along_y = waves(&from(&self.positions[0], y.origin), &y.frequencies, -1.0);
        let rows = self.amplitude.mapv(|a| Complex64::new(a, 0.0)).dot(&along_x);
        let mut spectrum = along_y.t().dot(&rows);
        let blur = |f: f64| {
            let t = PI * f * self.pitch_m;
            if t == 0.0 { 1.0 } else { t.sin() / t }
        };
        for ((v, u), value) in spectrum.indexed_iter_mut() {
            *value *= self.pitch_m.powi(2) / (blur(y.frequencies[v]) * blur(x.frequencies[u]));
        }
        Ok(spectrum.iter().copied().collect())
    }
}

fn patches(fine: &FinePupil) -> Vec<Patch> {
    // Rows and columns of each segment, as first..end.
    let mut boxes = vec![[usize::MAX, 0, usize::MAX, 0]; fine.pupil().segments.len()];
    for ((y, x), &label) in fine.pupil().owner.indexed_iter().filter(|(_, label)| **label >= 0) {
        let b = &mut boxes[label as usize];
        *b = [b[0].min(y), b[1].max(y + 1), b[2].min(x), b[3].max(x + 1)];
    }
    let cut = |(label, &[top, bottom, left, right]): (i32, &[usize; 4])| Patch {
        positions: [top..bottom, left..right].map(|range| range.map(|j| fine.grid().coordinate_m(j)).collect()),
        pitch_m: fine.grid().pitch_m(),
        amplitude: Array2::from_shape_fn((bottom - top, right - left), |(v, u)| {
            let at = [top + v, left + u];
            if fine.pupil().owner[at] == label { fine.pupil().amplitude[at] } else { 0.0 }
        }),
    };
    (0..).zip(&boxes).map(cut).collect()
}

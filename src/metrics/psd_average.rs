//! The average power spectrum of many maps over a pupil, one FFT for two of them, in constant memory.
//!
//! **Window and normalisation.** With weights a over the pupil (Σ over its samples) and W̄ = Σ a·W / Σ a,
//!
//! `PSD(f) = pitch² / Σ a · |Σ √a·(W − W̄)·exp(−2πi·f·x)|²`
//!
//! so that, by Parseval, the sum of the density over the grid of frequencies times the area of a step is exactly
//! Σ a·(W − W̄)² / Σ a: the variance of all other figures of merit, where a is the amplitude A of the pupil. (A window A
//! would give that of the weight A², which differs on the grey rims.)
//!
//! **Taper.** By default there is none: the window is the pupil's edge. Then a strong spatial frequency leaks into its
//! surroundings as the light of a star spreads in the telescope's own PSF, as f⁻³ on average over directions. Behind
//! adaptive optics there is no excess at low frequencies for it to leak from, the phasing errors at the rim count in
//! full, and a ratio of two spectra has the same leak on both sides. Open-loop turbulence falls as f^(−11/3), below its own
//! leak: give [`PsdAverage::windowed`] weights that fall smoothly to 0, such as A·cos⁴(π·r/D).
//!
//! **Two for one.** For real maps a and b, `|â|² + |b̂|²` at f is the mean of `|F{a + ib}|²` at f and at −f. Averaging
//! over ±f once, at the end, makes one FFT serve two maps.

use super::fft2::Fft2;
use super::psd::Psd;
use crate::grid::Grid;
use crate::pupil::Pupil;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2};
use num_complex::Complex64;
use rustfft::FftDirection;

/// Largest zero-padding: more only interpolates what twice the pupil already shows, and memory grows as its square.
pub const LARGEST_PADDING: usize = 8;

/// Collects the power spectra of residual wavefronts over a pupil.
pub struct PsdAverage {
    grid: Grid,
    /// a / Σ a, in reading order.
    weight: Vec<f64>,
    /// √(a / Σ a).
    window: Vec<f64>,
    padded: usize,
    fft: Fft2,
    /// `[y][x]`, padded: a map in the real parts, the next in the imaginary parts.
    field: Vec<Complex64>,
    /// `[x][y]`, frequency 0 first: sum over pairs of maps of the power at f, not yet averaged over ±f.
    power: Vec<f64>,
    maps: usize,
}

impl PsdAverage {
    /// Of maps over `pupil`, each weighted by its amplitude A. `padding` = 1 gives the frequencies 1/`grid.width_m()`
    /// apart; larger ones interpolate between them.
    ///
    /// # Errors
    /// Those of [`PsdAverage::windowed`].
    pub fn new(pupil: &Pupil, padding: usize) -> Result<Self> {
        Self::windowed(pupil.grid, pupil.amplitude.view(), padding)
    }

    /// Of maps on `grid`, with weights `[y, x]` (the squares of the window) of one's own.
    ///
    /// # Errors
    /// [`Error::Shape`] for weights that do not have the grid's shape, [`Error::Value`] for one that is negative or not
    /// finite, for weights that are 0 everywhere, and for a padding of 0 or beyond [`LARGEST_PADDING`].
    pub fn windowed(grid: Grid, weights: ArrayView2<f64>, padding: usize) -> Result<Self> {
        check_shape("weights", weights.dim(), &grid)?;
        if let Some(((y, x), value)) = weights.indexed_iter().find(|(_, a)| !(a.is_finite() && **a >= 0.0)) {
            return Err(Error::Value(format!(
                "the weight at row {y}, column {x} is {value}: a finite number that is not negative is needed"
            )));
        }
        let sum = weights.sum();
        if !(sum.is_finite() && sum > 0.0) {
            return Err(Error::Value(format!("the weights sum to {sum}: a spectrum needs some glass")));
        }
        if !(1..=LARGEST_PADDING).contains(&padding) {
            return Err(Error::Value(format!(
                "a zero-padding of {padding} times cannot be used: 1 to {LARGEST_PADDING} are accepted"
            )));
        }
        let weight: Vec<f64> = weights.iter().map(|a| a / sum).collect();
        let window = weight.iter().map(|a| a.sqrt()).collect();
        let padded = padding * grid.samples();
        let fft = Fft2::new(padded, padded, FftDirection::Forward);
        let field = vec![Complex64::default(); padded * padded];
        Ok(Self { grid, weight, window, padded, fft, field, power: vec![0.0; padded * padded], maps: 0 })
    }

    /// Adds a map `[y, x]`, nm. Its mean over the pupil is taken out; tip and tilt stay. Values where there is no weight
    /// are not looked at.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map that does not have the grid's shape, [`Error::Value`] for a value on the glass that is
    /// not finite; the average stays as it was.
    pub fn add<T: Copy + Into<f64>>(&mut self, map_nm: ArrayView2<T>) -> Result<()> {
        check_shape("map", map_nm.dim(), &self.grid)?;
        let lit = || self.weight.iter().zip(&map_nm).filter(|(a, _)| **a > 0.0);
        let mean: f64 = lit().map(|(a, &value)| a * value.into()).sum();
        if !mean.is_finite() {
            return Err(not_finite(&self.weight, map_nm));
        }
        let samples = self.grid.samples();
        let second = self.maps % 2 == 1;
        for ((row, window), line) in
            map_nm.outer_iter().zip(self.window.chunks(samples)).zip(self.field.chunks_mut(self.padded))
        {
            for ((&value, &window), out) in row.iter().zip(window).zip(&mut *line) {
                let value = if window > 0.0 { window * (value.into() - mean) } else { 0.0 };
                if second { out.im = value } else { *out = value.into() }
            }
            if !second {
                // What the last transform left here.
                line[samples..].fill(Complex64::default());
            }
        }
        if second {
            add_power(&mut self.fft, &mut self.field, samples, &mut self.power);
        }
        self.maps += 1;
        Ok(())
    }

    /// Maps added so far.
    pub fn maps(&self) -> usize {
        self.maps
    }

    /// The average spectrum of the maps so far.
    ///
    /// # Errors
    /// [`Error::Value`] where there are none.
    pub fn mean(&self) -> Result<Psd> {
        if self.maps == 0 {
            return Err(Error::Value("a spectrum of 0 maps was asked for: at least 1 is needed".into()));
        }
        let n = self.padded;
        let mut power = self.power.clone();
        if self.maps % 2 == 1 {
            // The last map still waits for its pair.
            let mut fft = Fft2::new(n, n, FftDirection::Forward);
            add_power(&mut fft, &mut self.field.clone(), self.grid.samples(), &mut power);
        }
        let scale = self.grid.pitch_m().powi(2) / (2.0 * self.maps as f64);
        let density = Array2::from_shape_fn((n, n), |(y, x)| {
            // Index N/2 is frequency 0.
            let (ky, kx) = ((y + n - n / 2) % n, (x + n - n / 2) % n);
            scale * (power[kx * n + ky] + power[(n - kx) % n * n + (n - ky) % n])
        });
        Ok(Psd::new(density, 1.0 / (n as f64 * self.grid.pitch_m())))
    }
}

/// Adds |F{field}|², turned, to `power`; `field` is used up.
fn add_power(fft: &mut Fft2, field: &mut [Complex64], lit_rows: usize, power: &mut [f64]) {
    for (sum, value) in power.iter_mut().zip(fft.process(field, lit_rows)) {
        *sum += value.norm_sqr();
    }
}

fn check_shape(name: &str, (rows, columns): (usize, usize), grid: &Grid) -> Result<()> {
    let samples = grid.samples();
    if (rows, columns) == (samples, samples) {
        return Ok(());
    }
    Err(Error::Shape(format!("the {name} of a spectrum is {rows}x{columns}: the grid needs {samples}x{samples}")))
}

/// Names the sample that spoiled a mean.
fn not_finite<T: Copy + Into<f64>>(weight: &[f64], map: ArrayView2<T>) -> Error {
    let spoiled = map.indexed_iter().zip(weight).find(|((_, value), a)| **a > 0.0 && !(**value).into().is_finite());
    Error::Value(match spoiled {
        Some((((y, x), &value), _)) => {
            format!("the map is {} at row {y}, column {x}, on the glass: finite values are needed", value.into())
        }
        None => "the mean of the map overflows: a wavefront in nm is needed".into(),
    })
}

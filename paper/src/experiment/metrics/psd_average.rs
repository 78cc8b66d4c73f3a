//! Average power spectrum of many maps over a pupil, in constant memory, with one FFT for every two
//! maps.
//!
//! **Window and normalisation.** With weights a over the pupil (Σ over its samples) and W̄ = Σ a·W
//! / Σ a,
//!
//! `PSD(f) = pitch² / Σ a · |Σ √a·(W − W̄)·exp(−2πi·f·x)|²`
//!
//! so that, by Parseval, the sum of the density over the grid of frequencies times the area of a
//! step is exactly Σ a·(W − W̄)² / Σ a. With a the pupil amplitude A, this is the variance of all
//! other figures of merit. (A window A would correspond to the weight A², which differs at partly
//! covered samples.)
//!
//! **Taper.** By default there is none: the window ends at the pupil's edge. A strong spatial
//! frequency then leaks into its neighbours like the light of a star in the telescope's PSF, as f⁻³
//! on average over directions. Behind adaptive optics there is no excess at low frequencies that
//! could leak, phasing errors at the rim have their full weight, and the leakage cancels in a ratio
//! of two spectra. Open-loop turbulence falls as f^(−11/3), below its own leakage: call
//! [`PsdAverage::with_weights`] with weights that fall smoothly to 0, such as A·cos⁴(π·r/D).
//!
//! **Two maps per FFT.** For real maps a and b, `|â|² + |b̂|²` at f is the mean of `|F{a + ib}|²`
//! at f and at −f. The average over ±f is taken once, at the end.

use super::fft2::Fft2;
use super::psd::Psd;
use cophase::pupil::{Grid, Pupil};
use cophase::{Error, Result};
use cophase_numerics::fft::FftDirection;
use ndarray::{Array2, ArrayView2};
use num_complex::Complex64;

/// Largest zero-padding factor. A factor of 2 already determines the spectrum; larger ones
/// interpolate it, and memory grows with the square of the factor.
pub const LARGEST_PADDING: usize = 8;

/// Running average of the power spectra of residual wavefronts over a pupil.
pub struct PsdAverage {
    grid: Grid,
    /// a / Σ a, in row order.
    weight: Vec<f64>,
    /// √(a / Σ a).
    window: Vec<f64>,
    padded: usize,
    fft: Fft2,
    /// `[y][x]`, padded: one map in the real parts, the next in the imaginary parts.
    field: Vec<Complex64>,
    /// `[x][y]`, frequency 0 first: sum over pairs of maps of the power at f, not yet averaged over
    /// ±f.
    power: Vec<f64>,
    maps: usize,
}

impl PsdAverage {
    /// Average of maps over `pupil`, weighted by the pupil amplitude A. With `padding` = 1 the
    /// frequencies are 1/`grid.width_m()` apart; larger factors interpolate between them.
    ///
    /// # Errors
    /// Those of [`PsdAverage::with_weights`].
    pub fn new(pupil: &Pupil, padding: usize) -> Result<Self> {
        Self::with_weights(pupil.grid, pupil.amplitude.view(), padding)
    }

    /// Average of maps on `grid`, with the caller's weights `[y, x]` (the squares of the window).
    ///
    /// # Errors
    /// [`Error::Shape`] for weights that do not have the grid's shape, [`Error::Value`] for one
    /// that is negative or not finite, for weights that are 0 everywhere, and for a padding of 0 or
    /// beyond [`LARGEST_PADDING`].
    pub fn with_weights(grid: Grid, weights: ArrayView2<f64>, padding: usize) -> Result<Self> {
        check_shape("weights", weights.dim(), &grid)?;
        if let Some(((y, x), value)) = weights.indexed_iter().find(|(_, a)| !(a.is_finite() && **a >= 0.0)) {
            return Err(Error::Value(format!(
                "the weight at row {y}, column {x} is {value}; a finite number that is not negative is needed"
            )));
        }
        let sum = weights.sum();
        if !(sum.is_finite() && sum > 0.0) {
            return Err(Error::Value(format!("the weights sum to {sum}; a positive, finite sum is needed")));
        }
        if !(1..=LARGEST_PADDING).contains(&padding) {
            return Err(Error::Value(format!(
                "a zero-padding of {padding} times is impossible; 1 to {LARGEST_PADDING} are accepted"
            )));
        }
        let weight: Vec<f64> = weights.iter().map(|a| a / sum).collect();
        let window = weight.iter().map(|a| a.sqrt()).collect();
        let padded = padding * grid.samples();
        let fft = Fft2::new(padded, padded, FftDirection::Forward);
        let field = vec![Complex64::default(); padded * padded];
        Ok(Self { grid, weight, window, padded, fft, field, power: vec![0.0; padded * padded], maps: 0 })
    }

    /// Adds a map `[y, x]`, nm. Its mean over the pupil is removed; tip and tilt are kept. Values
    /// with weight 0 are ignored.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map that does not have the grid's shape, [`Error::Value`] for a value
    /// inside the pupil that is not finite; the average is then unchanged.
    pub fn add<T: Copy + Into<f64>>(&mut self, map_nm: ArrayView2<T>) -> Result<()> {
        check_shape("map", map_nm.dim(), &self.grid)?;
        let weighted = || self.weight.iter().zip(&map_nm).filter(|(a, _)| **a > 0.0);
        let mean: f64 = weighted().map(|(a, &value)| a * value.into()).sum();
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
                // Overwrites the last transform.
                line[samples..].fill(Complex64::default());
            }
        }
        if second {
            add_power(&mut self.fft, &mut self.field, samples, &mut self.power);
        }
        self.maps += 1;
        Ok(())
    }

    /// Number of maps added.
    pub fn maps(&self) -> usize {
        self.maps
    }

    /// Computes the average spectrum of the maps added so far.
    ///
    /// # Errors
    /// [`Error::Value`] if there are none.
    pub fn mean(&self) -> Result<Psd> {
        if self.maps == 0 {
            return Err(Error::Value("a spectrum of 0 maps was requested; at least 1 is needed".into()));
        }
        let n = self.padded;
        let mut power = self.power.clone();
        if self.maps % 2 == 1 {
            // The last map has no partner yet.
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

/// Adds |F{field}|², transposed, to `power`; `field` is overwritten.
fn add_power(fft: &mut Fft2, field: &mut [Complex64], nonzero_rows: usize, power: &mut [f64]) {
    for (sum, value) in power.iter_mut().zip(fft.process(field, nonzero_rows)) {
        *sum += value.norm_sqr();
    }
}

fn check_shape(name: &str, (rows, columns): (usize, usize), grid: &Grid) -> Result<()> {
    let samples = grid.samples();
    if (rows, columns) == (samples, samples) {
        return Ok(());
    }
    Err(Error::Shape(format!("the {name} of a spectrum is {rows}x{columns}; the grid needs {samples}x{samples}")))
}

/// Error that names the first value that is not finite.
fn not_finite<T: Copy + Into<f64>>(weight: &[f64], map: ArrayView2<T>) -> Error {
    let first = map.indexed_iter().zip(weight).find(|((_, value), a)| **a > 0.0 && !(**value).into().is_finite());
    Error::Value(match first {
        Some((((y, x), &value), _)) => {
            format!("the map is {} at row {y}, column {x}, inside the pupil; finite values are needed", value.into())
        }
        None => "the mean of the map overflows; a wavefront in nm is needed".into(),
    })
}

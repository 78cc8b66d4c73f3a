//! Two-dimensional power spectral density: variance within a band, ratio of two spectra, radial
//! average.

use cophase::{Error, Result};
use ndarray::{Array2, Zip};

/// Power spectral density of a wavefront, from [`PsdAverage`](super::PsdAverage).
#[derive(Debug, Clone)]
pub struct Psd {
    density_nm2_m2: Array2<f64>,
    step_per_m: f64,
}

/// Radial average of a [`Psd`] over rings one step wide.
#[derive(Debug, Clone, PartialEq)]
pub struct Rings {
    /// Mean distance from frequency 0 of the samples of each ring, cycles/m.
    pub frequency_per_m: Vec<f64>,
    /// Mean density of each ring, nm²·m².
    pub density_nm2_m2: Vec<f64>,
    /// Number of samples of each ring.
    pub samples: Vec<usize>,
}

/// Half-width of the square of frequencies that a mirror with an actuator pitch of `pitch_m`
/// controls: 1/(2·pitch), cycles/m.
///
/// # Errors
/// [`Error::Value`] for a pitch that is not positive and finite.
pub fn control_half_width_per_m(pitch_m: f64) -> Result<f64> {
    if pitch_m.is_finite() && pitch_m > 0.0 {
        return Ok(0.5 / pitch_m);
    }
    Err(Error::Value(format!("an actuator pitch of {pitch_m} m is impossible; a positive number is needed")))
}

impl Psd {
    pub(super) fn new(density_nm2_m2: Array2<f64>, step_per_m: f64) -> Self {
        Self { density_nm2_m2, step_per_m }
    }

    /// Density, `[fy, fx]`, nm²·m²; frequency 0 at `[N/2, N/2]`.
    pub fn density_nm2_m2(&self) -> &Array2<f64> {
        &self.density_nm2_m2
    }

    /// Distance between neighbouring frequencies, cycles/m.
    pub fn step_per_m(&self) -> f64 {
        self.step_per_m
    }

    /// Frequency of row or column `j`, cycles/m.
    pub fn frequency_per_m(&self, j: usize) -> f64 {
        (j as f64 - (self.side() / 2) as f64) * self.step_per_m
    }

    /// Integral over all frequencies, nm²: the variance of the wavefront over the pupil.
    pub fn variance_nm2(&self) -> f64 {
        self.density_nm2_m2.sum() * self.step_per_m.powi(2)
    }

    /// Variance within the box |fx|, |fy| ≤ `half_width_per_m`, nm². A sample represents the square
    /// of one step around it, and is weighted by the fraction of that square inside the box.
    ///
    /// # Errors
    /// [`Error::Value`] for a half-width that is negative, not finite, or beyond the highest
    /// frequency of the spectrum.
    pub fn variance_within_nm2(&self, half_width_per_m: f64) -> Result<f64> {
        let highest = self.highest_per_m();
        // Equal widths may differ by rounding.
        if !(0.0..=highest * (1.0 + 1e-12)).contains(&half_width_per_m) {
            return Err(Error::Value(format!(
                "a half-width of {half_width_per_m} cycles/m is impossible for this spectrum; 0 to {highest} cycles/m is \
                 accepted"
            )));
        }
        let shares: Vec<f64> = (0..self.side()).map(|j| self.share(j, half_width_per_m)).collect();
        let rows = self.density_nm2_m2.outer_iter().zip(&shares);
        let sum: f64 = rows.map(|(row, share)| share * row.iter().zip(&shares).map(|(d, s)| d * s).sum::<f64>()).sum();
        Ok(sum * self.step_per_m.powi(2))
    }

    /// Ratio of this density to that of `other`, `[fy, fx]`. NaN at frequency 0, which both lack
    /// (the mean is removed), and where `other` is 0.
    ///
    /// # Errors
    /// [`Error::Shape`] for spectra of different sizes, [`Error::Value`] for different steps.
    pub fn ratio(&self, other: &Self) -> Result<Array2<f64>> {
        let (side, wanted) = (self.side(), other.side());
        if side != wanted {
            return Err(Error::Shape(format!(
                "a spectrum of {side}x{side} frequencies cannot be divided by one of {wanted}x{wanted}; equal sizes are needed"
            )));
        }
        // Equal steps may differ by rounding.
        if (self.step_per_m / other.step_per_m - 1.0).abs() > 1e-9 {
            return Err(Error::Value(format!(
                "a spectrum in steps of {} cycles/m cannot be divided by one of {} cycles/m; equal steps are needed",
                self.step_per_m, other.step_per_m
            )));
        }
        let mut ratio = Zip::from(&self.density_nm2_m2)
            .and(&other.density_nm2_m2)
            .map_collect(|&a, &b| if b > 0.0 { a / b } else { f64::NAN });
        ratio[[side / 2, side / 2]] = f64::NAN;
        Ok(ratio)
    }

    /// Averages over rings one step wide around frequency 0, up to the highest frequency along the
    /// axes, without the corners.
    pub fn rings(&self) -> Rings {
        let count = self.side() / 2 + 1;
        let mut rings =
            Rings { frequency_per_m: vec![0.0; count], density_nm2_m2: vec![0.0; count], samples: vec![0; count] };
        for ((y, x), &density) in self.density_nm2_m2.indexed_iter() {
            let distance = self.frequency_per_m(y).hypot(self.frequency_per_m(x));
            let ring = (distance / self.step_per_m).round() as usize;
            if ring < count {
                rings.frequency_per_m[ring] += distance;
                rings.density_nm2_m2[ring] += density;
                rings.samples[ring] += 1;
            }
        }
        for (ring, &samples) in rings.samples.iter().enumerate() {
            // Every ring has a sample on each axis, so the count is not 0.
            rings.frequency_per_m[ring] /= samples as f64;
            rings.density_nm2_m2[ring] /= samples as f64;
        }
        rings
    }

    fn side(&self) -> usize {
        self.density_nm2_m2.nrows()
    }

    /// Half the sampling frequency.
    fn highest_per_m(&self) -> f64 {
        self.side() as f64 / 2.0 * self.step_per_m
    }

    /// Fraction of the step around frequency `j` that lies within ±`half_width_per_m`. The step at
    /// the Nyquist frequency is cut at that frequency; its other half is the mirror image.
    fn share(&self, j: usize, half_width_per_m: f64) -> f64 {
        let middle = self.frequency_per_m(j).abs();
        let from = middle - self.step_per_m / 2.0;
        let to = (middle + self.step_per_m / 2.0).min(self.highest_per_m());
        ((to.min(half_width_per_m) - from.max(-half_width_per_m)) / (to - from)).clamp(0.0, 1.0)
    }
}

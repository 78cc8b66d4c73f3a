//! A two-dimensional power spectral density, and what one asks of it.

use crate::{Error, Result};
use ndarray::{Array2, Zip};

/// Power spectral density of a wavefront, from [`PsdAverage`](super::PsdAverage).
#[derive(Debug, Clone)]
pub struct Psd {
    density_nm2_m2: Array2<f64>,
    step_per_m: f64,
}

/// Average of a [`Psd`] around frequency 0, over rings one step wide.
#[derive(Debug, Clone, PartialEq)]
pub struct Rings {
    /// Mean distance from frequency 0 of the samples of each ring, cycles/m.
    pub frequency_per_m: Vec<f64>,
    /// Their mean density, nm²·m².
    pub density_nm2_m2: Vec<f64>,
    /// How many they are.
    pub samples: Vec<usize>,
}

/// Half the side of the square of frequencies that a mirror with actuators `pitch_m` apart controls, |fx| and |fy| up to
/// 1/(2·pitch), cycles/m.
///
/// # Errors
/// [`Error::Value`] for a pitch that is not positive and finite.
pub fn control_half_width_per_m(pitch_m: f64) -> Result<f64> {
    if pitch_m.is_finite() && pitch_m > 0.0 {
        return Ok(0.5 / pitch_m);
    }
    Err(Error::Value(format!("an actuator pitch of {pitch_m} m is impossible: it must be positive")))
}

impl Psd {
    pub(super) fn new(density_nm2_m2: Array2<f64>, step_per_m: f64) -> Self {
        Self { density_nm2_m2, step_per_m }
    }

    /// The density, `[fy, fx]`, nm²·m²; frequency 0 at `[N/2, N/2]`.
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

    /// The integral over all frequencies, nm²: the variance of the wavefront over the pupil.
    pub fn variance_nm2(&self) -> f64 {
        self.density_nm2_m2.sum() * self.step_per_m.powi(2)
    }

    /// Variance at |fx| and |fy| up to `half_width_per_m`, nm². A sample stands for the square of one step around it, and
    /// counts by the share of that inside: half on the edge of a box that runs through it.
    ///
    /// # Errors
    /// [`Error::Value`] for a half-width that is negative, not finite, or beyond the highest frequency of the spectrum.
    pub fn variance_within_nm2(&self, half_width_per_m: f64) -> Result<f64> {
        let highest = self.highest_per_m();
        // Widths that were meant to be equal differ by rounding.
        if !(0.0..=highest * (1.0 + 1e-12)).contains(&half_width_per_m) {
            return Err(Error::Value(format!(
                "a box of frequencies up to {half_width_per_m} cycles/m was asked of a spectrum that reaches \
                 {highest} cycles/m"
            )));
        }
        let shares: Vec<f64> = (0..self.side()).map(|j| self.share(j, half_width_per_m)).collect();
        let rows = self.density_nm2_m2.outer_iter().zip(&shares);
        let sum: f64 = rows.map(|(row, share)| share * row.iter().zip(&shares).map(|(d, s)| d * s).sum::<f64>()).sum();
        Ok(sum * self.step_per_m.powi(2))
    }

    /// [`Psd::variance_within_nm2`] over [`Psd::variance_nm2`]: what is left of 1 lies outside of the box.
    ///
    /// # Errors
    /// Those of [`Psd::variance_within_nm2`]; [`Error::Value`] for a spectrum of flat wavefronts.
    pub fn fraction_within(&self, half_width_per_m: f64) -> Result<f64> {
        let within = self.variance_within_nm2(half_width_per_m)?;
        match self.variance_nm2() {
            variance if variance > 0.0 => Ok(within / variance),
            variance => Err(Error::Value(format!("a spectrum of {variance} nm^2 has no fraction within a box"))),
        }
    }

    /// This density over that of `other`, `[fy, fx]`. NaN at frequency 0, of which both have been robbed, and wherever
    /// `other` is 0.
    ///
    /// # Errors
    /// [`Error::Shape`] for spectra of two sizes, [`Error::Value`] for spectra of two steps.
    pub fn ratio(&self, other: &Self) -> Result<Array2<f64>> {
        let (side, wanted) = (self.side(), other.side());
        if side != wanted {
            return Err(Error::Shape(format!(
                "a spectrum of {side}x{side} frequencies cannot be divided by one of {wanted}x{wanted}"
            )));
        }
        // Steps that were meant to be equal differ by rounding.
        if (self.step_per_m / other.step_per_m - 1.0).abs() > 1e-9 {
            return Err(Error::Value(format!(
                "a spectrum in steps of {} cycles/m cannot be divided by one of {} cycles/m",
                self.step_per_m, other.step_per_m
            )));
        }
        let mut ratio = Zip::from(&self.density_nm2_m2)
            .and(&other.density_nm2_m2)
            .map_collect(|&a, &b| if b > 0.0 { a / b } else { f64::NAN });
        ratio[[side / 2, side / 2]] = f64::NAN;
        Ok(ratio)
    }

    /// Averages over rings one step wide around frequency 0, from there to the highest frequency along the axes; the
    /// corners beyond are left out.
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
            // A ring has a sample at least where an axis crosses it.
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

    /// Share of the step around frequency `j` that lies within ±`half_width_per_m`. Half of the step at half the sampling
    /// frequency lies beyond it, where its mirror image is.
    fn share(&self, j: usize, half_width_per_m: f64) -> f64 {
        let middle = self.frequency_per_m(j).abs();
        let from = middle - self.step_per_m / 2.0;
        let to = (middle + self.step_per_m / 2.0).min(self.highest_per_m());
        ((to.min(half_width_per_m) - from.max(-half_width_per_m)) / (to - from)).clamp(0.0, 1.0)
    }
}

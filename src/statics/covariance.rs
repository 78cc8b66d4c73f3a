//! Covariance of the residual wavefront: stationary, so a power spectrum on a grid padded for every
//! lag.

use super::convolution::Convolver;
use crate::fourier::transform_square;
use crate::retrieval::{IlluminatedSamples, RadialPsd};
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2, Axis};
use num_complex::Complex64;
use rayon::prelude::*;

/// Least number of pairs of samples at a lag for an estimate of the covariance: fewer give noise.
const MIN_PAIRS: f64 = 50.0;

/// Maps whose power one thread sums: enough to pay for its buffers.
const MAPS_PER_THREAD: usize = 16;

/// Covariance between the samples of the residual wavefront of single images.
#[derive(Clone)]
pub struct ResidualCovariance {
    /// Samples along a side of the padded grid.
    pub(super) padded: usize,
    /// Eigenvalues, nm², `[kx, ky]`, none negative.
    pub(super) spectrum_nm2: Vec<f64>,
    /// Whether each is of a spatial frequency that images do not resolve.
    pub(super) is_unresolved: Vec<bool>,
    /// Convolutions of the solver.
    pub(super) single: Convolver<f32>,
}

impl ResidualCovariance {
    /// Estimates the covariance from `residuals_nm`, `[image, sample]`, each about the mean of all
    /// images.
    ///
    /// It is the autocorrelation over all pairs of samples and all images, tapered to 0 at the
    /// width of the pupil. Negative eigenvalues, which come from the taper and from chance alone,
    /// are set to 0.
    ///
    /// # Errors
    /// [`Error::Value`] for fewer than two images, [`Error::Shape`] for another number of samples.
    pub fn from_residuals(samples: &IlluminatedSamples, residuals_nm: ArrayView2<f64>) -> Result<Self> {
        let (images, columns) = residuals_nm.dim();
        if images < 2 {
            return Err(Error::Value(format!("{images} images were given for a covariance: at least 2 are needed")));
        }
        if columns != samples.len() {
            return Err(Error::Shape(format!(
                "wavefronts of {columns} samples were given: {} are needed",
                samples.len()
            )));
        }
        let double = Convolver::new(samples);
        let pairs = autocorrelation(&double, Array2::ones((1, columns)).view());
        let products = autocorrelation(&double, residuals_nm);
        // The variance about a mean of n is (n − 1)/n of that about the truth.
        let unbiased = 1.0 / (images - 1) as f64;
        let n = double.padded;
        let reach_m = reach_m(samples);
        let lag = |k: usize| (if k <= n / 2 { k as f64 } else { k as f64 - n as f64 }) * samples.pitch_m;
        let mut field: Vec<Complex64> = (0..n * n)
            .map(|at| {
                let r_m = lag(at % n).hypot(lag(at / n));
                // A pair is counted once in each direction, and rounding leaves fractions of one.
                let measured = if pairs[at] > MIN_PAIRS { products[at] / pairs[at] * unbiased } else { 0.0 };
                let taper =
                    if r_m < reach_m { 0.5 * (1.0 + (std::f64::consts::PI * r_m / reach_m).cos()) } else { 0.0 };
                Complex64::new(measured * taper, 0.0)
            })
            .collect();
        transform_square(&mut field, n, &*double.forward);
        let spectrum_nm2 = field.iter().map(|value| value.re.max(0.0)).collect();
        Ok(Self { padded: n, spectrum_nm2, is_unresolved: vec![false; n * n], single: Convolver::new(samples) })
    }

    /// Raises this covariance to no less than the power spectral density `psd` at any frequency.
    ///
    /// MAP retrieval shrinks poorly resolved frequencies. Retrieved wavefronts scatter less there
    /// than the turbulence, but they hold less of static errors too, and a covariance as small as
    /// their scatter would give these very frequencies the most weight.
    pub fn with_lower_bound(mut self, psd: &RadialPsd, pitch_m: f64) -> Self {
        for (at, value) in self.spectrum_nm2.iter_mut().enumerate() {
            let least = psd.density_nm2_m2_at(frequency_per_m(at, self.padded, pitch_m)) / (pitch_m * pitch_m);
            *value = value.max(least);
        }
        self
    }

    /// Sets this covariance to unknown beyond `highest_frequency_per_m`.
    ///
    /// MAP retrieval leaves frequencies that the image does not resolve as they are in the static
    /// wavefront about which it starts. Edges of segments exceed turbulence the more, the higher
    /// the frequency, so an estimate that trusted these frequencies would rest on absent
    /// information: each iteration would recover half of the remaining pistons, and errors would
    /// double.
    pub fn with_unresolved_beyond(mut self, highest_frequency_per_m: f64, pitch_m: f64) -> Self {
        for (at, is_unresolved) in self.is_unresolved.iter_mut().enumerate() {
            *is_unresolved = frequency_per_m(at, self.padded, pitch_m) > highest_frequency_per_m;
        }
        self
    }

    /// RMS of the residual, nm.
    pub fn rms_nm(&self) -> f64 {
        (self.spectrum_nm2.iter().sum::<f64>()).sqrt() / self.padded as f64
    }
}

/// Spatial frequency of the index `[kx, ky]` on a square of `n` samples a side, 1/m.
fn frequency_per_m(place: usize, n: usize, pitch_m: f64) -> f64 {
    let cycles = |k: usize| k.min(n - k) as f64;
    cycles(place % n).hypot(cycles(place / n)) / (n as f64 * pitch_m)
}

/// Largest lag: the width of the pupil, m.
fn reach_m(samples: &IlluminatedSamples) -> f64 {
    let wide = |values: &[f64]| {
        let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(low, high), &v| (low.min(v), high.max(v)));
        high - low
    };
    wide(&samples.xs_m).max(wide(&samples.ys_m)).max(samples.pitch_m)
}

/// Autocorrelation: Σ over maps, `[map, sample]`, and over pairs of samples at each lag, `[x, y]`.
fn autocorrelation(convolver: &Convolver<f64>, maps: ArrayView2<f64>) -> Vec<f64> {
    let n2 = convolver.padded * convolver.padded;
    // Two maps are the real and the imaginary part of one: their cross terms are odd in frequency,
    // so the real part of the transform has none of them.
    let power_of = |maps: ArrayView2<f64>| {
        let (mut power, mut buffers) = (vec![0.0; n2], convolver.buffers());
        for pair in maps.axis_chunks_iter(Axis(0), 2) {
            let last = pair.nrows() - 1;
            let both = (0..pair.ncols()).map(|i| Complex64::new(pair[[0, i]], last as f64 * pair[[last, i]]));
            convolver.spectrum(both, &mut buffers);
            power.iter_mut().zip(&buffers.transposed).for_each(|(sum, value)| *sum += value.norm_sqr());
        }
        power
    };
    // Parts of a fixed size, summed in turn: the same bits on any number of threads.
    let parts: Vec<Vec<f64>> = maps.axis_chunks_iter(Axis(0), MAPS_PER_THREAD).into_par_iter().map(power_of).collect();
    let mut power = vec![0.0; n2];
    for part in parts {
        power.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
    }
    let mut power: Vec<Complex64> = power.into_iter().map(Complex64::from).collect();
    transform_square(&mut power, convolver.padded, &*convolver.inverse);
    power.iter().map(|value| value.re / n2 as f64).collect()
}

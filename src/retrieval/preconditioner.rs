//! Spectral preconditioner: maps white coordinates to a free phase with the prior's power spectrum,
//! and gradients back.
//!
//! The free phase φ lives on a periodic square of N×N samples that holds the pupil and a margin.
//! With H the orthogonal (Hartley) transform there, the prior is −2 log p = Σ_k (Hφ)_k²/S_k, with
//! S_k the variance of a coefficient: the power spectral density over the area of a sample, because
//! then the mean of φ² is Σ_k S_k/N² = ∫ S df. To second order, χ² is h·Σ_p (φ_p − φ̂_p)² over the
//! illuminated samples, with the same Fisher information h on each, independently (defocus spreads
//! the light of each over the whole image). Where the pupil fills the square, the Hessian of
//! objective and prior together is h + 1/S_k for each k. So with
//!
//! `φ = H·g·y`,  `g_k = (h + 1/S_k)^(−1/2)`
//!
//! the Hessian in y is about 2·I where the pupil is illuminated, and the prior is Σ_k y_k²/(1 +
//! h·S_k): near 0 where the data dominate, y² where the prior does. Any h gives the same objective
//! in other coordinates, so h need not be exact.

use super::prior::RadialPsd;
use crate::fourier::{HartleyTransform, Real, fast_side};
use num_complex::Complex;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::ops::Range;

/// Least response of a spatial frequency, relative to the information given to
/// [`SpectralPreconditioner::set`]: less is the probes' own noise.
const MIN_RESPONSE: f64 = 1e-4;

/// Spectral preconditioner of one scene: the periodic square, the pupil on it and the prior's power
/// spectrum.
pub(super) struct SpectralPreconditioner<T: Real> {
    hartley: HartleyTransform<T>,
    pitch_m: f64,
    /// Index of each illuminated sample, `[x][y]`.
    place: Vec<u32>,
    /// Rows `[x]` with illuminated samples.
    rows: Range<usize>,
    /// S_k, nm², `[ky][kx]`.
    variance_nm2: Vec<f64>,
    /// Fisher information on each k over that on a sample: less where the light diffracted by k
    /// falls outside the image.
    response: Vec<f64>,
}

/// Coordinates for one image.
pub(super) struct ImagePreconditioner<T> {
    /// g_k, turns of phase.
    gain: Vec<T>,
    /// 1/(1 + h·S_k).
    prior: Vec<f64>,
}

/// Buffers of one thread.
pub(super) struct PreconditionerScratch<T> {
    from: Vec<T>,
    to: Vec<T>,
    fft: Vec<Complex<T>>,
}

impl<T: Real> SpectralPreconditioner<T> {
    /// For the `illuminated` samples (flat indices on a grid of `samples` a side, `pitch_m` apart,
    /// and the amplitude of each), on a square with a margin of `margin_m`, so that opposite rims
    /// of the pupil are independent. Samples of the ringing beyond the rim need no margin.
    ///
    /// # Errors
    /// Those of [`HartleyTransform::new`].
    pub(super) fn new(
        (illuminated, amplitude): (&[u32], &[f64]),
        samples: usize,
        pitch_m: f64,
        margin_m: f64,
        psd: &RadialPsd,
    ) -> crate::Result<Self> {
        let place = |&p: &u32| [p as usize % samples, p as usize / samples];
        let span = |axis: usize, least: f64| {
            let places = illuminated
                .iter()
                .zip(amplitude)
                .filter(|(_, amplitude)| **amplitude >= least)
                .map(|(p, _)| place(p)[axis]);
            (places.clone().min().unwrap_or(0), places.max().map_or(0, |last| last + 1))
        };
        let longest = |least: f64| (0..2).map(|axis| span(axis, least)).map(|(a, b)| b - a).max().unwrap_or(0);
        let ([(left, right), (bottom, _)], margin) =
            ([0, 1].map(|axis| span(axis, f64::NEG_INFINITY)), (margin_m / pitch_m).ceil() as usize);
        let side = fast_side(longest(f64::NEG_INFINITY).max(longest(0.5) + margin));
        let index = |p| {
            let [x, y] = place(p);
            ((x - left) * side + y - bottom) as u32
        };
        let mut square = Self {
            hartley: HartleyTransform::new(side)?,
            pitch_m,
            place: illuminated.iter().map(index).collect(),
            rows: 0..right - left,
            variance_nm2: Vec::new(),
            response: vec![1.0; side * side],
        };
        square.variance_nm2 = (0..side * side).map(|at| square.variance_of(psd, at)).collect();
        Ok(square)
    }

    /// Number of white coordinates.
    pub(super) fn len(&self) -> usize {
        self.variance_nm2.len()
    }

    pub(super) fn scratch(&self) -> PreconditionerScratch<T> {
        let zeros = || vec![T::zero(); self.len()];
        PreconditionerScratch { from: zeros(), to: zeros(), fft: self.hartley.scratch() }
    }

    pub(super) fn image_preconditioner(&self) -> ImagePreconditioner<T> {
        ImagePreconditioner { gain: vec![T::zero(); self.len()], prior: vec![0.0; self.len()] }
    }

    /// Sets the coordinates for an image with Fisher information `information_nm2` (h, nm⁻²) on
    /// each sample.
    pub(super) fn set(&self, information_nm2: f64, turns_per_nm: f64, image: &mut ImagePreconditioner<T>) {
        let parts = image.gain.iter_mut().zip(&mut image.prior).zip(&self.variance_nm2).zip(&self.response);
        for (((gain, prior), &variance), response) in parts {
            let information = information_nm2 * response;
            *gain = T::narrow(turns_per_nm / (information + 1.0 / variance).sqrt());
            *prior = 1.0 / (1.0 + information * variance);
        }
    }

    /// Draws a phase of power spectral density `psd`, times `scale`, at the illuminated samples.
    pub(super) fn draw(&self, psd: &RadialPsd, scale: f64, seed: u64) -> Vec<T> {
        let deviation = |at: usize| T::narrow(scale * self.variance_of(psd, at).sqrt());
        let filter = ImagePreconditioner { gain: (0..self.len()).map(deviation).collect(), prior: Vec::new() };
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let white: Vec<f64> = (0..self.len()).map(|_| StandardNormal.sample(&mut rng)).collect();
        let mut field = vec![T::zero(); self.place.len()];
        self.phase(&filter, &white, &mut self.scratch(), &mut field);
        field
    }

    /// Variance S_k of the coefficients of `psd`, nm².
    fn variance_of(&self, psd: &RadialPsd, at: usize) -> f64 {
        let side = self.hartley.side();
        let cycles = |k: usize| k.min(side - k) as f64;
        let step_per_m = 1.0 / (side as f64 * self.pitch_m);
        psd.density_nm2_m2_at(step_per_m * cycles(at / side).hypot(cycles(at % side))) / self.pitch_m.powi(2)
    }

    /// Rings of spatial frequencies: the ring of each k, and their number.
    fn rings(&self) -> (Vec<usize>, usize) {
        let side = self.hartley.side();
        let cycles = |k: usize| k.min(side - k) as f64;
        let ring = |at: usize| cycles(at / side).hypot(cycles(at % side)).round() as usize;
        let rings: Vec<usize> = (0..side * side).map(ring).collect();
        let count = rings.iter().max().map_or(0, |last| last + 1);
        (rings, count)
    }

    /// Measures the response to each spatial frequency with `probes` white phases: `hessian`
    /// multiplies a phase at the illuminated samples, turns, by the Gauss-Newton matrix over the
    /// information on a sample. The response is averaged over rings.
    pub(super) fn measure_response(&mut self, probes: u64, mut hessian: impl FnMut(&[T], &mut [T])) {
        let (rings, count) = self.rings();
        let (mut power, mut product_power) = (vec![0.0; count], vec![0.0; count]);
        let mut scratch = self.scratch();
        let flat = ImagePreconditioner { gain: vec![T::one(); self.len()], prior: Vec::new() };
        let (mut turns, mut product) = (vec![T::zero(); self.place.len()], vec![T::zero(); self.place.len()]);
        let mut returned = vec![0.0; self.len()];
        for seed in 0..probes {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let sent: Vec<f64> = (0..self.len()).map(|_| StandardNormal.sample(&mut rng)).collect();
            self.phase(&flat, &sent, &mut scratch, &mut turns);
            hessian(&turns, &mut product);
            self.phase_adjoint(&flat, &product, &mut scratch, &mut returned);
            for ((&ring, sent), returned) in rings.iter().zip(&sent).zip(&returned) {
                power[ring] += sent * sent;
                product_power[ring] += sent * returned;
            }
        }
        let covered = self.place.len() as f64 / self.len() as f64;
        for (response, &ring) in self.response.iter_mut().zip(&rings) {
            *response = (product_power[ring] / (power[ring] * covered)).max(MIN_RESPONSE);
        }
    }

    /// Evaluates the phase of white coordinates `y` (`[ky][kx]`) at the illuminated samples, turns.
    pub(super) fn phase(
        &self,
        image: &ImagePreconditioner<T>,
        y: &[f64],
        scratch: &mut PreconditionerScratch<T>,
        turns: &mut [T],
    ) {
        for ((from, &y), &gain) in scratch.from.iter_mut().zip(y).zip(&image.gain) {
            *from = T::narrow(y) * gain;
        }
        self.hartley.transform(&scratch.from, 0..self.hartley.side(), &mut scratch.to, &mut scratch.fft);
        for (turns, &place) in turns.iter_mut().zip(&self.place) {
            *turns = scratch.to[place as usize];
        }
    }

    /// Adjoint of [`Self::phase`]: a gradient per turn at the illuminated samples to one in `y`.
    pub(super) fn phase_adjoint(
        &self,
        image: &ImagePreconditioner<T>,
        turns_bar: &[T],
        scratch: &mut PreconditionerScratch<T>,
        y_bar: &mut [f64],
    ) {
        scratch.from.fill(T::zero());
        for (&bar, &place) in turns_bar.iter().zip(&self.place) {
            scratch.from[place as usize] = bar;
        }
        self.hartley.transform(&scratch.from, self.rows.clone(), &mut scratch.to, &mut scratch.fft);
        for ((y_bar, &to), &gain) in y_bar.iter_mut().zip(&scratch.to).zip(&image.gain) {
            *y_bar = (to * gain).widen();
        }
    }

    /// Effective degrees of freedom that the free phase takes from an image with `information_nm2`
    /// (h) on each of `covered` illuminated samples: Σ h·S/(1 + h·S), over their share of the
    /// square.
    pub(super) fn freedom(&self, information_nm2: f64, covered: f64) -> f64 {
        let seen = |(variance, response): (&f64, &f64)| information_nm2 * response * variance;
        let parts = self.variance_nm2.iter().zip(&self.response).map(seen);
        parts.map(|seen| seen / (1.0 + seen)).sum::<f64>() * covered / self.len() as f64
    }

    /// Mean response over all frequencies.
    #[cfg(test)]
    pub(super) fn mean_response(&self) -> f64 {
        self.response.iter().sum::<f64>() / self.len() as f64
    }

    /// Prior variance of the phase, nm².
    pub(super) fn variance_nm2(&self) -> f64 {
        self.variance_nm2.iter().sum::<f64>() / self.len() as f64
    }
}

impl<T> ImagePreconditioner<T> {
    /// Returns the prior's term at `y` and adds its gradient to `gradient`.
    pub(super) fn add_prior(&self, y: &[f64], gradient: &mut [f64]) -> f64 {
        const LANES: usize = 8;
        let mut lanes = [0.0; LANES];
        let parts = y.chunks(LANES).zip(self.prior.chunks(LANES)).zip(gradient.chunks_mut(LANES));
        for ((y, prior), gradient) in parts {
            for i in 0..y.len() {
                let slope = prior[i] * y[i];
                lanes[i] += slope * y[i];
                gradient[i] += 2.0 * slope;
            }
        }
        lanes.iter().sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// A disc of 40 samples on a grid of 48.
    fn square<T: Real>() -> SpectralPreconditioner<T> {
        let lit: Vec<u32> =
            (0..48 * 48).filter(|p| (p % 48 - 24i32).pow(2) + (p / 48 - 23).pow(2) < 400).map(|p| p as u32).collect();
        let density = (0..60).map(|k| 50.0 / (1.0 + (0.1 * f64::from(k)).powi(2)).powf(11.0 / 6.0)).collect();
        SpectralPreconditioner::new((&lit, &vec![1.0; lit.len()]), 48, 0.1, 0.5, &RadialPsd::new(0.1, density).unwrap())
            .unwrap()
    }

    fn white(count: usize, seed: u64) -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| StandardNormal.sample(&mut rng)).collect()
    }

    #[test]
    fn phase_and_adjoint_pass_the_dot_test() {
        fn error<T: Real>() -> f64 {
            let square = square::<T>();
            let (mut filter, mut scratch) = (square.image_preconditioner(), square.scratch());
            square.set(1e-3, 1.0 / 2000.0, &mut filter);
            let (y, bar) = (white(square.len(), 1), white(square.place.len(), 2));
            let bar: Vec<T> = bar.iter().map(|&v| T::narrow(v)).collect();
            let (mut turns, mut y_bar) = (vec![T::nan(); bar.len()], vec![f64::NAN; y.len()]);
            square.phase(&filter, &y, &mut scratch, &mut turns);
            square.phase_adjoint(&filter, &bar, &mut scratch, &mut y_bar);
            let forward: f64 = turns.iter().zip(&bar).map(|(a, b)| a.widen() * b.widen()).sum();
            let adjoint: f64 = y.iter().zip(&y_bar).map(|(a, b)| a * b).sum();
            let size = |v: &[T]| v.iter().map(|v| v.widen().powi(2)).sum::<f64>().sqrt();
            (forward - adjoint).abs() / (size(&turns) * size(&bar))
        }
        // Random signs: a rounding a level of the transform, of which there are 12, at most.
        assert!(error::<f64>() < 12.0 * f64::EPSILON, "{:e}", error::<f64>());
        assert!(error::<f32>() < 12.0 * f64::from(f32::EPSILON), "{:e}", error::<f32>());
    }

    /// Without information (h = 0), white coordinates map to phases of the prior's variance.
    #[test]
    fn drawn_phases_have_the_variance_of_the_prior() {
        let square = square::<f64>();
        let (mut filter, mut scratch) = (square.image_preconditioner(), square.scratch());
        square.set(0.0, 1.0, &mut filter);
        assert!(filter.prior.iter().all(|&prior| prior == 1.0));
        let mut turns = vec![0.0; square.place.len()];
        let draws = 200;
        let mut mean_square = 0.0;
        for seed in 0..draws {
            square.phase(&filter, &white(square.len(), seed), &mut scratch, &mut turns);
            mean_square += turns.iter().map(|t| t * t).sum::<f64>() / (turns.len() as f64 * draws as f64);
        }
        let expected = square.variance_nm2.iter().sum::<f64>() / square.len() as f64;
        // Fields with some 20 independent patches each, 200 of them: √(2/4000) = 2 %; four times
        // that.
        assert!((mean_square / expected - 1.0).abs() < 0.08, "{mean_square} {expected}");
        // ... which is the integral of the density over the square of frequencies that the samples
        // carry.
        let step = 1.0 / (square.hartley.side() as f64 * 0.1);
        let sum: f64 = square.variance_nm2.iter().map(|s| s * 0.01 * step * step).sum();
        assert!((sum / expected - 1.0).abs() < 1e-12);
    }
}

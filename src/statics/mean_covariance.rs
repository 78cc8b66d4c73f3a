//! Covariance of the mean of images, and its inverse by preconditioned conjugate gradients.
//!
//! Between 9,000 samples of a pupil a dense Cholesky decomposition takes 600 MB and 10 s. A stationary covariance is a convolution:
//! on a grid padded for every lag it is diagonal in Fourier space, and conjugate gradients preconditioned by the inverse spectrum
//! (the exact inverse but for the pupil's edge) take two dozen iterations to four digits, for any number of samples.

use super::convolution::ConvolutionBuffers;
use super::covariance::ResidualCovariance;
use crate::optimize::{CancelFlag, is_cancelled};
use crate::retrieval::IlluminatedSamples;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2, Axis};
use num_complex::{Complex, Complex64};
use rayon::prelude::*;

/// Residual at which a column is solved, over its norm: four digits of a posterior.
const TOLERANCE: f64 = 1e-4;

/// Prior RMS of a sample of the mean wavefront at frequencies that images do not resolve, nm: more than turbulence and static
/// errors have there together.
const UNRESOLVED_NM: f64 = 50.0;

/// Iterations after which a solution fails: ten times the usual number.
const MAX_ITERATIONS: usize = 250;

/// Covariance of the mean of images.
pub struct MeanCovariance<'a> {
    residual: &'a ResidualCovariance,
    /// Eigenvalues of the mean over the number of points of the grid, nm².
    gain_nm2: Vec<f64>,
    /// Variance of the error of each sample, nm².
    floor_nm2: Vec<f64>,
    /// Approximate inverse of the eigenvalues, but for its scale.
    inverse: Vec<f32>,
    cancel: Option<&'a CancelFlag>,
}

/// Buffers of a solution.
struct SolverBuffers {
    double: ConvolutionBuffers<f64>,
    single: ConvolutionBuffers<f32>,
}

impl<'a> MeanCovariance<'a> {
    /// Covariance of the mean of `images` wavefronts of covariance `residual`, whose samples each have an independent error of
    /// `sample_error_nm` over their amplitude.
    pub fn new(
        residual: &'a ResidualCovariance,
        images: usize,
        sample_error_nm: f64,
        samples: &IlluminatedSamples,
    ) -> Self {
        let floor_nm2 = samples.amplitude.iter().map(|amplitude| (sample_error_nm / amplitude.clamp(0.1, 1.0)).powi(2));
        let middle_nm2 = sample_error_nm.powi(2);
        let share = 1.0 / images as f64;
        let n2 = (residual.padded * residual.padded) as f64;
        let of_mean = |(nm2, &is_unresolved): (&f64, &bool)| {
            nm2 * share + if is_unresolved { UNRESOLVED_NM * UNRESOLVED_NM } else { 0.0 }
        };
        let mean_nm2: Vec<f64> = residual.spectrum_nm2.iter().zip(&residual.is_unresolved).map(of_mean).collect();
        let gain_nm2 = mean_nm2.iter().map(|nm2| nm2 / n2).collect();
        // Scaled to 1 and less in single precision: conjugate gradients do not depend on the scale of the preconditioner.
        let variance = |nm2: &f64| (nm2 + middle_nm2).max(f64::MIN_POSITIVE);
        let least = mean_nm2.iter().map(variance).fold(f64::MAX, f64::min);
        let inverse = mean_nm2.iter().map(|nm2| (least / variance(nm2) / n2) as f32).collect();
        Self { residual, gain_nm2, floor_nm2: floor_nm2.collect(), inverse, cancel: None }
    }

    /// As it is, but a solution ends where `cancel` is raised.
    pub fn stopped_by(self, cancel: Option<&'a CancelFlag>) -> Self {
        Self { cancel, ..self }
    }

    fn buffers(&self) -> SolverBuffers {
        SolverBuffers { double: self.residual.double.buffers(), single: self.residual.single.buffers() }
    }

    /// Computes C·v for two vectors at once, the real and the imaginary part of one.
    #[cfg(test)]
    pub fn times(&self, vectors: &[Complex64]) -> Vec<Complex64> {
        let mut product = vec![Complex64::default(); vectors.len()];
        self.times_into(vectors, &mut product, &mut self.residual.double.buffers());
        product
    }

    fn times_into(&self, vectors: &[Complex64], product: &mut [Complex64], buffers: &mut ConvolutionBuffers<f64>) {
        let filtered = self.residual.double.filtered(vectors.iter().copied(), &self.gain_nm2, buffers);
        for (((out, value), v), floor) in product.iter_mut().zip(filtered).zip(vectors).zip(&self.floor_nm2) {
            *out = value + v * floor;
        }
    }

    /// Preconditioner: approximates C⁻¹·v, but for a factor. In single precision, because it only has to be the same linear map
    /// each time, to a part in 10⁶.
    fn precondition(&self, vectors: &[Complex64], out: &mut [Complex64], buffers: &mut ConvolutionBuffers<f32>) {
        let largest =
            vectors.iter().fold([f64::MIN_POSITIVE; 2], |[re, im], v| [re.max(v.re.abs()), im.max(v.im.abs())]);
        let narrow = |v: &Complex64| Complex::new((v.re / largest[0]) as f32, (v.im / largest[1]) as f32);
        let filtered = self.residual.single.filtered(vectors.iter().map(narrow), &self.inverse, buffers);
        for (out, value) in out.iter_mut().zip(filtered) {
            *out = Complex64::new(f64::from(value.re) * largest[0], f64::from(value.im) * largest[1]);
        }
    }

    /// Computes C⁻¹ of each row of `columns`, `[column, sample]`, nm⁻².
    ///
    /// # Errors
    /// [`Error::Internal`] where the iteration does not converge, [`Error::Interrupted`].
    pub fn solve(&self, columns: ArrayView2<f64>) -> Result<Array2<f64>> {
        let mut solved = Array2::zeros(columns.dim());
        let pairs = columns.axis_chunks_iter(Axis(0), 2).into_par_iter();
        let outs = solved.axis_chunks_iter_mut(Axis(0), 2).into_par_iter();
        outs.zip(pairs).try_for_each_init(
            || self.buffers(),
            |buffers, (mut out, pair)| {
                if is_cancelled(self.cancel) {
                    return Err(Error::Interrupted("static errors were being separated".into()));
                }
                let both = |sample: usize| {
                    Complex64::new(pair[[0, sample]], if pair.nrows() > 1 { pair[[1, sample]] } else { 0.0 })
                };
                let right: Vec<Complex64> = (0..pair.ncols()).map(both).collect();
                for (sample, value) in self.solve_pair(right, buffers)?.into_iter().enumerate() {
                    out[[0, sample]] = value.re;
                    if out.nrows() > 1 {
                        out[[1, sample]] = value.im;
                    }
                }
                Ok(())
            },
        )?;
        Ok(solved)
    }

    /// Conjugate gradients for two right sides at once, each with its own steps.
    fn solve_pair(&self, right: Vec<Complex64>, buffers: &mut SolverBuffers) -> Result<Vec<Complex64>> {
        let wanted = dots(&right, &right).map(|square| square * TOLERANCE * TOLERANCE);
        let mut x = vec![Complex64::default(); right.len()];
        let mut residual = right;
        let mut preconditioned = x.clone();
        self.precondition(&residual, &mut preconditioned, &mut buffers.single);
        let (mut direction, mut product) = (preconditioned.clone(), x.clone());
        let mut gain = dots(&residual, &direction);
        for _ in 0..MAX_ITERATIONS {
            let left = dots(&residual, &residual);
            if (0..2).all(|i| left[i] <= wanted[i]) {
                return Ok(x);
            }
            self.times_into(&direction, &mut product, &mut buffers.double);
            let curvature = dots(&direction, &product);
            let step = [0, 1].map(|i| if curvature[i] > 0.0 { gain[i] / curvature[i] } else { 0.0 });
            add(&mut x, &direction, step);
            add(&mut residual, &product, step.map(|s| -s));
            self.precondition(&residual, &mut preconditioned, &mut buffers.single);
            let next = dots(&residual, &preconditioned);
            let keep = [0, 1].map(|i| if gain[i] > 0.0 { next[i] / gain[i] } else { 0.0 });
            for (d, p) in direction.iter_mut().zip(&preconditioned) {
                *d = Complex64::new(p.re + keep[0] * d.re, p.im + keep[1] * d.im);
            }
            gain = next;
        }
        Err(Error::Internal(format!("conjugate gradients did not invert a covariance in {MAX_ITERATIONS} iterations")))
    }
}

/// Scalar products of the real parts, and of the imaginary parts.
fn dots(a: &[Complex64], b: &[Complex64]) -> [f64; 2] {
    a.iter().zip(b).fold([0.0; 2], |[re, im], (a, b)| [re + a.re * b.re, im + a.im * b.im])
}

/// Adds a multiple of another vector to the real parts, and one to the imaginary parts.
fn add(to: &mut [Complex64], vector: &[Complex64], times: [f64; 2]) {
    for (to, value) in to.iter_mut().zip(vector) {
        *to += Complex64::new(times[0] * value.re, times[1] * value.im);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pupil::SegmentWeights;

    /// A ring on 24 × 24 samples, 0.1 m apart: one segment.
    fn disc() -> IlluminatedSamples {
        let at = |i: usize| i as f64 - 11.5;
        let amplitude = |&p: &u32| (3.0..11.0).contains(&at(p as usize % 24).hypot(at(p as usize / 24)));
        let lit: Vec<u32> = (0..576).filter(amplitude).collect();
        let count = lit.len();
        let weights = SegmentWeights {
            segments: 1,
            offsets: (0..=count as u32).collect(),
            segment: vec![0; count],
            weight: vec![1.0; count],
            energy: count as f64,
            illuminated: lit,
        };
        IlluminatedSamples::new(24, 0.1, &weights).unwrap()
    }

    /// Numbers without a pattern, of unit variance.
    fn noise(count: usize) -> Vec<f64> {
        use rand_distr::Distribution;
        let mut rng = crate::source::stream(5, 0);
        (0..count).map(|_| rand_distr::StandardNormal.sample(&mut rng)).collect()
    }

    #[test]
    fn variance_and_correlation_length_are_estimated() {
        let (samples, images) = (disc(), 60);
        // Each map is white noise averaged over 3 × 3 samples: variance 1/9, correlation (1 − lag/3) along an axis.
        let residuals = {
            let white = Array2::from_shape_vec((images, 26 * 26), noise(images * 676)).unwrap();
            Array2::from_shape_fn((images, samples.len()), |(image, sample)| {
                let (y, x) = (samples.indices[sample] / 24, samples.indices[sample] % 24);
                (0..9).map(|k| white[[image, (y + k / 3) * 26 + x + k % 3]]).sum::<f64>() / 9.0
            })
        };
        let covariance = ResidualCovariance::from_residuals(&samples, residuals.view()).unwrap();
        // 60 images of some 40 independent patches: variance to 1/√1200 = 3 %; three of those. Negative eigenvalues that are
        // left out, and the mean that is not, move it by a few per cent.
        assert!((covariance.rms_nm() * 3.0 - 1.0).abs() < 0.1, "{}", covariance.rms_nm());
        let mean = MeanCovariance::new(&covariance, 10, 0.0, &samples);
        let mut one = vec![Complex64::default(); samples.len()];
        let middle = samples.len() / 2 + 3;
        one[middle] = 1.0.into();
        let column = mean.times(&one);
        let neighbour = (0..samples.len()).find(|&s| samples.indices[s] == samples.indices[middle] + 1).unwrap();
        // The mean of ten: a tenth. Two thirds at its neighbour, less the taper; to the same 10 %.
        assert!((column[middle].re * 90.0 - 1.0).abs() < 0.2, "{}", column[middle].re);
        assert!((column[neighbour].re / column[middle].re - 2.0 / 3.0).abs() < 0.07);
    }

    #[test]
    fn the_product_of_the_inverse_is_the_identity() {
        let samples = disc();
        let smooth = |image: usize, sample: usize| {
            (samples.xs_m[sample] * (3.0 + image as f64) + image as f64).sin() * 30.0
                + samples.ys_m[sample] * image as f64
        };
        let residuals = Array2::from_shape_fn((7, samples.len()), |(image, sample)| smooth(image, sample));
        let covariance = ResidualCovariance::from_residuals(&samples, residuals.view()).unwrap();
        let mean = MeanCovariance::new(&covariance, 7, 1.0, &samples);
        let columns = Array2::from_shape_vec((3, samples.len()), noise(3 * samples.len())).unwrap();
        let solved = mean.solve(columns.view()).unwrap();
        for (column, solved) in columns.outer_iter().zip(solved.outer_iter()) {
            let back = mean.times(&solved.iter().map(|&v| v.into()).collect::<Vec<_>>());
            let off: f64 = back.iter().zip(column).map(|(back, v)| (back.re - v).powi(2)).sum();
            // The tolerance of the iteration, and rounding in its residual.
            assert!(off.sqrt() < 1.1 * TOLERANCE * column.dot(&column).sqrt());
        }
    }

    /// An estimate weights a ripple by C⁻¹: next to 0 beyond the resolved frequencies.
    #[test]
    fn unresolved_ripples_have_no_weight() {
        let samples = disc();
        let white = Array2::from_shape_vec((30, samples.len()), noise(30 * samples.len())).unwrap();
        let weight = |highest_frequency_per_m: f64, f_per_m: f64| {
            let covariance = ResidualCovariance::from_residuals(&samples, white.view())
                .unwrap()
                .with_unresolved_beyond(highest_frequency_per_m, 0.1);
            let ripple = |sample: usize| (std::f64::consts::TAU * f_per_m * samples.xs_m[sample]).cos();
            let column = Array2::from_shape_fn((1, samples.len()), |(_, sample)| ripple(sample));
            let mean = MeanCovariance::new(&covariance, 30, 1.0, &samples);
            mean.solve(column.view()).unwrap().row(0).dot(&column.row(0))
        };
        // 1.3 nm² of noise and floor against 50² nm². Within, a third: 0.7 of the plane is free here, and at the edges of a pupil
        // of 24 samples its ripples make up some of any other.
        assert!(weight(3.0, 4.2) < 1e-3 * weight(f64::INFINITY, 4.2));
        assert!(weight(3.0, 1.0) > 0.6 * weight(f64::INFINITY, 1.0));
    }

    #[test]
    fn one_image_and_other_samples_are_refused() {
        let samples = disc();
        assert!(ResidualCovariance::from_residuals(&samples, Array2::zeros((1, samples.len())).view()).is_err());
        assert!(ResidualCovariance::from_residuals(&samples, Array2::zeros((5, 3)).view()).is_err());
    }
}

//! Covariance of the mean of images, and its inverse by preconditioned conjugate gradients.
//!
//! Between 9,000 samples of a pupil a dense Cholesky decomposition takes 600 MB and 10 s. A
//! stationary covariance is a convolution: on a grid padded for every lag it is diagonal in Fourier
//! space, and conjugate gradients preconditioned by the inverse spectrum (the exact inverse but for
//! the pupil's edge) take two dozen iterations to four digits, for any number of samples. Scalar
//! products of the solutions have twice as many digits: see [`Weighted`].

use super::convolution::{ConvolutionBuffers, Convolver};
use super::covariance::ResidualCovariance;
use crate::control::Control;
use crate::linear_algebra::row_products;
use crate::retrieval::IlluminatedSamples;
use crate::{Error, Result};
use ndarray::linalg::general_mat_mul;
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};
use num_complex::Complex32;
use rayon::prelude::*;

/// Error at which a column is solved, over the solution, in the norm √(v·C·v) in which the error
/// bars of an estimate are 1: scalar products by [`Weighted`] are known to its square, which is
/// what single precision leaves of them, those with another mean to it. The preconditioner measures
/// it, but for a factor.
const TOLERANCE: f64 = 1e-3;

/// Prior RMS of a sample of the mean wavefront at frequencies that images do not resolve, nm: more
/// than turbulence and static errors have there together.
const UNRESOLVED_NM: f64 = 50.0;

/// Rows of scalar products that a thread computes at once.
const ROWS_OF_PRODUCTS: usize = 64;

/// Iterations after which a solution fails: ten times the usual number.
const MAX_ITERATIONS: usize = 250;

/// Covariance of the mean of images.
#[derive(Clone)]
pub struct MeanCovariance {
    convolver: Convolver<f32>,
    /// Eigenvalues, with the mean variance of a sample's error, nm²; none of frequencies that
    /// images do not resolve.
    resolved_nm2: Vec<f32>,
    /// Eigenvalues of the mean over the number of points of the grid, nm².
    gain_nm2: Vec<f32>,
    /// Variance of the error of each sample, nm².
    floor_nm2: Vec<f32>,
    /// Approximate inverse of the eigenvalues, but for its scale.
    inverse: Vec<f32>,
    control: Control,
}

/// Columns B weighted by the inverse of a covariance C, `[column, sample]`: X ≈ C⁻¹·B, and its
/// residual R = B − C·X.
///
/// For the columns B′ of another, with X′ and R′, X·B′ᵀ + R·X′ᵀ = B·C⁻¹·B′ᵀ − R·C⁻¹·R′ᵀ: the error
/// of these scalar products is the product of two residuals, where that of X·B′ᵀ alone is one.
pub struct Weighted {
    /// X, the unit of B over nm².
    pub solution: Array2<f64>,
    residual: Array2<f64>,
}

impl Weighted {
    /// Computes B·C⁻¹·B′ᵀ for the columns `others`, B′, of which `weighted` is X′.
    pub fn products(&self, others: ArrayView2<f64>, weighted: &Weighted) -> Array2<f64> {
        let mut products = Array2::zeros((self.solution.nrows(), others.nrows()));
        let [solution, residual] =
            [&self.solution, &self.residual].map(|own| own.axis_chunks_iter(Axis(0), ROWS_OF_PRODUCTS));
        products
            .axis_chunks_iter_mut(Axis(0), ROWS_OF_PRODUCTS)
            .into_par_iter()
            .zip(solution.into_par_iter())
            .zip(residual.into_par_iter())
            .for_each(|((mut products, solution), residual)| {
                general_mat_mul(1.0, &solution, &others.t(), 0.0, &mut products);
                general_mat_mul(1.0, &residual, &weighted.solution.t(), 1.0, &mut products);
            });
        products
    }

    /// What [`products`](Self::products) adds to X·b′ for one column, of which `weighted` is X′.
    pub fn correction(&self, weighted: ArrayView1<f64>) -> Array1<f64> {
        row_products(self.residual.view(), weighted)
    }
}

impl MeanCovariance {
    /// Covariance of the mean of `images` wavefronts of covariance `residual`, whose samples each
    /// have an independent error of `sample_error_nm` over their amplitude.
    pub fn new(
        residual: &ResidualCovariance,
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
        let gain_nm2 = mean_nm2.iter().map(|nm2| (nm2 / n2) as f32).collect();
        // Scaled to 1 and less in single precision: conjugate gradients do not depend on the scale
        // of the preconditioner.
        let variance = |nm2: &f64| (nm2 + middle_nm2).max(f64::MIN_POSITIVE);
        let least = mean_nm2.iter().map(variance).fold(f64::MAX, f64::min);
        let inverse = mean_nm2.iter().map(|nm2| (least / variance(nm2) / n2) as f32).collect();
        let resolved = mean_nm2.iter().zip(&residual.is_unresolved).filter(|(_, is_unresolved)| !**is_unresolved);
        Self {
            convolver: residual.single.clone(),
            resolved_nm2: resolved.map(|(nm2, _)| variance(nm2) as f32).collect(),
            gain_nm2,
            floor_nm2: floor_nm2.map(|nm2| nm2 as f32).collect(),
            inverse,
            control: Control::default(),
        }
    }

    /// As it is, but a solution ends where `control` is cancelled.
    pub fn stopped_by(self, control: &Control) -> Self {
        Self { control: control.clone(), ..self }
    }

    /// RMS, over the resolved frequencies, of the logarithm of this covariance over `other`;
    /// infinite for one on another grid.
    ///
    /// An estimate whose weights are off by factors between 1 − d and 1 + d has a variance of at
    /// most 1/(1 − d²) times the least (Kantorovich), and error bars from them are off by d/2 at
    /// most.
    pub fn distance(&self, other: &Self) -> f64 {
        if self.resolved_nm2.len() != other.resolved_nm2.len() || self.floor_nm2.len() != other.floor_nm2.len() {
            return f64::INFINITY;
        }
        let square = |(own, other): (&f32, &f32)| f64::from(own / other).ln().powi(2);
        let sum: f64 = self.resolved_nm2.iter().zip(&other.resolved_nm2).map(square).sum();
        (sum / self.resolved_nm2.len().max(1) as f64).sqrt()
    }

    /// Computes C·v for two vectors at once, the real and the imaginary part of one.
    fn times(&self, vectors: &[Complex32], product: &mut [Complex32], buffers: &mut ConvolutionBuffers<f32>) {
        let filtered = self.convolver.filtered(vectors.iter().copied(), &self.gain_nm2, buffers);
        for (((out, value), v), floor) in product.iter_mut().zip(filtered).zip(vectors).zip(&self.floor_nm2) {
            *out = value + v * floor;
        }
    }

    /// Preconditioner: approximates C⁻¹·v, but for a factor.
    fn precondition(&self, vectors: &[Complex32], out: &mut [Complex32], buffers: &mut ConvolutionBuffers<f32>) {
        let filtered = self.convolver.filtered(vectors.iter().copied(), &self.inverse, buffers);
        out.iter_mut().zip(filtered).for_each(|(out, value)| *out = value);
    }

    /// Weights each row of `columns`, `[column, sample]`, by C⁻¹.
    ///
    /// # Errors
    /// [`Error::Internal`] where the iteration does not converge, [`Error::Interrupted`].
    pub fn solve(&self, columns: ArrayView2<f64>) -> Result<Weighted> {
        let mut weighted = Weighted { solution: Array2::zeros(columns.dim()), residual: Array2::zeros(columns.dim()) };
        let pairs = columns.axis_chunks_iter(Axis(0), 2).into_par_iter();
        let solutions = weighted.solution.axis_chunks_iter_mut(Axis(0), 2).into_par_iter();
        let residuals = weighted.residual.axis_chunks_iter_mut(Axis(0), 2).into_par_iter();
        solutions.zip(residuals).zip(pairs).try_for_each_init(
            || self.convolver.buffers(),
            |buffers, ((mut solution, mut residual), pair)| {
                self.control.check("static errors were being separated")?;
                // Columns are normalised, because the range of single precision is limited.
                let norms = [0, 1].map(|i| {
                    let square = if i < pair.nrows() { pair.row(i).dot(&pair.row(i)) } else { 0.0 };
                    if square > 0.0 { square.sqrt() } else { 1.0 }
                });
                let at = |row: usize, sample| {
                    if row < pair.nrows() { (pair[[row, sample]] / norms[row]) as f32 } else { 0.0 }
                };
                let right: Vec<Complex32> = (0..pair.ncols()).map(|i| Complex32::new(at(0, i), at(1, i))).collect();
                let (x, r) = self.solve_pair(right, buffers)?;
                for (values, mut rows) in [(x, solution.view_mut()), (r, residual.view_mut())] {
                    for (sample, value) in values.into_iter().enumerate() {
                        for (row, value) in [value.re, value.im].into_iter().enumerate().take(rows.nrows()) {
                            rows[[row, sample]] = f64::from(value) * norms[row];
                        }
                    }
                }
                Ok(())
            },
        )?;
        Ok(weighted)
    }

    /// Conjugate gradients for two right sides at once, each with its own steps; returns the
    /// solution and its residual.
    fn solve_pair(
        &self,
        right: Vec<Complex32>,
        buffers: &mut ConvolutionBuffers<f32>,
    ) -> Result<(Vec<Complex32>, Vec<Complex32>)> {
        let mut x = vec![Complex32::default(); right.len()];
        let mut residual = right;
        let mut preconditioned = x.clone();
        self.precondition(&residual, &mut preconditioned, buffers);
        let (mut direction, mut product) = (preconditioned.clone(), x.clone());
        let mut gain = dots(&residual, &direction);
        let wanted = gain.map(|square| square * TOLERANCE * TOLERANCE);
        for _ in 0..MAX_ITERATIONS {
            if (0..2).all(|i| gain[i] <= wanted[i]) {
                return Ok((x, residual));
            }
            self.times(&direction, &mut product, buffers);
            let curvature = dots(&direction, &product);
            let step = [0, 1].map(|i| if curvature[i] > 0.0 { gain[i] / curvature[i] } else { 0.0 });
            add(&mut x, &direction, step);
            add(&mut residual, &product, step.map(|s| -s));
            self.precondition(&residual, &mut preconditioned, buffers);
            let next = dots(&residual, &preconditioned);
            let keep = [0, 1].map(|i| if gain[i] > 0.0 { (next[i] / gain[i]) as f32 } else { 0.0 });
            for (d, p) in direction.iter_mut().zip(&preconditioned) {
                *d = Complex32::new(p.re + keep[0] * d.re, p.im + keep[1] * d.im);
            }
            gain = next;
        }
        Err(Error::Internal(format!("conjugate gradients did not invert a covariance in {MAX_ITERATIONS} iterations")))
    }
}

/// Scalar products of the real parts, and of the imaginary parts, summed in double precision.
fn dots(a: &[Complex32], b: &[Complex32]) -> [f64; 2] {
    let product = |a: f32, b: f32| f64::from(a) * f64::from(b);
    a.iter().zip(b).fold([0.0; 2], |[re, im], (a, b)| [re + product(a.re, b.re), im + product(a.im, b.im)])
}

/// Adds a multiple of another vector to the real parts, and one to the imaginary parts.
fn add(to: &mut [Complex32], vector: &[Complex32], times: [f64; 2]) {
    let times = times.map(|times| times as f32);
    for (to, value) in to.iter_mut().zip(vector) {
        *to += Complex32::new(times[0] * value.re, times[1] * value.im);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pupil::SegmentWeights;
    use ndarray::Array1;

    /// C·v for one vector.
    fn times(mean: &MeanCovariance, vector: ArrayView1<f64>) -> Array1<f64> {
        let vector: Vec<Complex32> = vector.iter().map(|&v| Complex32::new(v as f32, 0.0)).collect();
        let mut product = vec![Complex32::default(); vector.len()];
        mean.times(&vector, &mut product, &mut mean.convolver.buffers());
        product.iter().map(|value| f64::from(value.re)).collect()
    }

    /// Norm of the tolerance: √(v·M·v) with the preconditioner M.
    fn norm_of(mean: &MeanCovariance, vector: ArrayView1<f64>) -> f64 {
        let vector: Vec<Complex32> = vector.iter().map(|&v| Complex32::new(v as f32, 0.0)).collect();
        let mut product = vector.clone();
        mean.precondition(&vector, &mut product, &mut mean.convolver.buffers());
        dots(&vector, &product)[0].sqrt()
    }

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
        // Each map is white noise averaged over 3 × 3 samples: variance 1/9, correlation (1 −
        // lag/3) along an axis.
        let residuals = {
            let white = Array2::from_shape_vec((images, 26 * 26), noise(images * 676)).unwrap();
            Array2::from_shape_fn((images, samples.len()), |(image, sample)| {
                let (y, x) = (samples.indices[sample] / 24, samples.indices[sample] % 24);
                (0..9).map(|k| white[[image, (y + k / 3) * 26 + x + k % 3]]).sum::<f64>() / 9.0
            })
        };
        let covariance = ResidualCovariance::from_residuals(&samples, residuals.view()).unwrap();
        // 60 images of some 40 independent patches: variance to 1/√1200 = 3 %; three of those.
        // Negative eigenvalues that are left out, and the mean that is not, move it by a few per
        // cent.
        assert!((covariance.rms_nm() * 3.0 - 1.0).abs() < 0.1, "{}", covariance.rms_nm());
        let mean = MeanCovariance::new(&covariance, 10, 0.0, &samples);
        let mut one = Array1::zeros(samples.len());
        let middle = samples.len() / 2 + 3;
        one[middle] = 1.0;
        let column = times(&mean, one.view());
        let neighbour = (0..samples.len()).find(|&s| samples.indices[s] == samples.indices[middle] + 1).unwrap();
        // The mean of ten: a tenth. Two thirds at its neighbour, less the taper; to the same 10 %.
        assert!((column[middle] * 90.0 - 1.0).abs() < 0.2, "{}", column[middle]);
        assert!((column[neighbour] / column[middle] - 2.0 / 3.0).abs() < 0.07);
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
        let weighted = mean.solve(columns.view()).unwrap();
        for ((column, solution), residual) in
            columns.outer_iter().zip(weighted.solution.outer_iter()).zip(weighted.residual.outer_iter())
        {
            let norm = column.dot(&column).sqrt();
            let left = &column - &times(&mean, solution);
            // The tolerance in its own norm; a tenth for the rounding of the norms.
            assert!(norm_of(&mean, residual) < 1.1 * TOLERANCE * norm_of(&mean, column));
            // What single precision adds to the residual of the iteration: the rounding of 2⁻²⁴ =
            // 6e-8 times the condition.
            let rounding = &left - &residual;
            assert!(rounding.dot(&rounding).sqrt() < 1e-4 * norm);
        }
    }

    /// Scalar products are known to the square of the solution's tolerance.
    #[test]
    fn residuals_correct_the_scalar_products() {
        let samples = disc();
        let white = Array2::from_shape_vec((30, samples.len()), noise(30 * samples.len())).unwrap();
        let covariance = ResidualCovariance::from_residuals(&samples, white.view()).unwrap();
        let mean = MeanCovariance::new(&covariance, 30, 0.3, &samples);
        let columns = white.slice(ndarray::s![..4, ..]);
        let weighted = mean.solve(columns).unwrap();
        // The dense inverse, in double precision.
        let mut dense = Array2::zeros((samples.len(), samples.len()));
        for (sample, mut row) in dense.outer_iter_mut().enumerate() {
            let mut one = Array1::zeros(samples.len());
            one[sample] = 1.0;
            row.assign(&times(&mean, one.view()));
        }
        let inverse = crate::linear_algebra::SpdInverse::new(&((&dense + &dense.t()) / 2.0)).unwrap().inverse;
        let exact = columns.dot(&inverse).dot(&columns.t());
        let error = |products: Array2<f64>| (products - &exact).iter().fold(0.0, |most: f64, e| most.max(e.abs()));
        let scale = exact.diag().fold(0.0, |most: f64, &value| most.max(value));
        let [corrected, plain] = [weighted.products(columns, &weighted), weighted.solution.dot(&columns.t())]
            .map(|products| error(products) / scale);
        // The square of the tolerance is 1e-7; single precision of the residuals leaves some 1e-6,
        // and the plain product the tolerance.
        assert!(corrected < 1e-5 && corrected < 0.1 * plain, "{corrected:e} {plain:e}");
        let column = weighted.correction(weighted.solution.row(2)) + weighted.solution.dot(&columns.row(2));
        assert!((&column - &exact.column(2)).iter().all(|off| off.abs() < 1e-5 * scale));
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
            mean.solve(column.view()).unwrap().solution.row(0).dot(&column.row(0))
        };
        // 1.3 nm² of noise and floor against 50² nm². Within, a third: 0.7 of the plane is free
        // here, and at the edges of a pupil of 24 samples its ripples make up some of any other.
        assert!(weight(3.0, 4.2) < 1e-3 * weight(f64::INFINITY, 4.2));
        assert!(weight(3.0, 1.0) > 0.6 * weight(f64::INFINITY, 1.0));
    }

    #[test]
    fn the_distance_of_two_covariances_is_that_of_their_logarithms() {
        let samples = disc();
        let white = Array2::from_shape_vec((30, samples.len()), noise(30 * samples.len())).unwrap();
        let of = |times: f64, f_per_m: f64| {
            let residuals = &white * times;
            let covariance = ResidualCovariance::from_residuals(&samples, residuals.view()).unwrap();
            MeanCovariance::new(&covariance.with_unresolved_beyond(f_per_m, 0.1), 30, 0.01, &samples)
        };
        let one = of(1.0, f64::INFINITY);
        assert_eq!(one.distance(&one), 0.0);
        // Eigenvalues that are 0 are equal in both: the others, of which white noise has four
        // fifths or more after the taper, differ by ln 1.21.
        let distance = one.distance(&of(1.1, f64::INFINITY));
        assert!(distance < 1.21f64.ln() * 1.0001 && distance > 0.8 * 1.21f64.ln(), "{distance}");
        // Other frequencies are resolved.
        assert_eq!(one.distance(&of(1.0, 3.0)), f64::INFINITY);
    }

    #[test]
    fn one_image_and_other_samples_are_refused() {
        let samples = disc();
        assert!(ResidualCovariance::from_residuals(&samples, Array2::zeros((1, samples.len())).view()).is_err());
        assert!(ResidualCovariance::from_residuals(&samples, Array2::zeros((5, 3)).view()).is_err());
    }
}

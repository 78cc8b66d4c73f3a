//! How the mean of a turbulent residual scatters: a covariance that depends on distance alone, and its inverse.
//!
//! Between 9,000 samples of a pupil a dense Cholesky decomposition takes 600 MB and 10 s. A stationary covariance is a
//! convolution instead: on a grid that leaves room for every lag it is diagonal in Fourier space, and conjugate gradients
//! preconditioned by the inverse spectrum (the exact inverse but for the pupil's edge) take two dozen iterations for
//! four digits, whatever the number of samples.

use super::convolution::{Convolver, Room, transform};
use crate::retrieval::{LitSamples, Spectrum};
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2, Axis};
use num_complex::{Complex, Complex64};
use rayon::prelude::*;

/// Pairs of samples at a lag below which it is not measured: their mean would be noise.
const FEWEST_PAIRS: f64 = 50.0;

/// Residual at which a column is solved, of its own norm: a posterior to four digits.
const SOLVED: f64 = 1e-4;

/// What nobody knows of a mean phase at frequencies that no image shows, nm RMS of a sample: more than turbulence and static
/// errors have there together.
const UNSEEN_NM: f64 = 50.0;

/// Maps whose power is summed by one thread: enough to pay for its memory.
const MAPS_TOGETHER: usize = 16;

/// Iterations after which a column stays as it is: ten times what one takes.
const MOST_ITERATIONS: usize = 250;

/// Covariance between the samples of the residual wavefront of single images, by its spectrum.
#[derive(Clone)]
pub struct ResidualCovariance {
    /// Samples along a side of the grid with room for every lag.
    padded: usize,
    /// Eigenvalues, nm², `[kx, ky]`, none negative.
    spectrum_nm2: Vec<f64>,
    /// Which of them are of frequencies that no image shows.
    unseen: Vec<bool>,
    /// Convolutions in either precision: products with the covariance need the one, its approximate inverse only the other.
    double: Convolver<f64>,
    single: Convolver<f32>,
}

impl ResidualCovariance {
    /// As `residuals_nm`, `[image, sample]`, each about the mean of them all, show it.
    ///
    /// The autocorrelation over all pairs of samples and all images, tapered to nothing at the width of the pupil,
    /// negative eigenvalues (which only the taper and chance make) left out.
    ///
    /// # Errors
    /// [`Error::Value`] for fewer than two images, [`Error::Shape`] for another number of samples.
    pub fn of_scatter(lit: &LitSamples, residuals_nm: ArrayView2<f64>) -> Result<Self> {
        let (images, samples) = residuals_nm.dim();
        if images < 2 {
            return Err(Error::Value(format!("{images} images do not show how they scatter: at least 2 are needed")));
        }
        if samples != lit.len() {
            return Err(Error::Shape(format!("phases of {samples} samples were given: {} are needed", lit.len())));
        }
        let double = Convolver::of(lit);
        let pairs = autocorrelation(&double, Array2::ones((1, samples)).view());
        let products = autocorrelation(&double, residuals_nm);
        // The scatter about a mean of n is (n − 1)/n of that about the truth.
        let unbiased = 1.0 / (images - 1) as f64;
        let n = double.padded;
        let reach_m = reach_m(lit);
        let lag = |k: usize| (if k <= n / 2 { k as f64 } else { k as f64 - n as f64 }) * lit.pitch_m;
        let mut field: Vec<Complex64> = (0..n * n)
            .map(|at| {
                let r_m = lag(at % n).hypot(lag(at / n));
                // A pair is counted once in each direction, and rounding leaves fractions of one.
                let measured = if pairs[at] > FEWEST_PAIRS { products[at] / pairs[at] * unbiased } else { 0.0 };
                let taper =
                    if r_m < reach_m { 0.5 * (1.0 + (std::f64::consts::PI * r_m / reach_m).cos()) } else { 0.0 };
                Complex64::new(measured * taper, 0.0)
            })
            .collect();
        transform(&mut field, n, &*double.forward);
        let spectrum_nm2 = field.iter().map(|value| value.re.max(0.0)).collect();
        Ok(Self { padded: n, spectrum_nm2, unseen: vec![false; n * n], double, single: Convolver::of(lit) })
    }

    /// This covariance with no less than `spectrum` at any frequency.
    ///
    /// A retrieval by maximum a posteriori lowers what it hardly sees. Its phases scatter less there than the turbulence
    /// does; they show static errors less too, and a covariance as small as their scatter would rest the estimate on just
    /// these frequencies.
    pub fn at_least(mut self, spectrum: &Spectrum, pitch_m: f64) -> Self {
        for (at, value) in self.spectrum_nm2.iter_mut().enumerate() {
            let least = spectrum.at(frequency_per_m(at, self.padded, pitch_m)) / (pitch_m * pitch_m);
            *value = value.max(least);
        }
        self
    }

    /// This covariance for phases of which nothing is known beyond `seen_to_per_m`.
    ///
    /// What a retrieval by maximum a posteriori cannot see it leaves as it was before. Edges of segments stand out from
    /// turbulence the more, the higher the frequency, so an estimate that believed these phases would rest on what is not
    /// there: pass after pass it would recover half of the pistons that are still missing, and errors would double.
    pub fn seen_to(mut self, seen_to_per_m: f64, pitch_m: f64) -> Self {
        for (at, unseen) in self.unseen.iter_mut().enumerate() {
            *unseen = frequency_per_m(at, self.padded, pitch_m) > seen_to_per_m;
        }
        self
    }

    /// RMS of a residual, nm.
    pub fn rms_nm(&self) -> f64 {
        (self.spectrum_nm2.iter().sum::<f64>()).sqrt() / self.padded as f64
    }

    /// The covariance of the mean of `images` of them, whose samples are also each off by `floor_nm` over the share of glass
    /// they hold.
    pub fn of_mean<'a>(&'a self, images: usize, floor_nm: f64, lit: &LitSamples) -> MeanCovariance<'a> {
        let floor_nm2: Vec<f64> = lit.glass.iter().map(|glass| (floor_nm / glass.clamp(0.1, 1.0)).powi(2)).collect();
        let middle = floor_nm.powi(2);
        let share = 1.0 / images as f64;
        let n2 = (self.padded * self.padded) as f64;
        let of_mean = |(nm2, &unseen): (&f64, &bool)| nm2 * share + if unseen { UNSEEN_NM * UNSEEN_NM } else { 0.0 };
        let mean_nm2: Vec<f64> = self.spectrum_nm2.iter().zip(&self.unseen).map(of_mean).collect();
        let gain_nm2 = mean_nm2.iter().map(|nm2| nm2 / n2).collect();
        // Scaled to 1 and less in single precision: conjugate gradients do not ask for the scale of what preconditions them.
        let strength = |nm2: &f64| (nm2 + middle).max(f64::MIN_POSITIVE);
        let weakest = mean_nm2.iter().map(strength).fold(f64::MAX, f64::min);
        let inverse = mean_nm2.iter().map(|nm2| (weakest / strength(nm2) / n2) as f32).collect();
        MeanCovariance { of_one: self, gain_nm2, floor_nm2, inverse }
    }
}

/// That of the place `[kx, ky]` on a square of `n` samples a side.
fn frequency_per_m(place: usize, n: usize, pitch_m: f64) -> f64 {
    let cycles = |k: usize| k.min(n - k) as f64;
    cycles(place % n).hypot(cycles(place / n)) / (n as f64 * pitch_m)
}

/// The largest lag that matters: no pair is farther apart than the pupil is wide, and none at its width is left.
fn reach_m(lit: &LitSamples) -> f64 {
    let wide = |values: &[f64]| {
        let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(low, high), &v| (low.min(v), high.max(v)));
        high - low
    };
    wide(&lit.xs_m).max(wide(&lit.ys_m)).max(lit.pitch_m)
}

/// Σ over maps, `[map, sample]`, and over pairs of samples at each lag, `[x, y]`.
fn autocorrelation(convolver: &Convolver<f64>, maps: ArrayView2<f64>) -> Vec<f64> {
    let n2 = convolver.padded * convolver.padded;
    // Two maps go as the real and the imaginary part of one: their cross terms are odd in frequency, and the real part of
    // what comes back has none of them.
    let of_some = |maps: ArrayView2<f64>| {
        let (mut power, mut room) = (vec![0.0; n2], convolver.room());
        for pair in maps.axis_chunks_iter(Axis(0), 2) {
            let last = pair.nrows() - 1;
            let both = (0..pair.ncols()).map(|i| Complex64::new(pair[[0, i]], last as f64 * pair[[last, i]]));
            convolver.spectrum(both, &mut room);
            power.iter_mut().zip(&room.turned).for_each(|(sum, value)| *sum += value.norm_sqr());
        }
        power
    };
    // Parts of a fixed size, summed in turn: the same bits whatever the threads.
    let parts: Vec<Vec<f64>> = maps.axis_chunks_iter(Axis(0), MAPS_TOGETHER).into_par_iter().map(of_some).collect();
    let mut power = vec![0.0; n2];
    for part in parts {
        power.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
    }
    let mut power: Vec<Complex64> = power.into_iter().map(Complex64::from).collect();
    transform(&mut power, convolver.padded, &*convolver.inverse);
    power.iter().map(|value| value.re / n2 as f64).collect()
}

/// Covariance of a mean of images.
pub struct MeanCovariance<'a> {
    of_one: &'a ResidualCovariance,
    /// Spectrum of the mean over the points of the grid, nm².
    gain_nm2: Vec<f64>,
    floor_nm2: Vec<f64>,
    /// About the inverse, but for its scale.
    inverse: Vec<f32>,
}

/// Memory of a solution.
struct Rooms {
    double: Room<f64>,
    single: Room<f32>,
}

impl MeanCovariance<'_> {
    fn rooms(&self) -> Rooms {
        Rooms { double: self.of_one.double.room(), single: self.of_one.single.room() }
    }

    /// C·v for two vectors at once, which are the real and the imaginary part of one.
    pub fn times(&self, vectors: &[Complex64]) -> Vec<Complex64> {
        let mut product = vec![Complex64::default(); vectors.len()];
        self.times_into(vectors, &mut product, &mut self.of_one.double.room());
        product
    }

    fn times_into(&self, vectors: &[Complex64], product: &mut [Complex64], room: &mut Room<f64>) {
        let filtered = self.of_one.double.filtered(vectors.iter().copied(), &self.gain_nm2, room);
        for (((out, value), v), floor) in product.iter_mut().zip(filtered).zip(vectors).zip(&self.floor_nm2) {
            *out = value + v * floor;
        }
    }

    /// About C⁻¹·v, but for a factor. In single precision: it only has to be the same linear map every time, to a part in
    /// 10⁶.
    fn precondition(&self, vectors: &[Complex64], out: &mut [Complex64], room: &mut Room<f32>) {
        let largest =
            vectors.iter().fold([f64::MIN_POSITIVE; 2], |[re, im], v| [re.max(v.re.abs()), im.max(v.im.abs())]);
        let narrow = |v: &Complex64| Complex::new((v.re / largest[0]) as f32, (v.im / largest[1]) as f32);
        let filtered = self.of_one.single.filtered(vectors.iter().map(narrow), &self.inverse, room);
        for (out, value) in out.iter_mut().zip(filtered) {
            *out = Complex64::new(f64::from(value.re) * largest[0], f64::from(value.im) * largest[1]);
        }
    }

    /// C⁻¹ of each row of `columns`, `[column, sample]`, per nm².
    ///
    /// # Errors
    /// [`Error::Internal`] where the iteration does not converge.
    pub fn solve(&self, columns: ArrayView2<f64>) -> Result<Array2<f64>> {
        let mut solved = Array2::zeros(columns.dim());
        let pairs = columns.axis_chunks_iter(Axis(0), 2).into_par_iter();
        let outs = solved.axis_chunks_iter_mut(Axis(0), 2).into_par_iter();
        outs.zip(pairs).try_for_each_init(
            || self.rooms(),
            |rooms, (mut out, pair)| {
                let both = |sample: usize| {
                    Complex64::new(pair[[0, sample]], if pair.nrows() > 1 { pair[[1, sample]] } else { 0.0 })
                };
                let right: Vec<Complex64> = (0..pair.ncols()).map(both).collect();
                for (sample, value) in self.solve_pair(right, rooms)?.into_iter().enumerate() {
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

    /// Conjugate gradients on two right sides at once, each with steps of its own.
    fn solve_pair(&self, right: Vec<Complex64>, rooms: &mut Rooms) -> Result<Vec<Complex64>> {
        let wanted = dots(&right, &right).map(|square| square * SOLVED * SOLVED);
        let mut x = vec![Complex64::default(); right.len()];
        let mut residual = right;
        let mut preconditioned = x.clone();
        self.precondition(&residual, &mut preconditioned, &mut rooms.single);
        let (mut direction, mut product) = (preconditioned.clone(), x.clone());
        let mut gain = dots(&residual, &direction);
        for _ in 0..MOST_ITERATIONS {
            let left = dots(&residual, &residual);
            if (0..2).all(|i| left[i] <= wanted[i]) {
                return Ok(x);
            }
            self.times_into(&direction, &mut product, &mut rooms.double);
            let curvature = dots(&direction, &product);
            let step = [0, 1].map(|i| if curvature[i] > 0.0 { gain[i] / curvature[i] } else { 0.0 });
            add(&mut x, &direction, step);
            add(&mut residual, &product, step.map(|s| -s));
            self.precondition(&residual, &mut preconditioned, &mut rooms.single);
            let next = dots(&residual, &preconditioned);
            let keep = [0, 1].map(|i| if gain[i] > 0.0 { next[i] / gain[i] } else { 0.0 });
            for (d, p) in direction.iter_mut().zip(&preconditioned) {
                *d = Complex64::new(p.re + keep[0] * d.re, p.im + keep[1] * d.im);
            }
            gain = next;
        }
        Err(Error::Internal(format!("a covariance was not inverted in {MOST_ITERATIONS} iterations")))
    }
}

/// Σ of the products of the real parts, and of the imaginary parts.
fn dots(a: &[Complex64], b: &[Complex64]) -> [f64; 2] {
    a.iter().zip(b).fold([0.0; 2], |[re, im], (a, b)| [re + a.re * b.re, im + a.im * b.im])
}

fn add(to: &mut [Complex64], what: &[Complex64], times: [f64; 2]) {
    for (to, what) in to.iter_mut().zip(what) {
        *to += Complex64::new(times[0] * what.re, times[1] * what.im);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pupil::SegmentWeights;

    /// A ring of glass on 24 × 24 samples, 0.1 m apart: one segment.
    fn lit() -> LitSamples {
        let at = |i: usize| i as f64 - 11.5;
        let glass = |&p: &u32| (3.0..11.0).contains(&at(p as usize % 24).hypot(at(p as usize / 24)));
        let lit: Vec<u32> = (0..576).filter(glass).collect();
        let count = lit.len();
        let weights = SegmentWeights {
            segments: 1,
            offsets: (0..=count as u32).collect(),
            segment: vec![0; count],
            weight: vec![1.0; count],
            energy: count as f64,
            lit,
        };
        LitSamples::of(24, 0.1, &weights).unwrap()
    }

    /// Numbers without a pattern, of unit variance.
    fn noise(count: usize) -> Vec<f64> {
        use rand_distr::Distribution;
        let mut rng = crate::source::stream(5, 0);
        (0..count).map(|_| rand_distr::StandardNormal.sample(&mut rng)).collect()
    }

    #[test]
    fn scatter_shows_its_variance_and_its_length() {
        let (lit, images) = (lit(), 60);
        // Each map is white noise averaged over 3 × 3 samples: variance 1/9, correlation (1 − lag/3) along an axis.
        let residuals = {
            let white = Array2::from_shape_vec((images, 26 * 26), noise(images * 676)).unwrap();
            Array2::from_shape_fn((images, lit.len()), |(image, sample)| {
                let (y, x) = (lit.places[sample] / 24, lit.places[sample] % 24);
                (0..9).map(|k| white[[image, (y + k / 3) * 26 + x + k % 3]]).sum::<f64>() / 9.0
            })
        };
        let covariance = ResidualCovariance::of_scatter(&lit, residuals.view()).unwrap();
        // 60 images of some 40 independent patches: variance to 1/√1200 = 3 %; three of those. Negative eigenvalues that are
        // left out, and the mean that is not, move it by a few per cent.
        assert!((covariance.rms_nm() * 3.0 - 1.0).abs() < 0.1, "{}", covariance.rms_nm());
        let mean = covariance.of_mean(10, 0.0, &lit);
        let mut one = vec![Complex64::default(); lit.len()];
        let middle = lit.len() / 2 + 3;
        one[middle] = 1.0.into();
        let column = mean.times(&one);
        let beside = (0..lit.len()).find(|&s| lit.places[s] == lit.places[middle] + 1).unwrap();
        // The mean of ten: a tenth. Two thirds beside it, less the taper; to the same 10 %.
        assert!((column[middle].re * 90.0 - 1.0).abs() < 0.2, "{}", column[middle].re);
        assert!((column[beside].re / column[middle].re - 2.0 / 3.0).abs() < 0.07);
    }

    #[test]
    fn the_inverse_is_one() {
        let lit = lit();
        let smooth = |image: usize, sample: usize| {
            (lit.xs_m[sample] * (3.0 + image as f64) + image as f64).sin() * 30.0 + lit.ys_m[sample] * image as f64
        };
        let residuals = Array2::from_shape_fn((7, lit.len()), |(image, sample)| smooth(image, sample));
        let covariance = ResidualCovariance::of_scatter(&lit, residuals.view()).unwrap();
        let mean = covariance.of_mean(7, 1.0, &lit);
        let columns = Array2::from_shape_vec((3, lit.len()), noise(3 * lit.len())).unwrap();
        let solved = mean.solve(columns.view()).unwrap();
        for (column, solved) in columns.outer_iter().zip(solved.outer_iter()) {
            let back = mean.times(&solved.iter().map(|&v| v.into()).collect::<Vec<_>>());
            let off: f64 = back.iter().zip(column).map(|(back, v)| (back.re - v).powi(2)).sum();
            // What the iteration stops at, and rounding in the residual that it follows.
            assert!(off.sqrt() < 1.1 * SOLVED * column.dot(&column).sqrt());
        }
    }

    /// An estimate weighs a ripple by C⁻¹: beyond what is seen next to nothing.
    #[test]
    fn ripples_that_are_not_seen_do_not_count() {
        let lit = lit();
        let white = Array2::from_shape_vec((30, lit.len()), noise(30 * lit.len())).unwrap();
        let weight = |seen_to_per_m: f64, f_per_m: f64| {
            let covariance = ResidualCovariance::of_scatter(&lit, white.view()).unwrap().seen_to(seen_to_per_m, 0.1);
            let ripple = |sample: usize| (std::f64::consts::TAU * f_per_m * lit.xs_m[sample]).cos();
            let column = Array2::from_shape_fn((1, lit.len()), |(_, sample)| ripple(sample));
            let mean = covariance.of_mean(30, 1.0, &lit);
            mean.solve(column.view()).unwrap().row(0).dot(&column.row(0))
        };
        // 1.3 nm² of noise and floor against 50² nm². Within, a third: 0.7 of the plane is free here, and at the edges of a pupil
        // of 24 samples its ripples make up some of any other.
        assert!(weight(3.0, 4.2) < 1e-3 * weight(f64::INFINITY, 4.2));
        assert!(weight(3.0, 1.0) > 0.6 * weight(f64::INFINITY, 1.0));
    }

    #[test]
    fn one_image_and_other_samples_are_refused() {
        let lit = lit();
        assert!(ResidualCovariance::of_scatter(&lit, Array2::zeros((1, lit.len())).view()).is_err());
        assert!(ResidualCovariance::of_scatter(&lit, Array2::zeros((5, 3)).view()).is_err());
    }
}

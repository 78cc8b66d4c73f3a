//! Karhunen-Loève modes of a deformable mirror: combinations of its influence functions that are
//! uncorrelated in turbulence, by decreasing variance.
//!
//! Double diagonalisation (E. Gendron's thesis, 1995; as in OOMAO): the eigenvectors of the
//! geometric covariance of the piston-removed influence functions give an orthonormal basis of the
//! mirror's space over the pupil; in this basis, the eigenvectors of the covariance of the
//! projected turbulent wavefront are the modes.
//!
//! The statistics are computed on the grid of the pupil if its sampling suits the mirror, and on a
//! grid of their own otherwise; the modes are then orthonormalised over the pupil as given.

use super::influence::InfluenceFunctions;
use super::linalg::symmetric_eigen;
use super::orthonormal::orthonormalise;
use super::samples::Samples;
use super::smooth::SmoothBasis;
use super::von_karman::VonKarman;
use crate::grid::Grid;
use crate::linear_algebra::times_transposed;
use crate::machine;
use crate::pupil::Pupil;
use crate::{Error, Result};
use cophase_numerics::fft::{Fft, plan_both};
use ndarray::parallel::prelude::*;
use ndarray::{Array2, ArrayView1, ArrayViewMut1, Axis};
use num_complex::Complex64;
use std::sync::Arc;

/// Samples per actuator pitch below which the grid of the pupil is not used. A Gaussian of 15 %
/// coupling has σ = 0.51 pitch, here 1.5 samples: its spectrum is exp(−(π·1.5)²/2) = 1e-5 at the
/// Nyquist frequency.
const ENOUGH_PER_PITCH: f64 = 3.0;

/// Samples per pitch of the grid used instead, if it is within [`USUAL_GRID`]. The functions need
/// 3, the edge of the pupil more: with 3, the span of 66 modes rotates by up to 0.5 degrees and
/// their variances change by 0.3 %.
const GOOD_PER_PITCH: f64 = 6.0;

/// Grids with more samples a side are only as fine as necessary (time and memory are proportional
/// to actuators × samples).
const USUAL_GRID: f64 = 256.0;

/// Largest grid, samples a side: for 170 actuators across.
const LARGEST_GRID: f64 = 512.0;

/// Combinations of influence functions whose RMS over the pupil is below this fraction of the
/// largest are truncated: they are differences of actuators beyond the edge, determined by rounding
/// (in the covariance the limit is 1e-9, six digits above the error of the eigenvalues).
const SMALLEST_RMS: f64 = 3e-5;

/// The first Karhunen-Loève modes of a mirror.
#[derive(Debug, Clone)]
pub struct KarhunenLoeve {
    /// The modes, `kl-00`, `kl-01` …: without piston, orthonormal over the pupil (weight A), by
    /// decreasing variance.
    pub basis: SmoothBasis,
    /// Variance of each mode in turbulence, nm².
    pub variances_nm2: Vec<f64>,
}

/// The first `count` Karhunen-Loève modes of `influence` over `pupil` under `turbulence`.
///
/// # Errors
/// Those of [`Samples::from_pupil`]; [`Error::Value`] where `count` is 0 or exceeds the number of
/// modes of the mirror, or the grid is too wide for the pitch.
pub fn karhunen_loeve(
    influence: &InfluenceFunctions,
    pupil: &Pupil,
    turbulence: &VonKarman,
    count: usize,
) -> Result<KarhunenLoeve> {
    modes(influence, pupil, turbulence, ModeCount::Exactly(count))
}

/// The first `most` modes, or all that the mirror has and the samples of the pupil resolve, if
/// those are fewer.
///
/// # Errors
/// Those of [`Samples::from_pupil`]; [`Error::Value`] for a grid that is too wide for the pitch.
pub fn karhunen_loeve_at_most(
    influence: &InfluenceFunctions,
    pupil: &Pupil,
    turbulence: &VonKarman,
    most: usize,
) -> Result<KarhunenLoeve> {
    modes(influence, pupil, turbulence, ModeCount::AtMost(most.max(1)))
}

/// All Karhunen-Loève modes of `influence`.
///
/// # Errors
/// Those of [`karhunen_loeve`].
pub fn karhunen_loeve_complete(
    influence: &InfluenceFunctions,
    pupil: &Pupil,
    turbulence: &VonKarman,
) -> Result<KarhunenLoeve> {
    modes(influence, pupil, turbulence, ModeCount::All)
}

/// Requested number of modes.
#[derive(Debug, Clone, Copy)]
enum ModeCount {
    Exactly(usize),
    AtMost(usize),
    All,
}

fn modes(
    influence: &InfluenceFunctions,
    pupil: &Pupil,
    turbulence: &VonKarman,
    count_wanted: ModeCount,
) -> Result<KarhunenLoeve> {
    let working = working_pupil(pupil, influence.mirror().pitch_m())?;
    let samples = Samples::from_pupil(&working)?;
    check_memory(influence.len(), samples.weights.len())?;
    let mut values = influence.evaluate(&samples.xs_m, &samples.ys_m)?;
    let weights = ndarray::aview1(&samples.weights);
    let mean = values.dot(&weights);
    values -= &mean.view().insert_axis(Axis(1));
    let weighted = &values * &weights;

    let orthonormal = geometric_modes(&times_transposed(weighted.view(), values.view()))?;
    let available = orthonormal.ncols();
    let count = match count_wanted {
        ModeCount::Exactly(count) => count,
        ModeCount::AtMost(most) => most.min(available),
        ModeCount::All => available,
    };
    if count == 0 || count > available {
        let text = format!("{count} Karhunen-Loève modes were requested: this mirror has 1 to {available}");
        return Err(Error::Value(text));
    }
    let statistical = statistical_covariance(&weighted, &samples, &working.grid, turbulence);
    let (variances, vectors) = symmetric_eigen(&orthonormal.t().dot(&statistical).dot(&orthonormal))?;
    let strongest: Vec<usize> = (0..available).rev().take(count).collect();
    let mut combination = orthonormal.dot(&vectors.select(Axis(1), &strongest)).reversed_axes();
    combination.rows_mut().into_iter().for_each(fix_sign);

    let width = (count - 1).to_string().len().max(2);
    let names = (0..count).map(|mode| format!("kl-{mode:0width$}")).collect();
    let raw = SmoothBasis::influence(influence.clone()).combined(names, &combination, &mean);
    let modes = orthonormalise(&raw, pupil, 1e-3)?;
    let lost = |name: &String| modes.dropped.iter().any(|dropped| dropped.name == *name);
    if let (Some(lost), ModeCount::Exactly(_) | ModeCount::All) = (modes.dropped.first(), count_wanted) {
        let text = format!(
            "the samples of the pupil are too few to separate {} from the modes before it: request fewer modes",
            lost.name
        );
        return Err(Error::Value(text));
    }
    let kept = strongest.iter().zip(raw.names()).filter(|(_, name)| !lost(name));
    let variances_nm2 = kept.map(|(&mode, _)| variances[mode]).collect();
    Ok(KarhunenLoeve { basis: modes.basis, variances_nm2 })
}

/// Refuses modes of `actuators` influence functions at `samples` samples that the machine cannot
/// hold, in numbers of 8 bytes: the functions, these with their weights, and their convolution with
/// the turbulence, three times actuators × samples; covariances, eigenvectors and combinations,
/// eight times actuators². Measured with 1,500 actuators at 43,000 samples: 1.2 GB of 1.7.
///
/// # Errors
/// [`Error::Value`].
fn check_memory(actuators: usize, samples: usize) -> Result<()> {
    let (actuators, samples) = (actuators as u64, samples as u64);
    machine::check_memory(
        format_args!("the Karhunen-Loève modes of {actuators} actuators at {samples} samples"),
        8 * actuators * (3 * samples + 8 * actuators),
        "set a larger mirror.pitch_m, or fewer mirror.actuators_across",
    )
}

/// Makes the largest component of a mode positive: the sign of an eigenvector is arbitrary.
fn fix_sign(mut mode: ArrayViewMut1<f64>) {
    let strongest = mode.iter().fold(0f64, |best, &value| if value.abs() > best.abs() { value } else { best });
    if strongest < 0.0 {
        mode.mapv_inplace(|value| -value);
    }
}

/// Columns that combine the influence functions into functions orthonormal over the pupil.
fn geometric_modes(covariance: &Array2<f64>) -> Result<Array2<f64>> {
    let (eigenvalues, vectors) = symmetric_eigen(covariance)?;
    let largest = eigenvalues.last().copied().unwrap_or(0.0);
    let smallest = largest * SMALLEST_RMS.powi(2);
    let kept: Vec<usize> = (0..eigenvalues.len()).filter(|&i| eigenvalues[i] > smallest).collect();
    let mut combination = vectors.select(Axis(1), &kept);
    for (mut column, &i) in combination.columns_mut().into_iter().zip(&kept) {
        column /= eigenvalues[i].sqrt();
    }
    Ok(combination)
}

/// The pupil on a grid that suits the mirror: the pupil itself, or its amplitude averaged over the
/// cells of another grid.
fn working_pupil(pupil: &Pupil, pitch_m: f64) -> Result<Pupil> {
    // Checks the shape of the amplitude before it is indexed.
    Samples::from_pupil(pupil)?;
    let width_m = pupil.grid.width_m();
    let enough = ENOUGH_PER_PITCH * width_m / pitch_m;
    if enough > LARGEST_GRID {
        let text = format!(
            "a pitch of {pitch_m} m on a grid of {width_m} m needs {enough:.0} working samples: {LARGEST_GRID} are accepted"
        );
        return Err(Error::Value(text));
    }
    let good = (GOOD_PER_PITCH * width_m / pitch_m).min(USUAL_GRID.max(enough));
    // Up to a third finer than necessary, the grid of the pupil is used.
    if (enough..=good * 4.0 / 3.0).contains(&(pupil.grid.samples() as f64)) {
        return Ok(pupil.clone());
    }
    // An even size, so that twice the size has small prime factors more often.
    let size = (good.ceil() as usize).next_multiple_of(2);
    let from = pupil.grid.samples();
    // Fraction of each cell that each sample of the pupil covers: rows sum to 1.
    let share = Array2::from_shape_fn((size, from), |(cell, sample)| {
        let (scale, cell, sample) = (from as f64 / size as f64, cell as f64, sample as f64);
        let overlap = ((cell + 1.0) * scale).min(sample + 1.0) - (cell * scale).max(sample);
        overlap.max(0.0) / scale
    });
    let amplitude = share.dot(&pupil.amplitude).dot(&share.t());
    let owner = Array2::from_elem((size, size), -1);
    Ok(Pupil { grid: Grid::new(size, width_m)?, amplitude, owner, segments: vec![] })
}

/// Covariance of the turbulent wavefront's projections on functions: Σ_pq f_p w_p B(p − q) w_q g_q
/// for all pairs, nm². `weighted` is `[functions, samples]` and already holds the weights; each
/// function has zero mean.
///
/// B is replaced by −D/2. They differ by a constant, whose projection on functions without piston
/// is zero, and D is finite and small where B(0) is large or, for Kolmogorov turbulence, infinite.
fn statistical_covariance(
    weighted: &Array2<f64>,
    samples: &Samples,
    grid: &Grid,
    turbulence: &VonKarman,
) -> Array2<f64> {
    let convolution = Convolution::new(samples, grid, turbulence);
    let mut spread = Array2::zeros(weighted.dim());
    // Two real functions in one complex transform.
    let pairs = spread.axis_chunks_iter_mut(Axis(0), 2).into_par_iter();
    pairs.zip(weighted.axis_chunks_iter(Axis(0), 2)).for_each_init(
        || convolution.field(),
        |field, (mut spread, functions)| {
            let last = functions.nrows() - 1;
            convolution.apply(field, functions.row(0), functions.row(last));
            for (point, &place) in convolution.places.iter().enumerate() {
                spread[[last, point]] = field[place].im;
                spread[[0, point]] = field[place].re;
            }
        },
    );
    let covariance = times_transposed(weighted.view(), spread.view());
    (&covariance + &covariance.t()) * 0.5
}

/// Convolution with −D/2 over the samples of a grid, by transforms of twice its size.
struct Convolution {
    /// Index of each sample in the padded square.
    places: Vec<usize>,
    /// Transform of the kernel over the padded square, times the scale of the transforms.
    kernel: Vec<f64>,
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
}

impl Convolution {
    fn new(samples: &Samples, grid: &Grid, turbulence: &VonKarman) -> Self {
        let (size, padded) = (grid.samples(), 2 * grid.samples());
        let (forward, inverse) = plan_both(padded);
        let offset_m = |i: usize| i.min(padded - i) as f64 * grid.pitch_m();
        let kernel = |i: usize| -0.5 * turbulence.structure_nm2(offset_m(i / padded).hypot(offset_m(i % padded)));
        let mut field: Vec<Complex64> = (0..padded * padded).map(|i| kernel(i).into()).collect();
        transform(&*forward, &mut field);
        let scale = 1.0 / (padded * padded) as f64;
        Self {
            places: samples.indices.iter().map(|i| i / size * padded + i % size).collect(),
            // The kernel is even, so its transform is real.
            kernel: field.iter().map(|value| value.re * scale).collect(),
            forward,
            inverse,
        }
    }

    /// The padded square of a function.
    fn field(&self) -> Vec<Complex64> {
        vec![Complex64::default(); self.kernel.len()]
    }

    /// Convolves two real functions, as real and imaginary part of one complex function, in
    /// `field`.
    fn apply(&self, field: &mut [Complex64], real: ArrayView1<f64>, imaginary: ArrayView1<f64>) {
        field.fill(Complex64::default());
        for ((&place, &re), &im) in self.places.iter().zip(real).zip(imaginary) {
            field[place] = Complex64::new(re, im);
        }
        transform(&*self.forward, field);
        field.iter_mut().zip(&self.kernel).for_each(|(value, kernel)| *value *= kernel);
        transform(&*self.inverse, field);
    }
}

/// Transforms a square along both axes: rows, transpose, rows, transpose.
fn transform(fft: &dyn Fft<f64>, field: &mut [Complex64]) {
    let size = fft.len();
    for _ in 0..2 {
        fft.process(field);
        for row in 1..size {
            for column in 0..row {
                field.swap(row * size + column, column * size + row);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array1;

    #[test]
    fn the_transforms_give_the_double_sum() {
        // An odd number of uneven functions on an uneven pupil, against the definition.
        let grid = Grid::new(6, 3.0).unwrap();
        let amplitude = Array2::from_shape_fn((6, 6), |(y, x)| if x + 2 * y > 4 { 0.5 + 0.1 * x as f64 } else { 0.0 });
        let owner = Array2::from_elem((6, 6), 0);
        let samples = Samples::from_pupil(&Pupil { grid, amplitude, owner, segments: vec![] }).unwrap();
        let weights = Array1::from(samples.weights.clone());
        let turbulence = VonKarman::new(0.2, 20.0).unwrap();
        let mut functions = Array2::from_shape_fn((3, weights.len()), |(k, p)| {
            (samples.xs_m[p] * (k + 1) as f64 + samples.ys_m[p].powi(2)).sin()
        });
        for mut function in functions.rows_mut() {
            function -= function.dot(&weights);
        }
        functions *= &weights;
        let fast = statistical_covariance(&functions, &samples, &grid, &turbulence);
        for ((i, j), &value) in fast.indexed_iter() {
            let (mut slow, mut size) = (0.0, 0.0);
            for p in 0..weights.len() {
                for q in 0..weights.len() {
                    let r_m = (samples.xs_m[p] - samples.xs_m[q]).hypot(samples.ys_m[p] - samples.ys_m[q]);
                    // The definition, with B itself: the result must be the same as with −D/2.
                    let term = functions[[i, p]] * functions[[j, q]] * turbulence.covariance_nm2(r_m);
                    slow += term;
                    size += term.abs();
                }
            }
            // A thousand terms summed in another order, relative to their sizes: 1e-16 · √1000 and
            // a margin of ten.
            assert!((value - slow).abs() < 5e-14 * size, "[{i}, {j}]: {value} against {slow}");
        }
    }

    #[test]
    fn working_pupil_keeps_the_area_at_any_sampling() {
        for (n, size) in [(7, 120), (59, 120), (61, 61), (160, 160), (161, 120)] {
            let grid = Grid::new(n, 10.0).unwrap();
            let amplitude = Array2::from_shape_fn((n, n), |(y, x)| ((3 * x + 5 * y) % 7) as f64 / 6.0);
            let mean = amplitude.mean().unwrap();
            let owner = Array2::from_elem((n, n), 0);
            let working = working_pupil(&Pupil { grid, amplitude, owner, segments: vec![] }, 0.5).unwrap();
            assert_eq!(working.grid.samples(), size);
            // Means of some 1e4 cells, each of a few products: rounding only.
            assert!((working.amplitude.mean().unwrap() / mean - 1.0).abs() < 1e-13);
        }
    }
}

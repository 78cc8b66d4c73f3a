//! Whole wavelengths of segment pistons, from channels of several wavelengths.
//!
//! Channel i sees the piston of a segment modulo its wavelength λ_i: its estimate is ĉ_i + λ_i k_i with unknown integers k_i. With the
//! information Λ_i of each channel and the modes c common to all, the integers are those of the smallest
//!
//! ```text
//! χ²(k) = min over c of Σ_i (ĉ_i + λ_i k_i − c)ᵀ Λ_i (ĉ_i + λ_i k_i − c)
//! ```
//!
//! so that segments are tied to each other by what they share with the NCPA. For each integer of the first channel those of the others
//! are the nearest. Pistons p_s about their mean are taken to be normal with a standard deviation τ that is not known: with a prior 1/τ
//! its integral is proportional to (Σ p_s²)^(−n/2), n being one less than the number of segments, and
//!
//! ```text
//! −2 ln P(k) = χ²(k) + n ln Σ p_s² + const.,   |p_s| within modes.piston_range_nm
//! ```
//!
//! The probability of an integer is its mean conditional probability over a Gibbs sampler of all segments (Geman & Geman 1984); the
//! integers that are returned are the most probable that it met.

use ndarray::{Array1, Array2, ArrayView2, s};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;
use std::collections::BTreeMap;

/// Wavelengths that differ by less than this fraction do not determine integers: their synthetic wavelength is above 100 wavelengths.
const LEAST_DIFFERENCE: f64 = 0.01;
/// Sweeps of the sampler over all segments that are left out, while it leaves its start,
const SKIPPED_SWEEPS: usize = 100;
/// and that are averaged: a probability is known to some 5 % of its distance from 0 or 1, being a mean of conditional ones.
const SAMPLED_SWEEPS: usize = 400;
/// Seed of the sampler: the same images give the same probabilities.
const SEED: u64 = 1;

/// The whole wavelengths that were found for the piston of a segment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PistonInteger {
    /// Wavelengths of the first channel that were added to what it sees.
    pub integer: i64,
    /// Probability of this integer, among those of pistons within `modes.piston_range_nm`.
    pub probability: f64,
    /// Piston of the second most probable integer, relative to that of this one, nm.
    pub runner_up_nm: f64,
}

impl PistonInteger {
    /// This integer, found after `before` was added already.
    pub(super) fn following(self, before: &Self) -> Self {
        Self { integer: self.integer + before.integer, ..self }
    }
}

/// One channel, for the search.
pub(super) struct ColourChannel<'a> {
    pub(super) wavelength_nm: f64,
    /// Pistons are the first.
    pub(super) coefficients_nm: &'a mut Array1<f64>,
    /// Λ, per nm².
    pub(super) information: &'a Array2<f64>,
}

/// Whether the channels have wavelengths that differ enough to determine integers.
pub(super) fn are_determined(wavelengths_nm: &[f64]) -> bool {
    let extreme = |choose: fn(f64, f64) -> f64| wavelengths_nm.iter().copied().reduce(choose).unwrap_or(1.0);
    extreme(f64::max) / extreme(f64::min) > 1.0 + LEAST_DIFFERENCE
}

/// Finds the integers of the first `pistons` modes, adds them to the coefficients of each channel, and returns them with their
/// probabilities. `covariance_nm2` is that of the modes, ΣΛ inverted, and `range_nm` the largest piston.
pub(super) fn resolve(
    channels: &mut [ColourChannel],
    covariance_nm2: &Array2<f64>,
    pistons: usize,
    range_nm: f64,
) -> Vec<PistonInteger> {
    // Of one piston nothing is seen.
    if pistons < 2 {
        return Vec::new();
    }
    let mut search = Search::new(channels, covariance_nm2, pistons, range_nm);
    search.begin();
    let (chosen, probabilities) = search.sample();
    for (channel, number) in channels.iter_mut().zip(0..) {
        for (segment, shifts) in chosen.iter().enumerate() {
            channel.coefficients_nm[segment] += shifts[number] as f64 * channel.wavelength_nm;
        }
    }
    let wavelength_nm = channels[0].wavelength_nm;
    let each = chosen.iter().zip(probabilities).map(|(integers, found)| {
        let integer = integers[0];
        let others = found.iter().filter(|(k, _)| **k != integer);
        let runner_up = others.max_by(|a, b| a.1.total_cmp(b.1)).map_or(f64::NAN, |(k, _)| (k - integer) as f64);
        let probability = found.get(&integer).copied().unwrap_or(0.0);
        PistonInteger { integer, probability, runner_up_nm: runner_up * wavelength_nm }
    });
    each.collect()
}

/// Prior of the piston of one segment, given those of the n others.
struct PistonPrior {
    /// n.
    count: f64,
    mean_nm: f64,
    /// Sum of the squares of the others about their mean.
    square_nm2: f64,
}

impl PistonPrior {
    /// n ln Σ p² of all n + 1 pistons about their mean, which is the sum of the others plus n/(n + 1) times the square of the
    /// distance of this one from their mean.
    fn cost(&self, piston_nm: f64) -> f64 {
        let share = self.count / (self.count + 1.0);
        self.count * (self.square_nm2 + share * (piston_nm - self.mean_nm).powi(2)).ln()
    }
}

/// Integers of all segments, and the derivatives of χ² there.
struct Search {
    wavelengths_nm: Vec<f64>,
    /// Pistons as the channels see them, `[channel, segment]`, nm.
    seen_nm: Array2<f64>,
    /// Integers of each segment, one for each channel.
    shifts: Vec<Vec<i64>>,
    /// Half the gradient of χ² with respect to the pistons of each channel, `[channel, segment]`, per nm.
    gradient: Array2<f64>,
    /// Half the second derivatives: `[channel][other channel][segment, other segment]`, per nm².
    curvature: Vec<Vec<Array2<f64>>>,
    reference: usize,
    range_nm: f64,
}

impl Search {
    fn new(channels: &[ColourChannel], covariance_nm2: &Array2<f64>, pistons: usize, range_nm: f64) -> Self {
        let modes = covariance_nm2.nrows();
        let along = channels.iter().fold(Array1::zeros(modes), |sum: Array1<f64>, channel| {
            sum + channel.information.dot(&*channel.coefficients_nm)
        });
        let common_nm = covariance_nm2.dot(&along);
        let mut gradient = Array2::zeros((channels.len(), pistons));
        let mut seen_nm = Array2::zeros((channels.len(), pistons));
        for (number, channel) in channels.iter().enumerate() {
            let slope = channel.information.dot(&(&*channel.coefficients_nm - &common_nm));
            gradient.row_mut(number).assign(&slope.slice(s![..pistons]));
            seen_nm.row_mut(number).assign(&channel.coefficients_nm.slice(s![..pistons]));
        }
        let block = |matrix: ArrayView2<f64>| matrix.slice(s![..pistons, ..pistons]).to_owned();
        let curvature = (0..channels.len()).map(|i| {
            let row = channels[i].information.dot(covariance_nm2);
            let pair = |j: usize| {
                let coupled = -block(row.dot(channels[j].information).view());
                if i == j { coupled + block(channels[i].information.view()) } else { coupled }
            };
            (0..channels.len()).map(pair).collect()
        });
        let curvature: Vec<Vec<Array2<f64>>> = curvature.collect();
        // The segment that the images determine best.
        let stiffness = |segment: &usize| (0..channels.len()).map(|i| curvature[i][i][[*segment; 2]]).sum::<f64>();
        let reference = (0..pistons).max_by(|a, b| stiffness(a).total_cmp(&stiffness(b))).unwrap_or(0);
        let wavelengths_nm = channels.iter().map(|channel| channel.wavelength_nm).collect();
        let shifts = vec![vec![0; channels.len()]; pistons];
        Self { wavelengths_nm, seen_nm, shifts, gradient, curvature, reference, range_nm }
    }

    /// Piston of a segment by a channel, with its integer.
    fn piston_nm(&self, channel: usize, segment: usize) -> f64 {
        self.seen_nm[[channel, segment]] + self.shifts[segment][channel] as f64 * self.wavelengths_nm[channel]
    }

    /// Mean over some segments of the piston by a channel, less that by the first.
    fn offset_nm(&self, channel: usize, segments: &[usize]) -> f64 {
        let each = segments.iter().map(|&segment| self.piston_nm(channel, segment) - self.piston_nm(0, segment));
        each.sum::<f64>() / segments.len().max(1) as f64
    }

    /// The integers of a segment, one for each channel, for which it is within the range about the mean of `others`.
    fn candidates(&self, segment: usize, others: &[usize]) -> Vec<Vec<i64>> {
        let mean_nm = others.iter().map(|&other| self.piston_nm(0, other)).sum::<f64>() / others.len().max(1) as f64;
        let offsets_nm: Vec<f64> = (0..self.wavelengths_nm.len()).map(|i| self.offset_nm(i, others)).collect();
        let (seen_nm, first_nm) = (self.seen_nm[[0, segment]], self.wavelengths_nm[0]);
        let integer = |piston_nm: f64| (piston_nm - seen_nm) / first_nm;
        let (low, high) =
            (integer(mean_nm - self.range_nm).ceil() as i64, integer(mean_nm + self.range_nm).floor() as i64);
        let nearest = |piston_nm: f64, i: usize| {
            ((piston_nm + offsets_nm[i] - self.seen_nm[[i, segment]]) / self.wavelengths_nm[i]).round() as i64
        };
        let each = (low..=high).map(|k| {
            let piston_nm = seen_nm + k as f64 * first_nm;
            (0..self.wavelengths_nm.len()).map(|i| if i == 0 { k } else { nearest(piston_nm, i) }).collect()
        });
        each.collect()
    }

    fn prior(&self, others: &[usize]) -> PistonPrior {
        let count = others.len() as f64;
        let mean_nm = others.iter().map(|&other| self.piston_nm(0, other)).sum::<f64>() / count;
        let square_nm2 = others.iter().map(|&other| (self.piston_nm(0, other) - mean_nm).powi(2)).sum();
        PistonPrior { count, mean_nm, square_nm2 }
    }

    fn all_but(&self, segment: usize) -> Vec<usize> {
        (0..self.shifts.len()).filter(|other| *other != segment).collect()
    }

    /// Change of χ² where a segment gets these integers.
    fn change(&self, segment: usize, integers: &[i64]) -> f64 {
        let moved_nm = self.moved_nm(segment, integers);
        let mut change = 0.0;
        for (i, a) in moved_nm.iter().enumerate() {
            let curved: f64 = moved_nm.iter().enumerate().map(|(j, b)| b * self.curvature[i][j][[segment; 2]]).sum();
            change += a * (2.0 * self.gradient[[i, segment]] + curved);
        }
        change
    }

    fn moved_nm(&self, segment: usize, integers: &[i64]) -> Vec<f64> {
        let own = integers.iter().zip(&self.shifts[segment]).zip(&self.wavelengths_nm);
        own.map(|((new, old), wavelength_nm)| (new - old) as f64 * wavelength_nm).collect()
    }

    fn set(&mut self, segment: usize, integers: &[i64]) {
        let moved_nm = self.moved_nm(segment, integers);
        for (i, mut gradient) in self.gradient.outer_iter_mut().enumerate() {
            for (j, nm) in moved_nm.iter().enumerate() {
                gradient.scaled_add(*nm, &self.curvature[i][j].column(segment));
            }
        }
        self.shifts[segment].copy_from_slice(integers);
    }

    /// Integers of each segment for which the channels agree best about one of them.
    fn begin(&mut self) {
        let reference = [self.reference];
        for segment in self.all_but(self.reference) {
            let offsets_nm: Vec<f64> = (0..self.wavelengths_nm.len()).map(|i| self.offset_nm(i, &reference)).collect();
            let miss = |integers: &Vec<i64>| -> f64 {
                let piston_nm =
                    |i: usize| self.seen_nm[[i, segment]] + integers[i] as f64 * self.wavelengths_nm[i] - offsets_nm[i];
                (1..integers.len()).map(|i| (piston_nm(i) - piston_nm(0)).powi(2)).sum()
            };
            let best = self.candidates(segment, &reference).into_iter().min_by(|a, b| miss(a).total_cmp(&miss(b)));
            if let Some(best) = best {
                self.set(segment, &best);
            }
        }
    }

    /// The most probable integers of each segment, and the probabilities of those of the first channel.
    fn sample(&mut self) -> (Vec<Vec<i64>>, Vec<BTreeMap<i64, f64>>) {
        let mut rng = ChaCha12Rng::seed_from_u64(SEED);
        let mut sums: Vec<BTreeMap<i64, f64>> = vec![BTreeMap::new(); self.shifts.len()];
        let (mut cost, mut lowest, mut best) = (0.0, 0.0, self.shifts.clone());
        for sweep in 0..SKIPPED_SWEEPS + SAMPLED_SWEEPS {
            for (segment, sum) in sums.iter_mut().enumerate() {
                let others = self.all_but(segment);
                let (candidates, prior) = (self.candidates(segment, &others), self.prior(&others));
                let now = prior.cost(self.piston_nm(0, segment));
                let moved_nm = |k: i64| self.seen_nm[[0, segment]] + k as f64 * self.wavelengths_nm[0];
                let rise = |one: &Vec<i64>| self.change(segment, one) + prior.cost(moved_nm(one[0])) - now;
                let rises: Vec<f64> = candidates.iter().map(rise).collect();
                let least = rises.iter().copied().fold(f64::INFINITY, f64::min);
                let weights: Vec<f64> = rises.iter().map(|rise| (-0.5 * (rise - least)).exp()).collect();
                let total: f64 = weights.iter().sum();
                if sweep >= SKIPPED_SWEEPS {
                    for (integers, weight) in candidates.iter().zip(&weights) {
                        *sum.entry(integers[0]).or_default() += weight / total / SAMPLED_SWEEPS as f64;
                    }
                }
                let mut draw = rng.random::<f64>() * total;
                let chosen = weights.iter().position(|weight| {
                    draw -= weight;
                    draw <= 0.0
                });
                let Some(chosen) = chosen else { continue };
                cost += rises[chosen];
                self.set(segment, &candidates[chosen]);
                if cost < lowest {
                    lowest = cost;
                    best.clone_from(&self.shifts);
                }
            }
        }
        (best, sums)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    const COLOURS_NM: [f64; 2] = [2168.6, 1640.0];
    const SEGMENTS: usize = 12;

    /// Draws of pistons within ±`range_nm`, sought within twice that, seen with `sigma_nm`: right integers, wrong ones, and wrong ones with a probability above 0.99.
    fn draws(range_nm: f64, sigma_nm: f64, count: u64) -> (usize, usize, usize) {
        let (mut right, mut wrong, mut certain) = (0, 0, 0);
        for seed in 1..=count {
            let mut rng = ChaCha12Rng::seed_from_u64(seed);
            let truth: Vec<f64> = (0..SEGMENTS).map(|_| range_nm * (2.0 * rng.random::<f64>() - 1.0)).collect();
            // Of pistons only their differences are seen.
            let information = Array2::from_shape_fn((SEGMENTS, SEGMENTS), |(i, j)| {
                f64::from(u8::from(i == j)) - 1.0 / SEGMENTS as f64
            }) / sigma_nm.powi(2);
            let mut seen = COLOURS_NM.map(|wavelength_nm| {
                let offset: f64 = rng.random::<f64>() * 1000.0;
                Array1::from_iter(truth.iter().map(|nm| {
                    let noise: f64 = StandardNormal.sample(&mut rng);
                    (nm + offset + sigma_nm * noise + 0.5 * wavelength_nm).rem_euclid(wavelength_nm)
                        - 0.5 * wavelength_nm
                }))
            });
            // Two channels of one information: the inverse of their sum, in the space of differences.
            let covariance_nm2 = &information * (sigma_nm.powi(4) / 2.0);
            let [one, two] = &mut seen;
            let mut channels = [(one, COLOURS_NM[0]), (two, COLOURS_NM[1])].map(|(coefficients_nm, wavelength_nm)| {
                ColourChannel { wavelength_nm, coefficients_nm, information: &information }
            });
            let found = resolve(&mut channels, &covariance_nm2, SEGMENTS, 2.0 * range_nm);
            // All pistons may be off by one amount: that of most of them.
            let mut errors_nm: Vec<f64> = seen[0].iter().zip(&truth).map(|(found, truth)| found - truth).collect();
            let off_nm = crate::statistics::median(&errors_nm);
            errors_nm.iter_mut().for_each(|nm| *nm -= off_nm);
            for (error_nm, integer) in errors_nm.iter().zip(&found) {
                let is_right = error_nm.abs() < 0.5 * COLOURS_NM[0];
                right += usize::from(is_right);
                wrong += usize::from(!is_right);
                certain += usize::from(!is_right && integer.probability > 0.99);
            }
        }
        (right, wrong, certain)
    }

    #[test]
    fn precise_pistons_have_their_integers_far_beyond_the_synthetic_wavelength() {
        // Within ±30 µm of each other, 4·1640 and 3·2168.6 nm are the closest, 54 nm apart: 11 standard deviations of 3·√2 nm.
        assert_eq!(draws(15_000.0, 3.0, 20), (20 * SEGMENTS, 0, 0));
        // Within ±3 µm about the mean nothing is closer than 529 nm: its half is 4.7 standard deviations of 40·√2 nm.
        assert_eq!(draws(1_500.0, 40.0, 20), (20 * SEGMENTS, 0, 0));
    }

    #[test]
    fn integers_that_noise_makes_ambiguous_are_not_claimed() {
        // 54 nm are 1.9 standard deviations of 20·√2 nm: a tenth of the segments are wrong, and of those that are claimed with 0.99 at most
        // 1 % may be.
        let (right, wrong, certain) = draws(15_000.0, 20.0, 40);
        assert!(wrong > right / 50 && wrong < right, "{right} {wrong}");
        assert!(certain * 100 <= right + wrong, "{certain} of {}", right + wrong);
    }
}

//! Gibbs sampler of the integers: of each segment alone, and of groups of segments.
//!
//! 4·1640 and 3·2168.6 nm differ by 54 nm. A segment that is off by this pair of integers shows it;
//! a group of neighbours shows little of it, because the NCPA and the tilts of the channels take up
//! what is smooth, and no segment of it can go back alone. Such groups are short vectors of the
//! lattice of integers in the metric of χ²: a reduced basis of it has them (as in the integer least
//! squares of satellite navigation, Teunissen 1995, J. Geodesy 70, 65). The sampler starts near the
//! minimum of χ² over all integers, which the basis gives, and draws multiples of its vectors.

use crate::modal::combine::integers::lattice::IntegerLattice;
use ndarray::{Array1, Array2, ArrayView2, s};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha12Rng;
use std::collections::BTreeMap;

/// Sweeps of the sampler over all segments that are left out, while it leaves its start,
const SKIPPED_SWEEPS: usize = 100;
/// and that are averaged: a probability is known to some 5 % of its distance from 0 or 1, being a
/// mean of conditional ones.
const SAMPLED_SWEEPS: usize = 400;
/// Largest multiple of a joint move that is drawn at once; larger ones take several sweeps.
const MULTIPLES: i64 = 2;
/// Seed of the sampler: the same images give the same probabilities.
const SEED: u64 = 1;

/// One channel, for the search.
pub(in crate::modal) struct ColourChannel<'a> {
    pub(in crate::modal) wavelength_nm: f64,
    /// Pistons are the first.
    pub(in crate::modal) coefficients_nm: &'a mut Array1<f64>,
    /// Λ, per nm².
    pub(in crate::modal) information: &'a Array2<f64>,
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
    /// n ln Σ p² of all n + 1 pistons about their mean, which is the sum of the others plus
    /// n/(n + 1) times the square of the distance of this one from their mean.
    fn cost(&self, piston_nm: f64) -> f64 {
        let share = self.count / (self.count + 1.0);
        self.count * (self.square_nm2 + share * (piston_nm - self.mean_nm).powi(2)).ln()
    }
}

/// Integers of all segments, and the derivatives of χ² there.
pub(super) struct IntegerSearch {
    wavelengths_nm: Vec<f64>,
    /// Pistons as the channels see them, `[channel, segment]`, nm.
    seen_nm: Array2<f64>,
    /// Integers of each segment, one for each channel.
    shifts: Vec<Vec<i64>>,
    /// Half the gradient of χ² with respect to the pistons of each channel, `[channel, segment]`,
    /// per nm.
    gradient: Array2<f64>,
    /// Half the second derivatives: `[channel][other channel][segment, other segment]`, per nm².
    curvature: Vec<Vec<Array2<f64>>>,
    reference: usize,
    range_nm: f64,
}

impl IntegerSearch {
    pub(super) fn new(channels: &[ColourChannel], covariance_nm2: &Array2<f64>, pistons: usize, range_nm: f64) -> Self {
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

    /// The integers of a segment, one for each channel, for which it is within the range about the
    /// mean of `others`.
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

    /// −2 ln of the prior of all pistons, up to a constant: n ln Σ p² about their mean within the
    /// range, infinite beyond it.
    fn prior_cost(&self, pistons_nm: impl Iterator<Item = f64> + Clone) -> f64 {
        let count = self.shifts.len() as f64;
        let mean_nm = pistons_nm.clone().sum::<f64>() / count;
        let (mut square_nm2, mut is_within) = (0.0, true);
        for piston_nm in pistons_nm {
            square_nm2 += (piston_nm - mean_nm).powi(2);
            is_within &= (piston_nm - mean_nm).abs() <= self.range_nm;
        }
        if is_within { (count - 1.0) * square_nm2.ln() } else { f64::INFINITY }
    }

    /// Channels and segments whose integers are free. Pistons of all are not seen: one segment
    /// stays.
    fn free(&self) -> Vec<(usize, usize)> {
        let segments = self.all_but(self.reference);
        (0..self.wavelengths_nm.len()).flat_map(|i| segments.iter().map(move |segment| (i, *segment))).collect()
    }

    /// Moves to integers near the minimum of χ² and a normal prior of the pistons, and returns
    /// moves of several segments at once that change it little: the reduced basis of the integers
    /// in its metric.
    pub(super) fn begin(&mut self) -> Vec<JointMove> {
        let free = self.free();
        let spread = self.range_nm.powi(-2);
        let gram = Array2::from_shape_fn((free.len(), free.len()), |(a, b)| {
            let ((i, segment), (j, other)) = (free[a], free[b]);
            let curvature = self.curvature[i][j][[segment, other]] + if a == b { spread } else { 0.0 };
            self.wavelengths_nm[i] * self.wavelengths_nm[j] * curvature
        });
        let slope = |at: &(usize, usize)| self.wavelengths_nm[at.0] * (self.gradient[*at] + spread * self.seen_nm[*at]);
        let gradient: Vec<f64> = free.iter().map(slope).collect();
        let lattice = IntegerLattice::new(gram);
        let start = self.joint_move(&free, &lattice.near_minimum(&gradient));
        self.shift(&start, 1);
        lattice.basis.iter().map(|vector| self.joint_move(&free, vector)).collect()
    }

    /// The move by `vector` of the integers `free`.
    fn joint_move(&self, free: &[(usize, usize)], vector: &[i64]) -> JointMove {
        let mut steps = Array2::zeros(self.seen_nm.dim());
        for (at, step) in free.iter().zip(vector) {
            steps[*at] = *step;
        }
        let moved_nm = |i: usize| steps.row(i).mapv(|step: i64| step as f64 * self.wavelengths_nm[i]);
        let mut slope = Array2::zeros(self.seen_nm.dim());
        for (i, mut row) in slope.outer_iter_mut().enumerate() {
            for j in 0..self.wavelengths_nm.len() {
                row += &self.curvature[i][j].dot(&moved_nm(j));
            }
        }
        let curvature = (0..self.wavelengths_nm.len()).map(|i| moved_nm(i).dot(&slope.row(i))).sum();
        JointMove { steps, slope, curvature }
    }

    fn shift(&mut self, joint: &JointMove, multiple: i64) {
        self.gradient.scaled_add(multiple as f64, &joint.slope);
        for ((channel, segment), step) in joint.steps.indexed_iter() {
            self.shifts[segment][channel] += multiple * step;
        }
    }

    /// Draws a multiple of `joint`, given everything else, and moves by it; the change of χ².
    fn draw_multiple(&mut self, joint: &JointMove, rng: &mut ChaCha12Rng) -> f64 {
        let along: f64 = joint
            .steps
            .indexed_iter()
            .map(|(at, step)| *step as f64 * self.wavelengths_nm[at.0] * self.gradient[at])
            .sum();
        let change = |multiple: i64| {
            let multiple = multiple as f64;
            multiple * (2.0 * along + multiple * joint.curvature)
        };
        let costs: Vec<f64> = (-MULTIPLES..=MULTIPLES)
            .map(|multiple| {
                let moved = |segment: usize| {
                    self.piston_nm(0, segment) + (multiple * joint.steps[[0, segment]]) as f64 * self.wavelengths_nm[0]
                };
                change(multiple) + self.prior_cost((0..self.shifts.len()).map(moved))
            })
            .collect();
        let Some(drawn) = drawn(&costs, rng) else { return 0.0 };
        let multiple = drawn as i64 - MULTIPLES;
        if multiple != 0 {
            self.shift(joint, multiple);
        }
        change(multiple)
    }

    /// The most probable integers of each segment, and the probabilities of those of the first
    /// channel.
    pub(super) fn sample(&mut self, joint_moves: &[JointMove]) -> (Vec<Vec<i64>>, Vec<BTreeMap<i64, f64>>) {
        let mut rng = ChaCha12Rng::seed_from_u64(SEED);
        let mut sums: Vec<BTreeMap<i64, f64>> = vec![BTreeMap::new(); self.shifts.len()];
        let (mut chi2, mut lowest, mut best) = (0.0, f64::INFINITY, self.shifts.clone());
        for sweep in 0..SKIPPED_SWEEPS + SAMPLED_SWEEPS {
            for joint in joint_moves {
                chi2 += self.draw_multiple(joint, &mut rng);
            }
            for (segment, sum) in sums.iter_mut().enumerate() {
                let others = self.all_but(segment);
                let (candidates, prior) = (self.candidates(segment, &others), self.prior(&others));
                let moved_nm = |k: i64| self.seen_nm[[0, segment]] + k as f64 * self.wavelengths_nm[0];
                let cost = |one: &Vec<i64>| self.change(segment, one) + prior.cost(moved_nm(one[0]));
                let costs: Vec<f64> = candidates.iter().map(cost).collect();
                if sweep >= SKIPPED_SWEEPS {
                    for (integers, probability) in candidates.iter().zip(probabilities(&costs)) {
                        *sum.entry(integers[0]).or_default() += probability / SAMPLED_SWEEPS as f64;
                    }
                }
                if let Some(drawn) = drawn(&costs, &mut rng) {
                    chi2 += self.change(segment, &candidates[drawn]);
                    self.set(segment, &candidates[drawn]);
                }
                let pistons_nm = (0..self.shifts.len()).map(|segment| self.piston_nm(0, segment));
                let cost = chi2 + self.prior_cost(pistons_nm);
                if cost < lowest {
                    lowest = cost;
                    best.clone_from(&self.shifts);
                }
            }
        }
        (best, sums)
    }
}

/// A change of the integers of several segments.
pub(super) struct JointMove {
    /// `[channel, segment]`.
    steps: Array2<i64>,
    /// Change of half the gradient of χ², `[channel, segment]`, per nm.
    slope: Array2<f64>,
    /// Half the second derivative of χ² along it.
    curvature: f64,
}

/// Probabilities of states with these −2 ln P, which may be infinite; of none where all are.
fn probabilities(costs: &[f64]) -> Vec<f64> {
    let least = costs.iter().copied().fold(f64::INFINITY, f64::min);
    if !least.is_finite() {
        return vec![0.0; costs.len()];
    }
    let weights: Vec<f64> = costs.iter().map(|cost| (-0.5 * (cost - least)).exp()).collect();
    let total: f64 = weights.iter().sum();
    weights.iter().map(|weight| weight / total).collect()
}

/// A random one of the states with these −2 ln P; `None` where all are infinite.
fn drawn(costs: &[f64], rng: &mut ChaCha12Rng) -> Option<usize> {
    let mut draw = rng.random::<f64>();
    probabilities(costs).iter().position(|probability| {
        draw -= probability;
        draw <= 0.0 && *probability > 0.0
    })
}

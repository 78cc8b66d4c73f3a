//! Ribbon: endless strip of turbulence, drawn row by row, periodic across and without repetition
//! along.

use super::spectrum::{Lattice, POLES, Process};
use crate::Result;
use crate::ao::footprint::LANES;
use cophase_numerics::fft::{Fft, FftDirection, FftReal};
use num_complex::Complex;
use pulp::NullaryFnOnce;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Rows drawn at a time: a cache line of a column; the recursion's coefficients are loaded once for
/// all of them.
pub(super) const BLOCK: usize = 16;

/// Statistics of a ribbon: a [`Process`] along it for each frequency across.
///
/// The field is y(t, j) = Σ_m c_m(t)·exp(2πi·mj/period), so its covariance is that of the lattice's
/// spectrum along, and its periodic repetition across.
pub(super) struct Law {
    period: usize,
    /// Frequencies 0 to period/2, in groups of [`LANES`].
    groups: Vec<Group>,
    /// Cholesky factors of the states' stationary covariance, for each frequency.
    stationary: Vec<[[f32; POLES]; POLES]>,
    fft: Arc<dyn Fft<f32>>,
}

type Lanes = [f32; LANES];

#[derive(Clone, Copy)]
struct Group {
    poles: [Lanes; POLES],
    gains: [Lanes; POLES],
}

impl Law {
    /// Statistics of a ribbon of even width `period`, for an outer scale in samples and a Fried
    /// parameter of one sample.
    pub(super) fn new(period: usize, outer_scale: f64) -> Result<Self> {
        let lattice = Lattice::new(outer_scale)?;
        let processes: Vec<Process> = (0..=period / 2)
            .into_par_iter()
            .map(|m| {
                let mut process = Process::fit(&lattice, TAU * m as f64 / period as f64);
                // The power is divided between m and −m, and between real and imaginary part; the
                // amplitudes at the frequencies 0 and period/2 are real and have no partner.
                let parts = if m == 0 || 2 * m == period { 1.0 } else { 2.0 };
                process.gains = process.gains.map(|gain| gain / (parts * period as f64).sqrt());
                process
            })
            .collect();
        let mut groups =
            vec![Group { poles: [[0.0; LANES]; POLES], gains: [[0.0; LANES]; POLES] }; processes.len().div_ceil(LANES)];
        for (m, process) in processes.iter().enumerate() {
            for i in 0..POLES {
                groups[m / LANES].poles[i][m % LANES] = process.poles[i] as f32;
                groups[m / LANES].gains[i][m % LANES] = process.gains[i] as f32;
            }
        }
        let stationary = processes.iter().map(|process| process.stationary().map(|row| row.map(|x| x as f32)));
        let fft = f32::plan(period, FftDirection::Inverse);
        Ok(Self { period, groups, stationary: stationary.collect(), fft })
    }

    /// Covariance of points `along` rows and `across` positions apart, nm²; exact, from the
    /// coefficients in use.
    #[cfg(test)]
    pub(super) fn covariance_nm2(&self, along: i32, across: usize) -> f64 {
        let one = |m: usize| {
            let group = &self.groups[m / LANES];
            let values = |lanes: &[Lanes; POLES]| lanes.map(|lanes| f64::from(lanes[m % LANES]));
            let process = Process { poles: values(&group.poles), gains: values(&group.gains) };
            // The real and the imaginary part, of m and of −m.
            let parts = if m == 0 || 2 * m == self.period { 1.0 } else { 4.0 };
            parts * process.covariance(along) * (TAU * (m * across % self.period) as f64 / self.period as f64).cos()
        };
        (0..=self.period / 2).map(one).sum()
    }

    /// Samples across.
    pub(super) fn period(&self) -> usize {
        self.period
    }

    /// Values of a plane (real or imaginary part) of one row's spectrum.
    fn plane(&self) -> usize {
        self.groups.len() * LANES
    }
}

/// One realisation of a [`Law`], at its last row.
pub(super) struct Ribbon {
    law: Arc<Law>,
    rng: ChaCha8Rng,
    /// Real and imaginary parts, `[group][part][pole]`.
    states: Vec<[[Lanes; POLES]; 2]>,
    /// White noise, then the spectra of the rows, `[row][part][frequency]`.
    spectra: Vec<f32>,
    /// Two rows, as real and imaginary part.
    pair: Vec<Complex<f32>>,
    scratch: Vec<Complex<f32>>,
}

impl Ribbon {
    pub(super) fn new(law: Arc<Law>, rng: ChaCha8Rng) -> Self {
        let mut ribbon = Self {
            rng,
            states: vec![[[[0.0; LANES]; POLES]; 2]; law.groups.len()],
            spectra: vec![0.0; BLOCK * 2 * law.plane()],
            pair: vec![Complex::ZERO; law.period],
            scratch: vec![Complex::ZERO; law.fft.get_inplace_scratch_len()],
            law,
        };
        ribbon.restart();
        ribbon
    }

    /// Statistics of the ribbon.
    pub(super) fn law(&self) -> &Law {
        &self.law
    }

    /// Starts a new realisation: draws the states from their stationary distribution.
    pub(super) fn restart(&mut self) {
        for (m, factor) in self.law.stationary.iter().enumerate() {
            for part in 0..2 {
                let white: [f32; POLES] = std::array::from_fn(|_| StandardNormal.sample(&mut self.rng));
                for (i, row) in factor.iter().enumerate() {
                    let value = row.iter().zip(white).map(|(l, w)| l * w).sum();
                    self.states[m / LANES][part][i][m % LANES] = value;
                }
            }
        }
    }

    /// Draws the spectra of the next [`BLOCK`] rows; [`Ribbon::rows`] transforms them.
    pub(super) fn extend(&mut self) {
        for plane in self.spectra.chunks_exact_mut(self.law.plane()) {
            for value in &mut plane[..self.law.period / 2 + 1] {
                *value = StandardNormal.sample(&mut self.rng);
            }
        }
        let recursion = Recursion { law: &self.law, states: &mut self.states, spectra: &mut self.spectra };
        pulp::Arch::new().dispatch(recursion);
    }

    /// Transforms rows 2·`pair` and 2·`pair` + 1 of the last block; they are the real and imaginary
    /// parts of one period.
    pub(super) fn rows(&mut self, pair: usize) -> &[Complex<f32>] {
        let (plane, period) = (self.law.plane(), self.law.period);
        let [a_re, a_im, b_re, b_im]: [&[f32]; 4] =
            std::array::from_fn(|i| &self.spectra[(4 * pair + i) * plane..][..period / 2 + 1]);
        // Real rows a and b have spectra with a(−m) = a(m)*. One transform of a + ib gives both
        // rows:
        let (low, high) = self.pair.split_at_mut(period / 2 + 1);
        for (m, value) in low.iter_mut().enumerate() {
            *value = Complex::new(a_re[m] - b_im[m], a_im[m] + b_re[m]);
        }
        for (m, value) in (1..period / 2).zip(high.iter_mut().rev()) {
            *value = Complex::new(a_re[m] + b_im[m], b_re[m] - a_im[m]);
        }
        for m in [0, period / 2] {
            self.pair[m] = Complex::new(a_re[m], b_re[m]);
        }
        self.law.fft.process_with_scratch(&mut self.pair, &mut self.scratch);
        &self.pair
    }
}

/// Kernel: advances all frequencies by [`BLOCK`] rows; a group's states and coefficients stay in
/// registers. Products and sums are not fused, so that the result does not depend on the length of
/// the vectors.
struct Recursion<'a> {
    law: &'a Law,
    states: &'a mut [[[Lanes; POLES]; 2]],
    spectra: &'a mut [f32],
}

impl NullaryFnOnce for Recursion<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let plane = self.law.plane();
        for (index, (group, states)) in self.law.groups.iter().zip(self.states).enumerate() {
            for (part, states) in states.iter_mut().enumerate() {
                let mut state = *states;
                for row in 0..BLOCK {
                    let place = (2 * row + part) * plane + index * LANES;
                    let Some(values) = self.spectra[place..].first_chunk_mut::<LANES>() else { return };
                    let white = *values;
                    let mut sum = [0.0; LANES];
                    for ((state, poles), gains) in state.iter_mut().zip(&group.poles).zip(&group.gains) {
                        for lane in 0..LANES {
                            let drive = gains[lane] * white[lane];
                            state[lane] = poles[lane] * state[lane] + drive;
                            sum[lane] += state[lane];
                        }
                    }
                    *values = sum;
                }
                *states = state;
            }
        }
    }
}

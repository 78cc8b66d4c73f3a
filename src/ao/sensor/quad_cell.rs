//! Diffractive quad cell, in closed form.
//!
//! A lenslet of n samples, padded to 2n, forms a spot `|F_k|²` on a field of n λ/d. The cell's axis
//! lies between the points of the transform, at half-integer k. The difference of the halves needs
//! no transform: with the autocorrelation `R(D) = Σ_x E(x+D)·E*(x)`, summed over the rows,
//!
//! `Σ_k sgn(k)|F_k|² = Σ_D R(D) Σ_k sgn(k) exp(−2πi·kD/2n)`, and the inner sum is `−2i/sin(πD/2n)`
//! for odd D, else 0.
//!
//! With `Σ_k|F_k|² = 2n·R(0)` the signal is `S = Σ_{odd D>0} 2·Im R(D) / (n·sin(πD/2n)) / R(0)`.

use super::lenslets::Lenslets;
use super::light::GuideStar;
use crate::ao::aligned::AlignedBuffer;
use crate::ao::footprint::{Footprint, LANES};
use crate::ao::phase::unit_phasor;
use pulp::{Arch, NullaryFnOnce};
use std::ops::Range;

/// The most samples of a lenslet: a power of two.
const LONGEST: usize = 64;
/// Length of a vector of samples with its partners up to [`LONGEST`] samples to the right.
const WINDOW: usize = LONGEST + LANES;

/// Quad cells of all subapertures.
#[derive(Clone)]
pub(super) struct QuadCell {
    lenslets: Lenslets,
    turns_per_nm: f32,
    footprint: Footprint,
    stride: usize,
    /// Illuminated columns of each row of lenslets, in whole vectors.
    spans: Vec<Range<usize>>,
    /// `2/(n·sin(πD/2n))` for D = 1, 3, 5 …
    weights: Vec<f32>,
    /// The same weights for each column, `[vector of columns][D]`; 0 if x + D lies in another
    /// lenslet.
    masked: AlignedBuffer,
    /// First subaperture of each row of lenslets.
    first: Vec<usize>,
    /// Field of one row of lenslets, `[sample row][x]`, and the x and y differences summed over
    /// each column.
    re: AlignedBuffer,
    im: AlignedBuffer,
    along: [Vec<f32>; 2],
    arch: Arch,
}

impl QuadCell {
    pub(super) fn new(lenslets: &Lenslets, footprint: &Footprint, wavelength_nm: f64) -> Self {
        let (n, across, stride) = (lenslets.samples, lenslets.across, footprint.stride());
        let spans = (0..across)
            .map(|row| {
                let spans = (row * n..(row + 1) * n).map(|y| footprint.span(y)).filter(|span| !span.is_empty());
                let union = spans.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end)).unwrap_or(0..0);
                // Whole lenslets, so that dark samples of an illuminated lenslet are overwritten
                // with 0 in every row.
                let (start, end) = (union.start / n * n, union.end.next_multiple_of(n));
                start / LANES * LANES..end.next_multiple_of(LANES).min(stride)
            })
            .collect();
        let distances: Vec<usize> = (1..n).step_by(2).collect();
        let weight = |d: usize| 2.0 / (n as f64 * (std::f64::consts::PI * d as f64 / (2 * n) as f64).sin());
        let weights: Vec<f32> = distances.iter().map(|&d| weight(d) as f32).collect();
        let mask = |d: usize, w: f32, x: usize| if x < across * n && x % n + d < n { w } else { 0.0 };
        let masked: Vec<f32> = (0..stride)
            .step_by(LANES)
            .flat_map(|at| distances.iter().zip(&weights).map(move |(&d, &w)| (at, d, w)))
            .flat_map(|(at, d, w)| (at..at + LANES).map(move |x| mask(d, w, x)))
            .collect();
        let first = (0..=across).map(|row| lenslets.subapertures.partition_point(|&s| s < row * across)).collect();
        // Windows extend beyond the end of a row; their weights are 0 there.
        let width = stride + WINDOW;
        Self {
            lenslets: lenslets.clone(),
            turns_per_nm: (1.0 / wavelength_nm) as f32,
            footprint: footprint.clone(),
            stride,
            spans,
            weights,
            masked: AlignedBuffer::from(&masked[..]),
            first,
            re: AlignedBuffer::zeros(n * width),
            im: AlignedBuffer::zeros(n * width),
            along: [vec![0.0; stride], vec![0.0; stride]],
            arch: Arch::new(),
        }
    }

    /// Measures the differences between the halves over their sum: x, then y.
    pub(super) fn raw_slopes(&mut self, opd_nm: &[f32], mut light: Option<&mut GuideStar>, slopes: &mut [f32]) {
        let (n, across) = (self.lenslets.samples, self.lenslets.across);
        let count = self.lenslets.subapertures.len();
        let (along_x, along_y) = slopes.split_at_mut(count);
        let full = (n * n) as f64;
        for row in 0..across {
            let used = self.first[row]..self.first[row + 1];
            if used.is_empty() {
                continue;
            }
            self.arch.dispatch(Row { cell: self, opd_nm, row });
            for i in used {
                let start = self.lenslets.subapertures[i] % across * n;
                let energy = (self.lenslets.light[i] * full) as f32;
                let sum = |columns: &[f32]| sum_in_parts(&columns[start..start + n]) / energy;
                let ratios = [sum(&self.along[0]), sum(&self.along[1])];
                let noisy = match light.as_deref_mut() {
                    Some(light) => light
                        .quad_cell(ratios.map(f64::from), light.electrons * self.lenslets.light[i])
                        .map(|r| r as f32),
                    None => ratios,
                };
                (along_x[i], along_y[i]) = (noisy[0], noisy[1]);
            }
        }
    }
}

/// Sum in four independent partial sums, which hides the latency of the additions.
fn sum_in_parts(values: &[f32]) -> f32 {
    let (fours, rest) = values.as_chunks::<4>();
    let mut sums = [0.0f32; 4];
    for four in fours {
        for (sum, value) in sums.iter_mut().zip(four) {
            *sum += value;
        }
    }
    (sums[0] + sums[2]) + (sums[1] + sums[3]) + rest.iter().sum::<f32>()
}

/// Kernel of one row of lenslets: its field, then both differences column by column.
struct Row<'a> {
    cell: &'a mut QuadCell,
    opd_nm: &'a [f32],
    row: usize,
}

impl NullaryFnOnce for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { cell, opd_nm, row } = self;
        let (n, stride) = (cell.lenslets.samples, cell.stride);
        let width = cell.re.len() / n;
        let span = cell.spans[row].clone();
        for y in 0..n {
            let from = (row * n + y) * stride;
            let opd = &opd_nm[from..][span.clone()];
            let amplitude = &cell.footprint.amplitude()[from..][span.clone()];
            let re = &mut cell.re[y * width..][span.clone()];
            let im = &mut cell.im[y * width..][span.clone()];
            for (((re, im), opd), a) in re.iter_mut().zip(im).zip(opd).zip(amplitude) {
                let (cos, sin) = unit_phasor(opd * cell.turns_per_nm);
                (*re, *im) = (a * cos, a * sin);
            }
        }
        for at in span.step_by(LANES) {
            // A constant length lets the compiler unroll the loops over distances, so the common
            // lengths have code of their own.
            match n {
                8 => cell.differences(at, 8),
                10 => cell.differences(at, 10),
                12 => cell.differences(at, 12),
                16 => cell.differences(at, 16),
                _ => cell.differences(at, n),
            }
        }
    }
}

impl QuadCell {
    /// Computes both differences in the [`LANES`] columns from `at` on, summed over the `n` rows of
    /// the lenslet.
    ///
    /// Rows are read through windows of a constant length, and distances are limited to it, so that
    /// no access needs a bounds check.
    #[inline(always)]
    fn differences(&mut self, at: usize, n: usize) {
        let width = self.re.len() / self.lenslets.samples;
        let masks = &self.masked[at * (n / 2)..][..LANES * (n / 2)].as_chunks::<LANES>().0;
        let mut sum_x = [0.0f32; LANES];
        let mut sum_y = [0.0f32; LANES];
        for y in 0..n {
            let Some((re, im)) = self.window(y * width + at) else { return };
            let here = (lanes(re, 0), lanes(im, 0));
            // One sum for each row and axis: a single one would be a chain of 70 dependent
            // additions.
            let mut row = [0.0f32; LANES];
            for (i, mask) in masks.iter().enumerate() {
                add_cross(&mut row, mask, here, (lanes(re, 2 * i + 1), lanes(im, 2 * i + 1)));
            }
            let mut column = [0.0f32; LANES];
            for (i, &weight) in self.weights[..(n - y) / 2].iter().enumerate() {
                let Some((re, im)) = self.window((y + 2 * i + 1) * width + at) else { return };
                add_cross(&mut column, &[weight; LANES], here, (lanes(re, 0), lanes(im, 0)));
            }
            for l in 0..LANES {
                sum_x[l] += row[l];
            }
            for l in 0..LANES {
                sum_y[l] += column[l];
            }
        }
        self.along[0][at..at + LANES].copy_from_slice(&sum_x);
        self.along[1][at..at + LANES].copy_from_slice(&sum_y);
    }

    /// Window of the field from `place` on.
    #[inline(always)]
    fn window(&self, place: usize) -> Option<(&[f32; WINDOW], &[f32; WINDOW])> {
        Some((self.re.get(place..)?.first_chunk()?, self.im.get(place..)?.first_chunk()?))
    }
}

type Lane = [f32; LANES];

/// [`LANES`] neighbouring values of a window.
#[inline(always)]
fn lanes(window: &[f32; WINDOW], first: usize) -> Lane {
    let mut lanes = [0.0; LANES];
    lanes.copy_from_slice(&window[first % LONGEST..][..LANES]);
    lanes
}

/// `sum += weight·Im(E'·E*)`, for E and E' as (real, imaginary).
#[inline(always)]
fn add_cross(sum: &mut Lane, weight: &Lane, (re, im): (Lane, Lane), (re_d, im_d): (Lane, Lane)) {
    let mut cross = [0.0f32; LANES];
    for l in 0..LANES {
        cross[l] = im_d[l].mul_add(re[l], -(re_d[l] * im[l]));
    }
    for l in 0..LANES {
        sum[l] = weight[l].mul_add(cross[l], sum[l]);
    }
}

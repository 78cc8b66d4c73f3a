//! Surface of a mirror with Gaussian influence functions.
//!
//! Such a function is separable, `g(x−x_i)·g(y−y_j)`, so the surface for the commands C is
//! `G_yᵀ·C·G_x`: first the columns, then the rows. Beyond a few pitches the Gaussian is below
//! single precision, so both products are banded: about six rows of actuators contribute to a row
//! of samples.

use super::super::aligned::AlignedBuffer;
use super::super::footprint::{Footprint, LANES};
use crate::grid::Grid;
use crate::modes::InfluenceFunctions;
use pulp::{Arch, NullaryFnOnce};
use std::ops::Range;

/// Influence below this is taken as 0: for a stroke of 10 µm it is 1e-3 nm.
const NEGLIGIBLE: f64 = 1e-7;

/// Gaussian influence functions over the simulator's grid.
#[derive(Clone)]
pub(super) struct SeparableSurface {
    footprint: Footprint,
    across: usize,
    indices: Vec<usize>,
    /// Influence along an axis, `[actuator line][sample]`, in rows of the footprint's stride; and
    /// its transpose, `[sample][line]`.
    along: AlignedBuffer,
    transposed: Vec<f32>,
    /// Samples at which `along` is not 0, for each line of actuators, in whole vectors.
    reach: Vec<Range<usize>>,
    /// Lines of actuators that contribute to each line of samples.
    band: Vec<Range<usize>>,
    /// Commands on the whole square of actuators; then `C·G_x` in vectors of samples,
    /// `[vector][actuator row]`.
    commands: Vec<f32>,
    columns: AlignedBuffer,
}

impl SeparableSurface {
    /// Mirror of `influence` over `footprint`, which lies on `grid`.
    pub(super) fn new(influence: &InfluenceFunctions, grid: &Grid, footprint: &Footprint) -> Self {
        let mirror = influence.mirror();
        let (across, stride) = (mirror.actuators_across(), footprint.stride());
        let rate = mirror.coupling().ln() / mirror.pitch_m().powi(2);
        let mut along = AlignedBuffer::zeros(across * stride);
        let mut reach = Vec::with_capacity(across);
        for (i, row) in along.chunks_exact_mut(stride).enumerate() {
            let value = |j: usize| (rate * (grid.coordinate_m(j) - mirror.coordinate_m(i)).powi(2)).exp();
            for (j, out) in row.iter_mut().take(grid.samples()).enumerate() {
                *out = if value(j) > NEGLIGIBLE { value(j) as f32 } else { 0.0 };
            }
            let first = row.iter().position(|&v| v > 0.0).unwrap_or(0);
            let last = row.iter().rposition(|&v| v > 0.0).map_or(0, |last| last + 1);
            reach.push(first / LANES * LANES..last.next_multiple_of(LANES));
        }
        let band = (0..grid.samples())
            .map(|j| {
                let reaches = |i: &usize| along[i * stride + j] > 0.0;
                let first = (0..across).find(reaches).unwrap_or(0);
                first..(0..across).rfind(reaches).map_or(first, |last| last + 1)
            })
            .collect();
        let transposed = (0..grid.samples()).flat_map(|j| (0..across).map(move |i| (i, j)));
        let transposed = transposed.map(|(i, j)| along[i * stride + j]).collect();
        Self {
            footprint: footprint.clone(),
            across,
            indices: influence.indices().to_vec(),
            along,
            transposed,
            reach,
            band,
            commands: vec![0.0; across * across],
            columns: AlignedBuffer::zeros(across * stride),
        }
    }

    /// Rows and columns of samples that an actuator moves.
    pub(super) fn moved(&self, actuator: usize) -> [Range<usize>; 2] {
        let index = self.indices[actuator];
        [index / self.across, index % self.across].map(|line| self.moved_samples(line))
    }

    /// Samples along an axis that a line of actuators moves; empty for one that is far from the
    /// pupil.
    fn moved_samples(&self, line: usize) -> Range<usize> {
        let along = &self.along[line * self.footprint.stride()..][..self.footprint.stride()];
        let first = along.iter().position(|&value| value > 0.0).unwrap_or(0);
        first..along.iter().rposition(|&value| value > 0.0).map_or(first, |last| last + 1)
    }

    /// Number of multiply-adds of the two products.
    pub(super) fn taps(&self) -> (f64, f64) {
        let columns = self.across as f64 * self.reach.iter().map(|reach| reach.len() as f64).sum::<f64>();
        let rows = self.band.iter().enumerate().map(|(y, band)| (band.len() * self.footprint.span(y).len()) as f64);
        (columns, rows.sum())
    }

    /// Adds `scale` times the surface of `commands_nm` to `opd_nm`, and `static_nm`; returns Σ A·W
    /// and Σ A·W² of the sum W.
    pub(super) fn apply(
        &mut self,
        commands_nm: &[f32],
        scale: f32,
        static_nm: Option<&[f32]>,
        opd_nm: &mut [f32],
    ) -> [f64; 2] {
        self.load(commands_nm, scale);
        Arch::new().dispatch(ApplySurface { surface: self, static_nm, opd_nm })
    }

    fn load(&mut self, commands_nm: &[f32], scale: f32) {
        for (&index, &command) in self.indices.iter().zip(commands_nm) {
            self.commands[index] = scale * command;
        }
    }
}

/// Kernel of both products and of the residual's moments, which are summed in single precision
/// within a row and in double precision between rows.
struct ApplySurface<'a> {
    surface: &'a mut SeparableSurface,
    static_nm: Option<&'a [f32]>,
    opd_nm: &'a mut [f32],
}

impl NullaryFnOnce for ApplySurface<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn call(self) -> [f64; 2] {
        let Self { surface, static_nm, opd_nm } = self;
        surface.fill_columns();
        let stride = surface.footprint.stride();
        let mut moments = [0.0; 2];
        for (y, (row, band)) in opd_nm.chunks_exact_mut(stride).zip(&surface.band).enumerate() {
            let span = surface.footprint.span(y);
            let place = y * stride + span.start..y * stride + span.end;
            let influence = &surface.transposed[y * surface.across..][band.clone()];
            let amplitude = surface.footprint.amplitude()[place.clone()].as_chunks::<LANES>().0;
            let fixed = static_nm.map_or(amplitude, |static_nm| static_nm[place].as_chunks::<LANES>().0);
            let share = [if static_nm.is_some() { 1.0f32 } else { 0.0 }; LANES];
            let (mut first, mut second) = ([0.0f32; LANES], [0.0f32; LANES]);
            let columns = surface.columns.as_chunks::<LANES>().0.chunks_exact(surface.across).skip(span.start / LANES);
            let blocks = row[span].as_chunks_mut::<LANES>().0.iter_mut().zip(amplitude).zip(fixed);
            for (((out, a), fixed), columns) in blocks.zip(columns) {
                let mut sum = *out;
                multiply_add(&mut sum, &share, fixed);
                for (weight, column) in influence.iter().zip(&columns[band.clone()]) {
                    multiply_add(&mut sum, &[*weight; LANES], column);
                }
                *out = sum;
                let mut weighted = [0.0f32; LANES];
                for l in 0..LANES {
                    weighted[l] = a[l] * sum[l];
                }
                // A multiply-add like the other sum: the compiler does not vectorise plain
                // additions here.
                multiply_add(&mut first, a, &sum);
                multiply_add(&mut second, &weighted, &sum);
            }
            moments[0] += f64::from(first.iter().sum::<f32>());
            moments[1] += f64::from(second.iter().sum::<f32>());
        }
        moments
    }
}

impl SeparableSurface {
    /// Computes `C·G_x`.
    #[inline(always)]
    fn fill_columns(&mut self) {
        let (across, stride) = (self.across, self.footprint.stride());
        self.columns.fill(0.0);
        let all = self.columns.as_chunks_mut::<LANES>().0;
        for (j, commands) in self.commands.chunks_exact(across).enumerate() {
            for ((&command, along), reach) in commands.iter().zip(self.along.chunks_exact(stride)).zip(&self.reach) {
                let along = along[reach.clone()].as_chunks::<LANES>().0;
                let columns = all.chunks_exact_mut(across).skip(reach.start / LANES);
                for (column, along) in columns.zip(along) {
                    multiply_add(&mut column[j], &[command; LANES], along);
                }
            }
        }
    }
}

/// `sum += a·b`.
#[inline(always)]
pub(super) fn multiply_add(sum: &mut [f32; LANES], a: &[f32; LANES], b: &[f32; LANES]) {
    for l in 0..LANES {
        sum[l] = a[l].mul_add(b[l], sum[l]);
    }
}

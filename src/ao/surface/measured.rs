//! Surface of a mirror with measured influence functions: the sum of all functions, each over the
//! rectangle of samples in which it is not 0.
//!
//! The values are stored actuator by actuator and row by row, in runs of whole SIMD vectors, and
//! each is read once per surface.

use super::super::aligned::AlignedBuffer;
use super::super::footprint::{Footprint, LANES};
use super::separable::multiply_add;
use crate::grid::Grid;
use crate::modes::InfluenceFunctions;
use pulp::{Arch, NullaryFnOnce};
use std::ops::Range;

/// Measured influence functions over the simulator's grid.
#[derive(Clone)]
pub(super) struct MeasuredSurface {
    footprint: Footprint,
    actuators: Vec<Actuator>,
    runs: Vec<Run>,
    /// The values of all runs, one after the other.
    values: AlignedBuffer,
}

#[derive(Clone)]
struct Actuator {
    /// Its runs.
    runs: Range<usize>,
    /// Rows and columns of samples that it moves.
    moved: [Range<usize>; 2],
}

/// Values of an influence function in a row of samples.
#[derive(Clone)]
struct Run {
    /// Index of the first sample in a map over the footprint, and number of samples; both are
    /// multiples of [`LANES`].
    place: usize,
    len: usize,
}

impl MeasuredSurface {
    pub(super) fn new(influence: &InfluenceFunctions, grid: &Grid, footprint: &Footprint) -> Self {
        let coordinates_m: Vec<f64> = (0..grid.samples()).map(|i| grid.coordinate_m(i)).collect();
        let (mut actuators, mut runs, mut values) = (Vec::new(), Vec::new(), Vec::new());
        for window in (0..influence.len()).filter_map(|actuator| influence.window(actuator, &coordinates_m)) {
            let first = runs.len();
            for (y, row) in window.rows.clone().zip(window.values.outer_iter()) {
                let span = footprint.span(y);
                let start = (window.columns.start / LANES * LANES).max(span.start);
                let end = window.columns.end.next_multiple_of(LANES).min(span.end);
                if start >= end {
                    continue;
                }
                runs.push(Run { place: y * footprint.stride() + start, len: end - start });
                // 0 outside the window.
                let value = |x: usize| x.checked_sub(window.columns.start).and_then(|x| row.get(x));
                values.extend((start..end).map(|x| value(x).map_or(0.0, |&value| value as f32)));
            }
            actuators.push(Actuator { runs: first..runs.len(), moved: [window.rows, window.columns] });
        }
        let mut aligned = AlignedBuffer::zeros(values.len());
        aligned.copy_from_slice(&values);
        Self { footprint: footprint.clone(), actuators, runs, values: aligned }
    }

    /// Rows and columns of samples that an actuator moves.
    pub(super) fn moved(&self, actuator: usize) -> [Range<usize>; 2] {
        self.actuators[actuator].moved.clone()
    }

    /// Number of multiply-adds of a surface.
    pub(super) fn taps(&self) -> f64 {
        self.values.len() as f64
    }

    /// Adds `scale` times the surface of `commands_nm` to `opd_nm`, and `static_nm`; returns Σ A·W
    /// and Σ A·W² of the sum W.
    pub(super) fn apply(
        &self,
        commands_nm: &[f32],
        scale: f32,
        static_nm: Option<&[f32]>,
        opd_nm: &mut [f32],
    ) -> [f64; 2] {
        Arch::new().dispatch(ApplyFunctions { surface: self, commands_nm, scale, static_nm, opd_nm })
    }
}

/// Kernel of the sum and of its moments, which are summed in single precision within a row and in
/// double precision between rows.
struct ApplyFunctions<'a> {
    surface: &'a MeasuredSurface,
    commands_nm: &'a [f32],
    scale: f32,
    static_nm: Option<&'a [f32]>,
    opd_nm: &'a mut [f32],
}

impl NullaryFnOnce for ApplyFunctions<'_> {
    type Output = [f64; 2];

    #[inline(always)]
    fn call(self) -> [f64; 2] {
        let Self { surface, commands_nm, scale, static_nm, opd_nm } = self;
        let mut values = surface.values.as_chunks::<LANES>().0;
        for (actuator, command) in surface.actuators.iter().zip(commands_nm) {
            let stroke = [scale * command; LANES];
            for run in &surface.runs[actuator.runs.clone()] {
                let (own, others) = values.split_at(run.len / LANES);
                values = others;
                // An interaction matrix is measured with most commands 0.
                if *command != 0.0 {
                    let out = opd_nm[run.place..run.place + run.len].as_chunks_mut::<LANES>().0;
                    out.iter_mut().zip(own).for_each(|(out, value)| multiply_add(out, &stroke, value));
                }
            }
        }
        add_and_moments(&surface.footprint, static_nm, opd_nm)
    }
}

/// Adds `static_nm` to `opd_nm`; returns the moments of the sum.
#[inline(always)]
fn add_and_moments(footprint: &Footprint, static_nm: Option<&[f32]>, opd_nm: &mut [f32]) -> [f64; 2] {
    let mut moments = [0.0; 2];
    for (y, row) in opd_nm.chunks_exact_mut(footprint.stride()).enumerate() {
        let span = footprint.span(y);
        let place = y * footprint.stride() + span.start..y * footprint.stride() + span.end;
        let amplitude = footprint.amplitude()[place.clone()].as_chunks::<LANES>().0;
        let fixed = static_nm.map_or(amplitude, |static_nm| static_nm[place].as_chunks::<LANES>().0);
        let share = [if static_nm.is_some() { 1.0f32 } else { 0.0 }; LANES];
        let (mut first, mut second) = ([0.0f32; LANES], [0.0f32; LANES]);
        for ((out, a), fixed) in row[span].as_chunks_mut::<LANES>().0.iter_mut().zip(amplitude).zip(fixed) {
            multiply_add(out, &share, fixed);
            let mut weighted = [0.0f32; LANES];
            for l in 0..LANES {
                weighted[l] = a[l] * out[l];
            }
            multiply_add(&mut first, a, out);
            multiply_add(&mut second, &weighted, out);
        }
        moments[0] += f64::from(first.iter().sum::<f32>());
        moments[1] += f64::from(second.iter().sum::<f32>());
    }
    moments
}

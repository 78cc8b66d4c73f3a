//! The deformable mirror's surface from its commands, on the simulator's grid.
//!
//! A Gaussian influence function is a product of one in x and one in y, `g(x−x_i)·g(y−y_j)`, so the surface is
//! `G_yᵀ·C·G_x`: first the columns, then the rows. Beyond a few pitches the Gaussian is below single precision, and both
//! products are banded: a row of samples sees about six rows of actuators.

use super::footprint::{Footprint, LANES};
use crate::grid::Grid;
use crate::modes::InfluenceFunctions;
use crate::{Error, Result};
use pulp::{Arch, NullaryFnOnce};
use std::ops::Range;

/// Influence below this is nothing: a stroke of 10 µm would leave 1e-3 nm.
const NEGLIGIBLE: f64 = 1e-7;

/// A mirror in front of the simulator's grid.
#[derive(Clone)]
pub struct Surface {
    footprint: Footprint,
    across: usize,
    indices: Vec<usize>,
    /// Influence along an axis, `[actuator line][sample]`, rows of the footprint's stride.
    along: Vec<f32>,
    /// Where `along` is not negligible, for each line of actuators, in whole vectors.
    reach: Vec<Range<usize>>,
    /// The lines of actuators that reach each line of samples.
    band: Vec<Range<usize>>,
    /// Commands on the whole square, then `C·G_x`, `[actuator row][x]`.
    commands: Vec<f32>,
    columns: Vec<f32>,
    arch: Arch,
}

impl Surface {
    /// The mirror of `influence` over `footprint`, which lies on `grid`.
    pub fn new(influence: &InfluenceFunctions, grid: &Grid, footprint: &Footprint) -> Self {
        let mirror = influence.mirror();
        let (across, stride) = (mirror.actuators_across(), footprint.stride());
        let rate = mirror.coupling().ln() / mirror.pitch_m().powi(2);
        let mut along = vec![0.0; across * stride];
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
        Self {
            footprint: footprint.clone(),
            across,
            indices: influence.indices().to_vec(),
            along,
            reach,
            band,
            commands: vec![0.0; across * across],
            columns: vec![0.0; across * stride],
            arch: Arch::new(),
        }
    }

    /// Number of actuators.
    pub fn actuators(&self) -> usize {
        self.indices.len()
    }

    /// Adds `scale` times the surface of `commands_nm` (one for each actuator) to `opd_nm`, a map over the footprint.
    ///
    /// # Errors
    /// [`Error::Shape`] where either has another length.
    pub fn add(&mut self, commands_nm: &[f32], scale: f32, opd_nm: &mut [f32]) -> Result<()> {
        if commands_nm.len() != self.indices.len() || opd_nm.len() != self.footprint.len() {
            let (commands, map) = (commands_nm.len(), opd_nm.len());
            return Err(Error::Shape(format!(
                "{commands} commands on a map of {map} samples were given: {} on {} are needed",
                self.indices.len(),
                self.footprint.len()
            )));
        }
        for (&index, &command) in self.indices.iter().zip(commands_nm) {
            self.commands[index] = scale * command;
        }
        self.arch.dispatch(Add { surface: self, opd_nm });
        Ok(())
    }
}

/// Both products, compiled for the processor at hand.
struct Add<'a> {
    surface: &'a mut Surface,
    opd_nm: &'a mut [f32],
}

impl NullaryFnOnce for Add<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { surface, opd_nm } = self;
        let stride = surface.footprint.stride();
        for (row, commands) in
            surface.columns.chunks_exact_mut(stride).zip(surface.commands.chunks_exact(surface.across))
        {
            row.fill(0.0);
            for ((&command, along), reach) in
                commands.iter().zip(surface.along.chunks_exact(stride)).zip(&surface.reach)
            {
                let along = along[reach.clone()].as_chunks::<LANES>().0;
                for (out, along) in row[reach.clone()].as_chunks_mut::<LANES>().0.iter_mut().zip(along) {
                    for (out, along) in out.iter_mut().zip(along) {
                        *out = command.mul_add(*along, *out);
                    }
                }
            }
        }
        for (y, (row, band)) in opd_nm.chunks_exact_mut(stride).zip(&surface.band).enumerate() {
            let span = surface.footprint.span(y);
            let mut at = span.start;
            for out in row[span].as_chunks_mut::<LANES>().0 {
                let mut sum = *out;
                for j in band.clone() {
                    let weight = surface.along[j * stride + y];
                    let column: &[f32] = &surface.columns[j * stride + at..][..LANES];
                    for (sum, column) in sum.iter_mut().zip(column) {
                        *sum = weight.mul_add(*column, *sum);
                    }
                }
                *out = sum;
                at += LANES;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modes::Samples;
    use crate::scene::Scene;
    use crate::telescope::Telescope;

    #[test]
    fn the_surface_is_the_sum_of_the_influence_functions() {
        for coupling in ["0.1458", "0.35"] {
            let scene = Scene::preset("keck-onsky").unwrap().with_override("mirror.coupling", coupling).unwrap();
            let telescope = Telescope::of(&scene).unwrap();
            let influence = telescope.influence(&scene).unwrap();
            let (pupil, footprint) = (&telescope.pupil, Footprint::of(&telescope.pupil));
            let mut surface = Surface::new(&influence, &pupil.grid, &footprint);
            let commands: Vec<f32> = (0..surface.actuators()).map(|i| ((i * 37 % 101) as f32 - 50.0) * 20.0).collect();
            let mut map = footprint.zeros();
            surface.add(&commands, 1.0, &mut map).unwrap();
            let samples = Samples::of(pupil).unwrap();
            let values = influence.evaluate(&samples.xs_m, &samples.ys_m).unwrap();
            let wide: Vec<f64> = commands.iter().map(|&c| f64::from(c)).collect();
            let expected = ndarray::aview1(&wide).dot(&values);
            for (&index, expected) in samples.indices.iter().zip(expected) {
                let (y, x) = (index / footprint.samples(), index % footprint.samples());
                let got = f64::from(map[y * footprint.stride() + x]);
                // Strokes of 1,000 nm: what is cut off leaves some 1e-7 of each of 21 lines, rounding 1e-7 of the sum.
                assert!((got - expected).abs() < 1e-2, "{got} {expected}");
            }
            surface.add(&commands, -1.0, &mut map).unwrap();
            assert!(map.iter().all(|v| v.abs() < 1e-3), "what is added and taken away leaves rounding");
        }
    }

    #[test]
    fn commands_of_another_mirror_are_refused() {
        let scene = Scene::preset("keck-onsky").unwrap();
        let telescope = Telescope::of(&scene).unwrap();
        let footprint = Footprint::of(&telescope.pupil);
        let mut surface = Surface::new(&telescope.influence(&scene).unwrap(), &telescope.pupil.grid, &footprint);
        assert!(surface.add(&[0.0; 3], 1.0, &mut footprint.zeros()).is_err());
    }
}

//! Surface of the deformable mirror on the simulator's grid.

mod measured;
mod separable;

use super::footprint::Footprint;
use crate::grid::Grid;
use crate::modes::InfluenceFunctions;
use crate::{Error, Result};
use measured::MeasuredSurface;
use separable::SeparableSurface;
use std::ops::Range;

/// Deformable mirror over the simulator's grid.
#[derive(Clone)]
pub struct Surface {
    actuators: usize,
    /// Values of a map over the footprint.
    map_len: usize,
    functions: Functions,
}

#[derive(Clone)]
enum Functions {
    Separable(SeparableSurface),
    Measured(MeasuredSurface),
}

impl Surface {
    /// Mirror of `influence` over `footprint`, which lies on `grid`.
    pub fn new(influence: &InfluenceFunctions, grid: &Grid, footprint: &Footprint) -> Self {
        let functions = if influence.is_separable() {
            Functions::Separable(SeparableSurface::new(influence, grid, footprint))
        } else {
            Functions::Measured(MeasuredSurface::new(influence, grid, footprint))
        };
        Self { actuators: influence.len(), map_len: footprint.len(), functions }
    }

    /// Number of actuators.
    pub fn actuators(&self) -> usize {
        self.actuators
    }

    /// Rows and columns of samples that an actuator moves; empty for one that is far from the
    /// pupil.
    pub(super) fn moved(&self, actuator: usize) -> [Range<usize>; 2] {
        match &self.functions {
            Functions::Separable(surface) => surface.moved(actuator),
            Functions::Measured(surface) => surface.moved(actuator),
        }
    }

    /// Number of multiply-adds of a surface: of both products, or of all functions and none.
    pub(super) fn taps(&self) -> (f64, f64) {
        match &self.functions {
            Functions::Separable(surface) => surface.taps(),
            Functions::Measured(surface) => (surface.taps(), 0.0),
        }
    }

    /// Bytes of the influence functions that are read for a surface, besides what stays in the
    /// first cache.
    pub(super) fn bytes(&self) -> f64 {
        match &self.functions {
            Functions::Separable(_) => 0.0,
            Functions::Measured(surface) => 4.0 * surface.taps(),
        }
    }

    /// Adds `scale` times the surface of `commands_nm` (one for each actuator) to `opd_nm`, a map
    /// over the footprint.
    ///
    /// # Errors
    /// [`Error::Shape`] if either has a wrong length.
    pub fn add(&mut self, commands_nm: &[f32], scale: f32, opd_nm: &mut [f32]) -> Result<()> {
        self.check(commands_nm, opd_nm)?;
        self.apply(commands_nm, scale, None, opd_nm);
        Ok(())
    }

    /// Subtracts the surface of `commands_nm` from `opd_nm` and adds `static_nm`, both maps over
    /// the footprint; returns Σ A·W and Σ A·W² of the residual W.
    ///
    /// # Errors
    /// [`Error::Shape`] if one of them has a wrong length.
    pub fn correct(&mut self, commands_nm: &[f32], static_nm: &[f32], opd_nm: &mut [f32]) -> Result<[f64; 2]> {
        self.check(commands_nm, opd_nm)?;
        self.check(commands_nm, static_nm)?;
        Ok(self.apply(commands_nm, -1.0, Some(static_nm), opd_nm))
    }

    fn apply(&mut self, commands_nm: &[f32], scale: f32, static_nm: Option<&[f32]>, opd_nm: &mut [f32]) -> [f64; 2] {
        match &mut self.functions {
            Functions::Separable(surface) => surface.apply(commands_nm, scale, static_nm, opd_nm),
            Functions::Measured(surface) => surface.apply(commands_nm, scale, static_nm, opd_nm),
        }
    }

    fn check(&self, commands_nm: &[f32], map_nm: &[f32]) -> Result<()> {
        if commands_nm.len() == self.actuators && map_nm.len() == self.map_len {
            return Ok(());
        }
        let (commands, map) = (commands_nm.len(), map_nm.len());
        Err(Error::Shape(format!(
            "{commands} commands on a map of {map} samples were given; {} on {} are needed",
            self.actuators, self.map_len
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modes::{MeasuredInfluence, Samples};
    use crate::scene::Scene;
    use crate::telescope::Telescope;
    use ndarray::{Array2, Array3};
    use std::sync::Arc;

    #[test]
    fn the_surface_is_the_sum_of_the_influence_functions() {
        for coupling in ["0.1458", "0.35"] {
            let scene = Scene::preset("keck-onsky").unwrap().with_override("mirror.coupling", coupling).unwrap();
            let telescope = Telescope::new(&scene).unwrap();
            let influence = telescope.influence(&scene).unwrap();
            let (pupil, footprint) = (&telescope.pupil, Footprint::new(&telescope.pupil));
            let mut surface = Surface::new(&influence, &pupil.grid, &footprint);
            let commands: Vec<f32> = (0..surface.actuators()).map(|i| ((i * 37 % 101) as f32 - 50.0) * 20.0).collect();
            let mut map = footprint.zeros();
            surface.add(&commands, 1.0, &mut map).unwrap();
            let samples = Samples::from_pupil(pupil).unwrap();
            let values = influence.evaluate(&samples.xs_m, &samples.ys_m).unwrap();
            let wide: Vec<f64> = commands.iter().map(|&c| f64::from(c)).collect();
            let expected = ndarray::aview1(&wide).dot(&values);
            for (&index, expected) in samples.indices.iter().zip(expected) {
                let (y, x) = (index / footprint.samples(), index % footprint.samples());
                let got = f64::from(map[y * footprint.stride() + x]);
                // Strokes of 1,000 nm: the cut-off leaves up to 1e-7 of each of 21 lines, rounding
                // 1e-7 of the sum.
                assert!((got - expected).abs() < 1e-2, "{got} {expected}");
            }
            surface.add(&commands, -1.0, &mut map).unwrap();
            assert!(map.iter().all(|v| v.abs() < 1e-3), "a surface added and subtracted leaves rounding");
        }
    }

    /// Functions with negative rings, of each actuator and in common, on another grid than the
    /// simulator's.
    #[test]
    #[ignore = "merge: 3 s"]
    fn measured_surface_is_the_sum_of_functions_with_its_moments() {
        let scene = Scene::preset("keck-onsky").unwrap();
        let telescope = Telescope::new(&scene).unwrap();
        let (pupil, footprint) = (&telescope.pupil, Footprint::with_margin(&telescope.pupil, 3));
        let actuators = telescope.influence(&scene).unwrap();
        let ring = |r: f64| (1.0 - 0.8 * r * r) * (-r * r).exp();
        let each = Array3::from_shape_fn((actuators.len(), 90, 90), |(actuator, y, x)| {
            let at_m = |i: usize| (i as f64 - 44.5) * pupil.grid.width_m() / 90.0;
            let (x_m, y_m) = actuators.positions_m()[actuator];
            ring((at_m(x) - x_m).hypot(at_m(y) - y_m) / 0.5)
        });
        let common = Array2::from_shape_fn((41, 31), |(y, x)| ring((x as f64 - 15.0).hypot(y as f64 - 20.0) / 5.0));
        for measured in [
            MeasuredInfluence::of_each(each.view(), pupil.grid.width_m()).unwrap(),
            MeasuredInfluence::common(common.view(), 0.11).unwrap(),
        ] {
            let influence = actuators.clone().measured(Arc::new(measured)).unwrap();
            let mut surface = Surface::new(&influence, &pupil.grid, &footprint);
            let commands: Vec<f32> = (0..surface.actuators()).map(|i| ((i * 37 % 101) as f32 - 50.0) * 20.0).collect();
            let samples = Samples::from_pupil(pupil).unwrap();
            let values = influence.evaluate(&samples.xs_m, &samples.ys_m).unwrap();
            let wide: Vec<f64> = commands.iter().map(|&c| f64::from(c)).collect();
            let expected = ndarray::aview1(&wide).dot(&values);
            let mut map = footprint.zeros();
            surface.add(&commands, 1.0, &mut map).unwrap();
            let place = |&index: &usize| index / footprint.samples() * footprint.stride() + index % footprint.samples();
            for (index, expected) in samples.indices.iter().zip(&expected) {
                // Strokes of 1,000 nm: rounding of a few 1e-7 of the sum of some ten of them.
                assert!((f64::from(map[place(index)]) - expected).abs() < 1e-2);
            }
            let (fixed, mut opd_nm) =
                (footprint.amplitude().iter().map(|a| 30.0 * a).collect::<Vec<f32>>(), map.clone());
            opd_nm.iter_mut().zip(footprint.amplitude()).for_each(|(opd, a)| *opd += 100.0 * a);
            let moments = surface.correct(&commands, &fixed, &mut opd_nm).unwrap();
            let weights = footprint.amplitude().iter().map(|&a| f64::from(a));
            // What remains is 130 nm times the amplitude A: Σ A·130A and Σ A·(130A)², with the same
            // rounding in each sample.
            for (power, moment) in (1..).zip(moments) {
                let known: f64 = weights.clone().map(|a| a * (130.0 * a).powi(power)).sum();
                assert!((moment / known - 1.0).abs() < 1e-4, "{moment} {known}");
            }
        }
    }

    #[test]
    fn a_wrong_number_of_commands_is_refused() {
        let scene = Scene::preset("keck-onsky").unwrap();
        let telescope = Telescope::new(&scene).unwrap();
        let footprint = Footprint::new(&telescope.pupil);
        let mut surface = Surface::new(&telescope.influence(&scene).unwrap(), &telescope.pupil.grid, &footprint);
        assert!(surface.add(&[0.0; 3], 1.0, &mut footprint.zeros()).is_err());
    }
}

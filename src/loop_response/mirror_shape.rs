//! Shape of a deformable mirror at samples of a square grid, from its commands.
//!
//! A Gaussian influence function is the product of one in x and one in y, so the shape is `G_yᵀ·C·G_x` with the commands C on their square
//! grid: n·a·(n + a) operations and n·a numbers for n samples and a actuators a side, where the influence of each actuator at each sample
//! would be n²·a² of both.

use crate::modes::InfluenceFunctions;
use crate::retrieval::IlluminatedSamples;
use ndarray::{Array1, Array2, ArrayView1};

/// Mirror of a grid of samples.
pub(super) struct MirrorShape {
    /// Samples along a side.
    samples: usize,
    /// Flat index of each illuminated sample.
    indices: Vec<usize>,
    /// Influence of a column or row of actuators at a column or row of samples, `[actuators, samples]`.
    along: Array2<f64>,
    /// Index of each actuator on the square grid.
    actuators: Vec<usize>,
}

impl MirrorShape {
    /// Of the mirror `influence` at the illuminated `samples`.
    pub(super) fn new(influence: &InfluenceFunctions, samples: &IlluminatedSamples) -> Self {
        let n = samples.samples;
        let coordinates_m: Vec<f64> = (0..n).map(|i| (i as f64 - (n as f64 - 1.0) / 2.0) * samples.pitch_m).collect();
        let (along, actuators) = influence.along(&coordinates_m);
        Self { samples: n, indices: samples.indices.clone(), actuators: actuators.to_vec(), along }
    }

    /// Number of illuminated samples.
    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.indices.len()
    }

    /// Shape of these commands at each illuminated sample, nm.
    pub(super) fn wavefront_nm(&self, commands_nm: ArrayView1<f64>) -> Array1<f64> {
        let across = self.along.nrows();
        let mut commands = Array2::zeros((across, across));
        for (&actuator, &nm) in self.actuators.iter().zip(commands_nm) {
            commands[[actuator / across, actuator % across]] = nm;
        }
        let shape = self.along.t().dot(&commands.dot(&self.along));
        self.indices.iter().map(|&index| shape[[index / self.samples, index % self.samples]]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ao::Simulator;
    use crate::retrieval::tests::scene;

    #[test]
    fn the_shape_is_the_sum_of_the_influence_functions() {
        let simulator = Simulator::new(&scene()).unwrap();
        let (influence, telescope) = (simulator.influence(), simulator.telescope());
        let grid = telescope.pupil.grid;
        let weights = telescope.area_weights(grid).unwrap();
        let samples = IlluminatedSamples::new(grid.samples(), grid.pitch_m(), &weights).unwrap();
        let shape = MirrorShape::new(influence, &samples);
        let commands_nm = Array1::from_shape_fn(influence.len(), |i| 100.0 * (2.7 * i as f64).sin());
        let expected_nm = commands_nm.dot(&influence.evaluate(&samples.xs_m, &samples.ys_m).unwrap());
        let found_nm = shape.wavefront_nm(commands_nm.view());
        // Sums of some hundred products of at most 100 nm, each rounded.
        assert!(found_nm.len() == shape.len() && expected_nm.dot(&expected_nm) > 0.0);
        assert!(found_nm.iter().zip(&expected_nm).all(|(found, expected)| (found - expected).abs() < 1e-10));
    }
}

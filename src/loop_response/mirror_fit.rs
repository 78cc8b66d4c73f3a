//! What a deformable mirror takes up of a wavefront: least squares over the pupil.
//!
//! Influence functions are local, so the normal equations are sums over the few actuators at each sample.

use super::mirror_shape::moved_samples;
use crate::Result;
use crate::linear_algebra::SpdInverse;
use crate::modes::{InfluenceFunctions, Samples};
use crate::pupil::Grid;
use ndarray::{Array1, Array2, ArrayView1};

/// Regularisation of the fit of the mirror's commands, as a fraction of the strongest actuator's: bounds the commands of actuators
/// at the edge of the pupil.
const REGULARISATION: f64 = 1e-4;

/// Fit of a mirror's commands to wavefronts.
pub(super) struct MirrorFit {
    /// Samples that each actuator moves, with its influence on them.
    moved: Vec<Vec<(u32, f64)>>,
    /// Weight of each sample.
    weights: Vec<f64>,
    /// Inverse of the normal equations, `[actuator, actuator]`.
    inverse: Array2<f64>,
}

impl MirrorFit {
    /// Of the mirror `influence` at `samples` of `grid`.
    ///
    /// # Errors
    /// [`Error::Internal`](crate::Error::Internal) for normal equations that are not positive.
    pub(super) fn new(influence: &InfluenceFunctions, samples: &Samples, grid: Grid) -> Result<Self> {
        let coordinates_m: Vec<f64> = (0..grid.samples()).map(|at| grid.coordinate_m(at)).collect();
        let moved = moved_samples(influence, &samples.indices, &coordinates_m);
        let mut movers: Vec<Vec<(usize, f64)>> = vec![Vec::new(); samples.indices.len()];
        for (actuator, moved) in moved.iter().enumerate() {
            moved.iter().for_each(|&(sample, value)| movers[sample as usize].push((actuator, value)));
        }
        let mut gram = Array2::zeros((moved.len(), moved.len()));
        for (movers, weight) in movers.iter().zip(&samples.weights) {
            for (one, value) in movers {
                movers.iter().for_each(|(other, its)| gram[[*one, *other]] += weight * value * its);
            }
        }
        let strongest = gram.diag().iter().copied().fold(0.0, f64::max);
        gram.diag_mut().iter_mut().for_each(|value| *value += REGULARISATION * strongest);
        Ok(Self { moved, weights: samples.weights.clone(), inverse: SpdInverse::new(&gram)?.inverse })
    }

    /// The commands with which the mirror is nearest to a wavefront, nm.
    pub(super) fn commands_nm(&self, wavefront_nm: ArrayView1<f64>) -> Array1<f64> {
        let weighted =
            |&(sample, value): &(u32, f64)| value * self.weights[sample as usize] * wavefront_nm[sample as usize];
        let projected: Array1<f64> = self.moved.iter().map(|moved| moved.iter().map(weighted).sum()).collect();
        self.inverse.dot(&projected)
    }

    /// The mirror's shape that is nearest to a wavefront, at the samples, nm.
    pub(super) fn shape_nm(&self, wavefront_nm: ArrayView1<f64>) -> Array1<f64> {
        let mut shape_nm = Array1::zeros(self.weights.len());
        for (moved, nm) in self.moved.iter().zip(self.commands_nm(wavefront_nm)) {
            moved.iter().for_each(|&(sample, value)| shape_nm[sample as usize] += nm * value);
        }
        shape_nm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ao::Simulator;
    use crate::retrieval::tests::scene;

    #[test]
    fn a_shape_of_the_mirror_is_taken_up_and_a_fit_leaves_nothing_that_it_could_take() {
        let simulator = Simulator::new(&scene()).unwrap();
        let pupil = &simulator.telescope().pupil;
        let (samples, influence) = (Samples::from_pupil(pupil).unwrap(), simulator.influence());
        let fit = MirrorFit::new(influence, &samples, pupil.grid).unwrap();
        let shapes = influence.evaluate(&samples.xs_m, &samples.ys_m).unwrap();
        let own_nm = Array1::from_shape_fn(influence.len(), |i| 100.0 * (0.3 * i as f64).sin()).dot(&shapes);
        let norm =
            |nm: &Array1<f64>| nm.iter().zip(&samples.weights).map(|(nm, weight)| weight * nm * nm).sum::<f64>().sqrt();
        // The regularisation holds back what actuators at the edge do to few samples: a part in a hundred.
        assert!(norm(&(fit.shape_nm(own_nm.view()) - &own_nm)) < 0.01 * norm(&own_nm));
        let fine_nm: Array1<f64> =
            samples.xs_m.iter().zip(&samples.ys_m).map(|(x, y)| 50.0 * (9.0 * x + 5.0 * y).sin()).collect();
        let left_nm = &fine_nm - &fit.shape_nm(fine_nm.view());
        assert!(norm(&left_nm) < norm(&fine_nm));
        assert!(norm(&fit.shape_nm(left_nm.view())) < 0.05 * norm(&left_nm));
    }
}

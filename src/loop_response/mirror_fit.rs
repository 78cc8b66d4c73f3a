//! What a deformable mirror takes up of a wavefront: least squares over the pupil.
use super::mirror_shape::MirrorShape;
use crate::Result;
use crate::linear_algebra::CholeskyFactor;
use crate::modes::{InfluenceFunctions, Samples};
use crate::pupil::Grid;
use ndarray::{Array2, ArrayView1, ArrayView2, Axis};
use rayon::prelude::*;

/// Regularisation of the fit of the mirror's commands, as a fraction of the strongest actuator's:
/// bounds the commands of actuators at the edge of the pupil.
const REGULARISATION: f64 = 1e-4;

/// Fit of a mirror's commands to wavefronts.
pub(super) struct MirrorFit {
    shape: MirrorShape,
    /// Weight of each sample.
    weights: Vec<f64>,
    /// Normal equations.
    factor: CholeskyFactor,
}

impl MirrorFit {
    /// Of the mirror `influence` at `samples` of `grid`.
    ///
    /// # Errors
    /// [`Error::Value`](crate::Error::Value) for normal equations that are not positive.
    pub(super) fn new(influence: &InfluenceFunctions, samples: &Samples, grid: Grid) -> Result<Self> {
        let coordinates_m: Vec<f64> = (0..grid.samples()).map(|at| grid.coordinate_m(at)).collect();
        let shape = MirrorShape::at(influence, &samples.indices, &coordinates_m);
        let mut gram = shape.gram(&samples.weights);
        let strongest = gram.diag().iter().copied().fold(0.0, f64::max);
        gram.diag_mut().iter_mut().for_each(|value| *value += REGULARISATION * strongest);
        Ok(Self { shape, weights: samples.weights.clone(), factor: CholeskyFactor::new(&gram)? })
    }

    /// The commands with which the mirror is nearest to wavefronts, `[wavefront, sample]`;
    /// `[actuator, wavefront]`, both nm.
    pub(super) fn commands_nm(&self, wavefronts_nm: ArrayView2<f64>) -> Array2<f64> {
        let weights = ArrayView1::from(&self.weights);
        let mut products = Array2::zeros((self.factor.size(), wavefronts_nm.nrows()));
        let columns = products.axis_iter_mut(Axis(1)).into_par_iter();
        columns
            .zip(wavefronts_nm.axis_iter(Axis(0)))
            .for_each(|(mut products, nm)| products.assign(&self.shape.products((&nm * &weights).view())));
        self.factor.solution(&products)
    }

    /// The mirror's shapes that are nearest to wavefronts, both `[wavefront, sample]`, nm.
    pub(super) fn shapes_nm(&self, wavefronts_nm: ArrayView2<f64>) -> Array2<f64> {
        let commands_nm = self.commands_nm(wavefronts_nm);
        let mut shapes_nm = Array2::zeros(wavefronts_nm.dim());
        let rows = shapes_nm.axis_iter_mut(Axis(0)).into_par_iter();
        rows.zip(commands_nm.axis_iter(Axis(1)))
            .for_each(|(mut shape_nm, commands_nm)| shape_nm.assign(&self.shape.wavefront_nm(commands_nm)));
        shapes_nm
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ao::Simulator;
    use crate::retrieval::tests::scene;
    use ndarray::Array1;

    #[test]
    fn mirror_fit_is_nearly_a_projection_on_mirror_shapes() {
        let simulator = Simulator::new(&scene()).unwrap();
        let pupil = &simulator.telescope().pupil;
        let (samples, influence) = (Samples::from_pupil(pupil).unwrap(), simulator.influence());
        let fit = MirrorFit::new(influence, &samples, pupil.grid).unwrap();
        let shapes = influence.evaluate(&samples.xs_m, &samples.ys_m).unwrap();
        let own_nm = Array1::from_shape_fn(influence.len(), |i| 100.0 * (0.3 * i as f64).sin()).dot(&shapes);
        let shape_nm = |nm: &Array1<f64>| fit.shapes_nm(nm.view().insert_axis(Axis(0))).remove_axis(Axis(0));
        let norm =
            |nm: &Array1<f64>| nm.iter().zip(&samples.weights).map(|(nm, weight)| weight * nm * nm).sum::<f64>().sqrt();
        // The regularisation holds back what actuators at the edge do to few samples: a part in a
        // hundred.
        assert!(norm(&(shape_nm(&own_nm) - &own_nm)) < 0.01 * norm(&own_nm));
        let fine_nm: Array1<f64> =
            samples.xs_m.iter().zip(&samples.ys_m).map(|(x, y)| 50.0 * (9.0 * x + 5.0 * y).sin()).collect();
        let left_nm = &fine_nm - &shape_nm(&fine_nm);
        assert!(norm(&left_nm) < norm(&fine_nm));
        assert!(norm(&shape_nm(&left_nm)) < 0.05 * norm(&left_nm));
    }
}

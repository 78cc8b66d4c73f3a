//! Shape of a deformable mirror at samples of a square grid, from its commands.
//!
//! A Gaussian influence function is the product of one in x and one in y, so the shape is
//! `G_yᵀ·C·G_x` with the commands C on their square grid: n·a·(n + a) operations and n·a numbers
//! for n samples and a actuators a side, where the influence of each actuator at each sample would
//! be n²·a² of both. Of measured functions the values that are not 0 are kept.

use crate::modes::{InfluenceFunctions, reach};
use crate::retrieval::IlluminatedSamples;
use ndarray::{Array1, Array2, ArrayView1};

/// Mirror of a grid of samples.
pub(super) struct MirrorShape {
    /// Samples along a side.
    samples: usize,
    /// Flat index of each illuminated sample.
    indices: Vec<usize>,
    functions: Functions,
}

enum Functions {
    Separable {
        /// Influence of a column or row of actuators at a column or row of samples,
        /// `[actuators, samples]`.
        along: Array2<f64>,
        /// Index of each actuator on the square grid.
        actuators: Vec<usize>,
    },
    /// Illuminated samples that each actuator moves, with its influence on them.
    Measured(Vec<Vec<(u32, f64)>>),
}

impl MirrorShape {
    /// Of the mirror `influence` at the illuminated `samples`.
    pub(super) fn new(influence: &InfluenceFunctions, samples: &IlluminatedSamples) -> Self {
        let n = samples.samples;
        let coordinates_m: Vec<f64> = (0..n).map(|i| (i as f64 - (n as f64 - 1.0) / 2.0) * samples.pitch_m).collect();
        Self::at(influence, &samples.indices, &coordinates_m)
    }

    /// Of the mirror `influence` at the samples with these flat `indices`, on the square grid with
    /// these coordinates along both axes.
    pub(super) fn at(influence: &InfluenceFunctions, indices: &[usize], coordinates_m: &[f64]) -> Self {
        let functions = if influence.is_separable() {
            let (along, actuators) = influence.along(coordinates_m);
            Functions::Separable { along, actuators: actuators.to_vec() }
        } else {
            Functions::Measured(moved_samples(influence, indices, coordinates_m))
        };
        Self { samples: coordinates_m.len(), indices: indices.to_vec(), functions }
    }

    /// Number of illuminated samples.
    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.indices.len()
    }

    /// Shape of these commands at each illuminated sample, nm.
    pub(super) fn wavefront_nm(&self, commands_nm: ArrayView1<f64>) -> Array1<f64> {
        match &self.functions {
            Functions::Separable { along, actuators } => {
                let across = along.nrows();
                let mut commands = Array2::zeros((across, across));
                for (&actuator, &nm) in actuators.iter().zip(commands_nm) {
                    commands[[actuator / across, actuator % across]] = nm;
                }
                let shape = along.t().dot(&commands.dot(along));
                self.indices.iter().map(|&index| shape[[index / self.samples, index % self.samples]]).collect()
            }
            Functions::Measured(moved) => {
                let mut shape = Array1::zeros(self.indices.len());
                for (moved, nm) in moved.iter().zip(commands_nm) {
                    moved.iter().for_each(|&(sample, value)| shape[sample as usize] += nm * value);
                }
                shape
            }
        }
    }

    /// Map of values at the samples, `[y, x]`, 0 elsewhere.
    fn map(&self, values: ArrayView1<f64>) -> Array2<f64> {
        let mut map = Array2::zeros((self.samples, self.samples));
        for (&index, &value) in self.indices.iter().zip(values) {
            map[[index / self.samples, index % self.samples]] = value;
        }
        map
    }

    /// Sum over the samples, with these weights, of the products of the influence of each two
    /// actuators, `[actuator, actuator]`.
    pub(super) fn gram(&self, weights: &[f64]) -> Array2<f64> {
        match &self.functions {
            Functions::Separable { along, actuators } => {
                separable_gram(along, actuators, &self.map(ArrayView1::from(weights)))
            }
            Functions::Measured(moved) => {
                let mut movers: Vec<Vec<(usize, f64)>> = vec![Vec::new(); self.indices.len()];
                for (actuator, moved) in moved.iter().enumerate() {
                    moved.iter().for_each(|&(sample, value)| movers[sample as usize].push((actuator, value)));
                }
                let mut gram = Array2::zeros((moved.len(), moved.len()));
                for (movers, weight) in movers.iter().zip(weights) {
                    for (one, value) in movers {
                        movers.iter().for_each(|(other, its)| gram[[*one, *other]] += weight * value * its);
                    }
                }
                gram
            }
        }
    }

    /// Sum over the samples of a wavefront times the influence of each actuator: the transpose of
    /// [`MirrorShape::wavefront_nm`].
    pub(super) fn products(&self, wavefront_nm: ArrayView1<f64>) -> Array1<f64> {
        match &self.functions {
            Functions::Separable { along, actuators } => {
                let across = along.nrows();
                let products = along.dot(&self.map(wavefront_nm)).dot(&along.t());
                actuators.iter().map(|&actuator| products[[actuator / across, actuator % across]]).collect()
            }
            Functions::Measured(moved) => {
                let product = |&(sample, value): &(u32, f64)| value * wavefront_nm[sample as usize];
                moved.iter().map(|moved| moved.iter().map(product).sum()).collect()
            }
        }
    }
}

/// Sum over the samples, whose `weights` are a map, of the products of each two functions that are
/// products of one in x and one in y, `[actuator, actuator]`. Pairs of rows come first, then pairs
/// of columns, both within the reach of the functions.
fn separable_gram(along: &Array2<f64>, actuators: &[usize], weights: &Array2<f64>) -> Array2<f64> {
    let (across, n) = along.dim();
    let mut in_row: Vec<Vec<(usize, usize)>> = vec![Vec::new(); across];
    actuators.iter().enumerate().for_each(|(number, at)| in_row[at / across].push((at % across, number)));
    let reach = reach(along);
    let common = |i: usize, k: usize| reach[i].start.max(reach[k].start)..reach[i].end.min(reach[k].end);
    let mut gram = Array2::zeros((actuators.len(), actuators.len()));
    for (row, other) in (0..across).flat_map(|row| (row..across).map(move |other| (row, other))) {
        let mut columns = Array1::<f64>::zeros(n);
        for y in common(row, other) {
            columns.scaled_add(along[[row, y]] * along[[other, y]], &weights.row(y));
        }
        for (&(column, own), &(next, its)) in
            in_row[row].iter().flat_map(|own| in_row[other].iter().map(move |its| (own, its)))
        {
            let product = |x: usize| along[[column, x]] * along[[next, x]] * columns[x];
            let sum: f64 = common(column, next).map(product).sum();
            gram[[own, its]] = sum;
            gram[[its, own]] = sum;
        }
    }
    gram
}

/// Number of each of the samples with these flat `indices` that an actuator moves, and the
/// influence on it, on the square grid with these coordinates along both axes.
fn moved_samples(influence: &InfluenceFunctions, indices: &[usize], coordinates_m: &[f64]) -> Vec<Vec<(u32, f64)>> {
    let n = coordinates_m.len();
    let mut numbers = vec![None; n * n];
    indices.iter().zip(0u32..).for_each(|(&index, number)| numbers[index] = Some(number));
    let moved = influence.windows(coordinates_m).into_iter().map(|window| {
        let values = window.values.indexed_iter().filter(|(_, value)| **value != 0.0);
        let at = |(y, x): (usize, usize)| (window.rows.start + y) * n + window.columns.start + x;
        values.filter_map(|(place, &value)| Some((numbers[at(place)]?, value))).collect()
    });
    moved.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ao::Simulator;
    use crate::modes::MeasuredInfluence;
    use crate::retrieval::tests::scene;
    use crate::telescope::Telescope;

    #[test]
    fn the_shape_is_the_sum_of_the_influence_functions() {
        let simulator = Simulator::new(&scene()).unwrap();
        let cone = Array2::from_shape_fn((9, 9), |(y, x)| 5.0 - (x as f64 - 4.0).hypot(y as f64 - 4.0));
        let cone = MeasuredInfluence::common(cone.view(), 0.27 * simulator.influence().mirror().pitch_m()).unwrap();
        for influence in
            [simulator.influence().clone(), simulator.influence().clone().measured(std::sync::Arc::new(cone)).unwrap()]
        {
            check(&influence, simulator.telescope());
        }
    }

    fn check(influence: &InfluenceFunctions, telescope: &Telescope) {
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
        let shapes = influence.evaluate(&samples.xs_m, &samples.ys_m).unwrap();
        let expected = (&shapes * &ArrayView1::from(&samples.amplitude)).dot(&shapes.t());
        // What is out of reach is below 1e-8 of a function, at a few hundred samples.
        assert!((shape.gram(&samples.amplitude) - &expected).iter().all(|off| off.abs() < 1e-5));
        assert!(expected.diag().iter().all(|square| *square > 1e-2));
        // Of the transpose: sums of some thousand products, to the rounding of 100 nm × 100 nm.
        let other_nm = Array1::from_shape_fn(shape.len(), |i| 100.0 * (0.9 * i as f64).cos());
        let (forward, back) = (found_nm.dot(&other_nm), commands_nm.dot(&shape.products(other_nm.view())));
        assert!(forward.abs() > 1.0 && (forward - back).abs() < 1e-9 * forward.abs().max(1e4), "{forward} {back}");
    }
}

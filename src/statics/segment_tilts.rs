//! Detection of tilts of single segments, which neither pistons nor NCPA modes represent, in the
//! residual of the mean wavefront.

use super::mean_covariance::MeanCovariance;
use crate::Result;
use crate::linear_algebra::{combination, row_products};
use crate::retrieval::IlluminatedSamples;
use ndarray::{Array1, ArrayView1, ArrayView2, Axis};

/// Tilts of single segments in the residual of a mean wavefront.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentTilts {
    /// RMS over the pupil of the least-squares tilts, nm: a lower bound, because pistons and NCPA
    /// have absorbed a part.
    pub rms_nm: f64,
    /// Decrease of χ² per tilt, under the covariance of the mean wavefront.
    pub chi2: f64,
}

/// χ² per tilt above which tilts are significant. For 75 images of a Keck whose segments move in
/// piston alone it is 0.4, because the fit has absorbed a part; with tilts of 20 nm it is 15.
const SIGNIFICANT_CHI2: f64 = 3.0;

/// Residual of the least squares, over the right side, at which they are solved. χ² is then known
/// to the square of it, but for the condition of the equations, to a hundredth at worst in the
/// test: little beside the factors of 5 between its limit and what is found with and without tilts.
const TOLERANCE: f64 = 0.02;

/// Iterations after which the least squares end. χ² grows with each, so that it is too small then,
/// if anything.
const MAX_ITERATIONS: usize = 60;

impl SegmentTilts {
    /// Whether the tilts exceed the scatter of turbulence.
    pub fn is_significant(&self) -> bool {
        self.chi2 > SIGNIFICANT_CHI2
    }

    /// Estimates the tilts in the residual of the mean wavefront, nm at each sample, by the
    /// wavefronts `columns` of 1 nm of each, `[tilt, sample]`.
    pub(super) fn estimate(
        residual_nm: ArrayView1<f64>,
        columns: ArrayView2<f64>,
        covariance: &MeanCovariance,
        samples: &IlluminatedSamples,
    ) -> Result<Self> {
        let weighted = |wavefront_nm: ArrayView1<f64>| -> Result<Array1<f64>> {
            let solved = covariance.solve(wavefront_nm.insert_axis(Axis(0)))?;
            Ok(row_products(columns, solved.solution.row(0)))
        };
        let b = weighted(residual_nm)?;
        // Conjugate gradients, preconditioned by the squares of the columns, which differ where
        // segments are cut off. An inverse of the normal equations would take a solution under the
        // covariance for each tilt, and these take one for each iteration.
        let scale: Array1<f64> = columns
            .outer_iter()
            .map(|column| column.dot(&column))
            .map(|s| if s > 0.0 { 1.0 / s } else { 0.0 })
            .collect();
        let (mut tilts_nm, mut left) = (Array1::zeros(b.len()), b.clone());
        let mut direction = &scale * &left;
        let mut gain = left.dot(&direction);
        let wanted = gain * TOLERANCE * TOLERANCE;
        for _ in 0..MAX_ITERATIONS {
            if gain <= wanted {
                break;
            }
            let product = weighted(combination(direction.view(), columns).view())?;
            let step = gain / direction.dot(&product);
            tilts_nm.scaled_add(step, &direction);
            left.scaled_add(-step, &product);
            let scaled = &scale * &left;
            let next = left.dot(&scaled);
            direction = scaled + direction * (next / gain);
            gain = next;
        }
        let wavefront_nm = combination(tilts_nm.view(), columns);
        let weight: f64 = samples.amplitude.iter().sum();
        let square =
            wavefront_nm.iter().zip(&samples.amplitude).map(|(nm, amplitude)| amplitude * nm * nm).sum::<f64>()
                / weight;
        Ok(Self { rms_nm: square.sqrt(), chi2: b.dot(&tilts_nm) / b.len() as f64 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linear_algebra::SpdInverse;
    use crate::modes::tilt_frames;
    use crate::retrieval::tests::scene;
    use crate::statics::covariance::ResidualCovariance;
    use crate::telescope::Telescope;
    use ndarray::Array2;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn tilts_are_distinguished_from_chance() {
        let telescope = Telescope::new(&scene()).unwrap();
        let grid = telescope.pupil.grid;
        let weights = telescope.area_weights(grid).unwrap();
        let samples = IlluminatedSamples::new(grid.samples(), grid.pitch_m(), &weights).unwrap();
        let samples = samples.subset(&samples.select_bright(0.5));
        let mut rng = crate::source::stream(5, 0);
        let mut noise = |shape| {
            Array2::from_shape_simple_fn(shape, || {
                20.0 * {
                    let n: f64 = StandardNormal.sample(&mut rng);
                    n
                }
            })
        };
        let images = 25;
        let residual =
            ResidualCovariance::from_residuals(&samples, noise((images, samples.amplitude.len())).view()).unwrap();
        let covariance = MeanCovariance::new(&residual, images, 0.1, &samples);
        let chance = noise((1, samples.amplitude.len())).row(0).to_owned() / (images as f64).sqrt();
        let columns = samples.tilts(&tilt_frames(&telescope.pupil).unwrap());
        let none = SegmentTilts::estimate(chance.view(), columns.view(), &covariance, &samples).unwrap();
        // Fourteen unknowns: χ² of each scatters by √(2/14) = 0.4 about 1, as does the covariance
        // of so few images.
        assert!(!none.is_significant() && none.chi2 > 0.3, "{none:?}");
        // 10 nm RMS over every segment, along x.
        let count = samples.pistons.nrows();
        let along_x = Array1::from_shape_fn(2 * count, |k| if k < count { 10.0 } else { 0.0 });
        let tilted_nm = &chance + &along_x.dot(&columns);
        let tilted = SegmentTilts::estimate(tilted_nm.view(), columns.view(), &covariance, &samples).unwrap();
        // The least squares by their inverse.
        let weighted = covariance.solve(columns.view()).unwrap();
        let half = weighted.products(columns.view(), &weighted);
        let inverse = SpdInverse::of_normal_equations((&half + &half.t()) / 2.0).unwrap().inverse;
        for (residual_nm, found) in [(&chance, none), (&tilted_nm, tilted)] {
            let b = weighted.solution.dot(residual_nm);
            let chi2 = b.dot(&inverse.dot(&b)) / b.len() as f64;
            assert!((found.chi2 / chi2 - 1.0).abs() < 0.01, "{found:?} {chi2}");
        }
        // Chance adds, in quadrature, 4 nm over the root of the samples to an unknown, about 10.
        assert!(tilted.is_significant() && (tilted.rms_nm - 10.0).abs() < 1.0, "{tilted:?}");
    }
}

//! Detection of tilts of single segments, which neither pistons nor NCPA modes represent, in the residual of the mean wavefront.

use super::mean_covariance::MeanCovariance;
use crate::Result;
use crate::linear_algebra::SpdInverse;
use crate::retrieval::IlluminatedSamples;
use ndarray::{ArrayView1, ArrayView2};

/// Tilts of single segments in the residual of a mean wavefront.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentTilts {
    /// RMS over the pupil of the least-squares tilts, nm: a lower bound, because pistons and NCPA have absorbed a part.
    pub rms_nm: f64,
    /// Decrease of χ² per tilt, under the covariance of the mean wavefront.
    pub chi2: f64,
}

/// χ² per tilt above which tilts are significant. For 75 images of a Keck whose segments move in piston alone it is 0.4, because the
/// fit has absorbed a part; with tilts of 20 nm it is 15.
const SIGNIFICANT_CHI2: f64 = 3.0;

impl SegmentTilts {
    /// Whether the tilts exceed the scatter of turbulence.
    pub fn is_significant(&self) -> bool {
        self.chi2 > SIGNIFICANT_CHI2
    }

    /// Estimates the tilts in the residual of the mean wavefront, nm at each sample, by the wavefronts `columns` of 1 nm of each,
    /// `[tilt, sample]`.
    pub(super) fn estimate(
        residual_nm: ArrayView1<f64>,
        columns: ArrayView2<f64>,
        covariance: &MeanCovariance,
        samples: &IlluminatedSamples,
    ) -> Result<Self> {
        let weighted = covariance.solve(columns)?;
        let half = weighted.products(columns, &weighted);
        let information = SpdInverse::of_normal_equations((&half + &half.t()) / 2.0)?;
        let b = weighted.solution.dot(&residual_nm);
        let tilts_nm = information.inverse.dot(&b);
        let wavefront_nm = tilts_nm.dot(&columns);
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
    use crate::modes::tilt_frames;
    use crate::retrieval::tests::scene;
    use crate::statics::covariance::ResidualCovariance;
    use crate::telescope::Telescope;
    use ndarray::{Array1, Array2};
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
        // Fourteen unknowns: χ² of each scatters by √(2/14) = 0.4 about 1, as does the covariance of so few images.
        assert!(!none.is_significant() && none.chi2 > 0.3, "{none:?}");
        // 10 nm RMS over every segment, along x.
        let count = samples.pistons.nrows();
        let along_x = Array1::from_shape_fn(2 * count, |k| if k < count { 10.0 } else { 0.0 });
        let tilted_nm = &chance + &along_x.dot(&columns);
        let tilted = SegmentTilts::estimate(tilted_nm.view(), columns.view(), &covariance, &samples).unwrap();
        // Chance adds, in quadrature, 4 nm over the root of the samples to an unknown, about 10.
        assert!(tilted.is_significant() && (tilted.rms_nm - 10.0).abs() < 1.0, "{tilted:?}");
    }
}

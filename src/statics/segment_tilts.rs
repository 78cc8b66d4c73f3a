//! Tilts of single segments, which no piston and hardly a mode of the NCPA describes: are there any?

use super::covariance::MeanCovariance;
use crate::Result;
use crate::linear_algebra::Spd;
use crate::retrieval::LitSamples;
use ndarray::{Array2, ArrayView1};

/// What a mean phase holds of tilts of its segments once everything that was sought is taken out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentTilts {
    /// RMS of the tilts over the pupil that fit best, nm: less than there is, for pistons and NCPA have taken their share.
    pub rms_nm: f64,
    /// χ² that they take off for each of their unknowns, under the covariance of the turbulence's mean.
    pub chi2: f64,
}

/// χ² for each tilt beyond which they are no chance. Behind 75 images of a Keck whose segments move in piston alone it is
/// 0.4, for the fit has taken its share; with tilts of 20 nm it is 15.
const THERE: f64 = 3.0;

impl SegmentTilts {
    /// Whether they are there for all that turbulence may do.
    pub fn are_there(&self) -> bool {
        self.chi2 > THERE
    }

    /// Of what is left of the mean phase, nm at each sample.
    pub(super) fn of(left_nm: ArrayView1<f64>, covariance: &MeanCovariance, lit: &LitSamples) -> Result<Self> {
        let columns = columns(lit);
        let solved = covariance.solve(columns.view())?;
        let half = solved.dot(&columns.t());
        let mut information = (&half + &half.t()) / 2.0;
        // Segments of which hardly a sample shows have no tilt to speak of.
        let faint = 1e-9 * information.diag().iter().copied().fold(0.0, f64::max);
        information.diag_mut().iter_mut().for_each(|value| *value += faint);
        let b = solved.dot(&left_nm);
        let tilts_nm = Spd::of(&information)?.inverse.dot(&b);
        let shown_nm = tilts_nm.dot(&columns);
        let weight: f64 = lit.glass.iter().sum();
        let square = shown_nm.iter().zip(&lit.glass).map(|(nm, glass)| glass * nm * nm).sum::<f64>() / weight;
        Ok(Self { rms_nm: square.sqrt(), chi2: b.dot(&tilts_nm) / b.len() as f64 })
    }
}

/// Tilts of each segment about its middle along x and y, of 1 nm RMS over it: `[tilt, sample]`.
fn columns(lit: &LitSamples) -> Array2<f64> {
    let segments = lit.pistons.nrows();
    let mut columns = Array2::zeros((2 * segments, lit.glass.len()));
    for (segment, shares) in lit.pistons.outer_iter().enumerate() {
        for (axis, along_m) in [&lit.xs_m, &lit.ys_m].into_iter().enumerate() {
            let mean = |value: &dyn Fn(usize) -> f64| {
                let sum: f64 = shares.iter().enumerate().map(|(sample, share)| share * value(sample)).sum();
                sum / shares.sum()
            };
            let middle_m = mean(&|sample| along_m[sample]);
            let rms_m = mean(&|sample| (along_m[sample] - middle_m).powi(2)).sqrt();
            let mut column = columns.row_mut(2 * segment + axis);
            for ((out, share), along_m) in column.iter_mut().zip(shares).zip(along_m) {
                *out = share * (along_m - middle_m) / rms_m;
            }
        }
    }
    columns
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::retrieval::tests::scene;
    use crate::statics::ResidualCovariance;
    use crate::telescope::Telescope;
    use ndarray::Array1;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn tilts_are_told_from_chance() {
        let telescope = Telescope::of(&scene()).unwrap();
        let grid = telescope.pupil.grid;
        let weights = telescope.area_weights(grid).unwrap();
        let lit = LitSamples::of(grid.samples(), grid.pitch_m(), &weights).unwrap();
        let lit = lit.selected(&lit.with_glass(0.5));
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
        let residual = ResidualCovariance::of_scatter(&lit, noise((images, lit.glass.len())).view()).unwrap();
        let covariance = residual.of_mean(images, 0.1, &lit);
        let chance = noise((1, lit.glass.len())).row(0).to_owned() / (images as f64).sqrt();
        let none = SegmentTilts::of(chance.view(), &covariance, &lit).unwrap();
        // Fourteen unknowns: χ² of each scatters by √(2/14) = 0.4 about 1, as does the covariance of so few images.
        assert!(!none.are_there() && none.chi2 > 0.3, "{none:?}");
        // 10 nm RMS over every segment, along x.
        let along_x = Array1::from_shape_fn(2 * lit.pistons.nrows(), |k| if k % 2 == 0 { 10.0 } else { 0.0 });
        let tilted = SegmentTilts::of((&chance + &along_x.dot(&columns(&lit))).view(), &covariance, &lit).unwrap();
        // What chance adds, in quadrature: 4 nm over the root of the samples to an unknown, about 10.
        assert!(tilted.are_there() && (tilted.rms_nm - 10.0).abs() < 1.0, "{tilted:?}");
    }
}

//! Fisher matrix of an image (the Gauss-Newton matrix JᵀWJ), and the covariance of the modes that
//! follows from it.

use crate::Result;
use crate::imaging::{CpuChain, LinearModel, Photometry};
use crate::linear_algebra::times_transposed;
use crate::modal::solve::gauss_newton::{NuisanceShares, Nuisances, products, rows_of_tile};
use crate::optimize::Metric;
use ndarray::{Array1, Array2, ArrayView1, Axis};

/// Eigenvalues below this fraction of the largest are null directions (global piston: exactly null
/// up to rounding, about 1e-15; the weakest real direction of 36 pistons and 66 modes has 1e-3).
const NULL_FLOOR: f64 = 1e-11;

/// The fraction of the largest eigenvalue below which an eigenvalue of a matrix of `modes`
/// directions, summed over `pixels`, is null. Rounding leaves some ε·√pixels in each entry of a sum
/// over pixels, and so modes times that in an eigenvalue at most: 2,468 modes of 256×256 pixels
/// gave −2e-11, for which a fixed floor of 1e-11 reports an error.
pub(in crate::modal) fn null_floor(modes: usize, pixels: usize) -> f64 {
    NULL_FLOOR.max(modes as f64 * (pixels as f64).sqrt() * f64::EPSILON)
}

/// Fisher matrix of one image at one point, and the propagation of its noise.
pub(in crate::modal) struct Sensitivity {
    /// Jᵀ W J, `[mode, mode]`, per nm², with J orthogonalised to a fitted flux and background.
    pub(in crate::modal) fisher: Array2<f64>,
    /// Jᵀ W V W J, where the weights are not the inverse variances.
    noise: Option<Array2<f64>>,
    /// See [`null_floor`].
    floor: f64,
}

impl Sensitivity {
    /// Computed at `coefficients_nm`, for a star of `flux_e` and the given weights. `variance_e2`
    /// is that of the pixels (infinite where the weight is 0), or `None` where the weights are the
    /// inverse variances. `tile_bytes` of derivatives at a time.
    pub(in crate::modal) fn at(
        reference: &CpuChain<f64>,
        coefficients_nm: ArrayView1<f64>,
        flux_e: f64,
        (weight, variance_e2): (&[f64], Option<&[f64]>),
        photometry: Photometry,
        tile_bytes: usize,
    ) -> Self {
        let linear = reference.linearise(coefficients_nm);
        Self::of(&linear, &[], flux_e, (weight, variance_e2), photometry, tile_bytes)
    }

    /// As [`Sensitivity::at`], of `linear`, with `further` unknowns behind the modes: derivatives
    /// of the PSF at all pixels.
    pub(in crate::modal) fn of(
        linear: &LinearModel,
        further: &[Array1<f64>],
        flux_e: f64,
        (weight, variance_e2): (&[f64], Option<&[f64]>),
        photometry: Photometry,
        tile_bytes: usize,
    ) -> Self {
        let nuisances = match photometry {
            Photometry::Fixed { .. } => Nuisances::None,
            Photometry::FitFlux { .. } => Nuisances::Flux,
            Photometry::FitBoth => Nuisances::FluxAndBackground,
        };
        // In units of the flux the derivatives are those of the PSF.
        let square = flux_e * flux_e;
        let mut weights = vec![weight.iter().map(|w| w * square).collect::<Vec<f64>>()];
        weights.extend(variance_e2.map(|variance_e2| {
            let spread = weight.iter().zip(variance_e2).map(|(&w, &v)| if w > 0.0 { w * w * v * square } else { 0.0 });
            spread.collect()
        }));
        let modes = linear.unknowns() + further.len();
        let rows = rows_of_tile(modes, linear.pixels(), tile_bytes);
        let mut found = products(linear, further, nuisances, &weights, rows).into_iter();
        let fisher = found.next().unwrap_or_default();
        let shares = NuisanceShares::new(&fisher, nuisances);
        let noise = found.next().map(|noise| shares.project_out(noise));
        Self { fisher: shares.project_out(fisher), noise, floor: null_floor(modes, weight.len()) }
    }

    /// Covariance of the modes, nm². Where the weights are the inverse variances it is the inverse
    /// of `fisher`; otherwise F⁻¹ (Jᵀ W V W J) F⁻¹. Null directions carry no error: the fit does
    /// not move along them.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode changes the image.
    pub(in crate::modal) fn covariance(&self) -> Result<Array2<f64>> {
        let inverse = pseudo_inverse(&self.fisher, self.floor)?;
        let Some(noise) = &self.noise else { return Ok(inverse) };
        // Both are symmetric.
        let half = times_transposed(inverse.view(), noise.view());
        Ok(times_transposed(half.view(), inverse.view()))
    }
}

/// F⁻¹ in the directions whose eigenvalue is above `floor`, a fraction of the largest.
///
/// # Errors
/// [`crate::Error::Value`] where no direction changes the image.
pub(in crate::modal) fn pseudo_inverse(fisher: &Array2<f64>, floor: f64) -> Result<Array2<f64>> {
    let root = root_of_pseudo_inverse(fisher, floor)?;
    Ok(times_transposed(root.view(), root.view()))
}

/// R, `[mode, direction]`, with R·Rᵀ the [`pseudo_inverse`]. Its columns span the directions that
/// are not null.
///
/// # Errors
/// As [`pseudo_inverse`].
pub(in crate::modal) fn root_of_pseudo_inverse(fisher: &Array2<f64>, floor: f64) -> Result<Array2<f64>> {
    let (metric, scale) = scaled_metric(fisher, floor)?;
    Ok(metric.whitening().map(|whitening| &whitening * &scale.insert_axis(Axis(1))).unwrap_or_default())
}

/// `information` of the modes where amounts of `directions` (rows) are unknown. Modes of which
/// rounding alone is left have none.
pub(in crate::modal) fn without(information: Array2<f64>, directions: &Array2<f64>) -> Array2<f64> {
    let before = information.diag().to_owned();
    let mut left = directions.outer_iter().fold(information, |information, direction| {
        let along = information.dot(&direction);
        let own = direction.dot(&along);
        if own <= 0.0 {
            return information;
        }
        let column = along.insert_axis(Axis(1));
        information - column.dot(&column.t()) / own
    });
    for (mode, before) in before.into_iter().enumerate() {
        if left[[mode, mode]] <= NULL_FLOOR * before {
            left.row_mut(mode).fill(0.0);
            left.column_mut(mode).fill(0.0);
        }
    }
    left
}

/// The `score` of the modes, g of g·x − ½ x·`information`·x, at the best amounts of `directions`
/// (rows), each other mode as it is.
pub(in crate::modal) fn score_without(
    information: &Array2<f64>,
    score: Array1<f64>,
    directions: &Array2<f64>,
) -> Array1<f64> {
    let along = directions.dot(information);
    let own = along.dot(&directions.t());
    // No step along directions that change nothing.
    let amounts = pseudo_inverse(&own, NULL_FLOOR).map(|inverse| inverse.dot(&directions.dot(&score)));
    amounts.map_or(score.clone(), |amounts| score - along.t().dot(&amounts))
}

/// Number of directions of `information` whose eigenvalue is above `floor`, as [`pseudo_inverse`]
/// has it; 0 where none is.
pub(in crate::modal) fn rank(information: &Array2<f64>, floor: f64) -> usize {
    scaled_metric(information, floor).map_or(0, |(metric, _)| metric.rank())
}

/// Metric of a matrix that is scaled to a unit diagonal, so that "null" does not depend on the
/// units of a mode, and the scale.
fn scaled_metric(matrix: &Array2<f64>, floor: f64) -> Result<(Metric, Array1<f64>)> {
    let scale = matrix.diag().mapv(|f| if f > 0.0 { f.sqrt().recip() } else { 0.0 });
    let scaled = matrix * &scale.view().insert_axis(Axis(1)) * scale.view().insert_axis(Axis(0));
    Ok((Metric::from_gauss_newton(&scaled, floor)?, scale))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::array;

    #[test]
    fn scores_are_taken_at_the_best_amounts_of_the_directions() {
        let information = array![[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];
        let directions = array![[1.0, 0.5, 0.0], [0.0, 0.0, 0.0]];
        let score = array![0.3, -1.0, 0.7];
        let left = score_without(&information, score.clone(), &directions);
        // No slope is left along the direction, and one that changes nothing takes none.
        assert!(directions.dot(&left).iter().all(|slope| slope.abs() < 1e-14), "{left}");
        let amount = directions.row(0).dot(&score) / directions.row(0).dot(&information.dot(&directions.row(0)));
        let expected = &score - &information.dot(&directions.row(0)) * amount;
        assert!((&left - &expected).iter().all(|off| off.abs() < 1e-14), "{left} {expected}");
        // A change along the direction alone leaves nothing.
        let along = information.dot(&directions.row(0));
        assert!(score_without(&information, along, &directions).iter().all(|slope| slope.abs() < 1e-14));
    }
}

//! Fisher information of wavefront sensor slopes on the NCPA: weighted least squares of the
//! differences between the slopes of the retrieved wavefronts and the measured ones.
//!
//! Slopes are weighted by their scatter from image to image, and modes along the singular vectors
//! of the sensor's response, each by its own scatter. So directions with little response get next
//! to no weight, and the modes may be many. The error of the sensor model is estimated from the
//! data too: the part of the mean over images that no mode explains, beyond its scatter, does not
//! average over images.
//!
//! Differences follow the turbulence, too. A loop takes the sum of a wavefront's low orders and of
//! its aliases out of the slopes, so that the low orders are the aliases with the opposite sign; a
//! retrieval shrinks the high frequencies that alias, and the slopes of the retrieved wavefront
//! keep a share of the low orders: 3 % on Keck, 8 % on TMT, where that is a fourth of the variance
//! of the differences and half of what one image has in common with the next. The share is found by
//! regression, image by image. In the mean over the images it is a share of the turbulence's own
//! mean, the *common path* of the mean wavefront.

use super::serial_correlation::mean_variance_factors;
use crate::Result;
use crate::ao::{Svd, svd};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};

/// Weight, in images, of the mean variance of all slopes in the variance of each (shrinkage): from
/// three images alone some slopes would seem ten times more precise than others.
const COMMON_IMAGES: f64 = 4.0;

/// Least scatter of a slope, mas: copies of one image would have none.
const MIN_SCATTER_MAS: f64 = 1e-3;
/// Least scatter along a singular vector, in units of the slopes' scatter.
const MIN_SCATTER: f64 = 1e-3;

/// Normal equations of the NCPA, and a share of the common path, from wavefronts and slopes, for
/// modes in nm.
#[derive(Debug, Clone)]
pub struct SlopeInformation {
    /// Fisher information on the modes, nm⁻².
    pub information: Array2<f64>,
    /// Right side: the information times the estimated modes, nm⁻¹.
    pub right_side: Array1<f64>,
    /// Modes that the slopes hold for 1 nm of the common path, nm; 0 where it is theirs alone.
    pub common_path_share: f64,
    /// Error of the sensor model in each slope, RMS, mas.
    #[allow(dead_code, reason = "a diagnostic, which only the test of this file reads")]
    pub model_error_mas: f64,
}

impl SlopeInformation {
    /// The same estimate with an error along `shape_nm`, one standard deviation, that is
    /// independent of those it has: v·vᵀ is added to the covariance C. By Sherman and Morrison
    /// (1950) the information I = C⁻¹ loses Iv·vᵀI/(1 + vᵀIv).
    pub(super) fn with_uncertainty_along(self, shape_nm: ArrayView1<f64>) -> Self {
        let row = self.information.dot(&shape_nm);
        let shrink = 1.0 / (1.0 + shape_nm.dot(&row));
        let column = row.view().insert_axis(Axis(1));
        Self {
            information: &self.information - column.dot(&column.t()) * shrink,
            right_side: &self.right_side - &row * (shrink * shape_nm.dot(&self.right_side)),
            ..self
        }
    }
}

/// Linear response of a sensor's slopes to modes.
pub(super) struct SensorResponse {
    /// Slopes for 1 nm of each mode, `[mode, slope]`, mas.
    pub(super) response_mas: Array2<f64>,
}

impl SensorResponse {
    /// From the slopes for 1 nm of each mode, `[mode, slope]`, mas.
    pub(super) fn new(response_mas: Array2<f64>) -> Self {
        Self { response_mas }
    }

    /// Information on all modes of the slopes in `difference_mas` (`[image, slope]`), which remain
    /// beyond modes `known_nm`, and of which a share follows `turbulence_nm`, the images'
    /// wavefronts in the modes (`[image, mode]`).
    ///
    /// # Errors
    /// Where the response cannot be decomposed.
    pub(super) fn information(
        &self,
        difference_mas: ArrayView2<f64>,
        turbulence_nm: ArrayView2<f64>,
        known_nm: &[f64],
    ) -> Result<SlopeInformation> {
        let images = difference_mas.nrows() as f64;
        let freedom = (images - 1.0).max(1.0);
        let square = |values: ArrayView1<f64>| values.dot(&values);
        // In units of each slope's own scatter: partly illuminated subapertures are less precise.
        let units_mas = |scatter_mas: &Array2<f64>| {
            let own_mas2: Array1<f64> = scatter_mas.axis_iter(Axis(1)).map(square).collect();
            shrunk(&own_mas2, freedom, MIN_SCATTER_MAS).mapv(f64::sqrt)
        };
        let mean_mas = difference_mas.sum_axis(Axis(0)) / images;
        let mut scatter_mas = &difference_mas - &mean_mas;
        let moving_nm = &turbulence_nm - &(turbulence_nm.sum_axis(Axis(0)) / images);
        let moving_mas = moving_nm.dot(&self.response_mas);
        let common_path_share = regression(&moving_mas, &scatter_mas, &units_mas(&scatter_mas));
        scatter_mas.scaled_add(-common_path_share, &moving_mas);
        let unit_mas = units_mas(&scatter_mas);
        let Svd { left, values, right } = svd(&(&self.response_mas / &unit_mas))?;
        let (mean, scatter) = (mean_mas / &unit_mas, scatter_mas / &unit_mas);
        let modal = mean.dot(&right);
        let modal_scatter = scatter.dot(&right);
        let modal_squares: Array1<f64> = modal_scatter.axis_iter(Axis(1)).map(square).collect();
        // Along singular vectors, which are in the order of their singular values, modes of like
        // spatial frequencies are beside each other.
        let factors = mean_variance_factors(modal_scatter.view());
        let others = (unit_mas.len() - values.len()).max(1) as f64;
        let all_squares: f64 = scatter.iter().map(|value| value * value).sum();
        let other_variance = (all_squares - modal_squares.sum()).max(0.0) / (freedom * others);
        let unexplained = &mean - &right.dot(&modal);
        let model_variance = (square(unexplained.view()) / others - other_variance / images).max(0.0);
        let mean_variances = shrunk(&modal_squares, freedom, MIN_SCATTER) * factors / images;
        let weights = mean_variances.mapv(|variance| 1.0 / (variance + model_variance));
        let values = Array1::from(values);
        let weighted = &left * &(&values * &weights);
        let information = (&weighted * &values).dot(&left.t());
        let right_side = information.dot(&ArrayView1::from(known_nm)) + weighted.dot(&modal);
        let model_error_mas = (model_variance * square(unit_mas.view()) / unit_mas.len() as f64).sqrt();
        Ok(SlopeInformation { information, right_side, common_path_share, model_error_mas })
    }
}

/// Regression of `values` on `cause` (both `[image, slope]`), each slope in its own unit; 0 without
/// a cause.
fn regression(cause: &Array2<f64>, values: &Array2<f64>, units: &Array1<f64>) -> f64 {
    let in_units = cause / units;
    let square: f64 = in_units.iter().map(|value| value * value).sum();
    if square > 0.0 { (in_units * (values / units)).sum() / square } else { 0.0 }
}

/// Estimates variances from sums of squares with `freedom` degrees of freedom each, shrunk towards
/// their mean as by [`COMMON_IMAGES`] more images, and no less than `least²`.
fn shrunk(squares: &Array1<f64>, freedom: f64, least: f64) -> Array1<f64> {
    let common = squares.sum() / (freedom * squares.len().max(1) as f64);
    squares.mapv(|own| ((own + COMMON_IMAGES * common) / (freedom + COMMON_IMAGES)).max(least * least))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    const SLOPES: usize = 80;

    /// Three modes, the last measured a thousand times less.
    fn slopes_mas_per_nm() -> Array2<f64> {
        let wave = |mode: usize, slope: usize| ((mode + 1) as f64 * 0.37 * slope as f64).sin();
        Array2::from_shape_fn((3, SLOPES), |(mode, slope)| [0.1, 0.05, 1e-4][mode] * wave(mode, slope))
    }

    fn differences(images: usize, modes_nm: [f64; 3], noise_mas: f64, error_mas: f64) -> Array2<f64> {
        let mut rng = crate::source::stream(9, images as u64);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let shape: Vec<f64> = (0..SLOPES).map(|_| error_mas * normal()).collect();
        let exact = ndarray::arr1(&modes_nm).dot(&slopes_mas_per_nm());
        Array2::from_shape_fn((images, SLOPES), |(_, slope)| exact[slope] + shape[slope] + noise_mas * normal())
    }

    /// Images without turbulence.
    fn still(images: usize) -> Array2<f64> {
        Array2::zeros((images, 3))
    }

    fn solved(slopes: &SlopeInformation, prior_nm: f64) -> (Array1<f64>, Vec<f64>) {
        let mut matrix = slopes.information.clone();
        matrix.diag_mut().iter_mut().for_each(|value| *value += prior_nm.powi(-2));
        let inverse = crate::linear_algebra::SpdInverse::new(&matrix).unwrap().inverse;
        (inverse.dot(&slopes.right_side), inverse.diag().iter().map(|nm2| nm2.sqrt()).collect())
    }

    #[test]
    fn measured_modes_are_within_error_bars_and_others_unknown() {
        let response = SensorResponse::new(slopes_mas_per_nm());
        let slopes = response
            .information(differences(40, [12.0, -7.0, 3.0], 1.0, 0.0).view(), still(40).view(), &[0.0; 3])
            .unwrap();
        let (found_nm, sigma_nm) = solved(&slopes, 100.0);
        // Noise of 1 mas in 40 images and 80 slopes of half the power of a sine: 1/√(1600)/0.1 =
        // 0.25 nm and twice that.
        assert!((sigma_nm[0] / 0.25 - 1.0).abs() < 0.3 && (sigma_nm[1] / 0.5 - 1.0).abs() < 0.3, "{sigma_nm:?}");
        assert!((found_nm[0] - 12.0).abs() < 3.0 * sigma_nm[0] && (found_nm[1] + 7.0).abs() < 3.0 * sigma_nm[1]);
        assert!(sigma_nm[2] > 90.0);
        // Differences about known modes give the same estimate.
        let about = response
            .information(differences(40, [2.0, -7.0, 3.0], 1.0, 0.0).view(), still(40).view(), &[10.0, 0.0, 0.0])
            .unwrap();
        assert!((solved(&about, 100.0).0[0] - found_nm[0]).abs() < 1e-2);
    }

    #[test]
    fn fraction_of_turbulence_is_found_and_adds_no_scatter() {
        let mut rng = crate::source::stream(9, 7);
        let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
        let turbulence_nm = Array2::from_shape_simple_fn((40, 3), || 50.0 * normal());
        let response = SensorResponse::new(slopes_mas_per_nm());
        let alone = differences(40, [12.0, -7.0, 3.0], 1.0, 0.0);
        let following = &alone + &(turbulence_nm.dot(&slopes_mas_per_nm()) * 0.1);
        let found = response.information(following.view(), turbulence_nm.view(), &[0.0; 3]).unwrap();
        // The modes move 80 slopes by 3 mas, noise by 1: 1/√3200/3 = 0.006 of the turbulence.
        assert!((found.common_path_share - 0.1).abs() < 0.02, "{}", found.common_path_share);
        let (found_nm, sigma_nm) = solved(&found, 100.0);
        let (alone_nm, alone_sigma_nm) =
            solved(&response.information(alone.view(), still(40).view(), &[0.0; 3]).unwrap(), 100.0);
        // The estimate holds its share of the turbulence's mean, the error bars nothing: they are
        // those without turbulence, but for the one number that was fitted.
        let mean_nm = turbulence_nm.mean_axis(Axis(0)).unwrap();
        for mode in 0..2 {
            assert!(
                (found_nm[mode] - 0.1 * mean_nm[mode] - alone_nm[mode]).abs() < 0.1 * sigma_nm[mode],
                "{found_nm} {alone_nm}"
            );
            assert!((sigma_nm[mode] / alone_sigma_nm[mode] - 1.0).abs() < 0.02, "{sigma_nm:?} {alone_sigma_nm:?}");
        }
    }

    #[test]
    fn an_error_of_the_sensor_model_does_not_average() {
        let response = SensorResponse::new(slopes_mas_per_nm());
        let slopes = response
            .information(differences(400, [12.0, -7.0, 0.0], 1.0, 1.0).view(), still(400).view(), &[0.0; 3])
            .unwrap();
        // 77 slopes determine a variance to √(2/77) = 16 %.
        assert!((slopes.model_error_mas - 1.0).abs() < 0.25, "{}", slopes.model_error_mas);
        let (found_nm, sigma_nm) = solved(&slopes, 100.0);
        // That of one image: √400 times the noise's 0.079 nm.
        assert!((sigma_nm[0] / 1.58 - 1.0).abs() < 0.3, "{sigma_nm:?}");
        assert!((found_nm[0] - 12.0).abs() < 3.0 * sigma_nm[0], "{found_nm}");
    }

    #[test]
    fn shape_uncertainty_adds_to_the_covariance_not_the_estimate() {
        let response = SensorResponse::new(slopes_mas_per_nm());
        let slopes = response
            .information(differences(40, [12.0, -7.0, 3.0], 1.0, 0.0).view(), still(40).view(), &[0.0; 3])
            .unwrap();
        let covariance =
            |slopes: &SlopeInformation| crate::linear_algebra::SpdInverse::new(&slopes.information).unwrap().inverse;
        let shape_nm = ndarray::arr1(&[2.0, -1.0, 0.5]);
        let wider = slopes.clone().with_uncertainty_along(shape_nm.view());
        let (before, after) = (covariance(&slopes), covariance(&wider));
        // The third mode is known a thousand times less, so that inverses have errors of 10⁶
        // roundings.
        let (found_nm, still_nm) = (before.dot(&slopes.right_side), after.dot(&wider.right_side));
        for ((i, j), value) in after.indexed_iter() {
            let expected = before[[i, j]] + shape_nm[i] * shape_nm[j];
            assert!(
                (value - expected).abs() < 1e-8 * before[[i, i]].max(before[[j, j]]),
                "{i} {j}: {value} {expected}"
            );
        }
        assert!((found_nm - still_nm).iter().all(|nm| nm.abs() < 1e-6));
    }

    #[test]
    fn copies_of_one_image_have_finite_information() {
        let one = differences(1, [12.0, -7.0, 0.0], 0.0, 0.0);
        let copies = ndarray::concatenate(Axis(0), &[one.view(), one.view(), one.view()]).unwrap();
        let slopes =
            SensorResponse::new(slopes_mas_per_nm()).information(copies.view(), still(3).view(), &[0.0; 3]).unwrap();
        let (found_nm, sigma_nm) = solved(&slopes, 100.0);
        // Without noise the error is rounding and the prior's pull: (σ/100 nm)² of it.
        assert!((found_nm[0] - 12.0).abs() < 1e-6 && (found_nm[1] + 7.0).abs() < 1e-6, "{found_nm}");
        assert!(sigma_nm.iter().all(|nm| nm.is_finite() && *nm > 0.0), "{sigma_nm:?}");
    }
}

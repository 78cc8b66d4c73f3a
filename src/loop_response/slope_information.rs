//! What slopes that the wavefront sensor did not measure, though the phases behind the images would give them, say of the
//! NCPA.
//!
//! Slopes are weighed by their scatter from image to image, and modes in the directions in which slopes tell them apart (the
//! singular vectors of the sensor's response), each by its own scatter: what slopes hardly show gets next to no weight, and
//! modes may be many. How far the model of the sensor is to be trusted is read from the data too: the mean over images has
//! slopes that no mode explains, and what they are beyond their scatter is error that more images do not average.

use crate::Result;
use crate::ao::{Svd, svd};
use ndarray::{Array1, Array2, ArrayView1, ArrayView2, Axis};

/// A slope's scatter is known from its own images and as if from so many more that scatter like the mean slope: three images
/// would make some seem ten times surer than others.
const COMMON_IMAGES: f64 = 4.0;

/// Least scatter of a slope, mas, and of a direction, in units of its slopes': copies of one image are not infinitely sure.
const LEAST_MAS: f64 = 1e-3;
const LEAST: f64 = 1e-3;

/// NCPA as phases and slopes together show them: their normal equations, for modes in nm.
#[derive(Debug, Clone)]
pub struct Sensed {
    /// Information on the modes, per nm².
    pub information: Array2<f64>,
    /// That times the modes, per nm.
    pub b: Array1<f64>,
    /// Error of the model of the sensor in each slope, RMS, mas.
    pub model_mas: f64,
}

/// A sensor's response to modes.
pub(super) struct Response {
    /// Slopes for 1 nm of each mode, `[mode, slope]`, mas.
    response_mas: Array2<f64>,
}

impl Response {
    /// Of slopes for 1 nm of each mode, `[mode, slope]`, mas.
    pub(super) fn of(response_mas: Array2<f64>) -> Self {
        Self { response_mas }
    }

    /// What slopes beyond those that `known_nm` explain, `[image, slope]` in mas, say of all modes.
    ///
    /// # Errors
    /// Where the response cannot be decomposed.
    pub(super) fn sensed(&self, unseen_mas: ArrayView2<f64>, known_nm: &[f64]) -> Result<Sensed> {
        let images = unseen_mas.nrows() as f64;
        let freedom = (images - 1.0).max(1.0);
        let squares = |of: ArrayView1<f64>| of.dot(&of);
        let mean_mas = unseen_mas.sum_axis(Axis(0)) / images;
        let scatter_mas = &unseen_mas - &mean_mas;
        // Each slope in units of its own scatter: lenslets that the pupil hardly lights know less.
        let own_mas2: Array1<f64> = scatter_mas.axis_iter(Axis(1)).map(squares).collect();
        let unit_mas = shrunk(&own_mas2, freedom, LEAST_MAS).mapv(f64::sqrt);
        let Svd { left, values, right } = svd(&(&self.response_mas / &unit_mas))?;
        let (mean, scatter) = (mean_mas / &unit_mas, scatter_mas / &unit_mas);
        let seen = mean.dot(&right);
        let seen_squares: Array1<f64> = scatter.dot(&right).axis_iter(Axis(1)).map(squares).collect();
        let others = (unit_mas.len() - values.len()).max(1) as f64;
        let all_squares: f64 = scatter.iter().map(|value| value * value).sum();
        let other_variance = (all_squares - seen_squares.sum()).max(0.0) / (freedom * others);
        let unexplained = &mean - &right.dot(&seen);
        let model_variance = (squares(unexplained.view()) / others - other_variance / images).max(0.0);
        let weights = shrunk(&seen_squares, freedom, LEAST).mapv(|variance| 1.0 / (variance / images + model_variance));
        let values = Array1::from(values);
        let weighted = &left * &(&values * &weights);
        let information = (&weighted * &values).dot(&left.t());
        let b = information.dot(&ArrayView1::from(known_nm)) + weighted.dot(&seen);
        let model_mas = (model_variance * squares(unit_mas.view()) / unit_mas.len() as f64).sqrt();
        Ok(Sensed { information, b, model_mas })
    }
}

/// Variances from sums of squares with `freedom` degrees of freedom each: as if [`COMMON_IMAGES`] more images had scattered like
/// the mean of all, and by `least` or more.
fn shrunk(squares: &Array1<f64>, freedom: f64, least: f64) -> Array1<f64> {
    let common = squares.sum() / (freedom * squares.len().max(1) as f64);
    squares.mapv(|own| ((own + COMMON_IMAGES * common) / (freedom + COMMON_IMAGES)).max(least * least))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};

    const SLOPES: usize = 80;

    /// Three modes, the last seen a thousand times less.
    fn response() -> Array2<f64> {
        let wave = |mode: usize, slope: usize| ((mode + 1) as f64 * 0.37 * slope as f64).sin();
        Array2::from_shape_fn((3, SLOPES), |(mode, slope)| [0.1, 0.05, 1e-4][mode] * wave(mode, slope))
    }

    fn unseen(images: usize, modes_nm: [f64; 3], noise_mas: f64, error_mas: f64) -> Array2<f64> {
        let mut rng = crate::source::stream(9, images as u64);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let shape: Vec<f64> = (0..SLOPES).map(|_| error_mas * normal()).collect();
        let exact = ndarray::arr1(&modes_nm).dot(&response());
        Array2::from_shape_fn((images, SLOPES), |(_, slope)| exact[slope] + shape[slope] + noise_mas * normal())
    }

    fn solved(sensed: &Sensed, prior_nm: f64) -> (Array1<f64>, Vec<f64>) {
        let mut matrix = sensed.information.clone();
        matrix.diag_mut().iter_mut().for_each(|value| *value += prior_nm.powi(-2));
        let inverse = crate::linear_algebra::Spd::of(&matrix).unwrap().inverse;
        (inverse.dot(&sensed.b), inverse.diag().iter().map(|nm2| nm2.sqrt()).collect())
    }

    #[test]
    fn modes_come_back_within_their_error_bars_and_what_is_not_seen_stays_unknown() {
        let directions = Response::of(response());
        let sensed = directions.sensed(unseen(40, [12.0, -7.0, 3.0], 1.0, 0.0).view(), &[0.0; 3]).unwrap();
        let (found_nm, sigma_nm) = solved(&sensed, 100.0);
        // Noise of 1 mas in 40 images and 80 slopes of half the power of a sine: 1/√(1600)/0.1 = 0.25 nm and twice that.
        assert!((sigma_nm[0] / 0.25 - 1.0).abs() < 0.3 && (sigma_nm[1] / 0.5 - 1.0).abs() < 0.3, "{sigma_nm:?}");
        assert!((found_nm[0] - 12.0).abs() < 3.0 * sigma_nm[0] && (found_nm[1] + 7.0).abs() < 3.0 * sigma_nm[1]);
        assert!(sigma_nm[2] > 90.0);
        // About what is known already the same comes out: there slopes show the rest.
        let about = directions.sensed(unseen(40, [2.0, -7.0, 3.0], 1.0, 0.0).view(), &[10.0, 0.0, 0.0]).unwrap();
        assert!((solved(&about, 100.0).0[0] - found_nm[0]).abs() < 1e-2);
    }

    #[test]
    fn an_error_of_the_sensors_model_does_not_average_out() {
        let directions = Response::of(response());
        let sensed = directions.sensed(unseen(400, [12.0, -7.0, 0.0], 1.0, 1.0).view(), &[0.0; 3]).unwrap();
        // 77 slopes know a variance to √(2/77) = 16 %.
        assert!((sensed.model_mas - 1.0).abs() < 0.25, "{}", sensed.model_mas);
        let (found_nm, sigma_nm) = solved(&sensed, 100.0);
        // As one image would: √400 times the noise's 0.079 nm.
        assert!((sigma_nm[0] / 1.58 - 1.0).abs() < 0.3, "{sigma_nm:?}");
        assert!((found_nm[0] - 12.0).abs() < 3.0 * sigma_nm[0], "{found_nm}");
    }

    #[test]
    fn copies_of_one_image_say_something_finite() {
        let one = unseen(1, [12.0, -7.0, 0.0], 0.0, 0.0);
        let copies = ndarray::concatenate(Axis(0), &[one.view(), one.view(), one.view()]).unwrap();
        let sensed = Response::of(response()).sensed(copies.view(), &[0.0; 3]).unwrap();
        let (found_nm, sigma_nm) = solved(&sensed, 100.0);
        // Without noise what is left is rounding, and the prior's pull: (σ/100 nm)² of it.
        assert!((found_nm[0] - 12.0).abs() < 1e-6 && (found_nm[1] + 7.0).abs() < 1e-6, "{found_nm}");
        assert!(sigma_nm.iter().all(|nm| nm.is_finite() && *nm > 0.0), "{sigma_nm:?}");
    }
}

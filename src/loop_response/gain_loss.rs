//! Gains of slopes that depend on their own subaperture alone: turbulence within a subaperture
//! blurs its spot, and the slope of a quad cell changes less with a wavefront the wider the spot
//! is.
//!
//! On Keck the gain of a slope scatters by 30 % from image to image, and so its mean over 25 images
//! by 6 %, which reference slopes would put on the mirror. Turbulence is the same over the pupil,
//! so the means of all slopes are shrunk towards their common one by as much as scatter explains
//! their differences (James & Stein 1961).
//!
//! A loop is faster than turbulence crosses a subaperture, and follows the gains as they change.
//! With the interaction matrix D, the reconstructor M (M·D = 1), the diagonal matrix of the gains
//! ḡ(1 + E) and reference slopes r its commands c are at rest where M·ḡ(1 + E)·D·c = M·r. To second
//! order in the relative scatter σ of the gains, which is independent from slope to slope, their
//! mean is
//!
//! ```text
//! ⟨c⟩ = (1 + M⟨E·DM·E⟩D)·M·r/ḡ = (1 + p·σ²)·M·r/ḡ,
//! ```
//!
//! with the mean p of the diagonal of the projection DM: controlled modes over slopes, 0.6 on Keck.
//! By this 5 % the reference slopes have to be smaller.

use ndarray::{Array1, ArrayView1, ArrayView2, Axis};

/// Gain of each slope in a loop: the mean of its `responses` to a tilt (`[image, slope]`) over that
/// of a flat wavefront, `flat`, less what the loop follows, with `share` of the slopes' dimensions
/// controlled; 0 for a slope that does not respond.
pub(super) fn loop_gains(responses: ArrayView2<f64>, flat: ArrayView1<f64>, share: f64) -> Array1<f64> {
    let images = responses.nrows() as f64;
    let mut gains = Array1::zeros(flat.len());
    let responding: Vec<usize> = (0..flat.len()).filter(|&slope| flat[slope] > 0.0).collect();
    let ratios = responses.select(Axis(1), &responding) / &flat.select(Axis(0), &responding);
    let Some(means) = ratios.mean_axis(Axis(0)) else { return gains };
    let Some(common) = means.mean() else { return gains };
    let scatter = (&ratios - &means).mapv(|off| off * off).sum() / ((images - 1.0).max(1.0) * responding.len() as f64);
    let variance = means.mapv(|mean| (mean - common).powi(2)).sum() / (responding.len() as f64 - 1.0).max(1.0);
    let kept = if variance > 0.0 { (1.0 - scatter / images / variance).max(0.0) } else { 0.0 };
    let followed = 1.0 / (1.0 + share * scatter / common.powi(2));
    for (&slope, mean) in responding.iter().zip(means) {
        gains[slope] = followed * (common + kept * (mean - common));
    }
    gains
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::stream;
    use ndarray::Array2;
    use rand_distr::{Distribution, StandardNormal};

    const SLOPES: usize = 400;

    /// 20 images of slopes with gains of `mean`, which scatter by 0.2.
    fn responses(flat: &Array1<f64>, mean: impl Fn(usize) -> f64) -> Array2<f64> {
        let mut rng = stream(5, 0);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        Array2::from_shape_fn((20, SLOPES), |(_, slope)| flat[slope] * (mean(slope) + 0.2 * normal()))
    }

    /// RMS error of the means, which by themselves have one of 0.2/√20 = 0.045.
    fn error(mean: impl Fn(usize) -> f64) -> f64 {
        let flat = Array1::from_shape_fn(SLOPES, |slope| 1.0 + (slope % 3) as f64);
        let found = loop_gains(responses(&flat, &mean).view(), flat.view(), 0.0);
        (found.indexed_iter().map(|(slope, gain)| (gain - mean(slope)).powi(2)).sum::<f64>() / SLOPES as f64).sqrt()
    }

    #[test]
    fn equal_gains_are_pooled_and_those_that_differ_are_kept() {
        // All slopes know a common gain to 0.045/√400 = 0.002; by chance up to a tenth of the
        // scatter is taken for differences.
        assert!(error(|_| 0.5) < 0.01, "{}", error(|_| 0.5));
        let differ = |slope: usize| if slope < SLOPES / 2 { 0.3 } else { 0.7 };
        assert!((0.02..0.05).contains(&error(differ)), "{}", error(differ));
    }

    /// A loop of six modes and ten slopes, at rest about reference slopes with each of many draws
    /// of the gains.
    #[test]
    fn gain_loss_agrees_with_the_second_order_formula() {
        let (modes, slopes, draws) = (6, 10, 4000);
        let mut rng = stream(6, 0);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let response = Array2::from_shape_fn((slopes, modes), |_| normal());
        let inverse =
            |matrix: &Array2<f64>| crate::linear_algebra::SpdInverse::new(&matrix.t().dot(matrix)).unwrap().inverse;
        let reconstructor = inverse(&response).dot(&response.t());
        let wanted = Array1::from_shape_fn(modes, |mode| 1.0 + mode as f64);
        let gains = Array2::from_shape_fn((draws, slopes), |_| 0.5 * (1.0 + 0.2 * normal()));
        let found = loop_gains(gains.view(), Array1::ones(slopes).view(), modes as f64 / slopes as f64);
        let reference = &found * &response.dot(&wanted);
        let mut mean = Array1::<f64>::zeros(modes);
        for gain in gains.outer_iter() {
            // M·G·D·c = M·r, by the normal equations of a square matrix.
            let square = reconstructor.dot(&(&response * &gain.insert_axis(Axis(1))));
            let right = square.t().dot(&reconstructor.dot(&reference));
            mean += &(inverse(&square).dot(&right) / draws as f64);
        }
        let along = mean.dot(&wanted) / wanted.dot(&wanted);
        // The next order of a scatter of 0.2 is some 0.2⁴ times a few; without the second order it
        // is 1 + 0.6·0.04 = 1.024 at least.
        assert!((along - 1.0).abs() < 0.01, "{along}");
    }

    #[test]
    fn a_slope_without_response_has_no_gain() {
        let flat = Array1::from_shape_fn(SLOPES, |slope| if slope == 7 { 0.0 } else { 1.0 });
        let found = loop_gains(responses(&flat, |_| 0.5).view(), flat.view(), 0.0);
        assert_eq!(found[7], 0.0);
        assert!((found[8] - 0.5).abs() < 0.02);
    }
}

//! Gains of slopes that depend on their own subaperture alone: turbulence within a subaperture blurs its spot, and the slope of a quad
//! cell changes less with a wavefront the wider the spot is.
//!
//! On Keck the gain of a slope scatters by 30 % from image to image (its harmonic mean is 0.91 of its mean), and so its mean over 25 images by
//! 6 %, which reference slopes would put on the mirror. Turbulence is the same over the pupil, so the means of all slopes are shrunk towards their common one by as much as scatter explains
//! their differences (James & Stein 1961).

use ndarray::{Array1, ArrayView1, ArrayView2, Axis};

/// Mean gain of each slope: its `responses` to a tilt (`[image, slope]`) over that of a flat wavefront, `flat`; 0 for a slope that does not respond.
pub(super) fn mean_gains(responses: ArrayView2<f64>, flat: ArrayView1<f64>) -> Array1<f64> {
    let images = responses.nrows() as f64;
    let mut gains = Array1::zeros(flat.len());
    let responding: Vec<usize> = (0..flat.len()).filter(|&slope| flat[slope] > 0.0).collect();
    let ratios = responses.select(Axis(1), &responding) / &flat.select(Axis(0), &responding);
    let Some(means) = ratios.mean_axis(Axis(0)) else { return gains };
    let Some(common) = means.mean() else { return gains };
    let scatter = (&ratios - &means).mapv(|off| off * off).sum() / ((images - 1.0).max(1.0) * responding.len() as f64);
    let variance = means.mapv(|mean| (mean - common).powi(2)).sum() / (responding.len() as f64 - 1.0).max(1.0);
    let kept = if variance > 0.0 { (1.0 - scatter / images / variance).max(0.0) } else { 0.0 };
    for (&slope, mean) in responding.iter().zip(means) {
        gains[slope] = common + kept * (mean - common);
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
        let found = mean_gains(responses(&flat, &mean).view(), flat.view());
        (found.indexed_iter().map(|(slope, gain)| (gain - mean(slope)).powi(2)).sum::<f64>() / SLOPES as f64).sqrt()
    }

    #[test]
    fn equal_gains_are_pooled_and_those_that_differ_are_kept() {
        // All slopes know a common gain to 0.045/√400 = 0.002; by chance up to a tenth of the scatter is taken for differences.
        assert!(error(|_| 0.5) < 0.01, "{}", error(|_| 0.5));
        let differ = |slope: usize| if slope < SLOPES / 2 { 0.3 } else { 0.7 };
        assert!((0.02..0.05).contains(&error(differ)), "{}", error(differ));
    }

    #[test]
    fn a_slope_without_response_has_no_gain() {
        let flat = Array1::from_shape_fn(SLOPES, |slope| if slope == 7 { 0.0 } else { 1.0 });
        let found = mean_gains(responses(&flat, |_| 0.5).view(), flat.view());
        assert_eq!(found[7], 0.0);
        assert!((found[8] - 0.5).abs() < 0.02);
    }
}

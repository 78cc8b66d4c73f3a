//! χ² of the mean residual of many images: it shows errors of the model that all images share and
//! that are below the noise of one.
//!
//! The residuals r of N images of one wavefront, in standard deviations of their pixels, have at
//! each pixel a mean whose variance is 1/N. So N·mean(r)² per degree of freedom is 1 where the
//! model is right, and an error of the model that raises the χ² of one image to 1 + e raises it to
//! 1 + N·e. It does not average out: error bars are those of the noise, scaled by this χ² as those
//! of a single image are by its own.

use crate::modal::assess::chi2::nuisances;
use crate::modal::assess::residual::variance;
use crate::modal::assess::status::ImageReport;
use crate::modal::combine::sequence::SEQUENCE;
use crate::modal::fitter::ModalFitter;
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::minimum::Minimum;
use crate::scene::Weighting;
use crate::statistics::median;
use ndarray::ArrayView1;
use rayon::prelude::*;

/// Reduced χ² of the mean residual up to which error bars are those of noise and scatter. Over
/// 9,000 pixels its scatter is 0.015, over a few hundred 0.1; what is below changes an error bar by
/// 5 % at most.
pub(in crate::modal) const EXPLAINED: f64 = 1.1;
/// Median reduced χ² of the images from which on they are those of a wavefront that changes, or of
/// a wrong scene: no error that all images share, and the error bars are those of their scatter.
const MAX_TYPICAL_CHI2: f64 = 2.0;

/// Reduced χ² of the mean residual of the images `used`; that of one image is its own. 1 where the
/// median χ² is above 2, or without a noise model.
pub(in crate::modal) fn mean_residual_chi2(
    fitter: &ModalFitter,
    prepared: &[PreparedFrame],
    minima: &[Minimum],
    reports: &[ImageReport],
    used: &[usize],
) -> f64 {
    let typical = median(&used.iter().map(|&place| reports[place].reduced_chi2).collect::<Vec<_>>());
    match used {
        [one] => reports[*one].reduced_chi2,
        _ if typical < MAX_TYPICAL_CHI2 && fitter.recipe.weighting == Weighting::Noise => {
            chi2(fitter, prepared, minima, used)
        }
        _ => 1.0,
    }
}

fn chi2(fitter: &ModalFitter, prepared: &[PreparedFrame], minima: &[Minimum], used: &[usize]) -> f64 {
    let pixels = fitter.model.preparation.pixels.pow(2);
    // Sum of the residuals of each pixel, and the number of images in which it is good.
    let sum_of = |images: &[usize]| {
        let mut sums = vec![(0.0, 0.0); pixels];
        for (minimum, image) in images.iter().map(|&image| (&minima[image], &prepared[image])) {
            let psf = fitter.reference.psf(ArrayView1::from(&minimum.coefficients_nm));
            let variance_e2 = variance(&psf, minimum, &image.floor_variance_e2);
            let data = image.exposure.data_e.iter().zip(&psf).zip(&variance_e2);
            for (sum, ((data, h), variance)) in sums.iter_mut().zip(data).filter(|(_, (_, v))| v.is_finite()) {
                sum.0 += (data - minimum.flux_e * h - minimum.background_e) / variance.sqrt();
                sum.1 += 1.0;
            }
        }
        sums
    };
    // In parts that do not depend on the number of threads, so that neither do the bits of the
    // result.
    let parts: Vec<Vec<(f64, f64)>> = used.par_chunks(SEQUENCE).map(sum_of).collect();
    let (mut chi2, mut good) = (0.0, 0usize);
    for pixel in 0..pixels {
        let (sum, count) = parts.iter().fold((0.0, 0.0), |(s, n), part| (s + part[pixel].0, n + part[pixel].1));
        if count > 0.0 {
            chi2 += sum * sum / count;
            good += 1;
        }
    }
    let fitted = fitter.model.optics.modes() + used.first().map_or(0, |&image| nuisances(&prepared[image].exposure));
    chi2 / good.saturating_sub(fitted).max(1) as f64
}

//! Changes from one image to the next: what differs beyond noise, flux, background and small
//! shifts.
//!
//! Each image is fitted by the mean of the others, their first and second derivatives (a shift by a
//! fraction of a pixel) and a constant. Images of static aberrations leave a reduced χ² of about 1;
//! behind adaptive optics the speckles change, and it is tens to thousands.

use super::consistency::Electrons;
use crate::linear_algebra::SpdInverse;
use crate::scene::Scene;
use ndarray::{Array1, Array2, ArrayView2};

/// Reduced χ² from which images count as changing.
pub(super) const CHANGING: f64 = 5.0;
/// Images that are compared, evenly from the sequence.
const COMPARED: usize = 8;
/// Signal over noise of a pixel of the mean that is compared: others hold no star and dilute χ².
const SIGNAL: f64 = 5.0;
/// Fewest pixels with signal.
const LEAST_PIXELS: usize = 40;
/// The mean, its derivatives (two first and three second ones), a constant.
const TERMS: usize = 7;

/// Median over the images of the reduced χ² of each about the others; `None` for fewer than two
/// images, or too few pixels with signal.
pub(super) fn image_changes(scene: &Scene, images: &Electrons) -> Option<f64> {
    let count = images.len().min(COMPARED);
    if count < 2 {
        return None;
    }
    let chosen: Vec<usize> = (0..count).map(|i| i * images.len() / count).collect();
    let noise_e = images.read_noise_e.or(scene.image.read_noise_e).unwrap_or(1.0).max(1.0);
    let mut bad = Array2::from_elem(images.bad.index_axis(ndarray::Axis(0), 0).dim(), false);
    let mut sum_e = Array2::<f64>::zeros(bad.dim());
    for &image in &chosen {
        let (frame_e, marks) = frame(images, image);
        bad.zip_mut_with(&marks, |bad, mark| *bad |= mark);
        sum_e += &frame_e.mapv(|electrons| if electrons.is_finite() { electrons } else { 0.0 });
    }
    let mut found: Vec<f64> =
        chosen.iter().filter_map(|&image| chi2(&sum_e, &bad, frame(images, image).0, count, noise_e)).collect();
    found.sort_by(f64::total_cmp);
    found.get(found.len() / 2).copied()
}

fn frame<'a>(images: &'a Electrons, image: usize) -> (ArrayView2<'a, f64>, ArrayView2<'a, bool>) {
    (images.images_e.index_axis(ndarray::Axis(0), image), images.bad.index_axis(ndarray::Axis(0), image))
}

/// Reduced χ² of one image fitted by the mean of the others.
fn chi2(sum_e: &Array2<f64>, bad: &Array2<bool>, frame_e: ArrayView2<f64>, count: usize, noise_e: f64) -> Option<f64> {
    let others = (count - 1) as f64;
    let (rows, columns) = sum_e.dim();
    let mean = |y: usize, x: usize| (sum_e[[y, x]] - frame_e[[y, x]]) / others;
    let is_good = |y: usize, x: usize| (y - 1..=y + 1).all(|v| (x - 1..=x + 1).all(|u| !bad[[v, u]]));
    let (mut normal, mut right, mut square, mut pixels) = (Array2::zeros((TERMS, TERMS)), Array1::zeros(TERMS), 0.0, 0);
    for y in 1..rows.saturating_sub(1) {
        for x in 1..columns.saturating_sub(1) {
            let (here, data) = (mean(y, x), frame_e[[y, x]]);
            if here < SIGNAL * (noise_e + here.max(0.0).sqrt()) || !is_good(y, x) {
                continue;
            }
            let terms = [
                here,
                (mean(y, x + 1) - mean(y, x - 1)) / 2.0,
                (mean(y + 1, x) - mean(y - 1, x)) / 2.0,
                mean(y, x + 1) + mean(y, x - 1) - 2.0 * here,
                mean(y + 1, x) + mean(y - 1, x) - 2.0 * here,
                (mean(y + 1, x + 1) + mean(y - 1, x - 1) - mean(y + 1, x - 1) - mean(y - 1, x + 1)) / 4.0,
                // In the unit of the others, so that the normal equations are well conditioned.
                noise_e,
            ];
            // The noise of the mean, and of the derivatives about as much.
            let weight = 1.0 / ((here.max(0.0) + noise_e * noise_e) * (1.0 + 2.0 / others));
            for (i, one) in terms.iter().enumerate() {
                right[i] += weight * one * data;
                terms.iter().enumerate().for_each(|(j, other)| normal[[i, j]] += weight * one * other);
            }
            square += weight * data * data;
            pixels += 1;
        }
    }
    if pixels < LEAST_PIXELS {
        return None;
    }
    let trace: f64 = normal.diag().sum();
    normal.diag_mut().iter_mut().for_each(|value| *value += 1e-12 * trace);
    let solution = SpdInverse::new(&normal).ok()?.inverse.dot(&right);
    Some((square - solution.dot(&right)).max(0.0) / (pixels - TERMS) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::Images;
    use ndarray::Array3;
    use std::borrow::Cow;

    fn changes(images: &Images) -> Option<f64> {
        let Images { images_e, bad, .. } = images;
        let electrons = Electrons {
            images_e: Cow::Borrowed(images_e),
            bad: Cow::Borrowed(bad),
            read_noise_e: None,
            slopes_mas: None,
            moved_reference_mas: None,
        };
        image_changes(&scene(), &electrons)
    }

    fn scene() -> Scene {
        Scene::preset("keck-artificial").unwrap().with_override("image.read_noise_e", "10").unwrap()
    }

    /// Spots with a pattern, shifted by `shift` pixels and changed by `change`, with Gaussian
    /// noise.
    fn images(shifts: [f64; 4], change: f64) -> Images {
        use rand_distr::{Distribution, StandardNormal};
        let mut rng = crate::source::stream(1, 2);
        let image = |(i, y, x): (usize, usize, usize)| {
            let (u, v) = (x as f64 - 16.0 - shifts[i], y as f64 - 16.0);
            let phase = 0.5 * u + change * i as f64;
            let signal = 2e4 * (-(u * u + v * v) / 60.0).exp() * (1.0 + 0.4 * phase.sin());
            let noise: f64 = StandardNormal.sample(&mut rng);
            signal + noise * (signal + 100.0).sqrt()
        };
        Images::new(Array3::from_shape_fn((4, 32, 32), image))
    }

    #[test]
    fn noise_and_shifts_are_no_changes_and_other_patterns_are() {
        let still = changes(&images([0.0; 4], 0.0)).unwrap();
        let moved = changes(&images([0.0, 0.3, -0.2, 0.1], 0.0)).unwrap();
        let changed = changes(&images([0.0; 4], 0.5)).unwrap();
        assert!((0.5..1.6).contains(&still), "{still}");
        assert!(moved < CHANGING && changed > 3.0 * CHANGING, "{moved} {changed}");
        let one = Images::new(Array3::from_elem((1, 32, 32), 1.0));
        assert!(changes(&one).is_none());
    }
}

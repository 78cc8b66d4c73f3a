//! Rejection of planted pixels by a model that is known.

use super::*;
use crate::imaging::Photometry;
use crate::modal::assess::residual::photometry;
use rand_distr::{Distribution, StandardNormal};

const SIDE: usize = 64;
const FLOOR_E2: f64 = 100.0;

/// Light of a wide spot, e⁻: that of an image whose background is 50.
fn star_e(pixel: usize) -> f64 {
    let square = |at: usize| (at as f64 - 32.0).powi(2);
    2e4 * (-(square(pixel % SIDE) + square(pixel / SIDE)) / 200.0).exp()
}

const PREPARATION: Preparation = Preparation { frame: [SIDE; 2], reduced: [SIDE; 2], pixels: SIDE, flip: [false; 2] };

/// An image of the spot with noise, changed by `change`.
fn image(change: impl Fn(usize, usize, &mut f64)) -> PreparedFrame {
    let mut image = PREPARATION.empty();
    image.rejected.begin(FLOOR_E2);
    image.floor_variance_e2.fill(FLOOR_E2);
    image.exposure.photometry = Photometry::FitBoth;
    let mut rng = crate::source::stream(1, 0);
    for pixel in 0..SIDE * SIDE {
        let expected_e = star_e(pixel) + 50.0;
        let noise: f64 = StandardNormal.sample(&mut rng);
        let data_e = &mut image.exposure.data_e[pixel];
        *data_e = expected_e + noise * (expected_e + FLOOR_E2).sqrt();
        change(pixel % SIDE, pixel / SIDE, data_e);
        image.exposure.weight[pixel] = weight(*data_e);
    }
    image
}

fn weight(electrons: f64) -> f64 {
    1.0 / (electrons.max(0.0) + FLOOR_E2)
}

/// Such an image compared with the spot, what is rejected, and whether that has changed.
fn rejected_from(change: impl Fn(usize, usize, &mut f64)) -> (PreparedFrame, RejectedPixels, bool) {
    let mut image = image(change);
    let psf: Vec<f64> = (0..SIDE * SIDE).map(|pixel| star_e(pixel) / 2e4).collect();
    let (_, has_changed) = reject(&mut image, &psf, |image| photometry(&image.exposure, &psf));
    let kinds = crate::modal::prepare::rejection::kinds(&image, &PREPARATION);
    (image, kinds, has_changed)
}

#[test]
fn clean_images_lose_no_pixel() {
    let (_, kinds, has_changed) = rejected_from(|_, _, _| {});
    assert!(kinds == RejectedPixels::default() && !has_changed, "{kinds:?}");
}

#[test]
fn hot_and_dead_pixels_and_tracks_are_rejected() {
    let (image, kinds, has_changed) = rejected_from(|x, y, e| match (x, y) {
        (10, 50) => *e += 200.0,
        (30, 32) => *e = 0.0,
        (40..43, 20) => *e += 3e4,
        _ => {}
    });
    assert_eq!((kinds.high, kinds.low, kinds.in_lines, has_changed), (4, 1, 0, true));
    let at = [20 * SIDE + 40, 20 * SIDE + 41, 20 * SIDE + 42, 32 * SIDE + 30, 50 * SIDE + 10];
    assert!(image.rejected.pixels().iter().all(|pixel| at.contains(&(*pixel as usize))));
}

#[test]
fn dead_pixels_have_the_weight_of_their_neighbours() {
    let mut image = image(|x, y, e| *e *= if (x, y) == (30, 32) { 0.0 } else { 1.0 });
    let (at, own) = (32 * SIDE + 30, image.exposure.weight.clone());
    weigh_dead(&mut image);
    // The neighbours have 2e4 electrons within some per cent, and no other pixel changes.
    assert!((image.exposure.weight[at] / weight(2e4) - 1.0).abs() < 0.1);
    assert!((0..own.len()).all(|pixel| pixel == at || image.exposure.weight[pixel] == own[pixel]));
}

/// A background that falls below 0, as a subtraction leaves it, has no light by which to weigh.
#[test]
fn negative_pixels_keep_weights_above_zero() {
    let mut image = image(|x, y, e| *e -= 3e4 + if (x, y) == (10, 10) { 1e4 } else { 0.0 });
    weigh_dead(&mut image);
    assert!(image.exposure.weight.iter().all(|weight| *weight > 0.0 && weight.is_finite()));
}

#[test]
fn faint_columns_and_rows_are_rejected_and_named() {
    // Five standard deviations of the dark in each pixel, of which none is rejected by itself.
    let (_, kinds, _) = rejected_from(|x, _, e| *e += if x == 45 { 60.0 } else { 0.0 });
    assert_eq!((kinds.in_lines, kinds.line, kinds.high + kinds.low), (SIDE, [Some(45), None], 0));
    assert_eq!(kinds.kinds(), "64 in column 45");
    let (_, kinds, _) = rejected_from(|_, y, e| *e -= if y == 7 { 60.0 } else { 0.0 });
    assert_eq!((kinds.in_lines, kinds.line), (SIDE, [None, Some(7)]));
}

/// Light that the model lacks is spread over pixels, and stays: the residual is to show it.
#[test]
fn companions_stay() {
    let (_, kinds, _) = rejected_from(|x, y, e| {
        let square = (x as f64 - 20.3).powi(2) + (y as f64 - 44.6).powi(2);
        *e += 5e3 * (-square / 1.5).exp();
    });
    assert_eq!(kinds.total(), 0, "{kinds:?}");
}

#[test]
fn images_of_another_model_lose_no_pixel() {
    let (_, kinds, _) = rejected_from(|x, y, e| *e += 3e3 * ((x / 3 + y / 3) % 2) as f64);
    assert_eq!(kinds.total(), 0, "{kinds:?}");
}

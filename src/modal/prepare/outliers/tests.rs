//! Outliers that are planted in simulated images.

use super::*;
use crate::scene::Scene;
use crate::source;
use ndarray::Array3;

const NOISE_E: f64 = 10.0;

fn scene(settings: &[(&str, &str)]) -> Scene {
    let base = [("image.count", "2"), ("image.read_noise_e", "10"), ("pupil.samples", "64"), ("image.pixels", "132")];
    Scene::preset("keck-artificial").unwrap().with(&[&base[..], settings].concat()).unwrap()
}

fn images(scene: &Scene) -> Array3<f64> {
    source::simulate(scene).unwrap().remove(0).images_e
}

fn clean(scene: &Scene, data_e: &Array2<f64>, bad: &Array2<bool>) -> Option<CleanedFrame> {
    let frame = Frame { data_e: data_e.view(), bad: bad.view(), read_noise_e: Some(NOISE_E) };
    OutlierFinder::new(scene, &Filter::new(scene).unwrap()).unwrap().clean(frame)
}

#[test]
fn outliers_are_found_and_predicted() {
    for settings in [&[][..], &[("image.samples_per_lambda_over_d", "3")]] {
        let scene = scene(settings);
        let image_e = images(&scene).index_axis_move(Axis(0), 0);
        let bad = image_e.mapv(|_| false);
        assert!(clean(&scene, &image_e, &bad).is_none(), "light and noise have no outlier");
        let peak_e = image_e.iter().copied().fold(0.0, f64::max);
        let (rows, columns) = image_e.dim();
        // A hot pixel, a dead one in the light, a track of three, a corner, and a pixel that is
        // known.
        let brightest = image_e.indexed_iter().max_by(|a, b| a.1.total_cmp(b.1)).unwrap().0;
        let track = [0, 1, 2].map(|i| (rows / 4 + i, columns / 3 + i));
        let mut spoilt_e = image_e.clone();
        spoilt_e[(rows / 2, columns / 2)] += 10.0 * peak_e;
        spoilt_e[(0, 0)] += peak_e;
        spoilt_e[brightest] = 0.0;
        track.iter().for_each(|&at| spoilt_e[at] += 0.3 * peak_e);
        let (mut known, place) = (bad.clone(), (rows / 3, columns / 2));
        (known[place], spoilt_e[place]) = (true, f64::NAN);
        let found = clean(&scene, &spoilt_e, &known).unwrap();
        assert!(found.data_e[place].is_nan());
        for (at, &e) in spoilt_e.indexed_iter().filter(|(at, _)| *at != place) {
            let is_spoilt = e != image_e[at];
            assert_eq!(found.data_e[at] != e, is_spoilt, "{settings:?} {at:?}");
            // The noise of a prediction is twice that of a pixel at most, where neighbours are
            // good; four of these, and twice that in a track.
            let noise_e = (image_e[at].max(0.0) + NOISE_E * NOISE_E).sqrt();
            assert!((found.data_e[at] - image_e[at]).abs() < 16.0 * noise_e, "{at:?}");
        }
        assert_eq!((found.rejected.high, found.rejected.low, found.rejected.in_lines), (5, 1, 0));
    }
}

/// Two pixels in a hundred, each of 30 standard deviations or more: all are found, and of the
/// others not more than the share that may be noise.
#[test]
fn one_pixel_in_fifty_is_found() {
    let scene = scene(&[]);
    let image_e = images(&scene).index_axis_move(Axis(0), 1);
    let mut spoilt_e = image_e.clone();
    // Not in the corner, which is predicted least.
    let is_spoilt = |(y, x): (usize, usize)| y + x > 0 && (y * 7919 + x * 104_729) % 50 == 0;
    spoilt_e.indexed_iter_mut().filter(|(at, _)| is_spoilt(*at)).for_each(|(at, e)| {
        let noise_e = (image_e[at].max(0.0) + NOISE_E * NOISE_E).sqrt();
        *e += 30.0 * noise_e * (1 + at.0 % 20) as f64;
    });
    let found = clean(&scene, &spoilt_e, &image_e.mapv(|_| false)).unwrap();
    let planted = spoilt_e.indexed_iter().filter(|(at, _)| is_spoilt(*at)).count();
    let missed = found.data_e.indexed_iter().filter(|(at, e)| is_spoilt(*at) && **e == spoilt_e[*at]).count();
    let others = found.rejected.total() - planted;
    // The expected number, and three times its scatter.
    let expected = FALSE_SHARE * planted as f64;
    assert!(missed == 0 && (others as f64) < expected + 3.0 * expected.sqrt(), "{missed} {others}");
    // Few outliers leave the limit where it is; 2 Φ(−3.29) = 0.001.
    assert_eq!([limit(1e-3), limit(0.1)], LIMITS);
    assert!((limit(0.02) - 3.29).abs() < 0.011);
}

#[test]
fn errors_that_are_not_single_pixels_are_left() {
    let scene = scene(&[]);
    let image_e = images(&scene).index_axis_move(Axis(0), 1);
    let bad = image_e.mapv(|_| false);
    // Responses of pixels that scatter by 10 % are not single pixels, and noise that is understated
    // threefold is none.
    let mut uneven = image_e.clone();
    uneven.indexed_iter_mut().for_each(|((y, x), e)| *e *= 1.0 + 0.1 * ((7 * y + 13 * x * x) as f64).sin());
    assert!(clean(&scene, &uneven, &bad).is_none());
    let noisy = Array2::from_shape_fn(image_e.dim(), |(y, x)| {
        image_e[(y, x)] + 40.0 * ((31 * y * y + 17 * x * y + 7 * x * x) as f64).sin()
    });
    assert!(clean(&scene, &noisy, &bad).is_none());
    // Frames of another size, and of another sampling.
    assert!(clean(&scene, &Array2::zeros((4, 4)), &Array2::from_elem((4, 4), false)).is_none());
    let coarse = scene.with(&[("image.samples_per_lambda_over_d", "1.5")]).unwrap();
    assert!(OutlierFinder::new(&coarse, &Filter::new(&coarse).unwrap()).is_none());
}

use super::*;
use crate::scene::Scene;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::f64::consts::TAU;

fn recipe() -> Recipe {
    Recipe::from_scene(&Scene::preset("keck-artificial").unwrap())
}

fn plan(frame_pixels: usize, reduced_pixels: usize, pixels: usize) -> Preparation {
    Preparation { frame: [frame_pixels; 2], reduced: [reduced_pixels; 2], pixels, flip: [false, false] }
}

fn prepare(plan: &Preparation, data: &Array2<f64>) -> Result<PreparedFrame> {
    let bad = data.mapv(|_| false);
    plan.prepare(Frame { data_e: data.view(), bad: bad.view(), read_noise_e: Some(3.0) }, &recipe())
}

/// A star on the axis with a background of noise.
fn star(size: usize, at: (f64, f64)) -> Array2<f64> {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    Array2::from_shape_fn((size, size), |(v, u)| {
        let r2 = (u as f64 - at.0).powi(2) + (v as f64 - at.1).powi(2);
        1e4 * (-r2 / 18.0).exp() + rng.random::<f64>()
    })
}

#[test]
fn reduction_keeps_sum_and_values_of_a_band_limited_image() {
    // Frequencies of up to 5 cycles across 24 pixels survive the reduction to 12 (Nyquist 6).
    let wave =
        |y: f64, x: f64| 3.0 + (TAU * 5.0 * x / 24.0 + 0.3).cos() + 2.0 * (TAU * (4.0 * y - 2.0 * x) / 24.0).sin();
    let data = Array2::from_shape_fn((24, 24), |(v, u)| wave(v as f64, u as f64));
    let reduced = Decimation::new([24; 2], [12; 2]).run(data.view()).clone();
    for ((v, u), &value) in reduced.indexed_iter() {
        // Each new pixel holds the light of four: the axis, pixel 12 of 24, becomes pixel 6 of 12.
        let expected = 4.0 * wave(2.0 * v as f64, 2.0 * u as f64);
        // Two FFTs of 24 and 12 points on numbers of size 10: a few roundings each.
        assert!((value - expected).abs() < 1e-12, "{value} {expected}");
    }
}

#[test]
fn a_reduction_carries_white_noise_along() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let data = Array2::from_shape_fn((128, 128), |_| rng.random::<f64>() - 0.5);
    let reduced = Decimation::new([128; 2], [64; 2]).run(data.view()).clone();
    let variance = |a: &Array2<f64>| a.mapv(|v| v * v).mean().unwrap();
    // Variance of a sum of four; 4,096 samples scatter by √(2/4096) = 2 %: three of these.
    let ratio = variance(&reduced) / variance(&data);
    assert!((ratio / 4.0 - 1.0).abs() < 0.07, "{ratio}");
    // White: neighbours are uncorrelated within 1/√4096, three of these.
    let product: f64 =
        reduced.indexed_iter().filter(|((_, u), _)| *u > 0).map(|((v, u), a)| a * reduced[[v, u - 1]]).sum();
    assert!((product / reduced.len() as f64 / variance(&reduced)).abs() < 0.05);
}

#[test]
fn a_star_off_the_axis_is_moved_there_by_whole_pixels() {
    let prepared = prepare(&plan(64, 64, 32), &star(64, (41.0, 25.0))).unwrap();
    assert_eq!(prepared.shift_pixels, [9, -7]);
    let data = &prepared.exposure.data_e;
    let brightest = (0..data.len()).max_by(|&a, &b| data[a].total_cmp(&data[b])).unwrap();
    assert_eq!((brightest / 32, brightest % 32), (16, 16));
    // Near the axis exact tip and tilt do it better than a shift.
    assert_eq!(prepare(&plan(64, 64, 32), &star(64, (34.0, 31.0))).unwrap().shift_pixels, [0, 0]);
}

#[test]
fn a_flip_mirrors_about_the_axis() {
    let plain = star(32, (20.0, 13.0));
    let plan = Preparation { flip: [true, false], ..plan(32, 32, 32) };
    let bad = plain.mapv(|_| false);
    let frame = Frame { data_e: plain.view(), bad: bad.view(), read_noise_e: Some(3.0) };
    let still = Recipe { recentre: false, ..recipe() };
    let flipped = plan.prepare(frame, &still).unwrap();
    // Pixel 20 is 4 to the right of the axis on pixel 16; mirrored, it is on pixel 12.
    assert_eq!(flipped.exposure.data_e[13 * 32 + 12], plain[[13, 20]]);
    // Pixel 0 has no mirror image on the detector.
    assert_eq!(flipped.bad_pixels, 32);
}

#[test]
fn bad_pixels_weigh_nothing_and_the_floor_follows_the_reduction() {
    let mut data = star(64, (32.0, 32.0));
    data[[30, 30]] = f64::NAN;
    let mut bad = data.mapv(|_| false);
    bad[[31, 34]] = true;
    let frame = Frame { data_e: data.view(), bad: bad.view(), read_noise_e: Some(3.0) };
    let prepared = plan(64, 64, 64).prepare(frame, &recipe()).unwrap();
    assert_eq!(prepared.bad_pixels, 2);
    for pixel in [30 * 64 + 30, 31 * 64 + 34] {
        assert_eq!((prepared.exposure.weight[pixel], prepared.exposure.data_e[pixel]), (0.0, 0.0));
    }
    assert_eq!(prepared.floor_variance_e2[0], 9.0);
    let reduced = prepare(&plan(64, 32, 32), &star(64, (32.0, 32.0))).unwrap();
    assert_eq!(reduced.floor_variance_e2[0], 36.0);
}

#[test]
fn frames_without_a_star_are_refused_with_the_reason() {
    let plan = plan(32, 32, 32);
    let noise = star(32, (-100.0, -100.0));
    let cases = [
        (Array2::zeros((32, 32)), "constant"),
        (Array2::from_elem((32, 32), 7.5), "constant"),
        (Array2::from_elem((32, 32), f64::NAN), "no good pixel"),
        (star(32, (16.0, 16.0)).mapv(|v| -v), "no positive pixel"),
        (Array2::from_shape_fn((32, 32), |(v, _)| if (8..24).contains(&v) { 1.0 } else { 5.0 }) + noise, "no star"),
    ];
    for (data, reason) in cases {
        let error = prepare(&plan, &data).unwrap_err();
        assert!(matches!(error, Error::Image(_)) && error.to_string().contains(reason), "{error}");
    }
    let error = prepare(&plan, &star(30, (15.0, 15.0))).unwrap_err();
    assert!(matches!(error, Error::Shape(_)) && error.to_string().contains("30x30"), "{error}");
}

#[test]
fn noise_of_the_frame_does_not_hide_a_faint_star() {
    // Noise that is negative by chance takes all light of a star whose brightest pixel is seen.
    let frame = |peak_e: f64| {
        Array2::from_shape_fn((32, 32), |(v, u)| match (v, u) {
            (16, 16) => peak_e,
            (2..30, 2..30) => -2.0 + ((7 * v + 3 * u) % 5) as f64 / 10.0,
            _ => 0.0,
        })
    };
    let prepared = |peak_e: f64| {
        let (data, bad) = (frame(peak_e), Array2::from_elem((32, 32), false));
        let frame = Frame { data_e: data.view(), bad: bad.view(), read_noise_e: Some(30.0) };
        plan(32, 32, 32).prepare(frame, &Recipe { reject_outliers: false, ..recipe() }).map(drop)
    };
    assert!(prepared(600.0).is_ok());
    let error = prepared(150.0).unwrap_err().to_string();
    assert!(error.contains("no star") && error.contains("six noises"), "{error}");
}

#[test]
fn rectangular_frames_keep_their_axis_in_flip_and_crop() {
    // 48 pixels along x, 32 along y: the axis on [24, 16].
    let (width, height) = (48, 32);
    let star = |x: f64, y: f64| {
        Array2::from_shape_fn((height, width), |(v, u)| {
            let r2 = (u as f64 - x).powi(2) + (v as f64 - y).powi(2);
            1e4 * (-r2 / 18.0).exp() + 1.0
        })
    };
    let of = |plan: Preparation, data: &Array2<f64>| {
        let bad = data.mapv(|_| false);
        plan.prepare(Frame { data_e: data.view(), bad: bad.view(), read_noise_e: Some(3.0) }, &recipe()).unwrap()
    };
    let plain = Preparation { frame: [width, height], reduced: [width, height], pixels: 24, flip: [false; 2] };
    let brightest = |prepared: &PreparedFrame| {
        let data = &prepared.exposure.data_e;
        (0..data.len()).max_by(|&a, &b| data[a].total_cmp(&data[b])).unwrap()
    };
    let centred = of(plain, &star(24.0, 16.0));
    assert_eq!((centred.shift_pixels, brightest(&centred), centred.bad_pixels), ([0, 0], 12 * 24 + 12, 0));
    // A star elsewhere is moved onto the axis; the four lines beyond the frame are bad.
    let moved = of(plain, &star(32.0, 24.0));
    assert_eq!((moved.shift_pixels, brightest(&moved), moved.bad_pixels), ([8, 8], 12 * 24 + 12, 4 * 24));
    // Seen in a mirror along x, pixel 22 is pixel 26.
    let mirrored = of(Preparation { flip: [true, false], ..plain }, &star(22.0, 16.0));
    assert_eq!(brightest(&mirrored), 12 * 24 + 14);
    // The fitted part may be larger than the frame along y: what is beyond is bad.
    let wide = of(Preparation { pixels: 48, ..plain }, &star(24.0, 16.0));
    assert_eq!((brightest(&wide), wide.bad_pixels), (24 * 48 + 24, 16 * 48));
    // Half the sampling: four native pixels each, the axis on [12, 8] of [24, 16].
    let reduced = Preparation { reduced: [width / 2, height / 2], pixels: 16, ..plain };
    assert_eq!(reduced.native_pixels(), 4.0);
    let small = of(reduced, &star(24.0, 16.0));
    assert_eq!((brightest(&small), small.floor_variance_e2[0]), (8 * 16 + 8, 36.0));
    // A Gaussian of 3 pixels has 5e-5 of its spectrum's peak at the new Nyquist frequency, which
    // aliases.
    let peak = small.exposure.data_e[8 * 16 + 8];
    assert!((peak / 4.0 - 10_001.0).abs() < 10.0, "{peak}");
}

#[test]
fn a_part_without_a_good_pixel_is_refused() {
    let data = star(64, (32.0, 32.0));
    // All that is fitted is bad, and the star's halo around it is not.
    let bad = Array2::from_shape_fn((64, 64), |(v, u)| (20..44).contains(&v) && (20..44).contains(&u));
    let frame = Frame { data_e: data.view(), bad: bad.view(), read_noise_e: Some(3.0) };
    let still = Recipe { recentre: false, ..recipe() };
    let outcome = plan(64, 64, 16).prepare(frame, &still);
    assert!(outcome.unwrap_err().to_string().contains("no good pixel"));
}

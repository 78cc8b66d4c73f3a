//! Detector frames that are not square.

use crate::{Desk, number};
use cophase::io::{FitsReader, FitsWriter, Pixel};
use ndarray::{Array2, Axis, s};

/// 160×120 pixels of an image of 160×160: reduced to 80×60 at Nyquist sampling. The light of the
/// defocused source fills some 50 of those.
const WIDE: [&str; 3] = ["image.samples_per_lambda_over_d=4", "image.pixels=160", "image.rows=120"];

#[test]
fn frames_wider_than_high_are_read_as_well_as_square_ones() {
    for (settings, [rows, columns]) in [
        (WIDE.to_vec(), [120, 160]),
        // Higher than wide, and not reduced: 66 pixels at 2.2 per λ/D are 60 at 2, 90 are no whole
        // even number.
        (vec!["image.samples_per_lambda_over_d=2.2", "image.pixels=90", "image.columns=66"], [90, 66]),
        (vec!["image.pixels=80", "image.rows=64", "image.columns=72"], [64, 72]),
    ] {
        let desk = Desk::with_images(&settings);
        let cube = FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap();
        assert_eq!(cube.dim(), (1, rows, columns));
        // Both maps within their error bars: rows and columns that changed places would give tens
        // of nanometres.
        let (json, err) = desk.estimates_well("images.fits", &[]);
        assert_eq!((&json["status"], err.as_str()), (&"ok".into(), ""), "{settings:?}");
        let square = [&settings[..], &["image.rows=", "image.columns="]].concat();
        let (whole, _) = Desk::with_images(&square).estimates_well("images.fits", &[]);
        for sigma in ["phasing_nm", "ncpa_nm"] {
            // What is cut off are the wings: the noise grows by what the light out there knew, a
            // few per cent; its draws differ, which moves it by half a per cent.
            let [own_nm, whole_nm] = [&json, &whole].map(|json| number(&json["error_budget"][0], sigma));
            let ratio = own_nm / whole_nm;
            println!("{settings:?} {sigma}: {own_nm} nm, {ratio} of the square frame's");
            assert!((0.99..1.3).contains(&ratio), "{ratio}");
        }
    }
}

#[test]
fn a_strip_is_fitted_along_its_whole_length() {
    // Half of the columns that carry signal: the fitted part is as high as the frame, and has
    // nothing beyond its sides.
    let desk = Desk::with_images(&["image.columns=32"]);
    let (strip, _) = desk.estimates_well("images.fits", &[]);
    let (square, _) = desk.estimates_well("images.fits", &["--set", "image.crop_pixels=32"]);
    let sigmas = [&strip, &square].map(|json| number(json, "ncpa_sigma_nm"));
    println!("NCPA known to {} nm; from a square of the strip's width, {}", sigmas[0], sigmas[1]);
    assert!(sigmas[0] < 0.9 * sigmas[1], "{sigmas:?}");
}

#[test]
fn a_loop_s_camera_delivers_frames_of_the_scene_s_shape() {
    let desk = Desk::with_scene();
    std::fs::write(desk.path("loop.toml"), include_str!("../../../tests/c_api/small.toml")).unwrap();
    let set = ["--set", "image.count=2", "--set", "image.rows=40", "--set", "estimate.combine=mean"];
    desk.succeeds(&[["simulate", "loop.toml", "-o", "sky.fits"].as_slice(), &set].concat());
    assert_eq!(FitsReader::open(desk.path("sky.fits")).unwrap().cube("IMAGES").unwrap().dim(), (2, 40, 48));
    desk.succeeds(&["estimate", "sky.fits", "-o", "est.fits", "--optimizer", "paper"]);
}

#[test]
fn a_frame_is_the_middle_of_the_image() {
    let quiet = ["image.photon_noise=false", "image.read_noise_e=0", "image.flux_e=1e6", "image.peak_snr="];
    let read = |settings: &[&str]| {
        let desk = Desk::with_images(&[&quiet, settings].concat());
        FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap()
    };
    // 64×64 pixels with the axis on [32, 32]; 48 rows and 20 columns with the axis on [24, 10].
    let (square, frame) = (read(&[]), read(&["image.rows=48", "image.columns=20"]));
    assert_eq!(frame, square.slice(s![.., 8..56, 22..42]));
}

#[test]
fn a_frame_of_another_shape_is_refused() {
    let desk = Desk::with_images(&WIDE);
    let turned = FitsReader::open(desk.path("images.fits")).unwrap().cube("IMAGES").unwrap();
    let turned = turned.index_axis(Axis(0), 0).reversed_axes().as_standard_layout().to_owned();
    let mut file = FitsWriter::create(desk.path("turned.fits")).unwrap();
    file.image("IMAGES", &turned, Pixel::F64, "electron").unwrap();
    file.finish().unwrap();
    let set = WIDE.iter().flat_map(|setting| ["--set", setting]);
    let estimate = ["estimate", "turned.fits", "--scene", "scene.toml", "-o", "est.fits"];
    let arguments: Vec<&str> = estimate.into_iter().chain(set).collect();
    desk.refuses(&arguments, &["turned.fits", "120x160 pixels", "scene says 160x120"]);
    // A whole frame of a detector, whose cards contradict the scene, too.
    let mut file = FitsWriter::create(desk.path("raw.fits")).unwrap();
    file.image("IMAGES", &Array2::from_elem((512, 300), 7.0), Pixel::F32, "adu").unwrap();
    file.card("IMAGES", "ITIME", 2.0, "").unwrap();
    file.finish().unwrap();
    let raw = ["estimate", "raw.fits", "--scene", "scene.toml", "-o", "est.fits"];
    desk.refuses(&raw, &["raw.fits", "300x512 pixels", "scene says 64x64", "cophase reduce"]);
    let with = |setting: &'static str| ["image", "scene.toml", "-o", "e.fits", "--set", setting];
    desk.refuses(&with("image.rows=66"), &["image.rows = 66 ", "at most image.pixels = 64 "]);
    desk.refuses(&with("image.columns=7"), &["image.columns = 7 ", "integer from 8 to 8192"]);
}

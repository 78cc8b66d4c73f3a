//! Telemetry that does not belong to the images, and the orientation of images from a poke.

use crate::Desk;
use cophase::io::{FitsReader, FitsWriter, Pixel};
use cophase::scene::Scene;
use cophase::source::{Camera, Truth};
use cophase::telescope::Telescope;
use ndarray::Array2;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const SKY: &str = include_str!("../../../tests/c_api/sky.toml");

/// Copies images, scene and truth of `from` to `to`, with other slopes.
fn with_slopes(desk: &Desk, from: &str, to: &str, change: impl Fn(f64) -> f64) {
    let mut file = FitsReader::open(desk.path(from)).unwrap();
    let mut copy = FitsWriter::create(desk.path(to)).unwrap();
    copy.image("IMAGES", &file.cube("IMAGES").unwrap(), Pixel::F64, "electron").unwrap();
    copy.image("SLOPES_MEAN", &file.map(Some("SLOPES_MEAN")).unwrap().mapv(change), Pixel::F64, "mas").unwrap();
    copy.text("SCENE", &file.text_column("SCENE", "LINE").unwrap().join("\n")).unwrap();
    copy.finish().unwrap();
}

#[test]
fn slopes_of_the_opposite_sign_are_refused_used_or_ignored() {
    let desk = Desk::with_scene();
    std::fs::write(desk.path("sky.toml"), SKY).unwrap();
    desk.succeeds(&["simulate", "sky.toml", "-o", "sky.fits"]);
    with_slopes(&desk, "sky.fits", "negated.fits", |mas| -mas);
    let estimate = ["estimate", "negated.fits", "-o", "est.fits", "--method", "full-phase", "--device", "cpu"];
    desk.refuses(&estimate, &["the slopes have the opposite sign", "--telemetry", "correlation of -0.9"]);
    let json = desk.json(&[&estimate[..], &["--json", "--telemetry", "use"]].concat());
    assert!((-1.15..-0.85).contains(&json["telemetry_gain"].as_f64().unwrap()), "{json}");
    assert!(json["telemetry_correlation"].as_f64().unwrap() < -0.9, "{json}");
    let mut file = FitsReader::open(desk.path("est.fits")).unwrap();
    assert_eq!(file.card(None, "TELGAIN").unwrap().unwrap().number(), json["telemetry_gain"].as_f64());
    let json = desk.json(&[&estimate[..], &["--json", "--telemetry", "ignore"]].concat());
    assert!(json["ao_knowledge"] == "loop" && json["telemetry_gain"].is_null(), "{json}");
    // Slopes of a scene without a sensor.
    let cut = SKY.split("[wavefront_sensor]").next().unwrap().to_string()
        + "[mirror]\nactuators_across = 11\npitch_m = 0.5625\n";
    std::fs::write(desk.path("cut.toml"), cut).unwrap();
    let done = desk.succeeds(&[&estimate[..], &["--scene", "cut.toml"]].concat());
    assert!(done.err.contains("the slopes that come with the images are ignored"), "{}", done.err);
}

/// Writes two images of the scene in `desk`: as it is, and with segment 1 moved by `poke_nm`; pixel (row, column) of each is
/// that of `source(row, column)` of the telescope's.
fn write_poke(desk: &Desk, poke_nm: f64, source: impl Fn(usize, usize, usize) -> (usize, usize)) {
    let scene = Scene::from_file(desk.path("scene.toml")).unwrap();
    let telescope = Telescope::new(&scene).unwrap();
    let truth = || Truth::draw(&scene, &telescope, &mut ChaCha8Rng::seed_from_u64(3)).unwrap();
    let mut pistons_nm = truth().piston_nm;
    pistons_nm[1] += poke_nm;
    for (name, truth) in [("old.fits", truth()), ("new.fits", truth().with_pistons(&telescope, pistons_nm).unwrap())] {
        let psf = Camera::new(&scene, &telescope).unwrap().psf(&truth).unwrap();
        let seen = Array2::from_shape_fn(psf.dim(), |(y, x)| 1e6 * psf[source(psf.ncols(), y, x)]);
        let mut file = FitsWriter::create(desk.path(name)).unwrap();
        file.image("IMAGES", &seen, Pixel::F64, "electron").unwrap();
        file.finish().unwrap();
    }
}

#[test]
fn the_keys_that_a_poke_gives_undo_a_quarter_turn() {
    let desk = Desk::with_scene();
    let is_right = "The scene has the orientation of the images.";
    write_poke(&desk, 150.0, |n, y, x| (x, (n - y) % n));
    let check = [
        "check-orientation",
        "new.fits",
        "--before",
        "old.fits",
        "--poke-nm",
        "150",
        "--scene",
        "scene.toml",
        "--segment",
        "1",
    ];
    let json = desk.json(&[&check[..], &["--json"]].concat());
    let settings = json["settings"].as_object().unwrap();
    assert!(settings.contains_key("pupil.rotation_deg"), "{json}");
    let set = settings.iter().flat_map(|(key, value)| ["--set".into(), format!("{key}={}", value.as_str().unwrap())]);
    let set: Vec<String> = set.collect();
    let again: Vec<&str> = check.iter().copied().chain(set.iter().map(String::as_str)).collect();
    let done = desk.succeeds(&again);
    assert!(done.out.contains(is_right), "{}", done.out);
    // One image suffices where the poke is larger than what else is there.
    write_poke(&desk, 400.0, |n, y, x| (y, (n - x) % n));
    let alone =
        ["check-orientation", "new.fits", "--poke-nm", "400", "--scene", "scene.toml", "--segment", "1", "--json"];
    let json = desk.json(&alone);
    assert_eq!(json["settings"], serde_json::json!({"image.flip_x": "true"}), "{json}");
}

#[test]
fn a_poked_segment_shows_a_flip_and_the_key_to_set() {
    let desk = Desk::with_scene();
    write_poke(&desk, 150.0, |n, y, x| (y, (n - x) % n));
    let check = ["check-orientation", "new.fits", "--before", "old.fits", "--poke-nm", "150", "--scene", "scene.toml"];
    let json = desk.json(&[&check[..], &["--segment", "1", "--json"]].concat());
    assert_eq!((&json["flip_x"], &json["flip_y"], &json["sign"]), (&true.into(), &false.into(), &1.0.into()), "{json}");
    assert_eq!(json["settings"], serde_json::json!({"image.flip_x": "true"}), "{json}");
    let done = desk.succeeds(&[&check[..], &["--segment", "1"]].concat());
    assert!(done.out.contains("a flip left to right") && done.out.contains("set image.flip_x = true"), "{}", done.out);
    let set = ["--segment", "1", "--set", "image.flip_x=true"];
    let done = desk.succeeds(&[&check[..], &set].concat());
    assert!(done.out.contains("The scene has the orientation of the images."), "{}", done.out);
    desk.refuses(&[&check[..], &["--segment", "0"]].concat(), &["do not show the poke of segment 0"]);
    desk.refuses(&[&check[..], &["--segment", "7"]].concat(), &["segment 7", "0 to 6"]);
    assert_eq!(desk.run(&check).status, 2);
    // An image alone says that it does not determine its orientation, once.
    let done = desk.succeeds(&["estimate", "new.fits", "--scene", "scene.toml", "-o", "est.fits"]);
    assert_eq!(done.out.matches("The orientation cannot be verified").count(), 1, "{}", done.out);
    assert!(!done.err.contains("orientation"), "{}", done.err);
}

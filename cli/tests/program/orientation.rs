//! Telemetry that does not belong to the images, and the orientation of images from a poke.

use crate::{Desk, SMALL};
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
#[ignore = "merge: 7 s"]
fn slopes_of_the_opposite_sign_are_refused_used_or_ignored() {
    let desk = Desk::with_scene();
    std::fs::write(desk.path("sky.toml"), SKY).unwrap();
    desk.succeeds(&["simulate", "sky.toml", "-o", "sky.fits"]);
    with_slopes(&desk, "sky.fits", "negated.fits", |mas| -mas);
    let estimate = ["estimate", "negated.fits", "-o", "est.fits", "--method", "full-phase", "--device", "cpu"];
    desk.refuses(&estimate, &["the slopes have the opposite sign", "estimate.telemetry", "correlation of -0.9"]);
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
    assert!(done.err.contains("slopes") && done.err.contains("ignored"), "{}", done.err);
}

#[test]
#[ignore = "merge: 4 s"]
fn simulated_slopes_are_written_in_the_form_of_the_scene() {
    let desk = Desk::with_scene();
    std::fs::write(desk.path("sky.toml"), SKY).unwrap();
    desk.succeeds(&["simulate", "sky.toml", "-o", "plain.fits"]);
    let form =
        ["--set", "wavefront_sensor.slope_order=[\"y-then-x\"]", "--set", "wavefront_sensor.slope_unit_mas=-0.5"];
    desk.succeeds(&[&["simulate", "sky.toml", "-o", "form.fits"], &form[..]].concat());
    let slopes = |name: &str| FitsReader::open(desk.path(name)).unwrap().map(Some("SLOPES_MEAN")).unwrap();
    let (plain, formed) = (slopes("plain.fits"), slopes("form.fits"));
    let half = plain.ncols() / 2;
    let expected = Array2::from_shape_fn(plain.dim(), |(image, k)| -2.0 * plain[[image, (k + half) % (2 * half)]]);
    assert_eq!(formed, expected);
    let estimate = |name: &str| {
        desk.json(&["estimate", name, "-o", "est.fits", "--method", "full-phase", "--device", "cpu", "--json"])
    };
    let (plain, formed) = (estimate("plain.fits"), estimate("form.fits"));
    for key in ["phasing_rms_nm", "ncpa_rms_nm", "phasing_sigma_nm", "telemetry_gain", "status"] {
        assert_eq!(plain[key], formed[key], "{key}");
    }
}

/// Writes the image of `truth` as `name`: pixel (row, column) is that of `source(pixels, row, column)` of the telescope's.
fn write_image(
    desk: &Desk,
    name: &str,
    (scene, telescope, truth): (&Scene, &Telescope, &Truth),
    source: &impl Fn(usize, usize, usize) -> (usize, usize),
) {
    let psf = Camera::new(scene, telescope).unwrap().psf(truth).unwrap();
    let seen = Array2::from_shape_fn(psf.dim(), |(y, x)| 1e6 * psf[source(psf.ncols(), y, x)]);
    let mut file = FitsWriter::create(desk.path(name)).unwrap();
    file.image("IMAGES", &seen, Pixel::F64, "electron").unwrap();
    file.finish().unwrap();
}

/// Writes two images of the scene in `desk`: as it is, and with segment 1 moved by `poke_nm`, as [`write_image`].
fn write_poke(desk: &Desk, poke_nm: f64, source: impl Fn(usize, usize, usize) -> (usize, usize)) {
    let scene = Scene::from_file(desk.path("scene.toml")).unwrap();
    let telescope = Telescope::new(&scene).unwrap();
    let truth = || Truth::draw(&scene, &telescope, &mut ChaCha8Rng::seed_from_u64(3)).unwrap();
    let mut pistons_nm = truth().piston_nm;
    pistons_nm[1] += poke_nm;
    for (name, truth) in [("old.fits", truth()), ("new.fits", truth().with_pistons(&telescope, pistons_nm).unwrap())] {
        write_image(desk, name, (&scene, &telescope, &truth), &source);
    }
}

/// As [`write_poke`], for the actuator at `place_m` of the scene's mirror: NCPA of astigmatism alone, and with its influence. Gives
/// the number of the actuator.
fn write_actuator_poke(
    desk: &Desk,
    place_m: [f64; 2],
    poke_nm: f64,
    source: impl Fn(usize, usize, usize) -> (usize, usize),
) -> usize {
    let scene = Scene::from_file(desk.path("scene.toml")).unwrap();
    let telescope = Telescope::new(&scene).unwrap();
    let square_m2 = |x_m: f64, y_m: f64| (x_m - place_m[0]).powi(2) + (y_m - place_m[1]).powi(2);
    let positions = telescope.influence(&scene).unwrap().positions_m();
    let actuator = positions.iter().position(|&(x_m, y_m)| square_m2(x_m, y_m) < 1e-12).unwrap();
    // A Gaussian that is the coupling at a distance of one pitch.
    let (mirror, grid) = (&scene.mirror, &telescope.pupil.grid);
    let influence = |x_m: f64, y_m: f64| mirror.coupling.powf(square_m2(x_m, y_m) / mirror.pitch_m.powi(2));
    for (name, nm) in [("old.fits", 0.0), ("new.fits", poke_nm)] {
        let ncpa_nm = Array2::from_shape_fn([grid.samples(); 2], |(y, x)| {
            let [x_m, y_m] = [x, y].map(|at| grid.coordinate_m(at));
            10.0 * (x_m * x_m - y_m * y_m) + nm * influence(x_m, y_m)
        });
        let mut file = FitsWriter::create(desk.path("ncpa.fits")).unwrap();
        file.image("NCPA", &ncpa_nm, Pixel::F64, "nm").unwrap();
        file.finish().unwrap();
        let drawn = [("aberrations.ncpa_rms_nm", ""), ("aberrations.ncpa_zernikes", "")];
        let scene = scene.with(&[&drawn[..], &[("aberrations.ncpa_file", "ncpa.fits")]].concat()).unwrap();
        let truth = Truth::draw(&scene, &telescope, &mut ChaCha8Rng::seed_from_u64(3)).unwrap();
        write_image(desk, name, (&scene, &telescope, &truth), &source);
    }
    actuator
}

#[test]
#[ignore = "merge: 26 s"]
fn the_keys_that_a_poke_gives_undo_a_quarter_turn() {
    let desk = Desk::with_scene();
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
    assert!(done.out.contains("has the orientation"), "{}", done.out);
    // One image suffices where the poke is larger than what else is there.
    write_poke(&desk, 400.0, |n, y, x| (y, (n - x) % n));
    let alone =
        ["check-orientation", "new.fits", "--poke-nm", "400", "--scene", "scene.toml", "--segment", "1", "--json"];
    let json = desk.json(&alone);
    assert_eq!(json["settings"], serde_json::json!({"image.flip_x": "true"}), "{json}");
}

#[test]
#[ignore = "merge: 46 s"]
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
    assert!(done.out.contains("has the orientation"), "{}", done.out);
    // The check of scene and images finds the same.
    let whole =
        ["check", "new.fits", "--before", "old.fits", "--poke-nm", "150", "--scene", "scene.toml", "--segment", "1"];
    let json = desk.json(&[&whole[..], &["--json"]].concat());
    assert_eq!(
        (&json["cause"], &json["settings"]),
        (&"orientation".into(), &serde_json::json!({"image.flip_x": "true"})),
        "{json}"
    );
    desk.refuses(&[&check[..], &["--segment", "0"]].concat(), &["do not show", "poke of segment 0"]);
    desk.refuses(&[&check[..], &["--segment", "7"]].concat(), &["segment 7", "0 to 6"]);
    assert_eq!(desk.run(&check).status, 2);
    // An image alone says that it does not determine its orientation, once.
    let done = desk.succeeds(&["estimate", "new.fits", "--scene", "scene.toml", "-o", "est.fits"]);
    assert_eq!(done.out.matches("The orientation cannot be verified").count(), 1, "{}", done.out);
    assert!(!done.err.contains("orientation"), "{}", done.err);
}

#[test]
fn a_poked_actuator_shows_a_flip_and_the_key_to_set() {
    let desk = Desk::with_scene();
    // An actuator off the axes of the pupil, which are 30 degrees apart.
    let mirror = "[mirror]\nactuators_across = 5\npitch_m = 1.1\ncoupling = 0.15\n";
    // The shape of an actuator is finer than the modes: without larger models, which take their time.
    let modes = "[estimate]\nmodel = \"scene\"\n";
    std::fs::write(desk.path("scene.toml"), SMALL.to_string() + mirror + modes).unwrap();
    let actuator = write_actuator_poke(&desk, [1.1, 1.1], 120.0, |n, y, x| ((n - y) % n, x)).to_string();
    let check = ["check-orientation", "new.fits", "--before", "old.fits", "--poke-nm", "120", "--scene", "scene.toml"];
    let json = desk.json(&[&check[..], &["--actuator", &actuator, "--json"]].concat());
    assert_eq!((&json["flip_x"], &json["flip_y"], &json["sign"]), (&false.into(), &true.into(), &1.0.into()), "{json}");
    assert_eq!(json["settings"], serde_json::json!({"image.flip_y": "true"}), "{json}");
    let set = ["--actuator", &actuator, "--set", "image.flip_y=true"];
    let done = desk.succeeds(&[&check[..], &set].concat());
    assert!(done.out.contains("has the orientation"), "{}", done.out);
    desk.refuses(&[&check[..], &["--actuator", "99"]].concat(), &["actuator 99", "0 to "]);
    // A poke of nothing else than one of the two.
    assert_eq!(desk.run(&[&check[..], &["--actuator", &actuator, "--segment", "1"]].concat()).status, 2);
}

/// With three vanes the pupil equals its mirror image left to right, and not that up to down: an image flipped up to down is that of the opposite defocus.
/// The check names both, and a poke decides.
#[test]
#[ignore = "merge: 16 s"]
fn poke_distinguishes_a_flip_from_the_sign_of_the_defocus() {
    let desk = Desk::with_scene();
    let vanes = "spider_width_m = 0.25\nspider_vanes_deg = [90, 210, 330]\nsamples = 64";
    std::fs::write(desk.path("scene.toml"), SMALL.replace("samples = 64", vanes)).unwrap();
    let images = ["check", "new.fits", "--scene", "scene.toml", "--json"];
    let poke = [&images[..], &["--before", "old.fits", "--poke-nm", "150", "--segment", "1"]].concat();
    let sign = ["--set", "image.diversity_focus_waves_rms=-1"];
    for (is_flipped, keys, cause, settings) in [
        (true, &[][..], "orientation", serde_json::json!({"image.flip_y": "true"})),
        (false, &sign[..], "sign of the defocus", serde_json::json!({"image.diversity_focus_waves_rms": "1"})),
    ] {
        write_poke(&desk, 150.0, |n, y, x| if is_flipped { ((n - y) % n, x) } else { (y, x) });
        let json = desk.json(&[&images[..], keys].concat());
        assert_eq!(json["cause"], "orientation or sign of the defocus", "{json}");
        assert_eq!(json["settings"], serde_json::json!({}), "{json}");
        let sentence = json["findings"][0]["explanation"].as_str().unwrap();
        for part in ["image.flip_y = true", "image.diversity_focus_waves_rms = ", "--poke-nm"] {
            assert!(sentence.contains(part), "{part}: {sentence}");
        }
        let json = desk.json(&[&poke[..], keys].concat());
        assert_eq!((&json["cause"], &json["settings"]), (&cause.into(), &settings), "{json}");
    }
    // Both signs right: nothing to set. These images have no noise, of which the check says so.
    let json = desk.json(&poke);
    assert_eq!(json["cause"], "noise", "{json}");
}

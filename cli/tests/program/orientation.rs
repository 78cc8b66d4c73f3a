//! Telemetry that does not belong to the images, and the orientation of images from a poke.

use crate::{Desk, SMALL, text_column};
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

/// Writes the image of `truth` as `name`: pixel (row, column) is that of
/// `source(pixels, row, column)` of the telescope's.
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

/// Writes two images of the scene in `desk`: as it is, and with segment 1 moved by `poke_nm`, as
/// [`write_image`].
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

/// As [`write_poke`], for the actuator at `place_m` of the scene's mirror: NCPA of astigmatism
/// alone, and with its influence. Gives the number of the actuator.
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

/// The words after `name` of a check with a poke.
fn check_of(name: &str, before: Option<&str>, poke: [&str; 2], nm: &str) -> Vec<String> {
    let mut words = vec!["check", name, "--scene", "scene.toml", "--poke-nm", nm, poke[0], poke[1]];
    words.extend(before.into_iter().flat_map(|before| ["--before", before]));
    words.into_iter().map(str::to_owned).collect()
}

/// The explanation of the orientation in the answer `json`, and its verdict.
fn orientation(json: &serde_json::Value) -> (&str, &str) {
    let findings = json["findings"].as_array().unwrap();
    let found =
        findings.iter().find(|finding| finding["quantity"] == "orientation").unwrap_or_else(|| panic!("{json}"));
    (found["verdict"].as_str().unwrap(), found["explanation"].as_str().unwrap())
}

impl Desk {
    /// The answer of a check with further options.
    fn answer(&self, check: &[String], more: &[&str]) -> serde_json::Value {
        self.json(&check.iter().map(String::as_str).chain(more.iter().copied()).chain(["--json"]).collect::<Vec<_>>())
    }
}

#[test]
#[ignore = "merge: 26 s"]
fn the_keys_that_a_poke_gives_undo_a_quarter_turn() {
    let desk = Desk::with_scene();
    write_poke(&desk, 150.0, |n, y, x| (x, (n - y) % n));
    let check = check_of("new.fits", Some("old.fits"), ["--segment", "1"], "150");
    let json = desk.answer(&check, &["--write", "turned.toml"]);
    assert!(json["settings"].as_object().unwrap().contains_key("pupil.rotation_deg"), "{json}");
    let right: Vec<String> = check.iter().map(|word| word.replace("scene.toml", "turned.toml")).collect();
    assert_eq!(orientation(&desk.answer(&right, &[])).0, "agrees");
    // One image suffices where the poke is larger than what else is there.
    write_poke(&desk, 400.0, |n, y, x| (y, (n - x) % n));
    let json = desk.answer(&check_of("new.fits", None, ["--segment", "1"], "400"), &[]);
    assert_eq!(json["settings"], serde_json::json!({"image.flip_x": "true"}), "{json}");
}

#[test]
#[ignore = "merge: 46 s"]
fn a_poked_segment_shows_a_flip_and_the_key_to_set() {
    let desk = Desk::with_scene();
    write_poke(&desk, 150.0, |n, y, x| (y, (n - x) % n));
    let check = check_of("new.fits", Some("old.fits"), ["--segment", "1"], "150");
    let json = desk.answer(&check, &[]);
    let set = serde_json::json!({"image.flip_x": "true"});
    assert_eq!((&json["cause"], &json["settings"]), (&"orientation".into(), &set), "{json}");
    // In the scene's own orientation it is the mirror image of segment 1 that moved, which is named
    // first.
    let (_, sentence) = orientation(&json);
    let places =
        ["in the scene's own orientation segment 3 moved", "a flip left to right"].map(|fact| sentence.find(fact));
    assert!(places[0].is_some() && places[0] < places[1], "{sentence}");
    assert_eq!(orientation(&desk.answer(&check, &["--set", "image.flip_x=true"])).0, "agrees");
    let absent = check_of("new.fits", Some("old.fits"), ["--segment", "7"], "150");
    desk.refuses(&absent.iter().map(String::as_str).collect::<Vec<_>>(), &["segment 7", "0 to 6"]);
    assert_eq!(desk.run(&["check", "new.fits", "--scene", "scene.toml", "--poke-nm", "150"]).status, 2);
    // An image alone says that it does not determine its orientation, once.
    let done = desk.succeeds(&["estimate", "new.fits", "--scene", "scene.toml", "-o", "est.fits"]);
    assert_eq!(done.out.matches("The orientation cannot be verified").count(), 1, "{}", done.out);
    assert!(!done.err.contains("orientation"), "{}", done.err);
}

/// The segment that moved is named, and neither a flip nor a rotation with which the images are
/// explained worse.
#[test]
#[ignore = "merge: 13 s"]
fn a_wrong_segment_number_is_no_orientation() {
    let desk = Desk::with_scene();
    write_poke(&desk, 150.0, |_, y, x| (y, x));
    let check = |label: &str| check_of("new.fits", Some("old.fits"), ["--segment", label], "150");
    // The others of its ring are mirror images of it: then the answer names both.
    let json = desk.answer(&check("0"), &["--write", "corrected.toml"]);
    assert_eq!((&json["cause"], &json["settings"]), (&"poke".into(), &serde_json::json!({})), "{json}");
    assert!(json["findings"][0]["explanation"].as_str().unwrap().starts_with("segment 1 moved"), "{json}");
    assert!(!desk.path("corrected.toml").exists());
    let strict: Vec<String> = check("0").into_iter().chain(["--strict".into()]).collect();
    assert_eq!(desk.run(&strict.iter().map(String::as_str).collect::<Vec<_>>()).status, 3);
}

#[test]
#[ignore = "merge: 14 s"]
fn segments_are_addressed_by_their_labels() {
    let desk = Desk::with_scene();
    write_poke(&desk, 150.0, |_, y, x| (y, x));
    let labels = "pupil.segment_labels=[\"C1\",\"A1\",\"A2\",\"A3\",\"A4\",\"A5\",7]";
    let of = |label: &str| check_of("new.fits", Some("old.fits"), ["--segment", label], "150");
    assert_eq!(orientation(&desk.answer(&of("A1"), &["--set", labels])).0, "agrees");
    let json = desk.answer(&of("C1"), &["--set", labels]);
    assert!(json["findings"][0]["explanation"].as_str().unwrap().starts_with("segment A1 moved"), "{json}");
    let absent: Vec<String> = of("1").into_iter().chain(["--set".into(), labels.into()]).collect();
    desk.refuses(&absent.iter().map(String::as_str).collect::<Vec<_>>(), &["no segment 1", "C1, A1, A2"]);
    // The tables of an estimate have them, and pistons are compared by them.
    let estimate = ["estimate", "new.fits", "--scene", "scene.toml", "-o", "est.fits", "--set", labels];
    desk.succeeds(&estimate);
    assert_eq!(text_column(&desk.path("est.fits"), "SEGMENTS", "LABEL")[1], "A1");
    desk.json(&["compare", "est.fits", "--truth-pistons", "est.fits", "--json"]);
}

#[test]
#[ignore = "merge: 14 s"]
fn a_poked_actuator_shows_a_flip_and_the_key_to_set() {
    let desk = Desk::with_scene();
    // An actuator off the axes of the pupil, which are 30 degrees apart.
    let mirror = "[mirror]\nactuators_across = 5\npitch_m = 1.1\ncoupling = 0.15\n";
    // The shape of an actuator is finer than the modes: without larger models, which take their
    // time.
    let modes = "[estimate]\nmodel = \"scene\"\n";
    std::fs::write(desk.path("scene.toml"), SMALL.to_string() + mirror + modes).unwrap();
    let actuator = write_actuator_poke(&desk, [1.1, 1.1], 120.0, |n, y, x| ((n - y) % n, x)).to_string();
    let check = |actuator: &str| check_of("new.fits", Some("old.fits"), ["--actuator", actuator], "120");
    let json = desk.answer(&check(&actuator), &[]);
    assert_eq!(orientation(&json).0, "fault", "{json}");
    assert!(orientation(&json).1.contains("a flip up to down"), "{json}");
    assert_eq!(orientation(&desk.answer(&check(&actuator), &["--set", "image.flip_y=true"])).0, "agrees");
    desk.refuses(&check("99").iter().map(String::as_str).collect::<Vec<_>>(), &["actuator 99", "0 to "]);
    // A poke of nothing else than one of the two.
    let both: Vec<String> = check(&actuator).into_iter().chain(["--segment".into(), "1".into()]).collect();
    assert_eq!(desk.run(&both.iter().map(String::as_str).collect::<Vec<_>>()).status, 2);
}

/// With three vanes the pupil equals its mirror image left to right, and not that up to down: an
/// image flipped up to down is that of the opposite defocus. The check names both, and a poke
/// decides.
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

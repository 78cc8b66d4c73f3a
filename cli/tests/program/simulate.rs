//! `cophase simulate`: a file that 'estimate' reads, the figures that scripts read, loops that run
//! away.

use crate::parts::timeless;
use crate::{Desk, number};
use cophase::io::FitsReader;

/// A quarter of Keck's lenslets and samples: a tenth of a second to build.
const SMALL_LOOP: &str = include_str!("../../../tests/c_api/small.toml");

fn desk() -> Desk {
    let desk = Desk::with_scene();
    std::fs::write(desk.path("loop.toml"), SMALL_LOOP).unwrap();
    desk
}

const THREE: [&str; 6] =
    ["--set", "image.count=3", "--set", "image.exposure_s=0.003", "--set", "estimate.combine=mean"];

#[test]
fn a_run_leaves_images_truth_and_telemetry_that_estimate_reads() {
    let desk = desk();
    let arguments = [["simulate", "loop.toml", "-o", "sky.fits", "--json"].as_slice(), &THREE].concat();
    let json = desk.json(&arguments);
    // 0.02 s settling, two intervals of 0.01 s and three frames at 1054 Hz.
    assert_eq!((&json["frames"], &json["images"], &json["diverged"]), (&45.into(), &3.into(), &false.into()));
    for key in ["seconds", "frames_per_s", "residual_rms_nm", "strehl_k"] {
        assert!(number(&json, key) > 0.0, "{key}: {json}");
    }
    let mut file = FitsReader::open(desk.path("sky.fits")).unwrap();
    assert_eq!(file.cube("IMAGES").unwrap().dim(), (3, 40, 48));
    let commands = file.map(Some("COMMANDS")).unwrap();
    let slopes = file.map(Some("SLOPES")).unwrap();
    let subapertures = file.i64_column("SUBAPERTURES", "PLACE").unwrap().len();
    let actuators = file.f64_column("ACTUATORS", "X_M").unwrap().len();
    assert_eq!((slopes.dim(), commands.dim()), ((3, 2 * subapertures), (3, actuators)));
    assert_eq!(file.map(Some("INTERACTION")).unwrap().dim(), (2 * subapertures, actuators));
    assert_eq!(file.f64_column("SHOTS", "TIME_S").unwrap().len(), 3);
    for truth in ["TRUTH_PHASING", "TRUTH_NCPA"] {
        assert_eq!(file.map(Some(truth)).unwrap().dim(), (60, 60));
    }
    desk.succeeds(&["estimate", "sky.fits", "-o", "est.fits", "--optimizer", "paper"]);
    desk.succeeds(&["compare", "est.fits", "--truth", "sky.fits"]);
}

/// 80 samples across the pupil filter away 0.28 % of the light of these images, 120 nothing.
#[test]
fn too_coarse_grid_is_reported() {
    let desk = Desk::with_scene();
    std::fs::write(desk.path("sky.toml"), include_str!("../../../tests/c_api/sky.toml")).unwrap();
    let one = ["simulate", "sky.toml", "-o", "sky.fits", "--set", "image.count=1", "--set", "control.settle_s=0.01"];
    let done = desk.succeeds(&one);
    let said = ["80 samples across", "0.28 %", "116 are", "wavefront_sensor.samples_per_lenslet"];
    assert!(said.iter().all(|part| done.err.contains(part)), "{}", done.err);
    let finer = [one.as_slice(), &["--set", "wavefront_sensor.samples_per_lenslet=12"]].concat();
    assert!(!desk.succeeds(&finer).err.contains("warning"));
    for (arguments, warnings) in [(one.as_slice(), 1), (&finer, 0)] {
        let json = desk.json(&[arguments, &["--json"]].concat());
        assert_eq!(json["warnings"].as_array().unwrap().len(), warnings, "{json}");
    }
}

/// Places of actuators that a person reads off the picture are those of the telemetry.
#[test]
fn loop_picture_shows_actuators_and_subapertures_of_its_file() {
    let desk = desk();
    desk.succeeds(&["simulate", "loop.toml", "-o", "sky.fits"]);
    desk.succeeds(&["scene", "loop.toml", "--plot", "pupil.svg"]);
    let mut file = FitsReader::open(desk.path("sky.fits")).unwrap();
    let subapertures = file.i64_column("SUBAPERTURES", "PLACE").unwrap().len();
    let svg = std::fs::read_to_string(desk.path("pupil.svg")).unwrap();
    assert!(svg.contains(&format!("{subapertures} subapertures in use")));
    assert_eq!(svg.to_lowercase().matches("fill=\"#0072b2\"").count(), 4 * (subapertures + 1));
    for (column, key, sign) in [("X_M", "cx=\"", 1.0), ("Y_M", "cy=\"", -1.0)] {
        let places_m = file.f64_column("ACTUATORS", column).unwrap();
        assert!(svg.contains(&format!("{} actuators", places_m.len())));
        // The first circle is in the legend.
        let value = |rest: &str| rest.split('"').next().unwrap().parse::<f64>().unwrap();
        let drawn: Vec<f64> = svg.split(key).skip(2).map(value).collect();
        assert_eq!(drawn.len(), places_m.len());
        let extent = |values: &[f64]| {
            let low = values.iter().copied().fold(f64::INFINITY, f64::min);
            (low, values.iter().copied().fold(f64::NEG_INFINITY, f64::max))
        };
        let ((low, high), (low_m, high_m)) = (extent(&drawn), extent(&places_m));
        // x grows to the right, y upwards, against the rows of the picture.
        let scale = sign * (high - low) / (high_m - low_m);
        for (at, place_m) in drawn.iter().zip(&places_m) {
            let expected = (low + high) / 2.0 + scale * (place_m - (low_m + high_m) / 2.0);
            assert!((at - expected).abs() <= 1.5, "{column} {place_m} m is at {at} and not at {expected}");
        }
    }
}

#[test]
fn a_seed_decides_everything_and_another_one_changes_it() {
    let desk = desk();
    let make = |name: &str, seed: &str| {
        desk.succeeds(&["simulate", "loop.toml", "-o", name, "--seed", seed]);
        timeless(&desk.path(name))
    };
    let first = make("a.fits", "4");
    assert!(first == make("b.fits", "4"), "the same seed, the same bytes");
    assert!(first != make("c.fits", "5"));
    // Several seeds, by two processes of a job array.
    let seeds = ["simulate", "loop.toml", "-o", "night.fits", "--seed", "4", "--seeds", "3", "--json", "--part"];
    let made = ["1/2", "2/2"].map(|part| desk.json(&[&seeds[..], &[part]].concat()).as_array().unwrap().len());
    assert_eq!(made, [2, 1]);
    let nights: Vec<String> = desk.files().into_iter().filter(|name| name.starts_with("night")).collect();
    assert_eq!(nights, ["night-4.fits", "night-5.fits", "night-6.fits"]);
    assert!(first == timeless(&desk.path("night-4.fits")), "a seed among others, the same bytes");
    assert!(first != timeless(&desk.path("night-5.fits")));
    let done = desk.run(&["simulate", "loop.toml", "-o", "night.fits", "--part", "1/2"]);
    assert!(done.status == 2 && done.err.contains("--seeds"), "{}", done.err);
}

#[test]
fn diverging_loop_stops_with_a_message() {
    let desk = desk();
    let unstable = ["--set", "control.gain=1.05", "--set", "control.lag_frames=2"];
    let early = ["simulate", "loop.toml", "-o", "early.fits", "--set", "image.count=200"];
    let done = desk.run(&[early.as_slice(), &unstable, &["--json"]].concat());
    assert_eq!(done.status, 0, "{}", done.err);
    assert!(done.err.contains("unstable") && done.err.contains("diverged after"), "{}", done.err);
    let json: serde_json::Value = serde_json::from_str(&done.out).unwrap();
    assert_eq!(json["diverged"], true);
    assert!(number(&json, "diverged_at_s") < 1.0 && number(&json, "growth_per_s") > 0.0, "{json}");
    // Before the first image there is nothing to write.
    let none = ["simulate", "loop.toml", "-o", "none.fits", "--set", "control.settle_s=3"];
    let done = desk.run(&[none.as_slice(), &unstable].concat());
    assert_eq!(done.status, 1);
    assert!(done.err.contains("before its first image") && !desk.path("none.fits").exists(), "{}", done.err);
}

#[test]
fn missing_and_impossible_keys_are_named() {
    let desk = desk();
    desk.refuses(&["simulate", "scene.toml", "-o", "sky.fits"], &["[wavefront_sensor]"]);
    let with = |setting: &'static str| ["simulate", "loop.toml", "-o", "sky.fits", "--set", setting];
    desk.refuses(&with("wavefront_sensor.subaperture_file=none.txt"), &["none.txt"]);
    desk.refuses(&with("wavefront_sensor.min_light_ratio=1.0"), &["min_light_ratio"]);
    desk.refuses(&with("image.pixels=400"), &["400 pixels"]);
    std::fs::write(desk.path("map.txt"), "0 1\n1 x\n").unwrap();
    desk.refuses(&with("mirror.actuator_file=map.txt"), &["map.txt", "2 lines"]);
}

#[test]
fn corrections_move_segments_and_mirror_and_add_up() {
    let desk = desk();
    let simulate = |out: &str, more: &[&str]| {
        desk.succeeds(&[["simulate", "loop.toml", "-o", out].as_slice(), &THREE, more].concat());
        let mut file = FitsReader::open(desk.path(out)).unwrap();
        (file.f64_column("TRUTH", "PISTON_NM").unwrap(), file.map(Some("TRUTH_NCPA")).unwrap())
    };
    let (pistons, ncpa) = simulate("0.fits", &[]);
    desk.succeeds(&["estimate", "0.fits", "-o", "est.fits", "--optimizer", "paper", "--commands", "c.fits"]);
    let add = FitsReader::open(desk.path("c.fits")).unwrap().f64_column("SEGMENTS", "ADD_NM").unwrap();
    assert!(add.iter().any(|nm| *nm != 0.0));
    let (once_pistons, once_ncpa) = simulate("1.fits", &["--corrections", "c.fits"]);
    let (twice_pistons, twice_ncpa) = simulate("2.fits", &["--corrections", "c.fits", "--corrections", "c.fits"]);
    for (segment, add) in add.iter().enumerate() {
        // Sums of numbers of some 100 nm.
        assert!((once_pistons[segment] - pistons[segment] - add).abs() < 1e-10);
        assert!((twice_pistons[segment] - pistons[segment] - 2.0 * add).abs() < 1e-10);
    }
    let mut moved = 0.0f64;
    for ((before, once), twice) in ncpa.iter().zip(&once_ncpa).zip(&twice_ncpa).filter(|((nm, _), _)| nm.is_finite()) {
        moved = moved.max((before - once).abs());
        // Maps are in single precision, of some 100 nm.
        assert!((before - 2.0 * once + twice).abs() < 1e-3, "{before} {once} {twice}");
    }
    assert!(moved > 1.0, "{moved}");
    // An estimate is no correction, nor is one of other segments; an input is not overwritten.
    let refused = |file: &str, words: &[&str]| {
        desk.refuses(&["simulate", "loop.toml", "-o", "3.fits", "--corrections", file], words);
    };
    refused("0.fits", &["0.fits", "SEGMENTS or ACTUATORS"]);
    refused("none.fits", &["none.fits"]);
    desk.refuses(&["simulate", "loop.toml", "-o", "c.fits", "--corrections", "c.fits"], &["c.fits", "--corrections"]);
}

//! Files of AOT, the telemetry standard of adaptive optics: a night through one has the bits of one
//! through our own FITS; aotpy, the reference implementation, reads what is written here, and what
//! it writes is read.
//!
//! aotpy is that of the Python in `COPHASE_AOTPY`, else in `COPHASE_PYTHON`, else `python3`. Where
//! it is not installed its tests say so and pass, unless `COPHASE_REQUIRE_AOTPY=1`.

use crate::{Desk, number, text_column};
use cophase::io::FitsReader;
use cophase::pipeline::Images;
use std::process::Command;

/// Seven segments behind a loop.
const SKY: &str = include_str!("../../../tests/c_api/sky.toml");
const SCRIPT: &str = include_str!("aot.py");

/// A desk with `sky.fits` and `aot.fits` of one run.
fn desk() -> Desk {
    let desk = Desk::with_scene();
    std::fs::write(desk.path("sky.toml"), SKY).unwrap();
    desk.succeeds(&["simulate", "sky.toml", "-o", "sky.fits", "--aot", "aot.fits"]);
    desk
}

/// Estimates from `images`, and gives the estimate's numbers as bits: maps and coefficients with
/// their error bars.
fn estimate(desk: &Desk, images: &str, options: &[&str]) -> Vec<u64> {
    let own = ["estimate", images, "-o", "est.fits", "--method", "full-phase", "--device", "cpu"];
    desk.succeeds(&[own.as_slice(), options].concat());
    let mut file = FitsReader::open(desk.path("est.fits")).unwrap();
    let maps = ["PHASING", "NCPA"].map(|name| file.map(Some(name)).unwrap());
    let tables = [("SEGMENTS", "PISTON_NM"), ("SEGMENTS", "SIGMA_NM")]
        .map(|(table, column)| file.f64_column(table, column).unwrap());
    let numbers = maps.iter().flatten().chain(tables.iter().flatten());
    let bits: Vec<u64> = numbers.map(|number| number.to_bits()).collect();
    assert!(tables.iter().all(|column| column.len() == 7 && column.iter().all(|nm| nm.is_finite())));
    bits
}

/// Python with aotpy.
fn aotpy() -> Option<String> {
    let variables = ["COPHASE_AOTPY", "COPHASE_PYTHON"];
    let python = variables.iter().find_map(|name| std::env::var(name).ok()).unwrap_or("python3".into());
    let is_there =
        Command::new(&python).args(["-c", "import aotpy"]).output().is_ok_and(|output| output.status.success());
    if !is_there {
        let is_required = std::env::var_os("COPHASE_REQUIRE_AOTPY").is_some_and(|value| value == "1");
        assert!(!is_required, "{python} has no aotpy");
        println!("skipped: {python} has no aotpy");
    }
    is_there.then_some(python)
}

fn run(desk: &Desk, python: &str, arguments: &[&str]) {
    let output =
        Command::new(python).args(["-W", "ignore", "-c", SCRIPT]).args(arguments).current_dir(desk.path("")).output();
    let output = output.unwrap();
    assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
}

#[test]
#[ignore = "merge: 8 s"]
fn a_night_through_aot_has_the_bits_of_one_through_our_fits() {
    let desk = desk();
    assert!(estimate(&desk, "aot.fits", &[]) == estimate(&desk, "sky.fits", &[]), "an estimate from AOT differs");
    // The scene and the truth are in the file, too.
    let truth = ["sky.fits", "aot.fits"].map(|name| desk.json(&["compare", "est.fits", "--truth", name, "--json"]));
    assert_eq!(truth[0], truth[1]);
    assert!(!text_column(&desk.path("est.fits"), "SCENE", "LINE").is_empty());
    let check = |name: &str| desk.run(&["check", name, "--json"]).out.replace(name, "");
    assert_eq!(check("aot.fits"), check("sky.fits"));
}

/// The first scene of `images`, with what AOT cannot say: the defocus, and the number of modes of
/// the own scene.
fn first_scene(desk: &Desk, images: &str) -> String {
    let text = desk.succeeds(&["scene", "--from", images]).out;
    std::fs::write(desk.path("first.toml"), text.replace("focus_waves_rms = 1.5", "focus_waves_rms = 1.0")).unwrap();
    text
}

#[test]
#[ignore = "merge: 8 s"]
fn first_scene_of_aot_tables_estimates_as_the_own_scene() {
    let desk = desk();
    let text = first_scene(&desk, "aot.fits");
    for line in [
        "aperture = \"hexagonal\"",
        "rings = 1",
        "central_segment = true",
        "segment_side_m = 0.9",
        "segment_gap_m = 0.003",
        "grid_m = 5.625",
        "lenslets_across = 10",
        "subaperture_file = \"aot.fits[SUBAPERTURE_MASK]\"",
        "detector = \"quad-cell\"",
        "actuators_across = 11",
        "actuator_file = \"aot.fits\"",
        "interaction_file = \"aot.fits[INTERACTION_MATRIX]\"",
        "command_matrix_file = \"aot.fits[CONTROL_MATRIX]\"",
        "r0_m = 0.2",
        "wind_m_s = [6.8, 26.9]",
        "wind_dir_rad = [0.3, 2.0]",
        "frame_rate_hz = 1054.0",
    ] {
        assert!(text.lines().any(|own| own.starts_with(line)), "{line}:\n{text}");
    }
    // The scene's own matrices are those of the file, so that the loop's response, and with it the
    // estimate, is the same but for the pupil samples (120 by default, 64 of the own scene) and
    // modes: the residual does not grow by more than a third.
    let residual = |scene: &str| {
        let options = ["--scene", scene, "--set", "pupil.samples=64", "--set", "modes.ncpa_count=30"];
        estimate(&desk, "aot.fits", &options);
        let found = desk.json(&["compare", "est.fits", "--truth", "sky.fits", "--json"]);
        ["phasing", "ncpa"].map(|part| number(&found, &format!("{part}_residual_nm")))
    };
    let (own, first) = (residual("sky.toml"), residual("first.toml"));
    assert!(first.iter().zip(&own).all(|(first, own)| first < &(1.33 * own)), "{first:?} {own:?}");
}

#[test]
fn scenes_without_an_aot_form_are_refused_before_the_run() {
    let desk = desk();
    let order = ["--set", "wavefront_sensor.slope_order=[\"interleaved\"]"];
    let arguments = [["simulate", "sky.toml", "-o", "a.fits", "--aot", "b.fits"].as_slice(), &order].concat();
    desk.refuses(&arguments, &["wavefront_sensor.slope_order", "interleaved", "all x, then all y"]);
    desk.refuses(&["simulate", "sky.toml", "-o", "a.fits", "--aot", "a.fits"], &["-o", "--aot"]);
}

#[test]
fn aotpy_reads_our_file_and_its_copy_has_the_same_bits() {
    let Some(python) = aotpy() else { return };
    let desk = desk();
    run(&desk, &python, &["read", "aot.fits", "again.fits"]);
    assert!(estimate(&desk, "again.fits", &[]) == estimate(&desk, "sky.fits", &[]), "aotpy's copy differs");
    // But for the names of files and extensions, and comments, the first scene is the same.
    let lines = |text: String| {
        let keys = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim_end().to_owned());
        keys.filter(|line| !line.contains("again.fits") && !line.contains("aot.fits")).collect::<Vec<_>>()
    };
    assert_eq!(lines(first_scene(&desk, "again.fits")), lines(first_scene(&desk, "aot.fits")));
}

#[test]
fn aotpy_files_are_read_or_refused_with_the_missing_part() {
    let Some(python) = aotpy() else { return };
    let desk = desk();
    run(&desk, &python, &["make", "sky.fits", "."]);
    let with_scene = ["--scene", "sky.toml"];
    let expected = estimate(&desk, "sky.fits", &with_scene);
    for name in ["odd.fits", "bare.fits"] {
        assert!(estimate(&desk, name, &with_scene) == expected, "{name}");
    }
    // Another unit: slopes of the same size, to the rounding of a quotient and a product.
    let slopes = |name: &str| Images::only(Images::read(desk.path(name), None).unwrap()).unwrap().slopes_mas;
    let (ours, converted) = (slopes("sky.fits").unwrap(), slopes("arcsec.fits").unwrap());
    assert_eq!(ours.dim(), converted.dim());
    assert!(ours.iter().zip(&converted).all(|(a, b)| (a - b).abs() <= 2.0 * f64::EPSILON * a.abs()));

    assert_eq!(slopes("no-slopes.fits"), None);
    assert_eq!(slopes("few.fits"), None);
    let notes = Images::only(Images::read(desk.path("few.fits"), None).unwrap()).unwrap().notes;
    assert!(
        notes.iter().any(|note| note.contains("3 measurements for 4 images") && note.contains("TIMESTAMPS")),
        "{notes:?}"
    );
    let refused = |name: &str, words: &[&str]| {
        desk.refuses(&["estimate", name, "-o", "none.fits", "--scene", "sky.toml"], words);
    };
    refused("no-camera.fits", &["no scoring camera", "AOT_SCORING_CAMERAS"]);
    refused("no-detector.fits", &["no images", "(Camera)", "DETECTOR_UID"]);
    refused("no-images.fits", &["no images", "(Camera)", "PIXEL_INTENSITIES"]);
    refused("unit.fits", &["furlong", "mas, arcsec, rad, pix"]);
    refused("mask.fits", &["subaperture mask MASK", "each once"]);
    // Without a scene, in the file or beside it, there is no model of the instrument.
    desk.refuses(&["estimate", "bare.fits", "-o", "none.fits"], &["holds no scene", "--scene"]);
}

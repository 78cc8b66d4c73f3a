//! Sentences that name the cause: the setting, the file, the grid.

use crate::Desk;

#[test]
fn wrong_setting_is_named_and_not_the_line_of_the_preset() {
    let desk = Desk::with_scene();
    let image = ["image", "keck-artificial", "-o", "new.fits"];
    desk.refuses(
        &[&image[..], &["--set", "image.pixels=7"]].concat(),
        &["keck-artificial", "setting image.pixels", "image.pixels = 7 "],
    );
    // Another key contradicts it: the line of that key, after the setting.
    std::fs::write(desk.path("crop.toml"), "[image]\nwavelength_nm = 2000\npixels = 128\ncrop_pixels = 96\n").unwrap();
    desk.refuses(
        &["image", "crop.toml", "-o", "new.fits", "--set", "image.pixels=64"],
        &["crop.toml line 4: image.crop_pixels = 96", "(after setting image.pixels)"],
    );
}

#[test]
fn a_file_that_the_scene_names_is_missed_by_every_verb() {
    let desk = Desk::with_images(&[]);
    let missing = ["--set", "mirror.actuator_file=actuatros.txt"];
    for verb in [
        &["image", "scene.toml", "-o", "new.fits"][..],
        &["estimate", "images.fits", "-o", "est.fits"],
        &["estimate", "images.fits", "--scene", "scene.toml", "-o", "est.fits"],
        &["plan", "scene.toml", "--budget-nm", "5"],
    ] {
        desk.refuses(&[verb, &missing[..]].concat(), &["actuatros.txt", "no such file", "mirror.actuator_file"]);
    }
}

#[test]
fn a_truth_of_another_pupil_is_refused() {
    let desk = Desk::with_images(&[]);
    desk.succeeds(&["estimate", "images.fits", "-o", "est.fits"]);
    desk.succeeds(&["image", "scene.toml", "-o", "ring.fits", "--set", "pupil.central_obscuration_m=1.0"]);
    desk.refuses(&["compare", "est.fits", "--truth", "ring.fits"], &["ring.fits", "true phasing", "no value"]);
}

/// The figure above a map is that of the report, and an estimate that is not sound says so on its
/// picture.
#[test]
fn a_picture_has_the_figures_of_the_report_and_its_warnings() {
    let desk = Desk::with_images(&[]);
    let json = desk.json(&["estimate", "images.fits", "-o", "est.fits", "--plot", "est.svg", "--json"]);
    let svg = std::fs::read_to_string(desk.path("est.svg")).unwrap();
    let rms = crate::number(&json, "phasing_rms_nm");
    assert!(rms > 10.0 && rms < 100.0, "{rms}");
    assert!(svg.contains(&format!("{rms:.1} nm RMS")), "{rms} is not above its map");
    assert_eq!(svg.contains("Warning:"), json["warnings"].as_array().is_none_or(|warnings| !warnings.is_empty()));
    // A plate scale that is a tenth wrong: the fit is bad.
    let wrong = ["--set", "image.samples_per_lambda_over_d=1.8", "--plot", "bad.svg", "--quiet"];
    desk.succeeds(&[&["estimate", "images.fits", "-o", "bad.fits"], &wrong[..]].concat());
    let svg = std::fs::read_to_string(desk.path("bad.svg")).unwrap();
    assert!(svg.contains("Warning:"));
}

#[test]
fn a_plan_compares_itself_without_times_less() {
    let desk = Desk::with_scene();
    let plan = desk.succeeds(&["plan", "scene.toml", "--budget-nm", "5"]).out;
    assert!(plan.contains("times as many operations") && plan.contains("times as much time"), "{plan}");
    assert!(!plan.contains("times less") && !plan.contains("times fewer"), "{plan}");
}

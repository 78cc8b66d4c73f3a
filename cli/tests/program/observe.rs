//! `cophase plan --observe`.

use crate::Desk;

#[test]
#[ignore = "merge: 16 s"]
fn recommended_observation_is_written_as_a_readable_scene() {
    let desk = Desk::with_scene();
    let words = ["plan", "scene.toml", "--observe", "--budget-nm", "2", "-o", "observe.toml"];
    let table = desk.succeeds(&words).out;
    assert!(table.contains("* ") && table.contains("exposures") && table.contains("waves"), "{table}");
    let plan = desk.json(&[&words[..], &["--json"]].concat());
    assert_eq!(plan["met"], true, "{plan}");
    let best = &plan["observations"][0];
    assert!(best["phasing_nm"].as_f64().unwrap() <= 2.0 && best["ncpa_nm"].as_f64().unwrap() <= 2.0, "{plan}");
    let made = desk.json(&["image", "observe.toml", "-o", "images.fits", "--json"]);
    let channels = best["channels"].as_array().unwrap().len() as u64;
    assert_eq!(made["images"].as_u64().unwrap(), best["exposures"].as_u64().unwrap() * channels, "{made} {plan}");
}

#[test]
#[ignore = "merge: 16 s"]
fn unreachable_budgets_and_unplannable_scenes_are_refused() {
    let desk = Desk::with_scene();
    let words = ["plan", "scene.toml", "--observe", "--budget-nm", "1e-6"];
    desk.refuses(&[&words[..], &["-o", "observe.toml"]].concat(), &["no observation", "0.000001 nm", "observe.toml"]);
    assert!(!desk.path("observe.toml").exists());
    assert!(desk.succeeds(&words).err.contains("no observation"));
    desk.refuses(&["plan", "keck-onsky", "--observe", "--budget-nm", "1"], &["behind an AO loop"]);
    desk.refuses(
        &["plan", "scene.toml", "--observe", "--budget-nm", "1", "--wavelengths-nm", "0"],
        &["a wavelength of 0 nm"],
    );
    let usage = desk.run(&["plan", "scene.toml", "--budget-nm", "1", "--wavelengths-nm", "1000"]);
    assert_eq!(usage.status, 2, "{}", usage.err);
}

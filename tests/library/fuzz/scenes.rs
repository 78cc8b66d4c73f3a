//! Scenes: every key with hostile values, and what is accepted of them is built and imaged.

use super::{generator, pick, probes, seeds, word};
use cophase::modal::ModalFitter;
use cophase::scene::{Scene, reference};
use cophase::source;
use rand::RngExt;
use std::path::Path;

/// A telescope that is built and imaged in milliseconds.
const TINY: [(&str, &str); 12] = [
    ("pupil.aperture", "hexagonal"),
    ("pupil.rings", "1"),
    ("pupil.samples", "16"),
    ("image.wavelength_nm", "2000"),
    ("image.pixels", "16"),
    ("image.diversity_focus_waves_rms", "0.5"),
    ("image.read_noise_e", "3"),
    ("aberrations.truth_samples", "32"),
    ("aberrations.segment_piston_rms_nm", "30"),
    ("modes.ncpa", "zernike"),
    ("modes.ncpa_count", "3"),
    ("modes.exact_zernikes", "none"),
];

/// Numbers, words and shapes that no key, or not every key, can take.
const HOSTILE: [&str; 34] = [
    "0",
    "-0.0",
    "1",
    "-1",
    "2",
    "3",
    "16",
    "30",
    "64",
    "0.5",
    "1e-300",
    "5e-324",
    "1e300",
    "1e18",
    "inf",
    "-inf",
    "nan",
    "9223372036854775807",
    "-9223372036854775808",
    "1e400",
    "true",
    "\"\"",
    "\"none\"",
    "\"auto\"",
    "\"keck\"",
    "\"\\u0000\"",
    "[]",
    "[0]",
    "[1, 2]",
    "[nan]",
    "[[1]]",
    "{ a = 1 }",
    "1979-05-27",
    "\"geometric\"",
];

/// Every key, as `section.key`, from the reference that the parser's own table makes.
fn keys() -> Vec<String> {
    let (mut keys, mut section) = (Vec::new(), String::new());
    for line in reference().lines() {
        if let Some((name, _)) = line.strip_prefix('[').and_then(|rest| rest.split_once(']')) {
            section = name.to_string();
        } else if let Some(rest) = line.strip_prefix("  ").filter(|rest| !rest.starts_with(' ')) {
            let end = rest.find([':', ' ']).expect("a key ends somewhere");
            keys.push(format!("{section}.{}", &rest[..end]));
        }
    }
    assert!(keys.len() > 60, "the reference lists {} keys", keys.len());
    keys
}

/// The text of the tiny scene with `key` given as `value`, whatever that is.
fn text(key: &str, value: &str) -> String {
    let quoted = |value: &str| if value.parse::<f64>().is_ok() { value.to_string() } else { format!("{value:?}") };
    let mut settings: Vec<(&str, String)> = TINY.iter().map(|(key, value)| (*key, quoted(value))).collect();
    settings.retain(|(known, _)| *known != key);
    settings.push((key, value.to_string()));
    settings.into_iter().map(|(key, value)| format!("{key} = {value}\n")).collect()
}

/// Builds and images what `text` describes, if it is a scene. Only a value that makes the model
/// large is left to the other tests: what such a model takes of memory has a formula, and a test of
/// its own.
fn build(text: &str) -> (bool, bool) {
    if !probes::scene(text) {
        return (false, false);
    }
    // The sections of the loop behind the telescope say nothing of a model, nor of a star without
    // turbulence.
    if ["mirror.", "turbulence.", "wavefront_sensor.", "control."].iter().any(|section| text.contains(section)) {
        return (true, false);
    }
    let scene = Scene::from_text(text, Path::new("")).unwrap();
    let sizes = [scene.image.pixels, scene.image.count, scene.modes.ncpa_count, scene.pupil.samples];
    if sizes.iter().any(|&size| size > 64) || scene.pupil.rings > 3 || scene.estimate.budget_nm.is_some() {
        return (true, false);
    }
    let estimator = ModalFitter::new(&scene, false).inspect_err(probes::one_sentence);
    let images = source::simulate(&scene).inspect_err(probes::one_sentence);
    if let Ok(images) = images {
        assert!(
            images.iter().flat_map(|images| &images.images_e).all(|e| e.is_finite()),
            "an image that is not finite:\n{text}"
        );
    }
    (true, estimator.is_ok())
}

#[test]
#[ignore = "merge: 74 s"]
fn every_key_with_hostile_values() {
    let (mut accepted, mut built, mut refused) = (0, 0, 0);
    assert_eq!(build(&text("image.read_noise_e", "3")), (true, true));
    for key in keys() {
        for value in HOSTILE {
            match build(&text(&key, value)) {
                (false, _) => refused += 1,
                (true, done) => {
                    accepted += 1;
                    built += usize::from(done);
                }
            }
        }
    }
    println!("{refused} refused, {accepted} accepted, {built} of them built");
    assert!(refused > 1000 && accepted > 300 && built > 100);
}

#[test]
fn two_keys_with_hostile_values() {
    let (keys, mut rng) = (keys(), generator(43));
    let mut accepted = 0;
    // About one pair in a hundred is accepted.
    for _ in 0..3000 {
        let mut scene = text(pick(&mut rng, &keys[..]).as_str(), word(&mut rng, &HOSTILE));
        let (key, value) = (pick(&mut rng, &keys[..]).as_str(), word(&mut rng, &HOSTILE));
        scene = scene
            .lines()
            .filter(|line| !line.starts_with(&format!("{key} ")))
            .map(|line| format!("{line}\n"))
            .collect();
        accepted += usize::from(build(&format!("{scene}{key} = {value}\n")).0);
    }
    assert!(accepted > 15, "{accepted} accepted");
}

#[test]
fn seeds_of_scenes_and_settings() {
    let accepted = |target: &str, probe: fn(&str) -> bool| {
        let read = |(_, bytes): &(String, Vec<u8>)| probe(&String::from_utf8_lossy(bytes));
        seeds(target).iter().filter(|seed| read(seed)).count()
    };
    // The presets and those of the C tests are scenes.
    assert!(accepted("scene", probes::scene) >= 4);
    assert!(accepted("settings", probes::settings) >= 1);
}

#[test]
fn settings_of_random_words() {
    let (keys, mut rng) = (keys(), generator(44));
    for _ in 0..1500 {
        let mut line = format!("{}={}", pick(&mut rng, &keys), pick(&mut rng, &HOSTILE));
        for _ in 0..rng.random_range(0..3) {
            let at = rng.random_range(0..=line.len());
            let Some((at, _)) = line.char_indices().nth(at) else { continue };
            line.insert_str(at, word(&mut rng, &["=", ".", "\"", "[", " ", "é", "\u{0}", "\r", ","]));
        }
        probes::settings(&line);
    }
}

//! The golden vectors of tests/golden, through C.

use super::{doubles, dumps, root, same, words};
use cophase::io;
use cophase::modal::{ModalFitter, Session, SessionOptions};
use cophase::scene::Scene;
use ndarray::{Array2, ArrayView2, s};
use std::path::{Path, PathBuf};
use std::sync::Arc;

const POINTS: usize = 5;
/// Segment modes of the golden basis; they come first.
const PISTONS: usize = 36;
const MODES: usize = 102;

fn file(name: &str) -> PathBuf {
    root().join("tests/golden").join(name)
}

/// The golden scene with that program's choices, as tests/golden.rs has them; without its files
/// where `arrays` stand for them.
fn scene(weighting: &str, arrays: bool) -> String {
    let text = std::fs::read_to_string(file("scene.toml")).unwrap();
    let kept = |line: &&str| !arrays || !(line.starts_with("file") || line.starts_with("diversity_file"));
    let text: String = text.lines().filter(kept).flat_map(|line| [line, "\n"]).collect();
    let cropped = text.replace("pixels  = 240\n", "pixels  = 240\ncrop_pixels = 240\n");
    assert_ne!(text, cropped);
    let segment = if arrays { "segment = \"piston\"\n" } else { "" };
    format!(
        "{cropped}exact_zernikes = []\n{segment}[estimate]\nweighting = \"{weighting}\"\nfit_flux = false\n\
         fit_background = false\nrecentre = false\n"
    )
}

fn numbers(value: &serde_json::Value) -> Vec<f64> {
    match value {
        serde_json::Value::Array(values) => values.iter().flat_map(numbers).collect(),
        number => vec![number.as_f64().unwrap()],
    }
}

/// What golden.c reads.
fn data(key: &str) -> Vec<f64> {
    let json: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(file("objective.json")).unwrap()).unwrap();
    let map = |name: &str, hdu: &str| io::read_map(file(name), Some(hdu)).unwrap();
    let modes = io::read_cube(file("modes.fits.gz"), "BASIS").unwrap();
    let mut data = numbers(&json["coefficients_nm"]);
    data.extend(numbers(&json[key]["J"]).into_iter().chain(numbers(&json[key]["dJ_dnm"])));
    data.extend(map("inspan.fits.gz", "IMAGES").iter().chain(&map("pupil.fits.gz", "PUPIL")));
    data.extend(map("pupil.fits.gz", "SEGMENT"));
    data.extend(modes.slice(s![PISTONS.., .., ..]));
    data.extend(map("diversity.fits.gz", "DIVERSITY"));
    data
}

/// Objectives and gradients in Rust.
fn evaluated(scene: &Path, points_nm: ArrayView2<f64>) -> Vec<f64> {
    let scene = Scene::from_text(&std::fs::read_to_string(scene).unwrap(), &file("")).unwrap();
    let estimator = Arc::new(ModalFitter::new(&scene, false).unwrap());
    let mut session = Session::new(estimator, &SessionOptions { capacity: POINTS, ..Default::default() }).unwrap();
    let image: Array2<f64> = io::read_map(file("inspan.fits.gz"), Some("IMAGES")).unwrap();
    for k in 0..POINTS {
        session.frame_mut(k, 0).unwrap().0.assign(&image);
    }
    session.load(0, POINTS, None).unwrap();
    let (mut objectives, mut gradients) = (vec![0.0; POINTS], vec![0.0; points_nm.len()]);
    session.evaluate(0, points_nm, &mut objectives, &mut gradients).unwrap();
    objectives.into_iter().chain(gradients).collect()
}

#[test]
fn objectives_and_gradients_are_golden() {
    if !words("COPHASE_C_RUNNER").is_empty() {
        println!(
            "skipped: models of this size take more than three minutes under valgrind, and small ones do the same"
        );
        return;
    }
    for (weighting, key) in [("none", "unweighted"), ("noise", "weighted")] {
        let directory = tempfile::tempdir().unwrap();
        let [files, arrays, given] = ["files.toml", "arrays.toml", "data"].map(|name| directory.path().join(name));
        let data = data(key);
        std::fs::write(&files, scene(weighting, false)).unwrap();
        std::fs::write(&arrays, scene(weighting, true)).unwrap();
        std::fs::write(&given, data.iter().flat_map(|value| value.to_ne_bytes()).collect::<Vec<_>>()).unwrap();
        let points_nm = Array2::from_shape_vec((POINTS, MODES), data[..POINTS * MODES].to_vec()).unwrap();
        let expected = evaluated(&files, points_nm.view());
        dumps("golden.c", &[&files, &arrays, &file(""), &given], |dump| {
            same(key, &doubles(dump), &expected);
        });
    }
}

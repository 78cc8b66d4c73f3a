//! Files that a scene names: one that does not exist is missed, whether or not the estimate reads
//! it.

use crate::common::{images_of, simulated};
use crate::consistency::scene;
use cophase::Error;
use cophase::io::{FitsWriter, Pixel};
use cophase::pipeline::{Estimator, embedded_scene};
use cophase::scene::Scene;
use std::path::Path;

fn refusal(scene: &Scene) -> String {
    match Estimator::new(scene).map(|_| ()) {
        Err(error @ Error::File { .. }) => error.to_string(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn an_estimator_misses_every_file_that_its_scene_names() {
    let folder = tempfile::tempdir().unwrap();
    let named = |settings: &[(&str, &str)]| Scene::from_text(scene(settings).text(), folder.path()).unwrap();
    // The modes of a modal estimate do not depend on this file, so that nothing reads it.
    let missing = named(&[("mirror.actuator_file", "none.txt")]);
    let sentence = refusal(&missing);
    for words in ["none.txt", "no such file", "mirror.actuator_file"] {
        assert!(sentence.contains(words), "{sentence}");
    }
    assert_eq!(missing.files(), [("mirror.actuator_file", folder.path().join("none.txt"))]);
    let map = named(&[("image.diversity_file", "none.fits[2]"), ("image.diversity_focus_waves_rms", "")]);
    let sentence = refusal(&map);
    assert!(sentence.contains("none.fits") && sentence.contains("image.diversity_file"), "{sentence}");
    std::fs::write(folder.path().join("none.txt"), "").unwrap();
    assert!(Estimator::new(&missing).is_ok());
    // A map of NCPA is what simulated images are made with, and no estimate reads it.
    let drawn = [("aberrations.ncpa_rms_nm", ""), ("aberrations.ncpa_zernikes", "")];
    let made =
        scene(&[&drawn[..], &[("aberrations.ncpa_power_law", ""), ("aberrations.ncpa_file", "a.fits")]].concat());
    assert!(Estimator::new(&made).is_ok());
}

#[test]
#[ignore = "merge: 5 s"]
fn estimator_keeps_its_model_until_a_scene_file_changes() {
    let folder = tempfile::tempdir().unwrap();
    let filter = folder.path().join("filter.csv");
    let path = filter.display().to_string();
    let scene = scene(&[("image.filter_file", &*path), ("estimate.model", "scene")]);
    let wide = "2000, 0\n2100, 1\n2300, 1\n2400, 0\n";
    std::fs::write(&filter, wide).unwrap();
    let (images, estimator) = (simulated(&scene), Estimator::new(&scene).unwrap());
    let estimates = |estimator: &Estimator| estimator.estimate(&images).unwrap().modes.coefficients_nm;
    let found = estimates(&estimator);
    assert_eq!(estimates(&estimator), found);
    std::fs::write(&filter, wide.replace("2100", "2150")).unwrap();
    let changed = estimates(&estimator);
    assert_ne!(changed, found);
    assert_eq!(changed, estimates(&Estimator::new(&scene).unwrap()));
}

#[test]
fn the_scene_in_an_image_file_may_name_files_of_another_machine() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("images.fits");
    let plain = scene(&[]);
    let images = simulated(&plain);
    let elsewhere = plain.with(&[("mirror.actuator_file", "/elsewhere/none.txt")]).unwrap();
    let mut file = FitsWriter::create(&path).unwrap();
    file.image("IMAGES", &images.images_e, Pixel::F64, "electron").unwrap();
    file.text("SCENE", elsewhere.text()).unwrap();
    file.finish().unwrap();
    let embedded = embedded_scene(&path, |_| false).unwrap().unwrap();
    assert_eq!(embedded.mirror.actuator_file.as_deref(), Some(Path::new("/elsewhere/none.txt")));
    let [found, expected] = [(&embedded, &images_of(&path, None)), (&plain, &images)]
        .map(|(scene, images)| Estimator::new(scene).unwrap().estimate(images).unwrap());
    assert_eq!(found.modes.coefficients_nm, expected.modes.coefficients_nm);
    // The same text as a scene of its own is not.
    assert!(refusal(&elsewhere).contains("/elsewhere/none.txt"));
}

//! Full-phase estimates behind a loop whose reference slopes a correction has moved: the telemetry
//! is relative to them.

use crate::common::images_of;
use crate::full_phase::sky;
use cophase::Control;
use cophase::ao::{self, Shot};
use cophase::pipeline::{Estimate, Estimator, Images, SentCorrections};
use cophase::scene::Scene;
use ndarray::Array1;
use std::path::Path;

/// Exposures of `scene` after the corrections `sent`, read from a file.
fn images(scene: &Scene, sent: &[SentCorrections], path: &Path) -> Images {
    let mut simulator = SentCorrections::system(sent, scene).unwrap();
    let mut shots: Vec<Shot> = Vec::new();
    let summary = simulator.run(&mut shots, &Control::default()).unwrap();
    ao::write(path, scene.text(), &simulator, &shots, &summary).unwrap();
    images_of(path, None)
}

fn read(scene: &Scene, images: &Images) -> Estimate {
    Estimator::new(scene).unwrap().estimate(images).unwrap()
}

#[test]
#[ignore = "merge: 11 s"]
fn moved_reference_is_read_from_images_and_sent_corrections() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let settings = [
        ("estimate.method", "full-phase"),
        ("estimate.model", "scene"),
        ("commands.deadband_sigma", "0"),
        ("image.count", "4"),
    ];
    let scene = Scene::from_file(sky()).unwrap().with(&settings).unwrap();
    let before = images(&scene, &[], &path("0.fits"));
    assert!(before.moved_reference_mas.is_none());
    let corrections = read(&scene, &before).corrections(None).unwrap();
    corrections.write(&path("c.fits")).unwrap();

    let after = images(&scene, &[SentCorrections::read(&path("c.fits")).unwrap()], &path("1.fits"));
    let moved_mas = after.moved_reference_mas.clone().unwrap();
    assert_eq!(moved_mas.to_vec(), corrections.slopes_mas);
    // Slopes of another file come with the reference of that file.
    let other = after.clone().with_slopes(path("0.fits")).unwrap();
    assert!(other.moved_reference_mas.is_none());
    assert_eq!(other.with_slopes(path("1.fits")).unwrap().moved_reference_mas, after.moved_reference_mas);
    let known = read(&scene, &after);
    // Images that come as arrays, whose scene names the corrections, or the row in a file of
    // images.
    let array = Images { moved_reference_mas: None, ..after.clone() };
    for file in [path("c.fits").display().to_string(), format!("{}[MOVED_REFERENCE]", path("1.fits").display())] {
        let named = scene.with(&[("wavefront_sensor.moved_reference_file", &file)]).unwrap();
        let named = read(&named, &array);
        assert_eq!(named.modes.coefficients_nm, known.modes.coefficients_nm, "{file}");
        assert_eq!(named.modes.covariance_nm2, known.modes.covariance_nm2, "{file}");
    }
    assert_ne!(read(&scene, &array).modes.covariance_nm2, known.modes.covariance_nm2);
}

#[test]
fn moved_reference_slopes_of_another_sensor_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = Scene::from_file(sky()).unwrap().with(&[("estimate.method", "full-phase")]).unwrap();
    let given = images(&scene, &[], &folder.path().join("0.fits"));
    let slopes = given.slopes_mas.as_ref().unwrap().ncols();
    let refused = |moved: Array1<f64>, words: &str| {
        let images = Images { moved_reference_mas: Some(moved), ..given.clone() };
        let error = Estimator::new(&scene).unwrap().estimate(&images).err().unwrap().to_string();
        assert!(error.contains(words), "{error}");
    };
    refused(Array1::zeros(7), "7");
    refused(Array1::from_elem(slopes, f64::NAN), "NaN");
    let missing = scene.with(&[("wavefront_sensor.moved_reference_file", "none.fits")]).unwrap();
    let error = Estimator::new(&missing).err().unwrap().to_string();
    assert!(error.contains("none.fits") && error.contains("moved_reference_file"), "{error}");
}

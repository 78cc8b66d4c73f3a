//! Filter curves from files and temperatures of stars, from the scene to the estimate.

use crate::common::{assert_facts, simulated};
use crate::consistency::scene;
use cophase::Status;
use cophase::modal::{Model, Recipe};
use cophase::pipeline::{Estimate, Estimator, Images};
use cophase::scene::Scene;
use cophase::{Error, Result};

/// Rises slowly to the red, with a dip and a sharp edge: mean and middle differ. nm and
/// transmission.
const CURVE: &str = "# nm, transmission\n2000, 0.05\n2100, 0.30\n2200, 0.55\n2230, 0.40\n2340, 0.95\n2345, 0.0\n";

/// Images of a star of 4000 K through the curve, and the folder of its table.
fn made() -> (tempfile::TempDir, Scene) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("k.csv"), CURVE).unwrap();
    let keys = [("image.filter_file", "k.csv"), ("image.star_temperature_k", "4000"), ("estimate.model", "scene")];
    let made = Scene::from_text(scene(&keys).text(), folder.path()).unwrap();
    (folder, made)
}

/// Residuals of phasing and NCPA over their error bars, after they are printed.
fn pulls(what: &str, found: &Estimate) -> [f64; 2] {
    let residual_nm = found.truth.as_ref().unwrap().1.rms_nm;
    let sigma_nm = [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm];
    println!("{what}: residual {residual_nm:.3?} nm, error bars {sigma_nm:.3?} nm, χ² {:.3}", found.reduced_chi2);
    [residual_nm[0] / sigma_nm[0], residual_nm[1] / sigma_nm[1]]
}

#[test]
#[ignore = "merge: 6 s"]
fn estimate_is_right_only_with_filter_curve_and_star() {
    let (_folder, made) = made();
    let images = simulated(&made);
    let without_curve = [("image.filter_file", ""), ("image.star_temperature_k", "")];
    let cases: [(&str, &[(&str, &str)]); 5] = [
        ("curve and star", &[]),
        ("curve alone", &[("image.star_temperature_k", "")]),
        ("mean wavelength of both", &[("estimate.wavelengths", "1")]),
        ("top hat of its width", &[without_curve[0], without_curve[1], ("image.bandwidth_fraction", "0.159")]),
        ("image.wavelength_nm alone", &without_curve),
    ];
    for (number, (what, settings)) in cases.into_iter().enumerate() {
        let scene = made.with(settings).unwrap();
        let found = Estimator::new(&scene).unwrap().estimate(&images).unwrap();
        let pulls = pulls(what, &found);
        match number {
            0 => assert!(found.status == Status::Ok && pulls.iter().all(|pull| *pull < 3.0), "{pulls:?}"),
            _ => assert!(found.status != Status::Ok, "{what}"),
        }
    }
}

#[test]
fn one_wavelength_of_a_model_is_the_mean_of_the_photons() {
    let (_folder, made) = made();
    let one = made.with(&[("estimate.wavelengths", "1")]).unwrap();
    let [broad, mean] = [&made, &one].map(model);
    let nm = |model: &Model| model.optics.parts().wavelength_nm;
    // By the trapezoidal rule of the curve it is 2217.5 nm; the star moves it by some nm to the
    // blue.
    println!("mean {:.3} nm", nm(&mean));
    assert!(nm(&broad) == nm(&mean) && (2195.0..2217.0).contains(&nm(&mean)), "{}", nm(&mean));
    assert!(mean.optics.has_one_wavelength());
    let colours = &broad.optics.parts().colours;
    let centre: f64 = colours.iter().map(|colour| colour.ratio * colour.share).sum();
    assert!(colours.len() > 2 && (centre - 1.0).abs() < 1e-13, "{colours:?}");
    // A pixel is a fixed angle.
    let per_nm = mean.optics.sampling().pixels_per_lambda_over_d / nm(&mean);
    let flat = made.with(&[("image.filter_file", ""), ("image.star_temperature_k", "")]).unwrap();
    let flat = model(&flat);
    assert!((per_nm / (flat.optics.sampling().pixels_per_lambda_over_d / nm(&flat)) - 1.0).abs() < 1e-13);
}

fn model(scene: &Scene) -> Model {
    Model::new(scene, &Recipe::from_scene(scene), false).unwrap()
}

#[test]
fn keys_that_contradict_a_filter_file_are_refused() {
    let (folder, made) = made();
    let sentence = |result: Result<Estimate>| result.unwrap_err().to_string();
    let images = simulated(&made);
    let estimate = |scene: &Scene| Estimator::new(scene)?.estimate(&images);
    let both = made.with(&[("image.bandwidth_fraction", "0.1")]).unwrap_err().to_string();
    assert_facts(&both, "'image.filter_file' | image.bandwidth_fraction = 0.1 | both");
    let width = made.with(&[("estimate.fit_optics", "[\"bandwidth\"]")]).unwrap();
    let width = sentence(estimate(&width));
    assert_facts(&width, "\"bandwidth\" | filter from a file");
    assert_eq!(made.files(), [("image.filter_file", folder.path().join("k.csv"))]);
    for (table, words) in [
        ("2000\n2300\n", "line 1: 1 columns"),
        ("2300 1\n2000 1\n", "line 2: 2000 nm follows 2300 nm"),
        ("2000 1\n2300 nan\n", "line 2 | 'nan' | finite number"),
        ("2000 1\n2300 -1\n", "line 2: a transmission of -1"),
        ("1500 1\n1800 1\n", "image.wavelength_nm = 2168.6 | 1500 to 1800 nm"),
    ] {
        std::fs::write(folder.path().join("k.csv"), table).unwrap();
        let found = sentence(estimate(&made));
        assert_facts(&found, &format!("k.csv | {words}"));
        // The simulator reads the same table.
        assert_eq!(Images::simulated(&made).unwrap_err().to_string(), found);
    }
    std::fs::remove_file(folder.path().join("k.csv")).unwrap();
    let missing = estimate(&made).unwrap_err();
    assert!(matches!(missing, Error::File { .. }), "{missing}");
    let missing = missing.to_string();
    assert!(missing.contains("k.csv") && missing.contains("image.filter_file"), "{missing}");
}

#[test]
fn a_channel_has_its_own_filter() {
    let (_folder, made) = made();
    let narrow = "\n[[image.channel]]\nname = \"narrow\"\nbandwidth_fraction = 0.01\nstar_temperature_k = 3000\n";
    let text = format!("{}\n{narrow}\n[[image.channel]]\nname = \"broad\"\n", made.text());
    let scene = Scene::from_text(&text, made.directory()).unwrap();
    let [narrow, broad] = scene.channels() else { panic!("two channels") };
    let image = &narrow.scene.image;
    assert!(
        image.filter_file.is_none() && image.bandwidth_fraction == 0.01 && image.star_temperature_k == Some(3000.0)
    );
    let image = &broad.scene.image;
    assert!(image.filter_file.is_some() && image.bandwidth_fraction == 0.0 && image.star_temperature_k == Some(4000.0));
    assert!(scene.files().iter().all(|(key, _)| *key == "image.filter_file"));
}

//! Pupils that turn on the detector: each image is fitted with its own turn.

use crate::channels::{PAIR, is_right, with_channels};
use crate::common::{assert_facts, simulated};
use crate::consistency::{scene, shown};
use cophase::pipeline::{Estimate, Estimator, Images, Part, PartFits, Trust};
use cophase::scene::Scene;

const TURNS_DEG: &str = "[3.0, -4.0, 0.5, 3.01]";

fn turning(turns_deg: &str) -> Scene {
    scene(&[("image.count", "4"), ("image.pupil_turns_deg", turns_deg)])
}

#[test]
fn images_of_a_turning_pupil_are_fitted_each_with_its_turn() {
    let scene = turning(TURNS_DEG);
    let images = simulated(&scene);
    let estimator = Estimator::new(&scene).unwrap();
    let found = shown(estimator.estimate(&images).unwrap());
    assert!(found.is_sound() && is_right(&found), "{:?}", found.warnings);
    // Two images within 0.05 degrees are of one turn.
    assert_eq!(found.channels, ["turn -4.000", "turn +0.500", "turn +3.005"]);
    let channels: Vec<usize> = found.images.iter().map(|image| image.channel).collect();
    assert_eq!(channels, [2, 0, 1, 2], "the images keep their order");
    assert_eq!(found.scene.text(), scene.text());
    // Each image says as much as any.
    let one = Estimator::new(&turning("[0.0]")).unwrap().estimate(&images.clone()).unwrap();
    let first = simulated(&turning("[3.0]").with(&[("image.count", "1")]).unwrap());
    let single = Estimator::new(&turning("[3.0]")).unwrap().estimate(&first).unwrap();
    assert!(is_right(&single), "one turn for all is no channel: {:?}", single.channels);
    let noise_nm = |found: &Estimate| found.error_budget[0].phasing_nm;
    let ratio = noise_nm(&found) / noise_nm(&single);
    assert!((0.45..0.6).contains(&ratio), "noise of four images over that of one: {ratio}");
    // Without the turns the images contradict the model.
    assert!(!one.is_sound() && one.reduced_chi2 > 1.2 * found.reduced_chi2, "{}", one.reduced_chi2);
    // Parts have the bits of the whole.
    let fit =
        |number| estimator.fit_part(std::slice::from_ref(&images), Part::new(number, 2).unwrap(), Vec::new()).unwrap();
    let mut parts = PartFits::of_all(vec![fit(1), fit(2)]).unwrap();
    let merged = estimator.estimate_from_parts(&[images], &mut parts).unwrap();
    assert_eq!(merged.modes.coefficients_nm, found.modes.coefficients_nm);
}

#[test]
fn channels_turn_each_by_its_own() {
    let turns = "diversity_focus_waves_rms = -0.8\npupil_turns_deg = [2.0, -2.0]\n";
    let channels = PAIR.replace("diversity_focus_waves_rms = -0.8\n", turns);
    let scene = with_channels(&channels, &[("image.count", "2")]);
    let images = Images::simulated(&scene).unwrap();
    let found = shown(Estimator::new(&scene).unwrap().estimate(&images).unwrap());
    assert!(found.is_sound() && is_right(&found), "{:?}", found.warnings);
    assert_eq!(found.channels, ["plus, turn +0.000", "minus, turn -2.000", "minus, turn +2.000"]);
    let channels: Vec<usize> = found.images.iter().map(|image| image.channel).collect();
    assert_eq!(channels, [0, 0, 2, 1]);
}

#[test]
fn turns_of_a_file_are_those_of_a_scene_that_names_their_card() {
    let made = turning(TURNS_DEG);
    let images = Images { scene: Some(made.clone()), ..simulated(&made) };
    let silent = made.without("image.pupil_turns_deg").unwrap();
    let estimate = |scene: &Scene, images: &Images| Estimator::new(scene).unwrap().estimate(images);
    let refused = estimate(&silent, &images).unwrap_err().to_string();
    assert_facts(&refused, "image.pupil_turns_deg = [3, -4, ..., 3.01] | does not name it | --trust file");
    let ruled = silent.with(&[("image.pupil_turn_card", "-PARANG")]).unwrap();
    let trusting = Images { trust: Trust::File, ..images.clone() };
    for found in [estimate(&ruled, &images), estimate(&silent, &trusting)] {
        let found = found.unwrap();
        assert!(is_right(&found));
        assert_eq!(found.scene.image.pupil_turns_deg, made.image.pupil_turns_deg, "the estimate says what it used");
    }
    let other = estimate(&turning("[3.0, 4.0, 0.5, 3.01]"), &images).unwrap_err().to_string();
    assert_facts(&other, "the scene has [3, 4, ..., 3.01]");
    let few = Images { scene: None, ..images };
    let refused = estimate(&turning("[1.0, 2.0, 3.0]"), &few).unwrap_err().to_string();
    assert_facts(&refused, "image.pupil_turns_deg has 3 numbers for 4 images | one for each image");
}

#[test]
fn pupils_that_cannot_turn_are_refused() {
    let turn = ("image.pupil_turns_deg", "[1.0]");
    for (key, value) in [
        ("modes.segment", "piston-tip-tilt"),
        ("pupil.model", "hard"),
        ("aberrations.petal_piston_rms_nm", "10"),
        ("estimate.method", "full-phase"),
    ] {
        let error = scene(&[]).with(&[turn, (key, value)]).map(|_| ()).unwrap_err().to_string();
        assert_facts(&error, "image.pupil_turns_deg is not accepted with");
    }
    let behind_ao = Scene::preset("keck-onsky").unwrap().with(&[turn]).map(|_| ()).unwrap_err().to_string();
    assert_facts(&behind_ao, "image.pupil_turns_deg is not accepted with adaptive optics");
    let wide = [("pupil.grid_m", ""), ("image.pupil_turns_deg", "[6.0, 12.0, 18.0, 24.0]")];
    let tight = Scene::preset("keck-artificial").unwrap().with(&wide).map(|_| ()).unwrap_err().to_string();
    assert_facts(&tight, "beyond its grid | pupil.grid_m of 10.9");
    let error = scene(&[]).with(&[("image.pupil_turns_deg", "[]")]).map(|_| ()).unwrap_err().to_string();
    assert_facts(&error, "image.pupil_turns_deg = []");
    let error = cophase::modal::ModalFitter::new(&turning(TURNS_DEG), false).map(|_| ()).unwrap_err().to_string();
    assert_facts(&error, "one number for each image | cophase estimate");
}

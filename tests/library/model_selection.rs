//! Model selection: segment tilts, Zernikes, reflectivities and shadows that the scene does not
//! name.

use crate::common::{assert_facts, simulated};
use crate::consistency::{scene, shown};
use cophase::Status;
use cophase::pipeline::{Control, Estimate, Estimator, Policy};
use cophase::scene::Scene;

/// Error bars that hold the noise alone.
const NOISE_ALONE: (&str, &str) = ("estimate.posterior", "false");

/// The estimate of an image that was made with `made` beside the scene, by the scene with `read`.
fn estimate(made: &[(&str, &str)], read: &[(&str, &str)], policy: Policy) -> Estimate {
    let images = simulated(&scene(made));
    let scene: Scene = scene(&[made, read].concat());
    let found = Estimator::with_policy(&scene, policy, Control::default()).unwrap().estimate(&images).unwrap();
    shown(found)
}

/// Whether the residual is within three error bars, or 1 nm.
fn is_right(found: &Estimate) -> bool {
    let residual = &found.truth.as_ref().unwrap().1;
    let sigmas = [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm];
    residual.rms_nm.iter().zip(sigmas).all(|(nm, sigma_nm)| *nm < (3.0 * sigma_nm).max(1.0))
}

#[test]
#[ignore = "merge: 8 s"]
fn modes_are_added_where_the_scene_does_not_explain_the_images() {
    for (made, added) in [
        (&[("aberrations.segment_tip_tilt_rms_nm", "30")], "tip and tilt of each segment"),
        (&[("aberrations.ncpa_zernikes", "[4, 60]")], "Zernikes to Noll 91"),
    ] {
        let found = estimate(made, &[], Policy::default());
        assert!(found.is_sound() && is_right(&found), "{:?}", found.warnings);
        assert!(found.model.ends_with(&format!("extended by {added}")), "{}", found.model);
        assert_facts(&found.remarks[0], &format!("extended by {added} | reduced χ² of image 1"));
        // What the modes leave out does not stand for them: the model is the same without.
        let alone = estimate(made, &[NOISE_ALONE], Policy::default());
        assert!(alone.is_sound() && is_right(&alone), "{:?}", alone.warnings);
        assert!(alone.model.ends_with(&format!("extended by {added}")), "{}", alone.model);
        // The modes of the scene alone do not explain the image.
        let own = estimate(made, &[("estimate.model", "scene"), NOISE_ALONE], Policy::default());
        assert!(!own.is_sound() && own.basis.names.len() < found.basis.names.len(), "{:?}", own.status);
        assert!(!is_right(&own), "the test needs an image that the scene's modes do not explain");
        let realtime = estimate(made, &[], Policy::realtime());
        assert_ne!(realtime.status, Status::Ok);
    }
}

#[test]
#[ignore = "merge: 7 s"]
fn modes_are_added_where_a_sum_or_one_image_shows_them() {
    // NCPA of 6 and 13 nm in Zernikes beyond those of the scene: of the first no single image shows
    // anything, of the second the median χ² of the images is 1.4.
    for (rms_nm, status, shows) in [("6", Status::Ok, "the sum of 30 images"), ("13", Status::Misfit, "image 1")] {
        let made = [
            ("image.count", "30"),
            ("image.peak_snr", "60"),
            ("aberrations.ncpa_zernikes", "[4, 60]"),
            ("aberrations.ncpa_power_law", "0"),
            ("aberrations.ncpa_rms_nm", rms_nm),
        ];
        let own = estimate(&made, &[("estimate.model", "scene"), NOISE_ALONE], Policy::default());
        assert!(
            own.status == status
                && own.warnings.iter().any(|warning| warning.contains("mean residual of the 30 images"))
        );
        let found = estimate(&made, &[], Policy::default());
        assert!(found.is_sound() && is_right(&found), "{:?}", found.warnings);
        assert_facts(&found.remarks[0], &format!("extended by Zernikes to Noll 91 | reduced χ² of {shows}"));
    }
}

#[test]
#[ignore = "merge: 12 s"]
fn reflectivities_and_shadows_that_the_images_show_are_fitted() {
    let reflectivities = [("faults.segment_reflectivity_rms", "0.05")];
    let found = estimate(&reflectivities, &[], Policy::default());
    assert!(found.is_sound() && is_right(&found), "{:?}", found.warnings);
    assert!(found.model.ends_with("extended by reflectivities"), "{}", found.model);
    // Seven draws of 5 % RMS.
    let rms = (found.optics.iter().map(|optic| (optic.value - 1.0).powi(2)).sum::<f64>() / 7.0).sqrt();
    assert!(found.optics.len() == 7 && (0.01..0.1).contains(&rms), "{:?}", found.optics);
    assert_facts(&found.report(), "Reflectivities | 7 segments");
    for (key, made, absent, added) in [
        ("pupil.spider_width_m", 0.03, "0", "a spider"),
        ("pupil.central_obscuration_m", 1.1, "0", "a central obscuration"),
    ] {
        let found = estimate(&[(key, &made.to_string())], &[(key, absent)], Policy::default());
        assert!(found.is_sound() && is_right(&found), "{:?}", found.warnings);
        assert!(found.model.ends_with(added), "{}", found.model);
        let fitted = &found.optics[0];
        println!("{key}: {} ± {}", fitted.value, fitted.sigma);
        assert!(fitted.key == key && (fitted.value - made).abs() < 4.0 * fitted.sigma, "{fitted:?}");
    }
}

#[test]
fn misfit_outside_the_modes_remains_a_misfit() {
    // A filter of 5 % that the scene does not have.
    let made = [("image.bandwidth_fraction", "0.1")];
    let found = estimate(&made, &[("image.bandwidth_fraction", "0")], Policy::default());
    assert_eq!(found.status, Status::Misfit);
    assert!(!found.model.contains("extended"), "{}", found.model);
}

/// The fit of a pupil with all light ends far from an image of one that lacks a part.
#[test]
#[ignore = "merge: 12 s"]
fn light_that_the_pupil_lacks_is_found() {
    let labels = ("pupil.segment_labels", "[11, 12, 13, 14, 15, 16, 17]");
    let all_lit = [("pupil.dark_segments", "[]"), labels];
    let dark = estimate(&[("pupil.dark_segments", "[4]"), labels], &all_lit, Policy::default());
    assert!(dark.model.contains("pupil.dark_segments = [4]"), "{} {:?}", dark.model, dark.warnings);
    assert!(dark.is_sound() && dark.scene.pupil.dark_segments == [4], "{:?} {:?}", dark.status, dark.warnings);
    // The error bars of these modes are of nothing.
    let facts = ["No image shows the segments without light", "pupil.dark_segments = [4]", "labels 15"];
    assert!(dark.remarks.iter().any(|remark| facts.iter().all(|fact| remark.contains(fact))), "{:?}", dark.remarks);
    let stop = [("pupil.stop_diameter_m", "4.2"), ("pupil.stop_x_m", "0.1")];
    let none = [("pupil.stop_diameter_m", "0"), ("pupil.stop_x_m", "0")];
    let stopped = estimate(&stop, &none, Policy::default());
    assert!(stopped.status == Status::Ok && is_right(&stopped), "{:?}", stopped.warnings);
    let found = |key: &str| stopped.optics.iter().find(|parameter| parameter.key == key).unwrap().value;
    assert!((found("pupil.stop_diameter_m") - 4.2).abs() < 0.02 && (found("pupil.stop_x_m") - 0.1).abs() < 0.02);
}

#[test]
#[ignore = "merge: 20 s"]
fn shadows_that_the_scene_lacks_are_found_together() {
    let made = [
        ("pupil.stop_diameter_m", 4.2),
        ("pupil.stop_x_m", -0.1),
        ("pupil.central_obscuration_m", 1.3),
        ("pupil.spider_width_m", 0.1),
    ];
    let texts = made.map(|(_, value)| value.to_string());
    let settings: Vec<_> = made.iter().zip(&texts).map(|((key, _), text)| (*key, text.as_str())).collect();
    let images = simulated(&scene(&settings));
    // Its pupil has samples that the true one lacks, so the truth is not compared.
    let found = Estimator::new(&scene(&[])).unwrap().estimate(&images).unwrap();
    assert_eq!(found.status, Status::Ok, "{} {:?}", found.model, found.warnings);
    for (key, value) in made {
        let fitted = found.optics.iter().find(|parameter| parameter.key == key).unwrap();
        // Samples of 5 cm with edges of their exact area.
        assert!((fitted.value - value).abs() < 0.001, "{fitted:?}");
    }
}

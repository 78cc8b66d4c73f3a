//! Optics that are not the scene's, fitted beside the modes.

use super::{NOISE_ALONE, estimate, promised, residuals, scene};
use crate::common::source_images;
use cophase::Error;
use cophase::modal::{Cube, ModalFitter};
use cophase::scene::Scene;
use ndarray::Array3;

const NO_NCPA: [(&str, &str); 3] =
    [("modes.ncpa", "none"), ("modes.exact_zernikes", "none"), ("aberrations.ncpa_rms_nm", "0")];

/// The estimator that `scene` makes of images of `made`; with its residuals and what the error bars
/// promise, nm.
fn found(made: &Scene, scene: &Scene) -> (ModalFitter, [f64; 2], [f64; 2]) {
    let made = source_images(made);
    let (estimator, found) = estimate(scene, &made.images_e, &made.images_e.mapv(|_| false));
    let (residuals, promised) = (residuals(&estimator, &found, &made), promised(&estimator, &found));
    (estimator, residuals, promised)
}

#[test]
fn plate_scale_and_rotation_are_found_with_error_bars() {
    let made = scene(&[("image.samples_per_lambda_over_d", "3.02"), ("pupil.rotation_deg", "0.6")]);
    // A truth on a pupil that is turned against the estimate's cannot be held against it.
    let (_, unaware_nm, _) = found(&made, &scene(&[("pupil.rotation_deg", "0.6"), NOISE_ALONE]));
    let asked = scene(&[("estimate.fit_optics", "[\"plate-scale\", \"rotation\"]")]);
    let (estimator, residual_nm, promised_nm) = found(&made, &asked);
    let optics = estimator.fitted_optics();
    for (optic, (own, truth)) in optics.iter().zip([(3.0, 3.02), (0.0, 0.6)]) {
        assert!(optic.is_identifiable() && optic.scene == own && optic.identifiable > 0.1, "{optic:?}");
        // Four error bars, each far below what was off.
        assert!((optic.value - truth).abs() < 4.0 * optic.sigma, "{optic:?}");
        assert!(optic.sigma < 0.01 * (truth - own), "{optic:?}");
    }
    // Half as much again as the error bars: a draw of a few tens of modes.
    for (residual_nm, promised_nm) in residual_nm.iter().zip(promised_nm) {
        assert!(*residual_nm < 1.5 * promised_nm, "{residual_nm} {promised_nm}");
    }
    assert!(unaware_nm[1] > 10.0 * residual_nm[1], "{unaware_nm:?}: nothing was wrong without");
    // What was found is in the scene, which asks for no more.
    let scene = estimator.scene();
    assert_eq!([scene.image.samples_per_lambda_over_d, scene.pupil.rotation_deg], [optics[0].value, optics[1].value]);
    assert!(scene.estimate.fit_optics.is_empty());
}

#[test]
#[ignore = "merge: 3 s"]
fn a_filters_width_is_modelled_and_found() {
    let broad = |width: &str, more: &[(&str, &str)]| {
        scene(&[&[("image.bandwidth_fraction", width), NOISE_ALONE], more].concat())
    };
    let made = broad("0.1", &[]);
    // One wavelength is no model of it; as many as it needs are; a width that is a fifth too small
    // is found.
    let (_, narrow_nm, _) = found(&made, &broad("0.1", &[("estimate.wavelengths", "1")]));
    let (known, known_nm, promised_nm) = found(&made, &made);
    assert!(known.model().optics.parts().colours.len() > 2 && known.fitted_optics().is_empty());
    let (fitted, fitted_nm, fitted_promised_nm) =
        found(&made, &broad("0.08", &[("estimate.fit_optics", "[\"bandwidth\"]")]));
    let [optic] = fitted.fitted_optics() else { panic!("one was asked for") };
    assert!(optic.is_identifiable() && optic.scene == 0.08 && optic.key == "image.bandwidth_fraction", "{optic:?}");
    assert!((optic.value - 0.1).abs() < 4.0 * optic.sigma && optic.sigma < 0.002, "{optic:?}");
    for (residual_nm, promised_nm) in
        known_nm.iter().chain(&fitted_nm).zip(promised_nm.iter().chain(&fitted_promised_nm))
    {
        // As in the test above.
        assert!(*residual_nm < 1.5 * promised_nm, "{residual_nm} {promised_nm}");
    }
    assert!(narrow_nm[1] > 3.0 * known_nm[1], "{narrow_nm:?} {known_nm:?}: nothing was wrong without");
}

#[test]
#[ignore = "merge: 2 s"]
fn the_diffusion_of_charge_is_found() {
    let diffuse = |pixels: &str| scene(&[("image.charge_diffusion_pixels", pixels), super::EXPLAINED_SNR]);
    let made = diffuse("0.4");
    let asked = diffuse("0.3").with(&[("estimate.fit_optics", "[\"charge-diffusion\"]")]).unwrap();
    let (estimator, residual_nm, promised_nm) = found(&made, &asked);
    let [optic] = estimator.fitted_optics() else { panic!("one was asked for") };
    assert!(optic.is_identifiable() && optic.key == "image.charge_diffusion_pixels", "{optic:?}");
    assert!((optic.value - 0.4).abs() < 4.0 * optic.sigma && optic.sigma < 0.02, "{optic:?}");
    for (residual_nm, promised_nm) in residual_nm.iter().zip(promised_nm) {
        // As in the tests above.
        assert!(*residual_nm < 1.5 * promised_nm, "{residual_nm} {promised_nm}");
    }
    let none = sentence_of(read_of(&asked.with(&[("image.charge_diffusion_pixels", "0")]).unwrap()));
    assert!(none.contains("\"charge-diffusion\"") && none.contains("without a diffusion of charge"), "{none}");
}

#[test]
#[ignore = "merge: 3 s"]
fn the_error_bars_hold_what_the_optics_do_to_the_modes() {
    // As it is sampled where a plate scale is fitted.
    let own = scene(&[("estimate.sampling", "native"), NOISE_ALONE]);
    let made = source_images(&own);
    let bad = made.images_e.mapv(|_| false);
    let read = |scene: &Scene| estimate(scene, &made.images_e, &bad);
    let (estimator, fitted) = read(&own.with(&[("estimate.fit_optics", "[\"plate-scale\"]")]).unwrap());
    let [optic] = estimator.fitted_optics() else { panic!("one was asked for") };
    let at = |value: f64| read(&own.with(&[(&optic.key, &value.to_string())]).unwrap()).1.combined.modes;
    // The modes of two plate scales, which are taken for known, forty error bars either way: the
    // samplings of models that are nearer to each other differ by as much (0.01 nm).
    let known = at(optic.value);
    let [below, above] = [-40.0, 40.0].map(|sigmas| at(optic.value + sigmas * optic.sigma).coefficients_nm);
    let more_nm2 = (&fitted.combined.modes.covariance_nm2 - &known.covariance_nm2).diag().to_vec();
    let moved_nm: Vec<f64> = below.iter().zip(&above).map(|(below, above)| (above - below) / 80.0).collect();
    let largest = moved_nm.iter().fold(0.0f64, |most, nm| most.max(nm.abs()));
    assert!(largest > 0.005, "{moved_nm:?}: the plate scale moves nothing");
    // Those differences and a step tolerance of 0.001 nm, over eighty.
    for (more_nm2, moved_nm) in more_nm2.iter().zip(&moved_nm) {
        assert!((more_nm2.max(0.0).sqrt() - moved_nm.abs()).abs() < 0.02 * largest, "{more_nm2} {moved_nm}");
    }
}

#[test]
#[ignore = "merge: 2 s"]
fn defocus_is_fitted_only_without_a_focus_mode() {
    let made = scene(&[("image.diversity_focus_waves_rms", "0.82")]);
    let asked = ("estimate.fit_optics", "[\"defocus\"]");
    let (estimator, _, _) = found(&made, &scene(&[asked]));
    let [optic] = estimator.fitted_optics() else { panic!("one was asked for") };
    assert!(!optic.is_identifiable() && optic.value == 0.8 && optic.identifiable < 1e-5, "{optic:?}");
    let (estimator, residual_nm, promised_nm) =
        found(&made.with(&NO_NCPA).unwrap(), &scene(&[asked]).with(&NO_NCPA).unwrap());
    let [optic] = estimator.fitted_optics() else { panic!("one was asked for") };
    assert!(optic.is_identifiable() && (optic.value - 0.82).abs() < 4.0 * optic.sigma, "{optic:?}");
    // Seven pistons scatter more about their error bars than a hundred modes.
    assert!(residual_nm[0] < 2.5 * promised_nm[0], "{residual_nm:?} {promised_nm:?}");
}

#[test]
#[ignore = "merge: 4 s"]
fn all_images_determine_the_optics() {
    let made = scene(&[("image.samples_per_lambda_over_d", "3.006"), ("image.count", "24"), NOISE_ALONE]);
    let asked = scene(&[("estimate.fit_optics", "[\"plate-scale\"]"), NOISE_ALONE]);
    let images = source_images(&made).images_e;
    let fitted = |count: usize| {
        let images = images.slice(ndarray::s![..count, .., ..]).to_owned();
        let (estimator, _) = estimate(&asked, &images, &images.mapv(|_| false));
        let [optic] = estimator.fitted_optics() else { panic!("one was asked for") };
        optic.clone()
    };
    let [few, all] = [6, 24].map(fitted);
    // Of the same light, but for what noise does to an error bar.
    assert!((all.sigma / few.sigma - 0.5).abs() < 0.02, "{few:?} {all:?}");
    assert!((all.value - 3.006).abs() < 4.0 * all.sigma, "{all:?}");
}

/// What `scene` says of an image without anything.
fn read_of(scene: &Scene) -> cophase::Result<()> {
    let images_e = Array3::from_elem((1, 132, 132), 100.0);
    let bad = images_e.mapv(|_| false);
    let cube = Cube { images_e: images_e.view(), bad: bad.view(), read_noise_e: None };
    super::fitter_of_scene(scene, cube).map(drop)
}

/// The sentence of a refusal.
fn sentence_of(outcome: cophase::Result<()>) -> String {
    match outcome {
        Err(Error::Scene(sentence) | Error::Image(sentence)) => sentence,
        other => panic!("{other:?}"),
    }
}

#[test]
fn unidentifiable_optics_are_refused_with_the_reason() {
    let asked = |what: &str| scene(&[("estimate.fit_optics", what)]);
    // There is no image yet.
    let early = sentence_of(ModalFitter::new(&asked("[\"rotation\"]"), false).map(|_| ()));
    assert!(early.contains("fits the telescope to images"), "{early}");
    let with = |settings: &[(&str, &str)]| sentence_of(asked("[\"rotation\"]").with(settings).map(|_| ()));
    assert!(with(&[("estimate.optimizer", "bfgs")]).contains("needs noise weights"));
    assert!(with(&[("estimate.budget_nm", "1")]).contains("fit_optics"));
    assert!(with(&[("estimate.method", "full-phase")]).contains("fit_optics"));
    assert!(with(&[("estimate.fit_optics", "[\"rotation\", \"rotation\"]")]).contains("\"plate-scale\""));
    let narrow = sentence_of(read_of(&asked("[\"bandwidth\"]")));
    assert!(narrow.contains("one wavelength"), "{narrow}");
    // An image that shows nothing of them.
    assert!(sentence_of(read_of(&asked("[\"rotation\"]"))).contains("100"));
}

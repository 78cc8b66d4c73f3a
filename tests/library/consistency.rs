//! Images against the scene of their estimate: units, contradictions, keys that only simulations model, and how well the noise
//! explains the residual.

use cophase::io::{Card, FitsWriter, Pixel};
use cophase::pipeline::{Estimate, Estimator, ImageStatus, Images, Trust};
use cophase::scene::Scene;
use ndarray::Array3;

/// Seven hexagons and eleven Zernikes, 132 pixels, with these settings.
fn scene(settings: &[(&str, &str)]) -> Scene {
    let small = [
        ("pupil.aperture", "hexagonal"),
        ("pupil.rings", "1"),
        ("pupil.grid_m", "4.8"),
        ("pupil.samples", "96"),
        ("image.samples_per_lambda_over_d", "2"),
        ("image.pixels", "96"),
        ("image.diversity_focus_waves_rms", "0.8"),
        ("aberrations.truth_samples", "768"),
        ("aberrations.ncpa_zernikes", "[4, 11]"),
        ("modes.ncpa", "zernike"),
        ("modes.ncpa_count", "12"),
        ("modes.exact_zernikes", "[2, 4]"),
        ("estimate.device", "cpu"),
    ];
    Scene::preset("keck-artificial").unwrap().with(&small).unwrap().with(settings).unwrap()
}

fn estimate(scene: &Scene, images: &Images) -> Estimate {
    Estimator::new(scene).unwrap().estimate(images).unwrap()
}

fn refused(scene: &Scene, images: &Images) -> String {
    Estimator::new(scene).unwrap().estimate(images).unwrap_err().to_string()
}

#[test]
fn arrays_of_counts_are_converted_with_the_gain_of_the_scene() {
    let plain = scene(&[]);
    let made = Images::simulated(&plain).unwrap();
    let expected = estimate(&plain, &made);
    let gain = scene(&[("image.gain_e_per_adu", "16")]);
    // A power of two: nothing is rounded on the way.
    let counts = Images::new(&made.images_e / 16.0);
    let found = estimate(&gain, &counts);
    assert_eq!(found.coefficients_nm, expected.coefficients_nm);
    assert!(found.remarks[0].contains("converted to electrons: 16 per count"), "{:?}", found.remarks);
    assert!(found.is_sound(), "{:?}", found.warnings);
    // Simulated images, and those that a caller has converted, are in electrons.
    assert_eq!(estimate(&gain, &made).coefficients_nm, expected.coefficients_nm);
    // Without the gain the noise is a quarter of what the counts of photons would have.
    let unaware = estimate(&plain, &counts);
    assert_eq!(unaware.status, ImageStatus::Misfit);
    assert!(unaware.warnings[0].contains("the noise is smaller than the stated"), "{:?}", unaware.warnings);
}

#[test]
fn a_file_and_a_scene_that_contradict_each_other_need_a_decision() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("images.fits");
    let plain = scene(&[]);
    let write = |cards: &[(&str, Card)]| {
        let mut file = FitsWriter::create(&path).unwrap();
        file.image("IMAGES", &Images::simulated(&plain).unwrap().images_e, Pixel::F64, "electron").unwrap();
        cards.iter().for_each(|(key, card)| file.card("IMAGES", key, card.clone(), "").unwrap());
        file.finish().unwrap();
        Images::read(&path, None).unwrap()
    };
    let clean = estimate(&plain, &write(&[]));
    let mut images = write(&[("WAVELENG", 1.64.into()), ("RDNOISE", 60.into())]);
    let error = refused(&plain, &images);
    for words in ["card WAVELENG = 1.64", "image.wavelength_nm = 2168.6", "--trust"] {
        assert!(error.contains(words), "{error}");
    }
    assert!(!error.contains("RDNOISE"), "{error}");
    images.trust = Trust::Scene;
    let found = estimate(&plain, &images);
    assert_eq!(found.coefficients_nm, clean.coefficients_nm);
    assert!(found.remarks[0].contains("image.wavelength_nm = 2168.6 holds"), "{:?}", found.remarks);
    images.trust = Trust::File;
    let found = estimate(&plain, &images);
    assert_eq!(found.scene.image.wavelength_nm, 1640.0);
    assert_ne!(found.coefficients_nm, clean.coefficients_nm);
    (images.trust, images.overrides) = (Trust::Neither, vec!["image.wavelength_nm".into()]);
    assert_eq!(estimate(&plain, &images).coefficients_nm, clean.coefficients_nm);
    // A read noise that the scene does not name is the file's.
    let open = plain.without("image.read_noise_e").unwrap();
    let of_card = estimate(&open, &write(&[("RON", 60.0.into())]));
    assert_eq!(of_card.covariance_nm2, clean.covariance_nm2);
}

#[test]
fn a_key_that_only_simulations_model_is_a_warning() {
    let squares = scene(&[("image.pixel_fill", "0.9")]);
    let found = estimate(&squares, &Images::simulated(&squares).unwrap());
    assert!(
        found.warnings[0].contains("image.pixel_fill = 0.9 is modelled by simulations only"),
        "{:?}",
        found.warnings
    );
}

#[test]
fn nominal_images_are_explained_and_small_faults_are_not() {
    for snr in ["20", "100", "300", "1000"] {
        let scene = scene(&[("image.peak_snr", snr)]);
        let found = estimate(&scene, &Images::simulated(&scene).unwrap());
        println!("peak S/N {snr}: χ² {:.3}", found.reduced_chi2);
        assert!(found.is_sound(), "peak S/N {snr}: χ² {} {:?}", found.reduced_chi2, found.warnings);
    }
    let scene = scene(&[("image.peak_snr", "500")]);
    let star = Images::simulated(&scene).unwrap().images_e;
    let most = star.iter().fold(0.0f64, |most, &e| most.max(e));
    let companion = Array3::from_shape_fn(star.dim(), |(i, y, x)| {
        star[[i, y, x]] + if x < 6 { 0.0 } else { 0.01 * star[[i, y, x - 6]] }
    });
    let curved = star.mapv(|e| e * (1.0 - 0.02 * e / most));
    for (name, images_e) in [("a companion of 1 %", companion), ("a response that falls by 2 %", curved)] {
        let found = estimate(&scene, &Images::new(images_e));
        println!("{name}: χ² {:.3}", found.reduced_chi2);
        assert_eq!(found.status, ImageStatus::Misfit, "{name}: χ² {}", found.reduced_chi2);
        assert!(found.images[0].message.contains("larger than the noise"), "{}", found.images[0].message);
    }
}

#[test]
fn a_stated_read_noise_of_zero_is_none() {
    // Photon noise alone, from a thousand electrons in a pixel to hundredths.
    for flux in ["1e7", "1e5"] {
        let scene = scene(&[("image.peak_snr", ""), ("image.flux_e", flux), ("image.read_noise_e", "0")]);
        let found = estimate(&scene, &Images::simulated(&scene).unwrap());
        println!("{flux} electrons: χ² {:.3}", found.reduced_chi2);
        assert!(
            (0.8..1.1).contains(&found.reduced_chi2) && found.is_sound(),
            "χ² {} {:?}",
            found.reduced_chi2,
            found.warnings
        );
    }
}

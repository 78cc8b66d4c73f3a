//! Images against the scene of their estimate: units, contradictions, the area of pixels, and how
//! well the noise explains the residual.

use crate::common::{assert_facts, images_of, simulated};
use cophase::Status;
use cophase::io::{Card, ELECTRON, FitsWriter, Pixel, Quantity};
use cophase::pipeline::{Estimate, Estimator, Images, Trust};
use cophase::scene::Scene;
use ndarray::{Array3, s};

/// Seven hexagons and eleven Zernikes, 132 pixels, with these settings.
pub fn scene(settings: &[(&str, &str)]) -> Scene {
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

/// `found`, with what a failing test needs of it on the output.
pub fn shown(found: Estimate) -> Estimate {
    let residual = &found.truth.as_ref().unwrap().1;
    println!(
        "residual {:.3?} nm, error bars {:.3} and {:.3} nm, χ² {:.3}, {}, {:?}",
        residual.rms_nm,
        found.figures.phasing.sigma_nm,
        found.figures.ncpa.sigma_nm,
        found.reduced_chi2,
        found.model,
        found.warnings
    );
    found
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
    let made = simulated(&plain);
    let expected = estimate(&plain, &made);
    let gain = scene(&[("image.gain_e_per_adu", "16")]);
    // A power of two: nothing is rounded on the way.
    let counts = Images::new(&made.images_e / 16.0);
    let found = estimate(&gain, &counts);
    assert_eq!(found.modes.coefficients_nm, expected.modes.coefficients_nm);
    assert!(found.remarks[0].contains("converted to electrons: 16 per count"), "{:?}", found.remarks);
    assert!(found.is_sound(), "{:?}", found.warnings);
    // Simulated images, and those that a caller has converted, are in electrons.
    assert_eq!(estimate(&gain, &made).modes.coefficients_nm, expected.modes.coefficients_nm);
    // Without the gain the noise is a quarter of what the counts of photons would have.
    let unaware = estimate(&plain, &counts);
    assert_eq!(unaware.status, Status::Misfit);
    assert!(unaware.warnings[0].contains("the noise is smaller than the stated"), "{:?}", unaware.warnings);
}

#[test]
fn dead_columns_and_blocks_are_masked_and_named() {
    let plain = scene(&[]);
    let mut made = simulated(&plain);
    // Through the star.
    made.images_e.slice_mut(s![.., .., 40..43]).fill(12.5);
    made.images_e.slice_mut(s![.., 50..56, 52..58]).fill(0.0);
    let found = shown(estimate(&plain, &made));
    let named = "All pixels of columns 40 to 42 and of a block of 6 × 6 from column 52, row 50 on have one value";
    assert!(found.remarks.iter().any(|remark| remark.starts_with(named)), "{:?}", found.remarks);
    assert!(found.is_sound(), "{:?}", found.warnings);
    // Of the 64 rows that are fitted.
    assert_eq!(found.images[0].report.bad_pixels, 3 * 64 + 36);
    let residual_nm = found.truth.as_ref().unwrap().1.rms_nm;
    let sigma_nm = [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm];
    assert!(residual_nm.iter().zip(sigma_nm).all(|(residual_nm, sigma_nm)| *residual_nm < 2.0 * sigma_nm));
}

#[test]
fn contradiction_of_file_and_scene_needs_a_decision() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("images.fits");
    let plain = scene(&[]);
    let write = |cards: &[(&str, Card)]| {
        let mut file = FitsWriter::create(&path).unwrap();
        file.image("IMAGES", &simulated(&plain).images_e, Pixel::F64, "electron").unwrap();
        cards.iter().for_each(|(key, card)| file.card("IMAGES", key, card.clone(), "").unwrap());
        file.finish().unwrap();
        images_of(&path, None)
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
    assert_eq!(found.modes.coefficients_nm, clean.modes.coefficients_nm);
    assert!(found.remarks[0].contains("image.wavelength_nm = 2168.6 holds"), "{:?}", found.remarks);
    images.trust = Trust::File;
    let found = estimate(&plain, &images);
    assert_eq!(found.scene.image.wavelength_nm, 1640.0);
    assert_ne!(found.modes.coefficients_nm, clean.modes.coefficients_nm);
    (images.trust, images.overrides) = (Trust::Neither, vec!["image.wavelength_nm".into()]);
    assert_eq!(estimate(&plain, &images).modes.coefficients_nm, clean.modes.coefficients_nm);
    // A read noise that the scene does not name is the file's.
    let open = plain.without("image.read_noise_e").unwrap();
    let of_card = estimate(&open, &write(&[("RON", 60.0.into())]));
    assert_eq!(of_card.modes.covariance_nm2, clean.modes.covariance_nm2);
}

#[test]
fn filter_without_the_wavelength_contradicts_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("images.fits");
    let plain = scene(&[]);
    let made = simulated(&plain).images_e;
    let write = |cards: &[(&str, Card)]| {
        let mut file = FitsWriter::create(&path).unwrap();
        file.image("IMAGES", &made, Pixel::F64, ELECTRON).unwrap();
        cards.iter().for_each(|(key, card)| file.card("IMAGES", key, card.clone(), "").unwrap());
        file.finish().unwrap();
        images_of(&path, None)
    };
    let clean = estimate(&plain, &write(&[]));
    // 2168.6 nm is in K, K' and Ks, and is the wavelength of Br gamma; other names state no band.
    for name in ["Kp + clear", "Br_gamma", "H2_1-0"] {
        let found = estimate(&plain, &write(&[("FILTER", name.into())]));
        assert_eq!(found.modes.coefficients_nm, clean.modes.coefficients_nm, "{name}");
    }
    for (key, name) in
        [("FILTER", "H"), ("FILTNAME", "L'"), ("FWONAME", "J"), ("FILTER1", "PK50_1.5 + H"), ("FILTER", "r'")]
    {
        let error = refused(&plain, &write(&[(key, name.into())]));
        for words in [&format!("card {key} = {name} ("), "image.wavelength_nm = 2168.6", "--trust"] {
            assert!(error.contains(words), "{error}");
        }
    }
    // One of two wheels that agrees is enough, and the wavelength of a card is no second
    // contradiction.
    estimate(&plain, &write(&[("FILTER1", "J".into()), ("FILTER2", "K".into())]));
    let error = refused(&plain, &write(&[("FILTER", "H".into()), ("WAVELEN", 1640.0.into())]));
    assert!(error.contains("card WAVELEN = 1640") && !error.contains("FILTER"), "{error}");
    let mut images = write(&[("FILTER", "H".into())]);
    images.trust = Trust::Scene;
    let found = estimate(&plain, &images);
    assert_eq!(found.modes.coefficients_nm, clean.modes.coefficients_nm);
    assert!(
        ["FILTER = H", "1390 to 1924 nm", "not used"].iter().all(|fact| found.remarks[0].contains(fact)),
        "{:?}",
        found.remarks
    );
    images.trust = Trust::File;
    assert_eq!(estimate(&plain, &images).scene.image.wavelength_nm, 1635.0);
    (images.trust, images.overrides) = (Trust::Neither, vec!["image.wavelength_nm".into()]);
    assert_eq!(estimate(&plain, &images).modes.coefficients_nm, clean.modes.coefficients_nm);
    // A file that states its wavelength, too, is trusted with that.
    images = write(&[("FILTER", "H".into()), ("WAVELEN", 2168.6.into())]);
    assert!(refused(&plain, &images).contains("card FILTER = H"));
    images.trust = Trust::File;
    assert_eq!(estimate(&plain, &images).modes.coefficients_nm, clean.modes.coefficients_nm);
}

#[test]
fn the_filters_of_a_real_frame_contradict_no_scene() {
    let package = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let frames = ["../shared/data", "../../shared/data"].map(|at| package.join(at).join("20130801_n0004.fits"));
    let Some(frame) = frames.iter().find(|frame| frame.is_file()) else {
        println!("skipped: no folder of real frames beside the project");
        return;
    };
    // FILTER = 'PK50_1.5 + FEII', FWINAME = 'PK50_1.5', FWONAME = 'FEII'.
    let facts = images_of(frame, None).facts;
    assert!(facts.iter().any(|fact| fact.keyword == "CENWAVE"), "{facts:?}");
    assert!(facts.iter().all(|fact| fact.quantity != Quantity::BandNm), "{facts:?}");
}

#[test]
fn image_of_odd_size_loses_its_last_row_and_column() {
    let scene = scene(&[]);
    let made = simulated(&scene);
    let clean = estimate(&scene, &made);
    // The axis stays on pixel [48, 48]; values that would ruin the estimate are in the part that is
    // left out.
    let padded = |rows: usize, columns: usize| {
        let pixel = |(_, y, x)| made.images_e.get([0, y, x]).copied().unwrap_or(1e9);
        Images::new(Array3::from_shape_fn((1, rows, columns), pixel)).in_electrons()
    };
    for (rows, columns, edges) in [(97, 97, "row | column"), (97, 96, "row"), (96, 97, "column")] {
        let found = estimate(&scene, &padded(rows, columns));
        assert_eq!(found.modes.coefficients_nm, clean.modes.coefficients_nm, "{rows} rows, {columns} columns");
        assert_facts(&found.remarks[0], &format!("last {edges} | left out | {columns}x{rows} pixels | 96x96"));
        let named = ["row", "column"].map(|edge| found.remarks[0].contains(edge));
        assert_eq!(named, [rows == 97, columns == 97], "{:?}", found.remarks);
        assert!(found.is_sound(), "{:?}", found.warnings);
    }
    let error = refused(&scene, &padded(105, 105));
    assert_facts(&error, "105x105 pixels | 96x96 (image.pixels) | 104x104 | without the last | cophase reduce");
    let error = refused(&scene, &padded(104, 104));
    assert_facts(&error, "104x104 pixels | 96x96 (image.pixels) | cophase reduce");
    let error = refused(&scene, &padded(94, 104));
    assert_facts(&error, "104x94 pixels | 96x96 (image.pixels)");
    assert!(!error.contains("cophase reduce"), "{error}");
}

#[test]
fn pixels_with_an_area_are_modelled_as_the_scene_says() {
    // Pixels without gaps, and charge that diffuses between them.
    let detector = [("image.pixel_fill", "1"), ("image.charge_diffusion_pixels", "0.3")];
    let area = scene(&detector);
    let images = simulated(&area);
    let error_of = |scene: &Scene, images: &Images| {
        let found = estimate(scene, images);
        let residual = found.truth.as_ref().unwrap().1.clone();
        let sigma_nm = [found.figures.phasing.sigma_nm, found.figures.ncpa.sigma_nm];
        println!("residual {:?} nm, error bars {sigma_nm:?} nm, χ² {:.3}", residual.rms_nm, found.reduced_chi2);
        (residual.rms_nm, sigma_nm, found)
    };
    let error = |scene: &Scene| error_of(scene, &images);
    let (known_nm, sigma_nm, known) = error(&area);
    assert!(known.is_sound(), "{:?}", known.warnings);
    // A residual of ten modes or more within three error bars.
    assert!(known_nm[0] < 3.0 * sigma_nm[0] && known_nm[1] < 3.0 * sigma_nm[1]);
    // Taken for points: flagged, and wrong where error bars do not hold what the scene leaves out.
    let (points_nm, _, points) = error(&scene(&[("estimate.posterior", "false")]));
    assert!(points_nm[1] > 3.0 * known_nm[1] && points.status == Status::Misfit, "{:?}", points.warnings);
    let (held_nm, _, held) = error(&scene(&[]));
    assert_eq!(held.status, Status::Misfit, "{:?}", held.warnings);
    assert!((0..2).all(|part| held_nm[part] < 0.5 * points_nm[part]));
    // The step is linear: a blur of three times its tolerance is held, of seventeen times mended.
    let gaps = simulated(&scene(&[("image.pixel_fill", "0.6")]));
    let (held_nm, held_sigma_nm, _) = error_of(&scene(&[]), &gaps);
    assert!((0..2).all(|part| held_nm[part] < 3.0 * held_sigma_nm[part]));
}

#[test]
fn the_area_of_a_pixel_is_fitted() {
    let images = simulated(&scene(&[("image.pixel_fill", "0.9")]));
    let assumed = scene(&[("image.pixel_fill", "0.6"), ("estimate.fit_optics", "[\"pixel-fill\"]")]);
    let found = estimate(&assumed, &images);
    assert!(found.is_sound(), "{:?}", found.warnings);
    let fitted = &found.optics[0];
    println!("pixel fill {} ± {}, identifiable share {}", fitted.value, fitted.sigma, fitted.identifiable);
    assert_eq!(fitted.key, "image.pixel_fill");
    assert!((fitted.value - 0.9).abs() < 4.0 * fitted.sigma && fitted.sigma < 0.02, "{fitted:?}");
    let residual = found.truth.as_ref().unwrap().1.clone();
    assert!(
        residual.rms_nm[0] < 3.0 * found.figures.phasing.sigma_nm
            && residual.rms_nm[1] < 3.0 * found.figures.ncpa.sigma_nm
    );
}

#[test]
fn methods_without_a_pixel_area_model_are_refused() {
    let refused_scene =
        |settings: &[(&str, &str)]| Scene::preset("keck-artificial").unwrap().with(settings).unwrap_err().to_string();
    let coarse = refused_scene(&[("image.pixel_fill", "1"), ("image.samples_per_lambda_over_d", "1.5")]);
    assert_facts(&coarse, "image.pixel_fill = 1 | 1.9 or more");
    let points = scene(&[("estimate.fit_optics", "[\"pixel-fill\"]")]);
    let sentence = refused(&points, &simulated(&points));
    assert_facts(&sentence, "pixels are points");
}

#[test]
fn nominal_images_are_explained_and_small_faults_are_not() {
    for snr in ["20", "100", "300", "1000"] {
        let scene = scene(&[("image.peak_snr", snr)]);
        let found = estimate(&scene, &simulated(&scene));
        println!("peak S/N {snr}: χ² {:.3}", found.reduced_chi2);
        assert!(found.is_sound(), "peak S/N {snr}: χ² {} {:?}", found.reduced_chi2, found.warnings);
    }
    let scene = scene(&[("image.peak_snr", "500")]);
    let star = simulated(&scene).images_e;
    let most = star.iter().fold(0.0f64, |most, &e| most.max(e));
    let companion = Array3::from_shape_fn(star.dim(), |(i, y, x)| {
        star[[i, y, x]] + if x < 6 { 0.0 } else { 0.01 * star[[i, y, x - 6]] }
    });
    let curved = star.mapv(|e| e * (1.0 - 0.02 * e / most));
    let noise_alone = scene.with(&[("estimate.posterior", "false")]).unwrap();
    let response = Images::new(curved);
    for (name, scene, images) in [
        ("a companion of 1 %", &scene, &Images::new(companion)),
        ("a response that falls by 2 %", &noise_alone, &response),
    ] {
        let found = estimate(scene, images);
        println!("{name}: χ² {:.3}", found.reduced_chi2);
        assert_eq!(found.status, Status::Misfit, "{name}: χ² {}", found.reduced_chi2);
        assert!(found.images[0].message.contains("larger than the noise"), "{}", found.images[0].message);
    }
    // The response is one of the errors that error bars hold, and then the cause.
    let found = estimate(&scene, &response);
    let [warning] = &found.warnings[..] else { panic!("{:?}", found.warnings) };
    assert!(found.status == Status::Ok && warning.contains("the loss of response at the peak"), "{warning}");
}

/// The noise of one image is scaled by its χ².
#[test]
fn the_error_bars_of_a_misfit_are_scaled_by_its_residual() {
    // The modes of the scene alone, so that both estimates have the same.
    let own = [("image.peak_snr", "500"), ("estimate.model", "scene"), ("estimate.posterior", "false")];
    let scene = scene(&own);
    let images = simulated(&scene);
    let star = &images.images_e;
    let companion = Array3::from_shape_fn(star.dim(), |(i, y, x)| {
        star[[i, y, x]] + if x < 6 { 0.0 } else { 0.02 * star[[i, y, x - 6]] }
    });
    let (right, misfit) = (estimate(&scene, &images), estimate(&scene, &Images::new(companion)));
    assert_eq!((right.status, misfit.status), (Status::Ok, Status::Misfit));
    let expected = (misfit.reduced_chi2 / right.reduced_chi2.max(1.0)).sqrt();
    // Not scaled, or scaled by χ² itself, would be far from this.
    assert!(expected > 1.5, "χ² {} and {}", misfit.reduced_chi2, right.reduced_chi2);
    let pairs = misfit.modes.sigma_nm().into_iter().zip(right.modes.sigma_nm());
    let ratios: Vec<f64> = pairs.map(|(misfit, right)| misfit / right / expected).collect();
    println!("error bars over those that are expected: {ratios:.3?}");
    // The Fisher matrix is that of another wavefront, which differs by what the companion of 2 %
    // makes of it.
    assert!(ratios.iter().all(|ratio| (0.9..1.1).contains(ratio)), "{ratios:?}");
    assert!((misfit.figures.phasing.sigma_nm / right.figures.phasing.sigma_nm / expected - 1.0).abs() < 0.1);
    assert!((misfit.figures.ncpa.sigma_nm / right.figures.ncpa.sigma_nm / expected - 1.0).abs() < 0.1);
}

/// A MAP estimate does not fit the background, and a modal one does.
#[test]
fn contradicting_background_is_refused_by_map_estimates() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("images.fits");
    let plain = scene(&[("image.background_e", "100")]);
    let made = simulated(&plain).images_e;
    let write = |background_e: f64| {
        let mut file = FitsWriter::create(&path).unwrap();
        file.image("IMAGES", &made, Pixel::F64, ELECTRON).unwrap();
        file.card("IMAGES", "BACKGR_E", background_e, "").unwrap();
        file.finish().unwrap();
        images_of(&path, None)
    };
    let map = plain.with_override("estimate.method", "full-phase").unwrap();
    let mut images = write(40.0);
    let error = refused(&map, &images);
    for words in ["card BACKGR_E = 40", "image.background_e = 100", "--trust"] {
        assert!(error.contains(words), "{error}");
    }
    assert!(estimate(&plain, &images).remarks.iter().all(|remark| !remark.contains("background")));
    // Not so one that is decided, or that agrees: then one image is too few.
    images.trust = Trust::Scene;
    assert!(!refused(&map, &images).contains("BACKGR_E"));
    assert!(!refused(&map, &write(100.0)).contains("BACKGR_E"));
}

#[test]
fn a_stated_read_noise_of_zero_is_none() {
    // Photon noise alone, from a thousand electrons in a pixel to hundredths.
    for flux in ["1e7", "1e5"] {
        let scene = scene(&[("image.peak_snr", ""), ("image.flux_e", flux), ("image.read_noise_e", "0")]);
        let found = estimate(&scene, &simulated(&scene));
        println!("{flux} electrons: χ² {:.3}", found.reduced_chi2);
        assert!(
            (0.8..1.1).contains(&found.reduced_chi2) && found.is_sound(),
            "χ² {} {:?}",
            found.reduced_chi2,
            found.warnings
        );
    }
}

//! Images of one wavefront that are fitted together: in focus, with known shapes of a mirror
//! between them, or with a small defocus.

use crate::common::{images_of, simulated};
use crate::consistency::scene;
use cophase::io::{FitsWriter, Pixel};
use cophase::pipeline::{Estimate, Estimator, Images};
use cophase::scene::Scene;
use ndarray::{Array3, Axis};
use std::path::{Path, PathBuf};

/// Shapes that are neither even nor odd: focus, astigmatism and coma in turn, of `rms_nm`.
fn shapes(folder: &Path, rms_nm: f64) -> PathBuf {
    let value = |(shape, y, x): (usize, usize, usize)| {
        let [x, y] = [x, y].map(|at| (at as f64 - 47.5) / 48.0);
        let square = x * x + y * y;
        let terms =
            [2.0 * square - 1.0, 2.0 * x * y, (3.0 * square - 2.0) * x, x * x - y * y, (3.0 * square - 2.0) * y];
        let weights = [
            [1.0, 0.3, 0.5, 0.0, -0.6],
            [-0.8, 0.6, 0.0, 0.7, 0.5],
            [0.2, -1.0, -0.7, 0.4, 0.0],
            [0.7, 0.0, 0.6, -0.9, 0.4],
        ];
        1.7 * rms_nm * terms.iter().zip(weights[shape]).map(|(term, weight)| term * weight).sum::<f64>()
    };
    let path = folder.join("shapes.fits");
    let mut file = FitsWriter::create(&path).unwrap();
    file.image("SHAPES", &Array3::from_shape_fn((4, 96, 96), value), Pixel::F64, "nm").unwrap();
    file.finish().unwrap();
    path
}

/// Five images in focus, the first of a mirror at rest.
pub fn in_focus(folder: &Path, settings: &[(&str, &str)]) -> Scene {
    let path = shapes(folder, 100.0);
    let usual = [
        ("image.diversity_focus_waves_rms", ""),
        ("image.diversity_file", path.to_str().unwrap()),
        ("image.diversity_planes", "[-1, 0, 1, 2, 3]"),
        ("image.count", "5"),
        ("estimate.group", "all"),
    ];
    scene(&[&usual[..], settings].concat())
}

pub fn estimate(scene: &Scene, images: &Images) -> Estimate {
    Estimator::new(scene).unwrap().estimate(images).unwrap()
}

/// Residual of the wavefront over its error bar.
pub fn pull(estimate: &Estimate) -> f64 {
    let (_, residual) = estimate.truth.as_ref().unwrap();
    residual.rms_nm[2] / estimate.figures.wavefront.sigma_nm
}

#[test]
fn images_in_focus_with_known_shapes_determine_the_wavefront() {
    let folder = tempfile::tempdir().unwrap();
    let scene = in_focus(folder.path(), &[]);
    let found = estimate(&scene, &simulated(&scene));
    assert!(found.warnings.is_empty() && found.images.len() == 5, "{:?}", found.warnings);
    assert!((0.6..1.6).contains(&pull(&found)), "{}", pull(&found));
    assert!(found.figures.wavefront.sigma_nm < 20.0, "{}", found.figures.wavefront.sigma_nm);
    // Images behind shapes that are neither even nor odd show a flip; none shows the sign.
    let orientation: Vec<_> = found.remarks.iter().filter(|remark| remark.contains("check --before")).collect();
    assert!(orientation.len() == 1 && orientation[0].starts_with("Images turned by 180°"), "{:?}", found.remarks);
}

#[test]
fn scale_and_sign_of_the_shapes_are_fitted() {
    let folder = tempfile::tempdir().unwrap();
    let made = in_focus(folder.path(), &[("image.diversity_scale", "-0.66")]);
    let scene = in_focus(folder.path(), &[("estimate.fit_optics", "[\"diversity\"]")]);
    let images = Images { scene: None, ..simulated(&made) };
    let found = estimate(&scene, &images);
    let [scale] = found.optics.as_slice() else { panic!("{:?}", found.optics) };
    assert_eq!((scale.key.as_str(), scale.scene), ("image.diversity_scale", 1.0));
    assert!((scale.value + 0.66).abs() < 4.0 * scale.sigma && scale.sigma < 0.02, "{scale:?}");
    assert!(found.warnings.is_empty() && (0.6..1.6).contains(&pull(&found)), "{} {:?}", pull(&found), found.warnings);
}

#[test]
fn pairs_with_a_small_defocus_are_fitted_together() {
    let channels =
        "[[image.channel]]\nname = \"plus\"\n[[image.channel]]\nname = \"minus\"\ndiversity_focus_waves_rms = -0.2\n";
    let text = scene(&[("image.diversity_focus_waves_rms", "0.2")]).text().replacen(
        "[modes]",
        &format!("{channels}[modes]"),
        1,
    );
    let pair = Scene::from_text(&text, Path::new("")).unwrap();
    let images = Images::simulated(&pair).unwrap();
    let found = Estimator::new(&pair).unwrap().estimate(&images).unwrap();
    assert!(found.remarks[0].contains("2 images were fitted together"), "{:?}", found.remarks);
    assert!(found.warnings.is_empty() && (0.6..1.6).contains(&pull(&found)), "{} {:?}", pull(&found), found.warnings);
}

#[test]
fn images_that_are_not_fitted_are_predicted() {
    let folder = tempfile::tempdir().unwrap();
    let scene = in_focus(folder.path(), &[("estimate.fitted_images", "[4, 0, 2]")]);
    let images = simulated(&scene);
    let found = estimate(&scene, &images);
    let used: Vec<bool> = found.images.iter().map(|image| image.is_used).collect();
    assert_eq!(used, [true, false, true, false, true]);
    // Their wavefront is known to 10 nm and less, which is below the noise of one image.
    let chi2 = |image: usize| found.images[image].report.reduced_chi2;
    assert!(chi2(1) < 1.2 && chi2(3) < 1.2, "{} {}", chi2(1), chi2(3));
    let remark = &found.remarks[0];
    assert!(remark.contains("3 images were fitted") && remark.contains("2 others are predicted"), "{remark}");
    assert!(found.images[1].message.starts_with("compared with the wavefront"), "{}", found.images[1].message);
    assert!(found.warnings.is_empty() && (0.6..1.6).contains(&pull(&found)), "{} {:?}", pull(&found), found.warnings);
    // An image of another mirror's shape is not.
    let mut images = Images { scene: None, ..images };
    let shape_of_two = images.images_e.index_axis(Axis(0), 2).to_owned();
    images.images_e.index_axis_mut(Axis(0), 3).assign(&shape_of_two);
    let found = estimate(&scene, &images);
    assert!(found.images[3].report.reduced_chi2 > 5.0, "{}", found.images[3].report.reduced_chi2);
    assert!(found.warnings.iter().any(|warning| warning.contains("not explained")), "{:?}", found.warnings);
    assert!(!found.images[3].is_clipped && !found.images[3].is_used);
}

/// `images` with those of `other` at `places`.
fn with_images_of(images: &Images, other: &Images, places: &[usize]) -> Images {
    let mut images = Images { scene: None, ..images.clone() };
    for &place in places {
        images.images_e.index_axis_mut(Axis(0), place).assign(&other.images_e.index_axis(Axis(0), place));
    }
    images
}

#[test]
fn images_of_another_wavefront_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let planes =
        [("image.diversity_planes", "[-1, 0, 1, 2, 3, 0, 2]"), ("image.count", "7"), ("image.peak_snr", "500")];
    let scene = in_focus(folder.path(), &planes);
    let images = simulated(&scene);
    let other = simulated(&scene.with(&[("aberrations.ncpa_rms_nm", "100")]).unwrap());
    let says = |found: &Estimate, part: &str| found.warnings.iter().any(|warning| warning.contains(part));
    // Planes 2 and 3: channels map 2 and map 3.
    let found = estimate(&scene, &with_images_of(&images, &other, &[3, 4]));
    let clipped = found.images.iter().filter(|image| image.is_clipped && !image.is_used).count();
    assert_eq!((clipped, found.warnings.len(), found.status), (2, 1, cophase::Status::Ok), "{:?}", found.warnings);
    for name in ["channel map 2: image 1 of 2", "channel map 3: image 1 of 1", "were left out"] {
        assert!(says(&found, name), "{name}: {:?}", found.warnings);
    }
    assert!((0.6..1.6).contains(&pull(&found)), "{}", pull(&found));
    // A third and more of the images: which wavefront is meant is not known.
    let found = estimate(&scene, &with_images_of(&images, &other, &[1, 3, 4]));
    assert!(says(&found, "contradict each other") && says(&found, "differs most"), "{:?}", found.warnings);
    assert!(found.images.iter().all(|image| image.is_used));
    // A mean leaves nothing out.
    let mean = scene.with(&[("estimate.combine", "mean")]).unwrap();
    let found = estimate(&mean, &with_images_of(&images, &other, &[3]));
    assert!(says(&found, "contradict each other") && found.images[3].is_used, "{:?}", found.warnings);
}

/// What the modes leave out moves tip and tilt of each image, which are its own: they took 8 of 36
/// such groups for contradictory.
#[test]
fn images_of_one_wavefront_do_not_contradict_each_other() {
    let folder = tempfile::tempdir().unwrap();
    for planes in ["[0, 1, 2, 3]", "[-1, 0, 1, 2]"] {
        for seed in ["1", "2", "3"] {
            let own = [("image.diversity_planes", planes), ("image.count", "4"), ("aberrations.seed", seed)];
            let scene = in_focus(folder.path(), &[&own[..], &[("image.peak_snr", "100")]].concat());
            let found = estimate(&scene, &simulated(&scene));
            assert!(found.warnings.is_empty(), "{planes} {seed}: {:?}", found.warnings);
            assert!((0.5..1.8).contains(&pull(&found)), "{planes} {seed}: {}", pull(&found));
        }
    }
}

#[test]
fn images_that_cannot_be_used_are_named_and_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let scene = in_focus(folder.path(), &[]);
    let mut images = simulated(&scene);
    images.images_e.slice_mut(ndarray::s![2, .., ..]).fill(0.0);
    let found = estimate(&scene, &images);
    assert!(found.warnings[0].contains("channel map 1: no image can be used"), "{:?}", found.warnings);
    assert!(found.channels.len() == 4 && (0.6..1.6).contains(&pull(&found)), "{} {:?}", pull(&found), found.channels);
}

#[test]
fn an_amplitude_that_images_do_not_show_stays() {
    let channels = "[[image.channel]]\n[[image.channel]]\n";
    let settings = [("image.diversity_focus_waves_rms", "0.3"), ("estimate.fit_optics", "[\"defocus\"]")];
    let text = scene(&settings).text().replacen("[modes]", &format!("{channels}[modes]"), 1);
    let pair = Scene::from_text(&text, Path::new("")).unwrap();
    let found = Estimator::new(&pair).unwrap().estimate(&Images::simulated(&pair).unwrap()).unwrap();
    let [defocus] = found.optics.as_slice() else { panic!("{:?}", found.optics) };
    assert!(defocus.value == 0.3 && defocus.sigma.is_infinite(), "{defocus:?}");
    assert!(
        found.warnings.iter().any(|warning| warning.contains("do not determine the amplitude")),
        "{:?}",
        found.warnings
    );
    assert!((0.6..1.6).contains(&pull(&found)), "{}", pull(&found));
}

/// Whether the estimate from three images with `shape` of x, y and r² says that there is a twin.
fn says_twin(shape: fn(usize, [f64; 3]) -> f64, settings: &[(&str, &str)]) -> bool {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("own.fits");
    let value = |(number, y, x): (usize, usize, usize)| {
        let [x, y] = [x, y].map(|at| (at as f64 - 47.5) / 48.0);
        200.0 * shape(number, [x, y, x * x + y * y])
    };
    let mut file = FitsWriter::create(&path).unwrap();
    file.image("SHAPES", &Array3::from_shape_fn((2, 96, 96), value), Pixel::F64, "nm").unwrap();
    file.finish().unwrap();
    let own = [
        ("image.diversity_file", path.to_str().unwrap()),
        ("image.diversity_planes", "[-1, 0, 1]"),
        ("image.count", "3"),
    ];
    let scene = in_focus(folder.path(), &[&own[..], settings].concat());
    let found = estimate(&scene, &simulated(&scene));
    found.warnings.iter().any(|warning| warning.contains("the turned wavefront −W(−x, −y)"))
}

#[test]
fn shapes_that_are_all_odd_or_all_even_leave_a_twin() {
    let coma = |number, [x, y, square]: [f64; 3]| (3.0 * square - 2.0) * if number == 0 { x } else { y };
    assert!(says_twin(coma, &[]));
    // The twin behind even shapes needs them with the other sign.
    let even = |number, [x, y, square]: [f64; 3]| if number == 0 { 2.0 * square - 1.0 } else { 2.0 * x * y };
    assert!(says_twin(even, &[("estimate.fit_optics", "[\"diversity\"]")]));
    assert!(!says_twin(even, &[]));
}

#[test]
fn a_tolerance_of_the_defocus_leaves_no_twin() {
    let channels =
        "[[image.channel]]\nname = \"plus\"\n[[image.channel]]\nname = \"minus\"\ndiversity_focus_waves_rms = -0.2\n";
    let settings = [("image.diversity_focus_waves_rms", "0.2"), ("tolerance.defocus_fraction", "0.01")];
    let text = scene(&settings).text().replacen("[modes]", &format!("{channels}[modes]"), 1);
    let pair = Scene::from_text(&text, Path::new("")).unwrap();
    let found = Estimator::new(&pair).unwrap().estimate(&Images::simulated(&pair).unwrap()).unwrap();
    // The turned wavefront needs defocuses of the other sign.
    assert!(found.warnings.is_empty() && (0.6..1.6).contains(&pull(&found)), "{} {:?}", pull(&found), found.warnings);
}

#[test]
fn what_a_group_does_not_take_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let usual = in_focus(folder.path(), &[]);
    let images = simulated(&usual);
    let refused = |settings: &[(&str, &str)], parts: &[&str]| {
        let scene = usual.with(settings).unwrap();
        let images = Images { scene: None, ..images.clone() };
        let error = Estimator::new(&scene).unwrap().estimate(&images).unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{settings:?}: {error}");
    };
    refused(&[("image.diversity_planes", "[0, 1]")], &["image.diversity_planes has 2 numbers", "5 images"]);
    refused(&[("image.diversity_planes", "[0, 1, 2, 3, 4]")], &["has 4,", "4 maps"]);
    refused(&[("estimate.fitted_images", "[0, 7]")], &["names image 7", "0 to 4 are accepted"]);
    refused(&[("estimate.fitted_images", "[3]")], &["there is one"]);
    let each = [("estimate.fitted_images", "[0, 1]"), ("estimate.group", "each")];
    refused(&each, &["estimate.fitted_images", "estimate.group = \"all\""]);
    refused(&[("estimate.fit_optics", "[\"rotation\"]")], &["\"rotation\"", "estimate.group = \"each\""]);
    let at_rest = [("image.diversity_planes", "[-1, -1, -1, -1, -1]"), ("estimate.fit_optics", "[\"diversity\"]")];
    refused(&at_rest, &["all of them are 0"]);
    let one = Images {
        images_e: images.images_e.select(Axis(0), &[1]),
        bad: images.bad.select(Axis(0), &[1]),
        scene: None,
        ..images.clone()
    };
    let alone = usual.with(&[("image.diversity_planes", "[0]")]).unwrap();
    let error = Estimator::new(&alone).unwrap().estimate(&one).unwrap_err().to_string();
    assert!(error.contains("there is one: two or more are needed"), "{error}");
    let error = usual.with(&[("image.diversity_file", "")]).unwrap_err().to_string();
    assert!(error.contains("image.diversity_planes") && error.contains("image.diversity_file"), "{error}");
}

/// Real images of a bench in focus, between which a mirror took known shapes: two groups of one run
/// show one wavefront. Where the folder of the data is not there, nothing is tested.
#[test]
#[ignore = "merge: 40 s"]
fn groups_of_a_bench_show_one_wavefront() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let found = ["../shared/data/keck-bench", "../../shared/data/keck-bench"].map(|at| package.join(at));
    let Some(folder) = found.into_iter().find(|folder| folder.is_dir()) else {
        println!("no folder ../shared/data/keck-bench: nothing tested");
        return;
    };
    let run = folder.join("run1.fits");
    let whole = images_of(&run, None);
    // An image saw what the mirror was asked for after the one before it.
    let planes: Vec<i64> = (0..29).map(|image| image - 1).collect();
    let [one, other] = [[1, 4, 7, 11, 21], [2, 5, 9, 14, 25]].map(|which: [usize; 5]| {
        let text = format!(
            "[pupil]\naperture = \"round\"\nrings = 0\nsegment_side_m = 4.9\nsegment_gap_m = 0.0\ngrid_m = 11.3\nsamples = 120\n\
             [image]\nwavelength_nm = 2169.3\npixel_mas = 10.0\npixels = 64\ngain_e_per_adu = 3.5\nread_noise_e = 26.0\npixel_fill = 1.0\n\
             diversity_file = \"{}[DM_PHASE]\"\ndiversity_planes = {planes:?}\n\
             [modes]\nsegment = \"none\"\nncpa = \"zernike\"\nncpa_count = 44\nexact_zernikes = [2, 45]\n\
             [estimate]\ngroup = \"all\"\nfit_optics = [\"diversity\"]\nfitted_images = {which:?}\n",
            run.display()
        );
        let scene = Scene::from_text(&text, Path::new("")).unwrap();
        let found = estimate(&scene, &whole);
        let [scale] = found.optics.as_slice() else { panic!("{:?}", found.optics) };
        println!("reduced χ² {:.3}, scale {:.4} ± {:.4}", found.reduced_chi2, scale.value, scale.sigma);
        let mut unseen: Vec<f64> =
            found.images.iter().filter(|image| !image.is_used).map(|image| image.report.reduced_chi2).collect();
        unseen.sort_by(f64::total_cmp);
        println!("images that were not fitted: {unseen:.2?}");
        // All but those of the ends of the run.
        assert!(unseen.len() == 24 && unseen[18] < 1.8, "{unseen:?}");
        assert!(found.reduced_chi2 < 1.5 && (-0.72..-0.56).contains(&scale.value), "{} {scale:?}", found.reduced_chi2);
        found
    });
    let rms_nm = one.compare(&other.maps).unwrap().rms_nm[1];
    let sigma_nm = one.figures.ncpa.sigma_nm.hypot(other.figures.ncpa.sigma_nm);
    println!(
        "NCPA {:.1} and {:.1} nm, which differ by {rms_nm:.1} ± {sigma_nm:.1}",
        one.figures.ncpa.rms_nm, other.figures.ncpa.rms_nm
    );
    assert!(rms_nm < 1.5 * sigma_nm && sigma_nm < 80.0, "{rms_nm} {sigma_nm}");
}

//! Sequences of groups: the images of each exposure are fitted together, and the estimate is that
//! of the mean wavefront.

use crate::common::simulated;
use crate::consistency::scene;
use crate::groups::{estimate, in_focus, pull};
use cophase::pipeline::{Estimate, Estimator, Images, StaticMaps};
use cophase::scene::Scene;
use ndarray::{Array2, Axis};
use std::path::Path;

/// A pair at ±0.2 waves, `count` exposures of it, the images of each fitted together.
fn pairs(count: usize, settings: &[(&str, &str)]) -> Scene {
    let channels =
        "[[image.channel]]\nname = \"plus\"\n[[image.channel]]\nname = \"minus\"\ndiversity_focus_waves_rms = -0.2\n";
    let count = count.to_string();
    let usual = [("image.diversity_focus_waves_rms", "0.2"), ("image.count", &count), ("estimate.group", "channels")];
    let text = scene(&[&usual[..], settings].concat()).text().replacen("[modes]", &format!("{channels}[modes]"), 1);
    Scene::from_text(&text, Path::new("")).unwrap()
}

fn estimate_of(scene: &Scene, images: &[Images]) -> Estimate {
    Estimator::new(scene).unwrap().estimate(images).unwrap()
}

/// Gives `images` those of `other` in the group `group`.
fn with_group_of(images: &mut [Images], other: &[Images], group: usize) {
    for (own, other) in images.iter_mut().zip(other) {
        own.scene = None;
        own.images_e.index_axis_mut(Axis(0), group).assign(&other.images_e.index_axis(Axis(0), group));
    }
}

#[test]
fn groups_of_one_wavefront_are_averaged() {
    let scene = pairs(4, &[]);
    let images = Images::simulated(&scene).unwrap();
    let found = estimate_of(&scene, &images);
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
    assert!(found.remarks[0].contains("4 groups of 2 images"), "{:?}", found.remarks);
    assert!((0.6..1.6).contains(&pull(&found)) && !found.is_sequence, "{}", pull(&found));
    // All images together are the same images of the same wavefront.
    let together = estimate_of(&scene.with(&[("estimate.group", "all")]).unwrap(), &images);
    let [own, all] = [&found, &together].map(|one| one.figures.wavefront.sigma_nm);
    assert!((0.8..1.25).contains(&(own / all)), "{own} {all}");
    let apart_nm = found.compare(&together.maps).unwrap().rms_nm[2];
    assert!(apart_nm < 0.7 * all, "{apart_nm} {all}");
    // Two pairs in a group, which are two groups.
    let twos = estimate_of(&scene.with(&[("estimate.group", "2")]).unwrap(), &images);
    assert!(twos.remarks[0].contains("2 groups of 4 images"), "{:?}", twos.remarks);
    assert!(twos.compare(&together.maps).unwrap().rms_nm[2] < 0.7 * all);
}

#[test]
fn a_group_of_another_wavefront_is_left_out() {
    let scene = pairs(5, &[]);
    let mut images = Images::simulated(&scene).unwrap();
    let other = Images::simulated(&scene.with(&[("aberrations.ncpa_rms_nm", "100")]).unwrap()).unwrap();
    with_group_of(&mut images, &other, 3);
    let found = estimate_of(&scene, &images);
    assert!(found.warnings.iter().any(|warning| warning.contains("group 4 of 5")), "{:?}", found.warnings);
    let clipped: Vec<usize> = (0..10).filter(|&image| found.images[image].is_clipped).collect();
    assert_eq!((clipped, found.status), (vec![3, 8], cophase::Status::Ok), "{:?}", found.warnings);
    assert!((0.6..1.6).contains(&pull(&found)), "{}", pull(&found));
    // Half of the groups: of which wavefront the mean is to be is not known.
    with_group_of(&mut images, &other, 0);
    let found = estimate_of(&scene, &images);
    assert_eq!(found.status, cophase::Status::Contradictory, "{:?}", found.warnings);
    assert!(found.warnings.iter().any(|warning| warning.contains("the groups contradict")), "{:?}", found.warnings);
    assert!(found.images.iter().all(|image| image.is_used));
}

#[test]
fn a_group_with_an_image_that_cannot_be_used_is_left_out() {
    let scene = pairs(3, &[]);
    let mut images = Images::simulated(&scene).unwrap();
    // One that holds nothing, and one whose star is found to be none by the fit.
    let noise = Images::simulated(&scene.with(&[("image.peak_snr", "0.5")]).unwrap()).unwrap();
    let noise = noise[1].images_e.index_axis(Axis(0), 2).to_owned();
    for (frame, reason) in [(Array2::zeros(noise.dim()), "constant"), (noise, "holds no star")] {
        images[1].images_e.index_axis_mut(Axis(0), 2).assign(&frame);
        let found = estimate_of(&scene, &images);
        let used: Vec<bool> = found.images.iter().map(|image| image.is_used).collect();
        assert_eq!(used, [true, true, false, true, true, false], "{:?}", found.warnings);
        let [warning] = found.warnings.as_slice() else { panic!("{:?}", found.warnings) };
        assert!(warning.contains("group 3 of 3 cannot") && warning.contains(reason), "{warning}");
        assert!((0.6..1.6).contains(&pull(&found)), "{}", pull(&found));
    }
}

#[test]
fn error_bars_hold_a_wavefront_that_changes_between_groups() {
    let scene = pairs(8, &[]);
    let mut images = Images::simulated(&scene).unwrap();
    let still = estimate_of(&scene, &images);
    assert!(!still.is_sequence && still.warnings.is_empty(), "{:?}", still.warnings);
    assert!((0.6..1.6).contains(&pull(&still)), "{}", pull(&still));
    let size = still.maps.ncpa_nm.dim();
    let mut mean = StaticMaps { phasing_nm: Array2::zeros(size), ncpa_nm: Array2::zeros(size) };
    for group in 0..8 {
        let seed = (20 + group).to_string();
        let own = Images::simulated(&scene.with(&[("aberrations.seed", &seed)]).unwrap()).unwrap();
        with_group_of(&mut images, &own, group);
        let truth = own[0].truth.as_ref().unwrap();
        mean.phasing_nm.scaled_add(0.125, &truth.phasing_nm);
        mean.ncpa_nm.scaled_add(0.125, &truth.ncpa_nm);
    }
    let found = estimate_of(&scene, &images);
    assert!(found.warnings.iter().any(|warning| warning.contains("from group to group")), "{:?}", found.warnings);
    assert!(found.error_budget[0].name == "scatter between groups", "{}", found.error_budget[0].name);
    let (residual_nm, sigma_nm) = (found.compare(&mean).unwrap().rms_nm[2], found.figures.wavefront.sigma_nm);
    // Their mean is known to its noise, and the error bar is from what the eight differ.
    assert!(residual_nm < 2.0 * still.figures.wavefront.sigma_nm, "{residual_nm}");
    assert!(sigma_nm > 5.0 * still.figures.wavefront.sigma_nm, "{sigma_nm}");
}

#[test]
fn groups_are_of_exposures_while_the_pupil_turns() {
    let scene = pairs(4, &[("image.pupil_turns_deg", "[0, 20, 0, 20]"), ("image.peak_snr", "200")]);
    let mut images = Images::simulated(&scene).unwrap();
    let other = Images::simulated(&scene.with(&[("aberrations.ncpa_rms_nm", "100")]).unwrap()).unwrap();
    with_group_of(&mut images, &other, 2);
    let found = estimate_of(&scene, &images);
    assert!(found.remarks.iter().any(|remark| remark.contains("4 groups of 2 images")), "{:?}", found.remarks);
    assert!(found.warnings.iter().any(|warning| warning.contains("group 3 of 4")), "{:?}", found.warnings);
    let used: Vec<bool> = found.images.iter().map(|image| image.is_used).collect();
    assert_eq!(used, [true, true, false, true, true, true, false, true]);
    assert!((0.6..1.6).contains(&pull(&found)), "{}", pull(&found));
}

/// Faint images are weighed by read noise and bright ones by photon noise, and know other modes:
/// by one Gauss-Newton matrix for all, error bars were five to ten times too large.
#[test]
fn groups_of_unequal_brightness_count_by_what_they_know() {
    let faint = pairs(5, &[("image.peak_snr", "30")]);
    let mut images = Images::simulated(&faint).unwrap();
    let bright = Images::simulated(&faint.with(&[("image.peak_snr", "300")]).unwrap()).unwrap();
    with_group_of(&mut images, &bright, 2);
    let alone: Vec<Images> = bright
        .iter()
        .map(|images| Images {
            images_e: images.images_e.select(Axis(0), &[2]),
            bad: images.bad.select(Axis(0), &[2]),
            scene: None,
            ..images.clone()
        })
        .collect();
    let alone = estimate_of(&faint.with(&[("estimate.group", "all")]).unwrap(), &alone);
    for group in ["channels", "all"] {
        let found = estimate_of(&faint.with(&[("estimate.group", group)]).unwrap(), &images);
        let [own, least] = [&found, &alone].map(|one| one.figures.wavefront.sigma_nm);
        assert!(found.warnings.is_empty() && own < 1.1 * least, "{group}: {own} {least} {:?}", found.warnings);
        assert!((0.5..1.6).contains(&pull(&found)), "{group}: {}", pull(&found));
    }
}

#[test]
fn one_image_of_one_channel_is_no_group() {
    let usual = scene(&[("image.count", "3")]);
    let images = simulated(&usual);
    let [each, channels] = ["each", "channels"].map(|group| {
        let own = usual.with(&[("estimate.group", group)]).unwrap();
        estimate(&own, &Images { scene: None, ..images.clone() })
    });
    assert_eq!(each.modes.coefficients_nm, channels.modes.coefficients_nm);
}

#[test]
fn sweeps_of_a_mirror_in_focus_are_groups() {
    let folder = tempfile::tempdir().unwrap();
    let planes =
        [("image.diversity_planes", "[-1, 0, 1, 2, -1, 0, 1, 2]"), ("image.count", "8"), ("estimate.group", "4")];
    let scene = in_focus(folder.path(), &planes);
    let found = estimate(&scene, &simulated(&scene));
    assert!(found.remarks[0].contains("2 groups of 4 images"), "{:?}", found.remarks);
    assert!(found.warnings.is_empty() && (0.6..1.6).contains(&pull(&found)), "{} {:?}", pull(&found), found.warnings);
}

#[test]
fn what_a_sequence_of_groups_does_not_take_is_named() {
    let usual = pairs(3, &[]);
    let images = Images::simulated(&usual).unwrap();
    let refused = |settings: &[(&str, &str)], parts: &[&str]| {
        let error = usual.with(settings).and_then(|scene| Estimator::new(&scene)?.estimate(&images));
        let error = error.unwrap_err().to_string();
        assert!(parts.iter().all(|part| error.contains(part)), "{settings:?}: {error}");
    };
    refused(&[("estimate.group", "2")], &["estimate.group = 2", "a multiple of 2", "3 exposures", "4, 2 images"]);
    refused(&[("estimate.group", "6")], &["estimate.group = 6", "3 exposures"]);
    refused(&[("estimate.group", "0")], &["estimate.group", "\"channels\"", "from 1 to 10000"]);
    refused(&[("estimate.combine", "median")], &["sequence of groups", "median"]);
    refused(&[("estimate.fitted_images", "[0, 1]")], &["sequence of groups", "estimate.fitted_images"]);
    refused(&[("estimate.fit_optics", "[\"defocus\"]")], &["sequence of groups", "estimate.fit_optics"]);
    refused(&[("tolerance.defocus_fraction", "0.01")], &["sequence of groups", "tolerance.defocus_fraction"]);
}

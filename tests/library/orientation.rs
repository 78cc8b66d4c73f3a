//! Orientation of images: where the data determine it, it is checked, and where they do not, one
//! remark says so.

use crate::common::simulated;
use crate::consistency::{scene, shown};
use crate::full_phase::{exposures, sky};
use cophase::Status;
use cophase::ao::Stepper;
use cophase::pipeline::{Estimate, Estimator, Images};
use cophase::scene::{AoKnowledge, Scene};
use ndarray::Array3;

/// A pupil that no flip leaves as it is: two vanes, neither on an axis nor opposite to each other.
const VANES: [(&str, &str); 2] = [("pupil.spider_width_m", "0.25"), ("pupil.spider_vanes_deg", "[75, 200]")];
const UNVERIFIED: &str = "The orientation cannot be verified";

fn estimate(scene: &Scene, images: &Images) -> Estimate {
    shown(Estimator::new(scene).unwrap().estimate(images).unwrap())
}

#[test]
#[ignore = "merge: 6 s"]
fn diversity_sign_is_unverified_for_point_symmetric_pupils() {
    let remark = |settings: &[(&str, &str)]| {
        let scene = Scene::preset("keck-artificial").unwrap().with(settings).unwrap();
        let found = estimate(&scene, &simulated(&scene));
        found.remarks.into_iter().find(|remark| remark.contains(UNVERIFIED)).unwrap_or_default()
    };
    assert!(remark(&[]).contains("Nor can the sign of the diversity"));
    // One vane leaves a flip that the pupil equals, and no turn.
    let vane = [("pupil.spider_width_m", "0.25"), ("pupil.spider_vanes_deg", "[90]")];
    let flips = remark(&vane);
    assert!(flips.contains(UNVERIFIED) && !flips.contains("sign of the diversity"), "{flips}");
}

fn remarks(found: &Estimate) -> usize {
    found.remarks.iter().filter(|remark| remark.contains(UNVERIFIED)).count()
}

/// The images, with pixel (row, column) that of `source` of them, counted from the axis, which is
/// on pixel M/2.
fn moved(images: &Images, source: impl Fn(usize, usize) -> (usize, usize)) -> Images {
    let at = |(i, y, x): (usize, usize, usize)| {
        let (y, x) = source(y, x);
        images.images_e[[i, y, x]]
    };
    Images { images_e: Array3::from_shape_fn(images.images_e.dim(), at), ..images.clone() }
}

#[test]
#[ignore = "merge: 14 s"]
fn a_pupil_without_symmetry_determines_the_orientation() {
    let scene = scene(&VANES);
    let (n, images) = (96, simulated(&scene));
    let right = estimate(&scene, &images);
    assert!(right.is_sound() && remarks(&right) == 0, "{:?} {:?}", right.warnings, right.remarks);
    // All but one: a turn by 180° with the opposite diversity has the same image, and the opposite
    // maps.
    let opposite =
        scene.with(&[("image.diversity_focus_waves_rms", "-0.8"), ("image.flip_x", "true"), ("image.flip_y", "true")]);
    let turned = Images { truth: None, scene: None, facts: Vec::new(), ..images.clone() };
    let opposite = Estimator::new(&opposite.unwrap()).unwrap().estimate(&turned).unwrap();
    assert!(opposite.is_sound(), "{:?}", opposite.warnings);
    for (one, other) in right.modes.coefficients_nm.iter().zip(&opposite.modes.coefficients_nm) {
        // Two fits that stop at steps of a fraction of their error bars.
        assert!((one + other).abs() < right.figures.phasing.sigma_nm, "{one} {other}");
    }
    for found in [&right, &opposite] {
        assert!(found.remarks.iter().any(|remark| remark.contains("Images turned by 180°")), "{:?}", found.remarks);
    }
    for (name, flip_x, flip_y) in [("left to right", true, false), ("up to down", false, true), ("both", true, true)] {
        let mirrored = |at: usize, flip: bool| if flip { (n - at) % n } else { at };
        let found = estimate(&scene, &moved(&images, |y, x| (mirrored(y, flip_y), mirrored(x, flip_x))));
        assert!(
            matches!(found.status, Status::Misfit | Status::WrongMinimum),
            "{name}: {:?}, χ² {}",
            found.status,
            found.reduced_chi2
        );
        assert!(!found.is_sound() && remarks(&found) == 0, "{name}: {:?}", found.remarks);
    }
}

#[test]
fn a_pupil_that_equals_its_mirror_image_does_not() {
    let scene = scene(&[]);
    let images = simulated(&scene);
    let flipped = moved(&images, |y, x| (y, (96 - x) % 96));
    let [right, flipped] = [&images, &flipped].map(|images| estimate(&scene, images));
    assert!(right.is_sound() && remarks(&right) == 1, "{:?} {:?}", right.warnings, right.remarks);
    // Wrong, and nothing in the image shows it: the remark is what the user has.
    assert!(flipped.is_sound() && remarks(&flipped) == 1, "{:?} {:?}", flipped.warnings, flipped.remarks);
    let residual_nm = flipped.truth.as_ref().unwrap().1.rms_nm;
    assert!(residual_nm[0] > 3.0 * flipped.figures.phasing.sigma_nm, "{residual_nm:?}");
}

/// The response of a known loop is computed from the pistons, whose flipped map has the flipped
/// response.
#[test]
#[ignore = "merge: 4 s"]
fn known_loop_without_slopes_leaves_the_orientation_open() {
    let settings = [("estimate.method", "full-phase"), ("estimate.device", "cpu")];
    let scene = Scene::from_file(sky()).unwrap().with(&settings).unwrap();
    let images = exposures(&mut Stepper::new(&scene).unwrap(), 3);
    let images = Images { slopes_mas: None, ..images };
    let found = Estimator::new(&scene).unwrap().estimate(&images).unwrap();
    assert_eq!(found.full_phase().unwrap().ao_knowledge, AoKnowledge::Loop);
    assert_eq!(remarks(&found), 1, "{:?}", found.remarks);
    assert_eq!(found.report().matches(UNVERIFIED).count(), 1, "{}", found.report());
}

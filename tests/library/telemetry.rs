//! Telemetry that does not belong to the images, images in another orientation, and images that
//! change: each is named.

use crate::common::{assert_facts, simulated};
use crate::full_phase::{exposures, sky};
use cophase::Status;
use cophase::ao::Stepper;
use cophase::pipeline::{Estimate, Estimator, Images, Orientation, Poke, PokeResult, check_orientation};
use cophase::scene::{AoKnowledge, Scene};
use cophase::source::{Camera, Truth};
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use ndarray::{Array1, Array2, Array3, Axis, concatenate, s};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

fn scene(settings: &[(&str, &str)]) -> Scene {
    let own = [("estimate.method", "full-phase"), ("estimate.device", "cpu")];
    Scene::from_file(sky()).unwrap().with(&[&own, settings].concat()).unwrap()
}

/// Settings of modal estimates: the small mirror has fewer modes than the default.
const MODAL: [(&str, &str); 4] = [
    ("estimate.method", "modal"),
    ("estimate.precision", "f64"),
    ("modes.ncpa", "zernike"),
    ("modes.ncpa_count", "14"),
];

fn images(count: usize) -> Images {
    exposures(&mut Stepper::new(&scene(&[])).unwrap(), count)
}

fn estimate(scene: &Scene, images: &Images) -> Result<Estimate> {
    Estimator::new(scene)?.estimate(images)
}

fn with_slopes(images: &Images, change: impl Fn(&Array2<f64>) -> Array2<f64>) -> Images {
    Images { slopes_mas: images.slopes_mas.as_ref().map(change), ..images.clone() }
}

/// The frame mirrored left to right about its axis, pixel M/2.
fn flipped(images: &Images) -> Images {
    let columns = images.images_e.dim().2;
    let at = |(i, y, x): (usize, usize, usize)| images.images_e[[i, y, (columns - x) % columns]];
    Images { images_e: Array3::from_shape_fn(images.images_e.dim(), at), ..images.clone() }
}

/// The frame mirrored up to down about its axis.
fn flipped_up_down(images: &Images) -> Images {
    let rows = images.images_e.dim().1;
    let at = |(i, y, x): (usize, usize, usize)| images.images_e[[i, (rows - y) % rows, x]];
    Images { images_e: Array3::from_shape_fn(images.images_e.dim(), at), ..images.clone() }
}

#[test]
#[ignore = "merge: 15 s"]
fn slopes_of_other_images_are_refused_with_the_cause() {
    let (scene, right) = (scene(&[]), images(4));
    let half = right.slopes_mas.as_ref().unwrap().ncols() / 2;
    let x_and_y =
        |slopes: &Array2<f64>| (slopes.slice(s![.., ..half]).to_owned(), slopes.slice(s![.., half..]).to_owned());
    let swapped = |slopes: &Array2<f64>| {
        let (x, y) = x_and_y(slopes);
        concatenate![Axis(1), y, x]
    };
    let interleaved = |slopes: &Array2<f64>| {
        let (x, y) = x_and_y(slopes);
        Array2::from_shape_fn(slopes.dim(), |(i, k)| if k % 2 == 0 { x[[i, k / 2]] } else { y[[i, k / 2]] })
    };
    type Change<'a> = (&'a dyn Fn(&Array2<f64>) -> Array2<f64>, &'a str);
    let changes: [Change; 8] = [
        (&|slopes| -slopes, "the slopes have the opposite sign"),
        (&swapped, "along y come before"),
        (&interleaved, "come in turn"),
        (&|slopes| slopes / 500.0, "another unit or scale"),
        (&|slopes| slopes * 0.0, "all slopes are 0"),
        (&|slopes| slopes * 0.0 + 3.0, "every image has the same slopes"),
        (&|slopes| slopes.slice(s![..;-1, ..]).to_owned(), "in the reverse order of the images"),
        (
            &|slopes| Array2::from_shape_fn(slopes.dim(), |(i, k)| ((i * 7919 + k * 104_729) % 997) as f64 - 498.0),
            "of another night or sensor",
        ),
    ];
    for (change, cause) in changes {
        match estimate(&scene, &with_slopes(&right, change)).map(|_| ()) {
            Err(Error::Value(sentence)) => {
                assert_facts(&sentence, &format!("telemetry does not belong | {cause} | estimate.telemetry"));
            }
            other => panic!("{cause}: {other:?}"),
        }
    }
    for (images, cause) in [
        (flipped(&right), "flipped left to right (image.flip_x = true"),
        (flipped_up_down(&right), "flipped up to down (image.flip_y = true"),
    ] {
        let refused = estimate(&scene, &images).unwrap_err().to_string();
        assert!(refused.contains(cause), "{refused}");
    }
}

#[test]
#[ignore = "merge: 10 s"]
fn telemetry_is_used_at_its_gain_or_ignored_as_the_scene_sets() {
    let right = images(4);
    let found = estimate(&scene(&[]), &right).unwrap();
    let check = found.full_phase().unwrap().telemetry.clone().unwrap();
    // Retrieved wavefronts have an error of a tenth of the residual.
    assert!((0.85..1.15).contains(&check.gain) && check.correlation > 0.9, "{check:?}");
    assert!(check.excludes_flips && check.divided_by == 1.0 && check.image_correlations.len() == 4);
    assert!(found.report().contains("with a correlation of") && found.warnings.is_empty(), "{}", found.report());
    let says_why = found.report().contains("too fine or too fast");
    assert_eq!(says_why, found.reduced_chi2 > 1.1, "{}", found.report());
    assert!(!found.remarks.iter().any(|remark| remark.contains("orientation cannot be verified")));
    let negated = with_slopes(&right, |slopes| slopes * -40.0);
    let used = estimate(&scene(&[("estimate.telemetry", "use")]), &negated).unwrap();
    let gain = used.full_phase().unwrap().telemetry.as_ref().unwrap().divided_by;
    assert!((gain / (-40.0 * check.gain) - 1.0).abs() < 1e-6, "{gain}");
    assert!(used.warnings.iter().any(|warning| warning.contains("divided by -")), "{:?}", used.warnings);
    // The same slopes but for the gain, which is within a tenth of 1.
    let apart_nm = used.compare(&found.maps).unwrap().rms_nm;
    assert!(apart_nm[1] < 0.15 * found.figures.ncpa.rms_nm, "{apart_nm:?}");
    // Reference slopes are in the unit of the measured ones.
    let [moved, negated_moved] = [&found, &used].map(|found| Array1::from(found.corrections(None).unwrap().slopes_mas));
    let off = &negated_moved / -40.0 - &moved;
    assert!(off.dot(&off) < 0.15f64.powi(2) * moved.dot(&moved), "{}", (off.dot(&off) / moved.dot(&moved)).sqrt());
    let ignored = estimate(&scene(&[("estimate.telemetry", "ignore")]), &negated).unwrap();
    let map = ignored.full_phase().unwrap();
    assert!(map.ao_knowledge == AoKnowledge::Loop && map.telemetry.is_none());
    assert!(ignored.remarks.iter().any(|remark| remark.contains("orientation cannot be verified")));
}

#[test]
fn reference_slopes_without_measured_slopes_have_a_warning() {
    // Large beside what turbulence leaves in the mean of eight images, so that they are corrected.
    let scene = scene(&[("aberrations.ncpa_rms_nm", "300"), ("estimate.telemetry", "ignore")]);
    let images = exposures(&mut Stepper::new(&scene).unwrap(), 8);
    let corrections = estimate(&scene, &images).unwrap().corrections(None).unwrap();
    assert!(corrections.corrected_modes > 0 && corrections.slopes_mas.is_empty());
    let [sentence] = &corrections.warnings[..] else { panic!("{:?}", corrections.warnings) };
    assert!(sentence.starts_with("reference slopes are left out"), "{sentence}");
}

#[test]
#[ignore = "merge: 2 s"]
fn noise_that_is_smaller_than_stated_is_flagged() {
    // Counts of 20 electrons each, without their unit.
    let right = images(3);
    let counts = Images { images_e: &right.images_e / 20.0, slopes_mas: None, ..right };
    let found = estimate(&scene(&[]), &counts).unwrap();
    assert_eq!(found.status, Status::Misfit);
    let is_named = found.warnings.iter().any(|warning| warning.contains("is the image in electrons"));
    assert!(found.reduced_chi2 < 0.5 && is_named, "{:?}", found.warnings);
}

#[test]
fn settings_that_contradict_one_another_are_refused() {
    for (settings, word) in [
        (vec![("estimate.telemetry", "ignore"), ("estimate.ao_knowledge", "telemetry")], "contradicts"),
        (vec![("estimate.method", "modal"), ("estimate.telemetry", "use")], "estimate.method is \"modal\""),
        (vec![("estimate.telemetry", "trust")], "\"check\", \"use\" or \"ignore\""),
    ] {
        let own = [("estimate.method", "full-phase")];
        let refused = Scene::from_file(sky()).unwrap().with(&[&own, &settings[..]].concat()).unwrap_err().to_string();
        assert!(refused.contains(word), "{refused}");
    }
}

#[test]
#[ignore = "merge: 5 s"]
fn changing_images_are_recognised_and_given_their_method() {
    let changing = images(5);
    let modal = estimate(&scene(&MODAL), &changing).unwrap();
    let warnings = modal.warnings.join("\n");
    assert_facts(&warnings, "images change | full-phase");
    assert!(!warnings.contains("scene differs from the instrument"), "{warnings}");
    let auto = estimate(&scene(&[("estimate.method", "auto")]), &changing).unwrap();
    assert!(auto.full_phase().is_some());
    assert!(auto.remarks.iter().any(|remark| remark.contains("chose \"full-phase\"")), "{:?}", auto.remarks);
    let source = scene(&[&MODAL[..], &[("image.count", "3"), ("estimate.method", "auto")]].concat());
    let still = estimate(&source, &simulated(&source)).unwrap();
    assert!(still.modal().is_some());
    assert!(still.remarks.iter().any(|remark| remark.contains("chose \"modal\"")), "{:?}", still.remarks);
}

/// Images of the same aberrations before and after a poke of a segment by `nm`, without noise.
fn poked(scene: &Scene, segment: usize, nm: f64) -> [Images; 2] {
    let telescope = Telescope::new(scene).unwrap();
    let truth = || Truth::draw(scene, &telescope, &mut ChaCha8Rng::seed_from_u64(3)).unwrap();
    let image = |truth: &Truth| {
        let psf = Camera::new(scene, &telescope).unwrap().psf(truth).unwrap();
        Images::new((psf * 1e7).insert_axis(Axis(0)))
    };
    let mut pistons_nm = truth().piston_nm;
    pistons_nm[segment] += nm;
    [image(&truth()), image(&truth().with_pistons(&telescope, pistons_nm).unwrap())]
}

#[test]
#[ignore = "merge: 77 s"]
fn a_poke_shows_the_orientation() {
    let modal = scene(&[&MODAL[..], &[("image.rows", ""), ("image.pixels", "80")]].concat());
    let [before, after] = poked(&modal, 1, 150.0);
    let result = |scene: &Scene, before: Option<&Images>, after: &Images, poke| {
        check_orientation(scene, before, after, poke, &Default::default())
    };
    let check = |scene: &Scene, before: Option<&Images>, after: &Images, poke| -> Box<Orientation> {
        let found = result(scene, before, after, poke).unwrap();
        let PokeResult::Orientation(found) = found else { panic!("{found:?}") };
        found
    };
    let settings = |found: &Orientation| found.settings.iter().map(ToString::to_string).collect::<Vec<_>>();
    let poke = Poke::Segment(1, 150.0);
    let found = check(&modal, Some(&before), &after, poke);
    assert!(found.moved.as_ref().is_some_and(|moved| moved.is_stated && moved.name == "segment 1"), "{found:?}");
    assert_eq!((found.best.flip, found.best.rotation_deg, found.best.sign), ([false; 2], 0.0, 1.0), "{found:?}");
    assert!(found.settings.is_empty() && (found.best.amplitude - 1.0).abs() < 0.1, "{found:?}");
    let found = check(&modal, Some(&flipped(&before)), &flipped(&after), poke);
    assert_eq!(settings(&found), ["image.flip_x = true"], "{found:?}");
    let flips = modal.with_override("image.flip_x", "true").unwrap();
    assert!(check(&flips, Some(&flipped(&before)), &flipped(&after), poke).settings.is_empty());
    let opposite = check(&modal, Some(&before), &after, Poke::Segment(1, -150.0));
    assert!(opposite.best.sign < 0.0 && !opposite.warnings.is_empty(), "{opposite:?}");
    let reversed = modal.with_override("image.diversity_focus_waves_rms", "-1.0").unwrap();
    let found = check(&reversed, Some(&before), &after, poke);
    assert_eq!(settings(&found), ["image.diversity_focus_waves_rms = 1"], "{found:?}");
    // The central segment is its own mirror image, and so is one on the y axis.
    for (segment, word) in [(0, "does not distinguish"), (2, "symmetry axis")] {
        let [before, after] = poked(&modal, segment, 150.0);
        let open = result(&modal, Some(&before), &after, Poke::Segment(segment, 150.0)).unwrap();
        assert!(matches!(&open, PokeResult::Undecided(sentence) if sentence.contains(word)), "{open:?}");
    }
    let open = result(&modal, Some(&before), &before, poke).unwrap();
    let facts = "do not show the poke of segment 1";
    assert!(matches!(&open, PokeResult::Undecided(sentence) if sentence.contains(facts)), "{open:?}");
    // Another number than that of the segment that moved: the segment is named, and no orientation
    // is.
    let other = result(&modal, Some(&before), &after, Poke::Segment(0, 150.0)).unwrap();
    assert!(matches!(&other, PokeResult::OtherPart(sentence) if sentence.starts_with("segment 1 moved")), "{other:?}");
    let refused = result(&modal, None, &after, Poke::Segment(7, 100.0)).unwrap_err().to_string();
    assert!(refused.contains("0 to 6 is accepted"), "{refused}");
}

//! Full-phase estimates of a small telescope: what they take of the scene, and what corrections do
//! to the true errors behind the exposures that they were estimated from, by which their order and
//! their sign are told.

use crate::common::assert_facts;
use cophase::Control;
use cophase::Error;
use cophase::Precision;
use cophase::ao::{Shot, Simulator, Stepper};
use cophase::io::{FitsReader, FitsWriter, Pixel};
use cophase::modes::{Samples, SegmentModes};
use cophase::pipeline::{Estimate, Estimator, Images, SentCorrections};
use cophase::scene::{self, Scene};
use ndarray::{Array2, Array3, ArrayView1, ArrayView2, Axis};
use std::path::{Path, PathBuf};

/// A small telescope behind a loop.
pub fn sky() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/c_api/sky.toml")
}

fn read(scene: &Scene, images: &Images) -> Result<Estimate, Error> {
    Estimator::new(scene)?.estimate(images)
}

/// Exposures behind the loop, with the slopes that were measured meanwhile.
pub fn exposures(stepper: &mut Stepper, count: usize) -> Images {
    exposures_apart(stepper, 60, count)
}

/// The same, so many frames apart.
pub fn exposures_apart(stepper: &mut Stepper, frames: u64, count: usize) -> Images {
    let (mut images_e, mut slopes_mas) = (Vec::new(), Vec::new());
    stepper.step(300).unwrap();
    for _ in 0..count {
        stepper.step(frames).unwrap();
        images_e.push(stepper.image_e().unwrap().mapv(f64::from));
        slopes_mas.extend(stepper.last().unwrap().slopes_mas.iter().map(|&mas| f64::from(mas)));
    }
    let views: Vec<_> = images_e.iter().map(|image| image.view()).collect();
    let images_e: Array3<f64> = ndarray::stack(Axis(0), &views).unwrap();
    let slopes_mas = Array2::from_shape_vec((count, slopes_mas.len() / count), slopes_mas).unwrap();
    Images { slopes_mas: Some(slopes_mas), ..Images::new(images_e) }
}

#[test]
#[ignore = "merge: 5 s"]
fn estimates_in_single_and_double_precision_agree() {
    let single = Scene::from_file(sky()).unwrap().with(&[("estimate.method", "full-phase")]).unwrap();
    let double = single.with_override("estimate.precision", "f64").unwrap();
    let images = exposures(&mut Stepper::new(&single).unwrap(), 3);
    let [single, double] = [single, double].map(|scene| read(&scene, &images).unwrap());
    assert_eq!((single.run.precision, double.run.precision), (Precision::F32, Precision::F64));
    let (one_nm, other_nm) = (&single.modes.coefficients_nm, &double.modes.coefficients_nm);
    assert_ne!(one_nm, other_nm);
    // A retrieval stops within a fraction of what its noise leaves, in either precision somewhere
    // else.
    let within = |((one, other), sigma): ((&f64, &f64), f64)| (one - other).abs() < sigma;
    assert!(one_nm.iter().zip(other_nm).zip(double.modes.sigma_nm()).all(within), "{one_nm:?} {other_nm:?}");
}

/// The motion of the turbulence during exposures of 30 ms, with the telescope's own errors at 0:
/// what it leaves in the NCPA where the estimate knows the exposure, and where it takes it for an
/// instant.
#[test]
#[ignore = "merge: 11 s"]
fn exposures_that_the_turbulence_blurs_leave_no_ncpa() {
    let settings = [
        ("estimate.method", "full-phase"),
        ("aberrations.segment_piston_rms_nm", "0"),
        ("aberrations.ncpa_rms_nm", "0"),
        ("image.exposure_s", "0.030"),
        ("image.interval_s", "0.06"),
        ("image.count", "24"),
    ];
    let scene = Scene::from_file(sky()).unwrap().with(&settings).unwrap();
    let mut shots: Vec<Shot> = Vec::new();
    Simulator::new(&scene).unwrap().run(&mut shots, &Control::default()).unwrap();
    let views: Vec<_> = shots.iter().map(|shot| shot.image_e.mapv(f64::from)).collect();
    let images_e = ndarray::stack(Axis(0), &views.iter().map(|image| image.view()).collect::<Vec<_>>()).unwrap();
    let slopes_mas = Array2::from_shape_fn((shots.len(), shots[0].mean_slopes_mas.len()), |(image, slope)| {
        f64::from(shots[image].mean_slopes_mas[slope])
    });
    let images = Images { slopes_mas: Some(slopes_mas), ..Images::new(images_e) };
    let [known, instant] = ["0.030", "1e-6"].map(|exposure_s| {
        let estimate = read(&scene.with_override("image.exposure_s", exposure_s).unwrap(), &images).unwrap();
        (estimate.figures.ncpa.rms_nm, estimate.figures.ncpa.sigma_nm)
    });
    println!("NCPA and error bar, nm RMS: {known:?}, {instant:?} for an instant");
    // The error bar says how far chance may take it; two of them are 5 %.
    assert!(known.0 < 2.0 * known.1, "{known:?}");
    assert!(known.0 < 0.5 * instant.0, "{known:?} {instant:?}");
}

/// The whole estimate on every OpenCL device: what it says of itself, and the CPU's answer.
#[test]
#[ignore = "merge: 8 s"]
fn estimates_on_cpu_and_device_agree() {
    let settings = [("estimate.method", "full-phase"), ("estimate.precision", "f64"), ("estimate.device", "cpu")];
    let cpu = Scene::from_file(sky()).unwrap().with(&settings).unwrap();
    let images = exposures(&mut Stepper::new(&cpu).unwrap(), 3);
    let absent = cpu.with_override("estimate.device", "opencl:99:0").unwrap();
    assert!(matches!(read(&absent, &images), Err(Error::Device(_))));
    let devices = cophase::device::devices().unwrap_or_default();
    let required = std::env::var("COPHASE_REQUIRE_OPENCL").as_deref() == Ok("1");
    assert!(!devices.is_empty() || !required, "COPHASE_REQUIRE_OPENCL=1, and no OpenCL device was found");
    let wanted = read(&cpu, &images).unwrap();
    assert_eq!((wanted.run.device.as_str(), wanted.warnings.len()), ("cpu", 0));
    let (wanted_nm, sigma_nm) = (&wanted.modes.coefficients_nm, wanted.modes.sigma_nm());
    for info in devices.iter().filter(|info| info.f64) {
        let scene = cpu.with_override("estimate.device", &info.address()).unwrap();
        let found = read(&scene, &images).unwrap();
        assert!(found.run.device.starts_with(&info.address()), "{}", found.run.device);
        let coefficients_nm = &found.modes.coefficients_nm;
        // The same steps in other roundings, which grow with each: after some hundred, in three
        // passes, 3e-4 of an error bar is seen.
        let parts = coefficients_nm.iter().zip(wanted_nm).zip(&sigma_nm);
        let apart = parts.map(|((a, b), sigma)| (a - b).abs() / sigma).fold(0.0, f64::max);
        println!("{info}: {apart:.1e} error bars apart");
        assert!(apart < 0.02, "{info}: {apart} error bars");
    }
}

/// In focus an image does not tell an even aberration from its negative.
#[test]
#[ignore = "merge: 9 s"]
fn images_in_focus_have_a_warning_of_ambiguous_signs() {
    let scene = Scene::from_file(sky()).unwrap().with(&[("estimate.method", "full-phase")]).unwrap();
    let said = |waves: &str| {
        let scene = scene.with_override("image.diversity_focus_waves_rms", waves).unwrap();
        let images = exposures(&mut Stepper::new(&scene).unwrap(), 3);
        read(&scene, &images).unwrap().warnings.join("\n").contains("signs of these maps")
    };
    assert!(said("0.001") && !said("1.5"));
}

/// Images without telemetry have NaN for all of their slopes.
#[test]
#[ignore = "merge: 7 s"]
fn telemetry_of_some_images_is_used_for_those() {
    let scene = Scene::from_file(sky()).unwrap().with(&[("estimate.method", "full-phase")]).unwrap();
    let mut stepper = Stepper::new(&scene).unwrap();
    let all = exposures(&mut stepper, 8);
    let truth = stepper.simulator().truth();
    let with_missing = |missing: &[usize]| {
        let mut images = all.clone();
        let slopes_mas = images.slopes_mas.as_mut().unwrap();
        missing.iter().for_each(|&image| slopes_mas.row_mut(image).fill(f64::NAN));
        images
    };
    let [every, most] = [&[][..], &[1, 6]].map(|missing| read(&scene, &with_missing(missing)).unwrap());
    let said = "2 of 8 images have no telemetry";
    assert!(most.remarks.join("\n").contains(said) && !every.remarks.join("\n").contains(said));
    // Both are estimates of the same NCPA, of eight images and of six.
    for found in [&every, &most] {
        let left_nm =
            cophase::metrics::residual_nm(&found.pupil, found.maps.ncpa_nm.view(), truth.ncpa_nm.view()).unwrap();
        assert!(left_nm < 2.0 * found.figures.ncpa.sigma_nm, "{left_nm} {:?}", found.figures.ncpa);
    }
    assert!(
        most.figures.ncpa.sigma_nm > every.figures.ncpa.sigma_nm
            && most.figures.ncpa.sigma_nm < 2.0 * every.figures.ncpa.sigma_nm
    );

    let sentence = read(&scene, &with_missing(&[0, 1, 2, 3, 4, 5, 6])).map(|_| ()).unwrap_err().to_string();
    assert_facts(&sentence, "1 of 8 images | 2 or more");
    let mut odd = all.clone();
    odd.slopes_mas.as_mut().unwrap()[[3, 4]] = f64::NAN;
    let sentence = read(&scene, &odd).map(|_| ()).unwrap_err().to_string();
    assert_facts(&sentence, "slope 5 | image 4 | NaN");
}

#[test]
fn keys_of_modal_estimates_are_refused() {
    let scene = Scene::from_file(sky()).unwrap();
    for (key, value) in [
        ("estimate.optimizer", "bfgs"),
        ("estimate.optimizer", "paper"),
        ("estimate.weighting", "none"),
        ("estimate.max_evaluations", "10"),
        ("estimate.step_tolerance_nm", "0.1"),
        ("estimate.budget_nm", "1"),
        ("estimate.combine", "median"),
    ] {
        let modal = scene.with_override(key, value).unwrap();
        let sentence = modal.with_override("estimate.method", "full-phase").unwrap_err().to_string();
        assert_facts(&sentence, "estimate.method | \"full-phase\"");
        assert!(sentence.contains(key) || sentence.contains("estimate.method is"), "{sentence}");
        // The setting that causes it is named behind it.
        let asked = sentence.trim_end_matches(" (after setting estimate.method)");
        assert!(asked.ends_with("leave it out") && !sentence.contains('\n'), "{sentence}");
    }
}

/// Before any image is looked at: these are empty.
#[test]
fn a_diversity_error_outside_the_modes_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ripples.fits");
    let mut file = FitsWriter::create(&path).unwrap();
    // 24 cycles across the grid, where the modes that ten lenslets tell apart have nine zeros
    // across the pupil.
    let ripples = Array2::from_shape_fn((96, 96), |(_, x)| 1500.0 * (std::f64::consts::TAU * x as f64 / 4.0).cos());
    file.image("DIVERSITY", &ripples, Pixel::F64, "nm").unwrap();
    file.finish().unwrap();
    let path = path.display().to_string();
    let unsure = [("estimate.method", "full-phase"), ("tolerance.defocus_fraction", "0.02")];
    let ripples = [("image.diversity_focus_waves_rms", ""), ("image.diversity_file", &*path)];
    let images_e = Array3::zeros((3, 72, 80));
    for settings in [&ripples[..], &[("image.diversity_focus_waves_rms", "0")]] {
        let scene = Scene::from_file(sky()).unwrap().with(&[settings, &unsure].concat()).unwrap();
        match read(&scene, &Images::new(images_e.clone())).map(|_| ()) {
            Err(Error::Scene(sentence)) => {
                assert_facts(&sentence, "tolerance.defocus_fraction = 0.02 | modes | hold a focus");
            }
            other => panic!("{other:?}"),
        }
    }
}

/// Segments with tilts of 60 nm, twice what the turbulence of eight short exposures hides: pistons
/// alone, the default, which adds tilts to the model, and a scene with tilts.
#[test]
#[ignore = "merge: 9 s"]
fn tilts_of_segments_are_estimated_and_corrected() {
    let settings = [("estimate.method", "full-phase"), ("aberrations.segment_tip_tilt_rms_nm", "60")];
    let auto = Scene::from_file(sky()).unwrap().with(&settings).unwrap();
    let pistons = auto.with_override("estimate.model", "scene").unwrap();
    let tilts = pistons.with_override("modes.segment", "piston-tip-tilt").unwrap();
    let mut stepper = Stepper::new(&auto).unwrap();
    let images = exposures(&mut stepper, 8);
    let [pistons, auto, tilts] = [pistons, auto, tilts].map(|scene| read(&scene, &images).unwrap());
    let truth = stepper.simulator().truth();
    let rms_nm = |map: ArrayView2<f64>, pupil: &cophase::pupil::Pupil| {
        pupil.rms(pupil.remove_piston_tip_tilt(map).unwrap().view()).unwrap()
    };
    let left_nm = |found: &Estimate| rms_nm((&found.maps.phasing_nm - &truth.phasing_nm).view(), &found.pupil);
    // 67 nm left with pistons alone; 35 (added) and 38 nm (from the start) with tilts, of error
    // bars of 29 and 34 nm: the mirror removes most of what so few segments have in common, and the
    // common figure in the model hides a part of the rest (29 and 35 nm without one).
    assert!(left_nm(&auto) < 0.6 * left_nm(&pistons) && left_nm(&tilts) < 0.6 * left_nm(&pistons));
    assert!(left_nm(&auto) < 2.0 * auto.figures.phasing.sigma_nm, "{:?}", auto.figures.phasing);

    let is_seen = |found: &Estimate| found.warnings.join("\n").contains("segments seem to be tilted");
    let is_said = |found: &Estimate| found.report().contains("extended by tip and tilt of each segment");
    assert_eq!(
        [&pistons, &auto, &tilts].map(|found| (is_seen(found), is_said(found))),
        [(true, false), (false, true), (false, false)]
    );
    let modes = |found: &Estimate| (found.segment_modes(), found.scene.modes.segment);
    let [few, many] = [(7, scene::SegmentModes::Piston), (21, scene::SegmentModes::PistonTipTilt)];
    assert_eq!([&pistons, &auto, &tilts].map(modes), [few, many, many]);
    assert_eq!(auto.basis.names.len(), auto.modes.covariance_nm2.nrows());
    assert_eq!((&*auto.basis.names[7], &*auto.basis.names[20]), ("segment-00-tip", "segment-06-tilt"));

    // What the corrections leave of the segments is what the estimate leaves, and what is below its
    // error bar.
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("corrections.fits");
    let commands = auto.corrections(None).unwrap();
    commands.write(&path).unwrap();
    let mut file = FitsReader::open(&path).unwrap();
    let column = |file: &mut FitsReader, name: &str| file.f64_column("SEGMENTS", name).unwrap();
    let added = ["ADD_NM", "ADD_TIP_NM", "ADD_TILT_NM"].map(|name| column(&mut file, name));
    assert_eq!(added[1..].concat(), commands.tilts_nm);
    let maps = SegmentModes::PistonTipTilt.maps(&auto.pupil).unwrap().maps();
    let left = added
        .concat()
        .iter()
        .zip(maps.outer_iter())
        .fold(truth.phasing_nm.clone(), |left, (nm, map)| left + &(&map * *nm));
    let (before_nm, after_nm) = (rms_nm(truth.phasing_nm.view(), &auto.pupil), rms_nm(left.view(), &auto.pupil));
    assert!(after_nm < 0.5 * before_nm);
    assert_eq!(pistons.corrections(None).unwrap().tilts_nm.len(), 0);
    // Segments without any mode are no part of a MAP estimate.
    let none =
        Scene::from_file(sky()).unwrap().with(&[("estimate.method", "full-phase"), ("modes.segment", "none")]).unwrap();
    let sentence = read(&none, &images).map(|_| ()).unwrap_err().to_string();
    assert_facts(&sentence, "\"piston\" or \"piston-tip-tilt\"");
}

#[test]
#[ignore = "merge: 5 s"]
fn corrections_reduce_the_true_errors() {
    // Maps on the samples of the wavefront sensor.
    let settings = [("pupil.samples", "80"), ("estimate.method", "full-phase")];
    let scene = Scene::from_file(sky()).unwrap().with(&settings).unwrap();
    let mut stepper = Stepper::new(&scene).unwrap();
    let images = exposures(&mut stepper, 6);
    let found = read(&scene, &images).unwrap();
    let commands = found.corrections(None).unwrap();
    let simulator = stepper.simulator();
    let (truth, pupil) = (simulator.truth(), simulator.pupil());

    // With the wrong sign or in the wrong order twice as much, or 1.4 times, would be left and not
    // less than half. The plane through the pistons stays.
    let shown = |pistons_nm: &[f64]| {
        let owner = pupil.owner.mapv(|owner| if owner < 0 { f64::NAN } else { pistons_nm[owner as usize] });
        pupil.rms(pupil.remove_piston_tip_tilt(owner.view()).unwrap().view()).unwrap()
    };
    let left: Vec<f64> = truth.piston_nm.iter().zip(&commands.pistons_nm).map(|(nm, add)| nm + add).collect();
    println!("pistons of {:.1} nm, {:.1} left", shown(&truth.piston_nm), shown(&left));
    assert!(shown(&left) < 0.5 * shown(&truth.piston_nm));

    let influence = simulator.influence();
    let (places, moves): (Vec<[f64; 2]>, Vec<f64>) = commands.actuators_nm.iter().copied().unzip();
    assert!(places.iter().zip(influence.positions_m()).all(|(place, (x_m, y_m))| *place == [x_m, y_m]));
    let samples = Samples::from_pupil(pupil).unwrap();
    let shapes = influence.evaluate(&samples.xs_m, &samples.ys_m).unwrap();
    let surface_nm = ArrayView1::from(&moves).dot(&shapes);
    let map = |at: &dyn Fn(usize, usize) -> f64| {
        let mut map = Array2::from_elem(pupil.amplitude.dim(), f64::NAN);
        let n = map.ncols();
        samples.indices.iter().enumerate().for_each(|(i, &place)| map[[place / n, place % n]] = at(i, place));
        map
    };
    let ncpa_nm = truth.ncpa_nm.as_slice().unwrap();
    let rms_nm = |map: ArrayView2<f64>| pupil.rms(pupil.remove_piston_tip_tilt(map).unwrap().view()).unwrap();
    // The mirror's surface is taken off the wavefront.
    let before_nm = rms_nm(map(&|_, place| ncpa_nm[place]).view());
    let after_nm = rms_nm(map(&|i, place| ncpa_nm[place] - surface_nm[i]).view());
    println!("NCPA of {before_nm:.1} nm, {after_nm:.1} left");
    assert!(after_nm < 0.5 * before_nm);

    // The loop puts nearly the same shape on its mirror when the reference slopes are sent to it,
    // behind turbulence that blurs the spots: twice as much where they are those of sharp spots,
    // which would leave all of the NCPA.
    let sent = SentCorrections::system(&[SentCorrections::from(&commands)], &scene).unwrap();
    let left_nm = rms_nm(sent.truth().ncpa_nm.view());
    println!("NCPA of {before_nm:.1} nm, {left_nm:.1} left by the loop");
    assert!(left_nm < 0.5 * before_nm);
}

//! Channels behind adaptive optics: simulated in one run of the loop, written, read, and estimated
//! together.

use crate::common::assert_facts;
use crate::consistency::shown;
use crate::full_phase::sky;
use cophase::ao::{self, Shot, Simulator};
use cophase::pipeline::{Estimate, Estimator, Images};
use cophase::scene::{AoKnowledge, Scene};
use cophase::{Control, Status};
use std::path::Path;

const PAIR: &str =
    "[[image.channel]]\nname = \"plus\"\n[[image.channel]]\nname = \"minus\"\ndiversity_focus_waves_rms = -1.0\n";
const COLOURS: &str = "[[image.channel]]\nname = \"K\"\n[[image.channel]]\nname = \"H\"\nwavelength_nm = 1640.0\n";

/// The small telescope behind its loop, with `channels`, each of eight images.
fn scene(channels: &str, settings: &[(&str, &str)]) -> Scene {
    let text = std::fs::read_to_string(sky()).unwrap();
    let text = text.replacen("[aberrations]", &format!("{channels}\n[aberrations]"), 1);
    let own = [("estimate.method", "full-phase"), ("estimate.device", "cpu"), ("image.count", "8")];
    Scene::from_text(&text, Path::new("")).unwrap().with(&[&own, settings].concat()).unwrap()
}

/// The images of each channel, as a file has them.
fn simulated(scene: &Scene) -> Vec<Images> {
    let mut simulator = Simulator::new(scene).unwrap();
    let mut shots: Vec<Shot> = Vec::new();
    let summary = simulator.run(&mut shots, &Control::default()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("sky.fits");
    ao::write(&path, scene.text(), &simulator, &shots, &summary).unwrap();
    Images::read(&path, None).unwrap()
}

fn estimate(scene: &Scene, images: &[Images]) -> Estimate {
    shown(Estimator::new(scene).unwrap().estimate(images).unwrap())
}

/// Whether the residuals are within three error bars.
fn is_right(found: &Estimate) -> bool {
    let residual = &found.truth.as_ref().unwrap().1;
    residual.rms_nm[0] < 3.0 * found.figures.phasing.sigma_nm && residual.rms_nm[1] < 3.0 * found.figures.ncpa.sigma_nm
}

#[test]
#[ignore = "merge: 11 s"]
fn successive_channels_are_one_sequence() {
    let scene = scene(PAIR, &[]);
    let images = simulated(&scene);
    let found = estimate(&scene, &images);
    assert_eq!(found.status, Status::Ok);
    assert!(is_right(&found), "{:?}", found.warnings);
    assert_eq!(found.channels, ["plus", "minus"]);
    let channels: Vec<usize> = found.images.iter().map(|image| image.channel).collect();
    assert_eq!(channels, [[0; 8], [1; 8]].concat());
    let map = found.full_phase().unwrap();
    assert_eq!(map.ao_knowledge, AoKnowledge::Telemetry);
    // Turbulence averages over twice the images: 1/√2, and the noise of an estimate of the scatter
    // from eight images.
    let one = Estimator::new(&scene.channels()[0].scene).unwrap().estimate(&images[0]).unwrap();
    let ratio = found.figures.phasing.sigma_nm / one.figures.phasing.sigma_nm;
    assert!((0.55..0.9).contains(&ratio), "{ratio}");
    let [plus, minus] = images.try_into().unwrap();
    let swapped = Estimator::new(&scene).unwrap().estimate(&[minus, plus]).unwrap();
    assert_eq!(swapped.modes.coefficients_nm, found.modes.coefficients_nm);
}

#[test]
#[ignore = "merge: 7 s"]
fn simultaneous_channels_are_averaged_in_each_exposure() {
    let scene = scene(PAIR, &[("image.simultaneous", "true")]);
    let images = simulated(&scene);
    // One loop, one moment: the same slopes.
    assert_eq!(images[0].slopes_mas, images[1].slopes_mas);
    let found = estimate(&scene, &images);
    assert_eq!(found.status, Status::Ok);
    assert!(is_right(&found), "{:?}", found.warnings);
    assert_eq!(found.images.len(), 16);
    let iterations = &found.full_phase().unwrap().iterations;
    assert_eq!(iterations.last().unwrap().used_images, (0..8).collect::<Vec<_>>());
    // The second image of an exposure has its turbulence, too, and averages none of it.
    let one = Estimator::new(&scene.channels()[0].scene).unwrap().estimate(&images[0]).unwrap();
    let ratio = found.figures.phasing.sigma_nm / one.figures.phasing.sigma_nm;
    assert!((0.7..1.2).contains(&ratio), "{ratio}");
    let mut fewer = images.clone();
    let seven = images[1].images_e.slice(ndarray::s![..7, .., ..]).to_owned();
    fewer[1] = Images { channel: images[1].channel.clone(), ..Images::new(seven).in_electrons() };
    let refused = Estimator::new(&scene).unwrap().estimate(&fewer).unwrap_err().to_string();
    assert_facts(&refused, "[8, 7] images");
}

/// Pistons of 1,500 nm RMS, more than half of either wavelength, to whose whole wavelengths the
/// loop does not respond.
#[test]
#[ignore = "merge: 6 s"]
fn two_colours_resolve_whole_wavelengths_behind_ao() {
    let settings = [("aberrations.segment_piston_rms_nm", "1500"), ("modes.piston_range_nm", "10000")];
    let scene = scene(COLOURS, &settings);
    let found = estimate(&scene, &simulated(&scene));
    assert_eq!((found.integers.len(), found.status), (7, Status::Ok));
    assert!(found.integers.iter().all(|integer| integer.probability > 0.99), "{:?}", found.integers);
    assert!(found.integers.iter().any(|integer| integer.integer != found.integers[0].integer));
    assert!(is_right(&found), "{:?}", found.warnings);
}

#[test]
fn in_focus_channels_and_partial_slopes_are_left_out() {
    let focus = "[[image.channel]]\nname = \"focus\"\ndiversity_focus_waves_rms = 0.0\n";
    let scene = scene(&format!("{PAIR}{focus}"), &[("image.count", "4")]);
    let mut images = simulated(&scene);
    images[1].slopes_mas = None;
    let found = estimate(&scene, &images);
    assert_eq!((found.channels.len(), found.images.len()), (2, 8));
    assert_eq!(found.full_phase().unwrap().ao_knowledge, AoKnowledge::Loop);
    for part in ["channel focus: it is in focus", "some channels have slopes"] {
        assert!(found.warnings.iter().any(|warning| warning.contains(part)), "{part}: {:?}", found.warnings);
    }
    assert!(is_right(&found), "{:?}", found.warnings);
}

#[test]
#[ignore = "merge: 3 s"]
fn auto_chooses_by_the_images_of_each_channel() {
    let auto = scene(PAIR, &[("estimate.method", "auto"), ("image.count", "3")]);
    let found = estimate(&auto, &simulated(&auto));
    assert!(found.full_phase().is_some());
    assert!(found.remarks.iter().any(|remark| remark.contains("chose \"full-phase\"")), "{:?}", found.remarks);
}

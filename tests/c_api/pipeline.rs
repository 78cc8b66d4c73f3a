//! The whole pipeline in other languages prints what Rust finds: coefficients to the last bit,
//! statuses, warnings, policy, device.

use super::here;
use cophase::Control;
use cophase::ao::{Shot, Simulator};
use cophase::pipeline::{Estimate, Estimator, Figures, Images};
use cophase::scene::{AoKnowledge, Scene};
use ndarray::{Array1, Array2, Array3, Axis, concatenate, stack};
use std::path::Path;
use std::process::Command;

/// Images of the scene's artificial source, with a bad pixel in the first, and a hot one in the
/// second: an outlier.
fn images(scene: &Scene) -> Images {
    let mut images_e: Array3<f64> = Images::simulated(scene).unwrap().remove(0).images_e;
    images_e[[0, 20, 21]] = f64::NAN;
    images_e[[1, 24, 20]] += 2e5;
    Images::new(images_e)
}

/// Lines that a program prints of `estimate`, its numbers as bits; see `pipeline.c`.
fn expected(estimate: &Estimate) -> Vec<String> {
    let sigma_nm = estimate.modes.sigma_nm();
    let coefficients = estimate.basis.names.iter().zip(&estimate.modes.coefficients_nm).zip(&sigma_nm);
    let mut lines: Vec<String> =
        coefficients.map(|((name, nm), sigma)| format!("coefficient {name} {} {}", bits(*nm), bits(*sigma))).collect();
    for (index, image) in estimate.images.iter().enumerate() {
        let status = image.report.status.word().to_uppercase().replace('-', "_");
        let (chi2, rejected, channel) = (bits(image.report.reduced_chi2), image.report.rejected.total(), image.channel);
        lines.push(format!("image {index} {status} {chi2} {rejected} {channel}"));
    }
    lines.extend(estimate.channels.iter().map(|name| format!("channel {name}")));
    let integers = estimate.integers.iter();
    lines.extend(
        integers.map(|one| format!("integer {} {} {}", one.integer, bits(one.probability), bits(one.runner_up_nm))),
    );
    lines.extend(estimate.model_errors.iter().map(|error| {
        let numbers = [error.value, error.sigma, error.tolerance, error.significance].map(bits).join(" ");
        format!("error {} {numbers}", error.name)
    }));
    if let Some(without) = &estimate.without_staircases {
        let Figures { phasing, ncpa, wavefront } = without.figures;
        let figures = [("phasing", phasing), ("ncpa", ncpa), ("wavefront", wavefront)];
        lines.extend(figures.map(|(name, one)| format!("without {name} {} {}", bits(one.rms_nm), bits(one.sigma_nm))));
        let (maps, sigma) = (&without.maps, &without.sigma_maps);
        let at = [maps.phasing_nm.nrows() / 2, maps.phasing_nm.ncols() / 4];
        let maps = [&maps.phasing_nm, &maps.ncpa_nm, &sigma.phasing_nm, &sigma.ncpa_nm];
        lines.push(format!("without {}", maps.map(|map| bits(map[at])).join(" ")));
    }
    lines.extend(estimate.warnings.iter().map(|warning| format!("warning {warning}")));
    lines.extend([format!("policy {}", estimate.policy.name()), format!("device {}", estimate.run.device)]);
    lines
}

pub(super) fn bits(value: f64) -> String {
    format!("{:016x}", value.to_bits())
}

/// The scene in two colours.
pub(super) const COLOURS: &str =
    "[[image.channel]]\nname = \"K\"\n[[image.channel]]\nname = \"H\"\nwavelength_nm = 1640.0\n";

/// Runs a program on images of `tiny.toml` with outliers, on images of two colours, and on
/// exposures of two channels behind a loop, and compares what it prints with the estimates of Rust.
pub(super) fn prints_what_rust_finds(command: impl Fn() -> Option<Command>) {
    if let Some(command) = command() {
        images_of_one_channel(command);
    }
    if let Some(command) = command() {
        images_of_tilted_segments(command);
    }
    if let Some(command) = command() {
        images_of_two_channels(command);
    }
    if let Some(command) = command() {
        exposures_of_two_channels(command);
    }
}

fn exposures_of_two_channels(command: Command) {
    let settings = [("estimate.method", "full-phase"), ("estimate.device", "cpu"), ("image.count", "2")];
    let scene = Scene::from_file(here().join("sky.toml")).unwrap().with(&settings).unwrap();
    let defocus = COLOURS.replace("wavelength_nm = 1640.0", "diversity_focus_waves_rms = -1.0");
    let scene = Scene::from_text(&format!("{}\n{defocus}", scene.text()), Path::new("")).unwrap();
    let mut shots: Vec<Shot> = Vec::new();
    Simulator::new(&scene).unwrap().run(&mut shots, &Control::default()).unwrap();
    let of = |channel: usize| -> Vec<&Shot> { shots.iter().filter(|shot| shot.channel == channel).collect() };
    let images = ["K", "H"].iter().enumerate().map(|(number, name)| {
        let views: Vec<_> = of(number).iter().map(|shot| shot.image_e.mapv(f64::from)).collect();
        let images_e = stack(Axis(0), &views.iter().map(|image| image.view()).collect::<Vec<_>>()).unwrap();
        let slopes: Vec<Array1<f64>> =
            of(number).iter().map(|shot| shot.mean_slopes_mas.iter().map(|&mas| f64::from(mas)).collect()).collect();
        let slopes_mas = stack(Axis(0), &slopes.iter().map(|slopes| slopes.view()).collect::<Vec<_>>()).unwrap();
        Images { channel: Some((*name).into()), slopes_mas: Some(slopes_mas), ..Images::new(images_e) }
    });
    let images: Vec<Images> = images.collect();
    let found = Estimator::new(&scene).unwrap().estimate(&images).unwrap();
    assert_eq!(found.full_phase().unwrap().ao_knowledge, AoKnowledge::Telemetry);
    let cube = concatenate(Axis(0), &images.iter().map(|one| one.images_e.view()).collect::<Vec<_>>()).unwrap();
    let slopes: Vec<_> = images.iter().filter_map(|one| one.slopes_mas.as_ref()).map(|one| one.view()).collect();
    let slopes_mas = concatenate(Axis(0), &slopes).unwrap();
    compare(command, &scene, (&cube, 2), (Some(&slopes_mas), Some("K,H")), &found);
}

fn images_of_two_channels(command: Command) {
    let settings = [("image.peak_snr", "300"), ("aberrations.segment_piston_rms_nm", "1000")];
    let scene = Scene::from_file(here().join("tiny.toml")).unwrap().with(&settings).unwrap();
    let scene = Scene::from_text(&format!("{}\n{COLOURS}", scene.text()), Path::new("")).unwrap();
    let mut images = Images::simulated(&scene).unwrap();
    // In another order than the scene's: they are named.
    images.reverse();
    let images: Vec<Images> =
        images.into_iter().map(|one| Images { channel: one.channel, ..Images::new(one.images_e) }).collect();
    let cube = concatenate(Axis(0), &images.iter().map(|one| one.images_e.view()).collect::<Vec<_>>()).unwrap();
    let found = Estimator::new(&scene).unwrap().estimate(&images).unwrap();
    assert_eq!(
        (found.channels.as_slice(), found.integers.len()),
        (&["K".to_string(), "H".into()][..], found.segment_modes())
    );
    compare(command, &scene, (&cube, 1), (None, Some("H,K")), &found);
}

/// Segments whose figures are not known well, so that a tolerance divides them from staircases.
fn images_of_tilted_segments(command: Command) {
    let settings = [
        ("modes.segment", "piston-tip-tilt"),
        ("aberrations.segment_piston_rms_nm", "60"),
        ("aberrations.segment_tip_tilt_rms_nm", "20"),
        ("tolerance.common_figure_nm", "50"),
    ];
    let scene = Scene::from_file(here().join("tiny.toml")).unwrap().with(&settings).unwrap();
    let images_e = Images::simulated(&scene).unwrap().remove(0).images_e;
    let found = Estimator::new(&scene).unwrap().estimate(&Images::new(images_e.clone())).unwrap();
    assert!(found.without_staircases.is_some() && found.model_errors.len() > 5, "{:?}", found.model_errors);
    compare(command, &scene, (&images_e, 1), (None, None), &found);
}

fn images_of_one_channel(command: Command) {
    let settings = [("image.count", "3"), ("image.peak_snr", "300"), ("aberrations.segment_piston_rms_nm", "50")];
    let scene = Scene::from_file(here().join("tiny.toml")).unwrap().with(&settings).unwrap();
    let images = images(&scene);
    let found =
        Estimator::new(&Scene::from_text(scene.text(), Path::new("")).unwrap()).unwrap().estimate(&images).unwrap();
    assert_eq!(found.images[1].report.rejected.total(), 1, "the hot pixel");
    assert!(found.warnings.iter().any(|warning| warning.starts_with("1 pixel is not finite")), "{:?}", found.warnings);
    compare(command, &scene, (&images.images_e, 3), (None, None), &found);
}

/// Runs a program on a cube with `count` images of each of `channels`, and their slopes, and
/// compares what it prints with an estimate.
fn compare(
    mut command: Command,
    scene: &Scene,
    (cube, count): (&Array3<f64>, usize),
    (slopes_mas, channels): (Option<&Array2<f64>>, Option<&str>),
    found: &Estimate,
) {
    let directory = tempfile::tempdir().unwrap();
    let [toml, raw, slopes] = ["scene.toml", "frames.raw", "slopes.raw"].map(|name| directory.path().join(name));
    std::fs::write(&toml, scene.text()).unwrap();
    std::fs::write(&raw, cube.iter().flat_map(|e| e.to_ne_bytes()).collect::<Vec<u8>>()).unwrap();
    if let Some(slopes_mas) = slopes_mas {
        std::fs::write(&slopes, slopes_mas.iter().flat_map(|mas| mas.to_ne_bytes()).collect::<Vec<u8>>()).unwrap();
    }
    let telemetry = slopes_mas.map(|slopes_mas| [slopes.display().to_string(), slopes_mas.ncols().to_string()]);
    let (_, rows, cols) = cube.dim();
    let output = command
        .arg(&toml)
        .arg(&raw)
        .args([count, rows, cols].map(|extent| extent.to_string()))
        .args(telemetry.iter().flatten())
        .args(channels)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}\n{said}", output.status);
    let printed = String::from_utf8(output.stdout).unwrap();
    if std::env::var_os("COPHASE_C_RUNNER").is_none_or(|runner| runner.is_empty()) {
        assert_eq!(printed.lines().collect::<Vec<_>>(), expected(found));
    } else {
        // valgrind's processor rounds otherwise: see `fits::same`.
        assert_eq!(printed.lines().count(), expected(found).len());
    }
}

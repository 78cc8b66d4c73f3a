//! Sessions of several channels in other languages print what Rust finds, to the last bit.

use super::here;
use super::pipeline::{COLOURS, bits};
use cophase::imaging::Choice;
use cophase::modal::{ChannelFitters, FitOptions, Session, SessionOptions};
use cophase::pipeline::Images;
use cophase::scene::Scene;
use ndarray::s;
use std::path::Path;
use std::process::Command;

/// The small scene in two colours with the given pistons.
fn scene(pistons_nm: &str) -> Scene {
    let settings = [("image.peak_snr", "300"), ("aberrations.segment_piston_rms_nm", pistons_nm)];
    let scene = Scene::from_file(here().join("tiny.toml")).unwrap().with(&settings).unwrap();
    Scene::from_text(&format!("{}\n{COLOURS}", scene.text()), Path::new("")).unwrap()
}

/// Runs a program on a frame of each colour: of pistons within half a wavelength, and beyond, where
/// the colours contradict each other.
pub(super) fn prints_what_rust_finds(command: impl Fn() -> Option<Command>) {
    for pistons_nm in ["60", "1000"] {
        if let Some(command) = command() {
            compare(command, &scene(pistons_nm), pistons_nm == "1000");
        }
    }
}

fn compare(mut command: Command, scene: &Scene, is_contradictory: bool) {
    let images = Images::simulated(scene).unwrap();
    let directory = tempfile::tempdir().unwrap();
    let [toml, raw] = ["scene.toml", "frames.raw"].map(|name| directory.path().join(name));
    std::fs::write(&toml, scene.text()).unwrap();
    let frames = images.iter().flat_map(|one| one.images_e.slice(s![0, .., ..]).to_owned());
    std::fs::write(&raw, frames.flat_map(f64::to_ne_bytes).collect::<Vec<u8>>()).unwrap();
    let expected = expected(scene, &images);
    assert_eq!(expected.iter().any(|line| line.starts_with("warning the channels contradict")), is_contradictory);
    let output = command.arg(&toml).arg(&raw).args(["48", "48"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}\n{said}", output.status);
    let printed = String::from_utf8(output.stdout).unwrap();
    if std::env::var_os("COPHASE_C_RUNNER").is_none_or(|runner| runner.is_empty()) {
        assert_eq!(printed.lines().collect::<Vec<_>>(), expected);
    } else {
        // valgrind's processor rounds otherwise: see `fits::same`.
        assert!(printed.starts_with("channel K\n"), "{printed}");
    }
}

/// Lines that a program prints; see `session_channels.c`.
fn expected(scene: &Scene, images: &[Images]) -> Vec<String> {
    let options = SessionOptions { device: Some(Choice::Cpu), ..SessionOptions::default() };
    let mut session = Session::new(ChannelFitters::new(scene, false).unwrap(), &options).unwrap();
    for (channel, images) in images.iter().enumerate() {
        session.frame_mut(0, channel).unwrap().0.assign(&images.images_e.slice(s![0, .., ..]));
    }
    session.fit(1, &FitOptions::default()).unwrap();
    let names = session.fitters().first().model().basis.names().to_vec();
    let (fit, refined) = (&session.results()[0], session.refine(0).unwrap());
    let mut lines: Vec<String> =
        session.channels().iter().map(|channel| format!("channel {}", channel.name())).collect();
    let pairs = fit.coefficients_nm.iter().zip(&fit.sigma_nm);
    lines.extend(
        names.iter().zip(pairs).map(|(name, (nm, sigma))| format!("coefficient {name} {} {}", bits(*nm), bits(*sigma))),
    );
    let word = |status: &cophase::modal::Status| status.word().to_uppercase().replace('-', "_");
    lines.extend(session.channels().iter().enumerate().map(|(channel, fits)| {
        let report = &fits.results()[0].report;
        format!("image {channel} {} {} 1 {channel}", word(&report.status), bits(report.reduced_chi2))
    }));
    let joint = |is_contradictory: bool, (chi2, freedom): (f64, f64)| {
        format!("joint {} {} {} {}", word(&fit.status), i32::from(is_contradictory), bits(chi2), bits(freedom))
    };
    lines.push(joint(fit.is_contradictory, fit.disagreement));
    lines.extend(session.warnings().iter().map(|warning| format!("warning {warning}")));
    let variances = refined.modes.coefficients_nm.iter().zip(refined.modes.covariance_nm2.diag().to_vec());
    lines.extend(
        names.iter().zip(variances).map(|(name, (nm, nm2))| format!("refined {name} {} {}", bits(*nm), bits(nm2))),
    );
    let probability = refined.integers.iter().map(|one| one.probability).fold(f64::NAN, f64::min);
    lines.push(format!("{} {}", joint(refined.is_contradictory, refined.disagreement), bits(probability)));
    lines.push(format!("policy {}", session.policy().name()));
    lines
}

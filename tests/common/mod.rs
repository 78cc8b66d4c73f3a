//! Shared by the integration tests.
#![allow(dead_code)] // each test binary uses its part

use cophase::device::{self, Choice};
use cophase::imaging::{Chain, Precision};
use cophase::modal::ModalFitter;
use cophase::pipeline::Images;
use cophase::scene::Scene;
use cophase::source::{self, SourceImages};
use std::path::Path;

/// Every chain that this machine has for an estimator's model, with its name. OpenCL may be absent
/// on a user's machine; where `COPHASE_REQUIRE_OPENCL=1` (as in CI) its absence is a failure.
pub fn chains(estimator: &ModalFitter, capacity: usize) -> Vec<(String, Chain)> {
    let optics = || estimator.model().optics.clone();
    let mut chains = vec![
        ("CPU f64".to_string(), Chain::cpu(optics(), Precision::F64)),
        ("CPU f32".to_string(), Chain::cpu(optics(), Precision::F32)),
    ];
    let devices = device::devices().unwrap_or_default();
    if devices.is_empty() {
        assert!(std::env::var_os("COPHASE_REQUIRE_OPENCL").is_none_or(|v| v != "1"), "no OpenCL device is here");
        println!("skipped on OpenCL: {}", device::advice(&devices).unwrap_or_default());
    }
    for info in &devices {
        for precision in [Precision::F64, Precision::F32].into_iter().filter(|&p| info.supports(p)) {
            let choice = Choice::OpenClAt(info.platform, info.device);
            let chain = Chain::open(optics(), choice, precision, capacity).expect("a device that is listed opens");
            chains.push((format!("{} {precision}", info.address()), chain));
        }
    }
    chains
}

/// Simulated images of a scene without channels.
pub fn simulated(scene: &Scene) -> Images {
    Images::only(Images::simulated(scene).unwrap()).unwrap()
}

/// As [`simulated`], with flux and aberrations.
pub fn source_images(scene: &Scene) -> SourceImages {
    source::simulate(scene).unwrap().remove(0)
}

/// The images of a file of one channel.
pub fn images_of(path: impl AsRef<Path>, mask: Option<&Path>) -> Images {
    Images::only(Images::read(path, mask).unwrap()).unwrap()
}

/// Checks that a message has each of `facts`, which " | " separates: keys, values, ranges, the next
/// command. The rest of its sentence may change.
#[track_caller]
pub fn assert_facts(message: &str, facts: &str) {
    let missing: Vec<&str> = facts.split(" | ").filter(|fact| !message.contains(fact)).collect();
    assert!(missing.is_empty(), "{missing:?} missing in: {message}");
}

/// ‖a − b‖ / ‖b‖.
pub fn relative_difference(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let difference: f64 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
    let norm: f64 = b.iter().map(|b| b * b).sum();
    (difference / norm).sqrt()
}

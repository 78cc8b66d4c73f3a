//! The whole pipeline in C prints what Rust finds: coefficients to the last bit, statuses, warnings, policy, device.

use super::{command, compile, here, succeeded};
use cophase::pipeline::{Estimate, Estimator, Images};
use cophase::scene::Scene;
use ndarray::Array3;
use std::path::Path;

/// Images of the scene's artificial source, with a bad pixel in the first, and a hot one in the second: an outlier.
fn images(scene: &Scene) -> Images {
    let mut images_e: Array3<f64> = Images::simulated(scene).unwrap().images_e;
    images_e[[0, 20, 21]] = f64::NAN;
    images_e[[1, 24, 20]] += 2e5;
    Images::new(images_e)
}

/// What the program prints of `estimate`, its numbers as the bits that a hexadecimal float stands for.
fn expected(estimate: &Estimate) -> Vec<String> {
    let sigma_nm = estimate.sigma_nm();
    let coefficients = estimate.basis.names.iter().zip(&estimate.coefficients_nm).zip(&sigma_nm);
    let mut lines: Vec<String> =
        coefficients.map(|((name, nm), sigma)| format!("coefficient {name} {} {}", bits(*nm), bits(*sigma))).collect();
    for (index, image) in estimate.images.iter().enumerate() {
        let status = image.status.word().to_uppercase().replace('-', "_");
        lines.push(format!("image {index} {status} {} {}", bits(image.reduced_chi2), image.rejected_pixels));
    }
    lines.extend(estimate.warnings.iter().map(|warning| format!("warning {warning}")));
    lines.extend([format!("policy {}", estimate.policy.name()), format!("device {}", estimate.device)]);
    lines
}

fn bits(value: f64) -> String {
    format!("{:016x}", value.to_bits())
}

/// A line with its hexadecimal floats as bits.
fn as_bits(line: &str) -> String {
    if !line.starts_with("coefficient ") && !line.starts_with("image ") {
        return line.into();
    }
    line.split(' ').map(|word| from_hexadecimal(word).map_or(word.to_string(), bits)).collect::<Vec<_>>().join(" ")
}

/// The value of C's `%a`: `-0x1.8p+3`.
fn from_hexadecimal(word: &str) -> Option<f64> {
    let (sign, digits) = word.strip_prefix('-').map_or((1.0, word), |rest| (-1.0, rest));
    let (mantissa, exponent) = digits.strip_prefix("0x")?.split_once('p')?;
    let (whole, fraction) = mantissa.split_once('.').unwrap_or((mantissa, ""));
    let digits = u64::from_str_radix(&format!("{whole}{fraction}"), 16).ok()?;
    let exponent: i32 = exponent.parse().ok()?;
    Some(sign * digits as f64 * 2f64.powi(exponent - 4 * fraction.len() as i32))
}

#[test]
fn hexadecimal_floats_are_read() {
    assert_eq!(from_hexadecimal("-0x1.8p+3"), Some(-12.0));
    assert_eq!(from_hexadecimal("0x1p-2"), Some(0.25));
    assert_eq!(from_hexadecimal("0"), None);
}

#[test]
fn the_pipeline_prints_what_rust_finds() {
    let directory = tempfile::tempdir().unwrap();
    let settings = [("image.count", "3"), ("image.peak_snr", "300"), ("aberrations.segment_piston_rms_nm", "50")];
    let scene = Scene::from_file(here().join("tiny.toml")).unwrap().with(&settings).unwrap();
    let images = images(&scene);
    let [toml, raw] = ["scene.toml", "frames.raw"].map(|name| directory.path().join(name));
    std::fs::write(&toml, scene.text()).unwrap();
    std::fs::write(&raw, images.images_e.iter().flat_map(|e| e.to_ne_bytes()).collect::<Vec<u8>>()).unwrap();
    let (count, rows, cols) = images.images_e.dim();
    let program = compile("-std=c99", &here().join("pipeline.c"), directory.path());
    let mut command = command(&program);
    command.arg(&toml).arg(&raw).args([count, rows, cols].map(|extent| extent.to_string()));
    let printed = String::from_utf8(succeeded(&mut command).stdout).unwrap();
    let found =
        Estimator::new(&Scene::from_text(scene.text(), Path::new("")).unwrap()).unwrap().estimate(&images).unwrap();
    assert_eq!(found.images[1].rejected_pixels, 1, "the hot pixel");
    assert!(found.warnings.iter().any(|warning| warning.starts_with("1 pixel is not finite")), "{:?}", found.warnings);
    if super::words("COPHASE_C_RUNNER").is_empty() {
        assert_eq!(printed.lines().map(as_bits).collect::<Vec<_>>(), expected(&found));
    } else {
        // valgrind's processor rounds otherwise: see `fits::same`.
        assert_eq!(printed.lines().count(), expected(&found).len());
    }
}

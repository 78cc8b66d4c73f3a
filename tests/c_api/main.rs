//! The simulator from C, Python and Octave, and all else from C (`c`). Each program of the
//! simulator provokes what can go wrong, then dumps what it shows after some frames; the dump must
//! be what Rust sees, to the last bit.
//!
//! Where a language is not installed its test says so and passes, unless `COPHASE_REQUIRE_PYTHON=1`
//! or `COPHASE_REQUIRE_OCTAVE=1`, which `scripts/test` sets where it is, and in CI.

mod c;

use cophase::ao::Stepper;
use cophase::scene::Scene;
use libraries::libraries;
use ndarray::Array2;
use std::path::{Path, PathBuf};
use std::process::Command;

mod fits;
#[path = "../common/libraries.rs"]
mod libraries;
mod octave;
mod pipeline;
mod python;
mod session_channels;
mod sky;

/// Enough for the loop to have closed.
const FRAMES: u64 = 300;

fn here() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/c_api")
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn library() -> PathBuf {
    libraries().join(format!("{}cophase{}", std::env::consts::DLL_PREFIX, std::env::consts::DLL_SUFFIX))
}

fn stepper() -> Stepper {
    let scene = Scene::from_text(&std::fs::read_to_string(here().join("small.toml")).unwrap(), Path::new("")).unwrap();
    let mut stepper = Stepper::new(&scene).unwrap();
    stepper.step(FRAMES).unwrap();
    stepper
}

/// What the programs must dump: slopes, commands, residual, image, phasing, NCPA, each in C order.
fn expected() -> Vec<u32> {
    let mut stepper = stepper();
    let last = stepper.last().unwrap();
    let mut dump = [last.slopes_mas, last.commands_nm].concat();
    dump.extend(stepper.residual_nm().unwrap());
    dump.extend(stepper.image_e().unwrap());
    let truth = stepper.simulator().truth();
    dump.extend(truth.phasing_nm.iter().chain(&truth.ncpa_nm).map(|&nm| nm as f32));
    dump.into_iter().map(f32::to_bits).collect()
}

/// Runs `command`, to which the scene, the number of frames and a file for the dump are added as
/// arguments, and then `more`; holds the dump against Rust.
fn dumps_the_same(mut command: Command, more: &[&Path]) {
    let directory = tempfile::tempdir().unwrap();
    let dump = directory.path().join("dump");
    // cargo's own search path begins with a folder where an older library may lie.
    command.env("LD_LIBRARY_PATH", libraries());
    command.arg(here().join("small.toml")).arg(FRAMES.to_string()).arg(&dump).args(more);
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}\n{said}", output.status);
    let bytes = std::fs::read(&dump).unwrap();
    let (bits, rest) = bytes.as_chunks::<4>();
    assert!(rest.is_empty());
    let bits: Vec<u32> = bits.iter().map(|&bits| u32::from_ne_bytes(bits)).collect();
    let expected = expected();
    assert_eq!(bits.len(), expected.len());
    let first = bits.iter().zip(&expected).position(|(a, b)| a != b);
    assert_eq!(first, None, "{command:?}: the first value that differs");
}

/// Whether `program` runs with `arguments`; where it does not, the test is skipped, or fails if
/// `variable` is 1 or true.
fn is_here(program: &str, arguments: &[&str], variable: &str) -> bool {
    let output = Command::new(program).args(arguments).output();
    let here = output.as_ref().is_ok_and(|output| output.status.success());
    if !here {
        let required = std::env::var_os(variable).is_some_and(|value| value == "1" || value == "true");
        assert!(!required, "{program} {arguments:?}: {output:?}");
        println!("skipped: {program} {arguments:?} does not run here");
    }
    here
}

#[test]
fn c99() {
    let directory = tempfile::tempdir().unwrap();
    let program = c::compile("-std=c99", &here().join("simulator.c"), directory.path());
    dumps_the_same(c::command(&program), &[]);
}

#[test]
fn compared_maps_differ_from_their_turns_and_flips() {
    let mut stepper = stepper();
    let differs = |map: &Array2<f32>| {
        let bits = |map: Array2<f32>| map.mapv(f32::to_bits);
        let turned = [map.t().to_owned(), map.slice(ndarray::s![..;-1, ..]).to_owned()];
        turned.into_iter().all(|turned| bits(turned) != bits(map.clone()))
    };
    assert!(differs(&stepper.residual_nm().unwrap()) && differs(&stepper.image_e().unwrap()));
    let truth = stepper.simulator().truth();
    assert!(differs(&truth.phasing_nm.mapv(|nm| nm as f32)) && differs(&truth.ncpa_nm.mapv(|nm| nm as f32)));
}

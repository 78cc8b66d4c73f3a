//! The MATLAB package under Octave, on the library that cargo built: simulator, fits, estimates,
//! help and examples.

use super::pipeline::prints_what_rust_finds;
use super::{dumps_the_same, fits, here, is_here, libraries, root, session_channels, sky};
use std::path::Path;
use std::process::Command;

/// Octave with `script`, if it is installed with mkoctfile, which comes in a package of its own.
/// Its own files, such as a history, go into `scratch`.
fn octave(script: &str, scratch: &Path) -> Option<Command> {
    let required = "COPHASE_REQUIRE_OCTAVE";
    let installed = is_here("octave-cli", &["--version"], required) && is_here("mkoctfile", &["--version"], required);
    installed.then(|| {
        let mut command = Command::new("octave-cli");
        // cargo's own search path begins with a folder where an older library may lie.
        command.env("HOME", scratch).env("LD_LIBRARY_PATH", libraries());
        command.args(["--norc", "--quiet"]).arg(here().join(script));
        command
    })
}

fn passes(command: &mut Command) {
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}\n{said}", output.status);
}

#[test]
fn simulator() {
    let scratch = tempfile::tempdir().unwrap();
    if let Some(command) = octave("simulator.m", scratch.path()) {
        dumps_the_same(command, &[&root().join("bindings/matlab"), &libraries(), scratch.path()]);
    }
}

#[test]
#[ignore = "merge: 11 s"]
fn fits_have_the_bits_of_rust() {
    let scratch = tempfile::tempdir().unwrap();
    for scene in fits::scenes(scratch.path()) {
        let dump = scratch.path().join("dump");
        if let Some(mut command) = octave("session.m", scratch.path()) {
            command.args([&scene, &dump, &root().join("bindings/matlab"), &libraries()]).arg(scratch.path());
            passes(&mut command);
            fits::are_those_of_rust(&scene, &dump);
        }
    }
}

#[test]
#[ignore = "merge: 13 s"]
fn map_estimates_have_the_bits_of_rust() {
    let scratch = tempfile::tempdir().unwrap();
    let dump = scratch.path().join("dump");
    if let Some(mut command) = octave("estimator.m", scratch.path()) {
        command.args([&sky::scene(), &dump, &root().join("bindings/matlab"), &libraries()]).arg(scratch.path());
        passes(&mut command);
        sky::is_that_of_rust(&dump);
    }
}

#[test]
#[ignore = "merge: 16 s"]
fn pipeline() {
    let scratch = tempfile::tempdir().unwrap();
    prints_what_rust_finds(|| {
        let mut command = octave("pipeline.m", scratch.path())?;
        command.env("COPHASE_LIBRARIES", libraries()).env("COPHASE_SCRATCH", scratch.path());
        Some(command)
    });
}

#[test]
fn sessions_of_several_channels() {
    let scratch = tempfile::tempdir().unwrap();
    session_channels::prints_what_rust_finds(|| {
        let mut command = octave("session_channels.m", scratch.path())?;
        command.env("COPHASE_LIBRARIES", libraries()).env("COPHASE_SCRATCH", scratch.path());
        Some(command)
    });
}

#[test]
#[ignore = "merge: 9 s"]
fn help_and_examples() {
    let scratch = tempfile::tempdir().unwrap();
    if let Some(mut command) = octave("package.m", scratch.path()) {
        passes(command.args([&root().join("bindings/matlab"), &libraries()]).arg(scratch.path()));
    }
}

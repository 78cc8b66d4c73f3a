//! The Python package on the library that cargo built: simulator, fits, estimates, failures, the
//! wheel.

use super::pipeline::prints_what_rust_finds;
use super::{dumps_the_same, fits, here, is_here, libraries, library, root, session_channels, sky};
use std::process::Command;

/// `script` with the package on Python's path, if Python runs `needs`; a failure if it does not and
/// `variable` is set.
fn python(script: &str, needs: &str, variable: &str) -> Option<Command> {
    python_as(&std::env::var("COPHASE_PYTHON").unwrap_or("python3".into()), script, needs, variable)
}

fn python_as(python: &str, script: &str, needs: &str, variable: &str) -> Option<Command> {
    is_here(python, &["-c", needs], variable).then(|| {
        let mut command = Command::new(python);
        command.env("PYTHONPATH", root().join("bindings/python")).env("PYTHONDONTWRITEBYTECODE", "1");
        command.env("COPHASE_LIBRARY", library()).env("COPHASE_HEADER", root().join("include/cophase.h"));
        // cargo's own search path begins with a folder where an older library may lie.
        command.env("LD_LIBRARY_PATH", libraries()).arg(here().join(script));
        command
    })
}

/// A Python with Dask is that of `COPHASE_DASK`, which scripts/test installs.
#[test]
fn a_folder_of_nights_is_mapped_over_two_workers() {
    let python_of_dask = std::env::var("COPHASE_DASK").or(std::env::var("COPHASE_PYTHON"));
    let python_of_dask = python_of_dask.unwrap_or("python3".into());
    if let Some(mut command) =
        python_as(&python_of_dask, "nights.py", "import numpy, cffi, distributed", "COPHASE_REQUIRE_DASK")
    {
        let (folder, example) = (tempfile::tempdir().unwrap(), root().join("bindings/python/examples/dask_nights.py"));
        passes(command.args([&example, &here().join("tiny.toml"), folder.path()]));
    }
}

fn with_package(script: &str) -> Option<Command> {
    python(script, "import numpy, cffi", "COPHASE_REQUIRE_PYTHON")
}

fn passes(command: &mut Command) {
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?}: {}\n{said}", output.status);
}

#[test]
fn simulator() {
    if let Some(command) = with_package("simulator.py") {
        dumps_the_same(command, &[]);
    }
}

#[test]
#[ignore = "merge: 9 s"]
fn fits_have_the_bits_of_rust() {
    let directory = tempfile::tempdir().unwrap();
    for scene in fits::scenes(directory.path()) {
        let dump = directory.path().join("dump");
        if let Some(mut command) = with_package("session.py") {
            passes(command.args([&scene, &dump]));
            fits::are_those_of_rust(&scene, &dump);
        }
    }
}

#[test]
#[ignore = "merge: 14 s"]
fn map_estimates_have_the_bits_of_rust() {
    let directory = tempfile::tempdir().unwrap();
    let dump = directory.path().join("dump");
    if let Some(mut command) = with_package("estimator.py") {
        passes(command.args([&sky::scene(), &dump]));
        sky::is_that_of_rust(&dump);
    }
}

#[test]
#[ignore = "merge: 14 s"]
fn pipeline() {
    prints_what_rust_finds(|| with_package("pipeline.py"));
}

#[test]
fn sessions_of_several_channels() {
    session_channels::prints_what_rust_finds(|| with_package("session_channels.py"));
}

#[test]
fn failures() {
    if let Some(mut command) = with_package("failures.py") {
        // A library with these has faults on demand.
        let debug = if cfg!(debug_assertions) { "debug" } else { "" };
        passes(command.arg(here().join("tiny.toml")).arg(debug));
    }
}

/// Only where pip and what it needs to make wheels are there already, for a test fetches nothing.
#[test]
fn a_wheel_works_without_the_sources() {
    let needs = "import numpy, cffi, setuptools, pip, importlib.util as modules\n\
                 assert modules.find_spec('wheel') or modules.find_spec('setuptools.command.bdist_wheel')";
    if let Some(mut command) = python("wheel.py", needs, "COPHASE_REQUIRE_WHEEL") {
        let scratch = tempfile::tempdir().unwrap();
        let scene = here().join("tiny.toml");
        passes(command.args([&root().join("bindings/python"), scratch.path(), &scene]));
    }
}

#[test]
fn the_package_has_the_version_of_the_crate() {
    let project = std::fs::read_to_string(root().join("bindings/python/pyproject.toml")).unwrap();
    let version = format!("\nversion = \"{}\"\n", env!("CARGO_PKG_VERSION"));
    assert!(project.contains(&version), "bindings/python/pyproject.toml lacks {version}");
}

//! Python and MATLAB blocks: those of a page run one after the other in one interpreter, after
//! `setup/PAGE.py` or `.m`, on the library that cargo built. Presets are small scenes there
//! (`run.py`, `run.m`).
//!
//! Where Python or Octave is not installed its test prints that and passes, unless
//! `COPHASE_REQUIRE_PYTHON` or `COPHASE_REQUIRE_OCTAVE` is 1.

use crate::blocks::{self, Block};
use crate::{here, libraries, root, setup};
use std::path::{Path, PathBuf};
use std::process::Command;

fn is_here(program: &str, arguments: &[&str], variable: &str) -> bool {
    let output = Command::new(program).args(arguments).output();
    let here = output.as_ref().is_ok_and(|output| output.status.success());
    if !here {
        assert!(std::env::var_os(variable).is_none_or(|value| value != "1"), "{program} {arguments:?}: {output:?}");
        println!("skipped: {program} {arguments:?} does not run here");
    }
    here
}

/// Writes each block to a file whose name is its place, and gives these files, each behind its
/// setup.
fn files(page: &str, blocks: &[Block], extension: &str, folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = setup(page, extension).into_iter().collect();
    for (index, block) in blocks.iter().enumerate() {
        files.extend(setup(page, &format!("{}.{extension}", index + 1)));
        let name = format!("{}_{}.{extension}", page.replace(['/', '.', '-'], "_"), block.line);
        files.push(folder.join(name));
        std::fs::write(files.last().unwrap(), &block.text).unwrap();
    }
    files
}

fn succeeds(command: &mut Command, page: &str) {
    // cargo's own search path begins with a folder where an older library may lie.
    let output = command.env("LD_LIBRARY_PATH", libraries()).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{page}: {command:?}: {}\n{said}", output.status);
}

#[test]
fn python_blocks_run() {
    let python = std::env::var("COPHASE_PYTHON").unwrap_or("python3".into());
    if !is_here(&python, &["-c", "import numpy, cffi"], "COPHASE_REQUIRE_PYTHON") {
        return;
    }
    for (page, blocks) in blocks::run_in("python") {
        let folder = tempfile::tempdir().unwrap();
        let files = files(&page, &blocks, "py", folder.path());
        let mut command = Command::new(&python);
        command.arg(here().join("run.py")).args(files).current_dir(folder.path());
        command.env("PYTHONPATH", root().join("bindings/python")).env("PYTHONDONTWRITEBYTECODE", "1");
        command.env("COPHASE_LIBRARY", libraries().join("libcophase.so"));
        succeeds(command.env("COPHASE_HEADER", root().join("include/cophase.h")), &page);
    }
}

#[test]
fn matlab_blocks_run() {
    let required = "COPHASE_REQUIRE_OCTAVE";
    if !(is_here("octave-cli", &["--version"], required) && is_here("mkoctfile", &["--version"], required)) {
        return;
    }
    let gateway = tempfile::tempdir().unwrap();
    for (page, blocks) in blocks::run_in("matlab") {
        let folder = tempfile::tempdir().unwrap();
        let files = files(&page, &blocks, "m", folder.path());
        let mut command = Command::new("octave-cli");
        command.args(["--norc", "--quiet"]).arg(here().join("run.m")).arg(root()).arg(libraries()).arg(gateway.path());
        succeeds(command.args(files).current_dir(folder.path()).env("HOME", folder.path()), &page);
    }
}

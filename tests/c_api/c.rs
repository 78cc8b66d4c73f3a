//! Models, estimators, sessions and sequences from C, against the public headers alone. Each
//! program is compiled as C99 with warnings as errors (`tests/header.rs` compiles the headers as
//! C++17 too), checks what it can by itself, and dumps what must be the same bits in Rust.
//!
//! `scripts/sanitize` runs these tests once more, under other flags of the compiler
//! (`COPHASE_C_FLAGS`) and under a program that watches them (`COPHASE_C_RUNNER`).

mod estimates;
mod golden;
mod rtc;

use super::fits::same;
use super::pipeline::prints_what_rust_finds;
use super::session_channels;
use super::{here, libraries, root};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn words(variable: &str) -> Vec<String> {
    std::env::var(variable).unwrap_or_default().split_whitespace().map(String::from).collect()
}

/// Whether a tool watches the memory of the programs, which makes them slow and keeps freed memory
/// for a while.
fn is_watched() -> bool {
    !words("COPHASE_C_FLAGS").is_empty() || !words("COPHASE_C_RUNNER").is_empty()
}

/// Compiles `source` in a version of C against the headers and the library, into `directory`.
pub(super) fn compile(standard: &str, source: &Path, directory: &Path) -> PathBuf {
    let program = directory.join(source.file_stem().unwrap());
    let output = Command::new("cc")
        .arg(standard)
        .args(["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
        .arg(root().join("include"))
        .args(words("COPHASE_C_FLAGS"))
        .arg(source)
        .arg("-L")
        .arg(libraries())
        .args(["-lcophase", "-pthread", "-lm"])
        .arg(format!("-Wl,-rpath,{}", libraries().display()))
        .arg("-o")
        .arg(&program)
        .output()
        .unwrap();
    assert!(output.status.success(), "cc: {}", String::from_utf8_lossy(&output.stderr));
    program
}

/// A program as it is run: where cargo's own library is found, and under the runner if there is
/// one.
pub(super) fn command(program: &Path) -> Command {
    let mut runner = words("COPHASE_C_RUNNER").into_iter();
    let mut command = match runner.next() {
        Some(first) => Command::new(first),
        None => Command::new(program),
    };
    if is_watched() {
        // A driver's findings are not ours, and PoCL under valgrind takes minutes.
        command.args(runner).env("OCL_ICD_VENDORS", "/nonexistent");
        // Memory that there is not is refused, as by malloc, and no reason to stop.
        command.env("ASAN_OPTIONS", "allocator_may_return_null=1");
    }
    if !words("COPHASE_C_RUNNER").is_empty() {
        command.arg(program);
    }
    // cargo's own search path begins with a folder where an older library may lie.
    command.env("LD_LIBRARY_PATH", libraries());
    command
}

fn succeeded(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    let (said, printed) = (String::from_utf8_lossy(&output.stderr), String::from_utf8_lossy(&output.stdout));
    println!("{printed}");
    assert!(output.status.success(), "{command:?}: {}\n{said}", output.status);
    output
}

/// Runs the program of `source` with `arguments` and then a file for its dump, which `check` is
/// given.
fn dumps(source: &str, arguments: &[&Path], check: impl Fn(&Path)) {
    let directory = tempfile::tempdir().unwrap();
    let program = compile("-std=c99", &here().join(source), directory.path());
    let dump = directory.path().join("dump");
    succeeded(command(&program).args(arguments).arg(&dump));
    check(&dump);
}

/// The doubles of a dump.
fn doubles(dump: &Path) -> Vec<f64> {
    let bytes = std::fs::read(dump).unwrap();
    let (values, rest) = bytes.as_chunks::<8>();
    assert!(rest.is_empty());
    values.iter().map(|&bytes| f64::from_ne_bytes(bytes)).collect()
}

/// Runs the program of `source`, which dumps nothing.
fn passes(source: &str, arguments: &[&str]) {
    let directory = tempfile::tempdir().unwrap();
    let program = compile("-std=c99", &here().join(source), directory.path());
    succeeded(command(&program).arg(here().join("tiny.toml")).args(arguments));
}

#[test]
fn pipeline() {
    let directory = tempfile::tempdir().unwrap();
    let program = compile("-std=c99", &here().join("pipeline.c"), directory.path());
    prints_what_rust_finds(|| Some(command(&program)));
}

#[test]
fn sessions_of_several_channels() {
    let directory = tempfile::tempdir().unwrap();
    let program = compile("-std=c99", &here().join("session_channels.c"), directory.path());
    session_channels::prints_what_rust_finds(|| Some(command(&program)));
}

#[test]
fn images() {
    passes("images.c", &[]);
}

#[test]
fn sequences() {
    passes("sequence.c", &[]);
}

#[test]
fn programs_built_against_older_and_newer_headers_run() {
    passes("grown.c", &[]);
}

#[test]
fn misuse() {
    passes("misuse.c", &[]);
}

#[test]
fn threads_lifetimes_and_panics() {
    passes("threads.c", &[]);
}

#[test]
fn use_of_destroyed_handles_is_mostly_detected() {
    if is_watched() {
        println!("skipped: this is what a watched program must not do");
    } else {
        passes("freed.c", &[]);
    }
}

#[test]
#[ignore = "merge: 17 s"]
fn destroyed_handles_leave_no_memory() {
    let times = match is_watched() {
        true => "20",
        false if std::env::var_os("COPHASE_LONG_TESTS").is_some() => "10000",
        false => "2000",
    };
    passes("lifetimes.c", &[times]);
}

//! Models, sessions and sequences from C, against the public header alone. Each program is compiled as C99 and as C++17
//! with warnings as errors, checks what it can by itself, and dumps what must be the same bits in Rust.
//!
//! `scripts/sanitize` runs these tests once more, under other flags of the compiler (`COPHASE_C_FLAGS`) and under a
//! program that watches them (`COPHASE_C_RUNNER`).

mod estimates;
mod golden;
mod rtc;

use super::fits::same;
use super::{here, is_here, libraries, root};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A compiler, with what makes it take a source as the language meant.
type Language = (&'static str, &'static [&'static str]);

/// Those that are here. What watches a program's memory sees the same in either: once is enough.
fn languages() -> Vec<Language> {
    let all: [Language; 2] = [("cc", &["-std=c99"]), ("c++", &["-std=c++17", "-x", "c++"])];
    let wanted = if is_watched() { 1 } else { 2 };
    all.into_iter().take(wanted).filter(|(compiler, _)| is_here(compiler, &["--version"], "CI")).collect()
}

fn words(variable: &str) -> Vec<String> {
    std::env::var(variable).unwrap_or_default().split_whitespace().map(String::from).collect()
}

/// Whether a tool watches the memory of the programs, which makes them slow and keeps freed memory for a while.
fn is_watched() -> bool {
    !words("COPHASE_C_FLAGS").is_empty() || !words("COPHASE_C_RUNNER").is_empty()
}

/// Compiles `source` against the header and the library, into `directory`.
pub(super) fn compile((compiler, language): (&str, &[&str]), source: &Path, directory: &Path) -> PathBuf {
    let program = directory.join(source.file_stem().unwrap());
    let output = Command::new(compiler)
        .args(language)
        .args(["-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
        .arg(root().join("include"))
        .args(words("COPHASE_C_FLAGS"))
        .arg(source)
        // What follows is a library again, whatever language the source was said to be.
        .args(["-x", "none", "-L"])
        .arg(libraries())
        .args(["-lcophase", "-pthread", "-lm"])
        .arg(format!("-Wl,-rpath,{}", libraries().display()))
        .arg("-o")
        .arg(&program)
        .output()
        .unwrap();
    assert!(output.status.success(), "{compiler}: {}", String::from_utf8_lossy(&output.stderr));
    program
}

/// A program as it is run: where cargo's own library is found, and under the runner if there is one.
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

/// Runs the program of `source` in both languages, with `arguments` and then a file for its dump, which `check` is given.
fn dumps(source: &str, arguments: &[&Path], check: impl Fn(&Path)) {
    for language in languages() {
        let directory = tempfile::tempdir().unwrap();
        let program = compile(language, &here().join(source), directory.path());
        let dump = directory.path().join("dump");
        succeeded(command(&program).args(arguments).arg(&dump));
        check(&dump);
    }
}

/// The doubles of a dump.
fn doubles(dump: &Path) -> Vec<f64> {
    let bytes = std::fs::read(dump).unwrap();
    let (values, rest) = bytes.as_chunks::<8>();
    assert!(rest.is_empty());
    values.iter().map(|&bytes| f64::from_ne_bytes(bytes)).collect()
}

/// Runs the program of `source`, which dumps nothing, in both languages.
fn passes(source: &str, arguments: &[&str]) {
    for language in languages() {
        let directory = tempfile::tempdir().unwrap();
        let program = compile(language, &here().join(source), directory.path());
        succeeded(command(&program).arg(here().join("tiny.toml")).args(arguments));
    }
}

#[test]
fn what_becomes_of_images() {
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
fn what_was_destroyed_is_mostly_noticed() {
    if is_watched() {
        println!("skipped: this is what a watched program must not do");
    } else {
        passes("freed.c", &[]);
    }
}

#[test]
fn handles_that_come_and_go_leave_nothing() {
    passes("lifetimes.c", &[if is_watched() { "20" } else { "10000" }]);
}

//! Models, sessions and sequences from C, against the public header alone. Each program is compiled as C99 and as C++17
//! with warnings as errors, checks what it can by itself, and dumps what must be the same bits in Rust.
//!
//! `scripts/sanitize` runs these tests once more, under other flags of the compiler (`COPHASE_C_FLAGS`) and under a
//! program that watches them (`COPHASE_C_RUNNER`).

use super::{here, is_here, libraries, root};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Compilers with what makes them take a source as the language meant.
const LANGUAGES: [(&str, &[&str]); 2] = [("cc", &["-std=c99"]), ("c++", &["-std=c++17", "-x", "c++"])];

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

/// Runs the program of `source` in both languages, with `arguments` and then a file for its dump; the dumps.
fn dumps(source: &str, arguments: &[&Path]) -> Vec<Vec<f64>> {
    let languages = LANGUAGES.into_iter().filter(|(compiler, _)| is_here(compiler, &["--version"], "CI"));
    let run = |language| {
        let directory = tempfile::tempdir().unwrap();
        let program = compile(language, &here().join(source), directory.path());
        let dump = directory.path().join("dump");
        succeeded(command(&program).args(arguments).arg(&dump));
        let bytes = std::fs::read(&dump).unwrap_or_default();
        let (values, rest) = bytes.as_chunks::<8>();
        assert!(rest.is_empty());
        values.iter().map(|&bytes| f64::from_ne_bytes(bytes)).collect()
    };
    languages.map(run).collect()
}

/// Runs the program of `source`, which dumps nothing, in both languages.
fn passes(source: &str, arguments: &[&str]) {
    for language in LANGUAGES.into_iter().filter(|(compiler, _)| is_here(compiler, &["--version"], "CI")) {
        let directory = tempfile::tempdir().unwrap();
        let program = compile(language, &here().join(source), directory.path());
        succeeded(command(&program).arg(here().join("tiny.toml")).args(arguments));
    }
}

/// The scene of the tests, with another detector: neither its rows nor its columns are those of the image.
fn oblong(directory: &Path) -> PathBuf {
    let square = std::fs::read_to_string(here().join("tiny.toml")).unwrap();
    let oblong = square.replace("pixels = 48\n", "pixels = 48\nrows = 36\ncolumns = 44\n");
    assert_ne!(square, oblong);
    let file = directory.join("oblong.toml");
    std::fs::write(&file, oblong).unwrap();
    file
}

/// That a dump holds these numbers, to the last bit.
fn same(what: &str, dumped: &[f64], expected: impl IntoIterator<Item = f64>) {
    let expected: Vec<f64> = expected.into_iter().collect();
    assert_eq!(dumped.len(), expected.len(), "{what}");
    let first =
        dumped.iter().zip(&expected).position(|(a, b)| a.to_bits() != b.to_bits() && !(a.is_nan() && b.is_nan()));
    assert_eq!(first, None, "{what}: the first value that differs");
}

mod estimates;
mod golden;
mod rtc;

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
fn handles_that_come_and_go_leave_nothing() {
    passes("lifetimes.c", &[if is_watched() { "20" } else { "10000" }]);
}

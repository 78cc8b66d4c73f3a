//! The command line: words in any order, and some that are no words.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::ffi::OsString;
use std::os::unix::ffi::OsStringExt;
use std::process::{Command, Stdio};

/// Seconds of a processor and KiB of address space that a command line may take: an estimate of the
/// tiny files here takes a tenth of a second and 1 GB, for OpenCL and every thread's stack reserve
/// addresses.
const LIMITS: &str = "ulimit -t 60; ulimit -v 16000000; exec \"$@\"";

/// Verbs that return at once or work on the images here. `simulate`, `plan` and `demo` work for
/// minutes on what they accept, so they get a word that they do not.
const VERBS: [&str; 6] = ["scene", "image", "estimate", "compare", "devices", ""];
const LONG: [&str; 3] = ["simulate", "plan", "demo"];

const WORDS: [&str; 40] = [
    "-o",
    "--output",
    "out.fits",
    "images.fits",
    "scene.toml",
    "empty.fits",
    "missing.fits",
    "--scene",
    "--mask",
    "--plot",
    "out.png",
    "out.pdf",
    "--device",
    "cpu",
    "opencl:9:9",
    "auto",
    "--precision",
    "f32",
    "--optimizer",
    "bfgs",
    "--json",
    "--quiet",
    "--verbose",
    "--set",
    "image.pixels=",
    "image.pixels=32",
    "image.count=999999999",
    "image.wavelength_nm=nan",
    "pupil.samples=2048000",
    "=",
    "--seed",
    "-1",
    "1e999",
    "--",
    "-",
    "",
    "--help",
    "--truth",
    "--set=image.pixels=-8",
    "keck-nowhere",
];

fn pick<'a, T>(rng: &mut ChaCha8Rng, from: &'a [T]) -> &'a T {
    &from[rng.random_range(0..from.len())]
}

#[test]
fn random_words_end_in_a_status() {
    let folder = tempfile::tempdir().unwrap();
    let seeds = concat!(env!("CARGO_MANIFEST_DIR"), "/../fuzz/seeds");
    std::fs::copy(format!("{seeds}/scene/tiny.toml"), folder.path().join("scene.toml")).unwrap();
    std::fs::copy(format!("{seeds}/fits/ok-mask"), folder.path().join("images.fits")).unwrap();
    std::fs::write(folder.path().join("empty.fits"), "").unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(42);
    let mut seen = [0; 3];
    for round in 0..120 {
        let mut words: Vec<OsString> = Vec::new();
        if round % 6 == 5 {
            words.extend([pick(&mut rng, &LONG).into(), "--no-such-option".into()]);
        } else {
            words.push(pick(&mut rng, &VERBS).into());
        }
        for _ in 0..rng.random_range(0..7) {
            words.push(pick(&mut rng, &WORDS).into());
        }
        if rng.random_bool(0.1) {
            words.push(OsString::from_vec(vec![b'-', 0xff, 0xfe]));
        }
        let mut shell = Command::new("sh");
        shell.args(["-c", LIMITS, "sh", env!("CARGO_BIN_EXE_cophase")]).args(&words).current_dir(folder.path());
        // Without OpenCL: a driver is not what is tried here.
        let done = shell.env("OCL_ICD_VENDORS", "/nonexistent").stdin(Stdio::null()).output().unwrap();
        let said = String::from_utf8_lossy(&done.stderr);
        let status = done.status.code().unwrap_or_else(|| panic!("{words:?} ended by a signal: {said}"));
        assert!((0..=2).contains(&status), "{words:?}: status {status}: {said}");
        assert!(!said.contains("panicked") && !said.contains("internal error"), "{words:?}: {said}");
        assert!(
            status != 1 || said.lines().filter(|line| line.starts_with("cophase: ")).count() > 0,
            "{words:?}: {said}"
        );
        seen[status as usize] += 1;
        for left in std::fs::read_dir(folder.path()).unwrap() {
            let name = left.unwrap().file_name();
            assert!(!name.to_string_lossy().ends_with(".tmp"), "{words:?} left {name:?}");
        }
    }
    println!("status 0, 1, 2: {seen:?}");
    assert!(seen.iter().all(|&times| times > 0), "{seen:?}");
}

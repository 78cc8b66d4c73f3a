//! OpenCL drivers that abort or hang when they are loaded: the default mode runs on the CPU,
//! `--device cpu` never loads them, and a request for a device says why. The driver is a library of
//! a few lines, named as the OpenCL library itself.

use crate::{Desk, Done};
use std::process::Command;
use std::time::{Duration, Instant};

/// A library `name` on the desk whose constructor runs `code` and appends a byte to the file
/// `loads`.
fn library(desk: &Desk, name: &str, code: &str) -> bool {
    let source = format!(
        "#include <stdio.h>\n#include <stdlib.h>\n#include <unistd.h>\n__attribute__((constructor)) static void load(void) {{\n\
         FILE *file = fopen(\"{}\", \"a\");\nif (file) {{ fputc('x', file); fclose(file); }}\n{code}\n}}\n",
        desk.path("loads").display()
    );
    std::fs::write(desk.path("driver.c"), source).unwrap();
    let mut compiler = Command::new("cc");
    let made = compiler.args(["-shared", "-fPIC", "-o"]).arg(desk.path(name)).arg(desk.path("driver.c")).status();
    made.expect("cc is needed").success()
}

fn loads(desk: &Desk) -> usize {
    std::fs::read(desk.path("loads")).unwrap_or_default().len()
}

fn with_driver(desk: &Desk, name: &str, arguments: &[&str]) -> Done {
    let mut command = desk.command(arguments);
    command.env("COPHASE_OPENCL_LIBRARY", desk.path(name)).env("XDG_CACHE_HOME", desk.path("cache"));
    Done::from(command.env("COPHASE_OPENCL_TIMEOUT_S", "2").output().unwrap())
}

#[test]
fn a_driver_that_aborts_or_hangs_is_found_in_a_child() {
    for (name, code, reason) in [
        ("aborts.so", "abort();", "aborted"),
        ("crashes.so", "*(volatile int *)0 = 1;", "crashed"),
        ("exits.so", "exit(3);", "ended the process"),
        ("hangs.so", "for (;;) sleep(1000);", "2 s (COPHASE_OPENCL_TIMEOUT_S)"),
    ] {
        let desk = Desk::with_images(&[]);
        assert!(library(&desk, name, code));
        let estimate = ["estimate", "images.fits", "-o", "est.fits", "--json"];
        // Never loaded.
        let done = with_driver(&desk, name, &[&estimate[..], &["--device", "cpu"]].concat());
        assert_eq!((done.status, loads(&desk)), (0, 0), "{name}: {}", done.err);
        // Loaded once, in a child.
        let done = with_driver(&desk, name, &estimate);
        assert_eq!((done.status, loads(&desk)), (0, 1), "{name}: {}", done.err);
        assert!(done.out.contains("\"device\": \"cpu\""), "{}", done.out);
        let device = [&estimate[..], &["--device", "opencl"]].concat();
        with_driver(&desk, name, &device).failed(&device, &["OpenCL driver", reason, name, "CPU chain"]);
        let started = Instant::now();
        let listed = with_driver(&desk, name, &["devices"]);
        assert!(listed.status == 0 && listed.out.contains(reason), "{}", listed.out);
        // From the cache: not loaded again, no waiting for the limit.
        assert_eq!(loads(&desk), 1, "{name}");
        assert!(started.elapsed() < Duration::from_secs(2));
        // Repaired: another library of this name is probed again, and loaded.
        assert!(library(&desk, name, ""));
        let listed = with_driver(&desk, name, &["devices"]);
        assert!(listed.status == 0 && !listed.out.contains(reason), "{}", listed.out);
        assert_eq!(loads(&desk), 3, "{name}: in the child and in the program");
    }
}

#[test]
fn a_cache_that_cannot_be_written_is_no_failure() {
    let desk = Desk::with_scene();
    assert!(library(&desk, "aborts.so", "abort();"));
    std::fs::write(desk.path("cache"), "a file where a folder is needed").unwrap();
    for probes in [1, 2] {
        let listed = with_driver(&desk, "aborts.so", &["devices"]);
        assert!(listed.status == 0 && listed.out.contains("aborted"), "{}", listed.out);
        assert_eq!(loads(&desk), probes);
    }
}

/// A driver is installed, and there is no device: which driver, and why.
#[test]
fn missing_device_with_a_driver_has_a_reason() {
    let desk = Desk::with_scene();
    std::fs::create_dir(desk.path("vendors")).unwrap();
    std::fs::write(desk.path("vendors/broken.icd"), "libno-such-driver.so.1\n").unwrap();
    let mut command = desk.command(&["devices"]);
    command.env("OCL_ICD_VENDORS", desk.path("vendors")).env("XDG_CACHE_HOME", desk.path("cache"));
    let done = Done::from(command.output().unwrap());
    assert_eq!(done.status, 0, "{}", done.err);
    for word in ["no OpenCL device was found", "broken.icd", "libno-such-driver.so.1"] {
        assert!(done.out.contains(word), "'{word}': {}", done.out);
    }
}

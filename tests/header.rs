//! `include/cophase.h` is what cbindgen makes of src/capi, and compiles as C99 and as C++17.

#[path = "common/libraries.rs"]
mod libraries;

use libraries::libraries;
use std::path::Path;
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

#[test]
fn the_header_is_up_to_date() {
    let config = cbindgen::Config::from_file(root().join("cbindgen.toml")).unwrap();
    let mut made = Vec::new();
    // The other files of the room are found from its root.
    let builder = cbindgen::Builder::new().with_config(config).with_src(root().join("src/capi/mod.rs"));
    builder.generate().unwrap().write(&mut made);
    let header = root().join("include/cophase.h");
    if std::env::var_os("COPHASE_BLESS").is_some() {
        std::fs::write(&header, &made).unwrap();
    }
    let there = std::fs::read_to_string(&header).unwrap_or_default();
    assert!(there.as_bytes() == made, "include/cophase.h is old: run COPHASE_BLESS=1 cargo test --test header");
}

#[test]
fn the_header_compiles_as_c_and_as_cpp() {
    let directory = tempfile::tempdir().unwrap();
    for (compiler, standard, name) in [("cc", "-std=c99", "use.c"), ("c++", "-std=c++17", "use.cpp")] {
        let source = directory.path().join(name);
        std::fs::write(&source, "#include <cophase.h>\nint main(void) { return cophase_version() == 0; }\n").unwrap();
        let output = Command::new(compiler)
            .args([standard, "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only", "-I"])
            .arg(root().join("include"))
            .arg(&source)
            .output();
        match output {
            Ok(output) => {
                assert!(output.status.success(), "{compiler}: {}", String::from_utf8_lossy(&output.stderr));
            }
            Err(error) if compiler == "c++" => println!("skipped: no C++ compiler here ({error})"),
            Err(error) => panic!("{compiler}: {error}"),
        }
    }
}

#[test]
fn names_and_versions_are_readable_from_c() {
    let text = |pointer| unsafe { std::ffi::CStr::from_ptr(pointer) }.to_str().unwrap().to_string();
    assert_eq!(text(cophase::capi::cophase_version()), env!("CARGO_PKG_VERSION"));
    assert_eq!(text(cophase::capi::cophase_status_name(0)), "OK");
    assert_eq!(text(cophase::capi::cophase_status_name(cophase::Error::Shape(String::new()).status())), "BAD_SHAPE");
    assert_eq!(text(cophase::capi::cophase_status_name(-7)), "UNKNOWN");
}

#[test]
fn a_c_program_links_and_runs() {
    let libraries = libraries();
    let directory = tempfile::tempdir().unwrap();
    let program = directory.path().join("versions");
    let output = Command::new("cc")
        .args(["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-I"])
        .arg(root().join("include"))
        .arg(root().join("bindings/c/versions.c"))
        .arg("-L")
        .arg(&libraries)
        .arg("-lcophase")
        .arg(format!("-Wl,-rpath,{}", libraries.display()))
        .arg("-o")
        .arg(&program)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // cargo's own search path begins with a folder where an older library may lie.
    let output = Command::new(&program).env("LD_LIBRARY_PATH", &libraries).output().unwrap();
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.starts_with(&format!("cophase {}, C interface", env!("CARGO_PKG_VERSION"))), "{text}");
    assert!(text.contains("0 OK\n1 BAD_SCENE\n") && text.contains("11 PANIC\n12 UNKNOWN\n"), "{text}");
}

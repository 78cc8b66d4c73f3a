//! The installed C library, seen from outside: `make install` into temporary folders, found by
//! pkg-config and by CMake, linked and run. What is installed is the archive that cargo built for
//! these tests; that the shipped one is optimised across crates is for `make check-lto` to say.
//!
//! Where pkg-config or CMake is not installed its tests say so and pass; in CI they fail.
#![cfg(target_os = "linux")]

#[path = "../common/libraries.rs"]
mod libraries;
mod tree;

use libraries::libraries;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;
use tree::{Tree, is_here, run};

const VERSION: &str = env!("CARGO_PKG_VERSION");
const ABI: u32 = cophase::capi::COPHASE_ABI_VERSION;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Prints the version and the name of every status.
fn versions_c() -> PathBuf {
    root().join("bindings/c/versions.c")
}

/// Runs a program without the search path that cargo sets, in which another libcophase.so may lie.
fn said_by(program: &Path) -> String {
    run(Command::new(program).env_remove("LD_LIBRARY_PATH"))
}

fn greets(program: &Path) {
    let said = said_by(program);
    assert!(said.starts_with(&format!("cophase {VERSION}, C interface {ABI}")), "{said}");
    assert!(said.contains("0 OK\n"), "{said}");
}

/// The values of one kind of entry in the dynamic section: NEEDED, SONAME, ...
fn dynamic(file: &Path, tag: &str) -> Vec<String> {
    let section = run(Command::new("readelf").args(["-dW"]).arg(file));
    let tag = format!("({tag})");
    let lines = section.lines().filter(|line| line.contains(&tag));
    lines.map(|line| line.split_once('[').map_or(line, |(_, rest)| rest.trim_end_matches(']')).to_string()).collect()
}

/// The symbols that `nm` shows with these options.
fn symbols(file: &Path, options: &[&str]) -> BTreeSet<String> {
    let table = run(Command::new("nm").args(options).args(["--defined-only", "--format=posix"]).arg(file));
    // In an archive each member has a line of its own, "libcophase.a[cophase.o]:".
    let names = table.lines().filter(|line| line.contains(' ')).map(|line| line.split(' ').next().unwrap().to_string());
    names.collect()
}

/// The functions that the headers declare.
fn declared() -> BTreeSet<String> {
    let headers = ["cophase.h", "cophase_simulator.h"];
    let headers = headers.map(|name| std::fs::read_to_string(root().join("include").join(name)).unwrap()).concat();
    // Text outside comments.
    let code: String = headers.split("/*").map(|part| part.rsplit("*/").next().unwrap()).collect();
    let word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let before_parentheses = code.split('(').map(|text| text.rsplit(|c| !word(c)).next().unwrap());
    before_parentheses.filter(|name| name.starts_with("cophase_")).map(String::from).collect()
}

#[test]
fn uninstall_removes_all_installed_files() {
    let tree = Tree::stage("/usr");
    let shared = format!("lib/libcophase.so.{VERSION}");
    let soname = format!("lib/libcophase.so.{ABI}");
    let mut files = [
        "include/cophase.h",
        "include/cophase_simulator.h",
        "lib/cmake/cophase/cophase-config-version.cmake",
        "lib/cmake/cophase/cophase-config.cmake",
        "lib/libcophase.a",
        "lib/libcophase.so",
        &soname,
        &shared,
        "lib/pkgconfig/cophase-static.pc",
        "lib/pkgconfig/cophase.pc",
        "share/cophase/scene-reference.txt",
    ];
    files.sort();
    assert_eq!(tree.files(), files);
    let target = |link: &str| std::fs::read_link(tree.path().join(link)).unwrap();
    assert_eq!(target("lib/libcophase.so"), Path::new(&format!("libcophase.so.{ABI}")));
    assert_eq!(target(&soname), Path::new(&format!("libcophase.so.{VERSION}")));
    for file in ["cophase.pc", "cophase-static.pc"] {
        let text = std::fs::read_to_string(tree.path().join("lib/pkgconfig").join(file)).unwrap();
        assert!(text.starts_with("prefix=/usr\n") && !text.contains('@'), "{text}");
        assert!(text.contains(&format!("\nVersion: {VERSION}\n")), "{text}");
    }
    tree.make("uninstall");
    assert!(tree.files().is_empty(), "{:?}", tree.files());
    assert!(!tree.path().join("lib/cmake/cophase").exists());
}

#[test]
fn shared_library_has_few_dependencies() {
    let tree = Tree::stage("/usr");
    let library = tree.path().join("lib/libcophase.so");
    assert_eq!(dynamic(&library, "SONAME"), [format!("libcophase.so.{ABI}")]);
    // Code that each process would have to patch, a folder of the builder's.
    for tag in ["TEXTREL", "RPATH", "RUNPATH"] {
        assert!(dynamic(&library, tag).is_empty(), "{tag}");
    }
    // No OpenCL among them: it is opened at run time. glibc before 2.34 has more files, the loader
    // is one of them.
    let glibc = ["libc.", "libm.", "libdl.", "libpthread.", "librt.", "libutil.", "ld-linux", "libgcc_s."];
    let needed = dynamic(&library, "NEEDED");
    assert!(needed.iter().all(|name| glibc.iter().any(|glibc| name.starts_with(glibc))), "{needed:?}");
}

#[test]
fn the_symbols_are_the_functions_of_the_header() {
    let tree = Tree::stage("/usr");
    let declared = declared();
    assert!(declared.contains("cophase_version") && declared.contains("cophase_simulator_step"), "{declared:?}");
    assert_eq!(symbols(&tree.path().join("lib/libcophase.so"), &["--dynamic"]), declared);
    assert_eq!(symbols(&tree.path().join("lib/libcophase.a"), &["--extern-only"]), declared);
    // As cargo leaves it for who links from the source tree.
    assert_eq!(symbols(&libraries().join("libcophase.so"), &["--dynamic"]), declared);
}

fn pkg_config(tree: &Tree, asked: &[&str]) -> String {
    run(Command::new("pkg-config").args(asked).env("PKG_CONFIG_PATH", tree.path().join("lib/pkgconfig")))
}

/// Compiles C99 with what pkg-config answered.
fn compile(tree: &Tree, source: &Path, flags: &str, program: &Path) {
    let mut compiler = Command::new("cc");
    compiler.args(["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]).arg(source).arg("-o").arg(program);
    compiler.args(flags.split_whitespace());
    run(compiler.arg(format!("-Wl,-rpath,{}", tree.path().join("lib").display())));
}

#[test]
fn a_panic_is_caught_inside() {
    if !is_here("pkg-config") {
        return;
    }
    let tree = Tree::install();
    for package in ["cophase", "cophase-static"] {
        let program = tree.scratch(package);
        let flags = pkg_config(&tree, &["--cflags", "--libs", package]);
        compile(&tree, &root().join("tests/install/panic.c"), &flags, &program);
        let said = run(Command::new(&program).env_remove("LD_LIBRARY_PATH").env("COPHASE_FAULT", "panic"));
        // There is no fault on demand in a release, where the call is refused for its missing
        // frames.
        assert_eq!(said, if cfg!(debug_assertions) { "PANIC\n" } else { "BAD_ARGUMENT\n" }, "{package}");
    }
}

/// The tree lies elsewhere than where its files say: it has been moved.
#[test]
fn pkg_config_finds_a_tree_that_was_moved() {
    if !is_here("pkg-config") {
        return;
    }
    let tree = Tree::stage("/opt/cophase");
    let (shared, fixed) = (tree.scratch("shared"), tree.scratch("static"));
    for (package, program) in [("cophase", &shared), ("cophase-static", &fixed)] {
        let flags = pkg_config(&tree, &["--define-prefix", "--cflags", "--libs", package]);
        compile(&tree, &versions_c(), &flags, program);
    }
    let needs = |program| dynamic(program, "NEEDED").contains(&format!("libcophase.so.{ABI}"));
    assert!(needs(&shared) && !needs(&fixed));
    greets(&shared);
    greets(&fixed);
}

#[test]
fn cmake_finds_a_tree_that_was_moved() {
    if !is_here("cmake") {
        return;
    }
    let tree = Tree::stage("/opt/cophase");
    let build = tree.scratch("build");
    let configure = |wanted: &str| {
        let mut cmake = Command::new("cmake");
        cmake.arg("-S").arg(root().join("tests/install")).arg("-B").arg(&build).arg(format!("-DWANTED={wanted}"));
        cmake.arg(format!("-DCMAKE_PREFIX_PATH={}", tree.path().display()));
        cmake.arg(format!("-DPROGRAM={}", versions_c().display()));
        cmake
    };
    let refused = configure("99.0").output().unwrap();
    assert!(!refused.status.success(), "cophase {VERSION} passes for 99.0");
    run(&mut configure(VERSION));
    run(Command::new("cmake").arg("--build").arg(&build));
    for program in ["shared", "static"] {
        greets(&build.join(program));
    }
}

/// What the page shows first: the whole program between its ```c fences.
fn program_of_the_page() -> String {
    let page = std::fs::read_to_string(root().join("docs/c.md")).unwrap();
    let (_, from) = page.split_once("```c\n").expect("docs/c.md has no C");
    let (program, _) = from.split_once("```\n").unwrap();
    program.to_string()
}

#[test]
fn the_program_of_the_page_compiles_and_runs() {
    if !is_here("pkg-config") {
        return;
    }
    let tree = Tree::install();
    let (source, program) = (tree.scratch("page.c"), tree.scratch("page"));
    std::fs::write(&source, program_of_the_page()).unwrap();
    compile(&tree, &source, &pkg_config(&tree, &["--cflags", "--libs", "cophase"]), &program);
    // It fails by itself where the estimate is not the truth.
    let said = said_by(&program);
    assert!(
        said.starts_with("1 of 1 image used")
            && said.lines().last().is_some_and(|line| line.starts_with("first segment: ")),
        "{said}"
    );
}

#[test]
fn lto_check_detects_a_library_without_lto() {
    let tree = Tree::stage("/usr");
    let library = tree.path().join("lib/libcophase.so");
    let output = Command::new(root().join("scripts/check-lto")).arg(library).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    // Cargo's own build of all kinds of library has none, whatever the profile asks for.
    assert!(!output.status.success() && said.contains("without LTO"), "{said}");
}

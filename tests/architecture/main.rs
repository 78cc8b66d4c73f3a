//! Holds the arrows of `ARCHITECTURE.md` against the sources, and the version against itself.

mod cycles;
mod names;
mod rules;
mod source;
mod version;

use rules::{Rules, module_of};
use source::Source;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const MAP: &str = include_str!("../../ARCHITECTURE.md");
const MANIFEST: &str = include_str!("../../Cargo.toml");
const DOOR: &str = include_str!("../../src/lib.rs");

/// A package of the workspace.
struct Package {
    /// Where its sources are.
    folder: &'static str,
    /// What its tables' titles end with.
    title: &'static str,
    /// What the paths of other packages that use it begin with.
    name: &'static str,
}

const PACKAGES: [Package; 6] = [NUMERICS, LIBRARY, VIEW, WATCH, PROGRAM, PAPER];
const NUMERICS: Package = Package { folder: "numerics/src", title: " of numerics", name: "cophase_numerics" };
const LIBRARY: Package = Package { folder: "src", title: "", name: "cophase" };
const VIEW: Package = Package { folder: "view/src", title: " of view", name: "cophase_view" };
const WATCH: Package = Package { folder: "watch/src", title: " of the watch", name: "cophase_watch" };
const PROGRAM: Package = Package { folder: "cli/src", title: " of the program", name: "" };
const PAPER: Package = Package { folder: "paper/src", title: " of the experiments", name: "" };

impl Package {
    fn rules(&self) -> Rules {
        Rules::parse(MAP, self.title)
    }

    /// A function that says what a text, standing in a file of the package, does against the rules
    /// of the real map.
    fn judge(&self) -> impl Fn(&str, &str) -> Vec<String> {
        let (rules, exported) = (self.rules(), self.exported());
        move |file, text| rules.violations(file, &Source::read(file, text), &exported)
    }

    /// The module of each name that the package's own `lib.rs` re-exports, and the library's for
    /// those outside it.
    fn exported(&self) -> BTreeMap<String, String> {
        let of_library = |(name, module)| (format!("cophase::{name}"), format!("cophase::{module}"));
        let mut exported: BTreeMap<String, String> = source::exported(DOOR).into_iter().map(of_library).collect();
        let door = Path::new(env!("CARGO_MANIFEST_DIR")).join(self.folder).join("lib.rs");
        exported.extend(source::exported(&std::fs::read_to_string(door).unwrap_or_default()));
        exported
    }

    /// The text of every source file outside tests, by its path under the package's sources without
    /// `.rs`.
    fn sources(&self) -> BTreeMap<String, String> {
        let texts = texts(self.folder);
        let tests: Vec<String> = texts.iter().flat_map(|(file, text)| Source::read(file, text).test_files).collect();
        let is_test = |file: &str| tests.iter().any(|test| file == test || file.starts_with(&format!("{test}/")));
        texts.into_iter().filter(|(file, _)| !is_test(file)).collect()
    }
}

fn texts(folder: &str) -> BTreeMap<String, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let mut texts = BTreeMap::new();
    let mut folders = vec![root.clone()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("src is readable") {
            let path = entry.expect("src is readable").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let relative = path.strip_prefix(&root).expect("below src").with_extension("");
                let file = relative.to_str().expect("file names are UTF-8").replace('\\', "/");
                let text = std::fs::read_to_string(&path).expect("sources are UTF-8");
                texts.insert(file, text);
            }
        }
    }
    texts
}

#[test]
fn the_sources_keep_the_arrows() {
    let mut violations = Vec::new();
    for package in PACKAGES {
        let judge = package.judge();
        for (file, text) in package.sources() {
            let found = judge(&file, &text);
            violations.extend(found.into_iter().map(|sentence| format!("{}/{sentence}", package.folder)));
        }
    }
    assert!(violations.is_empty(), "\n{}\n", violations.join("\n"));
}

#[test]
fn map_lists_the_modules_of_the_sources() {
    for package in PACKAGES {
        let (sources, rules) = (package.sources(), package.rules());
        let built: BTreeSet<&str> =
            sources.keys().map(|file| module_of(file)).filter(|module| *module != "lib").collect();
        let shown: BTreeSet<&str> =
            rules.modules.iter().filter(|(_, module)| !module.to_come).map(|(name, _)| name.as_str()).collect();
        let folder = package.folder;
        assert_eq!(shown, built, "left: ARCHITECTURE.md, without the modules marked (to come); right: {folder}");
    }
}

#[test]
fn the_map_is_sound() {
    let of_package = |package: &Package| -> Vec<String> {
        package.rules().modules.keys().map(|module| format!("{}::{module}", package.name)).collect()
    };
    let known: BTreeSet<String> = PACKAGES.iter().flat_map(of_package).collect();
    for package in PACKAGES {
        let rules = package.rules();
        assert_eq!(rules.faults(), [""; 0], "{}", package.folder);
        let unknown: Vec<&str> = rules.foreign().into_iter().filter(|name| !known.contains(*name)).collect();
        assert!(unknown.is_empty(), "{}: the map names {unknown:?}, which have no row", package.folder);
    }
}

#[test]
fn the_library_does_without_the_programs_crates() {
    let absent = LIBRARY.rules().absent;
    assert!(absent.contains("clap") && absent.contains("plotters"), "{absent:?}");
    let manifest: toml_edit::DocumentMut = MANIFEST.parse().expect("Cargo.toml is TOML");
    let dependencies = manifest["dependencies"].as_table().expect("Cargo.toml has dependencies");
    let found: Vec<&String> = absent.iter().filter(|name| dependencies.contains_key(name)).collect();
    assert!(found.is_empty(), "Cargo.toml: the library may not depend on {found:?}");
}

#[test]
fn no_other_package_depends_on_what_numerics_has() {
    let confined: BTreeSet<String> = NUMERICS.rules().confined.into_iter().flat_map(|(names, _)| names).collect();
    assert!(confined.contains("faer") && confined.contains("rustfft"), "{confined:?}");
    for package in PACKAGES.iter().filter(|package| package.folder != NUMERICS.folder) {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(package.folder).with_file_name("Cargo.toml");
        let manifest: toml_edit::DocumentMut =
            std::fs::read_to_string(&path).expect("readable").parse().expect("Cargo.toml is TOML");
        let tables = ["dependencies", "dev-dependencies"].map(|table| manifest.get(table).and_then(|it| it.as_table()));
        let depends = |name: &&String| tables.iter().flatten().any(|table| table.contains_key(name));
        let found: Vec<&String> = confined.iter().filter(depends).collect();
        assert!(found.is_empty(), "{}: {found:?} belong in numerics", path.display());
    }
}

/// The cycles of all packages' files.
fn cycles() -> BTreeSet<BTreeSet<String>> {
    let read = |package: &Package| -> BTreeMap<String, cycles::File> {
        package.sources().iter().map(|(file, text)| (file.clone(), cycles::File::read(file, text))).collect()
    };
    PACKAGES.iter().flat_map(|package| cycles::Package::new(&read(package)).cycles()).collect()
}

fn row(cycle: &BTreeSet<String>) -> String {
    format!("| `{}` |", cycle.iter().map(String::as_str).collect::<Vec<_>>().join("` `"))
}

#[test]
fn no_files_use_each_other_in_a_circle_but_those_of_the_map() {
    let (found, allowed) = (cycles(), BTreeSet::from_iter(LIBRARY.rules().cycles));
    for cycle in &found {
        println!("{}", row(cycle));
    }
    let sentences = found.difference(&allowed).map(|cycle| format!("use each other in a circle: {}", row(cycle)));
    // The list only shrinks: what was undone, in part or whole, leaves it.
    let undone = allowed.difference(&found).map(|cycle| format!("are no circle any more, or another: {}", row(cycle)));
    let wrong: Vec<String> = sentences.chain(undone).collect();
    assert!(wrong.is_empty(), "\n{}\nsee \"File cycles that remain\" in ARCHITECTURE.md\n", wrong.join("\n"));
}

#[test]
fn planted_cycles_are_found() {
    let found = |files: &[(&str, &str)]| {
        let read = files.iter().map(|(file, text)| (file.to_string(), cycles::File::read(file, text))).collect();
        let found = cycles::Package::new(&read).cycles();
        found.into_iter().map(|cycle| cycle.into_iter().collect::<Vec<_>>().join(" ")).collect::<Vec<_>>()
    };
    let pair = |a: &str, b: &str| {
        found(&[("r/mod", "mod a; mod b; pub use a::{A, f}; pub use b::B;"), ("r/a", a), ("r/b", b)])
    };
    let (a, b) = ("use super::B; pub struct A; pub fn f() {}", "pub struct B;");
    assert_eq!(pair(a, b), [""; 0]);
    for b in [
        "use super::a::A; pub struct B;",
        "use super::A; pub struct B;",
        "use super::*; pub struct B(A);",
        "use crate::r; pub struct B(r::A);",
        "use crate::r::a as other; pub struct B(other::A);",
        "pub struct B(super::A);",
        "pub struct B; fn g() { vec![super::f()] }",
        "pub struct B; mod inner { use super::super::a::{self, A}; }",
    ] {
        assert_eq!(pair(a, b), ["r/a r/b"], "{b}");
    }
    for b in [
        "use super::*; pub struct B;",
        "pub struct B; #[cfg(test)] mod tests { use super::super::A; }",
        "pub(in crate::r::a) struct B;",
        "use crate::other::A; pub struct B(A);",
        "/// See [`super::A`].\npub struct B;",
    ] {
        assert_eq!(pair(a, b), [""; 0], "{b}");
    }
    // A module's own file counts for what it defines and uses itself.
    let own = |module: &str, a: &str| found(&[("r/mod", module), ("r/a", a)]);
    assert_eq!(own("mod a; pub use a::A; pub struct R;", "use super::R; pub struct A(R);"), [""; 0]);
    assert_eq!(own("mod a; pub use a::A; pub struct R(A);", "use super::R; pub struct A;"), ["r/a r/mod"]);
    assert_eq!(own("mod a; pub struct R(a::A);", "pub struct A(super::R);"), ["r/a r/mod"]);
    assert_eq!(own("mod a; use a::A; words! { R { A } }", "pub struct A(super::R);"), ["r/a r/mod"]);
    let long = [
        ("r/mod", "mod a; mod b; mod c;"),
        ("r/a", "use super::b::B;"),
        ("r/b", "use super::c::C;"),
        ("r/c", "use super::a::A;"),
        ("s", "use crate::r::a::A;"),
    ];
    assert_eq!(found(&long), ["r/a r/b r/c"]);
}

#[test]
fn planted_faults_of_the_map_are_found() {
    let map = |modules: &str| {
        Rules::parse(&format!("## Modules\n| Module | What | Uses |\n|---|---|---|\n{modules}"), "").faults()
    };
    assert!(map("| `a` | | – |\n| `b` | | `a` |\n").is_empty());
    assert_eq!(map("| `a` | | `c` |\n"), ["the map names the module `c`, which has no row"]);
    assert_eq!(
        map("| `a` | | `b` |\n| `b` | | `c` |\n| `c` | | `a` |\n| `d` | | – |\n"),
        ["the map runs in a circle through [\"a\", \"b\", \"c\"]"]
    );
    // An exception is an arrow like any other.
    let bent = "| `a` | | – |\n| `b` | | `a` |\n## Exceptions\n| `a/x` | `b` | |\n";
    assert_eq!(map(bent), ["the map runs in a circle through [\"a\", \"b\"]"]);
}

#[test]
fn planted_violations_are_found() {
    for (file, text, named) in [
        ("grid", "use crate::modal::Fit;", "modal"),
        ("optimize/lbfgs", "use crate::{Error, grid::Grid};", "grid"),
        ("optimize/lbfgs", "use crate::{error::{Error}, pupil::{self, Pupil}};", "pupil"),
        ("metrics/mod", "fn f() { crate::io::read() }", "io"),
        ("metrics/mod", "fn f() { vec![crate::io::read()] }", "io"),
        ("metrics/mod", "use super::io;", "io"),
        ("metrics/psd", "use super::{super::io};", "io"),
        ("metrics/psd", "mod inner { use super::super::super::io; }", "io"),
        ("metrics/psd", "#[cfg(test)] mod tests { use crate::plot; } use crate::io;", "io"),
        ("metrics/psd", "#[cfg(test)] use crate::{plot}; use crate::io;", "io"),
        ("metrics/psd", "#[cfg(not(test))] use crate::io;", "io"),
        ("grid", "use super::*;", "*"),
        ("pupil/mod", "use crate::{self as all};", "self"),
        ("pupil/mod", "pub(in crate::modes) fn f() {}", "modes"),
        ("imaging/field", "use crate::device::Context;", "device"),
        ("cellar/mod", "", "cellar"),
        ("imaging/field", "fn f(q: ocl::Queue) {}", "ocl"),
        ("device", "use argmin::core::Problem;", "argmin"),
        ("modal/fit", "use argmin as solver;", "argmin"),
        ("modal/fit", "use ::fitsio::FitsFile;", "fitsio"),
        ("modal/fit", "fn f() { for i in 0..ocl::MAX {} }", "ocl"),
        ("lib", "extern crate argmin;", "argmin"),
        ("lib", "pub extern \"C\" fn f() {}", "extern \"C\""),
        ("io/mod", "unsafe extern \"C-unwind\" { fn f(); }", "extern \"C\""),
        ("io/mod", "type F = extern fn();", "extern \"C\""),
    ] {
        one_is_found(&LIBRARY, file, text, named);
    }
    for (package, file, text, named) in [
        (&NUMERICS, "cholesky", "use rustfft::Fft;", "rustfft"),
        (&LIBRARY, "grid", "use cophase_numerics::fft::Fft;", "fft"),
        (&PROGRAM, "main", "use cophase::fourier;", "fourier"),
        (&PROGRAM, "verbs/plan", "use cophase_view::{plot, panics};", "panics"),
        (&PROGRAM, "verbs/watch", "use cophase_watch::store::Store;", "store"),
        (&VIEW, "plot/canvas", "use cophase::modal::Fit;", "modal"),
        (&VIEW, "plot/canvas", "use crate::{html::Curve};", "html"),
        (&VIEW, "html/mod", "use plotters::prelude::*;", "plotters"),
        (&VIEW, "lib", "extern crate plotters;", "plotters"),
        (&WATCH, "store/read", "use crate::tracking::Step;", "tracking"),
        (&WATCH, "log", "use cophase::Scene;", "Scene"),
        (&WATCH, "clock", "use crate::TrackingSettings;", "TrackingSettings"),
        (&WATCH, "report", "use rusqlite::Connection;", "rusqlite"),
        (&PAPER, "experiment/draw", "use cophase_paper::reproduce::Row;", "reproduce"),
        (&PAPER, "bench/mod", "fn f() { clap::value_parser!(u32) }", "clap"),
    ] {
        one_is_found(package, file, text, named);
    }
}

fn one_is_found(package: &Package, file: &str, text: &str, named: &str) {
    let found = package.judge()(file, text);
    assert_eq!(found.len(), 1, "{file}: {text}: {found:?}");
    assert!(found[0].contains(&format!("`{named}`")) || found[0].contains(&format!("::{named}`")), "{found:?}");
}

#[test]
fn allowed_uses_are_no_violations() {
    for (file, text) in [
        ("grid", "use crate::{Error, Result};"),
        ("optimize/mod", "/// See [`crate::pupil`].\nfn f() { /* crate::io */ g(\"crate::io, ocl::Queue\") }"),
        ("optimize/mod", "mod step { use super::Step; } use self::step::Step; pub(crate) fn f() {}"),
        ("optimize/search", "use super::*; use super::super::optimize::Step; use argmin::core::Problem;"),
        ("metrics/mod", "#[cfg(test)]\n#[rustfmt::skip]\nmod tests { use super::*; use crate::io; }"),
        ("metrics/mod", "#[cfg(all(test, unix))] fn f() -> u8 { crate::io::read() }"),
        ("metrics/bench", "#![cfg(test)]\nuse crate::io;"),
        ("imaging/gpu_batch", "use crate::device::Context; use ocl::Queue;"),
        ("imaging/gpu/mod", "use crate::device; fn f() -> ocl::Result<()> {}"),
        ("device/loader", "unsafe extern \"C\" { fn f(); }"),
        ("modal/fit", "let fitsio = local.argmin::<f64>(); let x = shapes::argmin::f();"),
        ("lib", "pub mod io; pub use error::{Error, Result};"),
    ] {
        assert_eq!(LIBRARY.judge()(file, text), [""; 0], "{file}: {text}");
    }
    assert_eq!(LIBRARY.judge()("fourier/fft", "use cophase_numerics::fft::Fft;"), [""; 0]);
    // A module of one package is not that of the same name in another.
    let own_and_foreign = "use crate::tracking::Step; use cophase::{Error, modes::Group};";
    assert_eq!(WATCH.judge()("corrections", own_and_foreign), [""; 0]);
}

#[test]
fn re_exports_count_for_their_module() {
    let exported = source::exported("pub mod a; pub use a::{X, b::{Y as Z}}; pub use crate::c::W; pub use d::V;");
    let pairs: Vec<(&str, &str)> = exported.iter().map(|(name, module)| (name.as_str(), module.as_str())).collect();
    assert_eq!(pairs, [("V", "d"), ("W", "c"), ("X", "a"), ("Z", "a")]);
}

#[test]
fn test_files_are_excluded_from_the_rules() {
    let declared = |file, text| Source::read(file, text).test_files;
    assert_eq!(declared("io/mod", "#[cfg(test)] mod tests;"), ["io/tests"]);
    assert_eq!(declared("io/fits", "#[cfg(test)]\nmod hard_cases; mod header;"), ["io/fits/hard_cases"]);
}

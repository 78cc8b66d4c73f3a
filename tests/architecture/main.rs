//! Holds the arrows of `ARCHITECTURE.md` against the sources, and the version against itself.

mod rules;
mod source;
mod version;

use rules::{Rules, room_of};
use source::Source;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

const MAP: &str = include_str!("../../ARCHITECTURE.md");
const DOOR: &str = include_str!("../../src/lib.rs");

/// Every source file that is part of the library or of the program, by its path under `src` without `.rs`.
fn sources() -> BTreeMap<String, Source> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut sources = BTreeMap::new();
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
                let source = Source::read(&file, &text);
                sources.insert(file, source);
            }
        }
    }
    let tests: Vec<String> = sources.values().flat_map(|source| source.test_files.clone()).collect();
    sources.retain(|file, _| !tests.iter().any(|test| file == test || file.starts_with(&format!("{test}/"))));
    sources
}

/// What `text`, standing in `file`, does against the rules of the real map.
fn judge(file: &str, text: &str) -> Vec<String> {
    Rules::parse(MAP).violations(file, &Source::read(file, text), &source::exported(DOOR))
}

#[test]
fn the_sources_keep_the_arrows() {
    let (rules, exported) = (Rules::parse(MAP), source::exported(DOOR));
    let violations: Vec<String> =
        sources().iter().flat_map(|(file, source)| rules.violations(file, source, &exported)).collect();
    assert!(violations.is_empty(), "\n{}\n", violations.join("\n"));
}

#[test]
fn the_map_shows_the_rooms_that_are_there() {
    let sources = sources();
    let built: BTreeSet<&str> = sources.keys().map(|file| room_of(file)).filter(|room| *room != "lib").collect();
    let rules = Rules::parse(MAP);
    let shown: BTreeSet<&str> =
        rules.rooms.iter().filter(|(_, room)| !room.to_come).map(|(name, _)| name.as_str()).collect();
    assert_eq!(shown, built, "left: ARCHITECTURE.md, without the rooms marked (to come); right: src");
}

#[test]
fn the_map_is_sound() {
    assert_eq!(Rules::parse(MAP).faults(), [""; 0]);
}

#[test]
fn planted_faults_of_the_map_are_found() {
    let map = |rooms: &str| Rules::parse(&format!("## Rooms\n| Room | What | Uses |\n|---|---|---|\n{rooms}")).faults();
    assert!(map("| `a` | | – |\n| `b` | | `a` |\n").is_empty());
    assert_eq!(map("| `a` | | `c` |\n"), ["the map names the room `c`, which has no row"]);
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
        ("grid", "use crate::estimate::Fit;", "estimate"),
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
        ("main", "use cophase::fourier;", "fourier"),
        ("cellar/mod", "", "cellar"),
        ("imaging/field", "fn f(q: ocl::Queue) {}", "ocl"),
        ("device", "use argmin::core::Problem;", "argmin"),
        ("estimate/fit", "use argmin as solver;", "argmin"),
        ("estimate/fit", "use ::fitsio::FitsFile;", "fitsio"),
        ("cli/estimate", "use plotters::prelude::*;", "plotters"),
        ("estimate/fit", "fn f() { for i in 0..ocl::MAX {} }", "ocl"),
        ("lib", "extern crate plotters;", "plotters"),
        ("lib", "pub extern \"C\" fn f() {}", "extern \"C\""),
        ("io/mod", "unsafe extern \"C-unwind\" { fn f(); }", "extern \"C\""),
        ("io/mod", "type F = extern fn();", "extern \"C\""),
    ] {
        let found = judge(file, text);
        assert_eq!(found.len(), 1, "{file}: {text}: {found:?}");
        assert!(found[0].contains(&format!("`{named}`")) || found[0].contains(&format!("::{named}`")), "{found:?}");
    }
}

#[test]
fn the_innocent_are_left_alone() {
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
        ("estimate/fit", "let fitsio = local.argmin::<f64>(); let x = shapes::argmin::f();"),
        ("lib", "pub mod io; pub use error::{Error, Result};"),
    ] {
        assert_eq!(judge(file, text), [""; 0], "{file}: {text}");
    }
}

#[test]
fn re_exports_lead_to_their_room() {
    let exported = source::exported("pub mod a; pub use a::{X, b::{Y as Z}}; pub use crate::c::W; pub use d::V;");
    let pairs: Vec<(&str, &str)> = exported.iter().map(|(name, room)| (name.as_str(), room.as_str())).collect();
    assert_eq!(pairs, [("V", "d"), ("W", "c"), ("X", "a"), ("Z", "a")]);
}

#[test]
fn files_of_tests_are_no_part_of_the_house() {
    let declared = |file, text| Source::read(file, text).test_files;
    assert_eq!(declared("io/mod", "#[cfg(test)] mod tests;"), ["io/tests"]);
    assert_eq!(declared("io/fits", "#[cfg(test)]\nmod hard_cases; mod header;"), ["io/fits/hard_cases"]);
}

//! The rules, read from the tables of `ARCHITECTURE.md`, which is their only home.

use crate::source::Source;
use std::collections::{BTreeMap, BTreeSet};

type Names = BTreeSet<String>;

/// A row of "Modules".
#[derive(Debug)]
pub struct Module {
    /// The map shows it, the sources do not have it yet.
    pub to_come: bool,
    uses: Names,
}

/// The tables of one package. A place is a module, or the start of a path under `src` where it holds a slash: `imaging/gpu`
/// is `imaging/gpu.rs`, `imaging/gpu_batch.rs` and all of `imaging/gpu/`.
#[derive(Debug, Default)]
pub struct Rules {
    pub modules: BTreeMap<String, Module>,
    /// Modules of any package.
    known: Names,
    /// Places, and the modules that they may use besides those of their own module's row.
    exceptions: Vec<(Names, Names)>,
    /// Names from outside the crate, and the only places where they may stand.
    confined: Vec<(Names, Names)>,
    /// Crates that the library must not depend on.
    pub absent: Names,
    /// Sets of files, of any package, that use each other in a circle and may for now.
    pub cycles: Vec<Names>,
}

/// The file's module: its first folder, or itself. `file` is relative to `src`, without `.rs`.
pub fn module_of(file: &str) -> &str {
    file.split('/').next().unwrap_or(file)
}

fn lies_in(file: &str, place: &str) -> bool {
    if place.contains('/') { file.starts_with(place) } else { module_of(file) == place }
}

/// What stands between backticks.
fn quoted(cell: &str) -> Names {
    cell.split('`').skip(1).step_by(2).map(String::from).collect()
}

impl Rules {
    /// `package` ends the titles of the package's own tables: nothing for the library, " of the program" for the program.
    pub fn parse(markdown: &str, package: &str) -> Self {
        let mut rules = Self::default();
        let mut section = "";
        for line in markdown.lines() {
            if let Some(title) = line.strip_prefix("## ") {
                section = title;
            }
            let cells: Vec<&str> = line.split('|').collect();
            // The head of a table and the line below it quote nothing.
            if cells.len() < 4 || quoted(cells[1]).is_empty() {
                continue;
            }
            if section.starts_with("Modules") {
                rules.known.extend(quoted(cells[1]));
            }
            match section.strip_suffix(package).unwrap_or_default() {
                "Modules" => rules.modules.extend(
                    quoted(cells[1])
                        .into_iter()
                        .map(|name| (name, Module { to_come: cells[1].contains("(to come)"), uses: quoted(cells[3]) })),
                ),
                "Exceptions" => rules.exceptions.push((quoted(cells[1]), quoted(cells[2]))),
                "Names that stay in their module" => rules.confined.push((quoted(cells[1]), quoted(cells[2]))),
                _ => {}
            }
            match section {
                "Crates that the library does without" => rules.absent.extend(quoted(cells[1])),
                "File cycles that remain" => rules.cycles.push(quoted(cells[1])),
                _ => {}
            }
        }
        rules
    }

    /// Every arrow of the map, exceptions included, from the user to the used.
    fn arrows(&self) -> BTreeMap<&str, BTreeSet<&str>> {
        let mut arrows: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for (name, module) in &self.modules {
            arrows.entry(name).or_default().extend(module.uses.iter().map(String::as_str));
        }
        for (places, uses) in &self.exceptions {
            for place in places {
                arrows.entry(module_of(place)).or_default().extend(uses.iter().map(String::as_str));
            }
        }
        arrows
    }

    /// What is wrong with the map itself: names of modules that have no row, and cycles.
    pub fn faults(&self) -> Vec<String> {
        let mut arrows = self.arrows();
        let places = self.confined.iter().flat_map(|(_, places)| places).map(|place| module_of(place));
        let named = arrows.iter().flat_map(|(module, uses)| uses.iter().chain([module])).copied().chain(places);
        let mut faults: Vec<String> = named
            .collect::<BTreeSet<_>>()
            .into_iter()
            .filter(|name| !self.known.contains(*name))
            .map(|name| format!("the map names the module `{name}`, which has no row"))
            .collect();
        // Take away the modules that use none of those left, until nothing changes: what stays uses itself in a circle.
        loop {
            let left: BTreeSet<&str> = arrows.keys().copied().collect();
            arrows.retain(|_, uses| uses.iter().any(|used| left.contains(used)));
            if arrows.len() == left.len() {
                break;
            }
        }
        if !arrows.is_empty() {
            faults.push(format!("the map runs in a circle through {:?}", arrows.keys().collect::<Vec<_>>()));
        }
        faults
    }

    /// What `file` does against the rules; one sentence each. `exported` gives the module of each name that `lib.rs`
    /// re-exports.
    pub fn violations(&self, file: &str, source: &Source, exported: &BTreeMap<String, String>) -> Vec<String> {
        let module = module_of(file);
        let mut violations = Vec::new();
        // lib.rs is the door: it names every module.
        if module != "lib" {
            let Some(row) = self.modules.get(module) else {
                return vec![format!("{file}.rs: the module `{module}` has no row in ARCHITECTURE.md")];
            };
            let excepted = self.exceptions.iter().filter(|(places, _)| places.iter().any(|place| lies_in(file, place)));
            let allowed: BTreeSet<&String> = row.uses.iter().chain(excepted.flat_map(|(_, uses)| uses)).collect();
            for name in &source.uses {
                let used = exported.get(name).unwrap_or(name);
                if used != module && !allowed.contains(used) {
                    violations.push(format!("{file}.rs: `{module}` may not use `crate::{name}`"));
                }
            }
        }
        for (names, places) in &self.confined {
            if !places.iter().any(|place| lies_in(file, place)) {
                let strays = names.intersection(&source.outside);
                violations.extend(strays.map(|name| format!("{file}.rs: `{name}` belongs in {places:?} only")));
            }
        }
        violations
    }
}

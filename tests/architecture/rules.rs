//! The rules, read from the tables of `ARCHITECTURE.md`, which is their only home.

use crate::source::Source;
use std::collections::{BTreeMap, BTreeSet};

type Names = BTreeSet<String>;

/// A row of "Modules".
#[derive(Debug)]
pub struct Module {
    /// The map shows it, the sources do not have it yet.
    pub to_come: bool,
    /// Modules of the same package by their name, of another with its crate: `cophase_view::plot`.
    uses: Names,
}

/// The tables of one package. A place is a module, or the start of a path under `src` where it
/// holds a slash: `imaging/gpu` is `imaging/gpu.rs`, `imaging/gpu_batch.rs` and all of
/// `imaging/gpu/`.
#[derive(Debug, Default)]
pub struct Rules {
    pub modules: BTreeMap<String, Module>,
    /// Places, and the modules that they may use besides those of their own module's row.
    exceptions: Vec<(Names, Names)>,
    /// Names from outside the crate, and items of its modules, and the only places where they may
    /// stand.
    pub confined: Vec<(Names, Names)>,
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

/// Whether `name` is that of a module of another package.
fn is_foreign(name: &str) -> bool {
    name.contains("::")
}

/// What stands between backticks.
fn quoted(cell: &str) -> Names {
    cell.split('`').skip(1).step_by(2).map(String::from).collect()
}

impl Rules {
    /// `package` ends the titles of the package's own tables: nothing for the library, " of the
    /// program" for the program. In "Modules" the head of a column names the crate whose modules
    /// the column lists; the package's own crate has no name there.
    pub fn parse(markdown: &str, package: &str) -> Self {
        let mut rules = Self::default();
        let mut section = "";
        let mut crates: Vec<String> = Vec::new();
        for line in markdown.lines() {
            if let Some(title) = line.strip_prefix("## ") {
                section = title;
            }
            let cells: Vec<&str> = line.split('|').collect();
            if cells.len() < 4 {
                continue;
            }
            if cells[1].trim() == "Module" {
                crates = cells[3..].iter().map(|cell| quoted(cell).pop_first().unwrap_or_default()).collect();
            }
            // The head of a table and the line below it quote no name of a row.
            if quoted(cells[1]).is_empty() {
                continue;
            }
            match section.strip_suffix(package).unwrap_or_default() {
                "Modules" => {
                    let of_crate = |(owner, cell): (&String, &&str)| -> Vec<String> {
                        let path = |name| if owner.is_empty() { name } else { format!("{owner}::{name}") };
                        quoted(cell).into_iter().map(path).collect()
                    };
                    let uses: Names = crates.iter().zip(&cells[3..]).flat_map(of_crate).collect();
                    let row = || Module { to_come: cells[1].contains("(to come)"), uses: uses.clone() };
                    rules.modules.extend(quoted(cells[1]).into_iter().map(|name| (name, row())));
                }
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

    /// Modules of other packages that this one uses, with their crates.
    pub fn foreign(&self) -> BTreeSet<&str> {
        self.modules
            .values()
            .flat_map(|module| &module.uses)
            .map(String::as_str)
            .filter(|name| is_foreign(name))
            .collect()
    }

    /// Every arrow between modules of the package, exceptions included, from the user to the used.
    fn arrows(&self) -> BTreeMap<&str, BTreeSet<&str>> {
        let mut arrows: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for (name, module) in &self.modules {
            let own = module.uses.iter().map(String::as_str).filter(|name| !is_foreign(name));
            arrows.entry(name).or_default().extend(own);
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
            .filter(|name| !self.modules.contains_key(*name))
            .map(|name| format!("the map names the module `{name}`, which has no row"))
            .collect();
        // Take away the modules that use none of those left, until nothing changes: what stays uses
        // itself in a circle.
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

    /// What `file` does against the rules; one sentence each. `exported` gives the module of each
    /// name that a `lib.rs` re-exports, both with their crate where it is another package's.
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
                    let root = if is_foreign(name) { "" } else { "crate::" };
                    violations.push(format!("{file}.rs: `{module}` may not use `{root}{name}`"));
                }
            }
        }
        for (names, places) in &self.confined {
            if !places.iter().any(|place| lies_in(file, place)) {
                let of_door = |name: &String| exported.get(name).map(|module| format!("{module}::{name}"));
                let named: Names =
                    source.outside.iter().cloned().chain(source.uses.iter().filter_map(of_door)).collect();
                let strays = names.intersection(&named);
                violations.extend(strays.map(|name| format!("{file}.rs: `{name}` belongs in {places:?} only")));
            }
        }
        violations
    }
}

//! Files of one module that use each other in a circle.
//!
//! A file uses another where a path outside its tests leads to an item that is defined there: an
//! import, or a longer path in the code. Re-exports are followed to the definition and are no use
//! by themselves, so that `mod.rs` counts as a file for what it defines. Methods and traits' items,
//! which no path names, are not seen.

use crate::rules::module_of;
use crate::source::{
    self, Source, before_colons, branches, continues_a_path, ident, is_punct, is_test_attribute, trees,
};
use proc_macro2::{Delimiter, TokenTree};
use std::collections::{BTreeMap, BTreeSet};

/// A file's imports and definitions, and the paths in its code. A path that is known from the root
/// begins with `crate`.
#[derive(Debug, Default)]
pub struct File {
    imports: Vec<Import>,
    defined: BTreeSet<String>,
    paths: Vec<Vec<String>>,
    /// First names of all paths outside imports.
    words: BTreeSet<String>,
}

#[derive(Debug)]
struct Import {
    /// In this file; `*` for a glob.
    name: String,
    path: Vec<String>,
    is_public: bool,
}

impl File {
    /// Reads `text`, the file `file` (relative to `src`, without `.rs`).
    pub fn read(file: &str, text: &str) -> Self {
        let mut read = Self::default();
        read.walk(&source::tokens_of(file, text), &source::module_of(file), true);
        read
    }

    fn walk(&mut self, tokens: &[TokenTree], module: &[&str], at_top: bool) {
        let mut at = 0;
        while let Some(token) = tokens.get(at) {
            match token {
                TokenTree::Punct(_) if is_test_attribute(tokens, at) => {
                    at = Source::default().skip_test_item(tokens, at, module);
                    continue;
                }
                // `pub(in crate::module)` uses nothing.
                TokenTree::Group(_) if at > 0 && ident(tokens, at - 1).as_deref() == Some("pub") => {}
                TokenTree::Group(group) => {
                    let is_module = at >= 2 && ident(tokens, at - 2).as_deref() == Some("mod");
                    let name = ident(tokens, at.wrapping_sub(1)).filter(|_| is_module);
                    let inner: Vec<&str> = module.iter().copied().chain(name.as_deref()).collect();
                    self.walk(&trees(group.stream()), &inner, false);
                }
                // `use<'a>` in a bound imports nothing.
                TokenTree::Ident(word) if word == "use" && !is_punct(tokens.get(at + 1), '<') => {
                    let end = (at..tokens.len()).find(|&at| is_punct(tokens.get(at), ';')).unwrap_or(tokens.len());
                    self.import(&tokens[at + 1..end], &[], module, is_public(&tokens[..at]));
                    at = end;
                }
                TokenTree::Ident(word) if !continues_a_path(tokens, at) => {
                    if at_top && ITEMS.contains(&word.to_string().as_str()) {
                        self.defined.extend(ident(tokens, at + 1));
                    }
                    let mut path = vec![word.to_string()];
                    while let Some(next) = ident(tokens, at + 3).filter(|_| before_colons(tokens, at)) {
                        path.push(next);
                        at += 3;
                    }
                    self.words.insert(path[0].clone());
                    if path.len() > 1 {
                        self.paths.push(from_root(path, module));
                    }
                }
                _ => {}
            }
            at += 1;
        }
    }

    /// Reads a branch of an import behind the names `stem`.
    fn import(&mut self, tokens: &[TokenTree], stem: &[String], module: &[&str], is_public: bool) {
        let mut path = stem.to_vec();
        let mut at = 0;
        while let Some(token) = tokens.get(at) {
            match token {
                TokenTree::Group(group) if group.delimiter() == Delimiter::Brace => {
                    for branch in branches(group.stream()) {
                        self.import(&branch, &path, module, is_public);
                    }
                    return;
                }
                TokenTree::Ident(word) if word == "as" => break,
                TokenTree::Ident(word) if word == "self" && !path.is_empty() => {}
                TokenTree::Ident(word) => path.push(word.to_string()),
                TokenTree::Punct(star) if star.as_char() == '*' => path.push("*".into()),
                _ => {}
            }
            at += 1;
        }
        let Some(last) = path.last().cloned() else { return };
        let name = ident(tokens, at + 1).filter(|_| at < tokens.len()).unwrap_or(last);
        self.imports.push(Import { name, path: from_root(path, module), is_public });
    }
}

const ITEMS: [&str; 9] = ["fn", "struct", "enum", "union", "trait", "type", "const", "static", "mod"];

/// Whether an item is public that comes after these tokens.
fn is_public(before: &[TokenTree]) -> bool {
    let restricted =
        matches!(before.last(), Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Parenthesis);
    ident(before, before.len().wrapping_sub(1 + usize::from(restricted))).as_deref() == Some("pub")
}

/// `path`, standing in `module`, with `crate` in place of `self` and `super` at its beginning.
fn from_root(path: Vec<String>, module: &[&str]) -> Vec<String> {
    let ups = path.iter().take_while(|name| *name == "super" || *name == "self").collect::<Vec<_>>();
    match path[0].as_str() {
        "cophase_paper" => ["crate".to_string()].into_iter().chain(path[1..].iter().cloned()).collect(),
        "super" | "self" => {
            let depth = module.len().saturating_sub(ups.iter().filter(|name| **name == "super").count());
            let start = ["crate"].into_iter().chain(module[..depth].iter().copied()).map(String::from);
            start.chain(path[ups.len()..].iter().cloned()).collect()
        }
        _ => path,
    }
}

/// The files of a package.
pub struct Package<'a> {
    files: &'a BTreeMap<String, File>,
    /// The file of each module.
    modules: BTreeMap<Vec<&'a str>, &'a str>,
}

impl<'a> Package<'a> {
    pub fn new(files: &'a BTreeMap<String, File>) -> Self {
        // `lib` and `main` are both the root: what is used is in `lib`.
        let modules = files.keys().rev().map(|file| (source::module_of(file), file.as_str())).collect();
        Self { files, modules }
    }

    /// Sets of files of one module, each of which uses all others, directly or through others of
    /// them.
    pub fn cycles(&self) -> Vec<BTreeSet<String>> {
        let uses: BTreeMap<&str, BTreeSet<&str>> =
            self.files.keys().map(|file| (file.as_str(), self.used(file))).collect();
        let reached: BTreeMap<&str, BTreeSet<&str>> = uses.keys().map(|file| (*file, reach(&uses, file))).collect();
        let circle = |file: &str| -> BTreeSet<String> {
            let back = reached[file].iter().filter(|other| reached[*other].contains(file));
            back.map(|other| other.to_string()).collect()
        };
        let circles: BTreeSet<_> = uses.keys().map(|file| circle(file)).filter(|circle| circle.len() > 1).collect();
        circles.into_iter().collect()
    }

    /// The other files of its module that `file` uses.
    pub fn used(&self, file: &str) -> BTreeSet<&'a str> {
        let (read, module) = (&self.files[file], source::module_of(file));
        let mut used = BTreeSet::new();
        for import in &read.imports {
            let is_used = !import.is_public || read.words.contains(&import.name);
            if import.name == "*" && !import.is_public {
                let glob = &import.path[..import.path.len() - 1];
                let named = read.words.iter().filter(|word| !read.defined.contains(*word));
                used.extend(
                    named.filter_map(|word| self.find(&[glob, std::slice::from_ref(word)].concat(), &module, true, 8)),
                );
            } else if is_used {
                used.extend(self.find(&import.path, &module, false, 8));
            }
        }
        used.extend(read.paths.iter().filter_map(|path| self.find(path, &module, false, 8)));
        used.retain(|other| *other != file && module_of(other) == module_of(file));
        used
    }

    /// The file that defines what `path`, standing in `module`, names; none for a module as a whole
    /// and for other crates. A name that no definition is seen of comes from a macro of the
    /// module's file, unless the search is `strict`.
    fn find(&self, path: &[String], module: &[&str], strict: bool, hops: usize) -> Option<&'a str> {
        if hops == 0 {
            return None;
        }
        let mut at: Vec<&str> = if path[0] == "crate" { Vec::new() } else { module.to_vec() };
        let names = if path[0] == "crate" { &path[1..] } else { path };
        for (depth, name) in names.iter().enumerate() {
            at.push(name);
            if self.modules.contains_key(&at) {
                continue;
            }
            at.pop();
            let file = *self.modules.get(&at)?;
            let read = &self.files[file];
            if read.defined.contains(name) {
                return Some(file);
            }
            let rest = &names[depth + 1..];
            if let Some(import) = read.imports.iter().find(|import| import.name == *name && import.path[0] != *name) {
                return self.find(&[&import.path[..], rest].concat(), &at, strict, hops - 1);
            }
            let globs = read.imports.iter().filter(|import| import.name == "*");
            let through = |import: &Import| {
                let glob = &import.path[..import.path.len() - 1];
                self.find(&[glob, &names[depth..]].concat(), &at, true, hops - 1)
            };
            // A name at the beginning of a path that is not from the root may be that of another
            // crate.
            let is_foreign = depth == 0 && path[0] != "crate";
            return globs
                .filter(|import| !import.path[..1].contains(name))
                .find_map(through)
                .or((!strict && !is_foreign).then_some(file));
        }
        None
    }
}

/// All that `start` uses, directly or through others; itself where it is among them.
fn reach<'a>(uses: &BTreeMap<&'a str, BTreeSet<&'a str>>, start: &str) -> BTreeSet<&'a str> {
    let mut reached = BTreeSet::new();
    let mut open: Vec<&str> = uses[start].iter().copied().collect();
    while let Some(file) = open.pop() {
        if reached.insert(file) {
            open.extend(&uses[file]);
        }
    }
    reached
}

//! What a source file names, by its tokens: comments and strings do not count, macro calls do,
//! `#[cfg(test)]` items do not.

use proc_macro2::{Delimiter, TokenStream, TokenTree};
use std::collections::{BTreeMap, BTreeSet};

/// What a file names.
#[derive(Debug, Default)]
pub struct Source {
    /// Names at the root of the crate that a path leads to: `crate::grid::Grid` and, from
    /// `pupil/mod.rs`, `super::grid` give `grid`. A glob of the root gives `*`, the root itself
    /// `self`. Those of another package of the workspace have its crate with them:
    /// `cophase_view::plot`.
    pub uses: BTreeSet<String>,
    /// First names of all other paths, so those of other crates; `extern "C"`; and items of the
    /// crate's modules, as `scene::Scene`.
    pub outside: BTreeSet<String>,
    /// Files declared as `#[cfg(test)] mod name;`: their paths under `src`, without `.rs`.
    pub test_files: Vec<String>,
}

impl Source {
    /// Reads `text`, the file `file` (relative to `src`, without `.rs`).
    pub fn read(file: &str, text: &str) -> Self {
        let mut source = Self::default();
        source.walk(&tokens_of(file, text), &module_of(file));
        source
    }

    /// Reads the tokens of the body of `module`.
    fn walk(&mut self, tokens: &[TokenTree], module: &[&str]) {
        let mut at = 0;
        while let Some(token) = tokens.get(at) {
            match token {
                TokenTree::Punct(_) if is_test_attribute(tokens, at) => {
                    at = self.skip_test_item(tokens, at, module);
                    continue;
                }
                // The braces of a path were read with the path.
                TokenTree::Group(_) if after_colons(tokens, at) => {}
                TokenTree::Group(group) => {
                    let body = trees(group.stream());
                    let inline = at >= 2 && ident(tokens, at - 2).as_deref() == Some("mod");
                    match ident(tokens, at.wrapping_sub(1)) {
                        Some(name) if inline => self.walk(&body, &[module, &[name.as_str()]].concat()),
                        _ => self.walk(&body, module),
                    }
                }
                TokenTree::Ident(name) if !continues_a_path(tokens, at) => match name.to_string().as_str() {
                    // The program `cophase-paper` and its library are one package.
                    "crate" | "cophase_paper" if before_colons(tokens, at) => self.follow(tokens, at + 3, 0, ""),
                    "cophase" | "cophase_numerics" | "cophase_view" | "cophase_watch" if before_colons(tokens, at) => {
                        self.follow(tokens, at + 3, 0, &format!("{name}::"));
                    }
                    "super" | "self" => self.follow(tokens, at, module.len(), ""),
                    "extern" if declares_c(tokens.get(at + 1)) => {
                        self.outside.insert("extern \"C\"".into());
                    }
                    name if before_colons(tokens, at) || is_imported(tokens, at) => {
                        self.outside.insert(name.into());
                    }
                    _ => {}
                },
                _ => {}
            }
            at += 1;
        }
    }

    /// Follows the path at `at`, whose beginning has led to a module `depth` levels below the root.
    /// `owner` precedes the names of another package.
    fn follow(&mut self, tokens: &[TokenTree], at: usize, depth: usize, owner: &str) {
        match tokens.get(at) {
            Some(TokenTree::Ident(name)) => match name.to_string().as_str() {
                "super" if before_colons(tokens, at) => self.follow(tokens, at + 3, depth.saturating_sub(1), owner),
                "self" if before_colons(tokens, at) => self.follow(tokens, at + 3, depth, owner),
                name if depth == 0 => {
                    self.uses.insert(format!("{owner}{name}"));
                    let within = Self::items_of(tokens, at);
                    self.outside.extend(within.into_iter().map(|item| format!("{owner}{name}::{item}")));
                }
                _ => {}
            },
            Some(TokenTree::Punct(star)) if star.as_char() == '*' && depth == 0 => {
                self.uses.insert(format!("{owner}*"));
            }
            Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace => {
                for branch in branches(group.stream()) {
                    self.follow(&branch, 0, depth, owner);
                }
            }
            _ => {}
        }
    }

    /// The items of the module at `at` that a path names directly.
    fn items_of(tokens: &[TokenTree], at: usize) -> Vec<String> {
        if !before_colons(tokens, at) {
            return Vec::new();
        }
        match tokens.get(at + 3) {
            Some(TokenTree::Ident(name)) => vec![name.to_string()],
            Some(TokenTree::Group(group)) => {
                branches(group.stream()).iter().filter_map(|branch| ident(branch, 0)).collect()
            }
            _ => Vec::new(),
        }
    }

    /// The position behind the item that the attribute at `at` takes out of the library.
    pub fn skip_test_item(&mut self, tokens: &[TokenTree], mut at: usize, module: &[&str]) -> usize {
        // An inner attribute, `#![cfg(test)]`, takes out the whole module.
        if is_punct(tokens.get(at + 1), '!') {
            return tokens.len();
        }
        let mut imports = false;
        while let Some(token) = tokens.get(at) {
            match token {
                TokenTree::Ident(word) if word == "use" => imports = true,
                TokenTree::Ident(word) if word == "mod" && is_punct(tokens.get(at + 2), ';') => {
                    let name = ident(tokens, at + 1).unwrap_or_default();
                    self.test_files.push([module, &[name.as_str()]].concat().join("/"));
                }
                TokenTree::Group(body) if body.delimiter() == Delimiter::Brace && !imports => return at + 1,
                TokenTree::Punct(mark) if mark.as_char() == ';' => return at + 1,
                _ => {}
            }
            at += 1;
        }
        at
    }
}

/// The tokens of the file `file`.
pub fn tokens_of(file: &str, text: &str) -> Vec<TokenTree> {
    trees(text.parse().unwrap_or_else(|error| panic!("{file}.rs: {error}")))
}

/// The module that is the file `file`, by the names that lead to it from the root.
pub fn module_of(file: &str) -> Vec<&str> {
    let path = file.strip_suffix("/mod").unwrap_or(if matches!(file, "lib" | "main") { "" } else { file });
    path.split('/').filter(|name| !name.is_empty()).collect()
}

/// The module of each name that the door, `lib.rs`, re-exports: `pub use error::{Error, Result}`
/// gives `Error → error`.
pub fn exported(door: &str) -> BTreeMap<String, String> {
    let tokens = trees(door.parse().expect("lib.rs does not parse"));
    let mut exported = BTreeMap::new();
    for item in tokens.split(|token| is_punct(Some(token), ';')) {
        let Some(start) = item.iter().position(|token| matches!(token, TokenTree::Ident(word) if word == "use")) else {
            continue;
        };
        let rooted = matches!(ident(item, start + 1).as_deref(), Some("crate" | "self"));
        let path = &item[start + if rooted { 4 } else { 1 }..];
        if let Some(module) = ident(path, 0) {
            exported.extend(leaves(path).into_iter().map(|name| (name, module.clone())));
        }
    }
    exported
}

/// The names that an import brings into scope.
fn leaves(path: &[TokenTree]) -> Vec<String> {
    match path.last() {
        Some(TokenTree::Group(group)) => branches(group.stream()).iter().flat_map(|branch| leaves(branch)).collect(),
        Some(TokenTree::Ident(name)) => vec![name.to_string()],
        _ => Vec::new(),
    }
}

pub fn trees(stream: TokenStream) -> Vec<TokenTree> {
    stream.into_iter().collect()
}

/// The members of a path's braces.
pub fn branches(stream: TokenStream) -> Vec<Vec<TokenTree>> {
    trees(stream).split(|token| is_punct(Some(token), ',')).map(<[_]>::to_vec).collect()
}

pub fn is_punct(token: Option<&TokenTree>, mark: char) -> bool {
    matches!(token, Some(TokenTree::Punct(punct)) if punct.as_char() == mark)
}

pub fn ident(tokens: &[TokenTree], at: usize) -> Option<String> {
    match tokens.get(at) {
        Some(TokenTree::Ident(name)) => Some(name.to_string()),
        _ => None,
    }
}

pub fn before_colons(tokens: &[TokenTree], at: usize) -> bool {
    is_punct(tokens.get(at + 1), ':') && is_punct(tokens.get(at + 2), ':')
}

fn after_colons(tokens: &[TokenTree], at: usize) -> bool {
    at >= 2 && is_punct(tokens.get(at - 2), ':') && is_punct(tokens.get(at - 1), ':')
}

/// Whether the name at `at` is a later part of a path, or a method; `::ocl` begins a path, and so
/// does `..ocl`.
pub fn continues_a_path(tokens: &[TokenTree], at: usize) -> bool {
    let before = |steps: usize| at.checked_sub(steps).and_then(|at| tokens.get(at));
    let named = at >= 3 && ident(tokens, at - 3).is_some_and(|name| name != "use");
    after_colons(tokens, at) && (named || is_punct(before(3), '>'))
        || is_punct(before(1), '.') && !is_punct(before(2), '.')
}

/// Whether the name at `at` is imported whole: `use ocl;`, `use ocl as cl;`, `extern crate ocl;`.
fn is_imported(tokens: &[TokenTree], at: usize) -> bool {
    at >= 1 && matches!(ident(tokens, at - 1).as_deref(), Some("use" | "crate"))
}

/// Whether `extern` before `token` is the ABI of C: `extern "C"`, `extern "C-unwind"`, and
/// `extern fn` or `extern {` for short.
fn declares_c(token: Option<&TokenTree>) -> bool {
    match token {
        Some(TokenTree::Literal(abi)) => abi.to_string().starts_with("\"C"),
        Some(TokenTree::Ident(word)) => word == "fn",
        Some(TokenTree::Group(_)) => true,
        _ => false,
    }
}

/// Whether `#[cfg(test)]`, `#[cfg(all(test, ...))]` or the inner form stands at `at`.
pub fn is_test_attribute(tokens: &[TokenTree], at: usize) -> bool {
    let body = at + 1 + usize::from(is_punct(tokens.get(at + 1), '!'));
    let Some(TokenTree::Group(attribute)) = tokens.get(body).filter(|_| is_punct(tokens.get(at), '#')) else {
        return false;
    };
    let text: String = attribute.to_string().split_whitespace().collect();
    text.starts_with("[cfg(test") || text.starts_with("[cfg(all(test")
}

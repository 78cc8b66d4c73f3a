//! Length of test names: at most 60 characters, so that a line of the test report names the failure
//! and fits. Number of public names. Columns of comments.

use super::source::exported;
use super::texts;

/// Largest number of public names of the library: their list fits a page.
const MOST_PUBLIC: usize = 120;

const LIMIT: usize = 60;
const FOLDERS: [&str; 7] = ["src", "tests", "numerics", "cli", "view", "watch", "paper"];

/// Names of the `#[test]` functions in `text` that are longer than `LIMIT`.
fn long_names(text: &str) -> Vec<&str> {
    let mut long = Vec::new();
    let mut lines = text.lines().map(str::trim);
    while lines.any(|line| line == "#[test]") {
        // Other attributes may stand between `#[test]` and its function.
        let name = lines.find_map(|line| line.strip_prefix("fn ")?.split('(').next());
        long.extend(name.filter(|name| name.len() > LIMIT));
    }
    long
}

#[test]
fn test_names_are_short() {
    let mut long = Vec::new();
    for folder in FOLDERS {
        for (file, text) in texts(folder) {
            long.extend(long_names(&text).into_iter().map(|name| format!("{folder}/{file}.rs: {name}")));
        }
    }
    assert!(long.is_empty(), "test names of more than {LIMIT} characters:\n{}\n", long.join("\n"));
}

#[test]
fn planted_long_test_name_is_found() {
    let (short, long) = ("a".repeat(LIMIT), "a".repeat(LIMIT + 1));
    let text =
        format!("fn {long}() {{}}\n#[test]\nfn {short}() {{}}\n    #[test]\n    #[ignore]\n    fn {long}() {{}}\n");
    assert_eq!(long_names(&text), [long.as_str()]);
}

/// Names that a file makes public: what it exports, and its functions.
fn public_names(text: &str) -> usize {
    let statements = text.split(';').filter_map(|statement| statement.split_once("pub use ").map(|(_, path)| path));
    let exports: usize = statements.map(|path| exported(&format!("use {path};")).len()).sum();
    exports + text.lines().filter(|line| line.starts_with("pub fn ")).count()
}

#[test]
fn public_interface_fits_a_page() {
    let sources = texts("src");
    let public = |file: &str| public_names(&sources[file]);
    // The public modules of `lib.rs`, without those of the feature `internals`.
    let door = &sources["lib"];
    let stable = door.lines().zip(door.lines().skip(1)).filter(|(before, _)| !before.starts_with("#["));
    let modules: Vec<&str> = stable.filter_map(|(_, line)| line.strip_prefix("pub mod ")?.strip_suffix(';')).collect();
    assert_eq!(modules, ["pipeline", "planner", "tracking"]);
    let count = public("lib") + modules.iter().map(|module| public(&format!("{module}/mod"))).sum::<usize>();
    println!("{count} public names");
    assert!(count > modules.len() && count <= MOST_PUBLIC, "{count} public names; at most {MOST_PUBLIC} are accepted");
}

#[test]
fn planted_public_names_are_counted() {
    let text = "mod a;\npub use a::{B, c::D};\nuse crate::E;\npub(crate) use a::F;\npub fn g() {\n    h();\n}\n";
    assert_eq!(public_names(text), 3);
}

/// Most columns of a comment.
const COLUMNS: usize = 100;

/// Lines of comments in `text` that are wider than `COLUMNS`. Tables, code and diagrams may be.
fn wide_comments(text: &str) -> Vec<&str> {
    let mut is_code = false;
    let comments = text.lines().filter_map(|line| {
        let comment = line.trim_start().strip_prefix("//")?.trim_start_matches(['/', '!', ' ']);
        is_code ^= comment.starts_with("```");
        Some((line, is_code || comment.starts_with('|')))
    });
    comments
        .filter(|(line, may_be_wide)| !may_be_wide && line.chars().count() > COLUMNS)
        .map(|(line, _)| line)
        .collect()
}

#[test]
fn comments_fit_their_columns() {
    let mut wide = Vec::new();
    for folder in FOLDERS {
        for (file, text) in texts(folder) {
            wide.extend(wide_comments(&text).into_iter().map(|line| format!("{folder}/{file}.rs: {line}")));
        }
    }
    assert!(wide.is_empty(), "comments of more than {COLUMNS} columns:\n{}\n", wide.join("\n"));
}

#[test]
fn planted_wide_comment_is_found() {
    let (wide, fits) = ("w".repeat(COLUMNS - 3), "f".repeat(COLUMNS - 4));
    let text =
        format!("/// {fits}\n    // {wide}\n//! | {wide} |\n//! ```\n//! {wide}\n//! ```\n//! {wide}\nlet {wide};\n");
    assert_eq!(wide_comments(&text), [format!("    // {wide}"), format!("//! {wide}")]);
}

//! Code blocks of the pages: each is run or compiled in its language. Scenes are small: a block
//! that names a preset gets one of the same kind with few samples and modes (`presets/`).
//!
//! A block that cannot be run has the comment `<!-- not run: REASON -->` on the line before it in
//! the page; the test `blocks_that_are_not_run_have_a_reason` prints them. What a page leaves out
//! (`frames`, `scene`, ...) is in `setup/PAGE.EXTENSION`.

#[path = "../../../tests/common/blocks.rs"]
mod blocks;
mod c;
#[path = "../../../tests/common/shell.rs"]
mod commands;
mod interpreters;
mod rust;
mod scenes;
mod shell;

use blocks::Block;
use std::path::{Path, PathBuf};

/// Languages whose blocks are run; blocks in others are text.
const CODE: [&str; 6] = ["c", "matlab", "python", "rust", "sh", "toml"];
const TEXT: [&str; 2] = ["", "text"];

fn root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

fn here() -> PathBuf {
    root().join("cli/tests/docs")
}

/// What a page's blocks in a language need, if it is anything: `PAGE.EXTENSION` before all of them,
/// `PAGE.N.EXTENSION` before block N.
fn setup(page: &str, extension: &str) -> Option<PathBuf> {
    let name = page.trim_end_matches(".md").replace('/', "-").to_lowercase();
    Some(here().join("setup").join(format!("{name}.{extension}"))).filter(|path| path.exists())
}

/// The folder of the libraries that cargo built along with this test.
fn libraries() -> PathBuf {
    std::env::current_exe().unwrap().parent().unwrap().into()
}

#[test]
fn blocks_that_are_not_run_have_a_reason() {
    let blocks = blocks::all();
    let run = |block: &&Block| block.reason.is_none();
    for language in CODE {
        let count = blocks.iter().filter(|block| block.language == language).filter(run).count();
        println!("{language}: {count} blocks are run");
        assert!(count > 0, "no page has a block in {language}: the pages are not read as they are written");
    }
    for block in blocks.iter().filter(|block| block.reason.is_some()) {
        println!("{block} ({}) is not run: {}", block.language, block.reason.as_deref().unwrap());
        assert!(block.reason.as_ref().is_some_and(|reason| reason.len() > 10), "{block}: its reason is too short");
    }
    let known = |block: &&Block| CODE.contains(&&*block.language) || TEXT.contains(&&*block.language);
    let unknown: Vec<String> = blocks
        .iter()
        .filter(run)
        .filter(|block| !known(block))
        .map(|block| format!("{block}: no test runs the language {:?}", block.language))
        .collect();
    assert!(unknown.is_empty(), "{}", unknown.join("\n"));
    // A command in a block of text would not be tried.
    let is_command = |text: &str| text.starts_with("cophase ") || text.starts_with("cophase-paper ");
    let commands: Vec<&Block> =
        blocks.iter().filter(|block| block.language.is_empty() && is_command(&block.text)).collect();
    assert!(commands.is_empty(), "commands without the language sh: {commands:?}");
}

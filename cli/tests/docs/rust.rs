//! Rust blocks: each is part of a function of `setup/PAGE.rs`, which is compiled here; the test compares the two.

use crate::blocks;
use crate::setup;

#[path = "setup/tracking.rs"]
mod tracking;

/// Lines without their indentation, which differs within a function.
fn lines(text: &str) -> Vec<&str> {
    text.lines().map(str::trim).filter(|line| !line.is_empty()).collect()
}

#[test]
fn rust_blocks_are_compiled() {
    for (page, blocks) in blocks::run_in("rust") {
        let source = setup(&page, "rs").unwrap_or_else(|| panic!("{page}: no file of setup/ has its Rust"));
        let source = std::fs::read_to_string(source).unwrap();
        let compiled = lines(&source);
        for block in blocks {
            let block_lines = lines(&block.text);
            let found = compiled.windows(block_lines.len()).any(|window| window == block_lines);
            assert!(found, "{block}: setup/ has another text than the page");
        }
    }
    tracking::example().unwrap();
}

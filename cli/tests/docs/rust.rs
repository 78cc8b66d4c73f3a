//! Rust blocks: each is part of a file that is compiled, `setup/PAGE.rs` here or the example of the
//! library; the test compares the texts.

use crate::blocks;
use crate::{root, setup};

// The text of the page, not the formatter's; a loop of it names what it does not use.
#[rustfmt::skip]
#[allow(unused_variables)]
#[path = "setup/tracking.rs"]
mod tracking;

/// Lines without their indentation, which differs within a function.
fn lines(text: &str) -> Vec<&str> {
    text.lines().map(str::trim).filter(|line| !line.is_empty()).collect()
}

#[test]
fn rust_blocks_are_compiled() {
    for (page, blocks) in blocks::run_in("rust") {
        let source = setup(&page, "rs").unwrap_or(root().join("examples/one_image.rs"));
        let source = std::fs::read_to_string(source).unwrap();
        let compiled = lines(&source);
        for block in blocks {
            let block_lines = lines(&block.text);
            let found = compiled.windows(block_lines.len()).any(|window| window == block_lines);
            assert!(found, "{block}: no compiled file has this text");
        }
    }
    tracking::example().unwrap();
}

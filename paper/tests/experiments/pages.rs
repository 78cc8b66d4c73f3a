//! The command lines `cophase-paper ...` of the pages, in blocks and between backticks, are those
//! that the program accepts.

use crate::PROGRAM;
use crate::blocks::{self, Block};
use crate::shell::try_lines;

/// The request for help behind all other words: words that are not accepted are an error before it.
const ACCEPTS: &str = "\"$PROGRAM\" \"$@\" --help >/dev/null";

fn try_block(block: &Block) -> Result<usize, String> {
    try_lines(block, "cophase-paper", PROGRAM, ACCEPTS)
}

#[test]
fn command_lines_of_pages_are_accepted() {
    let pages = blocks::run_in("sh");
    let with_lines = pages.iter().flat_map(|(_, blocks)| blocks).filter(|block| block.text.contains("cophase-paper"));
    let inline = blocks::inline_commands("cophase-paper");
    let tried: Vec<Result<usize, String>> = with_lines.chain(&inline).map(try_block).collect();
    let refused: Vec<&String> = tried.iter().filter_map(|result| result.as_ref().err()).collect();
    assert!(refused.is_empty(), "{refused:#?}");
    let accepted: usize = tried.iter().flatten().sum();
    println!("{accepted} command lines are accepted");
    assert!(accepted > 30, "{accepted} command lines were found");
}

#[test]
fn wrong_command_line_is_refused() {
    let block =
        |text: &str| Block { page: "none.md".into(), line: 1, language: "sh".into(), text: text.into(), reason: None };
    let wrong = ["tables -o results", "table -o results --seed 3", "table -o results --part 9/8", "bench --batch 0"];
    for words in wrong {
        assert!(try_block(&block(&format!("cophase-paper {words}"))).is_err(), "{words} is accepted");
    }
    assert_eq!(try_block(&block("mpirun -n 2 cophase-paper beyond -o results --part rank")), Ok(1));
}

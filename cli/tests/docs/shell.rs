//! Shell blocks: each line `cophase ...` must be accepted by the program's parser of the command
//! line, and other commands must be among those that are known (`tests/common/shell.rs`), which do
//! nothing: `sudo make install` is not for a test. Lines `cophase-paper ...` are tried by the tests
//! of `paper/`.
//!
//! With `COPHASE_LONG_TESTS=1` (`scripts/test --all`) the lines of pages that begin with nothing
//! but a preset are run, too, one after the other in one folder, with small scenes in place of the
//! presets.

use crate::blocks::{self, Block};
use crate::commands::{shell, try_lines};
use crate::here;

const PROGRAM: &str = env!("CARGO_BIN_EXE_cophase");

/// Parses a command line without running it.
const ACCEPTS: &str = "\"$PROGRAM\" manual --accepts -- \"$@\"";

/// Runs the program with small scenes in place of presets. An estimate with warnings is one
/// (`--strict`).
const SMALL_PROGRAM: &str = "#!/bin/bash
words=()
for word; do
    [[ ! -f $PRESETS/$word.toml ]] || word=$PRESETS/$word.toml
    words+=(\"$word\")
done
\"$PROGRAM\" \"${words[@]}\" || { status=$?; [[ $status == 3 ]] || exit $status; }
";

/// Pages whose lines need no files but those that they make, and what makes the reader's own. A
/// scene that a page begins with is `scene.toml`.
const WHOLE: [(&str, &str); 3] = [
    ("README.md", ""),
    ("quickstart.md", ""),
    ("your-telescope.md", "cophase image scene.toml --set image.peak_snr=200 -o images.fits"),
];

fn try_block(block: &Block) -> Result<usize, String> {
    try_lines(block, "cophase", PROGRAM, ACCEPTS)
}

#[test]
fn whole_pages_run() {
    if std::env::var_os("COPHASE_LONG_TESTS").is_none_or(|value| value != "1") {
        println!("skipped: COPHASE_LONG_TESTS is not 1");
        return;
    }
    let (pages, scenes) = (blocks::run_in("sh"), blocks::run_in("toml"));
    for (name, own_files) in WHOLE {
        let (_, blocks) = pages.iter().find(|(page, _)| page == name).expect("the page has blocks");
        let folder = tempfile::tempdir().unwrap();
        if let Some((_, scenes)) = scenes.iter().find(|(page, _)| page == name) {
            std::fs::write(folder.path().join("scene.toml"), &scenes[0].text).unwrap();
        }
        for text in std::iter::once(own_files).chain(blocks.iter().map(|block| block.text.as_str())) {
            let output = shell(text, "cophase", SMALL_PROGRAM, folder.path())
                .env("PROGRAM", PROGRAM)
                .env("PRESETS", here().join("presets"))
                .output()
                .unwrap();
            let complaint = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success() && !complaint.contains("not found"), "{name}: {text}: {complaint}");
        }
        assert!(folder.path().join("est.fits").exists(), "{name} makes no estimate");
    }
}

#[test]
fn command_lines_are_accepted() {
    let pages = blocks::run_in("sh");
    let tried: Vec<Result<usize, String>> = pages.iter().flat_map(|(_, blocks)| blocks).map(try_block).collect();
    let refused: Vec<&String> = tried.iter().filter_map(|result| result.as_ref().err()).collect();
    assert!(refused.is_empty(), "{refused:#?}");
    let accepted: usize = tried.iter().flatten().sum();
    println!("{accepted} command lines of {} blocks are accepted", tried.len());
    assert!(accepted > 30, "{accepted} command lines were found");
}

#[test]
fn a_wrong_line_is_refused() {
    let block =
        |text: &str| Block { page: "none.md".into(), line: 1, language: "sh".into(), text: text.into(), reason: None };
    for wrong in ["cophase estimate a.fits --no-such-option 1", "mpirun -n 2 cophase no-such-verb", "no-such-command"] {
        assert!(try_block(&block(wrong)).is_err(), "{wrong} is accepted");
    }
    assert_eq!(try_block(&block("for i in 1 2; do cophase scene > $i.toml; done")), Ok(2));
}

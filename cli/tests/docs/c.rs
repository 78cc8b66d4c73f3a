//! C blocks: whole programs are compiled, linked and run; lines of a program are compiled within a
//! function, below the declarations of `setup/PAGE.c`. `docs/c.md` begins with a program that
//! `tests/install` runs with an installed library.

use crate::blocks::{self, Block};
use crate::{libraries, root, setup};
use std::path::Path;
use std::process::Command;

const FLAGS: [&str; 4] = ["-std=c99", "-Wall", "-Werror", "-Wno-unused-variable"];

fn compiler() -> Command {
    let mut compiler = Command::new("cc");
    compiler.args(FLAGS).arg("-I").arg(root().join("include"));
    compiler
}

fn succeeds(command: &mut Command, block: &Block) {
    let output = command.output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{block}: {command:?}: {}\n{said}", output.status);
}

/// The lines in a function of a program that has what they name.
fn in_function(block: &Block) -> String {
    let declarations = setup(&block.page, "c").map_or(String::new(), |path| std::fs::read_to_string(path).unwrap());
    format!("{declarations}\nvoid lines(void);\nvoid lines(void)\n{{\n{}}}\n", block.text)
}

fn compile(block: &Block, folder: &Path) {
    let source = folder.join("block.c");
    if !block.text.contains("int main(") {
        std::fs::write(&source, in_function(block)).unwrap();
        return succeeds(compiler().arg("-fsyntax-only").arg(&source), block);
    }
    std::fs::write(&source, &block.text).unwrap();
    if block.page == "c.md" {
        return succeeds(compiler().arg("-fsyntax-only").arg(&source), block);
    }
    let program = folder.join("block");
    let rpath = format!("-Wl,-rpath,{}", libraries().display());
    succeeds(
        compiler().arg(&source).arg("-L").arg(libraries()).args(["-lcophase", "-lm", &rpath, "-o"]).arg(&program),
        block,
    );
    // cargo's own search path begins with a folder where an older library may lie.
    succeeds(Command::new(&program).current_dir(folder).env("LD_LIBRARY_PATH", libraries()), block);
}

#[test]
fn c_blocks_compile() {
    let folder = tempfile::tempdir().unwrap();
    for (_, blocks) in blocks::run_in("c") {
        blocks.iter().for_each(|block| compile(block, folder.path()));
    }
}

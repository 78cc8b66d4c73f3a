//! Shell blocks: each line `cophase ...` must be accepted by the program's parser of the command line, and other commands must be among
//! those that are known here, which do nothing: `sudo make install` is not for a test.
//!
//! With `COPHASE_LONG_TESTS=1` (`scripts/test --all`) the lines of pages that begin with nothing but a preset are run, too, one after
//! the other in one folder, with small scenes in place of the presets.

use crate::blocks::{self, Block};
use crate::here;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

/// Writes the words of a refused command line to the file REFUSED, and goes on, so that all are seen.
const PROGRAM: &str = "#!/bin/bash
\"$COPHASE\" manual --accepts -- \"$@\" 2>>\"$FOLDER/refused\" || echo \"cophase $*\" >>\"$FOLDER/refused\"
echo \"$*\" >>\"$FOLDER/accepted\"
";

/// Runs the program with small scenes in place of presets. An estimate with warnings is one (`--strict`).
const SMALL_PROGRAM: &str = "#!/bin/bash
words=()
for word; do
    [[ ! -f $PRESETS/$word.toml ]] || word=$PRESETS/$word.toml
    words+=(\"$word\")
done
\"$COPHASE\" \"${words[@]}\" || { status=$?; [[ $status == 3 ]] || exit $status; }
";

/// Pages whose lines need no files but those that they make, and what makes the reader's own. A scene that a page begins with is
/// `scene.toml`.
const WHOLE: [(&str, &str); 3] = [
    ("README.md", ""),
    ("quickstart.md", ""),
    ("your-telescope.md", "cophase image scene.toml --set image.peak_snr=200 -o images.fits"),
];

/// Runs the program behind a launcher's own words, if there is one.
const LAUNCHER: &str = "#!/bin/bash
while (($# > 0)) && [[ $1 != cophase ]]; do shift; done
(($# == 0)) || exec \"$@\"
";

/// Commands of the blocks that start nothing here.
const SILENT: [&str; 10] =
    ["cargo", "cc", "make", "openssl", "pip", "pkg-config", "sbatch", "sudo", "scripts/demo", "scripts/test"];
const LAUNCHERS: [&str; 2] = ["mpirun", "srun"];

fn script(path: &Path, text: &str) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).unwrap();
}

/// A shell for the text of a block in `folder`, whose `cophase` is the script `program`.
fn shell(text: &str, program: &str, folder: &Path) -> Command {
    let commands = folder.join("commands");
    script(&commands.join("cophase"), program);
    LAUNCHERS.iter().for_each(|name| script(&commands.join(name), LAUNCHER));
    // A path is that of a script in the working folder.
    let at = |name: &str| if name.contains('/') { folder.join(name) } else { commands.join(name) };
    SILENT.iter().for_each(|name| script(&at(name), "#!/bin/bash\n"));
    let mut shell = Command::new("/bin/bash");
    shell.args(["-eu", "-c", text]).current_dir(folder).env("PATH", &commands);
    shell.env("COPHASE", env!("CARGO_BIN_EXE_cophase")).env("FOLDER", folder).env("PRESETS", here().join("presets"));
    // Of a job of an array.
    shell.env("SLURM_ARRAY_TASK_ID", "1").env("HOME", folder);
    shell
}

/// The command lines of `cophase` in a block that are accepted, or what is refused.
fn try_lines(block: &Block) -> Result<usize, String> {
    let folder = tempfile::tempdir().unwrap();
    let output = shell(&block.text, PROGRAM, folder.path()).output().unwrap();
    let complaint = String::from_utf8_lossy(&output.stderr);
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap_or_default();
    if !output.status.success() || complaint.contains("not found") || !read("refused").is_empty() {
        return Err(format!("{block}: {}\n{complaint}{}", output.status, read("refused")));
    }
    Ok(read("accepted").lines().count())
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
            let output = shell(text, SMALL_PROGRAM, folder.path()).output().unwrap();
            let complaint = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success() && !complaint.contains("not found"), "{name}: {text}: {complaint}");
        }
        assert!(folder.path().join("est.fits").exists(), "{name} makes no estimate");
    }
}

#[test]
fn command_lines_are_accepted() {
    let pages = blocks::run_in("sh");
    let tried: Vec<Result<usize, String>> = pages.iter().flat_map(|(_, blocks)| blocks).map(try_lines).collect();
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
        assert!(try_lines(&block(wrong)).is_err(), "{wrong} is accepted");
    }
    assert_eq!(try_lines(&block("for i in 1 2; do cophase scene > $i.toml; done")), Ok(2));
}

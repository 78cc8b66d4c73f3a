//! A shell in which the commands of the pages do nothing, but for those of the program under test.

#![allow(dead_code, reason = "not every package runs whole pages")]

use crate::blocks::Block;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::Command;

/// Runs a program of ours behind a launcher's own words, if there is one.
const LAUNCHER: &str = "#!/bin/bash
while (($# > 0)) && [[ $1 != cophase && $1 != cophase-paper ]]; do shift; done
(($# == 0)) || exec \"$@\"
";
const LAUNCHERS: [&str; 2] = ["mpirun", "srun"];

/// Commands of the blocks that start nothing here. Each program of ours is tried by the tests of
/// its own package.
const SILENT: [&str; 12] = [
    "cargo",
    "cc",
    "cophase",
    "cophase-paper",
    "make",
    "openssl",
    "pip",
    "pkg-config",
    "sbatch",
    "sudo",
    "scripts/demo",
    "scripts/test",
];

fn script(path: &Path, text: &str) {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, text).unwrap();
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).unwrap();
}

/// A shell for `text` in `folder`, in which the command `name` is the script `program`.
pub fn shell(text: &str, name: &str, program: &str, folder: &Path) -> Command {
    let commands = folder.join("commands");
    // A path is that of a script in the working folder.
    let at = |name: &str| if name.contains('/') { folder.join(name) } else { commands.join(name) };
    SILENT.iter().for_each(|name| script(&at(name), "#!/bin/bash\n"));
    LAUNCHERS.iter().for_each(|name| script(&at(name), LAUNCHER));
    script(&at(name), program);
    let mut shell = Command::new("/bin/bash");
    shell.args(["-eu", "-c", text]).current_dir(folder).env("PATH", &commands).env("FOLDER", folder);
    // Of a job of an array.
    shell.env("SLURM_ARRAY_TASK_ID", "1").env("HOME", folder);
    shell
}

/// The command lines of the program `name` in a block that are accepted, or what is refused.
/// `accepts` is a command that ends with status 0, and says nothing on stderr, where the program
/// `$PROGRAM` accepts its arguments.
pub fn try_lines(block: &Block, name: &str, program: &str, accepts: &str) -> Result<usize, String> {
    // A refused line goes to a file, and the block goes on, so that all are seen.
    let wrapper = format!(
        "#!/bin/bash\n{accepts} 2>>\"$FOLDER/refused\" || echo \"{name} $*\" >>\"$FOLDER/refused\"\n\
         echo \"$*\" >>\"$FOLDER/accepted\"\n"
    );
    let folder = tempfile::tempdir().unwrap();
    let output = shell(&block.text, name, &wrapper, folder.path()).env("PROGRAM", program).output().unwrap();
    let complaint = String::from_utf8_lossy(&output.stderr);
    let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).unwrap_or_default();
    if !output.status.success() || complaint.contains("not found") || !read("refused").is_empty() {
        return Err(format!("{block}: {}\n{complaint}{}", output.status, read("refused")));
    }
    Ok(read("accepted").lines().count())
}

//! `cophase completions`: completion of the command line in a shell.

use clap::Command;
use clap_complete::Shell;
use cophase::{Error, Result};
use cophase_view::terminal::Terminal;

const EXAMPLES: &str = "Examples:
  cophase completions bash > ~/.local/share/bash-completion/completions/cophase
  cophase completions zsh > ~/.zfunc/_cophase          in a folder of fpath
  cophase completions fish > ~/.config/fish/completions/cophase.fish";

/// Print the script that completes verbs and options in a shell
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Shell of the script
    #[arg(value_enum)]
    shell: Shell,
}

/// Runs the verb for `program`, the command line.
pub fn run(arguments: &Arguments, mut program: Command, terminal: &Terminal) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut program, "cophase", &mut script);
    let script = String::from_utf8(script).map_err(|error| Error::Internal(error.to_string()))?;
    terminal.print(&script)
}

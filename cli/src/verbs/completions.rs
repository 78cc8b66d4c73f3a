//! `cophase completions`: completion of the command line in a shell.

use super::Cli;
use crate::terminal::Terminal;
use clap::CommandFactory;
use clap_complete::Shell;
use cophase::{Error, Result};

const EXAMPLES: &str = "Examples:
  cophase completions bash > ~/.local/share/bash-completion/completions/cophase
  cophase completions zsh > ~/.zfunc/_cophase          in a folder of fpath
  cophase completions fish > ~/.config/fish/completions/cophase.fish";

/// Print the script that completes verbs and options in a shell
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Shell of the script
    #[arg(value_enum)]
    shell: Shell,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut Cli::command(), "cophase", &mut script);
    let script = String::from_utf8(script).map_err(|error| Error::Internal(error.to_string()))?;
    terminal.print(&script)
}

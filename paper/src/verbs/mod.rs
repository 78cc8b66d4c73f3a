//! The command line: a target to reproduce, or the bench.

mod bench;
mod reproduce;

use clap::{Parser, Subcommand};
use cophase::{Error, Result};
use cophase_view::terminal::Terminal;
use std::process::ExitCode;

/// Repeat the experiments of Lamb et al. (2021), the paper: tables and pictures, its way beside
/// ours
#[derive(Parser)]
#[command(
    name = "cophase-paper",
    version,
    after_help = reproduce::after_help(),
    max_term_width = 100,
    args_conflicts_with_subcommands = true,
    subcommand_negates_reqs = true
)]
pub struct Cli {
    #[command(subcommand)]
    verb: Option<Verb>,
    #[command(flatten)]
    reproduce: Option<reproduce::Arguments>,
    /// Print errors only (and what --json asks for)
    #[arg(short, long, global = true, display_order = 900)]
    quiet: bool,
}

#[derive(Subcommand)]
enum Verb {
    Bench(bench::Arguments),
}

/// Runs the target or the bench.
///
/// # Errors
/// Those of what is run.
pub fn run(cli: Cli) -> Result<ExitCode> {
    let terminal = Terminal::new(cli.quiet);
    match (cli.verb, cli.reproduce) {
        (Some(Verb::Bench(arguments)), _) => bench::run(&arguments, &terminal),
        (None, Some(arguments)) => reproduce::run(&arguments, &terminal),
        (None, None) => Err(Error::Value("no target is named: see 'cophase-paper --help'".into())),
    }?;
    Ok(ExitCode::SUCCESS)
}

//! The program `cophase`: parses the command line, runs a verb, says in one line why it failed.

mod verbs;

use clap::Parser;
use cophase_view::{allocator, program};
use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: allocator::Allocator = allocator::Allocator;

fn main() -> ExitCode {
    let cli = verbs::Cli::parse();
    program::run(|| verbs::run(cli))
}

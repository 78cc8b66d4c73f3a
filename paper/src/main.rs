//! The program `cophase-paper`: the experiments of the paper, and speed against error.

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

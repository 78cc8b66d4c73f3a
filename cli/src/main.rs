//! The program `cophase`: parses the command line, runs a verb, says in one line why it failed.

mod allocator;
mod files;
mod html;
mod interrupt;
mod outputs;
mod panics;
mod ranks;
mod terminal;
mod verbs;
mod watch;

use clap::Parser;
use cophase::Error;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: allocator::Allocator = allocator::Allocator;

fn main() -> ExitCode {
    let cli = verbs::Cli::parse();
    let panic = panics::catch_panics();
    // What a verb holds is dropped on the way here: temporary files go, and files that were there stay.
    let outcome = catch_unwind(AssertUnwindSafe(|| verbs::run(cli)));
    match outcome.unwrap_or_else(|_| Err(Error::Panic(panic.sentence()))) {
        Ok(status) => status,
        Err(error) => verbs::fail(&error),
    }
}

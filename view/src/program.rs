//! The run of a program: what precedes its verb, and what a failure of the verb leaves on the
//! terminal and as exit status.

use crate::panics::catch_panics;
use crate::{interrupt, terminal};
use cophase::{Error, Result};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::process::ExitCode;

/// Runs `verb`. Results go to stdout; messages, warnings and progress to stderr. Exit status: that
/// of the verb, 1 (failed), 130 (stopped by Ctrl-C or SIGTERM, as shells count it).
pub fn run(verb: impl FnOnce() -> Result<ExitCode>) -> ExitCode {
    let panic = catch_panics();
    // What a verb holds is dropped on the way here: temporary files go, and files that were there
    // stay.
    let outcome = catch_unwind(AssertUnwindSafe(|| interrupt::prepare_process().and_then(|()| verb())));
    interrupt::verb_has_ended();
    match outcome.unwrap_or_else(|_| Err(Error::Panic(panic.sentence()))) {
        Ok(status) => status,
        Err(error) => fail(&error),
    }
}

/// Says why, on one line, and gives the exit status.
fn fail(error: &Error) -> ExitCode {
    terminal::complain(&error.to_string());
    match error {
        Error::Interrupted(_) => ExitCode::from(interrupt::EXIT_STATUS),
        _ => ExitCode::FAILURE,
    }
}

//! `cophase estimate`: the main job.

mod arguments;
mod inputs;
mod part;
mod ranks;
mod report;
mod summary;
mod whole;

pub use arguments::Arguments;
pub use part::merge;
pub use whole::{estimated, print, write};

use crate::interrupt::Interrupt;
use crate::ranks::Share;
use crate::terminal::Terminal;
use cophase::Result;
use std::process::ExitCode;

pub fn run(arguments: Arguments, terminal: &Terminal) -> Result<ExitCode> {
    let interrupt = Interrupt::catch()?;
    match arguments.part {
        None => whole::whole(arguments, &[], terminal, &interrupt),
        Some(Share::Part(part)) => part::write(&arguments, part, terminal, &interrupt),
        Some(Share::Rank) => ranks::run(arguments, terminal, &interrupt),
    }
}

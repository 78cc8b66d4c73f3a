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

use cophase::Result;
use cophase_view::interrupt::Interrupt;
use cophase_view::ranks::Share;
use cophase_view::terminal::Terminal;
use std::process::ExitCode;

pub fn run(arguments: Arguments, terminal: &Terminal) -> Result<ExitCode> {
    let interrupt = Interrupt::catch()?;
    match arguments.part {
        None => whole::estimate_whole(arguments, Vec::new(), terminal, &interrupt),
        Some(Share::Part(part)) => part::write(&arguments, part, terminal, &interrupt),
        Some(Share::Rank) => ranks::run(arguments, terminal, &interrupt),
    }
}

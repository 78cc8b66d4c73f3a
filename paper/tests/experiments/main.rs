//! The experiments, run in this process, and the command line of the program.

mod bench;
mod channels;
mod command_line;
#[path = "../../../tests/common/desk.rs"]
mod desk;
mod hard_cases;
mod leak;
mod metrics;
mod night_table;
mod paper;
mod pulls;
mod pyramid;

use desk::{Desk, number};

/// The program under test.
const PROGRAM: &str = env!("CARGO_BIN_EXE_cophase-paper");

//! The experiments, run in this process, and the command line of the program.

mod bad_pixels;
mod bench;
#[path = "../../../tests/common/blocks.rs"]
mod blocks;
mod channels;
mod command_line;
#[path = "../../../tests/common/desk.rs"]
mod desk;
mod faults;
mod groups;
mod leak;
mod left_out;
mod metrics;
mod moving_star;
mod night_table;
mod one_wavefront;
mod pages;
mod paper;
mod pulls;
mod pyramid;
#[path = "../../../tests/common/shell.rs"]
mod shell;

use desk::{Desk, number};

/// The program under test.
const PROGRAM: &str = env!("CARGO_BIN_EXE_cophase-paper");

//! The program as a person or a script runs it: each test starts the binary in a folder of its own.

mod aot;
mod bad_input;
mod cards;
mod channels;
mod check;
mod commands;
mod compressed;
#[path = "../../../tests/common/desk.rs"]
mod desk;
mod drivers;
#[cfg(debug_assertions)]
mod faults;
mod filter;
mod foreign;
mod frames;
mod headers;
mod interrupt;
mod manual;
mod memory;
mod observe;
mod odd_images;
mod one_wavefront;
mod orientation;
mod outputs;
mod parts;
mod ranks;
mod raw_frames;
mod reduce;
mod report;
mod same_answer;
mod sentences;
mod simulate;
mod slopes;
mod truth;
mod units;
mod verbs;
mod words;

use desk::{Desk, Done, SMALL, number, text_column};

/// The program under test.
const PROGRAM: &str = env!("CARGO_BIN_EXE_cophase");

//! `cophase watch`: each frame counts exactly once, also across kills, restarts and full disks.

mod browser;
mod common;
mod corrections;
#[path = "../../../tests/common/desk.rs"]
mod desk;
mod faults;
mod folder;
mod night;
mod page;
mod pointing;
mod stream;

use common::*;
use cophase_watch::rusqlite;
use desk::{Desk, Done, SMALL};
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

/// The program under test.
const PROGRAM: &str = env!("CARGO_BIN_EXE_cophase");

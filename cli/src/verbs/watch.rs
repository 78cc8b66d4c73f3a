//! `cophase watch` in a program that was built without it.

use cophase::{Error, Result};
use cophase_view::terminal::Terminal;
use std::ffi::OsString;

const INSTEAD: &str = "'cophase watch' is not in this program, which was built without the feature 'watch': 'cargo install --path cli' installs \
one that has it";

/// Estimate every frame that appears in a folder (this program was built without it)
#[derive(clap::Args)]
#[command(after_help = INSTEAD)]
pub struct Arguments {
    #[arg(hide = true, trailing_var_arg = true, allow_hyphen_values = true)]
    words: Vec<OsString>,
}

pub fn run(_: &Arguments, _: &Terminal) -> Result<()> {
    Err(Error::Value(INSTEAD.into()))
}

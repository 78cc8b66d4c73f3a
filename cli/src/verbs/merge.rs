//! `cophase merge`: the estimate of all parts.

use super::estimate;
use cophase::Result;
use cophase_view::terminal::Terminal;
use std::path::PathBuf;
use std::process::ExitCode;

const EXAMPLES: &str = "Examples:
  cophase merge part*.fits -o est.fits
  cophase merge part*.fits -o est.fits --json --strict

The parts are files of 'cophase estimate ... --part I/N', each of them once. The images and the other files of that command are read \
again, in the folder where it ran, and what its options ask for (--plot, --commands, ...) is made. The estimate has the bits of \
one run; its fits are those of the parts, and merge makes those that depend on all images (restarts of outliers, a larger model).";

/// Make the estimate of all parts of 'cophase estimate --part I/N'
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Files of all parts, in any order
    #[arg(required = true, value_name = "PART")]
    parts: Vec<PathBuf>,
    /// FITS file to write; one that is there is replaced; .fits.gz is compressed
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Exit with status 3 where the estimate carries a warning, or a status other than ok
    #[arg(long)]
    strict: bool,
    /// Also say how many fits no part had
    #[arg(short, long)]
    verbose: bool,
}

pub fn run(arguments: Arguments, terminal: &Terminal) -> Result<ExitCode> {
    let Arguments { parts, output, json, strict, verbose } = arguments;
    estimate::merge(&parts, output, [json, strict, verbose], terminal)
}

//! The command line: one file per verb, and what they share.
//!
//! Results go to stdout; messages, warnings and progress to stderr. Exit status: 0, 1 (failed), 2
//! (bad usage), 130 (stopped by Ctrl-C or SIGTERM, as shells count it).

mod check;
mod compare;
mod completions;
mod demo;
mod devices;
mod estimate;
mod image;
mod manual;
mod merge;
mod moves;
mod numbering;
mod observe;
mod one_channel;
mod picture;
mod plan;
mod reduce;
mod scene;
mod simulate;
#[cfg(not(feature = "watch"))]
mod watch;

use clap::{CommandFactory, Parser, Subcommand};
use cophase::Result;
use cophase_view::terminal::Terminal;
#[cfg(feature = "watch")]
use cophase_watch::arguments as watch;
use std::process::ExitCode;

const ABOUT: &str = "Reads defocused images of a star; says what the mirror segments, and what the optics behind the \
adaptive optics, do to the wavefront: in nm, with error bars.";

const FIRST_STEPS: &str = "First steps:
  cophase demo -o demo-output                   an image, an estimate, a picture
  cophase scene keck-artificial > scene.toml    a documented scene to edit
  cophase image scene.toml -o images.fits       a simulated image with its truth
  cophase estimate images.fits -o est.fits      phasing and NCPA maps from it
  cophase compare est.fits --truth images.fits  how far they are from the truth
  cophase plan keck-artificial --budget-nm 1    the cheapest model for 1 nm
  cophase simulate keck-onsky -o onsky.fits     a minute of sky behind an AO loop

Exit status: 0 done, 1 failed (one line on stderr says why), 2 bad usage, 3 an estimate with warnings or a \
check with a fault under --strict, 130 stopped by Ctrl-C or SIGTERM.";

/// What the command line says.
#[derive(Parser)]
#[command(name = "cophase", version, about = ABOUT, after_help = FIRST_STEPS, max_term_width = 100)]
pub struct Cli {
    #[command(subcommand)]
    verb: Verb,
    /// Print errors only (and what --json asks for)
    #[arg(short, long, global = true, display_order = 900)]
    quiet: bool,
}

#[derive(Subcommand)]
enum Verb {
    Scene(scene::Arguments),
    Image(image::Arguments),
    Simulate(simulate::Arguments),
    Reduce(reduce::Arguments),
    Estimate(Box<estimate::Arguments>),
    Merge(merge::Arguments),
    Plan(plan::Arguments),
    Compare(compare::Arguments),
    Check(check::Arguments),
    Devices(devices::Arguments),
    Demo(demo::Arguments),
    Watch(Box<watch::Arguments>),
    Completions(completions::Arguments),
    Manual(manual::Arguments),
}

/// Runs the verb.
///
/// # Errors
/// Those of the verb.
pub fn run(cli: Cli) -> Result<ExitCode> {
    let terminal = Terminal::new(cli.quiet);
    match cli.verb {
        Verb::Scene(arguments) => scene::run(&arguments, &terminal),
        Verb::Image(arguments) => image::run(&arguments, &terminal),
        Verb::Simulate(arguments) => simulate::run(&arguments, &terminal),
        Verb::Reduce(arguments) => reduce::run(&arguments, &terminal),
        Verb::Estimate(arguments) => return estimate::run(*arguments, &terminal),
        Verb::Merge(arguments) => return merge::run(arguments, &terminal),
        Verb::Plan(arguments) => plan::run(&arguments, &terminal),
        Verb::Compare(arguments) => compare::run(&arguments, &terminal),
        Verb::Check(arguments) => return check::run(&arguments, &terminal),
        Verb::Devices(arguments) => devices::run(&arguments, &terminal),
        Verb::Demo(arguments) => demo::run(&arguments, &terminal),
        Verb::Watch(arguments) => watch::run(&arguments, &terminal),
        Verb::Completions(arguments) => completions::run(&arguments, Cli::command(), &terminal),
        Verb::Manual(arguments) => return manual::run(&arguments, Cli::command(), &terminal),
    }?;
    Ok(ExitCode::SUCCESS)
}

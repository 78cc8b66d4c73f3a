//! `cophase reproduce`: the paper's results beside ours.

use super::interrupt::Interrupt;
use super::terminal::Terminal;
use cophase::Result;
use cophase::reproduce::{Options, Target};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  cophase reproduce artificial-source -o results            24 draws: a few minutes
  cophase reproduce diversity -o results --seeds 3
  cophase reproduce all -o results --quick                  a look at the shapes

Targets:
  artificial-source  residuals from one image: the paper's way and ours, against the Cramer-Rao bound
  samples            error and time against pupil samples and the width of the fitted image
  diversity          residual against the amplitude of the defocus at 1640 and 2168.6 nm
  leak               pistons that leak into the mirror: plain, masked and inpainted loop without turbulence
  figures            leak
  all                all of these

Each writes its table as CSV, and a picture.";

/// Repeat the paper's experiments: tables and pictures, its way beside ours
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// What to reproduce: one of the targets below, figures or all
    #[arg(value_name = "TARGET", value_parser = targets)]
    targets: Targets,
    /// Folder for the tables and pictures; made if it is not there
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
    /// Draws of aberrations and noise at each point; each target has its own number
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    seeds: Option<u32>,
    /// Two draws and a few points
    #[arg(long)]
    quick: bool,
    /// Print what was written as JSON, not the tables
    #[arg(long)]
    json: bool,
}

/// One target, or all of them.
#[derive(Clone)]
struct Targets(Vec<Target>);

fn targets(word: &str) -> Result<Targets> {
    match word {
        "all" => Ok(Targets(Target::ALL.to_vec())),
        "figures" => Ok(Targets(Target::FIGURES.to_vec())),
        _ => Target::parse(word).map(|target| Targets(vec![target])),
    }
}

/// What one target left behind.
#[derive(Serialize)]
struct Written {
    target: &'static str,
    files: Vec<PathBuf>,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let interrupt = Interrupt::catch()?;
    let options = Options {
        seeds: arguments.seeds.map(|seeds| seeds as usize),
        directory: arguments.output.clone(),
        quick: arguments.quick,
    };
    let mut written = Vec::new();
    for target in &arguments.targets.0 {
        let report = {
            let wait = terminal.wait(target.name(), usize::MAX);
            target.run(&options, &|done, all| wait.done_of(done, all), Some(interrupt.flag()))?
        };
        if !arguments.json {
            terminal.show(&format!("{}\n", report.text))?;
            for file in &report.files {
                terminal.show(&format!("{}\n", file.display()))?;
            }
        }
        written.push(Written { target: target.name(), files: report.files });
    }
    if arguments.json { terminal.json(&written) } else { Ok(()) }
}

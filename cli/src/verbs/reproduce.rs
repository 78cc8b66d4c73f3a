//! `cophase reproduce`: the paper's results beside ours.

use crate::interrupt::Interrupt;
use crate::outputs;
use crate::terminal::Terminal;
use cophase::{Error, Result};
use cophase_cli::reproduce::{Options, Segments, Target};
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  cophase reproduce table -o results                        the paper's table: some six minutes
  cophase reproduce artificial-source -o results            24 draws: a few minutes
  cophase reproduce diversity -o results --seeds 3
  cophase reproduce beyond -o results --row '10 images' --row '128 nm' --seeds 10
  cophase reproduce all -o results --quick                  a look at the shapes";

/// Examples, and every target with what it shows.
fn after_help() -> String {
    let line = |name: &str, about: &str| format!("  {name:<18} {about}\n");
    let targets: String = Target::ALL.iter().map(|target| line(target.name(), target.about())).collect();
    let figures = line("figures", &Target::FIGURES.map(Target::name).join(", "));
    let all = line("all", "all of these");
    format!("{EXAMPLES}\n\nTargets:\n{targets}{figures}{all}\nEach writes its tables as CSV, and a picture.")
}

/// Repeat the paper's experiments: tables and pictures, its way beside ours
#[derive(clap::Args)]
#[command(after_help = after_help())]
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
    /// Two draws, and a few points or images
    #[arg(long)]
    quick: bool,
    /// Telescope behind the AO loop: paper (segments of 0.862 m, a pupil of 10.49 m) or real (0.9 m)
    #[arg(long, value_name = "WHICH", default_value = "paper", value_parser = segments)]
    segments: Segments,
    /// Row of beyond or of hard-cases to make, by name, or of pulls or channels, by a part of its name; may be given more than once
    /// [default: all]
    #[arg(long, value_name = "NAME")]
    row: Vec<String>,
    /// Folder of measured NCPA maps (NCPA*.fits, nm, over the pupil's grid): one more row of beyond for each
    #[arg(long, value_name = "FOLDER")]
    maps: Option<PathBuf>,
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

fn segments(word: &str) -> Result<Segments> {
    match word {
        "paper" => Ok(Segments::Published),
        "real" => Ok(Segments::Real),
        other => Err(Error::Value(format!("the segments '{other:.60}' are not known: paper or real is accepted"))),
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
    outputs::refuse_dash(("-o", &arguments.output))?;
    let options = Options {
        seeds: arguments.seeds.map(|seeds| seeds as usize),
        directory: arguments.output.clone(),
        quick: arguments.quick,
        segments: arguments.segments,
        rows: arguments.row.clone(),
        maps: arguments.maps.clone(),
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

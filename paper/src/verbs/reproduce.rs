//! `cophase-paper`: the paper's results beside ours.

use cophase::pipeline::Part;
use cophase::{Error, Result};
use cophase_paper::reproduce::{Options, Segments, Target};
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs;
use cophase_view::ranks::{Heartbeat, Rank, RankMonitor, Share, wait_for_all};
use cophase_view::terminal::Terminal;
use serde::Serialize;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  cophase-paper table -o results                        the table of the paper: some six minutes
  cophase-paper artificial-source -o results            24 draws: a few minutes
  cophase-paper diversity -o results --seeds 3
  cophase-paper beyond -o results --row '10 images' --row '128 nm' --seeds 10
  cophase-paper table -o results --part 3/8             then without --part
  mpirun -n 8 cophase-paper beyond -o results --part rank
  cophase-paper all -o results --quick                  a look at the shapes";

/// Examples, and every target with what it shows.
pub fn after_help() -> String {
    let line = |name: &str, about: &str| format!("  {name:<18} {about}\n");
    let targets: String = Target::ALL.iter().map(|target| line(target.name(), target.about())).collect();
    let figures = line("figures", &Target::FIGURES.map(Target::name).join(", "));
    let all = line("all", "all of these");
    format!("{EXAMPLES}\n\nTargets:\n{targets}{figures}{all}\nEach writes its tables as CSV, and a picture.")
}

/// A target and how it is run.
#[derive(Clone, clap::Args)]
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
    /// Telescope behind the AO loop: paper (segments of 0.862 m, a pupil of 10.49 m) or real (0.9
    /// m)
    #[arg(long, value_name = "WHICH", default_value = "paper", value_parser = segments)]
    segments: Segments,
    /// Row of beyond, pyramid or hard-cases to make, by name, or by a part of its name of any other
    /// target that has rows; may be given more than once [default: all]
    #[arg(long, value_name = "NAME")]
    row: Vec<String>,
    /// Folder of measured NCPA maps (NCPA*.fits, nm, over the pupil's grid): one more row of beyond
    /// for each
    #[arg(long, value_name = "FOLDER")]
    maps: Option<PathBuf>,
    /// Make part I of N of the draws, and no table: without --part the table is made of all draws
    /// that are there. rank: the part of this process under mpirun or srun, whose first process
    /// makes the table
    #[arg(long, value_name = "I/N|rank")]
    part: Option<Share>,
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
    match arguments.part {
        None => make(arguments, None, terminal, &interrupt),
        Some(Share::Part(part)) => make(arguments, Some(part), terminal, &interrupt),
        Some(Share::Rank) => {
            let rank = Rank::of_this_process()?;
            share(arguments, rank, terminal, &interrupt).map_err(|error| rank.name(error))
        }
    }
}

/// The share of one rank; the first waits for the others, and makes the table.
fn share(arguments: &Arguments, rank: Rank, terminal: &Terminal, interrupt: &Interrupt) -> Result<()> {
    let (folder, quiet) = (&arguments.output, Terminal::new(true));
    std::fs::create_dir_all(folder).map_err(|error| Error::file(folder, error))?;
    let silent = Arguments { json: false, ..arguments.clone() };
    if rank.number > 0 {
        let heartbeat = Heartbeat::start(folder, rank);
        return match make(&silent, Some(rank.part()?), &quiet, interrupt) {
            Ok(()) => {
                heartbeat.finish();
                Ok(())
            }
            Err(error) => {
                heartbeat.fail(&error);
                Err(error)
            }
        };
    }
    let monitors = RankMonitor::of_others(folder, rank);
    make(&silent, Some(rank.part()?), &quiet, interrupt)?;
    wait_for_all(monitors, || interrupt.check("the other ranks were not done"))?;
    make(arguments, None, terminal, interrupt)
}

/// Runs the targets, or a part of them.
fn make(arguments: &Arguments, part: Option<Part>, terminal: &Terminal, interrupt: &Interrupt) -> Result<()> {
    let options = Options {
        seeds: arguments.seeds.map(|seeds| seeds as usize),
        directory: arguments.output.clone(),
        quick: arguments.quick,
        segments: arguments.segments,
        rows: arguments.row.clone(),
        maps: arguments.maps.clone(),
        part,
    };
    arguments.targets.0.iter().try_for_each(|target| target.check_part(part))?;
    let mut written = Vec::new();
    for target in &arguments.targets.0 {
        let report = {
            let wait = terminal.wait(target.name(), usize::MAX);
            target.run(&options, &|done, all| wait.done_of(done, all), &interrupt.silent_control())?
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

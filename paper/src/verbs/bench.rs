//! `cophase-paper bench`: speed against error.

use cophase::device::{Choice, Precision};
use cophase::scene::{Optimizer, Scene};
use cophase::{Error, Result};
use cophase_paper::bench::{self, Bench, Cell, Crop, Grid, Point};
use cophase_paper::experiment::Progress;
use cophase_view::files::{self, Settings};
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs;
use cophase_view::terminal::Terminal;
use serde::{Serialize, Serializer};
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  cophase-paper bench                                                   about a minute
  cophase-paper bench --picture bench.png --csv bench.csv --budget-nm 1
  cophase-paper bench scene.toml --samples 72,108 --pixels auto,64 --batch 1,50,200 --device cpu --precision f64

Each point is a model (samples, pixels, optimizer) on a device, in a precision, with so many images at a time: the time \
of one objective with its gradient, its floor and what fraction of it that is, the time of a whole estimate with its \
quartiles, and its error beside the Cramér-Rao bound. Times are medians per image; errors are RMS over images with a \
truth each, made on a finer grid. The floor is the arithmetic, or the memory traffic, that cannot be avoided, at the \
peak measured on this machine. --csv and --json have more columns: set-up times, the deviation from the f64 CPU chain, \
work and peak. --json prints a list of points.";

/// Measure speed against error: models of several sizes, devices, precisions, one image and batches
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Scene: a TOML file, or the name of a preset (see 'cophase scene')
    #[arg(default_value = "keck-artificial")]
    scene: PathBuf,
    #[command(flatten)]
    settings: Settings,
    /// Samples along a side of the pupil grid [default: the scene's, and 0.6 and 0.8 of it]
    #[arg(long, value_name = "N,...", value_delimiter = ',')]
    samples: Vec<usize>,
    /// Pixels along a side of the fitted image, at 2 pixels per lambda/D where the image has more;
    /// auto is what carries signal
    #[arg(long, value_name = "N,...", value_delimiter = ',', default_value = "auto")]
    pixels: Vec<Crop>,
    /// Recipes of the fit: gauss-newton, paper
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', default_value = "gauss-newton", value_parser = optimizer)]
    optimizer: Vec<Optimizer>,
    /// Budgets for the phasing and the NCPA each, nm RMS: the models that 'cophase plan' chooses,
    /// besides the others
    #[arg(long, value_name = "NM,...", value_delimiter = ',')]
    budget_nm: Vec<f64>,
    /// Devices: cpu, auto, opencl or opencl:P:D [default: the CPU, and every OpenCL device that is
    /// here]
    #[arg(long, value_name = "DEVICE,...", value_delimiter = ',')]
    device: Vec<Choice>,
    /// Precisions: f32, f64
    #[arg(long, value_name = "TYPE,...", value_delimiter = ',', default_value = "f32,f64")]
    precision: Vec<Precision>,
    /// Images that are fitted at a time
    #[arg(long, value_name = "N,...", value_delimiter = ',', default_value = "1,100", value_parser = batch)]
    batch: Vec<usize>,
    /// Different images, each with a truth of its own
    #[arg(long, value_name = "N", default_value = "8", value_parser = clap::value_parser!(u32).range(1..=1000))]
    images: u32,
    /// How often each point is timed
    #[arg(long, value_name = "N", default_value = "3", value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeat: u32,
    /// Seed of the first image's aberrations and noise; the others follow [default:
    /// aberrations.seed of the scene]
    #[arg(long, value_parser = files::seed())]
    seed: Option<u64>,
    /// Write all columns to this file
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Draw error against time into this file, a .png or .svg
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
    /// Print the points as JSON, not as a table
    #[arg(long)]
    json: bool,
}

fn optimizer(word: &str) -> Result<Optimizer> {
    match word {
        "gauss-newton" => Ok(Optimizer::GaussNewton),
        "paper" => Ok(Optimizer::Paper),
        other => {
            Err(Error::Value(format!("the optimizer '{other:.60}' has no session: gauss-newton or paper is accepted")))
        }
    }
}

/// Most images of a batch: more would only measure the memory.
const MOST_BATCH: usize = 65_536;

fn batch(text: &str) -> Result<usize> {
    let number = text.parse().ok().filter(|number| (1..=MOST_BATCH).contains(number));
    number.ok_or_else(|| Error::Value(format!("a batch of '{text:.40}' images: 1 to {MOST_BATCH} is accepted")))
}

impl Arguments {
    fn grid(&self) -> Grid {
        Grid {
            samples: self.samples.clone(),
            crops: self.pixels.clone(),
            optimizers: self.optimizer.clone(),
            devices: self.device.clone(),
            budgets_nm: self.budget_nm.clone(),
            precisions: self.precision.clone(),
            batches: self.batch.clone(),
            images: self.images as usize,
            repeats: self.repeat as usize,
        }
    }
}

/// A point as a JSON object: the columns of the CSV.
struct Record(Vec<(&'static str, Cell)>);

/// What is not there is null.
struct Value<'a>(&'a Cell);

impl Serialize for Record {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        serializer.collect_map(self.0.iter().map(|(name, cell)| (name, Value(cell))))
    }
}

impl Serialize for Value<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        match self.0 {
            Cell::Text(text) => serializer.serialize_str(text),
            Cell::Count(count) => serializer.serialize_u64(*count as u64),
            Cell::Number(number, _) if number.is_finite() => serializer.serialize_f64(*number),
            Cell::Number(..) => serializer.serialize_none(),
        }
    }
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let interrupt = Interrupt::catch()?;
    let picture = arguments.picture.as_deref().map(|picture| ("--picture", picture));
    let csv = arguments.csv.as_deref().map(|csv| ("--csv", csv));
    picture.map_or(Ok(()), outputs::check_picture)?;
    let written: Vec<_> = csv.into_iter().chain(picture).collect();
    outputs::check(&written, &[("the scene", &arguments.scene)])?;
    let scene = arguments.settings.apply(&files::scene(&arguments.scene)?, &[])?;
    files::spare_files_of(&scene, &written)?;
    let Bench { points, left_out } = measure(arguments, &scene, terminal, &interrupt)?;
    for reason in &left_out {
        terminal.warn(&format!("left out: {reason}"));
    }
    if let Some(csv) = &arguments.csv {
        bench::table(&points, true).write_csv(csv)?;
    }
    if let Some(picture) = &arguments.picture {
        bench::picture(&points).draw(picture)?;
    }
    if arguments.json {
        return terminal.json(&points.iter().map(|point| Record(bench::record(point))).collect::<Vec<_>>());
    }
    terminal.show(&(bench::table(&points, false).text() + &set_up(&points)))
}

fn measure(arguments: &Arguments, scene: &Scene, terminal: &Terminal, interrupt: &Interrupt) -> Result<Bench> {
    let seed = arguments.seed.unwrap_or_else(|| scene.seed());
    let wait = terminal.wait("Measuring", usize::MAX);
    let watch = |done: usize, all: usize| wait.done_of(done, all);
    bench::run(scene, &arguments.grid(), seed, &Progress::new(&watch, &interrupt.silent_control()))
}

/// What comes once, apart from the times of the table.
fn set_up(points: &[Point]) -> String {
    let range = |of: fn(&Point) -> f64| {
        let seconds = points.iter().map(of);
        let (low, high) = seconds.fold((f64::INFINITY, 0.0f64), |(low, high), s| (low.min(s), high.max(s)));
        format!("{low:.2} to {high:.2} s")
    };
    format!(
        "Set-up, in none of these times: {} for a model, {} for a session.\n",
        range(|point| point.model_set_up_s),
        range(|point| point.session_set_up_s)
    )
}

//! `cophase watch`: estimates of the frames that appear in a folder.

use crate::files::{self, Settings};
use crate::interrupt::Interrupt;
use crate::terminal::Terminal;
use crate::watch::{self, FrameReader};
use cophase::Result;
use cophase::pipeline::Policy;
use std::path::PathBuf;
use std::time::Duration;

const EXAMPLES: &str = "Examples:
  cophase watch frames/ --scene scene.toml --state night.db
  cophase watch frames/ --scene scene.toml --state night.db --once

Every FITS file in the folder is taken once: those that are there, then those that appear, as soon as they are complete. The file \
--state keeps every result; the same command continues it, after a kill or a power cut too. Ctrl-C ends the watch (exit status 0).";

/// Estimate every frame that appears in a folder
#[derive(clap::Args)]
#[command(after_help = EXAMPLES)]
pub struct Arguments {
    /// Folder in which FITS files appear
    #[arg(value_name = "FOLDER")]
    folder: PathBuf,
    /// Scene: a TOML file, or the name of a preset
    #[arg(long)]
    scene: PathBuf,
    /// File that keeps the night; it is made where there is none, else continued
    #[arg(long, value_name = "FILE")]
    state: PathBuf,
    /// How a frame is estimated: one fit (realtime), or as 'cophase estimate' does (full)
    #[arg(long, default_value = "realtime", value_parser = ["realtime", "full"])]
    policy: String,
    #[command(flatten)]
    settings: Settings,
    /// FITS file whose non-zero pixels are bad
    #[arg(long, value_name = "FILE")]
    mask: Option<PathBuf>,
    /// Which holds where a file contradicts the scene
    #[arg(long, value_name = "WHICH", value_parser = ["scene"])]
    trust: Option<String>,
    /// Time between two scans of the folder, which find files of which the system gives no notice (network folders)
    #[arg(long, value_name = "SECONDS", default_value = "5", value_parser = seconds)]
    poll_seconds: f64,
    /// How long an incomplete file must stay as it is before it is refused
    #[arg(long, value_name = "SECONDS", default_value = "10", value_parser = seconds)]
    settle_seconds: f64,
    /// Take what is there, then end
    #[arg(long)]
    once: bool,
    /// Log, to which lines of JSON are appended
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
}

fn seconds(text: &str) -> std::result::Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|seconds| (0.05..=86400.0).contains(seconds));
    number.ok_or_else(|| "0.05 to 86400 seconds are accepted".into())
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let interrupt = Interrupt::catch()?;
    let scene = arguments.settings.apply(&files::scene(&arguments.scene)?, &[])?;
    let settings = watch::Settings {
        folder: arguments.folder.clone(),
        scene,
        policy: if arguments.policy == "full" { Policy::default() } else { Policy::realtime() },
        state: arguments.state.clone(),
        reader: FrameReader {
            mask: arguments.mask.clone(),
            trust_scene: arguments.trust.is_some(),
            overrides: arguments.settings.keys().map(str::to_owned).collect(),
        },
        poll: Duration::from_secs_f64(arguments.poll_seconds),
        settle: Duration::from_secs_f64(arguments.settle_seconds),
        once: arguments.once,
        log: arguments.log.clone(),
    };
    watch::run(settings, terminal, &interrupt)
}

//! `cophase watch`: estimates of the frames that appear in a folder.

use crate::export::export;
use crate::frame_file::FrameReader;
use crate::page::{PageSettings, is_token};
use crate::service::{self, Place};
use crate::tracking::TrackingSettings;
use cophase::pipeline::{Corrections, Policy};
use cophase::{Error, Result};
use cophase_view::files::{self, Settings};
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs::{self, Flagged};
use cophase_view::terminal::{Terminal, counted};
use std::net::{IpAddr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::Duration;

const EXAMPLES: &str = "Examples:
  cophase watch frames/ --scene scene.toml --state night.db
  cophase watch frames/ --scene scene.toml --state night.db --once
  cophase watch --stream cam0 --scene scene.toml --state night.db
  cophase watch frames/ --scene scene.toml --state night.db --corrections c.fits
  cophase watch --export night.csv --state night.db

Every FITS file in the folder is taken once: those that are there, then those that appear, as soon as they are complete. The file \
--state keeps every result; the same command continues it, after a kill or a power cut too. Ctrl-C ends the watch (exit status 0).";

/// Estimate every frame that appears in a folder
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Folder in which FITS files appear
    #[arg(value_name = "FOLDER", required_unless_present_any = ["stream", "export"], conflicts_with_all = ["stream", "export"])]
    folder: Option<PathBuf>,
    /// Stream of ImageStreamIO (milk, cacao) in place of a folder; its file is in MILK_SHM_DIR,
    /// else /milk/shm, else /tmp
    #[arg(long, value_name = "NAME", conflicts_with_all = ["mask", "export"])]
    stream: Option<String>,
    /// Write the night of --state to a .fits, .fits.gz or .csv file, or a report to an .html file,
    /// and end; a watch may run meanwhile
    #[arg(long, value_name = "FILE")]
    export: Option<PathBuf>,
    /// Scene: a TOML file, or the name of a preset
    #[arg(long, required_unless_present = "export")]
    scene: Option<PathBuf>,
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
    /// Time between two scans of the folder, which find files of which the system gives no notice
    /// (network folders)
    #[arg(long, value_name = "SECONDS", default_value = "5", value_parser = seconds)]
    poll_seconds: f64,
    /// How long an incomplete file must stay as it is before it is refused
    #[arg(long, value_name = "SECONDS", default_value = "10", value_parser = seconds)]
    settle_seconds: f64,
    /// Take what is there, then end
    #[arg(long)]
    once: bool,
    /// File to which corrections of the tracked state are written, by the policy of the scene
    /// ([commands]), as 'cophase estimate --commands' does: FITS, or text for FILE.txt. From later
    /// frames the watch recognises that one was applied
    #[arg(long, value_name = "FILE", conflicts_with = "export")]
    corrections: Option<PathBuf>,
    /// Log, to which lines of JSON are appended
    #[arg(long, value_name = "FILE")]
    log: Option<PathBuf>,
    /// False alarms of moved segments that are accepted in a night of 8 hours
    #[arg(long, value_name = "N", default_value = "0.1", value_parser = positive)]
    false_alarms_per_night: f64,
    /// Usual time between frames: with it the false alarms of a night become a threshold
    #[arg(long, value_name = "SECONDS", default_value = "10", value_parser = positive)]
    interval_seconds: f64,
    /// Port of the page on this machine; 0 takes any that is free
    #[arg(long, default_value = "8642")]
    port: u16,
    /// Make no page
    #[arg(long)]
    no_page: bool,
    /// Another address on which the page listens, such as 0.0.0.0; a token is needed
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    listen: IpAddr,
    /// Name of this machine under which the page is accepted besides its addresses; may be repeated
    #[arg(long, value_name = "NAME")]
    host: Vec<String>,
    /// What every request must know: 16 to 256 letters, digits, - and _. COPHASE_TOKEN in the
    /// environment is not seen by others
    #[arg(long)]
    token: Option<String>,
}

impl Arguments {
    fn page(&self) -> Result<Option<PageSettings>> {
        if self.no_page || self.once {
            return Ok(None);
        }
        let token =
            self.token.clone().or_else(|| std::env::var("COPHASE_TOKEN").ok().filter(|token| !token.is_empty()));
        if token.as_deref().is_some_and(|token| !is_token(token)) {
            let accepted = "16 to 256 letters, digits, - and _ are accepted";
            return Err(Error::Value(format!("the token (--token, COPHASE_TOKEN) cannot be used: {accepted}")));
        }
        if token.is_none() && !self.listen.is_loopback() {
            return Err(Error::Value(format!(
                "--listen {} opens the page to other machines, which needs a token: set COPHASE_TOKEN (or --token)",
                self.listen
            )));
        }
        Ok(Some(PageSettings { address: SocketAddr::new(self.listen, self.port), hosts: self.host.clone(), token }))
    }
}

fn positive(text: &str) -> std::result::Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite() && *number > 0.0);
    number.ok_or_else(|| "a positive number is accepted".into())
}

fn seconds(text: &str) -> std::result::Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|seconds| (0.05..=86400.0).contains(seconds));
    number.ok_or_else(|| "0.05 to 86400 seconds are accepted".into())
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    if let Some(output) = &arguments.export {
        outputs::check(&[("--export", output)], &[("--state", &arguments.state)])?;
        let (frames, incomplete) = export(&arguments.state, output)?;
        if let Some(sentence) = incomplete {
            terminal.warn(&format!("{}: {sentence}", arguments.state.display()));
        }
        return terminal.show(&format!("{}: {}\n", output.display(), counted(frames, "frame")));
    }
    let interrupt = Interrupt::catch()?;
    let place = match (&arguments.folder, &arguments.stream) {
        (_, Some(name)) => Place::Stream(name.clone()),
        (folder, None) => Place::Folder(folder.clone().unwrap_or_default()),
    };
    let scene = arguments.scene.as_deref().map(|scene| ("--scene", scene));
    let inputs: Vec<Flagged> =
        scene.into_iter().chain(arguments.mask.as_deref().map(|mask| ("--mask", mask))).collect();
    let state = ("--state", arguments.state.as_path());
    outputs::refuse_dash(state)?;
    outputs::spare(state, &inputs)?;
    if let Some(log) = &arguments.log {
        outputs::refuse_dash(("--log", log))?;
        outputs::spare(("--log", log), &[&inputs[..], &[state]].concat())?;
    }
    if let Some(corrections) = &arguments.corrections {
        let log = arguments.log.as_deref().map(|log| ("--log", log));
        let others: Vec<Flagged> = inputs.iter().copied().chain([state]).chain(log).collect();
        outputs::check(&[("--corrections", corrections)], &others)?;
        if let Some(folder) = &arguments.folder {
            refuse_within(corrections, folder)?;
        }
    }
    let scene = files::scene(arguments.scene.as_deref().unwrap_or(Path::new("")))?;
    let scene = arguments.settings.apply(&scene, &[])?;
    if arguments.corrections.is_some() {
        Corrections::check_controllers(&scene)?;
    }
    let settings = service::Settings {
        place,
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
        tracking: TrackingSettings {
            false_alarms_per_night: arguments.false_alarms_per_night,
            interval_s: arguments.interval_seconds,
        },
        corrections: arguments.corrections.clone(),
        page: arguments.page()?,
    };
    service::run(settings, terminal, &interrupt)
}

/// Refuses a file of corrections among the frames, of which it would be one.
fn refuse_within(corrections: &Path, folder: &Path) -> Result<()> {
    let parent = corrections.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if parent.canonicalize().is_ok_and(|parent| folder.canonicalize().is_ok_and(|folder| parent == folder)) {
        let reason = "is in the folder of the frames, which --corrections does not write to: give another folder";
        return Err(Error::file(corrections, reason));
    }
    Ok(())
}

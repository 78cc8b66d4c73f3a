//! `cophase check`: scene and images before an estimate is believed.

use super::one_channel::of_one_channel;
use cophase::Result;
use cophase::pipeline::{Check, Finding, Poke, check};
use cophase::scene::{Scene, Setting};
use cophase_view::files::{self, Settings};
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs;
use cophase_view::plot::{CaptionedMap, MapScale, MapsPicture};
use cophase_view::terminal::{DOUBTFUL_STATUS, Terminal};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;

const EXAMPLES: &str = "Examples:
  cophase check images.fits --scene scene.toml
  cophase check images.fits --scene scene.toml --plot a.png --write new.toml
  cophase check poked.fits --before old.fits --segment 8 --poke-nm 90

Images and scene are compared: plate scale, rotation, illumination, saturation, a second star, the orientation, cards of the file. \
Each line of the table has the scene's value, what was found with its error bar, and whether the images determine it. The first \
fault is the likeliest cause; set its keys (--write) and check again.

One image does not determine flips and the sign of the defocus where the pupil equals its mirror images; a known poke of a segment \
or an actuator does: give the images before and after it, its place and its size (--before, --segment, --actuator, --poke-nm). Move one \
away from the pupil's symmetry axes. Both are estimated, and the difference of their maps is compared with the expected one in every \
orientation that leaves the pupil as it is. Segments have the labels of pupil.segment_labels or of the pupil's file, else the numbers of this \
program, from 0 ('cophase scene SCENE --plot pupil.png' draws them); actuators are counted from 0 as in the table ACTUATORS of \
'estimate --commands'. Without --before the poke must be larger than the errors of the wavefront. A segment that moved in the scene's own \
orientation is named before any other orientation is, and nothing is proposed that raises χ².

--json prints: cause (name of the first fault, or null), settings (keys to set for it), reduced_chi2 (with the scene), \
reduced_chi2_corrected (with these settings), findings (list of quantity, verdict, scene, found, sigma, gain, settings, \
explanation).";

/// Check scene and images before an estimate is believed
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(group(clap::ArgGroup::new("poke").args(["segment", "actuator"])))]
pub struct Arguments {
    /// FITS file with images; with a poke those behind it
    images: PathBuf,
    /// Scene: a TOML file, or the name of a preset [default: the scene in the file]
    #[arg(long)]
    scene: Option<PathBuf>,
    /// FITS file whose non-zero pixels are bad
    #[arg(long, value_name = "FILE")]
    mask: Option<PathBuf>,
    /// FITS file with images without the poke
    #[arg(long, value_name = "FILE", requires = "poke")]
    before: Option<PathBuf>,
    /// Segment that was moved: its label, else its number from 0 on
    #[arg(long, value_name = "LABEL", requires = "poke_nm")]
    segment: Option<String>,
    /// Actuator that was moved, from 0 on
    #[arg(long, value_name = "N", requires = "poke_nm")]
    actuator: Option<usize>,
    /// By how much the wavefront was raised, nm (twice the motion of a mirror's surface)
    #[arg(long, value_name = "NM", allow_negative_numbers = true, requires = "poke")]
    poke_nm: Option<f64>,
    #[command(flatten)]
    settings: Settings,
    /// Picture of image, model and residual, with the scene and with the first fault corrected: a
    /// .png or .svg file
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
    /// Writes the scene with the settings of the first fault, where it has some
    #[arg(long, value_name = "FILE")]
    write: Option<PathBuf>,
    /// Print the findings as JSON
    #[arg(long)]
    json: bool,
    /// Exit with status 3 where a fault was found
    #[arg(long)]
    strict: bool,
}

impl Arguments {
    fn scene(&self) -> Result<Scene> {
        self.settings.scene_of(self.scene.as_deref(), &self.images, &[])
    }

    fn check_outputs(&self) -> Result<()> {
        let mut inputs = vec![("the images", self.images.as_path())];
        inputs.extend(self.before.as_deref().map(|path| ("--before", path)));
        inputs.extend(self.scene.as_deref().map(|path| ("--scene", path)));
        inputs.extend(self.mask.as_deref().map(|path| ("--mask", path)));
        let mut written = Vec::new();
        if let Some(path) = &self.plot {
            outputs::check_picture(("--plot", path))?;
            written.push(("--plot", path.as_path()));
        }
        written.extend(self.write.as_deref().map(|path| ("--write", path)));
        outputs::check(&written, &inputs)
    }
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<ExitCode> {
    let interrupt = Interrupt::catch()?;
    arguments.check_outputs()?;
    let scene = arguments.scene()?;
    let images = of_one_channel(&arguments.images, arguments.mask.as_deref())?;
    let before = arguments.before.as_ref().map(|path| of_one_channel(path, None)).transpose()?;
    let poke_nm = arguments.poke_nm.unwrap_or_default();
    let poke = match (&arguments.segment, arguments.actuator) {
        (Some(label), _) => Some(Poke::of_segment(&scene, label, poke_nm)?),
        (None, Some(index)) => Some(Poke::Actuator(index, poke_nm)),
        (None, None) => None,
    };
    let bar = terminal.follow();
    let poke = poke.map(|poke| (before.as_ref(), poke));
    let found = check(&scene, &images, poke, &interrupt.control(&bar)).map_err(files::about(&arguments.images))?;
    drop(bar);
    if let Some(path) = &arguments.plot {
        picture(&arguments.images.display().to_string(), &found).draw(path)?;
    }
    let has_settings = found.cause().is_some_and(|cause| !cause.settings.is_empty());
    if let Some(path) = arguments.write.as_ref().filter(|_| has_settings) {
        cophase::io::write_atomically(path, found.corrected.text().as_bytes())?;
    }
    if arguments.json { terminal.json(&Printed::new(&found)) } else { terminal.show(&text(&found)) }?;
    if let Some(path) = arguments.write.as_ref().filter(|_| !has_settings) {
        let why =
            if found.cause().is_some() { "the likeliest cause has no single key to set" } else { "no fault was found" };
        terminal.warn(&format!("{} was not written: {why}", path.display()));
    }
    let is_faulty = arguments.strict && found.cause().is_some();
    Ok(if is_faulty { ExitCode::from(DOUBTFUL_STATUS) } else { ExitCode::SUCCESS })
}

/// The table for people.
fn text(found: &Check) -> String {
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_string(), |value| format!("{value:.5}"));
    let mut text = format!("{:<36}{:<16}{:>12}{:>12}{:>11}\n", "quantity", "verdict", "scene", "found", "1σ");
    for one in &found.findings {
        let (quantity, verdict) = (one.quantity.name(), one.verdict.name());
        let [scene, value, sigma] = [one.scene, one.found, one.sigma].map(number);
        text += &format!("{quantity:<36}{verdict:<16}{scene:>12}{value:>12}{sigma:>11}\n");
    }
    text += "\n";
    for one in &found.findings {
        text += &format!("{}: {}\n", one.quantity.name(), one.explanation);
    }
    let [own, corrected] = found.reduced_chi2;
    text += &match found.cause() {
        None => format!("\nNo fault was found. Reduced χ² {own:.3}.\n"),
        Some(cause) if cause.settings.is_empty() => {
            format!("\nLikeliest cause: {}. Reduced χ² {own:.3}.\n", cause.quantity.name())
        }
        Some(cause) => {
            let set: Vec<String> = cause.settings.iter().map(|setting| format!("  set {setting}\n")).collect();
            let name = cause.quantity.name();
            format!(
                "\nLikeliest cause: {name}. Reduced χ² {own:.3}; it becomes {corrected:.3} if you\n{}Check again with it: other faults may be its \
                 consequences.\n",
                set.concat()
            )
        }
    };
    text
}

/// Image, model and residual, and the residual with the first fault corrected.
fn picture(name: &str, found: &Check) -> MapsPicture {
    let (scene, corrected) = &found.compared;
    let map = |caption: String, values: &ndarray::Array2<f64>, unit: &str, scale| CaptionedMap {
        caption,
        values: values.clone(),
        unit: unit.into(),
        width_m: None,
        scale,
        labels: Vec::new(),
    };
    let [own_chi2, corrected_chi2] = found.reduced_chi2;
    let mut maps = vec![
        map("image".into(), &scene.data_e, "e⁻", MapScale::Stretched),
        map("model of the scene".into(), &scene.model_e, "e⁻", MapScale::Stretched),
        map(format!("image − model, χ² {own_chi2:.2}"), &scene.residual_sigma, "σ", MapScale::Diverging),
    ];
    if let (Some(image), Some(cause)) = (corrected, found.cause()) {
        let caption = format!("{} corrected, χ² {corrected_chi2:.2}", cause.quantity.name());
        maps.push(map(caption, &image.residual_sigma, "σ", MapScale::Diverging));
    }
    let cause = found.cause().map_or("no fault was found".into(), |cause| cause.quantity.name());
    MapsPicture { title: format!("Check of {name}: {cause}"), columns: 2, maps }
}

/// What `check --json` prints; scripts rely on these keys.
#[derive(Serialize)]
struct Printed<'a> {
    cause: Option<String>,
    settings: BTreeMap<&'a str, &'a str>,
    reduced_chi2: f64,
    reduced_chi2_corrected: f64,
    findings: Vec<PrintedFinding<'a>>,
}

#[derive(Serialize)]
struct PrintedFinding<'a> {
    quantity: String,
    verdict: &'static str,
    scene: Option<f64>,
    found: Option<f64>,
    sigma: Option<f64>,
    gain: f64,
    settings: BTreeMap<&'a str, &'a str>,
    explanation: &'a str,
}

fn keys(settings: &[Setting]) -> BTreeMap<&str, &str> {
    settings.iter().map(|setting| (setting.key(), setting.text())).collect()
}

impl<'a> Printed<'a> {
    fn new(found: &'a Check) -> Self {
        let one = |finding: &'a Finding| PrintedFinding {
            quantity: finding.quantity.name(),
            verdict: finding.verdict.name(),
            scene: finding.scene,
            found: finding.found,
            sigma: finding.sigma,
            gain: finding.gain,
            settings: keys(&finding.settings),
            explanation: &finding.explanation,
        };
        Self {
            cause: found.cause().map(|cause| cause.quantity.name()),
            settings: found.cause().map(|cause| keys(&cause.settings)).unwrap_or_default(),
            reduced_chi2: found.reduced_chi2[0],
            reduced_chi2_corrected: found.reduced_chi2[1],
            findings: found.findings.iter().map(one).collect(),
        }
    }
}

//! `cophase check-orientation`: flips, rotation and sign of images from a known poke.

use cophase::Result;
use cophase::pipeline::{Control, Images, Orientation, OrientationCandidate, Poke, check_orientation};
use cophase::scene::Scene;
use cophase_view::files::{self, Settings};
use cophase_view::interrupt::Interrupt;
use cophase_view::terminal::Terminal;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  cophase check-orientation new.fits --before old.fits --segment 8 --poke-nm 90
  cophase check-orientation poked.fits --actuator 40 --poke-nm 400 --json

One image does not determine its orientation where the pupil equals its mirror image: a flipped image is explained as well, by \
flipped maps. Move one segment or one actuator by a known amount, away from the pupil's symmetry axes, and give the images before \
and after. Both are estimated; the difference of their maps is compared with the expected one in every orientation that leaves \
the pupil as it is. Segments and actuators are counted from 0 in the order of this program (tables SEGMENTS and ACTUATORS of \
'estimate --commands').

--json prints: flip_x, flip_y and rotation_deg (of the images against the scene), sign, amplitude (found over expected), \
correlation, runner_up (the same of the next orientation), equivalent (descriptions of orientations that this poke does not \
distinguish), settings (keys of the scene to set), warnings.";

/// Find flips, rotation and sign of images from a known poke of one segment or actuator
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
#[command(group(clap::ArgGroup::new("poke").required(true).args(["segment", "actuator"])))]
pub struct Arguments {
    /// FITS file with images behind the poke
    after: PathBuf,
    /// FITS file with images without the poke [default: none, the poke is larger than the errors of the wavefront]
    #[arg(long, value_name = "FILE")]
    before: Option<PathBuf>,
    /// Segment that was moved, from 0 on
    #[arg(long, value_name = "N")]
    segment: Option<usize>,
    /// Actuator that was moved, from 0 on
    #[arg(long, value_name = "N")]
    actuator: Option<usize>,
    /// By how much the wavefront was raised, nm (twice the motion of a mirror's surface)
    #[arg(long, value_name = "NM", allow_negative_numbers = true)]
    poke_nm: f64,
    /// Scene: a TOML file, or the name of a preset [default: the scene in the file]
    #[arg(long)]
    scene: Option<PathBuf>,
    #[command(flatten)]
    settings: Settings,
    /// Print the answer as JSON
    #[arg(long)]
    json: bool,
}

impl Arguments {
    fn scene(&self) -> Result<Scene> {
        self.settings.scene_of(self.scene.as_deref(), &self.after, &[])
    }
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let interrupt = Interrupt::catch()?;
    let scene = arguments.scene()?;
    let poke = match (arguments.segment, arguments.actuator) {
        (Some(index), _) => Poke::Segment(index, arguments.poke_nm),
        (None, index) => Poke::Actuator(index.unwrap_or_default(), arguments.poke_nm),
    };
    let after = Images::read(&arguments.after, None)?;
    let before = arguments.before.as_ref().map(|path| Images::read(path, None)).transpose()?;
    let bar = terminal.follow();
    let control = Control::with_flag(interrupt.flag().clone(), bar.observer());
    let found =
        check_orientation(&scene, before.as_ref(), &after, poke, &control).map_err(files::about(&arguments.after))?;
    drop(bar);
    for sentence in &found.warnings {
        terminal.warn(&format!("{}: {sentence}", arguments.after.display()));
    }
    if arguments.json {
        return terminal.json(&Printed::new(&found));
    }
    terminal.show(&text(&found))
}

/// The answer for people.
fn text(found: &Orientation) -> String {
    let line = |name: &str, candidate: &OrientationCandidate| {
        let (what, correlation) = (candidate.description(), candidate.correlation);
        format!("{name:<12}{what} (correlation {correlation:.3}, {:.2} times the poke)\n", candidate.amplitude)
    };
    let mut text = line("likeliest", &found.best) + &line("next", &found.runner_up);
    if !found.equivalent.is_empty() {
        let others: Vec<String> = found.equivalent.iter().map(OrientationCandidate::description).collect();
        text += &format!("Not distinguished by this poke: {}.\n", others.join("; "));
    }
    if found.settings.is_empty() && found.best.sign > 0.0 {
        return text + "The scene has the orientation of the images.\n";
    }
    for (key, value) in &found.settings {
        text += &format!("set {key} = {value}\n");
    }
    text
}

/// What `check-orientation --json` prints; scripts rely on these keys.
#[derive(Serialize)]
struct Printed<'a> {
    #[serde(flatten)]
    best: PrintedCandidate,
    runner_up: PrintedCandidate,
    equivalent: Vec<String>,
    settings: BTreeMap<&'a str, &'a str>,
    warnings: &'a [String],
}

#[derive(Serialize)]
struct PrintedCandidate {
    flip_x: bool,
    flip_y: bool,
    rotation_deg: f64,
    sign: f64,
    amplitude: f64,
    correlation: f64,
}

impl PrintedCandidate {
    fn new(candidate: &OrientationCandidate) -> Self {
        let OrientationCandidate { flip: [flip_x, flip_y], rotation_deg, sign, amplitude, correlation, .. } =
            *candidate;
        Self { flip_x, flip_y, rotation_deg, sign, amplitude, correlation }
    }
}

impl<'a> Printed<'a> {
    fn new(found: &'a Orientation) -> Self {
        Self {
            best: PrintedCandidate::new(&found.best),
            runner_up: PrintedCandidate::new(&found.runner_up),
            equivalent: found.equivalent.iter().map(OrientationCandidate::description).collect(),
            settings: found.settings.iter().map(|(key, value)| (key.as_str(), value.as_str())).collect(),
            warnings: &found.warnings,
        }
    }
}

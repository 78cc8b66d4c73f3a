//! `cophase scene`: the documented scenes, and the numbering of a scene's segments.

use super::numbering;
use cophase::reduction::first_scene;
use cophase::scene::{self, Scene};
use cophase::{Error, Result};
use cophase_view::files::{self, Settings};
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs;
use cophase_view::terminal::Terminal;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  cophase scene                                 the names of the presets
  cophase scene keck-artificial > scene.toml    one of them, to edit
  cophase scene --reference                     every key, with its default
  cophase scene scene.toml --plot pupil.png     which segment has which number
  cophase scene --from n0004.fits > scene.toml  one from a frame's header
  cophase scene --from aot.fits > scene.toml    one from a file of AOT

The picture shows the pupil as the maps of an estimate do: x to the right, y up, in metres. The numbers are those of the \
table SEGMENTS, of modes such as segment-07-piston and of 'check --segment'; actuators and subapertures are \
those of the AO loop.";

/// Print a documented scene or draw its numbering instead, or list the scenes that come with the
/// program
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Preset to print, or a TOML file; without it, the presets are listed
    name: Option<PathBuf>,
    /// Print every key that a scene may have
    #[arg(long, conflicts_with = "name")]
    reference: bool,
    /// Print a first scene for the instrument of a raw frame, or for the system of a file of AOT;
    /// what the file does not say is marked in comments
    #[arg(long, value_name = "FRAME", conflicts_with_all = ["name", "reference"])]
    from: Option<PathBuf>,
    /// Draw the pupil with the number of each segment, the actuators and the subapertures (.png or
    /// .svg), in place of the text
    #[arg(long, value_name = "FILE", requires = "name")]
    plot: Option<PathBuf>,
    #[command(flatten)]
    settings: Settings,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    if let Some(name) = &arguments.name {
        return print_scene(name, arguments, terminal);
    }
    if arguments.settings.keys().next().is_some() {
        return Err(Error::Value("--set changes a scene: the name of a preset or a file is needed".into()));
    }
    if let Some(frame) = &arguments.from {
        return terminal.print(&first_scene(frame)?);
    }
    if arguments.reference { terminal.print(&scene::reference()) } else { terminal.print(&listing()?) }
}

/// Prints the scene `name`, or draws it where a picture is asked for.
fn print_scene(name: &Path, arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let output = arguments.plot.as_deref().map(|plot| ("--plot", plot));
    outputs::check(output.as_slice(), &[("the scene", name)])?;
    output.map_or(Ok(()), outputs::check_picture)?;
    let scene = arguments.settings.apply(&named(name)?, &[])?;
    if let Some(output) = output {
        let interrupt = Interrupt::catch()?;
        files::spare_files_of(&scene, &[output])?;
        let wait = terminal.wait("Drawing the pupil", 1);
        let picture = numbering::picture(&scene, terminal)?;
        interrupt.check("nothing was written")?;
        picture.draw(output.1)?;
        drop(wait);
        let name = output.1.display();
        return terminal.show(&format!("{name}: {}\n{}\n", numbering::summary(&picture), in_pixels(&scene)));
    }
    terminal.print(scene.text())
}

/// Sampling of the image in pixels per λ/D, and defocus in waves and nm.
fn in_pixels(scene: &Scene) -> String {
    let image = &scene.image;
    let sampling = image.samples_per_lambda_over_d;
    let mut text = format!("{sampling:.3} pixels per λ/grid_m");
    if let Some(mas) = scene.pixel_mas() {
        text += &format!(" ({mas:.3} of {:.2} mas)", mas * sampling);
    }
    if image.diversity_file.is_none() {
        let waves = image.diversity_focus_waves_rms;
        // A defocus of one wave RMS on a disc, √3 (2r² − 1), has a slope of 4√3 waves a radius at
        // the edge: 8√3 λ/D on either side of the axis.
        let (nm, spot) = (waves * image.wavelength_nm, 16.0 * 3f64.sqrt() * waves.abs() * sampling);
        text += &format!(
            "; defocus {waves:.3} waves RMS ({nm:.0} nm), a spot some {spot:.0} of {} pixels wide",
            image.pixels
        );
    }
    text
}

/// The scene in the file `name`, or the preset; a misspelt preset gets a suggestion.
fn named(name: &Path) -> Result<Scene> {
    let is_word = |word: &&str| !name.exists() && *word != "-" && !word.contains(['.', '/']);
    match name.to_str().filter(is_word) {
        Some(preset) => Scene::preset(preset),
        None => files::scene(name),
    }
}

/// Name and first sentence of each preset.
fn listing() -> Result<String> {
    let mut text = String::new();
    for name in Scene::preset_names() {
        let first = Scene::preset_text(name)?.lines().next().unwrap_or_default();
        text += &format!("{name:<16}  {}\n", first.trim_start_matches(['#', ' ']));
    }
    Ok(text)
}

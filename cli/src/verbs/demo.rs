//! `cophase demo`: the main job on a scene of our own, from nothing to a picture.

use super::{estimate, image};
use cophase::pipeline::Images;
use cophase::scene::Scene;
use cophase::{Error, Result};
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs;
use cophase_view::terminal::Terminal;
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  cophase demo -o demo-output
  cophase demo -o demo-output --seed 7    other aberrations, other noise

It does what these two commands do, in the folder:
  cophase image keck-artificial -o images.fits
  cophase estimate images.fits -o est.fits --plot est.png";

/// Make an image of a star with a segmented telescope, estimate from it, draw the result
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Folder for images.fits, est.fits and est.png; made if it is not there
    #[arg(short, long, value_name = "FOLDER")]
    output: PathBuf,
    /// Seed of the aberrations and of the noise
    #[arg(long, default_value_t = 1, value_parser = cophase_view::files::seed())]
    seed: u64,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let interrupt = Interrupt::catch()?;
    let folder = &arguments.output;
    outputs::refuse_dash(("-o", folder))?;
    std::fs::create_dir_all(folder)
        .map_err(|error| Error::file(folder, format_args!("the folder cannot be made: {error}")))?;
    let [images, output, picture] = ["images.fits", "est.fits", "est.png"].map(|name| folder.join(name));
    outputs::check(&[("images", &images), ("estimate", &output), ("picture", &picture)], &[])?;
    let scene = Scene::preset("keck-artificial")?.with_override("aberrations.seed", &arguments.seed.to_string())?;
    image::make_file(&scene, &images, terminal, &interrupt)?;
    let found = estimate::estimated(&images, &scene, &Images::read(&images, None)?, terminal, &interrupt)?;
    estimate::write(&images, &found, &output, Some(&picture))?;
    estimate::print(&images, &found, arguments.json, terminal)?;
    if arguments.json {
        return Ok(());
    }
    let (images, output, picture) = (images.display(), output.display(), picture.display());
    terminal.show(&format!("\nThe image is in {images}, the estimate in {output}, its picture in {picture}.\n"))
}

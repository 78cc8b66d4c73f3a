//! `cophase image`: images of an artificial source, with the truth behind them.

use cophase::machine;
use cophase::pipeline::SentCorrections;
use cophase::scene::Scene;
use cophase::source;
use cophase::telescope::Telescope;
use cophase::{Error, Result};
use cophase_view::files::{self, Settings};
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs::{self, Flagged};
use cophase_view::terminal::Terminal;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  cophase image keck-artificial -o images.fits
  cophase image scene.toml -o faint.fits --set image.peak_snr=50 --seed 7
  cophase image scene.toml -o corrected.fits --corrections c.fits

The file holds the images (IMAGES, electrons; those of several channels with EXTVER 1, 2, ... and the card CHANNEL), what they were made with (TRUTH_PHASING and TRUTH_NCPA, nm; \
table TRUTH, segment by segment) and the scene (SCENE), so that 'cophase estimate' needs nothing else.";

/// Make images of an artificial source, with their truth
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Scene: a TOML file, or the name of a preset (see 'cophase scene')
    scene: PathBuf,
    /// FITS file to write; one that is there is replaced; .fits.gz is compressed
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Corrections that are applied before the images, as 'cophase estimate --commands FILE.fits'
    /// writes them; repeated, all add up
    #[arg(long, value_name = "FILE.fits")]
    corrections: Vec<PathBuf>,
    #[command(flatten)]
    settings: Settings,
    /// Seed of the aberrations and of the noise [default: aberrations.seed of the scene]
    #[arg(long, value_parser = cophase_view::files::seed())]
    seed: Option<u64>,
    /// Print what was made as JSON
    #[arg(long)]
    json: bool,
}

/// What was made.
#[derive(Serialize)]
struct Made {
    channels: Vec<String>,
    images: usize,
    pixels: usize,
    rows: usize,
    columns: usize,
    flux_e: f64,
    phasing_rms_nm: f64,
    ncpa_rms_nm: f64,
    seconds: f64,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let interrupt = Interrupt::catch()?;
    let output = ("-o", arguments.output.as_path());
    let corrections = arguments.corrections.iter().map(|path| ("--corrections", path.as_path()));
    let inputs: Vec<Flagged> = [("the scene", arguments.scene.as_path())].into_iter().chain(corrections).collect();
    outputs::check(&[output], &inputs)?;
    let sent = arguments.corrections.iter().map(|path| SentCorrections::read(path)).collect::<Result<Vec<_>>>()?;
    let seed = arguments.seed.map(|seed| seed.to_string());
    let options: Vec<(&str, &str)> = seed.iter().map(|seed| ("aberrations.seed", seed.as_str())).collect();
    let scene = arguments.settings.apply(&files::scene(&arguments.scene)?, &options)?;
    files::spare_files_of(&scene, &[output])?;
    if scene.wavefront_sensor.is_some() {
        let name = scene.name();
        terminal.warn(&format!("{name}: its turbulence and AO loop are left out, 'image' makes an artificial source"));
    }
    let made = make(&scene, &sent, &arguments.output, terminal, &interrupt)?;
    if arguments.json {
        return terminal.json(&made);
    }
    let Made { channels, images, rows, columns, flux_e, phasing_rms_nm, ncpa_rms_nm, seconds, .. } = made;
    let each = match channels.as_slice() {
        [] => format!("of {columns}x{rows} pixels, {flux_e:.3e} electrons each"),
        channels => {
            format!("in {} ({})", cophase_view::terminal::counted(channels.len(), "channel"), channels.join(", "))
        }
    };
    terminal.show(&format!(
        "{}: {} {each}, phasing {phasing_rms_nm:.2} nm and NCPA \
         {ncpa_rms_nm:.2} nm RMS, made in {seconds:.1} s\n",
        arguments.output.display(),
        cophase_view::terminal::counted(images, "image"),
    ))
}

/// Makes the images of `scene` after the corrections `sent`, and writes them.
fn make(
    scene: &Scene,
    sent: &[SentCorrections],
    output: &Path,
    terminal: &Terminal,
    interrupt: &Interrupt,
) -> Result<Made> {
    let started = Instant::now();
    check_memory(scene)?;
    let made = {
        let _wait =
            terminal.wait(&format!("Making {}", cophase_view::terminal::counted(scene.image.count, "image")), 1);
        source::simulate_with(scene, &|truth, scene, telescope| {
            sent.iter().try_fold(truth, |truth, sent| sent.apply(truth, scene, telescope))
        })?
    };
    interrupt.check("the images were made, nothing was written")?;
    source::write(output, scene, scene.text(), &made)?;
    let pupil = Telescope::new(scene)?.pupil;
    let rms = |map: &ndarray::Array2<f64>| pupil.rms(pupil.remove_piston_tip_tilt(map.view())?.view());
    let Some(first) = made.first() else { return Err(Error::Internal("no images were made".into())) };
    let (rows, columns) = scene.image.frame_shape();
    Ok(Made {
        channels: scene.channels().iter().map(|channel| channel.name.clone()).collect(),
        images: made.iter().map(|channel| channel.images_e.dim().0).sum(),
        pixels: scene.image.pixels,
        rows,
        columns,
        flux_e: first.flux_e,
        phasing_rms_nm: rms(&first.truth.phasing_nm)?,
        ncpa_rms_nm: rms(&first.truth.ncpa_nm)?,
        seconds: started.elapsed().as_secs_f64(),
    })
}

/// Refuses a sequence that the memory cannot hold.
pub fn check_memory(scene: &Scene) -> Result<()> {
    /// The image in double precision, and three copies in single while the file is put together.
    const BYTES_PER_PIXEL: u64 = 8 + 3 * 4;
    let bytes = |scene: &Scene| {
        let (rows, columns) = scene.image.frame_shape();
        (scene.image.count as u64).saturating_mul((rows * columns) as u64).saturating_mul(BYTES_PER_PIXEL)
    };
    let bytes = scene.each_channel().into_iter().map(|(_, own)| bytes(own)).fold(0, u64::saturating_add);
    let (images, (rows, columns)) =
        (cophase_view::terminal::counted(scene.image.count, "image"), scene.image.frame_shape());
    let each = if scene.channels().is_empty() { "" } else { " in each of its channels" };
    let what = format!("{}: {images} of {columns}x{rows} pixels{each}", scene.name());
    machine::check_memory(what, bytes, "lower image.count or image.pixels")
}

/// [`make`] for the demonstration.
pub fn make_file(scene: &Scene, output: &Path, terminal: &Terminal, interrupt: &Interrupt) -> Result<()> {
    make(scene, &[], output, terminal, interrupt).map(drop)
}

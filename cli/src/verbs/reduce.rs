//! `cophase reduce`: raw frames of a detector to the images that `estimate` takes.

use cophase::io::{self, FitsReader};
use cophase::reduction::{
    ChannelRule, FrameClass, LogRow, Pattern, RawFrame, Reduction, ReductionOptions, list_files, read_frames, reduce,
};
use cophase::scene::Scene;
use cophase::{Error, Result};
use cophase_view::files::{self, Settings};
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs;
use cophase_view::terminal::{Terminal, counted};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  cophase reduce raw/ --scene scene.toml -o images.fits
  cophase reduce raw/ --scene s.toml -o images.fits --darks d/ --flats f/
  cophase reduce raw/ --scene s.toml -o images.fits --channel plus=OBWF=-1.5
  cophase estimate images.fits -o est.fits

A list (--darks, --flats, --lamp-off, --skies, --stars) decides for its files. For others the header does, in this order: a card \
KOAIMTYP, IMAGETYP, OBSTYPE or IMTYPE that names a dark, bias, flat or sky; such a word in OBJECT; a shutter that is closed (SHRNAME, \
SHUTTER); else it is a frame of the star.";

/// Reduce raw frames (star, darks, flats, sky) to the images that 'estimate' takes
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Raw frames: files, folders, or patterns of file names with * and ?
    #[arg(required = true, value_name = "RAW")]
    raw: Vec<PathBuf>,
    /// Scene of the images: a TOML file, or the name of a preset
    #[arg(long)]
    scene: PathBuf,
    /// FITS file to write; one that is there is replaced
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Frames of the star, whatever their headers say
    #[arg(long, value_name = "RAW", num_args = 1..)]
    stars: Vec<PathBuf>,
    /// Darks: files, folders or patterns
    #[arg(long, value_name = "RAW", num_args = 1..)]
    darks: Vec<PathBuf>,
    /// Flats
    #[arg(long, value_name = "RAW", num_args = 1..)]
    flats: Vec<PathBuf>,
    /// Frames as the flats, with the lamp off
    #[arg(long, value_name = "RAW", num_args = 1..)]
    lamp_off: Vec<PathBuf>,
    /// Frames of the sky without the star; without them the sky is the median of the other dither
    /// positions
    #[arg(long, value_name = "RAW", num_args = 1..)]
    skies: Vec<PathBuf>,
    /// Channel of the scene whose frames have file names like PATTERN; NAME=CARD=PATTERN for a
    /// header card; may be repeated
    #[arg(long = "channel", value_name = "NAME=PATTERN", value_parser = channel_rule)]
    channels: Vec<ChannelRule>,
    /// FITS file that marks bad pixels of the detector with other values than 0
    #[arg(long, value_name = "FILE")]
    mask: Option<PathBuf>,
    /// Pixels along a side of the cut-out about the star [default: image.pixels of the scene]
    #[arg(long, value_name = "N")]
    pixels: Option<usize>,
    /// Counts of one coadd from which a pixel is saturated [default: image.saturation_adu of the
    /// scene]
    #[arg(long, value_name = "COUNTS")]
    saturation: Option<f64>,
    /// Make no sky of the dithers
    #[arg(long)]
    no_dither_sky: bool,
    #[command(flatten)]
    settings: Settings,
    /// Print the log as JSON
    #[arg(long)]
    json: bool,
}

fn channel_rule(text: &str) -> std::result::Result<ChannelRule, String> {
    let wanted =
        || format!("'{text}' is not accepted; NAME=PATTERN or NAME=CARD=PATTERN is needed, such as plus=n00*.fits");
    let (channel, rest) = text.split_once('=').ok_or_else(wanted)?;
    let (card, pattern) = rest.split_once('=').map_or((None, rest), |(card, pattern)| (Some(card.trim()), pattern));
    let is_complete =
        !channel.trim().is_empty() && !pattern.trim().is_empty() && card.is_none_or(|card| !card.is_empty());
    let rule = ChannelRule {
        channel: channel.trim().into(),
        card: card.map(str::to_uppercase),
        pattern: Pattern::new(pattern),
    };
    if is_complete { Ok(rule) } else { Err(wanted()) }
}

/// What was made.
#[derive(Serialize)]
struct Made<'a> {
    images: usize,
    channels: Vec<Channel<'a>>,
    bad_pixels: usize,
    frames: Vec<Row<'a>>,
    warnings: &'a [String],
    remarks: &'a [String],
    seconds: f64,
}

#[derive(Serialize)]
struct Channel<'a> {
    name: Option<&'a str>,
    images: usize,
    noise_e: f64,
}

#[derive(Serialize)]
struct Row<'a> {
    file: &'a str,
    class: &'a str,
    channel: &'a str,
    itime_s: f64,
    coadds: u32,
    x: f64,
    y: f64,
    flux_e: f64,
    peak_adu: f64,
    background_e: f64,
    elongation: f64,
    used: bool,
    reason: &'a str,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let started = Instant::now();
    let interrupt = Interrupt::catch()?;
    let output = ("-o", arguments.output.as_path());
    let scene = scene(arguments)?;
    let inputs = inputs(arguments)?;
    let mut read: Vec<(&str, &Path)> = inputs.iter().map(|(path, _)| ("a raw frame", path.as_path())).collect();
    read.push(("the scene", &arguments.scene));
    read.extend(arguments.mask.iter().map(|mask| ("--mask", mask.as_path())));
    outputs::check(&[output], &read)?;
    files::spare_files_of(&scene, &[output])?;
    let (frames, unreadable) = {
        let _wait = terminal.wait(&format!("Reading {}", counted(inputs.len(), "file")), 1);
        read_frames(&inputs, &arguments.channels, scene.image.pupil_turn_card.as_deref())
    };
    interrupt.check("nothing was written")?;
    let mut reduction = {
        let _wait = terminal.wait(&format!("Reducing {}", counted(frames.len(), "frame")), 1);
        reduced(arguments, &scene, &frames, &unreadable)?
    };
    reduction.log.extend(unreadable);
    interrupt.check("nothing was written")?;
    reduction.write(&arguments.output, &scene)?;
    report(arguments, &reduction, started.elapsed().as_secs_f64(), terminal)
}

/// The scene with the options.
fn scene(arguments: &Arguments) -> Result<Scene> {
    let pixels = arguments.pixels.map(|pixels| pixels.to_string());
    let saturation = arguments.saturation.map(|counts| counts.to_string());
    let options = [("image.pixels", pixels.as_deref()), ("image.saturation_adu", saturation.as_deref())];
    let options: Vec<(&str, &str)> = options.iter().filter_map(|(key, value)| Some((*key, (*value)?))).collect();
    let scene = arguments.settings.apply(&files::scene(&arguments.scene)?, &options)?;
    let channels = scene.channels();
    if let Some(rule) =
        arguments.channels.iter().find(|rule| channels.iter().all(|channel| channel.name != rule.channel))
    {
        let names: Vec<&str> = channels.iter().map(|channel| channel.name.as_str()).collect();
        let there = if names.is_empty() { "it has none".into() } else { format!("it has {}", names.join(", ")) };
        return Err(Error::Scene(format!("{}: --channel names the channel {}; {there}", scene.name(), rule.channel)));
    }
    Ok(scene)
}

/// The files with the class that a list gives them. A reduction that is to be replaced is none of
/// them.
fn inputs(arguments: &Arguments) -> Result<Vec<(PathBuf, Option<FrameClass>)>> {
    let mut inputs: Vec<(PathBuf, Option<FrameClass>)> = Vec::new();
    let lists = [
        (&arguments.stars, Some(FrameClass::Star)),
        (&arguments.darks, Some(FrameClass::Dark)),
        (&arguments.flats, Some(FrameClass::Flat)),
        (&arguments.lamp_off, Some(FrameClass::LampOff)),
        (&arguments.skies, Some(FrameClass::Sky)),
        (&arguments.raw, None),
    ];
    let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    let is_old = FitsReader::open(&arguments.output).is_ok_and(|file| file.has("REDUCTION"));
    let output = real(&arguments.output);
    for (list, class) in lists {
        for path in list_files(list)?.into_iter().filter(|path| !(is_old && real(path) == output)) {
            match inputs.iter().find(|(known, _)| real(known) == real(&path)) {
                Some((_, known)) if class.is_some() && *known != class => {
                    let [one, other] = [known, &class].map(|class| class.map_or("", FrameClass::name));
                    return Err(Error::file(
                        &path,
                        format_args!("is listed as {one} and as {other}: one of them is accepted"),
                    ));
                }
                Some(_) => {}
                None => inputs.push((path, class)),
            }
        }
    }
    Ok(inputs)
}

fn reduced(arguments: &Arguments, scene: &Scene, frames: &[RawFrame], unreadable: &[LogRow]) -> Result<Reduction> {
    if let (true, Some(first)) = (frames.is_empty(), unreadable.first()) {
        return Err(Error::Image(format!("no frame can be read ({}: {})", first.file, first.reason)));
    }
    let bad = arguments.mask.as_deref().map(io::read_mask).transpose()?;
    let mut overrides: Vec<String> = arguments.settings.keys().map(String::from).collect();
    overrides.dedup();
    reduce(scene, frames, &ReductionOptions { bad, is_without_dither_sky: arguments.no_dither_sky, overrides })
}

fn report(arguments: &Arguments, reduction: &Reduction, seconds: f64, terminal: &Terminal) -> Result<()> {
    reduction.warnings.iter().for_each(|warning| terminal.warn(warning));
    let channels = reduction.channels.iter().map(|channel| Channel {
        name: channel.name.as_deref(),
        images: channel.images_e.dim().0,
        noise_e: channel.noise_e,
    });
    let channels: Vec<Channel> = channels.collect();
    let images = channels.iter().map(|channel| channel.images).sum();
    if arguments.json {
        let frames = reduction.log.iter().map(row).collect();
        let Reduction { bad_pixels, warnings, remarks, .. } = reduction;
        return terminal.json(&Made { images, channels, bad_pixels: *bad_pixels, frames, warnings, remarks, seconds });
    }
    let rejected = reduction.log.iter().filter(|row| !row.is_used).count();
    let mut text = table(&reduction.log);
    let mut after = vec![counted(reduction.bad_pixels, "bad pixel")];
    after.splice(0..0, reduction.steps.iter().cloned());
    text += &format!(
        "{}: {}, {} not used; {}\n",
        arguments.output.display(),
        counted(images, "image"),
        counted(rejected, "frame"),
        after.join(", ")
    );
    reduction.remarks.iter().for_each(|remark| text += &format!("{remark}\n"));
    for channel in channels {
        let name = channel
            .name
            .map(|name| format!("channel {name}: {}, ", counted(channel.images, "image")))
            .unwrap_or_default();
        text += &format!("{name}noise of a pixel {:.1} electrons\n", channel.noise_e);
    }
    terminal.show(&text)
}

fn row(row: &LogRow) -> Row<'_> {
    let LogRow { itime_s, coadds, x, y, flux_e, peak_adu, background_e, elongation, is_used, .. } = *row;
    let (file, class, channel, reason) =
        (row.file.as_str(), row.class.name(), row.channel.as_str(), row.reason.as_str());
    Row {
        file,
        class,
        channel,
        itime_s,
        coadds,
        x,
        y,
        flux_e,
        peak_adu,
        background_e,
        elongation,
        used: is_used,
        reason,
    }
}

/// The log as a table for people.
fn table(rows: &[LogRow]) -> String {
    let width = rows.iter().map(|row| row.file.chars().count()).max().unwrap_or(0).max(4);
    let number = |value: f64, digits: usize| if value.is_finite() { format!("{value:.digits$}") } else { "-".into() };
    let mut text = format!(
        "{:width$}  {:8}  {:8}  {:>8}  {:>6}  {:>7}  {:>7}  {:>10}  {:>8}  {:>8}  used  why\n",
        "file", "class", "channel", "itime s", "coadds", "x", "y", "flux e", "peak", "backgr e"
    );
    for row in rows {
        let flux = if row.flux_e.is_finite() { format!("{:.3e}", row.flux_e) } else { "-".into() };
        text += &format!(
            "{:width$}  {:8}  {:8}  {:>8}  {:>6}  {:>7}  {:>7}  {:>10}  {:>8}  {:>8}  {:4}  {}\n",
            row.file,
            row.class.name(),
            row.channel,
            number(row.itime_s, 3),
            row.coadds,
            number(row.x, 1),
            number(row.y, 1),
            flux,
            number(row.peak_adu, 0),
            number(row.background_e, 1),
            if row.is_used { "yes" } else { "no" },
            row.reason
        );
    }
    text
}

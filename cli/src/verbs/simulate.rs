//! `cophase simulate`: an AO loop under a sky, its images, the truth, the telemetry.

use cophase::Result;
use cophase::ao::{self, LoopStage, Shot, Simulator, Summary};
use cophase::pipeline::{Part, SentCorrections};
use cophase::scene::{Scene, System};
use cophase_view::files::{self, Settings};
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs::{self, Flagged};
use cophase_view::ranks::{Rank, Share};
use cophase_view::terminal::Terminal;
use serde::Serialize;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  cophase simulate keck-onsky -o onsky.fits
  cophase simulate scene.toml -o pol.fits --set control.loop=pseudo-open-loop --seed 7
  cophase simulate keck-onsky -o onsky.fits --aot onsky-aot.fits
  cophase simulate keck-onsky -o again.fits --corrections first.fits --corrections second.fits
  cophase simulate keck-onsky -o night.fits --seeds 100 --part 3/8

The file holds the defocused images (IMAGES, electrons), the truth (TRUTH_PHASING and TRUTH_NCPA, nm), telemetry at each \
image (SLOPES, mas; COMMANDS, nm; SHOTS) with the interaction matrix, and the scene, so that 'cophase estimate' needs \
nothing else. A scene with channels has IMAGES and the telemetry of each channel, with EXTVER 1, 2, ... and the card CHANNEL; they are \
exposed one after the other in one run of the loop, or together with image.simultaneous = true.";

/// Close an AO loop on the telescope: images, truth, telemetry
#[derive(clap::Args)]
#[command(after_long_help = EXAMPLES)]
pub struct Arguments {
    /// Scene: a TOML file, or the name of a preset (see 'cophase scene')
    scene: PathBuf,
    /// FITS file to write; one that is there is replaced; .fits.gz is compressed
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Also write images, slopes, commands and loop as a file of AOT, the telemetry standard of
    /// adaptive optics (docs/aot.md)
    #[arg(long, value_name = "FILE")]
    aot: Option<PathBuf>,
    /// Corrections that were sent before the images, as 'cophase estimate --commands FILE.fits'
    /// writes them: the truth is what they leave; may be given more than once, they add up
    #[arg(long, value_name = "FILE")]
    corrections: Vec<PathBuf>,
    #[command(flatten)]
    settings: Settings,
    /// Seed of the aberrations, the turbulence and the noise [default: those of the scene]
    #[arg(long, value_parser = cophase_view::files::seed())]
    seed: Option<u64>,
    /// Make N runs with the seeds from --seed (else 1) on, each a file with its seed in its name:
    /// night-1.fits, night-2.fits, ...
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1_000_000), conflicts_with = "aot")]
    seeds: Option<u32>,
    /// Make every N-th of the runs from the I-th on; rank: the part of this process under mpirun or
    /// srun
    #[arg(long, value_name = "I/N|rank", requires = "seeds")]
    part: Option<Share>,
    /// Print the result as JSON
    #[arg(long)]
    json: bool,
    /// Also say how the time of a frame is spent, beside the least that each stage has to do
    #[arg(short, long)]
    verbose: bool,
}

/// What scripts read.
#[derive(Serialize)]
struct Made {
    channels: Vec<String>,
    images: usize,
    /// Images of each channel.
    channel_images: Vec<usize>,
    frames: u64,
    seconds: f64,
    frames_per_s: f64,
    residual_rms_nm: f64,
    strehl_k: f64,
    diverged: bool,
    diverged_at_s: Option<f64>,
    warnings: Vec<String>,
    growth_per_s: f64,
}

pub fn run(arguments: &Arguments, terminal: &Terminal) -> Result<()> {
    let interrupt = Interrupt::catch()?;
    let Some(seeds) = arguments.seeds else {
        let made = one(arguments, arguments.seed, &arguments.output, terminal, &interrupt)?;
        return if arguments.json { terminal.json(&made) } else { Ok(()) };
    };
    let share = |part: Part| part.items(seeds as usize);
    let (own, rank) = match arguments.part {
        None => ((0..seeds as usize).collect(), None),
        Some(Share::Part(part)) => (share(part), None),
        Some(Share::Rank) => {
            let rank = Rank::of_this_process()?;
            (share(rank.part()?), Some(rank))
        }
    };
    let first = arguments.seed.unwrap_or(1);
    let run = |place: usize| {
        let seed = first.saturating_add(place as u64);
        one(arguments, Some(seed), &with_seed(&arguments.output, seed), terminal, &interrupt)
    };
    let made = own.into_iter().map(run).collect::<Result<Vec<_>>>();
    let made = made.map_err(|error| match rank {
        Some(rank) => rank.name(error),
        None => error,
    })?;
    if arguments.json { terminal.json(&made) } else { Ok(()) }
}

/// `output` with a seed behind its name, before its extension: night.fits.gz is night-7.fits.gz.
fn with_seed(output: &Path, seed: u64) -> PathBuf {
    let name = output.file_name().unwrap_or_default().to_string_lossy();
    let (stem, extension) = name.rfind(".fit").map_or((&*name, ""), |at| name.split_at(at));
    output.with_file_name(format!("{stem}-{seed}{extension}"))
}

/// One run, written to `output` and shown, unless JSON is wanted; returns its figures.
fn one(
    arguments: &Arguments,
    seed: Option<u64>,
    output: &Path,
    terminal: &Terminal,
    interrupt: &Interrupt,
) -> Result<Made> {
    let aot = arguments.aot.as_deref().map(|path| ("--aot", path));
    let written: Vec<Flagged> = [("-o", output)].into_iter().chain(aot).collect();
    let corrections = arguments.corrections.iter().map(|path| ("--corrections", path.as_path()));
    let inputs: Vec<Flagged> = [("the scene", arguments.scene.as_path())].into_iter().chain(corrections).collect();
    outputs::check(&written, &inputs)?;
    let seed = seed.map(|seed| seed.to_string());
    let options: Vec<(&str, &str)> =
        seed.iter().flat_map(|seed| ["aberrations.seed", "turbulence.seed"].map(|key| (key, seed.as_str()))).collect();
    let scene = arguments.settings.apply(&files::scene(&arguments.scene)?, &options)?;
    files::spare_files_of(&scene, &written)?;
    if arguments.aot.is_some() {
        ao::check_aot(&scene)?;
    }
    super::image::check_memory(&scene)?;
    let sent = arguments.corrections.iter().map(|path| SentCorrections::read(path)).collect::<Result<Vec<_>>>()?;
    let (simulator, shots, summary) = simulate(&scene, &sent, terminal, interrupt)?;
    ao::write(output, scene.text(), &simulator, &shots, &summary)?;
    if let Some(path) = &arguments.aot {
        ao::write_aot(path, scene.text(), &simulator, &shots, &summary)?;
    }
    simulator.warnings().iter().for_each(|warning| terminal.warn(warning));
    if let Some(divergence) = summary.divergence {
        terminal.warn(&format!(
            "the loop diverged after {:.2} s, at {:.0} nm RMS; what was there by then is written",
            divergence.time_s, divergence.residual_rms_nm
        ));
    }
    let made = made(&simulator, &shots, &summary);
    if arguments.json {
        return Ok(made);
    }
    let mut text = format!(
        "{}: {} {} from {} frames in {:.1} s ({:.0} frames/s, {:.1} times the loop's own rate)\n\
         residual {:.1} nm RMS, Strehl {:.3} at {} nm (by Marechal {:.3}); {}\n",
        output.display(),
        cophase_view::terminal::counted(summary.images, "image"),
        sizes(&scene, &shots),
        summary.frames,
        summary.seconds,
        summary.frames_per_s(),
        summary.frames_per_s() * simulator.frame_s(),
        summary.residual_rms_nm,
        summary.strehl,
        scene.image.wavelength_nm,
        summary.strehl_marechal,
        stability(&simulator),
    );
    if arguments.verbose {
        text += &stages(&simulator, &summary);
    }
    terminal.show(&text)?;
    Ok(made)
}

/// The run itself, after the corrections `sent`.
fn simulate(
    scene: &Scene,
    sent: &[SentCorrections],
    terminal: &Terminal,
    interrupt: &Interrupt,
) -> Result<(Simulator, Vec<Shot>, Summary)> {
    let mut simulator = {
        let _wait = terminal.wait("Building the AO system", 1);
        SentCorrections::system(sent, scene)?
    };
    interrupt.check("nothing was written")?;
    if !simulator.stability().stable {
        terminal.warn(&stability(&simulator));
    }
    let mut shots: Vec<Shot> = Vec::new();
    let wait = terminal.follow();
    let summary = simulator.run(&mut shots, &interrupt.control(&wait))?;
    Ok((simulator, shots, summary))
}

/// Size of the images; for a scene with channels also their number in each.
fn sizes(scene: &Scene, shots: &[Shot]) -> String {
    let size = |scene: &Scene| {
        let (rows, columns) = scene.image.frame_shape();
        format!("of {columns}x{rows} pixels")
    };
    if scene.channels().is_empty() {
        return size(scene);
    }
    let each = scene.channels().iter().zip(channel_images(scene, shots));
    let each: Vec<String> =
        each.map(|(channel, images)| format!("{}: {images} {}", channel.name, size(&channel.scene))).collect();
    format!("in {} ({})", cophase_view::terminal::counted(each.len(), "channel"), each.join(", "))
}

/// Number of images of each channel; empty for a scene without channels.
fn channel_images(scene: &System, shots: &[Shot]) -> Vec<usize> {
    let count = |channel| shots.iter().filter(|shot| shot.channel == channel).count();
    (0..scene.channels().len()).map(count).collect()
}

fn made(simulator: &Simulator, shots: &[Shot], summary: &Summary) -> Made {
    let scene = simulator.scene();
    Made {
        channels: scene.channels().iter().map(|channel| channel.name.clone()).collect(),
        images: summary.images,
        channel_images: channel_images(scene, shots),
        frames: summary.frames,
        seconds: summary.seconds,
        frames_per_s: summary.frames_per_s(),
        residual_rms_nm: summary.residual_rms_nm,
        strehl_k: summary.strehl,
        diverged: summary.divergence.is_some(),
        diverged_at_s: summary.divergence.map(|divergence| divergence.time_s),
        warnings: simulator.warnings(),
        growth_per_s: simulator.stability().growth_per_frame.ln() / simulator.frame_s(),
    }
}

/// Time in each stage beside the least it has to do; the turbulence and the camera have threads of
/// their own.
fn stages(simulator: &Simulator, summary: &Summary) -> String {
    let mut text = String::from("stage          us/frame     Mflop        kB   GFLOP/s      GB/s\n");
    for stage in LoopStage::ALL {
        let us = summary.profile.seconds(stage) * 1e6 / summary.frames as f64;
        let work = simulator.work(stage);
        let (mflop, kb) = (work.flops / 1e6, work.bytes / 1e3);
        let rates = (mflop * 1e3 / us, kb / us);
        text += &format!("{:<12} {us:>10.1} {mflop:>9.2} {kb:>9.0} {:>9.1} {:>9.1}\n", stage.name(), rates.0, rates.1);
    }
    text + &format!("{:<12} {:>10.1}\n", "camera", summary.camera_s * 1e6 / summary.frames as f64)
}

/// What the poles of the loop say.
fn stability(simulator: &Simulator) -> String {
    let poles = simulator.stability();
    let modes = format!("{} modes controlled", poles.controlled);
    match poles.e_folding_s {
        Some(e_folding_s) => format!("{modes}; unstable: the worst of them grows e-fold in {e_folding_s:.3} s"),
        None => format!("{modes}, stable up to a gain of {:.2}", poles.largest_stable_gain),
    }
}

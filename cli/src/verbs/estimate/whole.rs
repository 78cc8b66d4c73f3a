//! The estimate from all images, and what is made of it.

use super::arguments::Arguments;
use super::report;
use super::summary::Summary;
use crate::verbs::{moves, picture};
use cophase::Result;
use cophase::pipeline::{Corrections, Estimate, Estimator, FittedPart, Images, PartFits, Policy};
use cophase::scene::Scene;
use cophase_view::files;
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs;
use cophase_view::terminal::{DOUBTFUL_STATUS, Terminal, Wait, counted};
use std::path::Path;
use std::process::ExitCode;

/// What an estimate works on.
pub(super) struct Work {
    pub(super) images: Vec<Images>,
    pub(super) estimator: Estimator,
}

impl Work {
    /// Reads the inputs; refuses corrections that the scene does not describe, and outputs that are
    /// files of the scene.
    pub(super) fn new(arguments: &Arguments, bar: &Wait, interrupt: &Interrupt) -> Result<Self> {
        let (scene, images) = arguments.inputs()?;
        files::spare_files_of(&scene, &arguments.outputs())?;
        if arguments.are_corrections_wanted() {
            Corrections::check_controllers(&scene)?;
        }
        let estimator = estimator(&scene, bar, interrupt)?;
        Ok(Self { images, estimator })
    }
}

/// The estimate from all images; fits of `parts`, where there are some, are not made again.
pub(super) fn estimate_whole(
    mut arguments: Arguments,
    parts: Vec<FittedPart>,
    terminal: &Terminal,
    interrupt: &Interrupt,
) -> Result<ExitCode> {
    arguments.check_outputs()?;
    let _copy = match &mut arguments.images {
        Some(images) => outputs::copy_standard_input(images, interrupt)?,
        None => None,
    };
    let bar = terminal.follow();
    let work = Work::new(&arguments, &bar, interrupt)?;
    conclude(&arguments, work, parts, bar, terminal)
}

/// As [`whole`], from `work`, whose progress `bar` shows.
pub(super) fn conclude(
    arguments: &Arguments,
    work: Work,
    parts: Vec<FittedPart>,
    bar: Wait,
    terminal: &Terminal,
) -> Result<ExitCode> {
    let Work { images, estimator, .. } = work;
    let mut parts = if parts.is_empty() { None } else { Some(PartFits::of_all(parts)?) };
    let estimate = match &mut parts {
        None => estimator.estimate(&images),
        Some(parts) => estimator.estimate_from_parts(&images, parts),
    };
    let estimate = estimate.map_err(files::about(arguments.first()))?;
    drop(bar);
    if let Some(parts) = parts.filter(|_| arguments.verbose && !arguments.json) {
        let made = counted(parts.made(), "fit");
        terminal.show(&format!("{made} that no part has, because they depend on all images\n"))?;
    }
    let corrections = arguments.are_corrections_wanted().then(|| estimate.corrections(None)).transpose()?;
    write(arguments.first(), &estimate, &arguments.output, arguments.plot.as_deref())?;
    if let Some(opd) = &arguments.opd {
        estimate.write_opd(opd)?;
    }
    if let Some(path) = &arguments.report {
        report::write(path, arguments.first(), &estimate)?;
    }
    if let Some(corrections) = &corrections {
        arguments.write_corrections(&estimate, corrections, terminal)?;
    }
    print(arguments.first(), &estimate, arguments.json, terminal)?;
    if let Some(corrections) = corrections.as_ref().filter(|_| !arguments.json) {
        terminal.show(&format!("corrections: {}\n", corrections.summary()))?;
    }
    if let Some(modal) = estimate.modal().filter(|_| arguments.verbose && !arguments.json) {
        terminal.show(&format!("\n{}\n", modal.degeneracy))?;
    }
    let is_doubtful = arguments.strict && !estimate.is_sound();
    Ok(if is_doubtful { ExitCode::from(DOUBTFUL_STATUS) } else { ExitCode::SUCCESS })
}

/// The estimate of `images`, those of each channel, which are of the file `name`, with a progress
/// bar.
pub fn estimated(
    name: &Path,
    scene: &Scene,
    images: &[Images],
    terminal: &Terminal,
    interrupt: &Interrupt,
) -> Result<Estimate> {
    let bar = terminal.follow();
    estimator(scene, &bar, interrupt)?.estimate(images).map_err(files::about(name))
}

/// The estimator of a scene, which shows its progress on `bar` and stops at Ctrl-C.
fn estimator(scene: &Scene, bar: &Wait, interrupt: &Interrupt) -> Result<Estimator> {
    Estimator::with_policy(scene, Policy::default(), interrupt.control(bar))
}

/// Writes the estimate, and its picture where one is asked for.
pub fn write(name: &Path, estimate: &Estimate, output: &Path, plot: Option<&Path>) -> Result<()> {
    estimate.write(output)?;
    let Some(plot) = plot else { return Ok(()) };
    let name = name.file_name().unwrap_or(name.as_os_str()).to_string_lossy();
    picture::picture(&name, estimate)?.draw(plot)
}

/// Prints the result on stdout, and the warnings on stderr.
pub fn print(name: &Path, estimate: &Estimate, json: bool, terminal: &Terminal) -> Result<()> {
    let name = name.display();
    for sentence in &estimate.warnings {
        terminal.warn(&format!("{name}: {sentence}"));
    }
    if json {
        return terminal.json(&Summary::new(estimate));
    }
    terminal.show(&format!("{name}: {}", estimate.summary()))
}

impl Arguments {
    fn are_corrections_wanted(&self) -> bool {
        self.commands.is_some() || self.commands_plot.is_some()
    }

    /// Writes and draws the corrections, as far as they are asked for.
    fn write_corrections(&self, estimate: &Estimate, corrections: &Corrections, terminal: &Terminal) -> Result<()> {
        if let Some(path) = &self.commands {
            corrections.write(path)?;
        }
        if let Some(path) = &self.commands_plot {
            moves::picture(self.first(), estimate, corrections)?.draw(path)?;
        }
        for sentence in &corrections.warnings {
            terminal.warn(&format!("{}: {sentence}", self.first().display()));
        }
        if corrections.limited > 0 {
            let what = counted(corrections.limited, "command");
            terminal.warn(&format!("{}: cut at a limit: {what} of the corrections", self.first().display()));
        }
        Ok(())
    }
}

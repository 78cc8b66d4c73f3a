//! `cophase estimate --part rank`: each process that mpirun or srun starts fits its part, and the
//! first makes the estimate of all.
//!
//! The parts are files in the folder `OUTPUT.parts`, which all processes see. Where a job was
//! stopped the folder stays, and the same command, with any number of processes, takes the fits
//! that are there.

use super::arguments::Arguments;
use super::part;
use super::whole::{Work, conclude, estimate_whole};
use cophase::pipeline::{FittedPart, Part};
use cophase::{Error, Result};
use cophase_view::interrupt::Interrupt;
use cophase_view::ranks::{Heartbeat, LOOK, Rank, RankMonitor};
use cophase_view::terminal::{Terminal, Wait};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The share of this process.
pub(super) fn run(arguments: Arguments, terminal: &Terminal, interrupt: &Interrupt) -> Result<ExitCode> {
    let rank = Rank::of_this_process()?;
    if rank.of == 1 {
        return estimate_whole(arguments, Vec::new(), terminal, interrupt);
    }
    share(&arguments, rank, terminal, interrupt).map_err(|error| rank.name(error))
}

fn share(arguments: &Arguments, rank: Rank, terminal: &Terminal, interrupt: &Interrupt) -> Result<ExitCode> {
    arguments.check_outputs()?;
    let folder = folder_of(&arguments.output);
    std::fs::create_dir_all(&folder).map_err(|error| Error::file(&folder, format!("cannot be made: {error}")))?;
    if rank.number == 0 {
        let status = first(arguments, rank, &folder, terminal, interrupt)?;
        remove(&folder);
        return Ok(status);
    }
    let heartbeat = Heartbeat::start(&folder, rank);
    // One bar is enough.
    let bar = Terminal::new(true).follow();
    match fitted(arguments, rank, &folder, &bar, interrupt) {
        Ok(_) => Ok(ExitCode::SUCCESS),
        Err(error) => {
            heartbeat.fail(&error);
            Err(error)
        }
    }
}

/// Fits and writes the part of a rank.
fn fitted(
    arguments: &Arguments,
    rank: Rank,
    folder: &Path,
    bar: &Wait,
    interrupt: &Interrupt,
) -> Result<(Work, FittedPart)> {
    // A file of another version, or one that is damaged, is no loss.
    let earlier = parts_in(folder).iter().filter_map(|path| FittedPart::read(path).ok()).collect();
    let work = part::work(arguments, bar, interrupt)?;
    let fitted = part::fit(arguments, &work, rank.part()?, earlier)?;
    fitted.write(folder.join(name_of(fitted.part)))?;
    Ok((work, fitted))
}

/// The first rank: fits its part, waits for the others, and makes the estimate.
fn first(
    arguments: &Arguments,
    rank: Rank,
    folder: &Path,
    terminal: &Terminal,
    interrupt: &Interrupt,
) -> Result<ExitCode> {
    let mut monitors = RankMonitor::of_others(folder, rank);
    let bar = terminal.follow();
    let (work, own) = fitted(arguments, rank, folder, &bar, interrupt)?;
    let mut parts = vec![own];
    loop {
        let mut missing = Vec::new();
        for mut monitor in monitors {
            match part_of(folder, monitor.rank().part()?, &parts[0]) {
                Some(found) => parts.push(found),
                None => {
                    monitor.check()?;
                    missing.push(monitor);
                }
            }
        }
        if missing.is_empty() {
            return conclude(arguments, work, parts, bar, terminal);
        }
        monitors = missing;
        interrupt.check("the other ranks were not done")?;
        std::thread::sleep(LOOK);
    }
}

/// The part in `folder`, where it is there and of the same estimate as `own`: another one is left
/// from an earlier job, and replaced.
fn part_of(folder: &Path, part: Part, own: &FittedPart) -> Option<FittedPart> {
    let path = folder.join(name_of(part));
    if !path.exists() {
        return None;
    }
    FittedPart::read(path).ok().filter(|found| found.part == part && found.is_of_same_estimate(own))
}

/// The folder of the parts of an estimate that is written to `output`.
fn folder_of(output: &Path) -> PathBuf {
    let mut name = output.as_os_str().to_owned();
    name.push(".parts");
    name.into()
}

fn name_of(part: Part) -> String {
    format!("part-{}-of-{}.fits", part.number(), part.of())
}

/// Files of parts in `folder`.
fn parts_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_part = |path: &PathBuf| {
        let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        name.starts_with("part-") && name.ends_with(".fits")
    };
    entries.filter(is_part).collect()
}

/// Removes the files of all ranks and their folder; other files in it stay, and with them the
/// folder.
fn remove(folder: &Path) {
    let is_own = |name: &str| {
        (name.starts_with("part-") && name.ends_with(".fits"))
            || (name.starts_with("rank-") && (name.ends_with(".alive") || name.ends_with(".tmp")))
            // Of a rank that was killed while it wrote.
            || (name.starts_with(".cophase-") && name.ends_with(".tmp"))
    };
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        if is_own(&entry.file_name().to_string_lossy()) {
            let _ = std::fs::remove_file(entry.path());
        }
    }
    let _ = std::fs::remove_dir(folder);
}

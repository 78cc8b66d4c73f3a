//! `cophase estimate --part rank`: each process that mpirun or srun starts fits its part, and the first makes the estimate of all.
//!
//! The parts are files in the folder `OUTPUT.parts`, which all processes see. Where a job was stopped the folder stays, and the same
//! command, with any number of processes, takes the fits that are there.

use super::arguments::Arguments;
use super::part;
use super::whole::whole;
use crate::interrupt::Interrupt;
use crate::outputs;
use crate::ranks::{Heart, LOOK, Pulse, Rank};
use crate::terminal::Terminal;
use cophase::pipeline::{FittedPart, Part};
use cophase::{Error, Result};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// The share of this process.
pub(super) fn run(arguments: Arguments, terminal: &Terminal, interrupt: &Interrupt) -> Result<ExitCode> {
    let rank = Rank::of_this_process()?;
    if rank.of == 1 {
        return whole(arguments, Vec::new(), terminal, interrupt);
    }
    share(arguments, rank, terminal, interrupt).map_err(|error| rank.name(error))
}

fn share(arguments: Arguments, rank: Rank, terminal: &Terminal, interrupt: &Interrupt) -> Result<ExitCode> {
    outputs::check(&[("-o", &arguments.output)], &arguments.read_files())?;
    let folder = folder_of(&arguments.output);
    std::fs::create_dir_all(&folder).map_err(|error| Error::file(&folder, format!("cannot be made: {error}")))?;
    // Only the first rank waits, and for the others.
    let heart = (rank.number > 0).then(|| Heart::start(&folder, rank));
    match fit_and_gather(&arguments, rank, &folder, terminal, interrupt) {
        Ok(None) => Ok(ExitCode::SUCCESS),
        Ok(Some(parts)) => {
            let status = whole(arguments, parts, terminal, interrupt)?;
            remove(&folder);
            Ok(status)
        }
        Err(error) => {
            if let Some(heart) = heart {
                heart.fail(&error);
            }
            Err(error)
        }
    }
}

/// Fits and writes the part of this rank; of the first rank, the parts of all.
fn fit_and_gather(
    arguments: &Arguments,
    rank: Rank,
    folder: &Path,
    terminal: &Terminal,
    interrupt: &Interrupt,
) -> Result<Option<Vec<FittedPart>>> {
    let part = rank.part()?;
    let mut pulses = Pulse::of_others(folder, rank);
    // One bar is enough.
    let quiet = Terminal::new(true);
    let terminal = if rank.number == 0 { terminal } else { &quiet };
    // A file of another version, or one that is damaged, is no loss.
    let earlier: Vec<FittedPart> = parts_in(folder).iter().filter_map(|path| FittedPart::read(path).ok()).collect();
    let own = part::fit(arguments, part, &earlier, terminal, interrupt)?;
    drop(earlier);
    own.write(folder.join(name_of(part)))?;
    if rank.number > 0 {
        return Ok(None);
    }
    let _wait = terminal.wait("Waiting for the other ranks", 1);
    let mut parts = vec![own];
    loop {
        let mut missing = Vec::new();
        for mut pulse in pulses {
            match part_of(folder, pulse.rank().part()?, &parts[0]) {
                Some(found) => parts.push(found),
                None => {
                    pulse.check()?;
                    missing.push(pulse);
                }
            }
        }
        if missing.is_empty() {
            return Ok(Some(parts));
        }
        pulses = missing;
        interrupt.check("the other ranks were not done")?;
        std::thread::sleep(LOOK);
    }
}

/// The part in `folder`, where it is there and of the same estimate as `own`: another one is left from an earlier job, and replaced.
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

/// Removes the files of all ranks and their folder; other files in it stay, and with them the folder.
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

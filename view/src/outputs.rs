//! Files that a command writes, checked before its work; images from standard input.

use crate::interrupt::Interrupt;
use cophase::io::{FitsWriter, file_of};
use cophase::{Error, Result};
use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;
use tempfile::TempDir;

/// A file as the command line names it: its flag or argument, and its path.
pub type Flagged<'a> = (&'a str, &'a Path);

/// Most bytes of standard input: an image of as many pixels as one may have, in double precision.
const MOST_INPUT: u64 = 16 << 30;

/// Extensions of a picture.
const PICTURES: [&str; 2] = ["png", "svg"];

/// Says now, before the work, what would stop the outputs from being written after it: two outputs
/// with one path, an output that is an input, a read-only file, a missing directory.
///
/// # Errors
/// [`Error::File`] with the path and the flags.
pub fn check(outputs: &[Flagged], inputs: &[Flagged]) -> Result<()> {
    for (i, &(flag, output)) in outputs.iter().enumerate() {
        refuse_dash((flag, output))?;
        if let Some((other, _)) = outputs[..i].iter().find(|(_, other)| same_file(other, output)) {
            let reason = format!("is named by {other} and by {flag}: each needs a file of its own");
            return Err(Error::file(output, reason));
        }
        spare((flag, output), inputs)?;
        // Any kind of file appears as a FITS file does: by a rename within its directory.
        FitsWriter::create(output)?;
    }
    Ok(())
}

/// [`check`] for the picture among the outputs.
///
/// # Errors
/// [`Error::File`] for another extension than those of pictures.
pub fn check_picture((_, picture): Flagged) -> Result<()> {
    let extension = picture.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    if !PICTURES.contains(&extension.to_ascii_lowercase().as_str()) {
        return Err(Error::file(picture, "a picture is named .png or .svg"));
    }
    Ok(())
}

/// [`check`] for a report among the outputs.
///
/// # Errors
/// [`Error::File`] for another extension than that of HTML.
pub fn check_report((_, report): Flagged) -> Result<()> {
    let extension = report.extension().and_then(|extension| extension.to_str()).unwrap_or_default();
    if extension.eq_ignore_ascii_case("html") { Ok(()) } else { Err(Error::file(report, "a report is named .html")) }
}

/// Refuses an output that is one of `inputs`.
///
/// # Errors
/// [`Error::File`] with both names.
pub fn spare((flag, output): Flagged, inputs: &[Flagged]) -> Result<()> {
    // An input may have an HDU in brackets behind its name.
    let is_output = |input: &Path| same_file(&file_of(input), output);
    let Some((input, _)) = inputs.iter().find(|(_, input)| is_output(input)) else { return Ok(()) };
    let reason = format!("is read by this command ({input}) and cannot be its output ({flag}): give another name");
    Err(Error::file(output, reason))
}

/// Refuses `-` as an output: standard output has the results for people and scripts.
///
/// # Errors
/// [`Error::File`].
pub fn refuse_dash((flag, output): Flagged) -> Result<()> {
    if output != Path::new("-") {
        return Ok(());
    }
    let reason = format!("{flag} does not write to standard output: give a file name (./- for a file named '-')");
    Err(Error::file(output, reason))
}

/// Whether two paths are one file, or would be: a file that is not there yet is compared by its
/// directory and its name.
fn same_file(a: &Path, b: &Path) -> bool {
    let identity = |path: &Path| -> Option<(PathBuf, Option<OsString>)> {
        if let Ok(there) = path.canonicalize() {
            return Some((there.parent()?.to_path_buf(), there.file_name().map(OsString::from)));
        }
        let directory = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
        Some((directory.canonicalize().ok()?, path.file_name().map(OsString::from)))
    };
    match (identity(a), identity(b)) {
        (Some(a), Some(b)) => a == b,
        _ => a == b,
    }
}

/// Copies standard input to a temporary file where `path` is `-`, and puts the name of that file
/// into `path`. The file is removed with the value that is returned.
///
/// # Errors
/// [`Error::File`] where standard input cannot be copied; [`Error::Interrupted`] while it is read.
pub fn copy_standard_input(path: &mut PathBuf, interrupt: &Interrupt) -> Result<Option<TempDir>> {
    if *path != Path::new("-") {
        return Ok(None);
    }
    let failed = |error: std::io::Error| Error::file("-", format_args!("standard input cannot be copied: {error}"));
    let folder = tempfile::Builder::new().prefix("cophase-").tempdir().map_err(failed)?;
    cophase::io::abandon_with(folder.path());
    // The name appears in messages and in the title of a picture.
    let copy = folder.path().join("standard-input");
    let mut file = std::fs::File::create_new(&copy).map_err(failed)?;
    // A thread of its own: a read that waits for input does not see Ctrl-C.
    let (done, copied) = channel();
    std::thread::spawn(move || done.send(std::io::copy(&mut std::io::stdin().lock().take(MOST_INPUT + 1), &mut file)));
    let bytes = loop {
        match copied.recv_timeout(Duration::from_millis(50)) {
            Ok(outcome) => break outcome.map_err(failed)?,
            Err(RecvTimeoutError::Timeout) => interrupt.check("standard input was not read to its end")?,
            Err(RecvTimeoutError::Disconnected) => {
                return Err(Error::Internal("the thread that reads standard input ended".into()));
            }
        }
    };
    if bytes > MOST_INPUT {
        return Err(Error::file(
            "-",
            format_args!("has more than {MOST_INPUT} bytes: at most that many are accepted of standard input"),
        ));
    }
    if bytes == 0 {
        return Err(Error::file("-", "standard input is empty: a FITS file is needed"));
    }
    *path = copy;
    Ok(Some(folder))
}

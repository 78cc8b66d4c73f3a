//! Parts of an estimate: `cophase estimate --part I/N`, and the estimate of all parts.

use super::arguments::Arguments;
use super::whole::{Work, estimate_whole};
use clap::Parser;
use cophase::pipeline::{FittedPart, Part};
use cophase::{Error, Result};
use cophase_view::files;
use cophase_view::interrupt::Interrupt;
use cophase_view::outputs;
use cophase_view::terminal::{Terminal, Wait, counted};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Fits the images of `part`, and writes the part to the output.
pub(super) fn write(arguments: &Arguments, part: Part, terminal: &Terminal, interrupt: &Interrupt) -> Result<ExitCode> {
    outputs::check(&[("-o", &arguments.output)], &arguments.read_files())?;
    let fitted = {
        let bar = terminal.follow();
        fit(arguments, &work(arguments, &bar, interrupt)?, part, Vec::new())?
    };
    fitted.write(&arguments.output)?;
    let (output, fits, images) = (arguments.output.display(), counted(fitted.fits(), "fit"), fitted.images);
    terminal.show(&format!("{output}: part {part} of an estimate from {}: {fits}\n", counted(images, "image")))?;
    Ok(ExitCode::SUCCESS)
}

/// What the parts of an estimate work on.
pub(super) fn work(arguments: &Arguments, bar: &Wait, interrupt: &Interrupt) -> Result<Work> {
    if arguments.images.as_deref() == Some(Path::new("-")) {
        return Err(Error::Value(
            "images from standard input have no parts: a file is needed, which is read again".into(),
        ));
    }
    Work::new(arguments, bar, interrupt)
}

/// The fits of `part`, some of which may be those of `earlier` parts.
pub(super) fn fit(arguments: &Arguments, work: &Work, part: Part, earlier: Vec<FittedPart>) -> Result<FittedPart> {
    let fitted = work.estimator.fit_part(&work.images, part, earlier);
    let mut fitted = fitted.map_err(files::about(arguments.first()))?;
    fitted.command = command()?;
    Ok(fitted)
}

/// The estimate of all `parts`, by the command that made them; `flags` are further --json, --strict
/// and --verbose.
pub fn merge(parts: &[PathBuf], output: PathBuf, flags: [bool; 3], terminal: &Terminal) -> Result<ExitCode> {
    let interrupt = Interrupt::catch()?;
    let inputs: Vec<_> = parts.iter().map(|part| ("a part", part.as_path())).collect();
    outputs::check(&[("-o", &output)], &inputs)?;
    let parts = parts.iter().map(FittedPart::read).collect::<Result<Vec<_>>>()?;
    let output = std::path::absolute(&output).map_err(|error| Error::file(&output, error))?;
    let Some(first) = parts.first() else { return Err(Error::Internal("there is no part".into())) };
    let mut arguments = stored(&first.command)?;
    let [json, strict, verbose] = flags;
    arguments.output = output;
    arguments.json |= json;
    arguments.strict |= strict;
    arguments.verbose |= verbose;
    estimate_whole(arguments, parts, terminal, &interrupt)
}

/// The folder and the words of this command, as a part keeps them.
fn command() -> Result<Vec<String>> {
    let folder = std::env::current_dir().map_err(|error| Error::file(".", error))?;
    let words = std::env::args_os().skip_while(|word| word != "estimate").skip(1);
    Ok(std::iter::once(folder.into_os_string()).chain(words).map(|word| encoded(&word.to_string_lossy())).collect())
}

/// The options of the command of a part; enters its folder, in which its file names hold.
fn stored(command: &[String]) -> Result<Arguments> {
    /// The words after `cophase estimate`.
    #[derive(Parser)]
    #[command(no_binary_name = true)]
    struct Stored {
        #[command(flatten)]
        arguments: Arguments,
        /// Of the program, not of the verb.
        #[arg(short, long)]
        quiet: bool,
    }
    let mut words = command.iter().map(|word| decoded(word));
    let folder = words.next().unwrap_or_default();
    std::env::set_current_dir(&folder).map_err(|error| {
        Error::file(&folder, format!("the folder where the parts were made cannot be entered: {error}"))
    })?;
    let stored = Stored::try_parse_from(words);
    let stored = stored.map_err(|_| Error::Value("the command of these parts is not one of this version".into()))?;
    let _ = stored.quiet;
    Ok(stored.arguments)
}

/// `word` in printable ASCII, which FITS accepts: other bytes, blanks and % as %XX.
fn encoded(word: &str) -> String {
    let code = |byte: u8| match byte {
        b'!'..=b'~' if byte != b'%' => char::from(byte).to_string(),
        _ => format!("%{byte:02X}"),
    };
    word.bytes().map(code).collect()
}

fn decoded(word: &str) -> String {
    let mut parts = word.split('%');
    let mut bytes: Vec<u8> = parts.next().unwrap_or_default().into();
    for part in parts {
        let (code, rest) = part.split_at(part.len().min(2));
        bytes.extend(u8::from_str_radix(code, 16).ok());
        bytes.extend(rest.bytes());
    }
    String::from_utf8_lossy(&bytes).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_a_command_survive_a_table_of_ascii() {
        for word in ["", "plain.fits", "a b", "50%", "Nächte/é.fits", "image.peak_snr=50", "%41 "] {
            assert!(encoded(word).is_ascii() && !encoded(word).contains(' '), "{word}");
            assert_eq!(decoded(&encoded(word)), word);
        }
    }
}

//! Files that a command line names: files, folders and patterns with `*` and `?`.

use crate::{Error, Result};
use std::path::{Path, PathBuf};

/// Ends of the names of FITS files.
const EXTENSIONS: [&str; 6] = [".fits", ".fit", ".fts", ".fits.gz", ".fit.gz", ".fits.fz"];

/// Pattern of a text: `*` for any characters, `?` for one; compared without case.
#[derive(Debug, Clone, PartialEq)]
pub struct Pattern(Vec<char>);

impl Pattern {
    /// Pattern `text`.
    pub fn new(text: &str) -> Self {
        Self(text.trim().to_lowercase().chars().collect())
    }

    /// The number that the pattern is, if it is one.
    pub(super) fn number(&self) -> Option<f64> {
        self.0.iter().collect::<String>().parse().ok().filter(|number: &f64| number.is_finite())
    }

    /// Whether all of `text` fits the pattern.
    pub fn matches(&self, text: &str) -> bool {
        let text: Vec<char> = text.trim().to_lowercase().chars().collect();
        // Place behind the last `*`, and the place in the text from which it is tried; one step
        // back at most for each character.
        let (mut at, mut place, mut retry) = (0, 0, None);
        while place < text.len() {
            match self.0.get(at) {
                Some('*') => {
                    at += 1;
                    retry = Some((at, place));
                }
                Some(c) if *c == '?' || *c == text[place] => (at, place) = (at + 1, place + 1),
                _ => {
                    let Some((star, from)) = retry else { return false };
                    (at, place) = (star, from + 1);
                    retry = Some((star, from + 1));
                }
            }
        }
        self.0[at..].iter().all(|c| *c == '*')
    }
}

/// The FITS files that `paths` name, each once, in the order of their names: a file itself, the
/// FITS files of a folder, or those files of a folder whose names fit a pattern.
///
/// # Errors
/// [`Error::File`] for a path that names no file.
pub fn list_files(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for path in paths {
        let found = if path.is_dir() {
            folder(path, is_fits)?
        } else if path.exists() {
            vec![path.clone()]
        } else {
            let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            if !name.contains(['*', '?']) {
                return Err(Error::file(path, "there is no such file or folder"));
            }
            let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty()).unwrap_or(Path::new("."));
            let pattern = Pattern::new(&name);
            folder(parent, |name| pattern.matches(name))?
        };
        if found.is_empty() {
            return Err(Error::file(path, "names no FITS file (.fits, .fit or .fts, packed or not)"));
        }
        files.extend(found);
    }
    files.sort();
    files.dedup();
    Ok(files)
}

fn is_fits(name: &str) -> bool {
    let name = name.to_lowercase();
    !name.starts_with('.') && EXTENSIONS.iter().any(|end| name.ends_with(end))
}

/// Files of a folder whose names are accepted.
fn folder(path: &Path, is_accepted: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>> {
    let entries =
        std::fs::read_dir(path).map_err(|error| Error::file(path, format_args!("cannot be listed: {error}")))?;
    let files = entries.filter_map(|entry| entry.ok().map(|entry| entry.path()));
    let accepted = |path: &PathBuf| path.file_name().is_some_and(|name| is_accepted(&name.to_string_lossy()));
    Ok(files.filter(|path| path.is_file()).filter(accepted).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_fit_whole_names() {
        for (pattern, name, fits) in [
            ("n*.fits", "N0004.fits", true),
            ("n*.fits", "n0004.fits.gz", false),
            ("n000?.fits", "n0004.fits", true),
            ("n000?.fits", "n00040.fits", false),
            ("*a*b", "xaxbab", true),
            ("*a*b", "xaxbac", false),
            ("*", "", true),
            ("", "a", false),
        ] {
            assert_eq!(Pattern::new(pattern).matches(name), fits, "{pattern} {name}");
        }
    }
}

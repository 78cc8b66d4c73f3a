//! Table of a filter's transmission.

use crate::{Error, Result};
use std::path::Path;

/// Bytes of the largest table that is read: some 50,000 rows, where the tables of instruments have up to some thousand.
const LARGEST: u64 = 1 << 20;

/// Reads a text table of two columns, separated by white space or a comma: wavelength, nm, ascending, and relative transmission. Comments
/// begin with `#`.
///
/// # Errors
/// [`Error::File`] with the line, for a file that cannot be read or is not such a table.
pub(super) fn read(path: &Path) -> Result<Vec<(f64, f64)>> {
    let size = std::fs::metadata(path)
        .map_err(|error| Error::file(path, format_args!("{error}; image.filter_file of the scene names it")))?
        .len();
    if size > LARGEST {
        let reason = format!("{size} bytes are too many for the table of a filter; at most {LARGEST} are accepted");
        return Err(Error::file(path, reason));
    }
    let text = std::fs::read_to_string(path).map_err(|error| Error::file(path, error))?;
    parse(&text).map_err(|reason| Error::file(path, reason))
}

/// The rows of a table, or why it is not accepted.
fn parse(text: &str) -> std::result::Result<Vec<(f64, f64)>, String> {
    let mut rows: Vec<(f64, f64)> = Vec::new();
    for (number, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default();
        let words: Vec<&str> =
            line.split(|c: char| c == ',' || c.is_whitespace()).filter(|word| !word.is_empty()).collect();
        if words.is_empty() {
            continue;
        }
        let at = |reason: String| format!("line {}: {reason}", number + 1);
        let [nm, transmission] = words[..] else {
            let count = words.len();
            return Err(at(format!(
                "{count} columns; wavelength (nm) and transmission are needed, comments begin with '#'"
            )));
        };
        let number_of = |word: &str| {
            word.parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(|| {
                let word: String = word.chars().take(30).collect();
                at(format!("'{word}' is not a finite number; wavelength (nm) and transmission are needed"))
            })
        };
        let (nm, transmission) = (number_of(nm)?, number_of(transmission)?);
        if nm <= 0.0 {
            return Err(at(format!("a wavelength of {nm} nm; a positive one is needed")));
        }
        if transmission < 0.0 {
            return Err(at(format!("a transmission of {transmission}; 0 or more is needed")));
        }
        if let Some((before_nm, _)) = rows.last().filter(|(before_nm, _)| *before_nm >= nm) {
            return Err(at(format!("{nm} nm follows {before_nm} nm; ascending wavelengths are needed")));
        }
        rows.push((nm, transmission));
    }
    if rows.len() < 2 {
        let count = rows.len();
        return Err(format!("rows of wavelength (nm) and transmission: {count}; 2 or more are needed"));
    }
    if rows.iter().all(|(_, transmission)| *transmission == 0.0) {
        return Err("the transmission is 0 everywhere; a filter that passes light is needed".into());
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_may_have_commas_comments_and_empty_lines() {
        let text = "\u{feff}# nm, transmission\r\n2000, 0.5\r\n\r\n 2010\t5e-1 # middle\n2020.5 ,0\n";
        assert_eq!(parse(text).unwrap(), [(2000.0, 0.5), (2010.0, 0.5), (2020.5, 0.0)]);
    }

    #[test]
    fn mistakes_are_named_with_their_line() {
        for (text, expected) in [
            ("2000\n2010\n", "line 1: 1 columns"),
            ("2000 1 1\n", "line 1: 3 columns"),
            ("# c\n2000 1\n1990 1\n", "line 3: 1990 nm follows 2000 nm"),
            ("2000 1\n2000 0\n", "2000 nm follows 2000 nm"),
            ("2000 1\n2010 -0.1\n", "line 2: a transmission of -0.1"),
            ("2000 NaN\n2010 1\n", "line 1: 'NaN' is not a finite number"),
            ("wavelength transmission\n", "'wavelength' is not a finite number"),
            ("-1 0\n1 0\n", "a wavelength of -1 nm"),
            ("2000 1\n", "2 or more are needed"),
            ("", "2 or more are needed"),
            ("2000 0\n2010 0\n", "0 everywhere"),
        ] {
            let reason = parse(text).unwrap_err();
            assert!(reason.contains(expected), "{text:?}: {reason}");
        }
    }
}

//! Table of a filter's transmission.

use crate::io::{TextTable, read_text};
use crate::{Error, Result};
use std::path::Path;

/// Reads a text table ([`TextTable`]) of two columns: wavelength, ascending, in nm or the unit that
/// the name of its column ends with, and relative transmission.
///
/// # Errors
/// [`Error::File`] with the line, for a file that cannot be read or is not such a table.
pub(super) fn read(path: &Path) -> Result<Vec<(f64, f64)>> {
    parse(&read_text(path, "image.filter_file of the scene names it")?).map_err(|reason| Error::file(path, reason))
}

/// The rows of a table, or why it is not accepted.
fn parse(text: &str) -> std::result::Result<Vec<(f64, f64)>, String> {
    const COLUMNS: &str = "wavelength (nm) and transmission";
    let mut rows: Vec<(f64, f64)> = Vec::new();
    let table = TextTable::new(text);
    let unit_nm = table.unit_nm(0).unwrap_or(1.0);
    for row in &table.rows {
        if row.words.len() != 2 {
            let count = row.words.len();
            return Err(row.at(format_args!("{count} columns; {COLUMNS} are needed, comments begin with '#'")));
        }
        let (nm, transmission) = (unit_nm * row.number(0, "a wavelength in nm")?, row.number(1, "a transmission")?);
        if nm <= 0.0 {
            return Err(row.at(format_args!("a wavelength of {nm} nm; a positive one is needed")));
        }
        if transmission < 0.0 {
            return Err(row.at(format_args!("a transmission of {transmission}; 0 or more is needed")));
        }
        if let Some((before_nm, _)) = rows.last().filter(|(before_nm, _)| *before_nm >= nm) {
            return Err(row.at(format_args!("{nm} nm follows {before_nm} nm; ascending wavelengths are needed")));
        }
        rows.push((nm, transmission));
    }
    if rows.len() < 2 {
        let count = rows.len();
        return Err(format!("rows of {COLUMNS}: {count}; 2 or more are needed"));
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
        assert_eq!(parse("Wavelength(um);T\n2;0,5\n2,5;1\n").unwrap(), [(2000.0, 0.5), (2500.0, 1.0)]);
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
            ("wavelength transmission\nx y\n", "'wavelength' is not a finite number"),
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

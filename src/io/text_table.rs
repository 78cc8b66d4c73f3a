//! Text tables of a user's, as people, NumPy, pandas, Fortran and spreadsheets write them.
//!
//! Columns are separated by white space, commas, semicolons or tabs. Comments begin with `#`, or
//! fill a line that begins with `%` or `!`. A first row without a number, or a last comment of as
//! many words before the first row, has the names of the columns. Numbers may have a Fortran
//! exponent (`1.5D-3`), and a decimal comma where commas separate no columns.

use super::{characters, regular};
use crate::{Error, Result};
use std::path::Path;

/// Bytes of the largest table that is read: some 50,000 rows; 256 × 256 entries of a map of cells
/// take at most half of it.
const LARGEST: u64 = 1 << 20;

/// Units of lengths by their names in the head of a column, nm.
const LENGTHS: [(&[&str], f64); 5] = [
    (&["nm", "nanometer", "nanometers"], 1.0),
    (&["um", "µm", "μm", "micron", "microns", "micrometer", "micrometers"], 1e3),
    (&["a", "aa", "å", "angstrom", "angstroms"], 0.1),
    (&["mm"], 1e6),
    (&["m", "meter", "meters"], 1e9),
];

/// Text table.
pub struct TextTable {
    /// Names of the columns, in lower case; empty without.
    pub names: Vec<String>,
    /// Rows that have words.
    pub rows: Vec<TextRow>,
}

/// Row of a text table: its line in the file, from 1, and its words.
pub struct TextRow {
    /// Line, from 1.
    pub line: usize,
    /// Words; at least one.
    pub words: Vec<String>,
}

impl TextRow {
    /// The number in column `column`, from 0, which is `what`.
    ///
    /// # Errors
    /// The sentence for a word that is not a finite number, with the line.
    pub fn number(&self, column: usize, what: &str) -> std::result::Result<f64, String> {
        let word = self.words.get(column).map_or("", String::as_str);
        number(word)
            .ok_or_else(|| self.at(format_args!("'{}' is not a finite number; {what} is needed", excerpt(word))))
    }

    /// The whole number in column `column`, also as programs write it that know real numbers only;
    /// `None` for another word.
    pub fn integer(&self, column: usize) -> Option<i64> {
        let number = number(self.words.get(column)?)?;
        // 2^53: beyond, an f64 does not represent every integer.
        (number.fract() == 0.0 && number.abs() <= 9_007_199_254_740_992.0).then_some(number as i64)
    }

    /// `sentence` with the line before it.
    pub fn at(&self, sentence: impl std::fmt::Display) -> String {
        format!("line {}: {sentence}", self.line)
    }
}

impl TextTable {
    /// The table in `text`.
    pub fn new(text: &str) -> Self {
        let text = text.trim_start_matches('\u{feff}');
        let lines: Vec<(usize, &str)> = text.lines().enumerate().filter(|(_, line)| !is_dialect(line)).collect();
        let data: Vec<(usize, &str)> = lines.iter().map(|&(at, line)| (at, data_of(line))).collect();
        let filled: Vec<(usize, &str)> = data.into_iter().filter(|(_, line)| !line.trim().is_empty()).collect();
        let style = Style::of(filled.iter().map(|(_, line)| *line));
        let row = |&(before, line): &(usize, &str)| TextRow { line: before + 1, words: style.words(line) };
        let mut rows: Vec<TextRow> = filled.iter().map(row).filter(|row| !row.words.is_empty()).collect();
        let has_number = |row: &TextRow| row.words.iter().any(|word| number(word).is_some());
        let is_head = rows.first().is_some_and(|row| !has_number(row)) && rows.get(1).is_some_and(has_number);
        let names = if is_head { rows.remove(0).words } else { named_in_comment(&lines, rows.first(), &style) };
        Self { names: names.iter().map(|name| name.trim().to_lowercase()).collect(), rows }
    }

    /// The column whose name has one of `words` in it, those that are preferred first.
    pub fn column(&self, words: &[&str]) -> Option<usize> {
        words.iter().find_map(|word| self.names.iter().position(|name| name.contains(word)))
    }

    /// The unit of lengths that ends the name of a column, nm; `None` where it names none.
    pub fn unit_nm(&self, column: usize) -> Option<f64> {
        let last = self.unit(column)?;
        LENGTHS.iter().find(|(names, _)| names.contains(&last)).map(|(_, nm)| *nm)
    }

    /// As [`TextTable::unit_nm`], also where the name ends with the unit of a phase of light of
    /// `wavelength_nm`.
    pub fn wavefront_unit_nm(&self, column: usize, wavelength_nm: f64) -> Option<f64> {
        let of_phase = || match self.unit(column)? {
            "rad" | "radian" | "radians" => Some(wavelength_nm / std::f64::consts::TAU),
            "wave" | "waves" => Some(wavelength_nm),
            _ => None,
        };
        self.unit_nm(column).or_else(of_phase)
    }

    /// The last word of the name of a column.
    fn unit(&self, column: usize) -> Option<&str> {
        self.names.get(column)?.split(|c: char| !c.is_alphanumeric()).rfind(|word| !word.is_empty())
    }
}

/// How the columns of a table are separated.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Style {
    White {
        has_decimal_comma: bool,
    },
    Comma,
    /// Semicolon or tab.
    Cells {
        separator: char,
        has_decimal_comma: bool,
    },
}

impl Style {
    fn of<'a>(lines: impl Iterator<Item = &'a str> + Clone) -> Self {
        let mut all = lines.clone();
        let has = |c: char| lines.clone().any(|line| line.contains(c));
        let is_decimal = |line: &str| {
            let bytes = line.as_bytes();
            let is_digit = |at: Option<usize>| at.and_then(|at| bytes.get(at)).is_some_and(u8::is_ascii_digit);
            let mut commas = line.match_indices(',').map(|(at, _)| at);
            commas.all(|at| is_digit(at.checked_sub(1)) && is_digit(Some(at + 1)))
        };
        let has_decimal_comma = has(',') && lines.clone().skip(1).all(is_decimal) && {
            let is_pointed = |word: &str| number(word).is_some() && word.contains('.');
            !lines.clone().any(|line| line.split([';', '\t', ' ']).any(is_pointed))
        };
        if has(';') {
            return Self::Cells { separator: ';', has_decimal_comma };
        }
        if lines.clone().count() > 0 && all.all(|line| line.trim().contains('\t')) {
            return Self::Cells { separator: '\t', has_decimal_comma };
        }
        // Where white space separates columns, too, commas between digits are decimal.
        let is_spaced = |line: &str| line.split_whitespace().count() > 1 && is_decimal(line);
        if !has(',') || (has_decimal_comma && lines.clone().all(is_spaced)) {
            return Self::White { has_decimal_comma };
        }
        Self::Comma
    }

    /// The words of a line.
    fn words(self, line: &str) -> Vec<String> {
        let unquoted = |word: &str| word.trim().trim_matches('"').trim().to_owned();
        let mut words: Vec<String> = match self {
            Self::White { .. } => line.split_whitespace().map(unquoted).collect(),
            Self::Cells { separator, .. } => line.split(separator).map(unquoted).collect(),
            Self::Comma => line.split(',').flat_map(|cell| spaced(cell).into_iter().map(unquoted)).collect(),
        };
        while words.last().is_some_and(String::is_empty) {
            words.pop();
        }
        if let Self::White { has_decimal_comma: true } | Self::Cells { has_decimal_comma: true, .. } = self {
            for word in &mut words {
                let pointed = word.replacen(',', ".", 1);
                if number(&pointed).is_some() {
                    *word = pointed;
                }
            }
        }
        words
    }
}

/// The words of a cell that white space separates further, unless it is quoted; an empty cell is an
/// empty word.
fn spaced(cell: &str) -> Vec<&str> {
    let trimmed = cell.trim();
    if trimmed.is_empty() || trimmed.starts_with('"') { vec![trimmed] } else { trimmed.split_whitespace().collect() }
}

/// The part of a line before its comment.
fn data_of(line: &str) -> &str {
    let is_comment = line.trim_start().starts_with(['%', '!']);
    if is_comment { "" } else { line.split('#').next().unwrap_or_default() }
}

/// Whether a line is the one by which Excel learns the separator.
fn is_dialect(line: &str) -> bool {
    line.trim().trim_matches('"').to_lowercase().strip_prefix("sep=").is_some_and(|rest| rest.len() <= 1)
}

/// Names of columns in the last comment before the first row, where it has as many words as the
/// row.
fn named_in_comment(lines: &[(usize, &str)], first: Option<&TextRow>, style: &Style) -> Vec<String> {
    let Some(first) = first else { return Vec::new() };
    let before = lines.iter().rev().find(|(at, line)| at + 1 < first.line && !line.trim().is_empty());
    let Some(comment) = before.and_then(|(_, line)| line.trim_start().strip_prefix(['#', '%', '!'])) else {
        return Vec::new();
    };
    let is_as_long = |words: &Vec<String>| words.len() == first.words.len();
    let comma: Vec<String> = comment.split(',').map(|word| word.trim().to_owned()).collect();
    [style.words(comment), comma].into_iter().find(is_as_long).unwrap_or_default()
}

/// A finite number, also with a Fortran exponent.
fn number(word: &str) -> Option<f64> {
    word.replace(['D', 'd'], "e").parse::<f64>().ok().filter(|value| value.is_finite())
}

/// The beginning of a word, for a message.
fn excerpt(word: &str) -> String {
    word.chars().take(30).collect()
}

/// Reads the text of a table, in UTF-8, UTF-16 or Latin-1; `origin` says where its name is from,
/// for messages.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read, is no regular file, or is larger than 1 MiB.
pub fn read_text(path: &Path, origin: &str) -> Result<String> {
    let bytes = regular::read_bytes(path, "a text table", LARGEST).map_err(|error| match error {
        Error::File { path, reason } => Error::File { path, reason: format!("{reason}; {origin}") },
        other => other,
    })?;
    Ok(characters::decoded(&bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_of_other_programs_have_the_same_rows() {
        for (program, text) in [
            ("by hand", "# nm\n0 -3.5\n1, 12.25\n"),
            (
                "NumPy",
                "0.000000000000000000e+00 -3.500000000000000000e+00\n1.000000000000000000e+00 1.225000000000000000e+01\n",
            ),
            ("NumPy with a header", "# segment piston_nm\n0 -3.5\n1 12.25\n"),
            ("pandas", "segment,piston_nm\n0,-3.5\n1,12.25\n"),
            ("Excel, German", "\u{feff}sep=;\r\nsegment;piston\r\n0;-3,5\r\n1;12,25\r\n"),
            ("tabs", "\"segment\"\t\"piston [nm]\"\n0\t-3,5\n1\t12,25\n"),
            ("decimal commas", "0 -3,5\n1 12,25\n"),
            ("semicolons", "0;-3.5\n1;12.25\n"),
            ("Fortran", "  0  -3.5D0\n  1  1.225D+01\n"),
            ("MATLAB", "% segment piston\n0, -3.5\n1, 12.25\n"),
            ("trailing separators", "0,-3.5,\n1,12.25,\n"),
        ] {
            let table = TextTable::new(text);
            let rows: Vec<_> =
                table.rows.iter().map(|row| (row.integer(0), row.number(1, "x"), row.words.len())).collect();
            assert_eq!(rows, [(Some(0), Ok(-3.5), 2), (Some(1), Ok(12.25), 2)], "{program}");
        }
    }

    #[test]
    fn names_of_columns_give_place_and_unit() {
        let table = TextTable::new(",segment,piston_um\n0,4,-3.5\n1,5,12.25\n");
        assert_eq!((table.column(&["label", "segment"]), table.column(&["piston"])), (Some(1), Some(2)));
        assert_eq!((table.unit_nm(2), table.unit_nm(1)), (Some(1e3), None));
        for (head, nm) in [("Wavelength(A)", 0.1), ("lambda [µm]", 1e3), ("wavelength_nm", 1.0), ("piston [m]", 1e9)] {
            assert_eq!(TextTable::new(&format!("{head};t\n1;2\n")).unit_nm(0), Some(nm), "{head}");
        }
        assert!(TextTable::new("1 2\n").names.is_empty());
    }
}

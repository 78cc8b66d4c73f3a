//! Text tables of a user's: columns separated by white space or commas, comments that begin with `#`.

use super::regular;
use crate::{Error, Result};
use std::path::Path;

/// Bytes of the largest table that is read: some 50,000 rows; 256 × 256 entries of a map of cells take at most half of it.
const LARGEST: u64 = 1 << 20;

/// Row of a text table: its line in the file, from 1, and its words.
pub struct TextRow<'a> {
    /// Line, from 1.
    pub line: usize,
    /// Words; at least one.
    pub words: Vec<&'a str>,
}

impl TextRow<'_> {
    /// The number in column `column`, from 0, which is `what`.
    ///
    /// # Errors
    /// The sentence for a word that is not a finite number, with the line.
    pub fn number(&self, column: usize, what: &str) -> std::result::Result<f64, String> {
        let word = self.words.get(column).copied().unwrap_or_default();
        let number = word.parse::<f64>().ok().filter(|value| value.is_finite());
        number.ok_or_else(|| self.at(format_args!("'{}' is not a finite number; {what} is needed", excerpt(word))))
    }

    /// `sentence` with the line before it.
    pub fn at(&self, sentence: impl std::fmt::Display) -> String {
        format!("line {}: {sentence}", self.line)
    }
}

/// The beginning of a word, for a message.
fn excerpt(word: &str) -> String {
    word.chars().take(30).collect()
}

/// The rows of `text`.
pub fn text_rows(text: &str) -> Vec<TextRow<'_>> {
    let mut rows = Vec::new();
    for (before, line) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = line.split('#').next().unwrap_or_default();
        let words = line.split(|c: char| c == ',' || c.is_whitespace()).filter(|word| !word.is_empty());
        let row = TextRow { line: before + 1, words: words.collect() };
        rows.extend((!row.words.is_empty()).then_some(row));
    }
    rows
}

/// Reads the text of a table; `origin` says where its name is from, for messages.
///
/// # Errors
/// [`Error::File`] for a file that cannot be read, is no regular file, or is larger than 1 MiB.
pub fn read_text(path: &Path, origin: &str) -> Result<String> {
    regular::read_text(path, "a text table", LARGEST).map_err(|error| match error {
        Error::File { path, reason } => Error::File { path, reason: format!("{reason}; {origin}") },
        other => other,
    })
}

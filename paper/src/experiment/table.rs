//! Tables: the same columns and rows as aligned text and as CSV, and files that appear whole or not
//! at all.

use cophase::Result;
use std::path::Path;

/// One entry.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// A word.
    Text(String),
    /// A number of things.
    Count(usize),
    /// A number, and how many decimals a reader wants to see of it; the CSV keeps six significant
    /// digits.
    Number(f64, usize),
}

impl Cell {
    fn shown(&self) -> String {
        match self {
            Cell::Text(text) => text.clone(),
            Cell::Count(count) => count.to_string(),
            Cell::Number(value, _) if value.is_nan() => "-".into(),
            Cell::Number(value, decimals) => format!("{value:.decimals$}"),
        }
    }

    fn csv(&self) -> String {
        match self {
            // Quoted where it must be (RFC 4180).
            Cell::Text(text) if text.contains(['"', ',', '\n']) => format!("\"{}\"", text.replace('"', "\"\"")),
            Cell::Text(text) => text.clone(),
            Cell::Count(count) => count.to_string(),
            Cell::Number(value, _) if value.is_nan() => String::new(),
            Cell::Number(value, _) => {
                format!("{value:.5e}").parse::<f64>().map_or_else(|_| String::new(), |v| v.to_string())
            }
        }
    }
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Cell::Text(text.into())
    }
}

impl From<usize> for Cell {
    fn from(count: usize) -> Self {
        Cell::Count(count)
    }
}

/// Columns with names that a script can rely on, and rows.
#[derive(Debug, Clone)]
pub struct Table {
    columns: Vec<&'static str>,
    rows: Vec<Vec<Cell>>,
}

impl Table {
    /// No rows yet.
    pub fn new(columns: &[&'static str]) -> Self {
        Self { columns: columns.to_vec(), rows: Vec::new() }
    }

    /// One more row, with one cell a column.
    pub fn push(&mut self, row: Vec<Cell>) {
        debug_assert_eq!(row.len(), self.columns.len());
        self.rows.push(row);
    }

    /// As text: words to the left, numbers to the right, one line a row, a blank line after them.
    pub fn text(&self) -> String {
        let shown: Vec<Vec<String>> = self.rows.iter().map(|row| row.iter().map(Cell::shown).collect()).collect();
        let width = |column: usize| {
            let cells = shown.iter().map(|row| row[column].chars().count());
            cells.chain([self.columns[column].chars().count()]).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.columns.len()).map(width).collect();
        let words: Vec<bool> = (0..self.columns.len())
            .map(|column| self.rows.iter().any(|row| matches!(row[column], Cell::Text(_))))
            .collect();
        let line = |cells: &[String]| {
            let aligned = cells.iter().zip(&widths).zip(&words).map(|((cell, &width), &word)| {
                if word { format!("{cell:<width$}") } else { format!("{cell:>width$}") }
            });
            aligned.collect::<Vec<_>>().join("  ").trim_end().to_string() + "\n"
        };
        let head: Vec<String> = self.columns.iter().map(|name| name.to_string()).collect();
        line(&head) + &shown.iter().map(|row| line(row)).collect::<String>() + "\n"
    }

    /// As CSV with a header line; a number that is not there is an empty field.
    pub fn csv(&self) -> String {
        let row = |cells: &[Cell]| cells.iter().map(Cell::csv).collect::<Vec<_>>().join(",") + "\n";
        self.columns.join(",") + "\n" + &self.rows.iter().map(|cells| row(cells)).collect::<String>()
    }

    /// Writes the CSV to `path`, whole or not at all.
    ///
    /// # Errors
    /// [`cophase::Error::File`] where it cannot be written.
    pub fn write_csv(&self, path: &Path) -> Result<()> {
        cophase::io::write_atomically(path, self.csv().as_bytes())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut table = Table::new(&["way", "seeds", "phasing_nm"]);
        table.push(vec!["ours, today".into(), 24usize.into(), Cell::Number(0.081234567, 3)]);
        table.push(vec!["paper".into(), 1usize.into(), Cell::Number(f64::NAN, 3)]);
        table
    }

    #[test]
    fn text_is_aligned() {
        assert_eq!(
            table().text(),
            "way          seeds  phasing_nm\nours, today     24       0.081\npaper            1           -\n\n"
        );
    }

    #[test]
    fn csv_keeps_six_digits_and_quotes_commas() {
        assert_eq!(table().csv(), "way,seeds,phasing_nm\n\"ours, today\",24,0.0812346\npaper,1,\n");
    }

    #[test]
    fn a_file_replaces_another_and_a_missing_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        std::fs::write(&path, "old").unwrap();
        table().write_csv(&path).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), table().csv());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        let error = table().write_csv(&folder.path().join("no/t.csv")).unwrap_err();
        assert!(error.to_string().contains("no/t.csv"), "{error}");
    }
}

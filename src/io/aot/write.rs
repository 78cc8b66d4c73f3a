//! Tables of a file of AOT.

use super::configuration::{CONFIGURATION, configuration_card};
use super::layout::{AotTable, Kind, TABLES};
use super::version::{VERSION, WRITTEN_VERSION};
use crate::io::{Column, FitsWriter};
use crate::{Error, Result};

/// A cell of a table of AOT.
#[derive(Debug, Clone, PartialEq)]
pub enum Cell {
    /// Text, or a reference: [`image_reference`], [`row_reference`].
    Text(String),
    /// A real number, in the unit of the standard.
    Real(f64),
    /// An integer.
    Integer(i64),
    /// Any number of reals, in the unit of the standard.
    List(Vec<f64>),
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.into())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<f64> for Cell {
    fn from(number: f64) -> Self {
        Self::Real(number)
    }
}

impl From<Vec<f64>> for Cell {
    fn from(list: Vec<f64>) -> Self {
        Self::List(list)
    }
}

/// Cell that refers to the image extension `name` of the same file.
pub fn image_reference(name: &str) -> String {
    format!("INTREF<{}>", name.to_ascii_uppercase())
}

/// Cell that refers to the row `uid` of another table.
pub fn row_reference(uid: &str) -> String {
    format!("ROWREF<{uid}>")
}

/// A row: table, and the cells by their columns.
type Row = (&'static str, Vec<(&'static str, Cell)>);

/// The tables of a file of AOT: rows of components, whose other cells are empty.
#[derive(Debug, Default)]
pub struct AotTables {
    rows: Vec<Row>,
}

impl AotTables {
    /// No rows.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a row to `table`. Columns that `cells` does not name are empty.
    ///
    /// # Errors
    /// [`Error::Value`] for a table or a column that the standard does not have, or a cell of
    /// another kind.
    pub fn row(&mut self, table: &'static str, cells: Vec<(&'static str, Cell)>) -> Result<()> {
        let found = TABLES.iter().find(|known| known.name == table);
        let found = found.ok_or_else(|| Error::Value(format!("AOT has no table `{table}`")))?;
        for (name, cell) in &cells {
            let kind = match cell {
                Cell::Text(_) => Kind::Text,
                Cell::Real(_) => Kind::Real,
                Cell::Integer(_) => Kind::Integer,
                Cell::List(_) => Kind::List,
            };
            if !found.columns.iter().any(|(column, of_column, _)| column == name && *of_column == kind) {
                return Err(Error::Value(format!("the table `{table}` of AOT has no column `{name}` for {cell:?}")));
            }
        }
        self.rows.push((table, cells));
        Ok(())
    }

    /// Writes the version, the AO mode (`SCAO`, …) and the configuration to the primary HDU of
    /// `file`, and then all tables. The images to which they refer are added by the caller.
    ///
    /// # Errors
    /// Those of [`FitsWriter::card`] and [`FitsWriter::table`].
    pub fn write(&self, file: &mut FitsWriter, ao_mode: &str, system: &str, configuration: &str) -> Result<()> {
        for (key, value, comment) in [
            (VERSION, WRITTEN_VERSION, "version of AOT"),
            ("TIMESYS", "UTC", "time system"),
            ("AO-MODE", ao_mode, "configuration of the adaptive optics"),
            ("SYS-NAME", system, "system"),
        ] {
            file.card("PRIMARY", key, value, comment)?;
        }
        file.card("PRIMARY", CONFIGURATION, configuration_card(configuration), "")?;
        TABLES.iter().try_for_each(|table| file.table(table.name, &self.columns(table)))
    }

    fn columns(&self, table: &AotTable) -> Vec<Column> {
        let rows: Vec<_> = self.rows.iter().filter(|(name, _)| *name == table.name).map(|(_, cells)| cells).collect();
        let column = |&(name, kind, unit): &(&str, Kind, &str)| {
            let cells: Vec<Option<&Cell>> = rows
                .iter()
                .map(|cells| cells.iter().find(|(column, _)| *column == name).map(|(_, cell)| cell))
                .collect();
            match kind {
                Kind::Text => Column::text(name, cells.iter().map(|cell| text(*cell))),
                Kind::Real => Column::f64(name, unit, cells.iter().map(|cell| real(*cell)).collect()),
                Kind::Integer => Column::i64(name, cells.iter().map(|cell| integer(*cell)).collect()).in_unit(unit),
                Kind::List => Column::lists(name, unit, cells.iter().map(|cell| list(*cell)).collect()),
            }
        };
        table.columns.iter().map(column).collect()
    }
}

fn text(cell: Option<&Cell>) -> &str {
    if let Some(Cell::Text(text)) = cell { text } else { "" }
}

fn real(cell: Option<&Cell>) -> f64 {
    if let Some(Cell::Real(number)) = cell { *number } else { f64::NAN }
}

/// An integer; −32768, the null of aotpy's integer columns, where there is none. All integers of
/// AOT are counts.
fn integer(cell: Option<&Cell>) -> i64 {
    if let Some(Cell::Integer(number)) = cell { *number } else { i64::from(i16::MIN) }
}

fn list(cell: Option<&Cell>) -> Vec<f64> {
    if let Some(Cell::List(list)) = cell { list.clone() } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_that_the_standard_lacks_is_refused() {
        let mut tables = AotTables::new();
        assert!(tables.row("AOT_SOURCES", vec![("UID", "a".into()), ("FWHM", 1.0.into())]).is_ok());
        for (table, column, cell) in [
            ("AOT_STARS", "UID", Cell::from("a")),
            ("AOT_SOURCES", "WIDTH", Cell::from(1.0)),
            ("AOT_SOURCES", "FWHM", Cell::from("a")),
        ] {
            assert!(tables.row(table, vec![(column, cell)]).is_err(), "{table} {column}");
        }
    }
}

//! Corrections in the terms of a controller: its channels, with their names, units, signs and
//! limits.
//!
//! Channel k receives `c_k = s_k Σ_j M_kj a_j` of the corrections a_j of all elements (segments or
//! actuators), nm of wavefront. M is the scene's matrix with s = 1; with a table and no matrix a
//! channel receives the correction of one element; with both the table names, scales and limits the
//! rows of the matrix. A matrix of the segments may have columns for tips and tilts after the
//! pistons'.

use crate::io::{Column, TextRow, TextTable, read_map, read_text};
use crate::scene::System;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1};
use std::collections::BTreeSet;
use std::path::Path;

/// What a channel moves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Moved {
    /// The segments.
    Segments,
    /// The mirror.
    Actuators,
}

/// What to add to one channel of a controller.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    /// The controller's name of the channel.
    pub name: String,
    /// The segment or actuator that it moves, from 0; the row of the matrix where several may.
    pub number: usize,
    /// What to add, in the unit of the channels.
    pub value: f64,
    /// Whether it was cut at the limit of the channel.
    pub is_limited: bool,
}

/// Commands to all channels of a controller.
#[derive(Debug, Clone, PartialEq)]
pub struct Commands {
    /// Unit of the channels.
    pub unit: String,
    /// One for each channel, in the order of the scene's table, else of the matrix.
    pub channels: Vec<Command>,
    /// Whether they move tips and tilts of segments, and not pistons alone.
    pub has_tilts: bool,
}

impl Commands {
    /// Corrections in nm of the elements themselves, numbered from 0.
    pub(super) fn in_nm(additions_nm: &mut dyn Iterator<Item = f64>) -> Self {
        let command = |(number, value): (usize, f64)| {
            let Channel { name, .. } = Channel::of_row(number);
            Command { name, number, value, is_limited: false }
        };
        Self { unit: "nm".into(), channels: additions_nm.enumerate().map(command).collect(), has_tilts: false }
    }

    /// Columns `NAME`, `NUMBER`, `ADD` (in the unit of the channels) and `LIMITED` of a table.
    pub(super) fn columns(&self) -> [Column; 4] {
        let each = || self.channels.iter();
        [
            Column::text("NAME", each().map(|channel| &channel.name)),
            Column::i64("NUMBER", each().map(|channel| channel.number as i64).collect()),
            Column::f64("ADD", &self.unit, each().map(|channel| channel.value).collect()),
            Column::i64("LIMITED", each().map(|channel| channel.is_limited.into()).collect()),
        ]
    }

    /// A comment with the unit of `what`, and a line for each channel: name and what to add. Empty
    /// without channels.
    pub(super) fn text(&self, what: &str) -> String {
        let line = |channel: &Command| {
            let mark = if channel.is_limited { " # at its limit" } else { "" };
            // Six digits: far below any error bar, and a line that people can read.
            format!("{} {:.5e}{mark}\n", channel.name, channel.value)
        };
        let lines: String = self.channels.iter().map(line).collect();
        if lines.is_empty() { lines } else { format!("# {what}: channel, {}\n{lines}", self.unit) }
    }
}

impl Moved {
    /// What one of them is called.
    fn element(self) -> &'static str {
        match self {
            Self::Segments => "segment",
            Self::Actuators => "actuator",
        }
    }

    /// Key of the scene that names the table, and of that which names the matrix.
    fn keys(self) -> [&'static str; 2] {
        match self {
            Self::Segments => ["commands.segment_file", "commands.segment_matrix_file"],
            Self::Actuators => ["commands.actuator_file", "commands.actuator_matrix_file"],
        }
    }
}

/// A channel of a controller.
struct Channel {
    name: String,
    /// Row of the matrix, or element.
    number: usize,
    /// Units per nm, or per unit of the matrix.
    scale: f64,
    limit: Option<f64>,
}

/// Commands of the scene's controller of `moved` for `additions_nm`, the correction of each
/// element, and `tilts_nm` of the tip, then of the tilt of each segment (none: 0); `None` where the
/// scene describes no controller.
///
/// # Errors
/// [`Error::File`] for a table or a matrix that cannot be read, that does not fit the elements, or
/// that leaves one out.
pub(super) fn commands(
    scene: &System,
    moved: Moved,
    additions_nm: &[f64],
    tilts_nm: &[f64],
) -> Result<Option<Commands>> {
    let terms = &scene.commands;
    let (table, matrix, unit) = match moved {
        Moved::Segments => (&terms.segment_file, &terms.segment_matrix_file, &terms.segment_unit),
        Moved::Actuators => (&terms.actuator_file, &terms.actuator_matrix_file, &terms.actuator_unit),
    };
    let [table, matrix] = [table, matrix].map(|file| file.as_ref().map(|file| scene.resolve(file)));
    let matrix = matrix.map(|path| read_matrix(&path, moved, additions_nm.len())).transpose()?;
    let (rows, element) = match &matrix {
        Some(matrix) => (matrix.nrows(), "row of the matrix"),
        None => (additions_nm.len(), moved.element()),
    };
    let channels = match &table {
        Some(path) => {
            let text = read_text(path, &format!("{} of the scene names it", moved.keys()[0]))?;
            parse(&text, rows, element).map_err(|reason| Error::file(path, reason))?
        }
        None if matrix.is_some() => (0..rows).map(Channel::of_row).collect(),
        None => return Ok(None),
    };
    let has_tilts = matrix.as_ref().is_some_and(|matrix| matrix.ncols() > additions_nm.len());
    let inputs = matrix.map(|matrix| rows_moved(&matrix, additions_nm, tilts_nm));
    let inputs = inputs.as_deref().unwrap_or(additions_nm);
    let channels = channels.into_iter().map(|channel| channel.command(inputs)).collect();
    Ok(Some(Commands { unit: unit.clone(), channels, has_tilts }))
}

impl Channel {
    /// The channel of row `number` of a matrix without a table.
    fn of_row(number: usize) -> Self {
        Self { name: number.to_string(), number, scale: 1.0, limit: None }
    }

    fn command(self, inputs: &[f64]) -> Command {
        let wanted = self.scale * inputs[self.number];
        let limit = self.limit.unwrap_or(f64::INFINITY);
        let value = wanted.clamp(-limit, limit);
        Command { name: self.name, number: self.number, value, is_limited: wanted.abs() > limit }
    }
}

/// What the rows of a matrix receive: of the corrections of all elements, and of as many tilts as
/// it has further columns.
fn rows_moved(matrix: &Array2<f64>, additions_nm: &[f64], tilts_nm: &[f64]) -> Vec<f64> {
    let mut all_nm = [additions_nm, tilts_nm].concat();
    all_nm.resize(matrix.ncols(), 0.0);
    matrix.dot(&ArrayView1::from(&all_nm)).to_vec()
}

fn read_matrix(path: &Path, moved: Moved, elements: usize) -> Result<Array2<f64>> {
    let matrix = read_map(path, None)?;
    let (rows, columns) = matrix.dim();
    let takes_tilts = moved == Moved::Segments && columns == 3 * elements;
    if columns != elements && !takes_tilts {
        let (element, key) = (moved.element(), moved.keys()[1]);
        return Err(Error::file(
            path,
            format_args!(
                "the matrix has {rows} rows and {columns} columns where there are {elements} {element}s; {key} needs a column for each"
            ),
        ));
    }
    match matrix.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(Error::file(path, format_args!("the matrix holds {value}; finite numbers are needed"))),
        None => Ok(matrix),
    }
}

/// The channels of a table that move each of `elements`, called `element`, or why it is not
/// accepted.
fn parse(text: &str, elements: usize, element: &str) -> std::result::Result<Vec<Channel>, String> {
    let (mut channels, mut names, mut moved): (Vec<Channel>, _, _) = (Vec::new(), BTreeSet::new(), BTreeSet::new());
    for row in TextTable::new(text).rows {
        let channel = channel(&row, elements, element)?;
        if !names.insert(channel.name.clone()) {
            return Err(
                row.at(format_args!("the channel {} is there twice; a row for each channel is needed", channel.name))
            );
        }
        moved.insert(channel.number);
        channels.push(channel);
    }
    match (0..elements).find(|number| !moved.contains(number)) {
        Some(missing) => {
            Err(format!("no channel has the {element} {missing}; each of 0 to {} needs one", elements - 1))
        }
        None => Ok(channels),
    }
}

fn channel(row: &TextRow, elements: usize, element: &str) -> std::result::Result<Channel, String> {
    let count = row.words.len();
    if !(3..=4).contains(&count) {
        return Err(row.at(format_args!(
            "{count} columns; the number of the {element}, the channel's name, units per nm and optionally a limit are needed"
        )));
    }
    let number = row.integer(0).and_then(|number| usize::try_from(number).ok()).filter(|number| *number < elements);
    let number = number.ok_or_else(|| {
        row.at(format_args!("there is no {element} {}; 0 to {} are accepted", row.words[0], elements.saturating_sub(1)))
    })?;
    let scale = row.number(2, "the number of units per nm")?;
    if scale == 0.0 {
        return Err(row.at("0 units per nm move nothing; another number is needed"));
    }
    let limit = (count == 4).then(|| row.number(3, "a positive limit")).transpose()?;
    if let Some(limit) = limit.filter(|limit| *limit <= 0.0) {
        return Err(row.at(format_args!("a limit of {limit}; a positive one is needed")));
    }
    Ok(Channel { name: row.words[1].to_owned(), number, scale, limit })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_permutes_scales_and_limits() {
        let text = "# no name  V/nm  limit\n1, A17 -0.5 10\n0 B3 2\n2 C 1e-3 0.5\n";
        let channels = parse(text, 3, "segment").unwrap();
        let found: Vec<Command> = channels.into_iter().map(|channel| channel.command(&[3.0, 8.0, 1000.0])).collect();
        let expected = |name: &str, number, value, is_limited| Command { name: name.into(), number, value, is_limited };
        let wanted = [expected("A17", 1, -4.0, false), expected("B3", 0, 6.0, false), expected("C", 2, 0.5, true)];
        assert_eq!(found, wanted);
    }

    #[test]
    fn a_matrix_takes_tilts_where_it_has_columns_for_them() {
        // Two supports below each of two segments: piston ± tip.
        let supports = ndarray::array![
            [1.0, 0.0, 2.0, 0.0, 0.0, 0.0],
            [1.0, 0.0, -2.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 2.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, -2.0, 0.0, 0.0]
        ];
        let tilts_nm = [5.0, 7.0, 11.0, 13.0];
        assert_eq!(rows_moved(&supports, &[3.0, 4.0], &tilts_nm), [13.0, -7.0, 18.0, -10.0]);
        // An estimate without tilts, and a matrix without their columns.
        assert_eq!(rows_moved(&supports, &[3.0, 4.0], &[]), [3.0, 3.0, 4.0, 4.0]);
        assert_eq!(rows_moved(&Array2::eye(2), &[3.0, 4.0], &tilts_nm), [3.0, 4.0]);
    }

    #[test]
    fn mistakes_are_named_with_their_line() {
        for (text, expected) in [
            ("0 a\n", "line 1: 2 columns"),
            ("0 a 1 2 3\n", "line 1: 5 columns"),
            ("#\n2 a 1\n", "line 2 | no segment 2 | 0 to 1"),
            ("-1 a 1\n", "no segment -1"),
            ("0 a one\n", "line 1 | 'one' | finite number | units per nm"),
            ("0 a 0\n", "0 units per nm"),
            ("0 a 1 -3\n", "a limit of -3"),
            ("0 a 1\n1 a 1\n", "line 2 | channel a | twice"),
            ("0 a 1\n", "no channel | segment 1 | 0 to 1"),
            ("", "no channel | segment 0"),
        ] {
            let reason = parse(text, 2, "segment").err().unwrap();
            assert!(expected.split(" | ").all(|fact| reason.contains(fact)), "{text:?}: {reason}");
        }
    }
}

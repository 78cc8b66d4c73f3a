//! Cells of the tables of AOT, and what they refer to. A column that a file does not have is empty:
//! other programs leave out what they do not know.

use crate::Result;
use crate::io::layout::HduKind;
use crate::io::read::FitsReader;
use crate::io::value::Card;

/// A column of text; empty texts where the table does not have it.
pub(super) fn texts(file: &mut FitsReader, table: &str, column: &str) -> Result<Vec<String>> {
    let rows = file.rows(table)?;
    if rows == 0 || !file.has_column(table, column) {
        return Ok(vec![String::new(); rows]);
    }
    let texts = file.text_column(table, column)?;
    Ok(texts.into_iter().map(|text| text.trim().to_owned()).collect())
}

/// A column of numbers; NaN where the table does not have it.
pub(super) fn reals(file: &mut FitsReader, table: &str, column: &str) -> Result<Vec<f64>> {
    let rows = file.rows(table)?;
    if rows == 0 || !file.has_column(table, column) { Ok(vec![f64::NAN; rows]) } else { file.f64_column(table, column) }
}

/// A column of lists; empty lists where the table does not have it.
pub(super) fn lists(file: &mut FitsReader, table: &str, column: &str) -> Result<Vec<Vec<f64>>> {
    let rows = file.rows(table)?;
    if rows == 0 || !file.has_column(table, column) {
        Ok(vec![Vec::new(); rows])
    } else {
        file.list_column(table, column)
    }
}

/// The index of the image to which a cell of `column` refers; `None` for an empty cell.
///
/// # Errors
/// [`Error::File`](crate::Error::File) for an image that the file does not have, or that is in
/// another file.
pub(super) fn image(file: &FitsReader, cell: &str, column: &str) -> Result<Option<usize>> {
    if cell.is_empty() {
        return Ok(None);
    }
    let name = cell.strip_prefix("INTREF<").and_then(|rest| rest.strip_suffix('>'));
    let name = name.ok_or_else(|| {
        file.refuse(format!("refers to `{cell}` as {column}: an image in the same file, INTREF<NAME>, is accepted"))
    })?;
    if !file.has(name) {
        return Err(file.refuse(format!("refers to the image `{name}` as {column}, and has no HDU of this name")));
    }
    file.find(name, HduKind::Image).map(Some)
}

/// The row of `table` to which a cell refers; `None` for an empty cell.
///
/// # Errors
/// [`Error::File`](crate::Error::File) for a row that the table does not have.
pub(super) fn row(file: &mut FitsReader, cell: &str, table: &str) -> Result<Option<usize>> {
    if cell.is_empty() {
        return Ok(None);
    }
    let found = match cell.strip_prefix("ROWREF<").and_then(|rest| rest.strip_suffix('>')) {
        Some(uid) => texts(file, table, "UID")?.iter().position(|known| known == uid.trim()),
        None => None,
    };
    let missing = || file.refuse(format!("refers to `{cell}`, and the table {table} has no row of this UID"));
    found.map(Some).ok_or_else(missing)
}

/// A text card of the HDU at `index`; empty where it is absent.
pub(super) fn text_card(file: &mut FitsReader, index: usize, key: &str) -> Result<String> {
    Ok(match file.card_at(index, key)? {
        Some(Card::Text(text)) => text.trim().to_owned(),
        _ => String::new(),
    })
}

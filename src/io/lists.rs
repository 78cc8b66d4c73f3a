//! Columns of a table that may be absent, and those with a list in each row (variable-length arrays).

use super::layout::HduKind;
use super::read::FitsReader;
use crate::Result;

impl FitsReader {
    /// Whether the table `hdu` has the column `column`.
    pub fn has_column(&self, hdu: &str, column: &str) -> bool {
        let is_column = |name: &String| name.trim().eq_ignore_ascii_case(column);
        self.find(hdu, HduKind::Table).is_ok_and(|index| self.columns_of(index).iter().any(is_column))
    }

    /// Number of rows of the table `hdu`.
    ///
    /// # Errors
    /// [`Error::File`](crate::Error::File) where the table is missing.
    pub fn rows(&self, hdu: &str) -> Result<usize> {
        self.find(hdu, HduKind::Table).map(|index| self.rows_of(index))
    }

    /// A column of lists of real numbers of table `hdu`: variable-length arrays, or one number in each row.
    ///
    /// # Errors
    /// As [`FitsReader::f64_column`]; for a list that is longer than the table.
    pub fn list_column(&mut self, hdu: &str, column: &str) -> Result<Vec<Vec<f64>>> {
        let found = self.column(hdu, column)?;
        // cfitsio gives variable-length arrays the negative code of their elements.
        if found.code > 0 {
            return Ok(self.f64_column(hdu, column)?.into_iter().map(|number| vec![number]).collect());
        }
        found.check_numbers(self)?;
        let most = self.data_bytes(self.find(hdu, HduKind::Table)?) / found.width.unsigned_abs();
        (0..found.rows).map(|row| self.list(found.number, row, most)).collect()
    }
}

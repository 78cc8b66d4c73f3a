//! Columns of a table that may be absent, and those with a list in each row (variable-length arrays).

use super::layout::HduKind;
use super::read::FitsReader;
use crate::Result;

impl FitsReader {
    /// Whether the table `hdu` has the column `column`.
    pub fn has_column(&self, hdu: &str, column: &str) -> bool {
        let is_column = |name: &String| name.trim().eq_ignore_ascii_case(column);
        self.find(hdu, HduKind::Table).is_ok_and(|index| self.layout.hdus[index].columns().iter().any(is_column))
    }

    /// Number of rows of the table `hdu`.
    ///
    /// # Errors
    /// [`Error::File`](crate::Error::File) where the table is missing.
    pub fn rows(&self, hdu: &str) -> Result<usize> {
        let index = self.find(hdu, HduKind::Table)?;
        Ok(self.layout.hdus[index].axes.get(1).map_or(0, |&rows| rows as usize))
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
        // TBYTE, TSHORT, TINT, TLONG, TFLOAT, TLONGLONG and TDOUBLE of fitsio.h.
        if !matches!(found.code.abs(), 11 | 21 | 31 | 41 | 42 | 81 | 82) {
            return Err(self.refuse(format!("column `{}` is not a column of lists of numbers", found.name)));
        }
        let index = self.find(hdu, HduKind::Table)?;
        let most = self.layout.hdus[index].data_bytes / found.width.unsigned_abs();
        let list = |row| self.handle.list_f64(found.number, row, most);
        let lists: std::result::Result<Vec<_>, String> = (0..found.rows).map(list).collect();
        lists.map_err(|reason| self.refuse(reason))
    }

    /// Whether the file is read as a whole, and not by the HDU in brackets behind its name.
    pub(super) fn is_whole(&self) -> bool {
        self.selected.is_none()
    }
}

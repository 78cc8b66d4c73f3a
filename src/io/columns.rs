//! Columns of a table: one number or text in each row, or a list (variable-length arrays).

use super::layout::HduKind;
use super::read::FitsReader;
use crate::Result;

/// cfitsio's code of a text column.
const TSTRING: i32 = 16;

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

    /// A column of real numbers of table `hdu`; undefined values are NaN.
    ///
    /// # Errors
    /// [`Error::File`](crate::Error::File) where the table or the column is missing, or the column
    /// has not one number per row.
    pub fn f64_column(&mut self, hdu: &str, column: &str) -> Result<Vec<f64>> {
        let found = self.column(hdu, column)?;
        found.check_scalar(self, found.code.abs() != TSTRING && !found.is_complex(), "a column of numbers")?;
        self.handle.column_f64(found.number, found.rows, !found.is_real()).map_err(|reason| self.refuse(reason))
    }

    /// A column of integers of table `hdu`.
    ///
    /// # Errors
    /// As [`FitsReader::f64_column`]; a column of real numbers is an error, not rounded.
    pub fn i64_column(&mut self, hdu: &str, column: &str) -> Result<Vec<i64>> {
        let found = self.column(hdu, column)?;
        let integral = found.code.abs() != TSTRING && !found.is_complex() && !found.is_real();
        found.check_scalar(self, integral, "a column of integers")?;
        self.handle.column_i64(found.number, found.rows).map_err(|reason| self.refuse(reason))
    }

    /// A column of text of table `hdu`, without trailing blanks.
    ///
    /// # Errors
    /// As [`FitsReader::f64_column`].
    pub fn text_column(&mut self, hdu: &str, column: &str) -> Result<Vec<String>> {
        let found = self.column(hdu, column)?;
        if found.code != TSTRING || found.width != found.repeat {
            return Err(self.refuse(format!("column `{column}` of `{hdu}` is not a column of text")));
        }
        self.handle.column_text(found.number, found.rows, found.width as usize).map_err(|reason| self.refuse(reason))
    }

    /// A column of lists of real numbers of table `hdu`: variable-length arrays, or one number in
    /// each row.
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

    fn column(&mut self, hdu: &str, column: &str) -> Result<Column> {
        let index = self.find(hdu, HduKind::Table)?;
        let names = self.layout.hdus[index].columns();
        let Some(place) = names.iter().position(|name| name.trim().eq_ignore_ascii_case(column.trim())) else {
            let listed = names.join(", ");
            return Err(self.refuse(format!("table `{hdu}` has no column `{column}`: there are {listed}")));
        };
        let rows = self.layout.hdus[index].axes[1] as usize;
        self.move_to(index)?;
        self.check_data_sum(index)?;
        let number = place as i32 + 1;
        let (code, repeat, width) = self.handle.column_type(number).map_err(|reason| self.refuse(reason))?;
        // A column cannot be wider than its row, whose size was checked against the file. TFORM may
        // claim otherwise.
        if width < 1 || width as u64 > self.layout.hdus[index].axes[0] {
            return Err(self.refuse(format!(
                "column `{column}` of `{hdu}` has elements of {width} bytes, which do not fit its rows"
            )));
        }
        let hdu = &self.layout.hdus[index];
        let [scale, offset] = ["TSCAL", "TZERO"].map(|key| format!("{key}{number}"));
        if let Some(reason) = hdu.scaling_fault([&scale, &offset]).filter(|_| code.abs() != TSTRING) {
            return Err(self.refuse(reason));
        }
        Ok(Column { name: column.to_string(), number, rows, code, repeat, width })
    }
}

/// A column of a table.
struct Column {
    name: String,
    number: i32,
    rows: usize,
    code: i32,
    repeat: i64,
    width: i64,
}

impl Column {
    /// TFLOAT and TDOUBLE of fitsio.h.
    fn is_real(&self) -> bool {
        matches!(self.code, 42 | 82)
    }

    /// TCOMPLEX and TDBLCOMPLEX of fitsio.h.
    fn is_complex(&self) -> bool {
        matches!(self.code, 83 | 163)
    }

    /// Fails for vectors, for variable-length columns (negative codes) and where `has_type` is
    /// false.
    fn check_scalar(&self, file: &FitsReader, has_type: bool, wanted: &str) -> Result<()> {
        if has_type && self.code > 0 && self.repeat == 1 {
            return Ok(());
        }
        Err(file.refuse(format!("column `{}` is not {wanted}, one in each row", self.name)))
    }
}

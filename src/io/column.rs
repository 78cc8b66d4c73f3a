//! Columns of the tables that are written.

use super::characters;

/// A column of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    pub(super) name: String,
    pub(super) unit: String,
    pub(super) values: Values,
}

#[derive(Debug, Clone, PartialEq)]
pub(super) enum Values {
    F64(Vec<f64>),
    I64(Vec<i64>),
    Text(Vec<String>),
    Lists(Vec<Vec<f64>>),
}

impl Column {
    /// Real numbers in `unit` (empty for none); NaN is allowed.
    pub fn f64(name: &str, unit: &str, values: Vec<f64>) -> Self {
        Self { name: name.into(), unit: unit.into(), values: Values::F64(values) }
    }

    /// Integers.
    pub fn i64(name: &str, values: Vec<i64>) -> Self {
        Self { name: name.into(), unit: String::new(), values: Values::I64(values) }
    }

    /// Text. FITS allows printable ASCII only: other characters are written as those of the same
    /// meaning (χ² as `chi2`), or as `?`, tabs as blanks; trailing blanks are lost.
    pub fn text(name: &str, values: impl IntoIterator<Item = impl AsRef<str>>) -> Self {
        let values = values.into_iter().map(|text| ascii(text.as_ref())).collect();
        Self { name: name.into(), unit: String::new(), values: Values::Text(values) }
    }

    /// A list of real numbers in `unit` (empty for none) in each row; lists may differ in length,
    /// and be empty.
    pub fn lists(name: &str, unit: &str, values: Vec<Vec<f64>>) -> Self {
        Self { name: name.into(), unit: unit.into(), values: Values::Lists(values) }
    }

    /// This column in `unit` (empty for none).
    pub fn in_unit(self, unit: &str) -> Self {
        Self { unit: unit.into(), ..self }
    }

    pub(super) fn len(&self) -> usize {
        match &self.values {
            Values::F64(values) => values.len(),
            Values::I64(values) => values.len(),
            Values::Text(values) => values.len(),
            Values::Lists(values) => values.len(),
        }
    }

    /// TFORM of the column.
    pub(super) fn form(&self) -> String {
        match &self.values {
            Values::F64(_) => "1D".into(),
            Values::I64(_) => "1K".into(),
            Values::Text(values) => format!("{}A", values.iter().map(String::len).max().unwrap_or(0).max(1)),
            // Descriptors of 64 bits; the length of the longest list, which cfitsio leaves out
            // where it is 0.
            Values::Lists(values) => format!("QD({})", values.iter().map(Vec::len).max().unwrap_or(0)),
        }
    }
}

/// `text` in printable ASCII, as FITS requires: characters of the same meaning, `?` for others.
pub(super) fn ascii(text: &str) -> String {
    let plain = |byte: u8| match byte {
        b' '..=b'~' => char::from(byte),
        b'\t' => ' ',
        _ => '?',
    };
    // No quotation mark that would end a text within a text, such as a value of a scene.
    let text = text.replace(['\u{201c}', '\u{201d}', '\u{2033}'], "`");
    characters::ascii(text.as_bytes()).0.into_iter().map(plain).collect()
}

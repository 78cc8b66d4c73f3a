//! The binary table of the tiles, and integers of its header.

use crate::io::card;
use crate::io::layout::Hdu;

/// The integer of the card `key`; `None` without the card.
pub(super) fn integer(hdu: &Hdu, key: &str) -> Result<Option<i64>, String> {
    let value = hdu.value(key).filter(|value| !value.is_empty());
    let read = |value: &str| {
        card::integer(value).ok_or_else(|| format!("the card {key} is `{value}`, where an integer is needed"))
    };
    value.map(read).transpose()
}

/// As [`integer`], for sizes: 1 or more.
pub(super) fn size(hdu: &Hdu, key: &str, default: Option<i64>) -> Result<usize, String> {
    let value = integer(hdu, key)?.or(default).ok_or_else(|| format!("the card {key} is missing"))?;
    let size = u32::try_from(value).ok().filter(|&size| size > 0);
    size.map(|size| size as usize).ok_or_else(|| format!("the card {key} is {value}, where 1 or more is needed"))
}

/// The binary table of the tiles.
pub(super) struct TileTable<'a> {
    /// Rows, and behind them the heap.
    pub(super) data: &'a [u8],
    pub(super) rows: usize,
    row_bytes: usize,
    heap: usize,
    /// Name, format and first byte of each column.
    columns: Vec<(String, String, usize)>,
}

impl<'a> TileTable<'a> {
    pub(super) fn new(hdu: &Hdu, data: &'a [u8]) -> Result<Self, String> {
        let (row_bytes, rows) = (hdu.axes[0] as usize, hdu.axes[1] as usize);
        let heap = match integer(hdu, "THEAP")? {
            Some(heap) => usize::try_from(heap).map_err(|_| format!("the card THEAP is {heap}"))?,
            None => rows * row_bytes,
        };
        let (mut columns, mut at) = (Vec::new(), 0);
        for (i, name) in hdu.columns().into_iter().enumerate() {
            let form = hdu.value(&format!("TFORM{}", i + 1)).map(card::text).unwrap_or_default();
            let letter = form.trim_start_matches(|c: char| c.is_ascii_digit() || c == ' ');
            let digits = form[..form.len() - letter.len()].trim();
            let repeat: usize = if digits.is_empty() { 1 } else { digits.parse().unwrap_or(0) };
            let bytes = match letter.chars().next() {
                Some('L' | 'B' | 'A') => 1,
                Some('I') => 2,
                Some('J' | 'E') => 4,
                Some('K' | 'D' | 'C' | 'P') => 8,
                Some('M' | 'Q') => 16,
                _ => return Err(format!("the column {name} of its table has the format `{form}`")),
            };
            columns.push((name.trim().to_uppercase(), letter.to_string(), at));
            at = repeat.saturating_mul(bytes).saturating_add(at);
        }
        if at > row_bytes {
            return Err(format!("the columns of its table take {at} bytes of rows of {row_bytes}"));
        }
        Ok(Self { data, rows, row_bytes, heap, columns })
    }

    /// The format and the bytes of a column in a row.
    pub(super) fn field(&self, name: &str, row: usize) -> Option<(&str, &'a [u8])> {
        let (_, form, at) = self.columns.iter().find(|(known, ..)| known == name)?;
        let row = self.data.get(row * self.row_bytes..(row + 1) * self.row_bytes)?;
        Some((form, row.get(*at..)?))
    }

    /// A number of a column.
    pub(super) fn number(&self, name: &str, row: usize) -> Option<f64> {
        let (form, bytes) = self.field(name, row)?;
        match form.chars().next()? {
            'E' => Some(f64::from(f32::from_be_bytes(*bytes.first_chunk()?))),
            'D' => Some(f64::from_be_bytes(*bytes.first_chunk()?)),
            'I' => Some(f64::from(i16::from_be_bytes(*bytes.first_chunk()?))),
            'J' => Some(f64::from(i32::from_be_bytes(*bytes.first_chunk()?))),
            _ => None,
        }
    }

    /// The stream that a column of variable length has in a row; `None` for an empty one.
    pub(super) fn stream(&self, name: &str, row: usize) -> Option<&'a [u8]> {
        let (form, bytes) = self.field(name, row)?;
        let (count, start) = match form.chars().next()? {
            'P' => {
                let [count, start] = [0, 4].map(|at| Some(u32::from_be_bytes(*bytes.get(at..)?.first_chunk()?)));
                (count? as usize, start? as usize)
            }
            'Q' => {
                let [count, start] = [0, 8].map(|at| Some(u64::from_be_bytes(*bytes.get(at..)?.first_chunk()?)));
                (usize::try_from(count?).ok()?, usize::try_from(start?).ok()?)
            }
            _ => return None,
        };
        let bytes = match form.chars().nth(1)? {
            'I' => 2,
            'J' | 'E' => 4,
            'K' | 'D' => 8,
            _ => 1,
        };
        let start = self.heap.checked_add(start)?;
        let end = start.checked_add(count.checked_mul(bytes)?)?;
        self.data.get(start..end).filter(|stream| !stream.is_empty())
    }
}

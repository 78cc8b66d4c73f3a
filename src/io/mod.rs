//! FITS in, FITS out.
//!
//! * [`read_images`] reads what a camera wrote: images, bad pixels, read noise. [`FitsReader`] reads anything else by
//!   name: maps, cubes, columns, cards. Reading never touches the file.
//! * [`FitsWriter`] composes a file that appears whole or not at all.
//!
//! Arrays are `[.., y, x]` in C order; in the file x is NAXIS1. Names of HDUs and columns are compared without case.
//!
//! # Files that are not quite FITS
//!
//! `layout` walks the headers before cfitsio sees them and compares every size with the length of the file; `mend` turns
//! cards into the standard's form in a copy in memory, and one sentence says what was mended. What cannot be mended is
//! refused with the byte and the reason.

mod card;
mod cfitsio;
mod images;
mod layout;
mod mend;
mod read;
mod write;

use std::fmt;
use std::path::Path;

use ndarray::{Array2, Array3};

pub use images::{Images, read_images};
pub use read::FitsReader;
pub use write::{Column, FitsWriter, Pixel};

use crate::{Error, Result};

/// The value of a header card.
#[derive(Debug, Clone, PartialEq)]
pub enum Card {
    /// A string.
    Text(String),
    /// An integer.
    Integer(i64),
    /// A real number.
    Real(f64),
    /// T or F.
    Logical(bool),
}

impl Card {
    /// The number of an integer or real card.
    pub fn number(&self) -> Option<f64> {
        match self {
            Card::Integer(n) => Some(*n as f64),
            Card::Real(x) => Some(*x),
            Card::Text(_) | Card::Logical(_) => None,
        }
    }

    /// The text of a string card.
    pub fn text(&self) -> Option<&str> {
        if let Card::Text(text) = self { Some(text) } else { None }
    }
}

impl fmt::Display for Card {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Card::Text(text) => write!(f, "`{text}`"),
            Card::Integer(n) => n.fmt(f),
            Card::Real(x) => x.fmt(f),
            Card::Logical(b) => if *b { "T" } else { "F" }.fmt(f),
        }
    }
}

impl From<&str> for Card {
    fn from(text: &str) -> Self {
        Card::Text(text.to_string())
    }
}

impl From<String> for Card {
    fn from(text: String) -> Self {
        Card::Text(text)
    }
}

impl From<i64> for Card {
    fn from(n: i64) -> Self {
        Card::Integer(n)
    }
}

impl From<f64> for Card {
    fn from(x: f64) -> Self {
        Card::Real(x)
    }
}

impl From<bool> for Card {
    fn from(b: bool) -> Self {
        Card::Logical(b)
    }
}

/// A map of `path`: [`FitsReader::map`] of a file read once.
pub fn read_map(path: impl AsRef<Path>, hdu: Option<&str>) -> Result<Array2<f64>> {
    FitsReader::open(path)?.map(hdu)
}

/// A cube of `path`: [`FitsReader::cube`] of a file read once.
pub fn read_cube(path: impl AsRef<Path>, hdu: &str) -> Result<Array3<f64>> {
    FitsReader::open(path)?.cube(hdu)
}

/// `key` in capitals, if FITS allows it as a keyword.
fn checked_keyword(key: &str) -> Result<String> {
    let upper = key.to_ascii_uppercase();
    if card::is_keyword(upper.as_bytes()) {
        return Ok(upper);
    }
    Err(Error::Value(format!("`{key}` is no FITS keyword: 1 to 8 of A-Z, 0-9, - and _ are accepted")))
}

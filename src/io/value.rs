//! Values and keywords of header cards, as the library's interface has them.

use super::card;
use crate::{Error, Result};
use std::fmt;

/// The value of a header card.
#[derive(Debug, Clone, PartialEq)]
pub enum Card {
    /// String.
    Text(String),
    /// Integer.
    Integer(i64),
    /// Real number.
    Real(f64),
    /// Logical: T or F.
    Logical(bool),
}

impl Card {
    /// The number of an integer or real value; `None` for others.
    pub fn number(&self) -> Option<f64> {
        match self {
            Card::Integer(n) => Some(*n as f64),
            Card::Real(x) => Some(*x),
            Card::Text(_) | Card::Logical(_) => None,
        }
    }

    /// The text of a string value; `None` for others.
    pub fn text(&self) -> Option<&str> {
        if let Card::Text(text) = self { Some(text) } else { None }
    }
}

impl Card {
    /// The value of a card that is not a quoted string; `None` where it is undefined.
    pub(super) fn parse(value: &str) -> Option<Self> {
        match value {
            "" => None,
            "T" => Some(Card::Logical(true)),
            "F" => Some(Card::Logical(false)),
            // Fortran writes the exponent of a double with a D.
            _ => value.parse().map(Card::Integer).ok().or_else(|| {
                let real = value.replace(['D', 'd'], "E").parse().map(Card::Real);
                Some(real.unwrap_or_else(|_| Card::Text(card::text(value))))
            }),
        }
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

/// `key` in capitals.
///
/// # Errors
/// [`Error::Value`] where FITS does not allow it as a keyword.
pub(super) fn checked_keyword(key: &str) -> Result<String> {
    let upper = key.to_ascii_uppercase();
    if card::is_keyword(upper.as_bytes()) {
        return Ok(upper);
    }
    Err(Error::Value(format!("`{key}` is not a FITS keyword: 1 to 8 of A-Z, 0-9, - and _ are accepted")))
}

/// As [`checked_keyword`], for a card that is read, whose keyword may be of several words
/// (HIERARCH).
///
/// # Errors
/// As [`checked_keyword`].
pub(super) fn checked_keyword_to_read(key: &str) -> Result<String> {
    let upper = key.to_ascii_uppercase();
    let words = upper.strip_prefix("HIERARCH ").unwrap_or(&upper);
    if card::is_hierarchical(words) { Ok(words.to_owned()) } else { checked_keyword(key) }
}

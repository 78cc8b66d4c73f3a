//! Values that are lists with a syntax of their own.

use super::value::{FromToml, Range};
use super::words::{Optic, SlopeOrder};
use toml_edit::Value;

/// Range of Zernike polynomials by Noll index (1 is piston).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NollRange {
    /// None: `[]` or `"none"`.
    None,
    /// All from `first` to `last`: `[first, last]`.
    Span {
        /// First Noll index.
        first: usize,
        /// Last Noll index, not before `first`.
        last: usize,
    },
}

impl NollRange {
    /// Noll indices, ascending.
    pub fn indices(&self) -> std::ops::Range<usize> {
        match *self {
            Self::None => 0..0,
            Self::Span { first, last } => first..last + 1,
        }
    }
}

impl FromToml for NollRange {
    fn accepted(range: &Range) -> String {
        format!("[first, last] Noll index, first not after last, each{range}, or [] for none")
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        if let Some(word) = value.as_str() {
            return (word == "none").then_some(Self::None);
        }
        let ends: Option<Vec<usize>> = value.as_array()?.iter().map(|item| usize::from_toml(item, range)).collect();
        match *ends?.as_slice() {
            [] => Some(Self::None),
            [first, last] if first <= last => Some(Self::Span { first, last }),
            _ => None,
        }
    }
    fn to_toml(&self) -> String {
        match self {
            Self::None => "[]".into(),
            Self::Span { first, last } => format!("[{first}, {last}]"),
        }
    }
}

impl FromToml for Vec<SlopeOrder> {
    fn accepted(range: &Range) -> String {
        format!("a list of {}", SlopeOrder::accepted(range))
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        value.as_array()?.iter().map(|item| SlopeOrder::from_toml(item, range)).collect()
    }
    fn to_toml(&self) -> String {
        words_to_toml(self)
    }
}

/// A list of words in the syntax of TOML.
fn words_to_toml<T: FromToml>(words: &[T]) -> String {
    format!("[{}]", words.iter().map(FromToml::to_toml).collect::<Vec<_>>().join(", "))
}

impl FromToml for Vec<Optic> {
    fn accepted(range: &Range) -> String {
        format!("a list of {}", Optic::accepted(range))
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        let optics: Self = value.as_array()?.iter().map(|item| Optic::from_toml(item, range)).collect::<Option<_>>()?;
        let twice = (1..optics.len()).any(|i| optics[..i].contains(&optics[i]));
        (!twice).then_some(optics)
    }
    fn to_toml(&self) -> String {
        words_to_toml(self)
    }
}

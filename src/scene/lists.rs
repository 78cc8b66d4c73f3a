//! Values that are lists with a syntax of their own.

use super::value::{FromToml, LONGEST_LIST, Range, items};
use super::words::SlopeOrder;
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
        let ends: Option<Vec<usize>> = items(value, |item| usize::from_toml(item, range));
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
    fn is_within(&self, range: &Range) -> bool {
        match self {
            Self::None => true,
            Self::Span { first, last } => first <= last && first.is_within(range) && last.is_within(range),
        }
    }
}

/// Labels of segments: numbers, or words such as `A1`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SegmentLabels(Vec<String>);

/// Longest label.
const LONGEST_LABEL: usize = 16;
/// Largest label that is a number.
const LARGEST_LABEL: i64 = 1_000_000_000;

impl SegmentLabels {
    /// Number of labels.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The label of the segment `number`, from 0.
    pub fn get(&self, number: usize) -> Option<&str> {
        self.0.get(number).map(String::as_str)
    }

    /// All labels, in the order of the segments.
    pub fn iter(&self) -> impl Iterator<Item = &str> {
        self.0.iter().map(String::as_str)
    }

    /// Whether a number is written as this label.
    fn is_number(label: &str) -> bool {
        label.parse::<i64>().is_ok_and(|number| number.to_string() == label)
    }
}

impl FromToml for SegmentLabels {
    fn accepted(_: &Range) -> String {
        format!(
            "a list of at most {LONGEST_LIST} integers from 0 to {LARGEST_LABEL:e} or words in quotes, of 1 to {LONGEST_LABEL} letters, digits, '-', '_' or '.'"
        )
    }
    fn from_toml(value: &Value, _: &Range) -> Option<Self> {
        let is_word = |word: &&str| {
            let is_sign = |byte: u8| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte);
            (1..=LONGEST_LABEL).contains(&word.len()) && word.bytes().all(is_sign)
        };
        let label = |item: &Value| match item.as_integer() {
            Some(number) => (0..=LARGEST_LABEL).contains(&number).then(|| number.to_string()),
            None => item.as_str().filter(is_word).map(str::to_owned),
        };
        items(value, label).map(Self)
    }
    fn to_toml(&self) -> String {
        let item = |label: &String| if Self::is_number(label) { label.clone() } else { format!("{label:?}") };
        format!("[{}]", self.0.iter().map(item).collect::<Vec<_>>().join(", "))
    }
}

impl FromToml for Vec<SlopeOrder> {
    fn accepted(range: &Range) -> String {
        format!("a list of {}", SlopeOrder::accepted(range))
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        items(value, |item| SlopeOrder::from_toml(item, range))
    }
    fn to_toml(&self) -> String {
        format!("[{}]", self.iter().map(FromToml::to_toml).collect::<Vec<_>>().join(", "))
    }
}

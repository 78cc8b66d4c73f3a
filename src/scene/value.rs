//! Values of keys: read from TOML, checked against their range, written back.

use std::fmt::{self, Display};
use std::path::PathBuf;
use toml_edit::Value;

/// Range of the numbers that a key accepts; for a list, of each item.
#[derive(Debug, Clone, Copy)]
pub(super) struct Range {
    low: f64,
    high: f64,
    open_low: bool,
    open_high: bool,
    even: bool,
}

/// Every finite number; also the range of keys that are not numbers.
pub(super) const ANY: Range =
    Range { low: f64::NEG_INFINITY, high: f64::INFINITY, open_low: false, open_high: false, even: false };

/// `low ≤ x ≤ high`.
pub(super) const fn between(low: f64, high: f64) -> Range {
    Range { low, high, ..ANY }
}

/// `low < x ≤ high`.
pub(super) const fn above(low: f64, high: f64) -> Range {
    Range { open_low: true, ..between(low, high) }
}

/// `low ≤ x < high`.
pub(super) const fn below(low: f64, high: f64) -> Range {
    Range { open_high: true, ..between(low, high) }
}

/// `low < x < high`.
pub(super) const fn inside(low: f64, high: f64) -> Range {
    Range { open_high: true, ..above(low, high) }
}

/// `x ≥ low`.
pub(super) const fn at_least(low: f64) -> Range {
    between(low, f64::INFINITY)
}

/// `low ≤ x ≤ high`, and even.
pub(super) const fn even(low: f64, high: f64) -> Range {
    Range { even: true, ..between(low, high) }
}

impl Range {
    fn holds(&self, x: f64) -> bool {
        x.is_finite()
            && (if self.open_low { x > self.low } else { x >= self.low })
            && (if self.open_high { x < self.high } else { x <= self.high })
            && (!self.even || x % 2.0 == 0.0)
    }
}

impl Display for Range {
    /// Writes the range in words, to follow a noun: ` from 0 to 1`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { open_low, open_high, .. } = *self;
        let (low, high) = (brief(self.low), brief(self.high));
        match (self.low.is_finite(), self.high.is_finite()) {
            (false, false) => Ok(()),
            (true, false) if open_low => write!(f, " above {low}"),
            (true, false) => write!(f, " of {low} or more"),
            (false, true) => write!(f, " of {high} or less"),
            (true, true) => match (open_low, open_high) {
                (false, false) => write!(f, " from {low} to {high}"),
                (true, false) => write!(f, " above {low} and up to {high}"),
                (true, true) => write!(f, " above {low} and below {high}"),
                (false, true) => write!(f, " from {low} to below {high}"),
            },
        }
    }
}

/// Bound of a range; large numbers in exponential notation.
fn brief(x: f64) -> String {
    if x.abs() >= 1e6 { format!("{x:e}") } else { x.to_string() }
}

/// Value of a key, where the key is known at run time alone.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum SettingValue {
    Number(f64),
    Numbers(Vec<f64>),
    Flag(bool),
}

impl SettingValue {
    pub(crate) fn number(&self) -> Option<f64> {
        match self {
            Self::Number(number) => Some(*number),
            _ => None,
        }
    }
}

impl From<f64> for SettingValue {
    fn from(number: f64) -> Self {
        Self::Number(number)
    }
}

impl From<bool> for SettingValue {
    fn from(flag: bool) -> Self {
        Self::Flag(flag)
    }
}

/// Type of a key's value.
pub(super) trait FromToml: Sized {
    /// Accepted values, in words.
    fn accepted(range: &Range) -> String;
    /// Reads the value; `None` for another type or a value outside the range.
    fn from_toml(value: &Value, range: &Range) -> Option<Self>;
    /// Writes the value in TOML syntax.
    fn to_toml(&self) -> String;
    /// Whether there is a value.
    fn has_value(&self) -> bool {
        true
    }
    /// Whether the value is within the range; true of values that are not numbers.
    fn is_within(&self, _range: &Range) -> bool {
        true
    }
    /// The value, as a setting holds it; `None` where there is none, and for types of which there
    /// are no settings.
    fn to_setting(&self) -> Option<SettingValue> {
        None
    }
    /// The value of a setting, or of a key that is left out; `None` for another type.
    fn from_setting(_value: Option<&SettingValue>) -> Option<Self> {
        None
    }
}

/// Number of a TOML integer or float: `4` is accepted for `4.0`.
fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|i| i as f64))
}

impl FromToml for f64 {
    fn accepted(range: &Range) -> String {
        format!("a number{range}")
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        number(value).filter(|&x| range.holds(x))
    }
    fn to_toml(&self) -> String {
        format!("{self:?}")
    }
    fn is_within(&self, range: &Range) -> bool {
        range.holds(*self)
    }
    fn to_setting(&self) -> Option<SettingValue> {
        Some(SettingValue::Number(*self))
    }
    fn from_setting(value: Option<&SettingValue>) -> Option<Self> {
        value?.number()
    }
}

impl FromToml for u64 {
    fn accepted(range: &Range) -> String {
        format!("{}{range}", if range.even { "an even integer" } else { "an integer" })
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        let integer = value.as_integer().filter(|&i| range.holds(i as f64))?;
        u64::try_from(integer).ok()
    }
    fn to_toml(&self) -> String {
        self.to_string()
    }
    fn is_within(&self, range: &Range) -> bool {
        range.holds(*self as f64)
    }
}

impl FromToml for usize {
    fn accepted(range: &Range) -> String {
        u64::accepted(range)
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        usize::try_from(u64::from_toml(value, range)?).ok()
    }
    fn to_toml(&self) -> String {
        self.to_string()
    }
    fn is_within(&self, range: &Range) -> bool {
        range.holds(*self as f64)
    }
    fn to_setting(&self) -> Option<SettingValue> {
        Some(SettingValue::Number(*self as f64))
    }
    fn from_setting(value: Option<&SettingValue>) -> Option<Self> {
        value?.number().filter(|number| number.fract() == 0.0 && *number >= 0.0).map(|number| number as Self)
    }
}

impl FromToml for bool {
    fn accepted(_: &Range) -> String {
        "true or false".into()
    }
    fn from_toml(value: &Value, _: &Range) -> Option<Self> {
        value.as_bool()
    }
    fn to_toml(&self) -> String {
        self.to_string()
    }
    fn to_setting(&self) -> Option<SettingValue> {
        Some(SettingValue::Flag(*self))
    }
    fn from_setting(value: Option<&SettingValue>) -> Option<Self> {
        match value? {
            SettingValue::Flag(flag) => Some(*flag),
            _ => None,
        }
    }
}

impl FromToml for PathBuf {
    fn accepted(_: &Range) -> String {
        "a file name in quotes, relative to the scene".into()
    }
    fn from_toml(value: &Value, _: &Range) -> Option<Self> {
        value.as_str().filter(|s| !s.trim().is_empty() && !s.contains('\0')).map(PathBuf::from)
    }
    fn to_toml(&self) -> String {
        format!("{:?}", self.display().to_string())
    }
}

/// Longest text: that of a card of a FITS file.
const LONGEST_TEXT: usize = 60;

impl FromToml for String {
    fn accepted(_: &Range) -> String {
        format!("1 to {LONGEST_TEXT} printable ASCII characters in quotes")
    }
    fn from_toml(value: &Value, _: &Range) -> Option<Self> {
        let is_accepted = |text: &&str| {
            (1..=LONGEST_TEXT).contains(&text.len()) && text.bytes().all(|byte| (b' '..=b'~').contains(&byte))
        };
        value.as_str().map(str::trim).filter(is_accepted).map(str::to_owned)
    }
    fn to_toml(&self) -> String {
        format!("{self:?}")
    }
}

/// Most items of a list: more than the 2791 segments of 30 rings.
pub(super) const LONGEST_LIST: usize = 4096;

/// The items of a list, each as `item` reads it; `None` for another type, a longer list, or an item
/// that is not accepted.
pub(super) fn items<T>(value: &Value, item: impl FnMut(&Value) -> Option<T>) -> Option<Vec<T>> {
    value.as_array().filter(|array| array.len() <= LONGEST_LIST)?.iter().map(item).collect()
}

impl FromToml for Vec<f64> {
    fn accepted(range: &Range) -> String {
        let each = if range.low.is_finite() { format!(", each{range}") } else { String::new() };
        format!("a list of at most {LONGEST_LIST} numbers{each}")
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        items(value, |item| f64::from_toml(item, range))
    }
    fn to_toml(&self) -> String {
        format!("{self:?}")
    }
    fn is_within(&self, range: &Range) -> bool {
        self.iter().all(|&x| range.holds(x))
    }
    fn to_setting(&self) -> Option<SettingValue> {
        Some(SettingValue::Numbers(self.clone()))
    }
    fn from_setting(value: Option<&SettingValue>) -> Option<Self> {
        match value? {
            SettingValue::Numbers(numbers) => Some(numbers.clone()),
            _ => None,
        }
    }
}

impl FromToml for Vec<i64> {
    fn accepted(range: &Range) -> String {
        format!("a list of at most {LONGEST_LIST} integers, each{range}")
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        items(value, |item| item.as_integer().filter(|&i| range.holds(i as f64)))
    }
    fn to_toml(&self) -> String {
        format!("{self:?}")
    }
    fn is_within(&self, range: &Range) -> bool {
        self.iter().all(|&i| range.holds(i as f64))
    }
}

impl<T: FromToml> FromToml for Option<T> {
    fn accepted(range: &Range) -> String {
        T::accepted(range)
    }
    fn from_toml(value: &Value, range: &Range) -> Option<Self> {
        T::from_toml(value, range).map(Some)
    }
    fn to_toml(&self) -> String {
        self.as_ref().map_or_else(|| "unset".into(), T::to_toml)
    }
    fn has_value(&self) -> bool {
        self.is_some()
    }
    fn is_within(&self, range: &Range) -> bool {
        self.as_ref().is_none_or(|value| value.is_within(range))
    }
    fn to_setting(&self) -> Option<SettingValue> {
        self.as_ref().and_then(T::to_setting)
    }
    fn from_setting(value: Option<&SettingValue>) -> Option<Self> {
        match value {
            Some(_) => T::from_setting(value).map(Some),
            None => Some(None),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_their_descriptions_agree() {
        assert!(between(0.0, 1.0).holds(0.0) && between(0.0, 1.0).holds(1.0));
        assert!(!above(0.0, 1.0).holds(0.0) && above(0.0, 1.0).holds(1.0));
        assert!(!inside(0.0, 1.0).holds(1.0) && inside(0.0, 1.0).holds(0.5));
        assert!(!even(8.0, 12.0).holds(9.0) && even(8.0, 12.0).holds(10.0));
        assert!(!ANY.holds(f64::NAN) && !ANY.holds(f64::INFINITY) && ANY.holds(-1e300));
        assert_eq!(f64::accepted(&above(0.0, 1.0)), "a number above 0 and up to 1");
        assert_eq!(usize::accepted(&even(8.0, 12.0)), "an even integer from 8 to 12");
        assert_eq!(f64::accepted(&at_least(0.0)), "a number of 0 or more");
    }

    #[test]
    fn an_integer_is_accepted_as_float_but_not_a_float_as_integer() {
        let (four, four_point) = (Value::from(4), Value::from(4.0));
        assert_eq!(f64::from_toml(&four, &ANY), Some(4.0));
        assert_eq!(usize::from_toml(&four, &ANY), Some(4));
        assert_eq!(usize::from_toml(&four_point, &ANY), None);
        assert_eq!(usize::from_toml(&Value::from(-4), &ANY), None);
    }
}

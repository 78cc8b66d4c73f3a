//! Table of keys. A section is declared once with [`section!`]; its struct, parser, error messages,
//! suggestions for misspelt keys and reference are generated from that declaration.

use super::purpose::Purpose;
use super::value::{FromToml, Range, SettingValue};
use crate::{Error, Result};
use toml_edit::{Item, TableLike};

/// Description of a key for the reference and the error messages.
pub(super) struct Key {
    pub name: &'static str,
    pub about: &'static str,
    pub accepted: String,
    pub default: String,
}

/// Value of a key that a scene does not name.
pub(super) enum Preset<T> {
    /// The key is required.
    Required,
    /// Default value.
    Is(T),
    /// No value; the text describes the effect.
    Unset(T, &'static str),
}

pub(super) fn required<T>() -> Preset<T> {
    Preset::Required
}

pub(super) fn default<T>(value: impl Into<T>) -> Preset<T> {
    Preset::Is(value.into())
}

pub(super) fn unset<T>(instead: &'static str) -> Preset<Option<T>> {
    Preset::Unset(None, instead)
}

impl<T: FromToml> Preset<T> {
    pub(super) fn describe(&self) -> String {
        match self {
            Self::Required => "none, it is required".into(),
            Self::Is(value) => value.to_toml(),
            Self::Unset(_, instead) => (*instead).into(),
        }
    }
}

/// Section of a scene; [`section!`] implements it.
pub(super) trait Section: Sized {
    const NAME: &'static str;
    const ABOUT: &'static str;
    /// Table of this section's keys.
    fn keys() -> Vec<Key>;
    /// Reads and checks each key separately.
    fn read(reader: &Reader) -> Result<Self>;
    /// Keys whose values differ from those of `other`, and their values in TOML syntax; empty for a
    /// key without one.
    fn differences(&self, other: &Self) -> Vec<(&'static str, String)>;
    /// The first key whose value is out of its range: its name, the value, and what is accepted.
    fn key_out_of_range(&self) -> Option<(&'static str, String, String)>;
    /// Value of a key, as a setting holds it; `None` for a key without one, and for words and names
    /// of files.
    fn value(&self, key: &str) -> Option<SettingValue>;
    /// Sets a key, or leaves it out where there is no value; false where the key does not exist or
    /// accepts no such value.
    fn set_value(&mut self, key: &str, value: Option<&SettingValue>) -> bool;
}

/// Checks of a section that concern several keys.
pub(super) trait Check {
    /// Fills in defaults that depend on other keys, and refuses keys that are named in vain.
    fn complete(&mut self, _reader: &Reader) -> Result<()> {
        Ok(())
    }

    /// Refuses values that contradict each other. It does not depend on which keys the scene names.
    fn check(&self, _reader: &Reader) -> Result<()> {
        Ok(())
    }
}

/// Declares a section: `key: type, range, default;`. The doc comment is the text of the reference.
macro_rules! section {
    ($(#[doc = $about:literal])+ $section:ident = $name:literal {
        $($(#[doc = $doc:literal])+ $key:ident: $type:ty, $range:expr, $preset:expr;)+
    }) => {
        $(#[doc = $about])+
        #[derive(Debug, Clone, PartialEq)]
        pub struct $section { $($(#[doc = $doc])+ pub $key: $type,)+ }

        impl $crate::scene::table::Section for $section {
            const NAME: &'static str = $name;
            const ABOUT: &'static str = concat!($($about),+);

            fn keys() -> Vec<$crate::scene::table::Key> {
                vec![$($crate::scene::table::Key {
                    name: $crate::scene::table::key_name(stringify!($key)),
                    about: concat!($($doc),+),
                    accepted: <$type as $crate::scene::value::FromToml>::accepted(&$range),
                    default: $crate::scene::table::Preset::<$type>::describe(&$preset),
                }),+]
            }

            fn read(reader: &$crate::scene::table::Reader) -> $crate::Result<Self> {
                Ok(Self { $($key: reader.key($crate::scene::table::key_name(stringify!($key)), &$range, $preset)?,)+ })
            }

            fn differences(&self, other: &Self) -> Vec<(&'static str, String)> {
                use $crate::scene::value::FromToml;
                let mut all = Vec::new();
                $(if self.$key != other.$key {
                    let value = self.$key.has_value().then(|| self.$key.to_toml());
                    all.push(($crate::scene::table::key_name(stringify!($key)), value.unwrap_or_default()));
                })+
                all
            }

            fn key_out_of_range(&self) -> Option<(&'static str, String, String)> {
                use $crate::scene::value::FromToml;
                $(if !self.$key.is_within(&$range) {
                    let name = $crate::scene::table::key_name(stringify!($key));
                    return Some((name, self.$key.to_toml(), <$type>::accepted(&$range)));
                })+
                None
            }

            fn value(&self, key: &str) -> Option<$crate::scene::SettingValue> {
                use $crate::scene::value::FromToml;
                $(if key == $crate::scene::table::key_name(stringify!($key)) {
                    return self.$key.to_setting();
                })+
                None
            }

            fn set_value(&mut self, key: &str, value: Option<&$crate::scene::SettingValue>) -> bool {
                use $crate::scene::value::FromToml;
                $(if key == $crate::scene::table::key_name(stringify!($key)) {
                    return <$type>::from_setting(value).map(|value| self.$key = value).is_some();
                })+
                false
            }
        }
    };
}
pub(super) use section;

/// Key of a field: `loop` for the field `r#loop`.
pub(super) const fn key_name(field: &'static str) -> &'static str {
    match field.as_bytes() {
        [b'r', b'#', ..] => field.split_at(2).1,
        _ => field,
    }
}

/// Text of a scene, and its name in messages.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub name: &'a str,
    pub text: &'a str,
    pub purpose: Purpose,
    /// Keys that were set by a caller and not by the text, as `section.key`, with their values.
    pub settings: &'a [(&'a str, &'a str)],
}

impl Source<'_> {
    /// Position for a message: `scene.toml line 12`, or `scene.toml` for an unknown position.
    pub(super) fn at(&self, span: Option<std::ops::Range<usize>>) -> String {
        match span {
            Some(span) => {
                let before = &self.text.as_bytes()[..span.start.min(self.text.len())];
                format!("{} line {}", self.name, before.iter().filter(|&&b| b == b'\n').count() + 1)
            }
            None => self.name.to_string(),
        }
    }
}

/// Between the name of a scene and a key that a caller has set, in messages.
pub(super) const SETTING: &str = ", setting ";

/// Reader of the keys of one section.
pub(super) struct Reader<'a> {
    pub source: Source<'a>,
    pub section: &'static str,
    /// Item of the section; `None` if the scene does not have the section.
    pub item: Option<&'a Item>,
}

impl<'a> Reader<'a> {
    fn table(&self) -> Option<&'a dyn TableLike> {
        self.item?.as_table_like()
    }

    /// Whether the scene names the key.
    pub(super) fn named(&self, key: &str) -> bool {
        self.table().is_some_and(|table| table.contains_key(key))
    }

    /// Position of a key for a message: `scene.toml line 12`, or `scene.toml, setting image.pixels`
    /// for a key that a caller has set; that of its section if the scene does not name the key.
    pub(super) fn at(&self, key: &str) -> String {
        let is_this = |name: &str| name.split_once('.') == Some((self.section, key));
        if self.source.settings.iter().any(|(name, _)| is_this(name)) {
            return format!("{}{SETTING}{}.{key}", self.source.name, self.section);
        }
        let key_span =
            self.table().and_then(|table| table.get_key_value(key)).and_then(|(key, item)| key.span().or(item.span()));
        self.source.at(key_span.or_else(|| self.item.and_then(Item::span)))
    }

    /// Error about `key`.
    pub(super) fn error(&self, key: &str, sentence: impl std::fmt::Display) -> Error {
        Error::Scene(format!("{}: {sentence}", self.at(key)))
    }

    /// Refuses `keys` that are named but have no effect, for the given reason.
    pub(super) fn refuse(&self, keys: &[&str], reason: &str) -> Result<()> {
        let named: Vec<(&str, bool)> = keys.iter().map(|key| (*key, self.named(key))).collect();
        self.refuse_set(&named, reason)
    }

    /// Refuses the first of `keys` that is set but has no effect, for the given reason.
    pub(super) fn refuse_set(&self, keys: &[(&str, bool)], reason: &str) -> Result<()> {
        match keys.iter().find(|(_, is_set)| *is_set) {
            Some((key, _)) => {
                Err(self.error(key, format_args!("'{}.{key}' has no meaning {reason}; leave it out", self.section)))
            }
            None => Ok(()),
        }
    }

    /// Refuses two keys that are alternatives if both are named.
    pub(super) fn not_both(&self, one: &str, other: &str) -> Result<()> {
        if self.named(one) && self.named(other) { Err(self.both(one, other)) } else { Ok(()) }
    }

    /// Error about two keys of which a scene may name one.
    pub(super) fn both(&self, one: &str, other: &str) -> Error {
        let section = self.section;
        self.error(
            other,
            format_args!("'{section}.{one}' and '{section}.{other}' are both given; name only one of them"),
        )
    }

    /// Refuses more than one of keys that are alternatives.
    pub(super) fn not_several(&self, keys: &[&str]) -> Result<()> {
        let named: Vec<&str> = keys.iter().copied().filter(|key| self.named(key)).collect();
        if let [one, other, ..] = named.as_slice() { self.not_both(one, other) } else { Ok(()) }
    }

    /// Reads the value of one key.
    pub(super) fn key<T: FromToml>(&self, name: &'static str, range: &Range, preset: Preset<T>) -> Result<T> {
        let section = self.section;
        let Some(item) = self.table().and_then(|table| table.get(name)) else {
            return match preset {
                Preset::Is(value) | Preset::Unset(value, _) => Ok(value),
                Preset::Required => {
                    Err(self
                        .error(name, format_args!("'{section}.{name}' is missing; {} is needed", T::accepted(range))))
                }
            };
        };
        item.as_value().and_then(|value| T::from_toml(value, range)).ok_or_else(|| {
            let given = excerpt(item);
            self.error(
                name,
                format_args!("{section}.{name} = {given} is not accepted; {} is needed", T::accepted(range)),
            )
        })
    }
}

/// Refuses a section with a key whose value is out of its range.
pub(super) fn check_ranges<S: Section>(section: &S, source: Source) -> Result<()> {
    match section.key_out_of_range() {
        None => Ok(()),
        Some((key, value, accepted)) => {
            let reader = Reader { source, section: S::NAME, item: None };
            let name = S::NAME;
            Err(reader.error(key, format_args!("{name}.{key} = {value} is not accepted; {accepted} is needed")))
        }
    }
}

/// Value for a message: on one line, shortened.
fn excerpt(item: &Item) -> String {
    const LONGEST: usize = 60;
    let Some(value) = item.as_value() else { return "(a table)".into() };
    let text = value.clone().decorated("", "").to_string();
    let line: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).take(LONGEST + 1).collect();
    match line.char_indices().nth(LONGEST) {
        Some((end, _)) => format!("{}…", &line[..end]),
        None => line,
    }
}

/// Finds the name in `known` that is most similar to a misspelt `word`; `None` if no name is
/// similar.
pub(super) fn nearest<'k>(word: &str, known: impl IntoIterator<Item = &'k str>) -> Option<&'k str> {
    // A third of the letters may differ: enough for a misprint or a missing unit, too few for
    // another word.
    let (distance, name) = known.into_iter().map(|name| (strsim::damerau_levenshtein(word, name), name)).min()?;
    let similar = strsim::jaro_winkler(word, name) > 0.9;
    (similar || 3 * distance <= name.chars().count()).then_some(name)
}

/// `; did you mean 'x'?`, or nothing.
pub(super) fn suggestion<'k>(word: &str, known: impl IntoIterator<Item = &'k str>) -> String {
    nearest(word, known).map(|name| format!("; did you mean '{name}'?")).unwrap_or_default()
}

/// Key for a message: TOML allows any text of any length as a quoted key, so it is shortened to
/// printable characters.
pub(super) fn shown(key: &str) -> String {
    key.chars().map(|c| if c.is_control() { ' ' } else { c }).take(60).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suggestions_are_similar_or_absent() {
        let known = ["wavelength_nm", "pixels", "peak_snr"];
        assert_eq!(nearest("wavelenght_nm", known), Some("wavelength_nm"));
        assert_eq!(nearest("wavelength", known), Some("wavelength_nm"));
        assert_eq!(nearest("pixel", known), Some("pixels"));
        assert_eq!(nearest("telescope", known), None);
        assert_eq!(nearest("", known), None);
    }

    #[test]
    fn lines_are_counted_from_one() {
        let source = Source { name: "s", text: "a\nb\nc", purpose: Purpose::Whole, settings: &[] };
        assert_eq!(source.at(Some(0..1)), "s line 1");
        assert_eq!(source.at(Some(4..5)), "s line 3");
        assert_eq!(source.at(Some(400..405)), "s line 3");
        assert_eq!(source.at(None), "s");
    }
}

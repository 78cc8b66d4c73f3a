//! The one table of keys: a section is declared once with [`section!`], and its struct, its parsing, its error texts,
//! the suggestions for misspelt keys and the reference are all made from that declaration.

use super::purpose::Purpose;
use super::value::{FromToml, Range};
use crate::{Error, Result};
use toml_edit::{Item, TableLike};

/// What the reference and the error texts say about one key.
pub(super) struct Key {
    pub name: &'static str,
    pub about: &'static str,
    pub accepted: String,
    pub default: String,
}

/// What a key is worth where a scene does not name it.
pub(super) enum Preset<T> {
    /// The scene must name it.
    Required,
    /// This value.
    Is(T),
    /// No value here: the text says what happens instead.
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

/// A section of a scene, as [`section!`] makes it.
pub(super) trait Section: Sized {
    const NAME: &'static str;
    const ABOUT: &'static str;
    /// The table of this section's keys.
    fn keys() -> Vec<Key>;
    /// Reads each key by itself.
    fn read(reader: &Reader) -> Result<Self>;
}

/// What a section refuses that no key refuses by itself.
pub(super) trait Check {
    /// Fills in what follows from other keys, and refuses keys that contradict each other.
    fn check(&mut self, _reader: &Reader) -> Result<()> {
        Ok(())
    }
}

/// Declares a section: `key: type, range, default;` with the doc comment as the text of the reference.
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
        }
    };
}
pub(super) use section;

/// `loop`, from the `r#loop` that Rust wants.
pub(super) const fn key_name(field: &'static str) -> &'static str {
    match field.as_bytes() {
        [b'r', b'#', ..] => field.split_at(2).1,
        _ => field,
    }
}

/// The text of a scene and what to call it in messages.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub name: &'a str,
    pub text: &'a str,
    pub purpose: Purpose,
}

impl Source<'_> {
    /// `scene.toml line 12`, or `scene.toml` where no place is known.
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

/// Reads the keys of one section.
pub(super) struct Reader<'a> {
    pub source: Source<'a>,
    pub section: &'static str,
    /// The section's item, or `None` where the scene does not have the section.
    pub item: Option<&'a Item>,
}

impl<'a> Reader<'a> {
    fn table(&self) -> Option<&'a dyn TableLike> {
        self.item?.as_table_like()
    }

    /// Whether the scene names this key.
    pub(super) fn named(&self, key: &str) -> bool {
        self.table().is_some_and(|table| table.contains_key(key))
    }

    /// `scene.toml line 12`: where a key stands, or its section where it does not.
    pub(super) fn at(&self, key: &str) -> String {
        let key_span =
            self.table().and_then(|table| table.get_key_value(key)).and_then(|(key, item)| key.span().or(item.span()));
        self.source.at(key_span.or_else(|| self.item.and_then(Item::span)))
    }

    /// An error about `key`.
    pub(super) fn error(&self, key: &str, sentence: impl std::fmt::Display) -> Error {
        Error::Scene(format!("{}: {sentence}", self.at(key)))
    }

    /// Refuses those of `keys` that are named, which have no meaning for the reason given.
    pub(super) fn refuse(&self, keys: &[&str], reason: &str) -> Result<()> {
        match keys.iter().find(|key| self.named(key)) {
            Some(key) => {
                Err(self.error(key, format_args!("'{}.{key}' has no meaning {reason}; leave it out", self.section)))
            }
            None => Ok(()),
        }
    }

    /// Refuses two keys that say the same thing twice.
    pub(super) fn not_both(&self, one: &str, other: &str) -> Result<()> {
        if self.named(one) && self.named(other) {
            let section = self.section;
            return Err(self.error(
                other,
                format_args!("'{section}.{one}' and '{section}.{other}' are both given; name only one of them"),
            ));
        }
        Ok(())
    }

    /// The value of one key.
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

/// A value as a message shows it: on one line and not too long.
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

/// The nearest of `known` to a misspelt `word`, if any is near.
pub(super) fn nearest<'k>(word: &str, known: impl IntoIterator<Item = &'k str>) -> Option<&'k str> {
    // A third of the letters may be wrong: enough for a slip or a missing unit, too few for another word.
    let (distance, name) = known.into_iter().map(|name| (strsim::damerau_levenshtein(word, name), name)).min()?;
    let similar = strsim::jaro_winkler(word, name) > 0.9;
    (similar || 3 * distance <= name.chars().count()).then_some(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn suggestions_are_near_or_absent() {
        let known = ["wavelength_nm", "pixels", "peak_snr"];
        assert_eq!(nearest("wavelenght_nm", known), Some("wavelength_nm"));
        assert_eq!(nearest("wavelength", known), Some("wavelength_nm"));
        assert_eq!(nearest("pixel", known), Some("pixels"));
        assert_eq!(nearest("telescope", known), None);
        assert_eq!(nearest("", known), None);
    }

    #[test]
    fn lines_are_counted_from_one() {
        let source = Source { name: "s", text: "a\nb\nc", purpose: Purpose::Whole };
        assert_eq!(source.at(Some(0..1)), "s line 1");
        assert_eq!(source.at(Some(4..5)), "s line 3");
        assert_eq!(source.at(Some(400..405)), "s line 3");
        assert_eq!(source.at(None), "s");
    }
}

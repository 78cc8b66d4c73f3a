//! Changed copies of a scene: other values for some keys, with the comments kept.

use super::section_keys::SectionKeys;
use super::sections::{Sections, directory_of_keys};
use super::table::SETTING;
use super::unknown::{unknown_key, unknown_section};
use super::{Channel, Scene, System, channel, forms};
use crate::{Error, Result};
use toml_edit::{DocumentMut, Item, TableLike, Value};

impl Scene {
    /// This scene with other values: pairs of `section.key` and a value in TOML syntax; words and
    /// file names may omit the quotes. An empty value removes the key. All pairs are set before the
    /// validation. Another form of the same quantity gives way: `image.flux_e` replaces
    /// `image.peak_snr`. [`Scene::text`] has the new values and keeps its comments.
    /// `image.channel.NAME.key` is a key of the channel NAME.
    ///
    /// # Errors
    /// [`Error::Scene`] for a key that does not exist, or a value that the scene does not accept.
    pub fn with(&self, settings: &[(&str, &str)]) -> Result<Self> {
        let mut document = self.document()?;
        let sections = directory_of_keys();
        for &(key, value) in settings {
            if let Some(key) = key.strip_prefix(channel::PREFIX) {
                let value = Some(value.trim()).filter(|value| !value.is_empty());
                channel::set(&mut document, key, value.map(word_or_value))?;
                continue;
            }
            let (section, name) = known_key(&sections, key)?;
            set(&mut document, section, name, value.trim())?;
            if !value.trim().is_empty() {
                // Another form of the same quantity gives way, unless it is set, too.
                let is_set = |other: &str| settings.iter().any(|(key, _)| *key == format!("{section}.{other}"));
                for other in forms::other_forms(section, name).into_iter().filter(|other| !is_set(other)) {
                    set(&mut document, section, other, "")?;
                }
            }
        }
        Self::parse(self.name(), &document.to_string(), self.directory(), self.purpose(), settings)
            .map_err(|error| after_settings(error, settings))
    }

    /// This scene with other values, which its text has, too: `change` is given the sections of the
    /// scene, then those of each channel.
    ///
    /// # Errors
    /// As [`System::with`].
    pub(crate) fn changed(&self, change: impl Fn(&mut Sections)) -> Result<Self> {
        self.adopting(&self.system.with(change)?)
    }

    /// As [`Scene::changed`], for each channel by its number from 0 in [`Scene::each_channel`].
    ///
    /// # Errors
    /// As [`System::with`].
    pub(crate) fn with_each_channel(&self, change: impl Fn(usize, &mut Sections)) -> Result<Self> {
        self.adopting(&self.system.with_each_channel(change)?)
    }

    /// This scene with the values of `system`, which is its own but for some of them; the text has
    /// those that differ.
    ///
    /// # Errors
    /// [`Error::Internal`] for a text that is not TOML.
    pub(crate) fn adopting(&self, system: &System) -> Result<Self> {
        if *system == self.system {
            return Ok(self.clone());
        }
        let (mut document, mut channels) = (self.document()?, Vec::new());
        for (section, key, value) in system.differences(self) {
            if section != "image" || self.channels().is_empty() {
                set(&mut document, section, key, &value)?;
            }
        }
        for (own, of) in self.channels().iter().zip(system.channels()) {
            for (section, key, value) in of.system.differences(&own.scene) {
                if section == "image" {
                    let value = Some(value).filter(|value| !value.is_empty());
                    channel::set(&mut document, &format!("{}.{key}", own.name), value.as_deref().map(word_or_value))?;
                }
            }
            channels.push(Channel { name: own.name.clone(), scene: own.scene.adopting(&of.system)? });
        }
        Ok(Self { system: system.clone(), text: document.to_string().into(), channels: channels.into() })
    }

    pub(super) fn document(&self) -> Result<DocumentMut> {
        let parsed = self.text().parse();
        parsed.map_err(|error| Error::Internal(format!("the text of a valid scene is not TOML: {error}")))
    }

    /// This scene without `key`, which then has its default.
    ///
    /// # Errors
    /// [`Error::Scene`] for a key that does not exist, and for a scene that is not valid without
    /// it.
    pub fn without(&self, key: &str) -> Result<Self> {
        let mut document = self.document()?;
        let sections = directory_of_keys();
        let (section, name) = known_key(&sections, key)?;
        if let Some(table) = document.get_mut(section).and_then(toml_edit::Item::as_table_like_mut) {
            table.remove(name);
        }
        Self::parse(self.name(), &document.to_string(), self.directory(), self.purpose(), &[])
    }

    /// As [`Scene::with`], for one key.
    ///
    /// # Errors
    /// As [`Scene::with`].
    pub fn with_override(&self, key: &str, value: &str) -> Result<Self> {
        self.with(&[(key, value)])
    }
}

/// `error` of a scene with these settings; where it is about another key, which the scene's own
/// text sets, it names the settings, too: without them the scene was valid.
pub(super) fn after_settings(error: Error, settings: &[(&str, &str)]) -> Error {
    /// More would hide the reason.
    const MOST: usize = 3;
    match error {
        Error::Scene(sentence) if !settings.is_empty() && !sentence.contains(SETTING) => {
            let keys: Vec<&str> = settings.iter().map(|(key, _)| *key).take(MOST).collect();
            let more = if settings.len() > MOST { ", …" } else { "" };
            Error::Scene(format!("{sentence} (after setting {}{more})", keys.join(", ")))
        }
        other => other,
    }
}

/// Splits a setting `section.key=value` of a command line.
///
/// # Errors
/// [`Error::Scene`] for a setting without `=`.
pub fn split_setting(setting: &str) -> Result<(&str, &str)> {
    setting.split_once('=').map(|(key, value)| (key.trim(), value.trim())).ok_or_else(|| {
        Error::Scene(format!(
            "setting '{setting}' has no value; section.key=value is needed, such as image.peak_snr=50"
        ))
    })
}

/// Splits a dotted key into section and name, and checks that it exists.
fn known_key<'k>(sections: &[SectionKeys], key: &'k str) -> Result<(&'k str, &'k str)> {
    let Some((section, name)) = key.split_once('.') else {
        let home = sections.iter().find(|section| section.keys.iter().any(|known| known.name == key));
        let example = home.map_or("image.peak_snr".into(), |home| format!("{}.{key}", home.name));
        return Err(Error::Scene(format!(
            "setting '{key}' names no section; section.key is needed, such as {example}"
        )));
    };
    let Some(keys) = sections.iter().find(|known| known.name == section) else {
        return Err(Error::Scene(format!("setting '{key}': {}", unknown_section(sections, section))));
    };
    if keys.keys.iter().all(|known| known.name != name) {
        return Err(Error::Scene(format!("setting '{key}': {}", unknown_key(sections, keys, name))));
    }
    Ok((section, name))
}

fn set(document: &mut DocumentMut, section: &str, name: &str, value: &str) -> Result<()> {
    let document = document.as_table_mut();
    if value.is_empty() && !document.contains_key(section) {
        return Ok(()); // nothing to remove; an empty section may have another meaning than an absent one
    }
    let table = document.entry(section).or_insert_with(toml_edit::table);
    let Some(table) = table.as_table_like_mut() else {
        return Err(Error::Internal(format!("[{section}] of a valid scene is not a section")));
    };
    if value.is_empty() {
        table.remove(name);
    } else {
        replace(table, name, word_or_value(value));
    }
    Ok(())
}

/// Sets a value; keeps the white space and the comment around the old value.
fn replace(table: &mut dyn TableLike, name: &str, mut value: Value) {
    match table.get_mut(name).and_then(Item::as_value_mut) {
        Some(old) => {
            *value.decor_mut() = old.decor().clone();
            *old = value;
        }
        None => {
            table.insert(name, Item::Value(value));
        }
    }
}

/// Parses a value in TOML syntax; other text is a word without its quotes.
fn word_or_value(text: &str) -> Value {
    text.parse().unwrap_or_else(|_| Value::from(text))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_need_no_quotes() {
        assert_eq!(word_or_value("opencl:0:1").as_str(), Some("opencl:0:1"));
        assert_eq!(word_or_value("\"kl\"").as_str(), Some("kl"));
        assert_eq!(word_or_value("50").as_integer(), Some(50));
        assert_eq!(word_or_value("[4, 18]").as_array().map(toml_edit::Array::len), Some(2));
    }
}

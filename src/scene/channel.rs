//! Channels: several ways of imaging one wavefront, `[[image.channel]]`.
//!
//! A channel has a scene of its own: the keys that it names in place of those of `[image]`, and no
//! channels. Pixels keep their angle on the sky: where a channel names another wavelength and not
//! its sampling, the sampling follows the wavelength.

use super::forms;
use super::table::{Key, Section, Source, shown, suggestion};
use super::telescope::ImageScene;
use super::value::{FromToml, between};
use crate::{Error, Result};
use std::fmt::Display;
use toml_edit::{Array, ArrayOfTables, Document, DocumentMut, Item, Table, TableLike, Value};

/// Name of the list of channels in `[image]`.
pub(super) const LIST: &str = "channel";
/// Key of a channel's name.
const NAME: &str = "name";
/// Keys of `[image]` that hold for all channels.
const SHARED: [&str; 1] = ["simultaneous"];
/// What a setting of a channel's key begins with, as in `image.channel.plus.peak_snr`.
pub(super) const PREFIX: &str = "image.channel.";
/// Most channels of a scene. Through-focus sets have up to some ten.
pub(super) const MAX_CHANNELS: usize = 64;
/// Longest name, in characters: a card of a FITS file holds it.
const LONGEST_NAME: usize = 40;

/// Text of a channel's own scene.
pub(super) struct ChannelText {
    pub(super) name: String,
    pub(super) text: String,
    /// Keys that the channel sets, as `image.key`, with their values.
    pub(super) settings: Vec<(String, String)>,
}

/// The texts of the scenes of the channels in `document`; empty for a scene without channels.
///
/// # Errors
/// [`Error::Scene`] for a list that is not one, a key that a channel does not have, and names that
/// are not unique.
pub(super) fn texts(source: Source, document: &Document<&str>) -> Result<Vec<ChannelText>> {
    let Some(item) = document.get("image").and_then(Item::as_table_like).and_then(|image| image.get(LIST)) else {
        return Ok(Vec::new());
    };
    let error = |item: &Item, sentence: &dyn Display| Error::Scene(format!("{}: {sentence}", source.at(item.span())));
    let Some(tables) = item.as_array_of_tables() else {
        return Err(error(
            item,
            &"image.channel is not a list of channels; write [[image.channel]] with its keys below",
        ));
    };
    if tables.len() > MAX_CHANNELS {
        let sentence = format!("there are {} channels; at most {MAX_CHANNELS} are accepted", tables.len());
        return Err(error(item, &sentence));
    }
    let keys = ImageScene::keys();
    let mut found: Vec<ChannelText> = Vec::new();
    for (number, table) in tables.iter().enumerate() {
        let at = |sentence: &dyn Display| Error::Scene(format!("{}: {sentence}", source.at(table.span())));
        let name = name(table, number).map_err(|sentence| at(&sentence))?;
        if found.iter().any(|other| other.name == name) {
            return Err(at(&format_args!("two channels are named '{name}'; names that differ are needed")));
        }
        if let Some((key, item)) = table.iter().find(|(key, _)| !is_key(&keys, key)) {
            let sentence = unknown(&keys, key);
            return Err(Error::Scene(format!("{}: {sentence}", source.at(item.span()))));
        }
        found.push(text(source.text, table, name)?);
    }
    Ok(found)
}

/// Name of a channel, or why it is not accepted.
fn name(table: &Table, number: usize) -> std::result::Result<String, String> {
    let Some(item) = table.get(NAME) else { return Ok((number + 1).to_string()) };
    let word = item.as_str().filter(|word| !word.trim().is_empty() && word.chars().count() <= LONGEST_NAME);
    let is_plain = |word: &&str| word.chars().all(|c| (' '..='~').contains(&c) && c != '=');
    word.filter(is_plain).map(|word| word.trim().to_owned()).ok_or_else(|| {
        format!(
            "image.channel.name = {} is not accepted; printable ASCII of 1 to {LONGEST_NAME} characters without '=' is needed",
            shown(&item.to_string())
        )
    })
}

fn is_key(keys: &[Key], key: &str) -> bool {
    key == NAME || (!SHARED.contains(&key) && keys.iter().any(|known| known.name == key))
}

fn unknown(keys: &[Key], key: &str) -> String {
    if SHARED.contains(&key) {
        return format!("'image.channel.{key}' holds for all channels; it belongs in [image]");
    }
    let names = keys.iter().map(|key| key.name).filter(|name| !SHARED.contains(name)).chain([NAME]);
    format!(
        "unknown key 'image.channel.{}'{}; it has 'name' and the keys of [image]",
        shown(key),
        suggestion(key, names)
    )
}

/// The scene of one channel: `table` in the place of keys of `[image]`.
fn text(whole: &str, table: &Table, name: String) -> Result<ChannelText> {
    let internal = |what: &str| Error::Internal(format!("the text of a scene with channels: {what}"));
    let mut document: DocumentMut = whole.parse().map_err(|error| internal(&format!("{error}")))?;
    let image = document.get_mut("image").and_then(Item::as_table_like_mut).ok_or_else(|| internal("no [image]"))?;
    image.remove(LIST);
    let mut settings = Vec::new();
    if let Some(sampling) = followed_sampling(image, table) {
        settings.push((SAMPLING.to_owned(), sampling.to_string()));
        image.insert(SAMPLING, Item::Value(Value::from(sampling)));
    }
    // A channel that names several alternatives has them, which is refused.
    for keys in ALTERNATIVES.iter().filter(|keys| keys.iter().any(|key| table.contains_key(key))) {
        keys.iter().for_each(|key| drop(image.remove(key)));
    }
    if forms::FOCUS.iter().any(|key| table.contains_key(key)) {
        OF_DIVERSITY_FILE.iter().for_each(|key| drop(image.remove(key)));
    }
    for (key, value) in table.iter().filter(|(key, _)| *key != NAME) {
        let mut value = value.clone();
        if let Some(value) = value.as_value_mut() {
            value.decor_mut().clear();
        }
        settings.push((format!("image.{key}"), value.to_string()));
        image.insert(key, value);
    }
    Ok(ChannelText { name, text: document.to_string(), settings })
}

/// Sets a key of a channel in the text of a scene, `NAME.key`, or removes it where there is no
/// value.
///
/// # Errors
/// [`Error::Scene`] for a channel that the scene does not have, or a key that channels do not have.
pub(super) fn set(document: &mut DocumentMut, name_and_key: &str, value: Option<Value>) -> Result<()> {
    let Some((name, key)) = name_and_key.rsplit_once('.') else {
        return Err(Error::Scene(format!(
            "setting '{PREFIX}{}' names no key; {PREFIX}NAME.key is needed, such as {PREFIX}plus.peak_snr",
            shown(name_and_key)
        )));
    };
    let keys = ImageScene::keys();
    if key == NAME || !is_key(&keys, key) {
        return Err(Error::Scene(format!("setting '{PREFIX}{}': {}", shown(name_and_key), unknown(&keys, key))));
    }
    let tables = document.get_mut("image").and_then(|image| image.get_mut(LIST)).and_then(Item::as_array_of_tables_mut);
    let of_name = |(number, table): &(usize, &mut Table)| self::name(table, *number).is_ok_and(|own| own == name);
    match tables.and_then(|tables| tables.iter_mut().enumerate().find(of_name)) {
        Some((_, table)) => {
            match value {
                Some(value) => {
                    forms::other_forms("image", key).into_iter().for_each(|other| drop(table.remove(other)));
                    drop(table.insert(key, Item::Value(value)));
                }
                None => drop(table.remove(key)),
            }
            Ok(())
        }
        None => {
            Err(Error::Scene(format!("setting '{PREFIX}{}': the scene has no channel '{name}'", shown(name_and_key))))
        }
    }
}

/// What the images of a scene have of their own, a number for each: a key of `[image]` that is a
/// list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ImageList {
    /// Turns of the pupil, degrees.
    PupilTurns,
    /// Maps of the diversity.
    DiversityPlanes,
}

impl ImageList {
    /// Its key in `[image]`.
    fn key(self) -> &'static str {
        match self {
            Self::PupilTurns => "pupil_turns_deg",
            Self::DiversityPlanes => "diversity_planes",
        }
    }

    /// A list of one number.
    fn of_one(self, number: f64) -> Array {
        match self {
            Self::PupilTurns => Array::from_iter([number]),
            Self::DiversityPlanes => Array::from_iter([number as i64]),
        }
    }
}

/// Replaces each channel of the text of a scene, or the only way of imaging of one without
/// channels, by a channel for each number of its list: a name and the number.
///
/// # Errors
/// [`Error::Internal`] for a scene with another number of channels.
pub(super) fn divide(document: &mut DocumentMut, list_of: ImageList, parts: &[Vec<(String, f64)>]) -> Result<()> {
    let internal = |what: &str| Error::Internal(format!("image.{}: {what}", list_of.key()));
    let image = document.get_mut("image").and_then(Item::as_table_like_mut).ok_or_else(|| internal("no [image]"))?;
    let given = match image.remove(LIST) {
        Some(list) => list.into_array_of_tables().map_err(|_| internal("no list of channels"))?.into_iter().collect(),
        None => vec![Table::new()],
    };
    if given.len() != parts.len() {
        return Err(internal("another number of channels"));
    }
    let mut list = ArrayOfTables::new();
    for (table, parts) in given.iter().zip(parts) {
        for (name, number) in parts {
            let mut own = table.clone();
            own.insert(NAME, Item::Value(Value::from(name)));
            own.insert(list_of.key(), Item::Value(Value::from(list_of.of_one(*number))));
            list.push(own);
        }
    }
    image.insert(LIST, Item::ArrayOfTables(list));
    Ok(())
}

/// Gives a scene without channels a list of them: names, each with its values of keys `image.KEY`.
///
/// # Errors
/// [`Error::Internal`] for a scene that has no `[image]`.
pub(super) fn set_list(document: &mut DocumentMut, channels: &[(String, Vec<(&str, f64)>)]) -> Result<()> {
    let image = document.get_mut("image").and_then(Item::as_table_like_mut);
    let image = image.ok_or_else(|| Error::Internal("a list of channels: no [image]".into()))?;
    let each = channels.iter().map(|(name, values)| {
        let values = values.iter().map(|(key, value)| (key.trim_start_matches("image."), Value::from(*value)));
        [(NAME, Value::from(name))].into_iter().chain(values).collect::<Table>()
    });
    image.insert(LIST, Item::ArrayOfTables(each.collect()));
    Ok(())
}

const SAMPLING: &str = forms::SAMPLING[0];
/// Keys of which a scene may name one: a channel that names one of them replaces all.
const ALTERNATIVES: [&[&str]; 5] = [
    &forms::BRIGHTNESS,
    &[forms::FOCUS[0], forms::FOCUS[1], forms::FOCUS[2], forms::FOCUS[3], "diversity_file"],
    &["bandwidth_fraction", "filter_file"],
    &forms::SAMPLING,
    &forms::FOCAL,
];

/// Keys that say how `diversity_file` is read.
const OF_DIVERSITY_FILE: [&str; 2] = ["diversity_planes", "diversity_scale"];

/// Sampling of a channel of another wavelength: that of `[image]` for pixels of the same angle.
fn followed_sampling(image: &dyn TableLike, channel: &Table) -> Option<f64> {
    let range = between(f64::MIN_POSITIVE, f64::MAX);
    let number = |item: Option<&Item>| item?.as_value().and_then(|value| f64::from_toml(value, &range));
    let (own, shared) = (number(channel.get("wavelength_nm"))?, number(image.get("wavelength_nm"))?);
    // A pixel in other words keeps its angle, and its sampling follows from it.
    let has_other_words = |table: &dyn TableLike| forms::SAMPLING[1..].iter().any(|key| table.contains_key(key));
    if channel.contains_key(SAMPLING) || own == shared || has_other_words(channel) || has_other_words(image) {
        return None;
    }
    let sampling = number(image.get(SAMPLING)).unwrap_or(DEFAULT_SAMPLING);
    Some(sampling * own / shared)
}

/// Sampling of a scene that names none; a test holds it against the section's default.
const DEFAULT_SAMPLING: f64 = 2.0;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use std::path::Path;

    const CHANNELS: &str = r#"
[[image.channel]]
name = "plus"
diversity_focus_waves_rms = 1.0

[[image.channel]]
wavelength_nm = 1084.3
flux_e = 1e6

[aberrations]"#;

    /// The preset with two channels.
    fn text() -> String {
        Scene::preset_text("keck-artificial").unwrap().replacen("[aberrations]", CHANNELS, 1)
    }

    fn parse(text: &str) -> Result<Scene> {
        Scene::from_text(text, Path::new(""))
    }

    #[test]
    fn a_channel_overrides_keys_of_the_image_and_keeps_the_others() {
        let base = Scene::preset("keck-artificial").unwrap();
        let unnamed = base.without("image.samples_per_lambda_over_d").unwrap();
        assert_eq!(DEFAULT_SAMPLING, unnamed.image.samples_per_lambda_over_d);
        let scene = parse(&text()).unwrap();
        let [plus, second] = scene.channels() else { panic!("{:?}", scene.channels().len()) };
        assert_eq!((plus.name.as_str(), second.name.as_str()), ("plus", "2"));
        assert_eq!(plus.scene.image, base.with_override("image.diversity_focus_waves_rms", "1.0").unwrap().image);
        assert_eq!(scene.image, plus.scene.image);
        assert!(second.scene.channels().is_empty());
        // The wavelength is 2168.6 nm in the preset: the same angle is half as many pixels per λ/D.
        let image = &second.scene.image;
        assert!((image.samples_per_lambda_over_d / base.image.samples_per_lambda_over_d - 0.5).abs() < 1e-12);
        assert_eq!((image.flux_e, image.peak_snr, image.pixels), (Some(1e6), None, 480));
    }

    #[test]
    fn a_setting_reaches_the_key_of_a_channel() {
        let scene = parse(&text()).unwrap().with_override("image.channel.plus.peak_snr", "50").unwrap();
        assert_eq!(scene.channels()[0].scene.image.peak_snr, Some(50.0));
        assert_eq!(scene.channels()[1].scene.image.flux_e, Some(1e6));
        let without = scene.with_override("image.channel.2.flux_e", "").unwrap();
        assert_eq!(without.channels()[1].scene.image.peak_snr, Some(500.0));
        for (key, expected) in [
            ("image.channel.blue.peak_snr", "no channel 'blue'"),
            ("image.channel.plus.peak_snt", "did you mean 'peak_snr'?"),
            ("image.channel.plus", "names no key"),
        ] {
            let error = scene.with_override(key, "50").unwrap_err().to_string();
            assert!(error.contains(expected), "{key}: {error}");
        }
    }

    #[test]
    fn mistakes_are_named() {
        for (from, to, expected) in [
            ("name = \"plus\"", "name = \"2\"", "two channels | '2'"),
            ("name = \"plus\"", "name = 3", "image.channel.name = 3"),
            ("name = \"plus\"", "nam = \"plus\"", "unknown key | 'image.channel.nam' | 'name'"),
            ("flux_e = 1e6", "simultaneous = true", "[image]"),
            ("flux_e = 1e6", "pixels = 7", "image.pixels = 7"),
            ("flux_e = 1e6", "flux_e = 1e6\npeak_snr = 50", "both given"),
            ("flux_e = 1e6", "name = \"a=b\"", "without '='"),
        ] {
            let error = parse(&text().replace(from, to)).unwrap_err().to_string();
            assert!(expected.split(" | ").all(|fact| error.contains(fact)), "{to}: {error}");
        }
        let error = parse("[image]\nwavelength_nm = 2000.0\npixels = 64\nchannel = 3\n").unwrap_err().to_string();
        assert!(error.contains("write [[image.channel]]"), "{error}");
    }
}

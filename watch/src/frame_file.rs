//! A file of frames: read as `cophase estimate` reads it, with the time of its observation.

use crate::clock;
use crate::folder::Stamp;
use crate::store::Content;
use cophase::io::{Card, FitsReader};
use cophase::pipeline::{Images, Trust};
use cophase::{Error, Result};
use std::path::{Path, PathBuf};

/// How files are read.
#[derive(Debug, Clone, Default)]
pub struct FrameReader {
    /// File of bad pixels.
    pub mask: Option<PathBuf>,
    /// Whether the scene holds where a file contradicts it.
    pub trust_scene: bool,
    /// Keys whose value takes precedence over the file.
    pub overrides: Vec<String>,
}

/// What a file holds.
pub struct FrameFile {
    /// Those of each channel.
    pub images: Vec<Images>,
    /// When it was observed, s since 1970: from its cards, else its last change.
    pub observed_s: f64,
    /// Whether a card has it, or something that is no time, of which the images' notes say so.
    pub is_dated: bool,
}

impl FrameReader {
    /// Reads the file `path`, which has this `stamp`.
    ///
    /// # Errors
    /// Those of [`Images::read`].
    pub fn read(&self, path: &Path, stamp: &Stamp) -> Result<FrameFile> {
        let read = Images::read(path, self.mask.as_deref())?.into_iter();
        let mut images: Vec<Images> = read.map(|images| self.with_options(images)).collect();
        if images.iter().all(Images::is_empty) {
            return Err(Error::file(path, "holds no image"));
        }
        let Observed { time_s, unread } = observed(path);
        let is_dated = time_s.is_some() || unread.is_some();
        if let (None, Some(card)) = (time_s, unread) {
            images[0].notes.push(format!(
                "the time of the observation is not read from the card {card}: that of the file's last change is used; \
                 2026-11-25T04:15:30.25 is accepted"
            ));
        }
        Ok(FrameFile { images, observed_s: time_s.unwrap_or_else(|| stamp.mtime_s()), is_dated })
    }

    /// `images` with what the command line says of them.
    pub fn with_options(&self, images: Images) -> Images {
        let trust = if self.trust_scene { Trust::Scene } else { Trust::Neither };
        Images { trust, overrides: self.overrides.clone(), ..images }
    }
}

/// Hash of the file's bytes.
///
/// # Errors
/// [`Error::File`] where it cannot be read.
pub fn content(path: &Path) -> Result<Content> {
    let failed = |error: std::io::Error| Error::file(path, format_args!("cannot be read: {error}"));
    Content::read(&mut std::fs::File::open(path).map_err(failed)?).map_err(failed)
}

/// The time of an observation in the cards of a file.
#[derive(Default)]
struct Observed {
    /// Seconds since 1970.
    time_s: Option<f64>,
    /// The first card that has a time in a form that is not read.
    unread: Option<String>,
}

/// The time of an observation, the middle before the beginning (FITS standard 4.0, table 22); then
/// names that observatories use.
fn observed(path: &Path) -> Observed {
    let Ok(mut file) = FitsReader::open(path) else { return Observed::default() };
    let mut card = |key: &str| file.image_card(key).ok().flatten();
    let mut unread = None;
    for key in ["DATE-AVG", "DATE-BEG", "DATE-OBS", "DATE_OBS", "UTC-OBS", "UTDATE"] {
        let Some(Card::Text(text)) = card(key).filter(|card| card.text().is_none_or(|text| !text.trim().is_empty()))
        else {
            continue;
        };
        let has_time = text.trim().contains(['T', ' ']);
        let own = has_time.then(|| clock::of_iso(&text)).flatten();
        if own.is_some() {
            return Observed { time_s: own, unread: None };
        }
        if !has_time && let (Some(midnight_s), Some(time_s)) = (clock::of_iso(&text), time_of_day(&mut card)) {
            return Observed { time_s: Some(midnight_s + time_s), unread: None };
        }
        unread.get_or_insert_with(|| format!("{key} = `{}`", text.trim()));
    }
    let days = |card: Card| card.number().or_else(|| card.text()?.trim().parse().ok());
    let of_days = ["MJD-AVG", "MJD-BEG", "MJD-OBS", "MJD_OBS", "MJD", "EXPSTART"].into_iter();
    let found = of_days.filter_map(&mut card).filter_map(days).find_map(clock::of_mjd);
    Observed { time_s: found.or_else(|| clock::of_mjd(days(card("JD")?)? - 2_400_000.5)), unread }
}

/// The time of the day in a card of its own, as Keck and others keep it, s; ESO's is a number of
/// seconds.
fn time_of_day(card: &mut impl FnMut(&str) -> Option<Card>) -> Option<f64> {
    ["TIME-OBS", "TIME_OBS", "UTC", "UT", "UTSTART", "UT-START", "TIME"].into_iter().find_map(|key| match card(key)? {
        Card::Text(text) => clock::time_in(&text),
        other => other.number().filter(|seconds| (0.0..86_401.0).contains(seconds)),
    })
}

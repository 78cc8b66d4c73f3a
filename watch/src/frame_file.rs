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
    pub images: Images,
    /// When it was observed, s since 1970: from its cards, else its last change.
    pub observed_s: f64,
}

impl FrameReader {
    /// Reads the file `path`, which has this `stamp`.
    ///
    /// # Errors
    /// Those of [`Images::read`].
    pub fn read(&self, path: &Path, stamp: &Stamp) -> Result<FrameFile> {
        let images = self.with_options(Images::read(path, self.mask.as_deref())?);
        if images.is_empty() {
            return Err(Error::file(path, "holds no image"));
        }
        let observed_s = observed(path).unwrap_or_else(|| stamp.mtime_s());
        Ok(FrameFile { images, observed_s })
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

/// The time of an observation in the cards of a file, the middle before the beginning (FITS standard 4.0, table 22).
fn observed(path: &Path) -> Option<f64> {
    let mut file = FitsReader::open(path).ok()?;
    let mut card = |key: &str| file.image_card(key).ok().flatten();
    for key in ["DATE-AVG", "DATE-BEG", "DATE-OBS"] {
        let Some(Card::Text(text)) = card(key) else { continue };
        if text.contains('T') {
            if let Some(seconds) = clock::of_iso(&text) {
                return Some(seconds);
            }
            continue;
        }
        // Keck and others keep the time of the day in a card of its own.
        for clock_key in ["TIME-OBS", "UTC", "UT"] {
            let Some(Card::Text(time)) = card(clock_key) else { continue };
            if let Some(seconds) = clock::of_iso(&format!("{text}T{time}")) {
                return Some(seconds);
            }
        }
    }
    ["MJD-AVG", "MJD-BEG", "MJD-OBS"].into_iter().find_map(|key| clock::of_mjd(card(key)?.number()?))
}

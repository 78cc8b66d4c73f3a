//! The one typeface of the pictures (Ubuntu Light, embedded: no system font is needed) and its measures.

use super::colour::Rgb;
use crate::{Error, Result};
use epaint_default_fonts::UBUNTU_LIGHT;
use plotters::style::{FontDesc, FontFamily, FontStyle};
use std::sync::LazyLock;

/// A CSS list: an SVG viewer takes the first that it has. Also the name under which the bytes are registered.
const FAMILY: &str = "Ubuntu, Helvetica, Arial, sans-serif";

/// Line height of Ubuntu Light, em: `hhea` ascender 932, descender −189 of 1000 units. plotters' bitmap text is sized by it.
pub(super) const LINE_PER_EM: f64 = 1.121;
/// plotters' SVG text divides the size by this.
pub(super) const SVG_SIZE_PER_EM: f64 = 1.24;
/// Where plotters' SVG puts the baseline below the top, em.
pub(super) const SVG_TOP_TO_BASELINE: f64 = 0.76;
/// Half the height of a capital, em (693 of 1000 units).
pub(super) const HALF_CAPITAL: f64 = 0.347;

/// The superscript minus, which the typeface lacks: a PNG gets a small raised minus.
const SUPERSCRIPT_MINUS: char = '⁻';

/// Where text stands relative to its point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

impl Anchor {
    /// The part of the text that lies before the point.
    pub fn fraction(self) -> f64 {
        match self {
            Anchor::Start => 0.0,
            Anchor::Middle => 0.5,
            Anchor::End => 1.0,
        }
    }
}

/// Size (em, logical pixels), colour and anchor of a text.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ink {
    pub em: f64,
    pub colour: Rgb,
    pub anchor: Anchor,
}

impl Ink {
    pub fn new(em: f64, colour: Rgb) -> Self {
        Self { em, colour, anchor: Anchor::Start }
    }

    pub fn middle(self) -> Self {
        Self { anchor: Anchor::Middle, ..self }
    }

    pub fn end(self) -> Self {
        Self { anchor: Anchor::End, ..self }
    }
}

/// Makes the typeface known to plotters, once.
pub(super) fn register() -> Result<()> {
    static DONE: LazyLock<bool> =
        LazyLock::new(|| plotters::style::register_font(FAMILY, FontStyle::Normal, UBUNTU_LIGHT).is_ok());
    if *DONE { Ok(()) } else { Err(Error::Internal("the embedded typeface cannot be read".into())) }
}

/// The typeface at `size`, in plotters' sense of the word.
pub(super) fn description(size: f64) -> FontDesc<'static> {
    FontDesc::new(FontFamily::Name(FAMILY), size, FontStyle::Normal)
}

/// `text` without the control characters that XML forbids.
pub(super) fn printable(text: &str) -> String {
    text.chars().map(|c| if c.is_control() || matches!(c, '\u{fffe}' | '\u{ffff}') { ' ' } else { c }).collect()
}

/// Pieces of `text` with their relative size and their rise in em.
pub(super) fn runs(text: &str) -> Vec<(&str, f64, f64)> {
    let mut runs = Vec::new();
    let mut rest = text;
    while let Some(at) = rest.find(SUPERSCRIPT_MINUS) {
        if at > 0 {
            runs.push((&rest[..at], 1.0, 0.0));
        }
        runs.push(("−", 0.62, 0.36));
        rest = &rest[at + SUPERSCRIPT_MINUS.len_utf8()..];
    }
    if !rest.is_empty() || runs.is_empty() {
        runs.push((rest, 1.0, 0.0));
    }
    runs
}

/// Width of `text` at `em`, logical pixels.
pub(super) fn width(text: &str, em: f64) -> f64 {
    // plotters measures in whole pixels: measure large, then scale.
    const LARGE: f64 = 1000.0;
    let large = description(LARGE * LINE_PER_EM);
    let one = |run: &str| large.layout_box(run).map_or(0.0, |((x0, _), (x1, _))| f64::from(x1 - x0));
    runs(text).iter().map(|(run, size, _)| one(run) * size * em / LARGE).sum()
}

/// `text`, cut with an ellipsis where it would be wider than `room`.
pub(super) fn fitted(text: &str, em: f64, room: f64) -> String {
    if width(text, em) <= room {
        return text.to_string();
    }
    let letters: Vec<char> = text.chars().collect();
    let cut = |n: usize| letters[..n].iter().collect::<String>().trim_end().to_string() + "…";
    // The width grows with the letters: bisect.
    let (mut fits, mut wide) = (0, letters.len());
    while wide - fits > 1 {
        let middle = (fits + wide) / 2;
        if width(&cut(middle), em) <= room { fits = middle } else { wide = middle }
    }
    cut(fits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_measured_and_cut_to_its_room() {
        register().unwrap();
        let full = width("Phasing residual", 20.0);
        // A sans-serif letter is about half an em wide.
        assert!((80.0..240.0).contains(&full), "{full}");
        let short = fitted("Phasing residual", 20.0, full / 2.0);
        assert!(short.starts_with("Ph") && short.ends_with('…'), "{short}");
        assert!(width(&short, 20.0) <= full / 2.0);
        assert_eq!(fitted("Phasing", 20.0, 1e4), "Phasing");
    }

    #[test]
    fn a_superscript_minus_is_a_small_raised_minus() {
        assert_eq!(runs("10⁻³"), [("10", 1.0, 0.0), ("−", 0.62, 0.36), ("³", 1.0, 0.0)]);
        assert_eq!(runs(""), [("", 1.0, 0.0)]);
    }
}

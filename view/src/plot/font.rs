//! The one typeface of the pictures (Ubuntu Light, embedded: no system font is needed) and its
//! measures.

use super::colour::Rgb;
use ab_glyph::{Font, FontRef, Glyph, GlyphId, PxScale, ScaleFont, point};
use epaint_default_fonts::UBUNTU_LIGHT;
use std::sync::LazyLock;

/// What an SVG asks for: its viewer takes the first family that it has.
pub(super) const FAMILY: &str = "Ubuntu, Helvetica, Arial, sans-serif";

/// An SVG's text is set this much smaller, because the families that stand in for Ubuntu Light run
/// wider than it, by which the layout is measured (Arial by 5 %, DejaVu Sans by 13 %).
pub(super) const SVG_EM: f64 = 0.92;
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

/// The typeface; `None` only if the embedded bytes were damaged, in which case the pictures have no
/// text.
static FACE: LazyLock<Option<FontRef<'static>>> = LazyLock::new(|| FontRef::try_from_slice(UBUNTU_LIGHT).ok());

/// Width of `text` at `em`, logical pixels.
pub(super) fn width(text: &str, em: f64) -> f64 {
    runs(text).iter().map(|(run, size, _)| set(run, size * em, |_, _| ())).sum()
}

/// Places the glyphs of `run` along a baseline that starts at 0: `place(glyph, x)`. Returns the
/// width.
fn set(run: &str, em: f64, mut place: impl FnMut(GlyphId, f64)) -> f64 {
    let Some(face) = FACE.as_ref() else { return 0.0 };
    let scaled = face.as_scaled(scale(face, em));
    let (mut x, mut before) = (0.0, None);
    for glyph in run.chars().map(|c| face.glyph_id(c)) {
        x += before.map_or(0.0, |before| f64::from(scaled.kern(before, glyph)));
        place(glyph, x);
        x += f64::from(scaled.h_advance(glyph));
        before = Some(glyph);
    }
    x
}

fn scale(face: &FontRef, em: f64) -> PxScale {
    // ab_glyph counts the line, ascender to descender, where typography counts the em.
    let line_per_em = face.height_unscaled() / face.units_per_em().unwrap_or(1000.0);
    PxScale::from(em as f32 * line_per_em)
}

/// Rasterises `text` at `em` pixels, its baseline from (0, 0) along +x: `paint(x, y, coverage)`, y
/// down.
///
/// plotters' own text leaves out each glyph's left bearing and rounds its advance, which shows as
/// uneven spacing.
pub(super) fn rasterise(text: &str, em: f64, mut paint: impl FnMut(i32, i32, f64)) {
    let Some(face) = FACE.as_ref() else { return };
    let mut start = 0.0;
    for (run, size, rise) in runs(text) {
        let (scale, y) = (scale(face, size * em), -(rise * em) as f32);
        start += set(run, size * em, |id, x| {
            let glyph = Glyph { id, scale, position: point((start + x) as f32, y) };
            let Some(outline) = face.outline_glyph(glyph) else { return };
            let corner = outline.px_bounds().min;
            outline.draw(|u, v, coverage| {
                paint(corner.x as i32 + u as i32, corner.y as i32 + v as i32, f64::from(coverage));
            });
        });
    }
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

/// `text` in lines no wider than `room`, broken between words.
pub(super) fn lines(text: &str, em: f64, room: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if width(&format!("{line} {word}"), em) <= room => *line += &format!(" {word}"),
            _ => lines.push(word.to_string()),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_measured_and_cut_to_its_room() {
        let full = width("Phasing residual", 20.0);
        // A sans-serif letter is about half an em wide.
        assert!((80.0..240.0).contains(&full), "{full}");
        let short = fitted("Phasing residual", 20.0, full / 2.0);
        assert!(short.starts_with("Ph") && short.ends_with('…'), "{short}");
        assert!(width(&short, 20.0) <= full / 2.0);
        assert_eq!(fitted("Phasing", 20.0, 1e4), "Phasing");
    }

    #[test]
    fn sentences_are_broken_between_words() {
        let (text, room) = ("one two three four five six seven", 100.0);
        let broken = lines(text, 20.0, room);
        assert!(broken.len() > 1 && broken.iter().all(|line| width(line, 20.0) <= room), "{broken:?}");
        assert_eq!(broken.join(" "), text);
        assert_eq!(lines("Phasing", 20.0, 1.0), ["Phasing"]);
    }

    #[test]
    fn glyphs_stand_on_the_baseline_within_the_measured_width() {
        let (mut top, mut bottom, mut left, mut right) = (0, i32::MIN, i32::MAX, 0);
        rasterise("HIH", 100.0, |x, y, coverage| {
            if coverage > 0.5 {
                (top, bottom, left, right) = (top.min(y), bottom.max(y), left.min(x), right.max(x));
            }
        });
        // A capital is 69.3 pixels high at 100 pixels an em and stands on y = 0.
        assert!((-70..=-68).contains(&top) && bottom == -1, "{top} {bottom}");
        // H has the same bearing on both sides: the text is centred in its width.
        let margin = width("HIH", 100.0) - f64::from(right + 1);
        assert!(left > 2 && (f64::from(left) - margin).abs() < 2.0, "{left} {margin}");
    }

    #[test]
    fn a_superscript_minus_is_a_small_raised_minus() {
        assert_eq!(runs("10⁻³"), [("10", 1.0, 0.0), ("−", 0.62, 0.36), ("³", 1.0, 0.0)]);
        assert_eq!(runs(""), [("", 1.0, 0.0)]);
    }
}

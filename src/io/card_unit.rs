//! Units of the numbers in cards: in the value (`2.17 um`), else in the comment (`[nm]`,
//! `exposure in microseconds`, `[ADU/e-]`).

/// Units of a quantity: names in lower case, factor to the unit of the quantity, plausible values
/// in the named unit.
pub(super) type Units = &'static [(&'static [&'static str], f64, [f64; 2])];

/// From 100 nm to 100 µm, as a scene accepts.
pub(super) const WAVELENGTHS: Units = &[
    (&["nm", "nanometer", "nanometers", "nanometre", "nanometres"], 1.0, [100.0, 1e5]),
    (&["um", "micron", "microns", "micrometer", "micrometers", "micrometre", "micrometres", "mum"], 1e3, [0.1, 100.0]),
    (&["angstrom", "angstroms", "ang", "a", "aa"], 0.1, [1e3, 1e6]),
    (&["m", "meter", "meters", "metre", "metres"], 1e9, [1e-7, 1e-4]),
];
/// From 0.01 mas to 60 arcsec.
pub(super) const PIXELS: Units = &[
    (&["mas", "milliarcsec", "milliarcsecond", "milliarcseconds"], 1.0, [0.1, 6e4]),
    (&["arcsec", "arcseconds", "arcsecond", "asec", "arcs"], 1e3, [1e-5, 60.0]),
    (&["deg", "degree", "degrees"], 3.6e6, [1e-9, 1e-3]),
];
pub(super) const SECONDS: Units = &[
    (&["s", "sec", "secs", "second", "seconds"], 1.0, [0.0, 1e7]),
    (&["ms", "msec", "millisec", "millisecond", "milliseconds"], 1e-3, [0.0, 1e9]),
    (&["us", "usec", "microsec", "microsecond", "microseconds"], 1e-6, [0.0, 1e12]),
    (&["ns", "nsec", "nanosecond", "nanoseconds"], 1e-9, [0.0, 1e15]),
    (&["min", "minute", "minutes"], 60.0, [0.0, 1e5]),
    (&["h", "hr", "hour", "hours"], 3600.0, [0.0, 1e4]),
];
pub(super) const ELECTRONS: Units =
    &[(&["e", "electron", "electrons", "photoelectron", "photoelectrons"], 1.0, [0.0, 1e12])];

/// Counts of a detector.
const COUNTS: &[&str] = &["adu", "adus", "dn", "dns", "count", "counts", "ct", "cts"];
/// Pixels, of which a scale may be the number in an angle.
const PIXEL: &[&str] = &["pix", "pixel", "pixels", "px"];
/// Units that are English words or names of something else where they stand free in a comment.
const AMBIGUOUS: &[&str] = &["min", "us", "ang", "deg", "aa", "arcs", "hr"];

/// What a text says of the unit of a number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stated {
    /// A unit: factor to the unit of the quantity.
    Factor(f64),
    /// The inverse, such as counts per electron: the value is this factor over the number.
    Inverse(f64),
    /// Counts, where electrons are asked for.
    Counts,
    /// No number of this quantity: the setting of a camera, decibels.
    Setting,
    /// A unit of another quantity, or one that is not known.
    Unknown,
}

/// Word of a text, or the line of a fraction.
#[derive(Debug, Clone, PartialEq)]
enum Token {
    Word(String),
    Over,
}

fn tokens(text: &str) -> Vec<Token> {
    let mut tokens = Vec::new();
    let mut word = String::new();
    for c in text.chars().chain([' ']) {
        if c.is_alphabetic() {
            word.extend(c.to_lowercase());
            continue;
        }
        match std::mem::take(&mut word).as_str() {
            "" => {}
            "per" => tokens.push(Token::Over),
            other => tokens.push(Token::Word(other.to_owned())),
        }
        if c == '/' {
            tokens.push(Token::Over);
        }
    }
    tokens
}

/// A comment without the words that belong to a number in it (`max 60 s`) or to a longer word
/// (`hour-long`), which are not the unit of the card.
fn without_quantities(comment: &str) -> String {
    let mut left = String::new();
    let mut is_after_number = false;
    for word in comment.split_inclusive(' ') {
        let bare = word.trim().trim_end_matches([',', ';', '.', ')']);
        let ends_in_digit = bare.ends_with(|c: char| c.is_ascii_digit());
        let is_number = ends_in_digit && bare.starts_with(|c: char| c.is_ascii_digit() || "+-.".contains(c));
        let is_compound = bare
            .split_once('-')
            .is_some_and(|(a, b)| [a, b].iter().all(|part| !part.is_empty() && part.chars().all(char::is_alphabetic)));
        // A number with its unit attached, as in `10ms`.
        let is_quantity = bare.starts_with(|c: char| c.is_ascii_digit()) && bare.ends_with(char::is_alphabetic);
        if !(is_after_number || is_compound || is_quantity) {
            left.push_str(word);
        }
        is_after_number = is_number;
    }
    left
}

/// Whether square brackets hold one word that is no unit of `units`, such as `[THz]`, or `text` is
/// such a word.
fn is_other_unit(text: &str, units: Units) -> bool {
    matches!(tokens(text).as_slice(), [Token::Word(word)] if factor(word, units).is_none() && !text.trim().contains(' '))
}

/// The factor of the unit `word`.
fn factor(word: &str, units: Units) -> Option<f64> {
    units.iter().find(|(names, ..)| names.contains(&word)).map(|(_, factor, _)| *factor)
}

/// The parts of a comment in brackets, where units stand by convention.
fn bracketed(comment: &str) -> Vec<&str> {
    comment.split(['[', '(']).skip(1).filter_map(|part| Some(&part[..part.find([']', ')'])?])).collect()
}

/// The unit of a number of `units`, by the text behind the number, else by the comment of its card.
pub(super) fn stated(value: &str, comment: &str, units: Units) -> Option<Stated> {
    let of_unit = |text: &str| named(&tokens(text), units, false);
    let in_brackets = || bracketed(comment).into_iter().find_map(of_unit);
    let square = comment.split_once('[').and_then(|(_, rest)| rest.split_once(']')).map(|(unit, _)| unit);
    let is_other = |text: &str| is_other_unit(text, units);
    let unknown = || (is_other(value) || square.is_some_and(is_other)).then_some(Stated::Unknown);
    of_unit(value)
        .or_else(in_brackets)
        .or_else(unknown)
        .or_else(|| in_words(comment, units))
        .or_else(|| named(&tokens(&without_quantities(comment)), units, true))
}

/// The unit that a comment names as `in seconds`, where also words count that may mean something
/// else.
fn in_words(comment: &str, units: Units) -> Option<Stated> {
    let tokens = tokens(&without_quantities(comment));
    let after_in = tokens.windows(2).find_map(|pair| match pair {
        [Token::Word(first), Token::Word(unit)] if first == "in" => factor(unit, units),
        _ => None,
    });
    let is_fraction = tokens.contains(&Token::Over);
    after_in.filter(|_| !is_fraction).map(Stated::Factor)
}

/// The unit that `tokens` name. In free text, words of one letter and [`AMBIGUOUS`] ones count in a
/// fraction only.
fn named(tokens: &[Token], units: Units, is_free: bool) -> Option<Stated> {
    let is_electrons = units == ELECTRONS;
    let below: &[&str] = if is_electrons { COUNTS } else { PIXEL };
    for window in tokens.windows(3) {
        if let [Token::Word(over), Token::Over, Token::Word(under)] = window {
            if let (Some(factor), true) = (factor(under, units), below.contains(&over.as_str())) {
                return Some(Stated::Inverse(factor));
            }
            if let (Some(factor), true) = (factor(over, units), below.contains(&under.as_str())) {
                return Some(Stated::Factor(factor));
            }
            // Such as µV for an electron, which is the response of an amplifier.
            if is_electrons && factor(under, units).is_some() {
                return Some(Stated::Unknown);
            }
        }
    }
    let words =
        || tokens.iter().filter_map(|token| if let Token::Word(word) = token { Some(word.as_str()) } else { None });
    if is_electrons && words().any(|word| ["setting", "db", "iso", "sensor"].contains(&word)) {
        return Some(Stated::Setting);
    }
    let is_unit = |word: &&str| !(is_free && (word.chars().count() == 1 || AMBIGUOUS.contains(word)));
    let found = words().filter(is_unit).find_map(|word| factor(word, units));
    let in_counts = || is_electrons && words().any(|word| COUNTS.contains(&word));
    found.map(Stated::Factor).or_else(|| in_counts().then_some(Stated::Counts))
}

/// Factors of all units that make the number `value` plausible.
pub(super) fn plausible(value: f64, units: Units) -> impl Iterator<Item = f64> {
    let is_plausible = move |unit: &&(_, f64, [f64; 2])| (unit.2[0]..=unit.2[1]).contains(&value);
    units.iter().filter(is_plausible).map(|(_, factor, _)| *factor)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_read_in_values_and_comments() {
        use Stated::{Counts, Factor, Inverse, Setting, Unknown};
        for (value, comment, units, expected) in [
            (" um", "", WAVELENGTHS, Some(Factor(1e3))),
            ("", "[A] central", WAVELENGTHS, Some(Factor(0.1))),
            ("", "a wavelength", WAVELENGTHS, None),
            ("", "[ms]", SECONDS, Some(Factor(1e-3))),
            ("", "(us)", SECONDS, Some(Factor(1e-6))),
            ("", "exposure in microseconds", SECONDS, Some(Factor(1e-6))),
            ("", "integration time (ms)", SECONDS, Some(Factor(1e-3))),
            ("", "True integration time (s)", SECONDS, Some(Factor(1.0))),
            ("", "min exposure", SECONDS, None),
            ("", "[min]", SECONDS, Some(Factor(60.0))),
            ("", "Integration time per coadd", SECONDS, None),
            ("", "[ADU/e-] conversion factor", ELECTRONS, Some(Inverse(1.0))),
            ("", "counts per electron", ELECTRONS, Some(Inverse(1.0))),
            ("", "gain, e-/ADU", ELECTRONS, Some(Factor(1.0))),
            (" e-/DN", "", ELECTRONS, Some(Factor(1.0))),
            ("", "gain setting", ELECTRONS, Some(Setting)),
            ("", "[dB]", ELECTRONS, Some(Setting)),
            ("", "Sensor gain", ELECTRONS, Some(Setting)),
            ("", "read noise [ADU]", ELECTRONS, Some(Counts)),
            ("", "read noise, electrons", ELECTRONS, Some(Factor(1.0))),
            (" mas/pix", "", PIXELS, Some(Factor(1.0))),
            ("", "[pix/arcsec]", PIXELS, Some(Inverse(1e3))),
            ("", "Exposure time, max 60 s, min 0.1 ms", SECONDS, None),
            ("", "one of an hour-long series", SECONDS, None),
            ("", "shutter 1/100 s", SECONDS, None),
            ("", "Exposure time in min", SECONDS, Some(Factor(60.0))),
            ("", "[THz]", WAVELENGTHS, Some(Unknown)),
            (" µas", "", PIXELS, Some(Unknown)),
            ("", "[uV/e-]", ELECTRONS, Some(Unknown)),
            ("", "gain [ADU/electron]", ELECTRONS, Some(Inverse(1.0))),
            ("", "pixel on the sky, mas", PIXELS, Some(Factor(1.0))),
        ] {
            assert_eq!(stated(value, comment, units), expected, "{value:?} / {comment:?}");
        }
    }
}

//! Class of a raw frame: what it shows, by its header.

/// What a raw frame shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameClass {
    /// The star.
    Star,
    /// Closed shutter.
    Dark,
    /// Evenly illuminated detector.
    Flat,
    /// As a flat, with the lamp off: what is subtracted from a flat.
    LampOff,
    /// Sky without the star.
    Sky,
    /// None of these, such as an arc lamp: set aside.
    Other,
}

impl FrameClass {
    /// Its name in the log.
    pub fn name(self) -> &'static str {
        match self {
            Self::Star => "star",
            Self::Dark => "dark",
            Self::Flat => "flat",
            Self::LampOff => "lamp-off",
            Self::Sky => "sky",
            Self::Other => "other",
        }
    }
}

/// Cards that say the class in one word, those of an archive before those of a camera.
const TYPES: [&str; 5] = ["KOAIMTYP", "IMAGETYP", "OBSTYPE", "IMTYPE", "OBSMODE"];
/// Cards of a shutter.
const SHUTTERS: [&str; 2] = ["SHRNAME", "SHUTTER"];

/// Class of the frame whose cards `card` gives as text, and the card that says so.
///
/// In this order: the first card of [`TYPES`] that names a dark, bias, flat, sky or lamp; a word of
/// `OBJECT` that does; a shutter that is closed; else it is the star. (NIRC2 writes
/// `IMAGETYP = 'DATA'` into every frame, so that card alone is no proof of a star.)
pub(super) fn classify(card: impl Fn(&str) -> Option<String>) -> (FrameClass, String) {
    let stated = |key: &str| Some((key.to_owned(), card(key)?.trim().to_lowercase()));
    for (key, text) in TYPES.iter().filter_map(|key| stated(key)) {
        if let Some(class) = class_of(&text, true) {
            return (class, format!("{key} = {text}"));
        }
    }
    if let Some((key, text)) = stated("OBJECT")
        && let Some(class) = class_of(&text, false)
    {
        return (class, format!("{key} = {text}"));
    }
    let is_closed = |text: &str| ["closed", "close", "shut"].contains(&text);
    match SHUTTERS.iter().filter_map(|key| stated(key)).find(|(_, text)| is_closed(text)) {
        Some((key, text)) => (FrameClass::Dark, format!("{key} = {text}")),
        None => (FrameClass::Star, String::from("no card says otherwise")),
    }
}

/// Class that a text in lower case names. An object's name counts by whole words, so that `Skylab`
/// and `Darkstar` are stars.
fn class_of(text: &str, is_type: bool) -> Option<FrameClass> {
    let words: Vec<&str> = text.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).collect();
    let names = |known: &[&str]| {
        if is_type {
            known.iter().any(|word| text.contains(word))
        } else {
            words.iter().any(|word| known.contains(&word.trim_end_matches('s')))
        }
    };
    if names(&["dark", "bia"]) {
        Some(FrameClass::Dark)
    } else if names(&["flat", "domeflat", "flatlamp", "skyflat", "twiflat", "twilight", "flatlampoff"]) {
        // Also as `lamp off`; a twilight flat has no lamp.
        Some(if text.contains("off") { FrameClass::LampOff } else { FrameClass::Flat })
    } else if names(&["sky"]) {
        Some(FrameClass::Sky)
    } else if is_type && names(&["arc", "lamp", "focus", "undefined"]) {
        Some(FrameClass::Other)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn class_comes_from_the_first_card_that_names_one() {
        let class = |cards: &[(&str, &str)]| {
            classify(|key| cards.iter().find(|(known, _)| *known == key).map(|(_, text)| (*text).to_owned())).0
        };
        for (cards, expected) in [
            (&[("IMAGETYP", "DATA"), ("OBJECT", "TEST"), ("SHRNAME", "OPEN")][..], FrameClass::Star),
            (&[("IMAGETYP", "DATA"), ("SHRNAME", "CLOSED")], FrameClass::Dark),
            (&[("IMAGETYP", "DATA"), ("OBJECT", "dark 0.5 s")], FrameClass::Dark),
            (&[("OBJECT", "Darkstar 7")], FrameClass::Star),
            (&[("OBJECT", "Dome flats Kp")], FrameClass::Flat),
            (&[("KOAIMTYP", "flatlampoff"), ("IMAGETYP", "flat")], FrameClass::LampOff),
            (&[("KOAIMTYP", "object"), ("OBJECT", "HD 1 sky")], FrameClass::Sky),
            (&[("IMAGETYP", "Bias Frame")], FrameClass::Dark),
            (&[("OBSTYPE", "arclamp")], FrameClass::Other),
            (&[], FrameClass::Star),
        ] {
            assert_eq!(class(cards), expected, "{cards:?}");
        }
    }
}

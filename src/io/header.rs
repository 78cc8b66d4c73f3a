//! Facts of the instrument in the header of an image file: unit, gain, read noise, wavelength,
//! filter, pixel scale, exposure.
//!
//! Observatories name the same quantity by different keywords and write it in different units. A
//! unit is taken from the value or from the comment of a card (`2.17 um`, `[nm]`,
//! `pixel on the sky, mas`); where neither has one, the value is read in every unit that makes it
//! plausible.

use super::band::Band;
use super::card_unit::{self, ELECTRONS, PIXELS, SECONDS, Stated, Units, WAVELENGTHS};
use super::read::FitsReader;
use super::value::Card;
use crate::Result;

/// Quantity that a card states.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Electrons per count.
    GainEPerAdu,
    /// Read noise of a pixel, electrons RMS.
    ReadNoiseE,
    /// Wavelength, nm.
    WavelengthNm,
    /// Wavelength of the photometric band that a filter's name states, nm. The tolerance is the
    /// width of the band.
    BandNm,
    /// Pixel on the sky, mas.
    PixelMas,
    /// Exposure, s.
    ExposureS,
    /// Background of a pixel, electrons.
    BackgroundE,
}

/// Fact that a card states.
#[derive(Debug, Clone, PartialEq)]
pub struct HeaderFact {
    /// What it is.
    pub quantity: Quantity,
    /// Keyword of the card.
    pub keyword: &'static str,
    /// Value as the card has it.
    pub written: String,
    /// The value in the unit of the quantity, once for each unit that the card may be in.
    pub values: Vec<f64>,
    /// Relative uncertainty of the value: one unit of its last digit, or half the width of a band.
    pub tolerance: f64,
}

impl HeaderFact {
    /// Whether one of the values that the card may mean is `value`, to the last digit of the card.
    pub fn agrees(&self, value: f64) -> bool {
        self.values.iter().any(|stated| (stated - value).abs() <= self.tolerance * stated.abs().max(value.abs()))
    }
}

/// Card of reduced images with the read noise of one coadd, electrons RMS, from which `RON_E` was
/// derived with the other noise.
pub const READ_NOISE_OF_A_COADD: &str = "RON_READ";

/// Unit of the pixels of an image file.
#[derive(Debug, Clone, Default, PartialEq)]
pub enum PixelUnit {
    /// Electrons, or photons that were detected.
    Electrons,
    /// Counts (ADU, DN): electrons over the gain.
    Counts,
    /// The file does not say.
    #[default]
    Unstated,
    /// Another unit, as written.
    Other(String),
}

/// Keywords of each quantity, those that are preferred first, their units, and whether the first
/// unit is that of a bare number.
const KEYWORDS: [(Quantity, &[&str], Units, bool); 6] = [
    (Quantity::GainEPerAdu, &["EGAIN", "GAIN", "ESO DET OUT1 CONAD"], ELECTRONS, true),
    (
        Quantity::ReadNoiseE,
        &["RON_E", "RON", "RDNOISE", "READNOIS", "ENOISE", "ESO DET OUT1 RON", READ_NOISE_OF_A_COADD],
        ELECTRONS,
        true,
    ),
    (
        Quantity::WavelengthNm,
        &["WAVELEN", "WAVELENG", "WAVELNTH", "WAVELTH", "CENWAVE", "CENTWAVE", "EFFWAVE", "LAMBDA"],
        WAVELENGTHS,
        false,
    ),
    (Quantity::PixelMas, &["PIXSCALE", "PIXSCAL", "PIXSCAL1", "PIXELSCL", "SECPIX", "SECPIX1"], PIXELS, false),
    (
        Quantity::ExposureS,
        &["EXPTIME", "EXPOSURE", "TRUITIME", "ITIME", "TEXP", "ESO DET DIT", "ESO DET SEQ1 DIT"],
        SECONDS,
        true,
    ),
    (Quantity::BackgroundE, &["BACKGR_E"], ELECTRONS, true),
];

/// Keywords of the name of a filter; several where the camera has several wheels.
const FILTERS: [&str; 11] = [
    "FILTER", "FILTNAME", "FILTNAM", "FILTER1", "FILTER2", "FILTER3", "FILTER01", "FILTER02", "FILT1", "FWINAME",
    "FWONAME",
];

/// Smallest relative uncertainty of a value: that of six digits, and of a single-precision number.
const LEAST_TOLERANCE: f64 = 1e-6;
/// Relative uncertainty of a pixel scale from the world coordinates of a file, which describe the
/// sky and not the optics.
const COORDINATES_TOLERANCE: f64 = 0.02;

/// Keywords of the integration time of one coadd, the true one of OSIRIS first: its `ITIME` is in
/// ms.
pub const COADD_TIMES: [&str; 4] = ["TRUITIME", "ITIME", "ESO DET DIT", "ESO DET SEQ1 DIT"];
/// Keyword of the number of integrations that an infrared camera of ESO averages.
pub const AVERAGED_COADDS: &str = "ESO DET NDIT";

/// What the cards of an image state.
#[derive(Debug, Default)]
pub(super) struct Facts {
    /// For each quantity all its cards, in the order of preference.
    pub facts: Vec<HeaderFact>,
    /// Cards that state a quantity in a form that is not read, where no other card states it: a
    /// sentence each.
    pub unread: Vec<String>,
}

/// Facts in the HDU at `index`, else in the primary HDU.
pub(super) fn facts(file: &mut FitsReader, index: usize) -> Result<Facts> {
    let mut found = Facts::default();
    for (quantity, keywords, units, is_bare) in KEYWORDS {
        let (before, mut unread) = (found.facts.len(), Vec::new());
        for keyword in keywords {
            let Some((card, written, comment)) = card(file, index, keyword)? else { continue };
            let gain = found.facts.iter().find(|fact| fact.quantity == Quantity::GainEPerAdu);
            let gain = gain.and_then(|fact| fact.values.first().copied());
            match fact(quantity, keyword, &card, (&written, &comment), (units, is_bare, gain)) {
                Ok(fact) => found.facts.push(fact),
                Err(why) => unread.push(format!("The card {keyword} = {card} was not used: {why}.")),
            }
        }
        if found.facts.len() == before {
            found.unread.extend(unread);
        }
    }
    // The integration time is that of one coadd, of which an image is the sum.
    if let Some(coadds) =
        card(file, index, "COADDS")?.and_then(|(card, ..)| card.number()).filter(|coadds| *coadds > 1.0)
    {
        for fact in found.facts.iter_mut().filter(|fact| COADD_TIMES.contains(&fact.keyword)) {
            fact.values.extend(fact.values.first().map(|seconds| seconds * coadds));
        }
    }
    for keyword in FILTERS {
        if let Some((Card::Text(name), ..)) = card(file, index, keyword)? {
            found.facts.extend(band_fact(keyword, name.trim()));
        }
    }
    if !found.facts.iter().any(|fact| fact.quantity == Quantity::PixelMas) {
        found.facts.extend(coordinates(file, index)?);
    }
    Ok(found)
}

/// Unit of the pixels: card `BUNIT` of the HDU at `index`, else that of a primary HDU without an
/// array that it could describe.
pub(super) fn unit(file: &mut FitsReader, index: usize) -> Result<PixelUnit> {
    let own = file.card_at(index, "BUNIT")?;
    let inherited = if own.is_none() && file.is_inherited_by(index) { file.card_at(0, "BUNIT")? } else { None };
    Ok(own.or(inherited).map_or(PixelUnit::Unstated, |card| pixel_unit(&plain(&card))))
}

/// A card of the HDU at `index`, else of the primary HDU, with its value as written and its
/// comment.
fn card(file: &mut FitsReader, index: usize, keyword: &str) -> Result<Option<(Card, String, String)>> {
    for hdu in [index, 0] {
        if let Some(card) = file.card_at(hdu, keyword)? {
            let (written, comment) = file.written_at(hdu, keyword);
            return Ok(Some((card, written, comment)));
        }
    }
    Ok(None)
}

/// Text of a card without quotes.
fn plain(card: &Card) -> String {
    card.text().map_or_else(|| card.to_string(), |text| text.trim().to_string())
}

/// The fact of a card, or why it is none. A number in counts is converted with the gain, where that
/// is known.
fn fact(
    quantity: Quantity,
    keyword: &'static str,
    card: &Card,
    (written, comment): (&str, &str),
    (units, is_bare, gain): (Units, bool, Option<f64>),
) -> std::result::Result<HeaderFact, String> {
    let text = match card {
        Card::Text(text) => text.trim(),
        Card::Integer(_) | Card::Real(_) => written,
        Card::Logical(_) => return Err("a number is accepted".into()),
    };
    let end = text.find(|c: char| !(c.is_ascii_digit() || "+-.eEdD".contains(c))).unwrap_or(text.len());
    // The `e` of a unit such as `e-/ADU` belongs to no number.
    let digits = text[..end].trim_end_matches(|c: char| !(c.is_ascii_digit() || c == '.'));
    let value: Option<f64> = digits.replace(['d', 'D'], "e").parse().ok().filter(|value: &f64| value.is_finite());
    let names: Vec<&str> = units.iter().map(|(names, ..)| names[0]).collect();
    let rest = text[digits.len()..].trim_start();
    if rest.starts_with(|c: char| c.is_ascii_digit() || ",:/".contains(c)) {
        return Err(format!("`{text}` is not one number with a decimal point"));
    }
    let value = value.ok_or_else(|| format!("a number, with a unit ({}) or without, is accepted", names.join(", ")))?;
    let values: Vec<f64> = match card_unit::stated(&text[digits.len()..], comment, units) {
        Some(Stated::Factor(factor)) => vec![value * factor],
        Some(Stated::Inverse(factor)) if value != 0.0 => vec![factor / value],
        Some(Stated::Inverse(_)) => return Err("the inverse of 0 is no number".into()),
        Some(Stated::Setting) => return Err(format!("its comment `{comment}` names a setting of the camera")),
        Some(Stated::Unknown) => return Err(format!("its unit is none of {}", names.join(", "))),
        // A gain in counts is the number of electrons in one, as its bare number is.
        Some(Stated::Counts) if quantity == Quantity::GainEPerAdu => vec![value],
        Some(Stated::Counts) => {
            vec![value * gain.ok_or("it is in counts, and no card GAIN or EGAIN gives the electrons per count")?]
        }
        None if is_bare => vec![value],
        None => card_unit::plausible(value, units).map(|factor| value * factor).collect(),
    };
    if values.is_empty() || values.iter().any(|value| *value < 0.0) {
        return Err(format!("in no unit ({}) is it a plausible value", names.join(", ")));
    }
    let tolerance = (last_digit(digits) / value.abs()).clamp(LEAST_TOLERANCE, 0.1);
    Ok(HeaderFact { quantity, keyword, written: text.to_string(), values, tolerance })
}

/// The band that the name of a filter states.
fn band_fact(keyword: &'static str, name: &str) -> Option<HeaderFact> {
    let Band { centre_nm, tolerance, .. } = Band::named(name)?;
    Some(HeaderFact { quantity: Quantity::BandNm, keyword, written: name.into(), values: vec![centre_nm], tolerance })
}

/// One unit of the last digit of a number.
fn last_digit(digits: &str) -> f64 {
    let (mantissa, exponent) = digits.split_once(['e', 'E', 'd', 'D']).unwrap_or((digits, "0"));
    let decimals = mantissa.split_once('.').map_or(0, |(_, decimals)| decimals.len() as i32);
    10f64.powi(exponent.parse().unwrap_or(0) - decimals)
}

/// Pixel scale of celestial coordinates: `CDELT1` (degrees), or the length of the first column of
/// the matrix `CD`, where `CTYPE1` names an axis of the sky. Files without coordinates have
/// CDELT1 = 1.
fn coordinates(file: &mut FitsReader, index: usize) -> Result<Option<HeaderFact>> {
    let is_sky = |card: Card| card.text().is_some_and(|text| ["RA--", "DEC-"].iter().any(|sky| text.starts_with(sky)));
    if !file.card_at(index, "CTYPE1")?.is_some_and(is_sky) {
        return Ok(None);
    }
    let mut number = |keyword| -> Result<Option<(f64, String)>> {
        Ok(card(file, index, keyword)?.and_then(|(card, written, _)| Some((card.number()?, written))))
    };
    // An entry of the matrix without a card is 0.
    let (keyword, degrees, written) = match (number("CD1_1")?, number("CD2_1")?) {
        (Some((along, written)), across) => ("CD1_1", along.hypot(across.map_or(0.0, |(across, _)| across)), written),
        (None, Some((across, written))) => ("CD2_1", across.abs(), written),
        (None, None) => {
            let Some((degrees, written)) = number("CDELT1")? else { return Ok(None) };
            ("CDELT1", degrees.abs(), written)
        }
    };
    let is_pixel = degrees > 0.0 && degrees < 1e-3;
    Ok(is_pixel.then(|| HeaderFact {
        quantity: Quantity::PixelMas,
        keyword,
        written,
        values: vec![degrees * 3.6e6],
        tolerance: COORDINATES_TOLERANCE,
    }))
}

/// The unit of pixels that `BUNIT` names.
fn pixel_unit(text: &str) -> PixelUnit {
    let word = text.trim().to_ascii_lowercase();
    match word.as_str() {
        "electron" | "electrons" | "e" | "e-" | "[e-]" | "photon" | "photons" | "photoelectron" | "photoelectrons"
        | "photo-electrons" => PixelUnit::Electrons,
        "adu" | "adus" | "dn" | "dns" | "count" | "counts" | "ct" | "cts" | "counts/pixel" | "adu/pixel" => {
            PixelUnit::Counts
        }
        "" | "none" | "unknown" | "n/a" => PixelUnit::Unstated,
        _ => PixelUnit::Other(text.trim().to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(quantity: Quantity, written: &str, comment: &str) -> Option<HeaderFact> {
        let (_, keywords, units, is_bare) = KEYWORDS.into_iter().find(|row| row.0 == quantity)?;
        let card = Card::parse(written).unwrap_or_else(|| written.into());
        fact(quantity, keywords[0], &card, (written, comment), (units, is_bare, None)).ok()
    }

    #[test]
    fn wavelengths_are_read_in_every_plausible_unit() {
        let nm = |written: &str, comment: &str| {
            let fact = read(Quantity::WavelengthNm, written, comment);
            fact.map(|fact| fact.values.iter().map(|nm| (nm * 1e3).round() / 1e3).collect::<Vec<_>>())
        };
        assert_eq!(nm("2168.6", "wavelength, nm"), Some(vec![2168.6]));
        assert_eq!(nm("2168.6", ""), Some(vec![2168.6, 216.86]));
        assert_eq!(nm("2.1686", "effective wavelength"), Some(vec![2168.6]));
        assert_eq!(nm("21686", "[Angstrom]"), Some(vec![2168.6]));
        assert_eq!(nm("2.1686E-06", ""), Some(vec![2168.6]));
        assert_eq!(nm("2.1686 um", ""), Some(vec![2168.6]));
        for odd in ["0", "-5", "H", "1e30"] {
            assert_eq!(nm(odd, ""), None, "{odd}");
        }
    }

    #[test]
    fn a_value_is_as_exact_as_its_last_digit() {
        let tolerance = |written: &str| read(Quantity::PixelMas, written, "mas").unwrap().tolerance;
        assert!((tolerance("9.95") - 0.01 / 9.95).abs() < 1e-12);
        assert!((tolerance("1.0E+01") - 0.1).abs() < 1e-12);
        assert_eq!(tolerance("9.9420000001"), 1e-6);
        let gain = read(Quantity::GainEPerAdu, "4.0 e-/ADU", "").unwrap();
        assert_eq!((gain.values, gain.written.as_str()), (vec![4.0], "4.0 e-/ADU"));
    }

    #[test]
    fn units_of_pixels_are_read_as_they_are_written() {
        for counts in ["adu", "ADU", "DN", "count", "Counts", " counts "] {
            assert_eq!(pixel_unit(counts), PixelUnit::Counts, "{counts}");
        }
        for electrons in ["electron", "Electrons", "e-", "photon", "PHOTONS"] {
            assert_eq!(pixel_unit(electrons), PixelUnit::Electrons, "{electrons}");
        }
        assert_eq!(pixel_unit(""), PixelUnit::Unstated);
        assert_eq!(pixel_unit("electron/s"), PixelUnit::Other("electron/s".into()));
    }

    #[test]
    fn numbers_that_go_on_behind_a_comma_or_colon_are_not_read() {
        for (quantity, written) in [
            (Quantity::GainEPerAdu, "'8,5'"),
            (Quantity::WavelengthNm, "'2,1686 um'"),
            (Quantity::ExposureS, "'00:00:10.0'"),
            (Quantity::ExposureS, "'1 1/2'"),
        ] {
            assert_eq!(read(quantity, written, ""), None, "{written}");
        }
        assert_eq!(read(Quantity::ExposureS, "'1.5 s'", "").map(|fact| fact.values), Some(vec![1.5]));
    }
}

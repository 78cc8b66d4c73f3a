//! Raw frame: pixels, exposure, and what its header states.

use super::classify::{FrameClass, classify};
use super::files::Pattern;
use crate::io::{self, Card, FitsReader, HeaderFact, PixelUnit, Quantity};
use crate::{Error, Result};
use ndarray::{Array2, Axis};
use std::path::Path;

/// Rule that puts frames into a channel.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelRule {
    /// Name of the channel.
    pub channel: String,
    /// Card whose text or number must fit; `None` for the name of the file.
    pub card: Option<String>,
    /// What it must fit.
    pub pattern: Pattern,
}

/// What the header of a frame states.
#[derive(Debug, Clone)]
pub struct FrameHeader {
    /// Integration time of one coadd, s.
    pub itime_s: Option<f64>,
    /// Coadded exposures.
    pub coadds: u32,
    /// Whether the header says that their counts are averaged, where others are summed.
    pub has_averaged_coadds: bool,
    /// Read mode, as `SAMPMODE/MULTISAM`; empty where no card says it.
    pub read_mode: String,
    /// Name of the filter.
    pub filter: Option<String>,
    /// Level of saturation, counts of one coadd.
    pub saturation_adu: Option<f64>,
    /// Unit of the pixels.
    pub unit: PixelUnit,
    /// What other cards state of the instrument.
    pub facts: Vec<HeaderFact>,
    /// Angle in the card that the caller names for the turn of the pupil, degrees.
    pub pupil_angle_deg: Option<f64>,
    /// Cards that may have the angle of the pupil on the detector, with their numbers, degrees.
    pub angles_deg: Vec<(&'static str, f64)>,
}

/// Cards with which the pupil may turn on the detector: parallactic angle, and rotators.
const ANGLES: [&str; 6] = ["PARANG", "PARANTEL", "ROTPOSN", "ROTPPOSN", "ROTANGLE", "ESO TEL PARANG START"];

/// Raw frame of a detector.
#[derive(Debug, Clone)]
pub struct RawFrame {
    /// Name in the log: that of the file, with the number of the plane in a cube.
    pub name: String,
    /// What it shows.
    pub class: FrameClass,
    /// What says so.
    pub classified_by: String,
    /// Whether that is a list of the user, which is not doubted.
    pub is_listed: bool,
    /// Channel that a rule or the card `CHANNEL` puts it into.
    pub channel: Option<String>,
    /// Counts, or electrons, `[y, x]`.
    pub data: Array2<f64>,
    /// Pixels that are not finite or that the file marks, `[y, x]`.
    pub bad: Array2<bool>,
    /// Header.
    pub header: FrameHeader,
    /// What a user should know of its file: repairs, images that were not read.
    pub notes: Vec<String>,
    /// The same, where it puts nothing in doubt: amplifiers that were put together, cards that are
    /// not read.
    pub remarks: Vec<String>,
}

impl RawFrame {
    /// Reads `path`: one frame, or those of a cube. `class` is theirs, whatever the header says;
    /// `None` for the header's. The card `turn_card` has the angle of the pupil.
    ///
    /// # Errors
    /// Those of [`io::read_images`]; [`Error::File`] for a file that a reduction wrote.
    pub fn read(
        path: &Path,
        class: Option<FrameClass>,
        rules: &[ChannelRule],
        turn_card: Option<&str>,
    ) -> Result<Vec<Self>> {
        let mut file = FitsReader::open(path)?;
        if file.has("REDUCTION") {
            return Err(Error::file(path, "was written by a reduction: raw frames are needed"));
        }
        let images = io::read_images(path, None)?;
        let mut cards = Cards { file: &mut file, hdu: images.hdu_name.clone() };
        let is_listed = class.is_some();
        let (class, classified_by) = match class {
            Some(class) => (class, String::from("named on the command line")),
            None => cards.class(),
        };
        let header = cards.header(images.unit, images.facts, turn_card);
        let file_name = file_name(path);
        let is_of = |rule: &&ChannelRule, cards: &mut Cards| match &rule.card {
            None => rule.pattern.matches(&file_name),
            Some(key) => cards.fits(key, &rule.pattern),
        };
        let ruled = rules.iter().find(|rule| is_of(rule, &mut cards)).map(|rule| rule.channel.clone());
        // With rules, a frame that fits none is in no channel.
        let channel = ruled.or_else(|| images.channel.filter(|_| rules.is_empty()));
        let planes = images.data.len_of(Axis(0));
        let notes: Vec<String> = images.repaired.into_iter().chain(images.notes).collect();
        let each = images.data.outer_iter().zip(images.bad.outer_iter()).enumerate().map(|(plane, (data, bad))| Self {
            name: if planes == 1 { file_name.clone() } else { format!("{file_name}#{}", plane + 1) },
            class,
            classified_by: classified_by.clone(),
            is_listed,
            channel: channel.clone(),
            data: data.to_owned(),
            bad: bad.to_owned(),
            header: header.clone(),
            notes: notes.clone(),
            remarks: images.remarks.clone(),
        });
        Ok(each.collect())
    }

    /// This frame of a camera that averages its coadds, as one of a camera that sums them.
    pub(super) fn with_summed_coadds(&self) -> Self {
        Self { data: &self.data * self.coadds(), ..self.clone() }
    }

    /// Number of coadds.
    pub(super) fn coadds(&self) -> f64 {
        f64::from(self.header.coadds)
    }
}

impl FrameHeader {
    /// Whether `other` has the same integration time and read mode, so that its dark signal per
    /// coadd is the same.
    pub(super) fn has_exposure_of(&self, other: &Self) -> bool {
        let same_time = match (self.itime_s, other.itime_s) {
            // Cameras round to milliseconds.
            (Some(a), Some(b)) => (a - b).abs() <= 1e-3 * a.max(b).max(1e-3),
            (None, None) => true,
            _ => false,
        };
        let (a, b) = (&self.read_mode, &other.read_mode);
        same_time && (a == b || a.is_empty() || b.is_empty())
    }

    /// The exposure in words.
    pub(super) fn exposure(&self) -> String {
        let time = self.itime_s.map_or("of unknown exposure".into(), |itime_s| format!("of {itime_s} s"));
        if self.read_mode.is_empty() { time } else { format!("{time} in read mode {}", self.read_mode) }
    }
}

/// Name of a file without its folder.
pub(super) fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into())
}

/// Cards of the HDU of the images, else of the primary HDU.
pub(super) struct Cards<'a> {
    pub(super) file: &'a mut FitsReader,
    /// Name of the HDU of the images.
    pub(super) hdu: String,
}

impl Cards<'_> {
    fn card(&mut self, key: &str) -> Option<Card> {
        let own = self.file.card(Some(&self.hdu), key).ok().flatten();
        own.or_else(|| self.file.card(None, key).ok().flatten())
    }

    /// Comment of a card; empty without.
    fn comment(&mut self, key: &str) -> String {
        let own = self.file.comment(Some(&self.hdu), key).ok().filter(|comment| !comment.is_empty());
        own.or_else(|| self.file.comment(None, key).ok()).unwrap_or_default()
    }

    /// Text of a card without quotes.
    pub(super) fn text(&mut self, key: &str) -> Option<String> {
        let card = self.card(key)?;
        Some(card.text().map_or_else(|| card.to_string(), |text| text.trim().to_owned()))
    }

    /// Number of a card, also where it is written as a text.
    pub(super) fn number(&mut self, key: &str) -> Option<f64> {
        let card = self.card(key)?;
        card.number().or_else(|| card.text()?.trim().parse().ok()).filter(|number: &f64| number.is_finite())
    }

    /// Angle in a card: degrees, or radians by its comment; also as a text with its unit (`40.0
    /// deg`, `0.698 rad`) or of degrees, minutes and seconds (`39:30:00`).
    fn angle_deg(&mut self, key: &str) -> Option<f64> {
        if let Some(number) = self.number(key) {
            let comment = self.comment(key).to_ascii_lowercase();
            let mut words = comment.split(|c: char| !c.is_ascii_alphabetic());
            let is_radians = words.any(|word| ["rad", "radian", "radians"].contains(&word));
            return Some(if is_radians { number.to_degrees() } else { number });
        }
        let text = self.text(key)?;
        let plain = |text: &str| text.trim().parse::<f64>().ok().filter(|number| number.is_finite());
        if let [degrees, minutes, seconds] = text.split(':').collect::<Vec<_>>()[..] {
            let sign = if degrees.trim().starts_with('-') { -1.0 } else { 1.0 };
            return Some(plain(degrees)? + sign * (plain(minutes)? / 60.0 + plain(seconds)? / 3600.0));
        }
        let (number, unit) =
            text.trim().split_at(text.trim().find(|c: char| c.is_alphabetic() && c != 'e' && c != 'E')?);
        match unit.to_ascii_lowercase().as_str() {
            "deg" | "degree" | "degrees" | "d" => plain(number),
            "rad" | "radian" | "radians" => plain(number).map(f64::to_degrees),
            _ => None,
        }
    }

    fn class(&mut self) -> (FrameClass, String) {
        let cards = std::cell::RefCell::new(self);
        classify(|key| cards.borrow_mut().text(key))
    }

    /// Whether a card fits a pattern, or has its number to a part in a thousand.
    fn fits(&mut self, key: &str, pattern: &Pattern) -> bool {
        if let (Some(wanted), Some(own)) = (pattern.number(), self.number(key)) {
            return (wanted - own).abs() <= 1e-3 * wanted.abs().max(own.abs());
        }
        self.text(key).is_some_and(|text| pattern.matches(&text))
    }

    pub(super) fn header(&mut self, unit: PixelUnit, facts: Vec<HeaderFact>, turn_card: Option<&str>) -> FrameHeader {
        let mut count = |key: &str| self.number(key).filter(|coadds| (1.0..=1e6).contains(coadds));
        let summed = count("COADDS");
        let averaged = if summed.is_none() { count(io::AVERAGED_COADDS) } else { None };
        let coadds = summed.or(averaged).map_or(1, |coadds| coadds as u32);
        let exposure = |keyword: &str| {
            let fact = facts.iter().find(|fact| fact.quantity == Quantity::ExposureS && fact.keyword == keyword);
            fact.and_then(|fact| fact.values.first().copied())
        };
        // ITIME is the time of one coadd (NIRC2, OSIRIS); the others are that of the whole frame.
        let whole = ["EXPTIME", "EXPOSURE", "TEXP"].iter().find_map(|keyword| exposure(keyword));
        let of_coadd = io::COADD_TIMES.iter().find_map(|keyword| exposure(keyword));
        // The exposure of an average is that of one coadd.
        let in_whole = if averaged.is_some() { 1.0 } else { f64::from(coadds) };
        let itime_s = of_coadd.or_else(|| Some(whole? / in_whole));
        let read_mode =
            [self.text("SAMPMODE"), self.text("MULTISAM")].into_iter().flatten().collect::<Vec<_>>().join("/");
        let filter = ["FILTER", "FILTNAME", "FILTNAM", "FILTER1"].iter().find_map(|key| self.text(key));
        let saturation_adu = ["SATURATE", "SATURATN", "SATLEVEL", "SATUR"].iter().find_map(|key| self.number(key));
        let saturation_adu = saturation_adu.filter(|counts| *counts > 0.0);
        let pupil_angle_deg = turn_card.and_then(|card| self.angle_deg(card));
        let angles_deg = ANGLES.into_iter().filter_map(|card| Some((card, self.angle_deg(card)?))).collect();
        FrameHeader {
            itime_s,
            coadds,
            has_averaged_coadds: averaged.is_some(),
            read_mode,
            filter,
            saturation_adu,
            unit,
            facts,
            pupil_angle_deg,
            angles_deg,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::io::{FitsWriter, Pixel};

    #[test]
    fn angles_are_in_the_unit_that_is_stated() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("frame.fits");
        let mut file = FitsWriter::create(&path).unwrap();
        file.image("SCI", &Array2::<f64>::zeros((4, 4)), Pixel::F64, "").unwrap();
        for (key, value, comment) in [
            ("PARANG", Card::Real(0.5), "[rad] parallactic angle"),
            ("ROTPOSN", Card::Real(0.5), "position of the rotator"),
            ("ROTANGLE", "0.5 rad".into(), ""),
            ("PARANTEL", "-0:30:00".into(), ""),
        ] {
            file.card("SCI", key, value, comment).unwrap();
        }
        file.finish().unwrap();
        let mut cards = Cards { file: &mut FitsReader::open(&path).unwrap(), hdu: "SCI".into() };
        let angles_deg = ["PARANG", "ROTPOSN", "ROTANGLE", "PARANTEL", "ANGLE"].map(|key| cards.angle_deg(key));
        let rad = 0.5_f64.to_degrees();
        assert_eq!(angles_deg, [Some(rad), Some(0.5), Some(rad), Some(-0.5), None]);
    }
}

//! Calibration of a frame: dark, flat, bad pixels, gain.

use super::frame::RawFrame;
use super::log::LogRow;
use super::masters::{self, Dark, Flat};
use crate::io::{HeaderFact, PixelUnit, Quantity};
use crate::scene::Scene;
use crate::{Error, Result};
use ndarray::{Array2, Zip};

/// Settings of a reduction beside its scene.
#[derive(Debug, Clone, Default)]
pub struct ReductionOptions {
    /// Bad pixels that are known, `[y, x]`.
    pub bad: Option<Array2<bool>>,
    /// Whether no sky is made of the dithers where there are no frames of the sky.
    pub is_without_dither_sky: bool,
    /// Keys whose value in the scene holds against a card, such as `image.gain_e_per_adu`.
    pub overrides: Vec<String>,
}

/// Frame in electrons, with its dark subtracted and its flat divided out.
pub(super) struct Calibrated<'a> {
    /// Its place among the frames.
    pub(super) index: usize,
    pub(super) frame: &'a RawFrame,
    /// `[y, x]`, NaN where it is bad.
    pub(super) electrons: Array2<f64>,
    /// Electrons per count.
    pub(super) gain: f64,
    /// Its dark, by its place.
    pub(super) dark: Option<usize>,
    /// Variance of the dark over that of the reads of one coadd.
    pub(super) dark_variance: f64,
}

impl Calibrated<'_> {
    /// Whether both have one filter.
    pub(super) fn has_filter_of(&self, other: &Self) -> bool {
        self.frame.header.filter == other.frame.header.filter
    }

    /// Whether both have the same sky: one filter and one exposure, and both a dark or none.
    pub(super) fn is_alike(&self, other: &Self) -> bool {
        self.has_filter_of(other)
            && other.frame.header.has_exposure_of(&self.frame.header)
            && other.frame.coadds() == self.frame.coadds()
            && other.dark.is_some() == self.dark.is_some()
    }
}

/// Masters and masks of a detector.
pub(super) struct DetectorCalibration<'a> {
    options: &'a ReductionOptions,
    pub(super) darks: Vec<Dark>,
    bad_in_darks: Vec<Array2<bool>>,
    flats: Vec<Flat>,
    bad_in_flats: Vec<Array2<bool>>,
    /// What a user should know.
    pub(super) warnings: Vec<String>,
}

impl<'a> DetectorCalibration<'a> {
    /// Masters of `frames`, whose rows say what was made of them.
    pub(super) fn new(frames: &[RawFrame], options: &'a ReductionOptions, rows: &mut [LogRow]) -> Self {
        let mut warnings = Vec::new();
        let darks = masters::darks(frames, rows);
        let flats = masters::flats(frames, &darks, rows, &mut warnings);
        let bad_in_darks = darks.iter().map(masters::bad_in_dark).collect();
        let bad_in_flats = flats.iter().map(masters::bad_in_flat).collect();
        Self { options, darks, bad_in_darks, flats, bad_in_flats, warnings }
    }

    /// A frame in electrons.
    pub(super) fn calibrate<'f>(&mut self, index: usize, frame: &'f RawFrame, scene: &Scene) -> Result<Calibrated<'f>> {
        let gain = self.gain(frame, scene)?;
        let mut counts = frame.data.clone();
        let mut bad = frame.bad.clone();
        let mut add = |more: &Array2<bool>| Zip::from(&mut bad).and(more).for_each(|bad, more| *bad |= more);
        self.options.bad.iter().for_each(&mut add);
        let dark = masters::dark_of(&self.darks, frame);
        let dark = dark.and_then(|dark| self.darks.iter().position(|known| std::ptr::eq(known, dark)));
        if let Some(dark) = dark {
            counts.scaled_add(-frame.coadds(), &self.darks[dark].counts);
            add(&self.bad_in_darks[dark]);
        }
        if let Some(flat) = self.flat_of(frame) {
            counts /= &self.flats[flat].response;
            add(&self.bad_in_flats[flat]);
        }
        counts *= gain;
        Zip::from(&mut counts).and(&bad).for_each(|counts, bad| {
            if *bad {
                *counts = f64::NAN;
            }
        });
        let dark_variance = dark.map_or(0.0, |dark| self.darks[dark].variance);
        Ok(Calibrated { index, frame, electrons: counts, gain, dark, dark_variance })
    }

    /// Flat of the filter of a frame, or the only one.
    fn flat_of(&mut self, frame: &RawFrame) -> Option<usize> {
        let filter = frame.header.filter.clone().unwrap_or_default();
        let own = self.flats.iter().position(|flat| flat.filter == filter);
        if own.is_some() || self.flats.is_empty() {
            return own;
        }
        let filters = self.flats.iter().map(|flat| flat.filter.as_str()).collect::<Vec<_>>().join(", ");
        let is_only = self.flats.len() == 1;
        let used = if is_only { "it was divided out all the same" } else { "none was divided out" };
        let warning = format!("there is no flat in the filter {filter}, only in {filters}: {used}");
        if !self.warnings.contains(&warning) {
            self.warnings.push(warning);
        }
        is_only.then_some(0)
    }

    /// Electrons per count of a frame; 1 for one in electrons.
    pub(super) fn gain(&self, frame: &RawFrame, scene: &Scene) -> Result<f64> {
        let key = "image.gain_e_per_adu";
        let named = scene.image.gain_e_per_adu;
        let about = |reason: String| Error::Image(format!("{}: {reason}", frame.name));
        let stated = frame.header.facts.iter().find(|fact| fact.quantity == Quantity::GainEPerAdu);
        let value = |fact: &HeaderFact| fact.values.first().copied().filter(|gain| *gain > 0.0);
        match (&frame.header.unit, named) {
            (_, Some(gain)) if self.options.overrides.iter().any(|known| known == key) => Ok(gain),
            (PixelUnit::Electrons, _) => Ok(1.0),
            (_, Some(gain)) => match stated.filter(|fact| !fact.agrees(gain)) {
                None => Ok(gain),
                Some(fact) => Err(about(format!(
                    "card {} = {} where the scene has {key} = {gain}; --set {key}={gain} keeps the scene's",
                    fact.keyword, fact.written
                ))),
            },
            (PixelUnit::Other(unit), None) => Err(about(format!(
                "its pixels are in `{unit}` (card BUNIT): counts or electrons are accepted; {key} is the number of electrons per unit"
            ))),
            (PixelUnit::Counts | PixelUnit::Unstated, None) => stated.and_then(value).ok_or_else(|| {
                about(format!("nothing gives the electrons per count: {key} in the scene (--set {key}=4), or a card GAIN or EGAIN is needed"))
            }),
        }
    }

    /// Number of pixels that the mask, a dark or a flat marks.
    pub(super) fn bad_pixels(&self) -> usize {
        let mut all: Array2<bool> = Array2::default((0, 0));
        for map in self.options.bad.iter().chain(&self.bad_in_darks).chain(&self.bad_in_flats) {
            if all.is_empty() {
                all = map.clone();
            } else {
                Zip::from(&mut all).and(map).for_each(|all, more| *all |= more);
            }
        }
        all.iter().filter(|bad| **bad).count()
    }
}

/// Read noise of one coadd that the scene or a card states, electrons RMS.
pub(super) fn stated_read_noise_e(frame: &RawFrame, scene: &Scene) -> Option<f64> {
    let stated = frame.header.facts.iter().find(|fact| fact.quantity == Quantity::ReadNoiseE);
    scene.image.read_noise_e.or_else(|| stated?.values.first().copied())
}

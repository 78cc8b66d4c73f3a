//! The reduction: masters, star, sky, cut-out, rejection.

use super::classify::FrameClass;
use super::cut_out::CutOut;
use super::frame::Frame;
use super::log::LogRow;
use super::masters::{self, Dark, Flat};
use super::noise::{NoiseTerms, scatter};
use super::{rejection, sky, star};
use crate::io::{HeaderFact, PixelUnit, Quantity};
use crate::machine;
use crate::scene::Scene;
use crate::statistics::median;
use crate::{Error, Result};
use ndarray::{Array2, Array3, Axis, Zip, stack};

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

/// Reduced images of a channel.
#[derive(Debug, Clone)]
pub struct ReducedChannel {
    /// Its name; `None` in a scene without channels.
    pub name: Option<String>,
    /// Electrons, `[image, y, x]`.
    pub images_e: Array3<f64>,
    /// Bad pixels, `[image, y, x]`.
    pub bad: Array3<bool>,
    /// Noise of a pixel without the star's light, RMS electrons, mean over the images.
    pub noise_e: f64,
    /// Read noise of one coadd, RMS electrons, that the scene or a card stated.
    pub stated_read_noise_e: Option<f64>,
    /// Integration time of a coadd, s, and number of coadds, where all images have the same.
    pub exposure: Option<(f64, u32)>,
    /// Wavelengths that the header of the first image states: keyword and nm.
    pub wavelengths_nm: Vec<(&'static str, f64)>,
}

/// Reduced images with the log of the frames.
#[derive(Debug, Clone)]
pub struct Reduction {
    /// The channels of the scene in order, or one.
    pub channels: Vec<ReducedChannel>,
    /// One row for each frame, in the order of the frames; then files that are no frames.
    pub log: Vec<LogRow>,
    /// What a user should know.
    pub warnings: Vec<String>,
    /// Pixels of the detector that the mask, the darks or the flats mark.
    pub bad_pixels: usize,
    /// What was subtracted and divided, in words.
    pub steps: Vec<String>,
}

/// Frame in electrons, with its dark subtracted and its flat divided out.
pub(super) struct Calibrated<'a> {
    /// Its place among the frames.
    index: usize,
    pub(super) frame: &'a Frame,
    /// `[y, x]`, NaN where it is bad.
    pub(super) electrons: Array2<f64>,
    gain: f64,
    /// Its dark, by its place.
    pub(super) dark: Option<usize>,
    /// Variance of the dark over that of the reads of one coadd.
    pub(super) dark_variance: f64,
}

/// Image that is cut out.
struct Image {
    index: usize,
    electrons: Array2<f64>,
    variance: f64,
    stated_read_noise_e: Option<f64>,
}

/// Reduces `frames` to the images of the channels of `scene`.
///
/// # Errors
/// [`Error::Image`] where no frame of the star is left, or one of a channel; for counts without a gain or with two; for frames of another
/// shape than the mask; [`Error::Value`] where the memory does not hold the frames.
pub fn reduce(scene: &Scene, frames: &[Frame], options: &ReductionOptions) -> Result<Reduction> {
    Reducer::new(scene, frames, options)?.run()
}

struct Reducer<'a> {
    scene: &'a Scene,
    frames: &'a [Frame],
    options: &'a ReductionOptions,
    rows: Vec<LogRow>,
    warnings: Vec<String>,
    darks: Vec<Dark>,
    bad_in_darks: Vec<Array2<bool>>,
    flats: Vec<Flat>,
    bad_in_flats: Vec<Array2<bool>>,
}

impl<'a> Reducer<'a> {
    fn new(scene: &'a Scene, frames: &'a [Frame], options: &'a ReductionOptions) -> Result<Self> {
        let mut rows: Vec<LogRow> = frames.iter().map(LogRow::of).collect();
        let shape = reject_other_shapes(frames, &mut rows)?;
        if let Some(bad) = options.bad.as_ref().filter(|bad| bad.dim() != shape) {
            let ((y, x), (rows, columns)) = (bad.dim(), shape);
            return Err(Error::Image(format!("the mask has {x}x{y} pixels, where the frames have {columns}x{rows}")));
        }
        // Each frame in electrons, and a copy of it without hot pixels with two tables of sums while its star is looked for.
        let bytes = (frames.len() + 4) as u64 * (shape.0 * shape.1) as u64 * 8;
        machine::check_memory(format_args!("{} frames", frames.len()), bytes, "reduce fewer frames at once")?;
        let mut warnings = Vec::new();
        let darks = masters::darks(frames, &mut rows);
        let flats = masters::flats(frames, &darks, &mut rows, &mut warnings);
        let bad_in_darks = darks.iter().map(masters::bad_in_dark).collect();
        let bad_in_flats = flats.iter().map(masters::bad_in_flat).collect();
        Ok(Self { scene, frames, options, rows, warnings, darks, bad_in_darks, flats, bad_in_flats })
    }

    fn run(mut self) -> Result<Reduction> {
        let mut groups: Vec<Vec<Calibrated>> = (0..self.scene.channels().len().max(1)).map(|_| Vec::new()).collect();
        let mut skies = Vec::new();
        let frames = self.frames;
        for (index, frame) in frames.iter().enumerate() {
            if !self.rows[index].reason.is_empty() {
                continue;
            }
            match frame.class {
                FrameClass::Star => match self.channel_of(frame) {
                    Ok(channel) => groups[channel].push(self.calibrate(index, channel)?),
                    Err(reason) => self.rows[index].reject(reason),
                },
                FrameClass::Sky => {
                    skies.push(self.calibrate(index, 0)?);
                    self.rows[index].accept("sky");
                }
                FrameClass::Other => {
                    self.rows[index].reject(format!("neither star nor calibration: {}", frame.classified_by))
                }
                _ => {}
            }
        }
        let channels = groups.iter().enumerate().map(|(channel, group)| self.channel(channel, group, &skies));
        let channels = channels.collect::<Result<Vec<_>>>()?;
        for row in self.rows.iter_mut().filter(|row| row.reason.is_empty()) {
            row.reject("not used");
        }
        self.check_read_noise();
        let (bad_pixels, steps) = (self.bad_pixels(), self.steps(&skies));
        Ok(Reduction { channels, log: self.rows, warnings: self.warnings, bad_pixels, steps })
    }

    /// Scene of a channel.
    fn scene_of(&self, channel: usize) -> &'a Scene {
        self.scene.channels().get(channel).map_or(self.scene, |channel| &channel.scene)
    }

    /// Channel that a frame belongs to, by its place; the reason where it belongs to none.
    fn channel_of(&self, frame: &Frame) -> std::result::Result<usize, String> {
        let channels = self.scene.channels();
        let disagrees = |channel: usize| self.wavelength_contradiction(frame, self.scene_of(channel));
        if channels.is_empty() {
            return disagrees(0).map_or(Ok(0), Err);
        }
        let names = || channels.iter().map(|channel| channel.name.as_str()).collect::<Vec<_>>().join(", ");
        if let Some(name) = &frame.channel {
            let found = channels.iter().position(|channel| channel.name == *name);
            let channel = found.ok_or_else(|| format!("the scene has no channel {name}: there are {}", names()))?;
            return disagrees(channel).map_or(Ok(channel), Err);
        }
        let agreeing: Vec<usize> = (0..channels.len()).filter(|&channel| disagrees(channel).is_none()).collect();
        let has_wavelength = frame.header.facts.iter().any(is_wavelength);
        match agreeing.as_slice() {
            [only] if has_wavelength => Ok(*only),
            [] => Err(format!("its wavelength is that of none of the channels {}", names())),
            _ => Err(format!(
                "its header does not say which of the channels {} it is of (--channel NAME=PATTERN)",
                names()
            )),
        }
    }

    /// How the wavelength or the filter of a frame contradicts a scene.
    fn wavelength_contradiction(&self, frame: &Frame, scene: &Scene) -> Option<String> {
        let key = "image.wavelength_nm";
        if self.options.overrides.iter().any(|known| known == key) {
            return None;
        }
        let contradiction = |quantity: Quantity| {
            let facts: Vec<&HeaderFact> = frame.header.facts.iter().filter(|fact| fact.quantity == quantity).collect();
            let first = facts.first()?;
            let agrees = facts.iter().any(|fact| fact.agrees(scene.image.wavelength_nm));
            let wavelength_nm = scene.image.wavelength_nm;
            (!agrees).then(|| {
                format!("card {} = {} where the scene has {key} = {wavelength_nm}", first.keyword, first.written)
            })
        };
        contradiction(Quantity::WavelengthNm).or_else(|| contradiction(Quantity::BandNm))
    }

    /// A frame in electrons.
    fn calibrate(&mut self, index: usize, channel: usize) -> Result<Calibrated<'a>> {
        let frame = &self.frames[index];
        let gain = self.gain(frame, self.scene_of(channel))?;
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
    fn flat_of(&mut self, frame: &Frame) -> Option<usize> {
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
    fn gain(&self, frame: &Frame, scene: &Scene) -> Result<f64> {
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

    /// Read noise of one coadd that the scene or a card states, electrons RMS.
    fn stated_read_noise_e(&self, frame: &Frame, scene: &Scene) -> Option<f64> {
        let stated = frame.header.facts.iter().find(|fact| fact.quantity == Quantity::ReadNoiseE);
        scene.image.read_noise_e.or_else(|| stated?.values.first().copied())
    }

    /// The images of a channel, cut out of its frames.
    fn channel(&mut self, channel: usize, group: &[Calibrated], skies: &[Calibrated]) -> Result<ReducedChannel> {
        let scene = self.scene_of(channel);
        let name = self.scene.channels().get(channel).map(|channel| channel.name.clone());
        let shape = scene.image.frame_shape();
        let (mut parts, mut stars) = (Vec::new(), Vec::new());
        for frame in group {
            self.rows[frame.index].channel = name.clone().unwrap_or_default();
            parts.push(self.find_star(frame, shape));
            let row = &self.rows[frame.index];
            stars.push((frame, row.x.is_finite().then_some((row.x, row.y))));
        }
        let mut images: Vec<Image> = Vec::new();
        for (frame, part) in group.iter().zip(parts) {
            images.extend(part.and_then(|part| self.cut_out(frame, part, &stars, skies, scene)));
        }
        let cut: Vec<usize> = images.iter().map(|image| image.index).collect();
        rejection::reject_trailed(&mut self.rows, &cut);
        images.retain(|image| self.rows[image.index].reason.is_empty());
        for image in &images {
            self.rows[image.index].accept("star");
        }
        self.assemble(name, &images)
    }

    /// Looks for the star of a frame; `None`, with the reason in the log, where there is none to use.
    fn find_star(&mut self, frame: &Calibrated, shape: (usize, usize)) -> Option<CutOut> {
        let row = &mut self.rows[frame.index];
        let spot = star::find(&frame.electrons, shape.0.max(shape.1));
        if let Some(reason) = rejection::starless(spot) {
            row.reject(reason);
            return None;
        }
        let spot = spot?;
        (row.x, row.y, row.elongation) = (spot.x, spot.y, spot.elongation);
        match CutOut::about((spot.x, spot.y), shape, frame.electrons.dim()) {
            Ok(part) => Some(part),
            Err(reason) => {
                row.reject(reason);
                None
            }
        }
    }

    /// Cuts the image of the star out; `None`, with the reason in the log, for a frame that is rejected.
    fn cut_out(
        &mut self,
        frame: &Calibrated,
        part: CutOut,
        stars: &[(&Calibrated, Option<(f64, f64)>)],
        skies: &[Calibrated],
        scene: &Scene,
    ) -> Option<Image> {
        let saturation_adu = scene.image.saturation_adu.or(frame.frame.header.saturation_adu);
        let bad = frame.electrons.mapv(|electrons| !electrons.is_finite());
        let (peak_adu, saturated) = rejection::saturation(frame.frame, &bad, part, saturation_adu);
        let background_e = median(&outside(&frame.electrons, part));
        let row = &mut self.rows[frame.index];
        (row.peak_adu, row.background_e) = (peak_adu, background_e);
        if let Some(reason) = saturated {
            row.reject(reason);
            return None;
        }
        let of_dithers = || if self.options.is_without_dither_sky { None } else { sky::of_dithers(frame, part, stars) };
        let sky = if skies.is_empty() { of_dithers() } else { sky::of_sky_frames(frame, part, skies) };
        if sky.is_none() && frame.dark.is_none() && !self.darks.is_empty() {
            let there = masters::exposures(&self.darks);
            self.rows[frame.index]
                .reject(format!("no dark {}, only {there}, and no sky of its exposure", frame.frame.header.exposure()));
            return None;
        }
        let mut electrons = part.of(&frame.electrons);
        let level_e = match &sky {
            Some(sky) => {
                electrons -= &sky.electrons;
                median(&sky.electrons.iter().copied().filter(|value| value.is_finite()).collect::<Vec<_>>())
            }
            // The bias of a detector is no background of photons.
            None if frame.dark.is_none() => {
                electrons -= background_e;
                background_e
            }
            None => 0.0,
        };
        let rest_e = if background_e.is_finite() { background_e - level_e } else { 0.0 };
        let light = electrons.iter().filter(|value| value.is_finite()).map(|value| value - rest_e);
        self.rows[frame.index].flux_e = light.sum();
        let stated_read_noise_e = self.stated_read_noise_e(frame.frame, scene);
        let of_dark = frame.dark.and_then(|dark| Some(self.darks[dark].read_noise_adu? * frame.gain));
        // Without a dark nothing tells the sky, which has photon noise, from the bias, which has none.
        let known = stated_read_noise_e.or(of_dark).filter(|_| frame.dark.is_some());
        let variance = match known {
            Some(read_noise_e) => {
                let (coadds, dark) = (frame.frame.coadds(), frame.dark_variance);
                NoiseTerms { coadds, read_noise_e, dark, sky: sky.as_ref().map(|sky| sky.terms) }.variance()
            }
            // An estimate adds the photons of a background that is kept.
            None => {
                let kept_e = if sky.is_none() && frame.dark.is_some() { background_e.max(0.0) } else { 0.0 };
                let measured = scatter(corners(&electrons)).powi(2);
                (measured - kept_e).max(0.01 * measured)
            }
        };
        Some(Image { index: frame.index, electrons, variance, stated_read_noise_e })
    }

    /// The cube of a channel.
    fn assemble(&mut self, name: Option<String>, images: &[Image]) -> Result<ReducedChannel> {
        let Some(first) = images.first() else { return Err(self.nothing_left(name.as_deref())) };
        let views: Vec<_> = images.iter().map(|image| image.electrons.view()).collect();
        let images_e = stack(Axis(0), &views).map_err(|error| Error::Internal(error.to_string()))?;
        let bad = images_e.mapv(|electrons| !electrons.is_finite());
        // An estimate weights a bad pixel 0, but a file with NaN in it would be warned of.
        let images_e = images_e.mapv(|electrons| if electrons.is_finite() { electrons } else { 0.0 });
        let variances: Vec<f64> = images.iter().map(|image| image.variance).collect();
        let mean = variances.iter().sum::<f64>() / variances.len() as f64;
        let (least, most) =
            variances.iter().fold((f64::MAX, 0f64), |(a, b), &variance| (a.min(variance), b.max(variance)));
        if most > 1.5 * least {
            self.warnings.push(format!(
                "{}the noise of the images is from {:.1} to {:.1} electrons, and one number is written for all: reduce exposures that \
                 differ apart from each other",
                name.as_ref().map(|name| format!("channel {name}: ")).unwrap_or_default(),
                least.sqrt(),
                most.sqrt()
            ));
        }
        let header = &self.frames[first.index].header;
        let is_same = images.iter().all(|image| {
            let other = &self.frames[image.index];
            other.header.coadds == header.coadds && other.header.has_exposure_of(header)
        });
        let exposure = header.itime_s.filter(|_| is_same).map(|itime_s| (itime_s, header.coadds));
        let wavelengths = header.facts.iter().filter(|fact| fact.quantity == Quantity::WavelengthNm);
        let wavelengths_nm = wavelengths.filter_map(|fact| Some((fact.keyword, *fact.values.first()?))).collect();
        let (noise_e, stated_read_noise_e) = (mean.sqrt(), first.stated_read_noise_e);
        Ok(ReducedChannel { name, images_e, bad, noise_e, stated_read_noise_e, exposure, wavelengths_nm })
    }

    /// The error of a channel without images, with the reasons of the first frames.
    fn nothing_left(&self, name: Option<&str>) -> Error {
        let own = |row: &&LogRow| {
            row.class == FrameClass::Star && name.is_none_or(|name| row.channel.is_empty() || row.channel == name)
        };
        let rejected: Vec<&LogRow> = self.rows.iter().filter(own).collect();
        let of = name.map(|name| format!(" of channel {name}")).unwrap_or_default();
        let reasons: Vec<String> = rejected.iter().take(3).map(|row| format!("{}: {}", row.file, row.reason)).collect();
        let more = if rejected.len() > reasons.len() { "; ..." } else { "" };
        match rejected.len() {
            0 => {
                Error::Image(format!("there is no frame{of} with a star among the {}: one is needed", self.rows.len()))
            }
            count => Error::Image(format!("none of {count} frames{of} can be used ({}{more})", reasons.join("; "))),
        }
    }

    /// Compares the read noise that was stated with that of the darks.
    fn check_read_noise(&mut self) {
        let stated = self
            .frames
            .iter()
            .enumerate()
            .find(|(index, frame)| self.rows[*index].is_used && frame.class == FrameClass::Star);
        let Some((_, frame)) = stated else { return };
        let channel = self.channel_of(frame).unwrap_or(0);
        let scene = self.scene_of(channel);
        let Some(read_noise_e) = self.stated_read_noise_e(frame, scene).filter(|noise_e| *noise_e > 0.0) else {
            return;
        };
        let Some(of_dark) = masters::dark_of(&self.darks, frame).and_then(|dark| dark.read_noise_adu) else { return };
        let Ok(gain) = self.gain(frame, scene) else { return };
        let ratio = of_dark * gain / read_noise_e;
        if !(0.8..=1.25).contains(&ratio) {
            self.warnings.push(format!(
                "the darks scatter by {:.1} electrons in one coadd, where the read noise is stated as {read_noise_e}: the stated one was used",
                of_dark * gain
            ));
        }
    }

    /// Number of pixels that the mask, a dark or a flat marks.
    fn bad_pixels(&self) -> usize {
        let mut all = self.frames.first().map(|_| Array2::from_elem((0, 0), false)).unwrap_or_default();
        for map in self.options.bad.iter().chain(&self.bad_in_darks).chain(&self.bad_in_flats) {
            if all.is_empty() {
                all = map.clone();
            } else {
                Zip::from(&mut all).and(map).for_each(|all, more| *all |= more);
            }
        }
        all.iter().filter(|bad| **bad).count()
    }

    /// What was done, and a warning where nothing removed the bias.
    fn steps(&mut self, skies: &[Calibrated]) -> Vec<String> {
        let used = |class: FrameClass| self.rows.iter().filter(|row| row.class == class && row.is_used).count();
        let (darks, flats) = (self.darks.iter().map(|dark| dark.frames).sum::<usize>(), used(FrameClass::Flat));
        let mut steps = Vec::new();
        let mut add = |count: usize, noun: &str| {
            if count > 0 {
                steps.push(format!("{count} {noun}{}", if count == 1 { "" } else { "s" }));
            }
        };
        add(darks, "dark");
        add(flats, "flat");
        add(skies.len(), "sky frame");
        if skies.is_empty() && !self.options.is_without_dither_sky {
            steps.push("sky from the dithers where they do not overlap".into());
        }
        if darks == 0 && skies.is_empty() {
            self.warnings.push(
                "there are neither darks nor frames of the sky: what the dithers do not remove of the bias remains"
                    .into(),
            );
        }
        steps
    }
}

fn is_wavelength(fact: &HeaderFact) -> bool {
    matches!(fact.quantity, Quantity::WavelengthNm | Quantity::BandNm)
}

/// The pixels of an image outside of the ellipse in it, where the least light of the star is.
fn corners(image: &Array2<f64>) -> impl Iterator<Item = f64> + '_ {
    let (rows, columns) = image.dim();
    let offset = |at: usize, size: usize| (2.0 * at as f64 - size as f64) / size as f64;
    let is_corner = move |y: usize, x: usize| offset(y, rows).hypot(offset(x, columns)) > 1.0;
    image.indexed_iter().filter(move |((y, x), _)| is_corner(*y, *x)).map(|(_, value)| *value)
}

/// The good pixels outside of a cut-out; all of them where there are too few for a median.
fn outside(map: &Array2<f64>, part: CutOut) -> Vec<f64> {
    const ENOUGH: usize = 100;
    let good = map.indexed_iter().filter(|(_, value)| value.is_finite());
    let outside: Vec<f64> =
        good.clone().filter(|((y, x), _)| !part.contains(*y, *x)).map(|(_, value)| *value).collect();
    if outside.len() >= ENOUGH { outside } else { good.map(|(_, value)| *value).collect() }
}

/// Rejects the frames of another shape than most frames of the star, and gives that shape.
fn reject_other_shapes(frames: &[Frame], rows: &mut [LogRow]) -> Result<(usize, usize)> {
    let shapes: Vec<_> =
        frames.iter().filter(|frame| frame.class == FrameClass::Star).map(|frame| frame.data.dim()).collect();
    let count = |shape: &(usize, usize)| shapes.iter().filter(|other| *other == shape).count();
    let Some(&shape) = shapes.iter().max_by_key(|shape| count(shape)) else {
        return Err(Error::Image(format!("there is no frame with a star among the {}: one is needed", frames.len())));
    };
    for (frame, row) in frames.iter().zip(rows) {
        let (y, x) = frame.data.dim();
        if (y, x) != shape {
            row.reject(format!("has {x}x{y} pixels, where the frames of the star have {}x{}", shape.1, shape.0));
        }
    }
    Ok(shape)
}

//! The reduction: masters, star, sky, cut-out, rejection.

use super::calibration::{Calibrated, DetectorCalibration, ReductionOptions, stated_read_noise_e};
use super::channel::channel_of;
use super::classify::FrameClass;
use super::frame::RawFrame;
use super::log::LogRow;
use super::noise::{NoiseTerms, scatter};
use super::pupil_turns;
use super::reduced::{ReducedChannel, Reduction};
use super::star_frame::{self, StarFrame};
use super::{masters, sky};
use crate::io::Quantity;
use crate::machine;
use crate::scene::Scene;
use crate::statistics::median;
use crate::{Error, Result};
use ndarray::{Array2, Axis, stack};

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
/// [`Error::Image`] where no frame of the star is left, or one of a channel; for counts without a
/// gain or with two; for frames of another shape than the mask; [`Error::Value`] where the memory
/// does not hold the frames.
pub fn reduce(scene: &Scene, frames: &[RawFrame], options: &ReductionOptions) -> Result<Reduction> {
    let is_averaged = |frame: &RawFrame| scene.image.coadds_are_averaged || frame.header.has_averaged_coadds;
    if frames.iter().any(is_averaged) {
        let summed = |frame: &RawFrame| if is_averaged(frame) { frame.with_summed_coadds() } else { frame.clone() };
        let summed: Vec<RawFrame> = frames.iter().map(summed).collect();
        return Reducer::new(scene, &summed, options)?.run();
    }
    Reducer::new(scene, frames, options)?.run()
}

/// The sentences on files that `of` gives, each once, with the number of frames that it is said of.
fn said_once(frames: &[RawFrame], of: fn(&RawFrame) -> &[String]) -> Vec<String> {
    let mut said: Vec<(&str, usize)> = Vec::new();
    for sentence in frames.iter().flat_map(of) {
        match said.iter_mut().find(|(known, _)| known == sentence) {
            Some((_, count)) => *count += 1,
            None => said.push((sentence, 1)),
        }
    }
    said.into_iter()
        .map(|(sentence, count)| format!("{sentence} ({count} frame{})", if count == 1 { "" } else { "s" }))
        .collect()
}

struct Reducer<'a> {
    scene: &'a Scene,
    frames: &'a [RawFrame],
    options: &'a ReductionOptions,
    rows: Vec<LogRow>,
    calibration: DetectorCalibration<'a>,
}

impl<'a> Reducer<'a> {
    fn new(scene: &'a Scene, frames: &'a [RawFrame], options: &'a ReductionOptions) -> Result<Self> {
        let mut rows: Vec<LogRow> = frames.iter().map(LogRow::of).collect();
        let shape = reject_other_shapes(frames, &mut rows)?;
        if let Some(bad) = options.bad.as_ref().filter(|bad| bad.dim() != shape) {
            let ((y, x), (rows, columns)) = (bad.dim(), shape);
            return Err(Error::Image(format!("the mask has {x}x{y} pixels, where the frames have {columns}x{rows}")));
        }
        // Each frame in electrons, and a copy of it without hot pixels with two tables of sums
        // while its star is looked for.
        let bytes = (frames.len() + 4) as u64 * (shape.0 * shape.1) as u64 * 8;
        machine::check_memory(format_args!("{} frames", frames.len()), bytes, "reduce fewer frames at once")?;
        let calibration = DetectorCalibration::new(frames, options, &mut rows);
        Ok(Self { scene, frames, options, rows, calibration })
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
        self.calibration.warnings.extend(said_once(self.frames, |frame| &frame.notes));
        let (bad_pixels, steps) = (self.calibration.bad_pixels(), self.steps(&skies));
        let remarks = said_once(self.frames, |frame| &frame.remarks);
        Ok(Reduction { channels, log: self.rows, warnings: self.calibration.warnings, remarks, bad_pixels, steps })
    }

    /// Channel of a frame, or the reason why it is of none.
    fn channel_of(&self, frame: &RawFrame) -> std::result::Result<usize, String> {
        let channel = channel_of(frame, self.scene, &self.options.overrides)?;
        pupil_turns::check(frame, self.scene_of(channel)).map(|()| channel)
    }

    /// Scene of a channel.
    fn scene_of(&self, channel: usize) -> &'a Scene {
        self.scene.channels().get(channel).map_or(self.scene, |channel| &channel.scene)
    }

    /// The frame `index` in electrons.
    fn calibrate(&mut self, index: usize, channel: usize) -> Result<Calibrated<'a>> {
        let scene = self.scene_of(channel);
        self.calibration.calibrate(index, &self.frames[index], scene)
    }

    /// The images of a channel, cut out of its frames.
    fn channel(&mut self, channel: usize, group: &[Calibrated], skies: &[Calibrated]) -> Result<ReducedChannel> {
        let scene = self.scene_of(channel);
        let name = self.scene.channels().get(channel).map(|channel| channel.name.clone());
        for frame in group {
            self.rows[frame.index].channel = name.clone().unwrap_or_default();
        }
        let found = star_frame::usable(group, scene, &mut self.rows);
        let mut images: Vec<Image> = Vec::new();
        for one in &found {
            images.extend(self.cut_out(one, &found, skies, scene));
        }
        for image in &images {
            self.rows[image.index].accept("star");
        }
        self.assemble(name, scene, &images)
    }

    /// Cuts the image of the star out; `None`, with the reason in the log, for a frame that is
    /// rejected.
    fn cut_out(&mut self, one: &StarFrame, all: &[StarFrame], skies: &[Calibrated], scene: &Scene) -> Option<Image> {
        let &StarFrame { frame, part, background_e, .. } = one;
        let of_dithers = || if self.options.is_without_dither_sky { None } else { sky::of_dithers(one, all) };
        let sky = if skies.is_empty() { of_dithers() } else { sky::of_sky_frames(frame, part, skies) };
        if sky.is_none() && frame.dark.is_none() && !self.calibration.darks.is_empty() {
            let there = masters::exposures(&self.calibration.darks);
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
        let flux_e: f64 = light.sum();
        let row = &mut self.rows[frame.index];
        row.flux_e = flux_e;
        if flux_e <= 0.0 {
            row.reject(format!(
                "its image has {flux_e:.3e} electrons in all, where a star has more than 0: the sky that was subtracted is not its own"
            ));
            return None;
        }
        let stated_read_noise_e = stated_read_noise_e(frame.frame, scene);
        let of_dark = frame.dark.and_then(|dark| Some(self.calibration.darks[dark].read_noise_adu? * frame.gain));
        // Darks have the photon noise of the dark current, which no read noise states. Without a
        // dark nothing tells the sky, which has photon noise, from the bias, which has none.
        let known = of_dark.or(stated_read_noise_e).filter(|_| frame.dark.is_some());
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
    fn assemble(&mut self, name: Option<String>, scene: &Scene, images: &[Image]) -> Result<ReducedChannel> {
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
            self.calibration.warnings.push(format!(
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
        let frames = images.iter().map(|image| &self.frames[image.index]);
        let pupil_turns_deg = pupil_turns::turns_deg(scene, frames.clone());
        self.calibration.warnings.extend(pupil_turns::unnamed_turn(scene, frames));
        Ok(ReducedChannel {
            name,
            images_e,
            bad,
            noise_e,
            stated_read_noise_e,
            exposure,
            wavelengths_nm,
            pupil_turns_deg,
        })
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

    /// Compares the read noise that was stated with that of the darks, which is used.
    fn check_read_noise(&mut self) {
        let stated = self
            .frames
            .iter()
            .enumerate()
            .find(|(index, frame)| self.rows[*index].is_used && frame.class == FrameClass::Star);
        let Some((_, frame)) = stated else { return };
        let channel = channel_of(frame, self.scene, &self.options.overrides).unwrap_or(0);
        let scene = self.scene_of(channel);
        let Some(read_noise_e) = stated_read_noise_e(frame, scene).filter(|noise_e| *noise_e > 0.0) else {
            return;
        };
        let Some(of_dark) = masters::dark_of(&self.calibration.darks, frame).and_then(|dark| dark.read_noise_adu)
        else {
            return;
        };
        let Ok(gain) = self.calibration.gain(frame, scene) else { return };
        let ratio = of_dark * gain / read_noise_e;
        if !(0.8..=1.25).contains(&ratio) {
            self.calibration.warnings.push(format!(
                "the darks scatter by {:.1} electrons in one coadd, where the read noise is stated as {read_noise_e}: that of the darks was \
                 used, which has the noise of the dark current",
                of_dark * gain
            ));
        }
    }

    /// What was done, and a warning where nothing removed the bias.
    fn steps(&mut self, skies: &[Calibrated]) -> Vec<String> {
        let used = |class: FrameClass| self.rows.iter().filter(|row| row.class == class && row.is_used).count();
        let (darks, flats) =
            (self.calibration.darks.iter().map(|dark| dark.frames).sum::<usize>(), used(FrameClass::Flat));
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
            self.calibration.warnings.push(
                "there are neither darks nor frames of the sky: what the dithers do not remove of the bias remains"
                    .into(),
            );
        }
        steps
    }
}

/// The pixels of an image outside of the ellipse in it, where the least light of the star is.
fn corners(image: &Array2<f64>) -> impl Iterator<Item = f64> + '_ {
    let (rows, columns) = image.dim();
    let offset = |at: usize, size: usize| (2.0 * at as f64 - size as f64) / size as f64;
    let is_corner = move |y: usize, x: usize| offset(y, rows).hypot(offset(x, columns)) > 1.0;
    image.indexed_iter().filter(move |((y, x), _)| is_corner(*y, *x)).map(|(_, value)| *value)
}

/// Rejects the frames of another shape than most frames of the star, and gives that shape.
fn reject_other_shapes(frames: &[RawFrame], rows: &mut [LogRow]) -> Result<(usize, usize)> {
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

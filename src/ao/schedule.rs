//! Schedule of the exposures of a run, in frames of the loop.

use crate::scene::{ImageScene, System};
use crate::{Error, Result};
use std::ops::Range;

/// Exposures of the channels of a scene: of all channels at the same frames (`image.simultaneous`),
/// or of one channel after another, each an interval after the one before.
#[derive(Debug, Clone, PartialEq)]
pub struct Schedule {
    pub(super) rate_hz: f64,
    /// Wavelength of the scene, which is that of its first channel, nm.
    pub(super) wavelength_nm: f64,
    sequences: Vec<Sequence>,
}

/// Exposures of one length at equal intervals.
#[derive(Debug, Clone, PartialEq)]
struct Sequence {
    channels: Range<usize>,
    /// Start of the first exposure, s.
    start_s: f64,
    interval_s: f64,
    frames: u64,
    images: usize,
}

/// One exposure of one channel, or of all where they are simultaneous.
#[derive(Debug, Clone, PartialEq)]
pub struct ScheduledExposure {
    /// Channels that are exposed; `0..1` for a scene without channels.
    pub channels: Range<usize>,
    /// Number of the image within each of them.
    pub image: usize,
    /// First frame of the run that it takes.
    pub start: u64,
    /// Frames that it takes; 1 freezes the turbulence.
    pub frames: u64,
}

impl ScheduledExposure {
    /// Index of `frame` within the exposure; `None` if it lies outside.
    pub fn place(&self, frame: u64) -> Option<u64> {
        (self.start..self.start + self.frames).contains(&frame).then(|| frame - self.start)
    }
}

impl Schedule {
    /// The schedule of `scene`, for a loop of `rate_hz` whose first exposure begins after
    /// `settle_s`.
    ///
    /// # Errors
    /// [`Error::Scene`] for simultaneous channels with other numbers or times of exposures.
    pub fn new(scene: &System, settle_s: f64, rate_hz: f64) -> Result<Self> {
        let channels = scene.channels();
        let sequences = if scene.image.simultaneous || channels.is_empty() {
            check_simultaneous(scene)?;
            vec![Sequence::new(0..channels.len().max(1), &scene.image, settle_s, rate_hz)]
        } else {
            let mut start_s = settle_s;
            let each = channels.iter().enumerate().map(|(number, channel)| {
                let sequence = Sequence::new(number..number + 1, &channel.system.image, start_s, rate_hz);
                start_s += sequence.images as f64 * sequence.interval_s;
                sequence
            });
            each.collect()
        };
        Ok(Self { rate_hz, wavelength_nm: scene.image.wavelength_nm, sequences })
    }

    /// The exposure `number`, from 0 in the order of time; `None` after the last.
    pub fn exposure(&self, number: usize) -> Option<ScheduledExposure> {
        let mut image = number;
        for sequence in &self.sequences {
            if image < sequence.images {
                return Some(sequence.exposure(image, self.rate_hz));
            }
            image -= sequence.images;
        }
        None
    }

    /// The frame at which the first exposure begins.
    pub fn start(&self) -> u64 {
        self.exposure(0).map_or(0, |first| first.start)
    }

    /// Frames of a run: up to the end of the last exposure.
    pub fn frames(&self) -> u64 {
        let exposures: usize = self.sequences.iter().map(|sequence| sequence.images).sum();
        self.exposure(exposures.max(1) - 1).map_or(0, |last| last.start + last.frames)
    }
}

impl Sequence {
    fn new(channels: Range<usize>, image: &ImageScene, start_s: f64, rate_hz: f64) -> Self {
        let frames = (image.exposure_s * rate_hz).round().max(1.0);
        let interval_s = image.interval_s.max(frames / rate_hz);
        Self { channels, start_s, interval_s, frames: frames as u64, images: image.count }
    }

    fn exposure(&self, image: usize, rate_hz: f64) -> ScheduledExposure {
        let start = ((self.start_s + image as f64 * self.interval_s) * rate_hz).round() as u64;
        ScheduledExposure { channels: self.channels.clone(), image, start, frames: self.frames }
    }
}

/// Refuses channels that cannot be exposed together.
fn check_simultaneous(scene: &System) -> Result<()> {
    let [first, others @ ..] = scene.channels() else { return Ok(()) };
    let keys = |image: &ImageScene| {
        [("count", image.count as f64), ("exposure_s", image.exposure_s), ("interval_s", image.interval_s)]
    };
    for channel in others {
        let mut pairs = keys(&channel.system.image).into_iter().zip(keys(&first.system.image));
        if let Some(((key, own), (_, other))) = pairs.find(|((_, own), (_, other))| own != other) {
            return Err(Error::Scene(format!(
                "{}: channel '{}' has image.{key} = {own} and channel '{}' {other}: with image.simultaneous = true one value for \
                 all channels is accepted",
                scene.name(),
                channel.name,
                first.name
            )));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ao::testing::small;

    const UNEQUAL: &str = "name = \"a\"\ncount = 2\ninterval_s = 0.01\n[[image.channel]]\nname = \"b\"\ncount = 3\n\
                           exposure_s = 0.004\ninterval_s = 0.0\n";

    #[test]
    fn channels_are_exposed_one_after_the_other() {
        let schedule = Schedule::new(&small(UNEQUAL, &[]), 0.02, 1000.0).unwrap();
        let exposures: Vec<_> = (0..).map_while(|number| schedule.exposure(number)).collect();
        let expected = |(channel, image, start, frames)| ScheduledExposure {
            channels: channel..channel + 1,
            image,
            start,
            frames,
        };
        // Two single frames 10 ms apart; 10 ms after the second, exposures of 4 ms without a pause.
        let frames = [(0, 0, 20, 1), (0, 1, 30, 1), (1, 0, 40, 4), (1, 1, 44, 4), (1, 2, 48, 4)];
        assert_eq!(exposures, frames.map(expected));
        assert_eq!((schedule.start(), schedule.frames()), (20, 52));
        assert_eq!([43, 44, 47, 48].map(|frame| exposures[3].place(frame)), [None, Some(0), Some(3), None]);
    }

    #[test]
    fn simultaneous_channels_need_equal_exposures() {
        let scene = small("name = \"a\"\n[[image.channel]]\nname = \"b\"\n", &[("image.simultaneous", "true")]);
        let scene = scene.with_override("image.count", "2").unwrap();
        let schedule = Schedule::new(&scene, 0.02, 1000.0).unwrap();
        assert_eq!(schedule.exposure(1), Some(ScheduledExposure { channels: 0..2, image: 1, start: 30, frames: 1 }));
        assert_eq!(schedule.exposure(2), None);
        for (key, value, facts) in [
            ("count", "3", "'b' has image.count = 3 | 'a' 2"),
            ("exposure_s", "0.004", "'b' has image.exposure_s = 0.004 | 'a' 0"),
            ("interval_s", "3", "'b' has image.interval_s = 3 | 'a' 0.01"),
        ] {
            let odd = scene.with_override(&format!("image.channel.b.{key}"), value).unwrap();
            match Schedule::new(&odd, 0.02, 1000.0) {
                Err(Error::Scene(reason)) => assert!(facts.split(" | ").all(|fact| reason.contains(fact)), "{reason}"),
                other => panic!("{other:?}"),
            }
        }
    }
}

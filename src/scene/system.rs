//! System: telescope, camera, modes, adaptive optics and settings of the estimate, as numbers and
//! without the text that they were read from.

use super::purpose::Purpose;
use super::sections::Sections;
use super::table::Source;
use crate::{Error, Result};
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Validated, immutable system. It dereferences to its [`Sections`]; a [`Scene`](super::Scene) is a
/// system with its text. Cloning is cheap.
#[derive(Debug, Clone)]
pub struct System {
    content: Arc<Content>,
}

/// One way of imaging the wavefront.
#[derive(Debug, Clone, PartialEq)]
pub struct SystemChannel {
    /// Its name; its number from 1 where the scene does not name it.
    pub name: String,
    /// The system of this channel alone.
    pub system: System,
}

#[derive(Debug, Clone)]
struct Content {
    sections: Sections,
    /// Name of the scene in messages.
    name: String,
    directory: PathBuf,
    purpose: Purpose,
    has_mirror: bool,
    channels: Vec<SystemChannel>,
}

/// Systems are equal whose sections and channels are.
impl PartialEq for System {
    fn eq(&self, other: &Self) -> bool {
        let (own, other) = (&self.content, &other.content);
        own.sections == other.sections && own.channels == other.channels
    }
}

/// What of a system is not in its sections.
pub(super) struct Origin<'a> {
    pub(super) name: &'a str,
    pub(super) directory: &'a Path,
    pub(super) purpose: Purpose,
    /// Whether the scene names a key of the mirror's layout.
    pub(super) names_mirror: bool,
}

impl System {
    pub(super) fn new(sections: Sections, origin: &Origin, channels: Vec<SystemChannel>) -> Self {
        let has_mirror = sections.control.is_some() || origin.names_mirror;
        let (name, directory) = (origin.name.to_owned(), origin.directory.to_owned());
        Self { content: Arc::new(Content { sections, name, directory, purpose: origin.purpose, has_mirror, channels }) }
    }

    /// This system with other values: `change` is given the sections of the system, then those of
    /// each channel.
    ///
    /// # Errors
    /// [`Error::Scene`] for a value out of the range of its key, and for values that contradict
    /// each other.
    pub fn with(&self, change: impl Fn(&mut Sections)) -> Result<Self> {
        self.changed(&[], &|sections| {
            change(sections);
            Ok(())
        })
    }

    /// As [`System::with`]; messages name the keys of `settings`.
    pub(super) fn changed(
        &self,
        settings: &[(&str, &str)],
        change: &dyn Fn(&mut Sections) -> Result<()>,
    ) -> Result<Self> {
        let mut content = Content::clone(&self.content);
        change(&mut content.sections)?;
        let source = Source { name: &content.name, text: "", purpose: content.purpose, settings };
        content.sections.check_values(source)?;
        for channel in &mut content.channels {
            channel.system = channel.system.changed(settings, change)?;
        }
        Ok(Self { content: Arc::new(content) })
    }

    /// This system with other values in its channels, whose numbers from 0 `change` is given; a
    /// system without a list of channels is its only one.
    ///
    /// # Errors
    /// As [`System::with`].
    pub(crate) fn with_each_channel(&self, change: impl Fn(usize, &mut Sections)) -> Result<Self> {
        if self.channels().is_empty() {
            return self.with(|sections| change(0, sections));
        }
        let mut content = Content::clone(&self.content);
        for (number, channel) in content.channels.iter_mut().enumerate() {
            channel.system = channel.system.with(|sections| change(number, sections))?;
        }
        // A system with channels has the sections of its first one.
        if let Some(first) = content.channels.first() {
            content.sections = Sections::clone(&first.system);
        }
        Ok(Self { content: Arc::new(content) })
    }

    /// Name of the scene in messages: its file or preset.
    pub fn name(&self) -> &str {
        &self.content.name
    }

    /// Directory to which relative file names in the scene refer.
    pub fn directory(&self) -> &Path {
        &self.content.directory
    }

    /// Path of a file that the scene names; a relative name refers to [`System::directory`].
    pub fn resolve(&self, file: impl AsRef<Path>) -> PathBuf {
        self.content.directory.join(file)
    }

    /// Seed of the aberrations; 1 in a scene without any.
    pub fn seed(&self) -> u64 {
        self.aberrations.as_ref().map_or(1, |aberrations| aberrations.seed)
    }

    /// Whether the system has a mirror of its own, and not only the default of every scene.
    pub fn has_mirror(&self) -> bool {
        self.content.has_mirror
    }

    /// Whether the scene says what changes the wavefront from image to image: an AO loop, its
    /// sensor, or layers of turbulence. The statistics of turbulence alone order the modes of a
    /// mirror.
    pub fn has_changing_wavefront(&self) -> bool {
        self.control.is_some() || self.wavefront_sensor.is_some() || !self.turbulence.fractions.is_empty()
    }

    /// Purpose for which the scene was read.
    pub(crate) fn purpose(&self) -> Purpose {
        self.content.purpose
    }

    /// The channels, in order; none for a system with one way of imaging.
    pub fn channels(&self) -> &[SystemChannel] {
        &self.content.channels
    }

    /// Refuses a system with several channels, for `who` (a noun in the plural), who images the
    /// wavefront in one way.
    ///
    /// # Errors
    /// [`Error::Scene`].
    pub(crate) fn refuse_channels(&self, who: &str) -> Result<()> {
        match self.channels() {
            [] => Ok(()),
            channels => Err(Error::Scene(format!(
                "{}: {who} have one channel, and the scene has {} ([[image.channel]]): give a scene of one channel, or give this one \
                 to 'cophase estimate', 'cophase simulate', Estimator::estimate or, in real time, \
                 ChannelFitters (cophase_model_create), which take several",
                self.name(),
                channels.len()
            ))),
        }
    }
}

impl Deref for System {
    type Target = Sections;

    fn deref(&self) -> &Sections {
        &self.content.sections
    }
}

#[cfg(test)]
mod tests {
    use crate::scene::{Crop, Optic, Scene, Sections};
    use std::path::Path;

    fn keck(settings: &[(&str, &str)]) -> Scene {
        Scene::preset("keck-artificial").unwrap().with(settings).unwrap()
    }

    #[test]
    fn changed_values_are_checked_as_those_of_a_text() {
        type Case<'a> = (fn(&mut Sections), [(&'a str, &'a str); 1], &'a str);
        let changes: [Case; 4] = [
            (|of| of.image.crop_pixels = Crop::Pixels(99), [("image.crop_pixels", "99")], "image.crop_pixels = 99"),
            (|of| of.image.pixel_fill = -0.1, [("image.pixel_fill", "-0.1")], "image.pixel_fill = -0.1"),
            (
                |of| of.pupil.central_obscuration_m = 20.0,
                [("pupil.central_obscuration_m", "20")],
                "pupil.central_obscuration_m = 20",
            ),
            (|of| of.image.interval_s = 1e-3, [("image.interval_s", "1e-3")], "image.interval_s = 0.001"),
        ];
        let scene = keck(&[]);
        for (change, settings, fact) in changes {
            let typed = scene.system().with(change).unwrap_err().to_string();
            let text = scene.with(&settings).unwrap_err().to_string();
            assert!(typed.contains(fact) && text.contains(fact), "{typed} | {text}");
            let [typed, text] = [&typed, &text].map(|sentence| sentence.split("accepted").nth(1).map(str::to_owned));
            assert_eq!(typed, text);
        }
    }

    #[test]
    fn adopted_text_has_the_values_of_each_parameter() {
        let base = [("image.pixel_fill", "0.9"), ("image.bandwidth_fraction", "0.01"), ("image.peak_snr", "77")];
        // The sampling and the defocus in other words give way where they are set, and only there.
        let words: [&[(&str, &str)]; 2] =
            [&[], &[("image.pixel_mas", "9.9"), ("image.diversity_focus_waves_pv", "5.0")]];
        for scene in words.map(|words| keck(&[&base, words].concat())) {
            // A map of the diversity takes the place of its focus.
            let fitted = Optic::all().filter(|optic| *optic != Optic::DIVERSITY);
            for parameter in fitted.flat_map(Optic::parameters) {
                let value = 1.01 * parameter.get(&scene) + 1e-3;
                let system = scene.system().with(|sections| parameter.set(sections, value)).unwrap();
                assert_eq!(parameter.get(&system), value, "{}", parameter.key);
                let adopted = scene.adopting(&system).unwrap();
                let read = Scene::from_text(adopted.text(), Path::new("")).unwrap();
                assert_eq!((read.system(), adopted.system()), (&system, &system), "{}", parameter.key);
                assert_ne!(read.system(), scene.system(), "{}", parameter.key);
            }
            assert_eq!(scene.adopting(scene.system()).unwrap().text(), scene.text());
        }
    }

    #[test]
    fn a_change_reaches_every_channel() {
        let scene = Scene::preset("keck-pair").unwrap();
        let system = scene.system().with(|sections| sections.pupil.illumination_x = 0.1).unwrap();
        assert_eq!(system.channels().len(), 2);
        assert!(system.channels().iter().all(|channel| channel.system.pupil.illumination_x == 0.1));
        let kept = system.channels().iter().zip(scene.channels());
        assert!(kept.into_iter().all(|(of, own)| of.system.image == own.scene.image));
        // A change of the second channel alone is one of the system, and of its text.
        let other = system.with_each_channel(|channel, sections| sections.image.count += channel).unwrap();
        assert_ne!(other, system);
        let adopted = scene.adopting(&other).unwrap();
        let read = Scene::from_text(adopted.text(), Path::new("")).unwrap();
        assert_eq!((read.system(), adopted.system()), (&other, &other));
    }
}

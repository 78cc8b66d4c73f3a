//! Scene: description of telescope, camera, aberrations, AO system and estimate, read from TOML and
//! validated as a whole.
//!
//! Only effects that a scene names are modelled. The fields of a [`Scene`] have the names of the
//! TOML keys.
//!
//! ```
//! use cophase::scene::Scene;
//!
//! let scene = Scene::preset("keck-artificial")?;
//! assert_eq!(scene.image.pixels, 480);
//! let faint = scene.with(&[("image.peak_snr", "50")])?;
//! assert_eq!(faint.image.peak_snr, Some(50.0));
//! # Ok::<(), cophase::Error>(())
//! ```

mod adaptive;
mod channel;
mod channel_scenes;
mod commands;
mod edit;
mod faults;
mod file;
mod fit;
mod forms;
mod lists;
mod optical_parameter;
mod own_form;
mod parameter;
mod pupil;
mod purpose;
mod reference;
mod section_keys;
mod sections;
mod setting;
mod system;
mod table;
mod telescope;
mod tolerance;
mod units;
mod unknown;
mod value;
mod words;

pub use adaptive::{ControlScene, LoopLag, MirrorScene, SensorScene, TurbulenceScene};
pub(crate) use channel::ImageList;
pub use commands::CommandsScene;
pub use edit::split_setting;
pub use faults::FaultScene;
pub use fit::{EstimateScene, ModesScene};
pub use lists::{NollRange, SegmentLabels};
pub use optical_parameter::OpticalParameter;
pub(crate) use own_form::rounded;
pub use parameter::Optic;
pub(crate) use parameter::{Changes, Parameter, ParameterKind, SearchRange};
pub use pupil::PupilScene;
pub(crate) use purpose::Purpose;
pub use sections::Sections;
pub use setting::Setting;
pub use system::{System, SystemChannel};
pub use telescope::{AberrationScene, ImageScene};
pub use tolerance::ToleranceScene;
pub(crate) use units::MAS_PER_RADIAN;
pub(crate) use value::SettingValue;
pub use words::{
    AoKnowledge, Aperture, Combine, ControlBasis, Crop, DeviceChoice, Fill, Grouping, Influence, Loop, Method,
    ModelChoice, NcpaBasis, OpticalGainMethod, Optimizer, Precision, PupilModel, ReconstructorKind, Sampling,
    SegmentConvention, SegmentModes, SensorDetector, SensorKind, SensorMask, SlopeNormalisation, SlopeOrder, Telemetry,
    Weighting,
};

use crate::{Error, Result};
use sections::directory_of_keys;
use std::ops::Deref;
use std::path::Path;
use std::sync::Arc;
use system::Origin;
use table::{Reader, Source, shown, suggestion};
use toml_edit::{Document, Item};

/// Validated, immutable scene: a [`System`], to which it dereferences, with the text that it was
/// read from. [`Scene::with`] makes a changed copy. Cloning is cheap.
#[derive(Debug, Clone)]
pub struct Scene {
    system: System,
    text: Arc<str>,
    channels: Arc<[Channel]>,
}

/// One way of imaging the wavefront.
#[derive(Debug, Clone)]
pub struct Channel {
    /// Its name; its number from 1 where the scene does not name it.
    pub name: String,
    /// The scene of this channel alone.
    pub scene: Scene,
}

/// Preset scenes: name and text.
const PRESETS: [(&str, &str); 13] = [
    ("keck-artificial", include_str!("presets/keck-artificial.toml")),
    ("keck-nirc2", include_str!("presets/keck-nirc2.toml")),
    ("keck-pair", include_str!("presets/keck-pair.toml")),
    ("keck-two-colour", include_str!("presets/keck-two-colour.toml")),
    ("jwst-pair", include_str!("presets/jwst-pair.toml")),
    ("gtc-artificial", include_str!("presets/gtc-artificial.toml")),
    ("tmt-artificial", include_str!("presets/tmt-artificial.toml")),
    ("elt-artificial", include_str!("presets/elt-artificial.toml")),
    ("gmt", include_str!("presets/gmt.toml")),
    ("keck-onsky", include_str!("presets/keck-onsky.toml")),
    ("keck-pyramid", include_str!("presets/keck-pyramid.toml")),
    ("tmt-onsky", include_str!("presets/tmt-onsky.toml")),
    ("elt-onsky", include_str!("presets/elt-onsky.toml")),
];

/// Names of the presets, in the order of [`PRESETS`].
const PRESET_NAMES: [&str; PRESETS.len()] = {
    let mut names = [""; PRESETS.len()];
    let mut i = 0;
    while i < PRESETS.len() {
        names[i] = PRESETS[i].0;
        i += 1;
    }
    names
};

impl Scene {
    /// Parses and validates a scene. Relative file names in it refer to `directory`.
    ///
    /// # Errors
    /// [`Error::Scene`] with the line, the key, its value and what is accepted.
    pub fn from_text(text: &str, directory: &Path) -> Result<Self> {
        Self::parse("scene", text, directory, Purpose::Whole, &[])
    }

    /// As [`Scene::from_text`], for a telescope whose pupil and modes are given as arrays: the keys
    /// of the pupil and of the modes may be incomplete without them. Such a scene can only be used
    /// together with these arrays.
    ///
    /// # Errors
    /// As [`Scene::from_text`].
    pub fn for_arrays(text: &str, directory: &Path) -> Result<Self> {
        Self::parse("scene", text, directory, Purpose::Arrays, &[])
    }

    /// As [`Scene::from_text`], for the scene in an image file: the files that it names may be
    /// missing where nothing reads them.
    ///
    /// # Errors
    /// As [`Scene::from_text`].
    pub(crate) fn embedded(text: &str, directory: &Path) -> Result<Self> {
        Self::parse("scene", text, directory, Purpose::Embedded, &[])
    }

    /// Reads a scene from a regular file or a pipe of at most 1 MiB. Relative file names in it
    /// refer to the file's directory; those of a pipe to the working directory.
    ///
    /// # Errors
    /// [`Error::File`] for a file that cannot be read as text, and those of [`Scene::from_text`].
    pub fn from_file(path: impl AsRef<Path>) -> Result<Self> {
        let path = path.as_ref();
        let (text, kind) = file::read_text(path)?;
        let is_stream = !kind.is_file() || path == Path::new("/dev/stdin");
        let directory = path.parent().filter(|_| !is_stream).unwrap_or(Path::new(""));
        Self::parse(&path.display().to_string(), &text, directory, Purpose::Whole, &[])
    }

    /// Preset scene. File names that are added to it are relative to the working directory.
    ///
    /// # Errors
    /// [`Error::Scene`] for a name that is not in [`Scene::preset_names`].
    pub fn preset(name: &str) -> Result<Self> {
        Self::parse(name, Self::preset_text(name)?, Path::new(""), Purpose::Whole, &[])
    }

    /// Text of a preset.
    ///
    /// # Errors
    /// As [`Scene::preset`].
    pub fn preset_text(name: &str) -> Result<&'static str> {
        PRESETS.iter().find(|(known, _)| *known == name).map(|(_, text)| *text).ok_or_else(|| {
            let known = Self::preset_names().join(", ");
            Error::Scene(format!(
                "there is no preset '{}'; {known} are accepted{}",
                shown(name),
                suggestion(name, PRESET_NAMES)
            ))
        })
    }

    /// Names of the presets.
    pub fn preset_names() -> &'static [&'static str] {
        &PRESET_NAMES
    }

    /// The scene as TOML text, including comments.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Whether the text names `key`, as `section.key`; otherwise the key has its default.
    pub fn names(&self, key: &str) -> bool {
        let Some((section, key)) = key.split_once('.') else { return false };
        let document = Document::parse(self.text());
        document.is_ok_and(|document| {
            document.get(section).and_then(Item::as_table_like).is_some_and(|table| table.contains_key(key))
        })
    }

    /// The system that the scene describes.
    pub fn system(&self) -> &System {
        &self.system
    }

    fn parse(name: &str, text: &str, directory: &Path, purpose: Purpose, settings: &[(&str, &str)]) -> Result<Self> {
        let source = Source { name, text, purpose, settings };
        let document = Document::parse(text).map_err(|error| {
            if is_name(text) {
                let name = shown(text.trim());
                return Error::Scene(format!(
                    "{}: '{name}' is a name and not the text of a scene; the text of that file or preset is needed",
                    source.name
                ));
            }
            let message = error.message().lines().collect::<Vec<_>>().join("; ");
            Error::Scene(format!("{}: not TOML: {message}", source.at(error.span())))
        })?;
        unknown::refuse(source, document.as_table(), &directory_of_keys())?;
        let channels = Self::parse_channels(source, &document, directory)?;
        // A scene with channels has the sections of its first one.
        let sections = match channels.first() {
            Some(first) => Sections::clone(&first.scene),
            None => {
                let mut sections = Sections::read(source, document.as_table())?;
                sections.convert_units(&|section| Reader { source, section, item: document.get(section) })?;
                sections
            }
        };
        sections.check_together(&|section| Reader { source, section, item: document.get(section) })?;
        let names_mirror = document.get("mirror").and_then(Item::as_table_like).is_some_and(|mirror| {
            ["actuators_across", "pitch_m", "actuator_file", "influence_file"]
                .iter()
                .any(|key| mirror.contains_key(key))
        });
        let origin = Origin { name, directory, purpose, names_mirror };
        let of = |Channel { name, scene }: &Channel| SystemChannel { name: name.clone(), system: scene.system.clone() };
        let system = System::new(sections, &origin, channels.iter().map(of).collect());
        Ok(Self { system, text: text.into(), channels: channels.into() })
    }
}

impl Deref for Scene {
    type Target = System;

    fn deref(&self) -> &System {
        &self.system
    }
}

/// Whether a text that is not TOML may be the name of a file or a preset: one line without the
/// signs of a section or a key.
fn is_name(text: &str) -> bool {
    let text = text.trim();
    !text.is_empty() && !text.contains(['\n', '=', '[', ']', '#', '"'])
}

/// Reference of every section and key of a scene, as text: unit, meaning, accepted values, default.
pub fn reference() -> String {
    reference::reference_of(directory_of_keys())
}

//! Scene: description of telescope, camera, aberrations, AO system and estimate, read from TOML and validated as a
//! whole.
//!
//! Only effects that a scene names are modelled. The fields of a [`Scene`] have the names of the TOML keys.
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
mod own_form;
mod pupil;
mod purpose;
mod reference;
mod section_keys;
mod table;
mod telescope;
mod units;
mod unknown;
mod value;
mod words;

pub use adaptive::{ControlScene, LoopLag, MirrorScene, SensorScene, TurbulenceScene};
pub use commands::CommandsScene;
pub use edit::split_setting;
pub use faults::FaultScene;
pub use fit::{EstimateScene, ModesScene};
pub use lists::{NollRange, SegmentLabels};
pub(crate) use own_form::rounded;
pub use pupil::PupilScene;
pub(crate) use purpose::Purpose;
pub use telescope::{AberrationScene, ImageScene};
pub(crate) use units::MAS_PER_RADIAN;
pub use words::{
    AoKnowledge, Aperture, Combine, ControlBasis, Crop, DeviceChoice, Fill, Influence, Loop, Method, ModelChoice,
    NcpaBasis, Optic, OpticalGainMethod, Optimizer, Precision, PupilModel, ReconstructorKind, Sampling,
    SegmentConvention, SegmentModes, SensorDetector, SensorKind, SensorMask, SlopeNormalisation, SlopeOrder, Telemetry,
    Weighting,
};

use crate::{Error, Result};
use section_keys::SectionKeys;
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use table::{Check, Reader, Section, Source, shown, suggestion};
use toml_edit::{Document, Item};

/// Validated, immutable scene. It dereferences to its [`Sections`]. [`Scene::with`] makes a changed copy. Cloning is
/// cheap.
#[derive(Debug, Clone)]
pub struct Scene {
    content: Arc<Content>,
}

/// One way of imaging the wavefront.
#[derive(Debug, Clone)]
pub struct Channel {
    /// Its name; its number from 1 where the scene does not name it.
    pub name: String,
    /// The scene of this channel alone.
    pub scene: Scene,
}

#[derive(Debug)]
struct Content {
    sections: Sections,
    text: String,
    /// Name of the scene in messages.
    name: String,
    directory: PathBuf,
    purpose: Purpose,
    channels: Vec<Channel>,
}

/// Declares the sections of a scene: their structs, their order, and which are optional.
macro_rules! sections {
    ($($(#[$doc:meta])+ $name:ident: $type:ty;)+) => {
        /// The sections of a scene.
        #[derive(Debug, Clone, PartialEq)]
        pub struct Sections { $($(#[$doc])+ pub $name: $type,)+ }

        impl Sections {
            fn read(source: Source, document: &toml_edit::Table) -> Result<Self> {
                Ok(Self { $($name: <$type>::read_checked(source, document.get(stringify!($name)))?,)+ })
            }
        }

        /// The table of all keys, section by section.
        fn directory_of_keys() -> Vec<SectionKeys> {
            vec![$(<$type>::listing()),+]
        }
    };
}

sections! {
    /// The telescope's pupil.
    pupil: PupilScene;
    /// The camera and its images.
    image: ImageScene;
    /// The truth of a simulated image.
    aberrations: Option<AberrationScene>;
    /// Faults planted in simulated images.
    faults: FaultScene;
    /// The modes that are estimated.
    modes: ModesScene;
    /// The deformable mirror.
    mirror: MirrorScene;
    /// The turbulence.
    turbulence: TurbulenceScene;
    /// The wavefront sensor of the AO loop.
    wavefront_sensor: Option<SensorScene>;
    /// The control of the AO loop.
    control: Option<ControlScene>;
    /// Settings of the estimate.
    estimate: EstimateScene;
    /// Terms of the controllers that take corrections.
    commands: CommandsScene;
}

/// Section as a field of [`Sections`]: always present (with defaults), or optional.
trait Entry: Sized {
    fn listing() -> SectionKeys;
    fn read_checked(source: Source, item: Option<&Item>) -> Result<Self>;
}

impl<S: Section + Check> Entry for S {
    fn listing() -> SectionKeys {
        SectionKeys { name: S::NAME, about: S::ABOUT, keys: S::keys() }
    }

    fn read_checked(source: Source, item: Option<&Item>) -> Result<Self> {
        let reader = Reader { source, section: S::NAME, item };
        let mut section = S::read(&reader)?;
        section.check(&reader)?;
        Ok(section)
    }
}

impl<S: Section + Check> Entry for Option<S> {
    fn listing() -> SectionKeys {
        S::listing()
    }

    fn read_checked(source: Source, item: Option<&Item>) -> Result<Self> {
        item.map(|item| S::read_checked(source, Some(item))).transpose()
    }
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

    /// As [`Scene::from_text`], for a telescope whose pupil and modes are given as arrays: the keys of the pupil and of
    /// the modes may be incomplete without them. Such a scene can only be used together with these arrays.
    ///
    /// # Errors
    /// As [`Scene::from_text`].
    pub fn for_arrays(text: &str, directory: &Path) -> Result<Self> {
        Self::parse("scene", text, directory, Purpose::Arrays, &[])
    }

    /// As [`Scene::from_text`], for the scene in an image file: the files that it names may be missing where nothing reads them.
    ///
    /// # Errors
    /// As [`Scene::from_text`].
    pub(crate) fn embedded(text: &str, directory: &Path) -> Result<Self> {
        Self::parse("scene", text, directory, Purpose::Embedded, &[])
    }

    /// Reads a scene from a regular file or a pipe of at most 1 MiB. Relative file names in it refer to the file's
    /// directory; those of a pipe to the working directory.
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
        &self.content.text
    }

    /// Name of the scene in messages: its file or preset.
    pub fn name(&self) -> &str {
        &self.content.name
    }

    /// Directory to which relative file names in the scene refer.
    pub fn directory(&self) -> &Path {
        &self.content.directory
    }

    /// Path of a file that the scene names; a relative name refers to [`Scene::directory`].
    pub fn resolve(&self, file: impl AsRef<Path>) -> PathBuf {
        self.content.directory.join(file)
    }

    /// Whether the text names `key`, as `section.key`; otherwise the key has its default.
    pub fn names(&self, key: &str) -> bool {
        let Some((section, key)) = key.split_once('.') else { return false };
        let document = Document::parse(self.text());
        document.is_ok_and(|document| {
            document.get(section).and_then(Item::as_table_like).is_some_and(|table| table.contains_key(key))
        })
    }

    /// Seed of the aberrations; 1 in a scene without any.
    pub fn seed(&self) -> u64 {
        self.aberrations.as_ref().map_or(1, |aberrations| aberrations.seed)
    }

    /// Whether the scene has a mirror of its own, and not only the default of every scene.
    pub fn has_mirror(&self) -> bool {
        let keys = ["mirror.actuators_across", "mirror.pitch_m", "mirror.actuator_file", "mirror.influence_file"];
        self.control.is_some() || keys.iter().any(|key| self.names(key))
    }

    /// Purpose for which the scene was read.
    pub(crate) fn purpose(&self) -> Purpose {
        self.content.purpose
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
                sections.convert_units(source, document.as_table())?;
                sections
            }
        };
        sections.check_together(source, document.as_table())?;
        let (text, name, directory) = (text.to_string(), name.to_string(), directory.to_path_buf());
        Ok(Self { content: Arc::new(Content { sections, text, name, directory, purpose, channels }) })
    }
}

impl Deref for Scene {
    type Target = Sections;

    fn deref(&self) -> &Sections {
        &self.content.sections
    }
}

impl Sections {
    /// Refuses sections that contradict each other.
    fn check_together(&self, source: Source, document: &toml_edit::Table) -> Result<()> {
        let reader = |section| Reader { source, section, item: document.get(section) };
        let samples = self.pupil.samples;
        if let Some(truth) = self.aberrations.as_ref().and_then(|aberrations| aberrations.truth_samples)
            && truth < samples
        {
            let sentence = format!(
                "aberrations.truth_samples = {truth} is not accepted; at least the estimator's pupil.samples = {samples} is needed"
            );
            return Err(reader("aberrations").error("truth_samples", sentence));
        }
        let planted = [
            ("segment_reflectivity_rms", self.faults.segment_reflectivity_rms),
            ("drift_nm_per_min", self.faults.drift_nm_per_min),
        ];
        if let Some((key, value)) = planted.iter().find(|(_, value)| *value > 0.0)
            && self.aberrations.is_none()
        {
            let sentence = format!(
                "faults.{key} = {value} is not accepted without aberrations; a section [aberrations] is needed"
            );
            return Err(reader("faults").error(key, sentence));
        }
        if self.control.is_some() && self.wavefront_sensor.is_none() {
            let sentence = "[control] is named without a sensor; a section [wavefront_sensor] is needed";
            return Err(reader("control").error("", sentence));
        }
        if self.wavefront_sensor.as_ref().is_some_and(SensorScene::is_pyramid)
            && self.control.as_ref().is_some_and(|control| control.reconstructor == ReconstructorKind::Sparse)
        {
            let sentence = "control.reconstructor = \"sparse\" is not accepted where wavefront_sensor.kind = \"pyramid\", whose slopes depend on the whole wavefront; \"dense\" is needed";
            return Err(reader("control").error("reconstructor", sentence));
        }
        if self.image.is_pupil_turned() {
            self.check_turns().map_err(|sentence| reader("image").error("pupil_turns_deg", sentence))?;
        }
        Ok(())
    }

    /// Why the pupil cannot turn as the scene says.
    fn check_turns(&self) -> std::result::Result<(), String> {
        if let Some(hindrance) = self.hindrance_of_turns() {
            return Err(format!("image.pupil_turns_deg is not accepted with {hindrance}"));
        }
        let turns_deg = self.image.pupil_turns_deg.iter().flatten();
        let widths_m = turns_deg.filter_map(|turn_deg| self.pupil.turned_by(*turn_deg).extent_m());
        let needed_m = widths_m.fold(0.0, f64::max);
        match self.pupil.grid_m.or(self.pupil.extent_m()) {
            Some(grid_m) if grid_m * (1.0 + 1e-9) < needed_m => Err(format!(
                "image.pupil_turns_deg turns the pupil beyond its grid of {grid_m:.4} m; pupil.grid_m of {needed_m:.4} or more is needed (λ/D in \
                 other keys means λ/grid_m)"
            )),
            _ => Ok(()),
        }
    }

    /// What in the scene does not go with a pupil that turns, and what does.
    fn hindrance_of_turns(&self) -> Option<&'static str> {
        let has_petals = self.modes.petals != SegmentModes::None
            || self.aberrations.as_ref().is_some_and(AberrationScene::has_petals);
        let has_loop = self.wavefront_sensor.is_some() || !self.turbulence.fractions.is_empty();
        [
            (matches!(self.pupil.aperture, Aperture::File(_)), "a pupil from a file; hexagons or discs are needed"),
            (self.pupil.model == Some(PupilModel::Hard), "pupil.model = \"hard\"; \"band-limited\" is needed"),
            (
                self.modes.segment == SegmentModes::PistonTipTilt,
                "modes.segment = \"piston-tip-tilt\"; \"piston\" is needed",
            ),
            (matches!(self.modes.ncpa, NcpaBasis::File(_)), "modes.ncpa from a file; \"kl\" or \"zernike\" is needed"),
            (has_petals, "petals, of which the scene must have none"),
            (has_loop, "adaptive optics or turbulence: images of one static wavefront are needed"),
            (self.estimate.method == Method::FullPhase, "estimate.method = \"full-phase\"; \"modal\" is needed"),
        ]
        .into_iter()
        .find_map(|(is_there, what)| is_there.then_some(what))
    }
}

/// Whether a text that is not TOML may be the name of a file or a preset: one line without the signs of a section or a key.
fn is_name(text: &str) -> bool {
    let text = text.trim();
    !text.is_empty() && !text.contains(['\n', '=', '[', ']', '#', '"'])
}

/// Reference of every section and key of a scene, as text: unit, meaning, accepted values, default.
pub fn reference() -> String {
    reference::reference_of(directory_of_keys())
}

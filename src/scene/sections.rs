//! Sections of a scene, as numbers and words: which there are, how they are read and checked, and
//! what contradicts each other between them.

use super::adaptive::{ControlScene, MirrorScene, SensorScene, TurbulenceScene};
use super::commands::CommandsScene;
use super::faults::FaultScene;
use super::fit::{EstimateScene, ModesScene};
use super::forms;
use super::pupil::PupilScene;
use super::section_keys::SectionKeys;
use super::table::{Check, Reader, Section, Source, check_ranges};
use super::telescope::{AberrationScene, ImageScene};
use super::tolerance::ToleranceScene;
use super::value::SettingValue;
use super::words::{Aperture, Method, NcpaBasis, PupilModel, ReconstructorKind, SegmentModes};
use crate::Result;
use toml_edit::Item;

/// Declares the sections of a scene: their structs, their order, and which are optional.
macro_rules! sections {
    ($($(#[$doc:meta])+ $name:ident: $type:ty;)+) => {
        /// The sections of a scene.
        #[derive(Debug, Clone, PartialEq)]
        pub struct Sections { $($(#[$doc])+ pub $name: $type,)+ }

        impl Sections {
            pub(super) fn read(source: Source, document: &toml_edit::Table) -> Result<Self> {
                Ok(Self { $($name: <$type>::read_checked(source, document.get(stringify!($name)))?,)+ })
            }

            /// Keys whose values differ from those of `other`, as section, key and value in TOML
            /// syntax; an empty value is that of a key without one.
            pub(super) fn differences(&self, other: &Self) -> Vec<(&'static str, &'static str, String)> {
                let mut all = Vec::new();
                $(self.$name.add_differences(&other.$name, &mut all);)+
                let image = &self.image;
                let is_derived = |key: &str| {
                    (key == forms::SAMPLING[0] && image.named_sampling().is_some())
                        || (key == forms::FOCUS[0] && image.named_focus().is_some())
                };
                // What follows from another key is no key of the text.
                all.iter_mut().filter(|(_, key, _)| is_derived(key)).for_each(|(.., value)| value.clear());
                all
            }

            /// Value of the key `name` of a section, as a setting holds it.
            pub(super) fn value(&self, section: &str, name: &str) -> Option<SettingValue> {
                match section {
                    $(stringify!($name) => self.$name.value_of(name),)+
                    _ => None,
                }
            }

            /// Sets the key `name` of a section, or leaves it out where there is no value; false
            /// where the key does not exist or accepts no such value.
            pub(super) fn set_value(&mut self, section: &str, name: &str, value: Option<&SettingValue>) -> bool {
                match section {
                    $(stringify!($name) => self.$name.set_value_of(name, value),)+
                    _ => false,
                }
            }

            fn check_sections(&self, source: Source) -> Result<()> {
                $(self.$name.check_again(source)?;)+
                Ok(())
            }
        }

        /// The table of all keys, section by section.
        pub(super) fn directory_of_keys() -> Vec<SectionKeys> {
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
    /// How well the instrument is known.
    tolerance: ToleranceScene;
    /// Terms of the controllers that take corrections.
    commands: CommandsScene;
}

/// Section as a field of [`Sections`]: always present (with defaults), or optional.
trait Entry: Sized {
    fn listing() -> SectionKeys;
    fn read_checked(source: Source, item: Option<&Item>) -> Result<Self>;
    /// Checks values that were changed after they were read.
    fn check_again(&self, source: Source) -> Result<()>;
    fn add_differences(&self, other: &Self, all: &mut Vec<(&'static str, &'static str, String)>);
    /// As [`Section::value`].
    fn value_of(&self, key: &str) -> Option<SettingValue>;
    /// As [`Section::set_value`].
    fn set_value_of(&mut self, key: &str, value: Option<&SettingValue>) -> bool;
}

impl<S: Section + Check> Entry for S {
    fn listing() -> SectionKeys {
        SectionKeys { name: S::NAME, about: S::ABOUT, keys: S::keys() }
    }

    fn read_checked(source: Source, item: Option<&Item>) -> Result<Self> {
        let reader = Reader { source, section: S::NAME, item };
        let mut section = S::read(&reader)?;
        section.complete(&reader)?;
        section.check(&reader)?;
        Ok(section)
    }

    fn check_again(&self, source: Source) -> Result<()> {
        check_ranges(self, source)?;
        self.check(&Reader { source, section: S::NAME, item: None })
    }

    fn add_differences(&self, other: &Self, all: &mut Vec<(&'static str, &'static str, String)>) {
        all.extend(self.differences(other).into_iter().map(|(key, value)| (S::NAME, key, value)));
    }

    fn value_of(&self, key: &str) -> Option<SettingValue> {
        Section::value(self, key)
    }

    fn set_value_of(&mut self, key: &str, value: Option<&SettingValue>) -> bool {
        Section::set_value(self, key, value)
    }
}

impl<S: Section + Check> Entry for Option<S> {
    fn listing() -> SectionKeys {
        S::listing()
    }

    fn read_checked(source: Source, item: Option<&Item>) -> Result<Self> {
        item.map(|item| S::read_checked(source, Some(item))).transpose()
    }

    fn check_again(&self, source: Source) -> Result<()> {
        self.as_ref().map_or(Ok(()), |section| section.check_again(source))
    }

    fn add_differences(&self, other: &Self, all: &mut Vec<(&'static str, &'static str, String)>) {
        if let (Some(own), Some(other)) = (self, other) {
            own.add_differences(other, all);
        }
    }

    fn value_of(&self, key: &str) -> Option<SettingValue> {
        Section::value(self.as_ref()?, key)
    }

    fn set_value_of(&mut self, key: &str, value: Option<&SettingValue>) -> bool {
        self.as_mut().is_some_and(|section| Section::set_value(section, key, value))
    }
}

impl Sections {
    /// Converts and checks values that were changed after they were read.
    pub(super) fn check_values(&mut self, source: Source) -> Result<()> {
        let reader = |section| Reader { source, section, item: None };
        self.convert_units(&reader)?;
        self.check_sections(source)?;
        self.check_together(&reader)
    }

    /// Refuses sections that contradict each other.
    pub(super) fn check_together<'r>(&self, reader: &dyn Fn(&'static str) -> Reader<'r>) -> Result<()> {
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
        // The amplitude of the diversity needs no step.
        let usual = ToleranceScene { defocus_fraction: self.tolerance.defocus_fraction, ..ToleranceScene::usual()? };
        let named = self.tolerance.differences(&usual).into_iter().next();
        if let Some((key, value)) = named.filter(|_| !self.estimate.has_posterior()) {
            let sentence = format!(
                "tolerance.{key} = {value} has no effect where estimate.posterior = false, and without noise weights or estimate.method = \"modal\"; \
                 leave it out"
            );
            return Err(reader("tolerance").error(key, sentence));
        }
        if self.image.is_pupil_turned() {
            self.check_turns().map_err(|sentence| reader("image").error("pupil_turns_deg", sentence))?;
        }
        Ok(())
    }

    /// Turns `estimate.posterior` off, and unsets the tolerances, which then have no effect: for
    /// one channel of several, whose estimate has what the modes of all leave out.
    pub(crate) fn leave_out_posterior(&mut self) {
        if let Ok(usual) = ToleranceScene::usual() {
            let defocus_fraction = self.tolerance.defocus_fraction;
            (self.estimate.posterior, self.tolerance) = (Some(false), ToleranceScene { defocus_fraction, ..usual });
        }
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

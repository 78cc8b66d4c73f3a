//! Optical parameters: the numbers of the optics on which images depend. Fits, searches and checks
//! of the optics, the words of `estimate.fit_optics` and their reference read this table: a
//! parameter that is fitted is a row of it.

use super::pupil::PupilScene;
use super::telescope::ImageScene;
use super::value::{FromToml, Range, items};
use super::words::one_of;
use std::fmt;
use std::ops::RangeInclusive;
use toml_edit::Value;

/// Step of a filter's width.
const WIDTH_STEP: f64 = 1e-3;
/// Step of the side of a pixel's square: it changes the highest frequencies of the image by 2 %.
const FILL_STEP: f64 = 0.03;
/// Step of the width of the diffusion, in pixels: at 0.4 pixels it changes the highest frequencies
/// of the image by 1 to 4 %.
const DIFFUSION_STEP: f64 = 0.01;
/// Step of the obscuration's diameter relative to the pupil: the pupil's area changes by 0.1 % at a
/// third of its diameter.
const OBSCURATION_STEP: f64 = 2e-3;
/// Step of the spider's width, m.
const SPIDER_STEP_M: f64 = 1e-3;
/// Step of a term of the illumination: as that of a segment's amplitude.
const ILLUMINATION_STEP: f64 = 0.02;

/// What `estimate.fit_optics` fits in addition to the modes: a number of the scene, some that
/// belong together, or the light that each segment reflects.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Optic {
    /// Number of its row.
    row: usize,
}

/// A word of `estimate.fit_optics`.
struct Row {
    word: &'static str,
    about: &'static str,
    /// Its place among those that a check of images examines; `None` for one that it does not.
    check: Option<u8>,
    /// What else has the same effect, of one whose wrong value is a likely cause where the scene
    /// does not explain an image.
    cause: Option<&'static str>,
    /// None for the reflectivities, which are 1 in every scene.
    parameters: &'static [Parameter],
}

/// A number of the optics on which images depend.
#[derive(Debug)]
pub(crate) struct Parameter {
    /// Its key in a scene, in whose unit its values are.
    pub(crate) key: &'static str,
    /// What of a model changes with it.
    pub(crate) changes: Changes,
    absence: fn(&PupilScene, &ImageScene) -> Option<&'static str>,
    step: fn(&PupilScene, &ImageScene) -> f64,
    search: fn(&PupilScene, &ImageScene) -> Option<SearchRange>,
    least_fault: fn(f64) -> f64,
}

/// What of a model, beside the imaging, changes with a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Changes {
    /// Nothing.
    Imaging,
    /// The frames to which images are reduced.
    Samples,
    /// How many wavelengths are enough.
    Wavelengths,
    /// The modes, which are those of the segments' places.
    Modes,
    /// The part of the pupil that has light, and beyond which modes are 0.
    Light,
}

/// What a parameter describes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ParameterKind {
    /// Scale or shadow: the objective can have several minima along it.
    Telescope,
    /// Filter or pixel, which blur the image: the objective has one minimum along it.
    Camera,
}

/// Where a parameter is searched for.
#[derive(Debug, Clone)]
pub(crate) struct SearchRange {
    pub(crate) kind: ParameterKind,
    pub(crate) range: RangeInclusive<f64>,
    /// About the half-width of the minimum.
    pub(crate) first_step: f64,
    /// Step at which the search ends: the remaining error raises χ² by some hundredths.
    pub(crate) last_step: f64,
}

impl Optic {
    /// Pixels per λ/D.
    pub const PLATE_SCALE: Self = Self::named("plate-scale");
    /// Rotation of the pupil.
    pub const ROTATION: Self = Self::named("rotation");
    /// Amplitude of the defocus.
    pub const DEFOCUS: Self = Self::named("defocus");
    /// Amplitude of a diversity from a file.
    pub const DIVERSITY: Self = Self::named("diversity");
    /// Side of a pixel's sensitive square.
    pub const PIXEL_FILL: Self = Self::named("pixel-fill");
    /// Diameter of the central obscuration.
    pub const OBSCURATION: Self = Self::named("obscuration");
    /// Width of the spider's vanes.
    pub const SPIDERS: Self = Self::named("spiders");
    /// Diameter and centre of the stop of a camera.
    pub const STOP: Self = Self::named("stop");
    /// Light that each segment reflects.
    pub const REFLECTIVITIES: Self = Self::named("reflectivities");
    /// Slopes of the light over the pupil, and its rise from the centre to the edge.
    pub const ILLUMINATION: Self = Self::named("illumination");

    /// The row with this word; a word that no row has is an error of compilation.
    const fn named(word: &str) -> Self {
        let mut row = 0;
        while !is_equal(ROWS[row].word, word) {
            row += 1;
        }
        Self { row }
    }

    fn row(self) -> &'static Row {
        &ROWS[self.row]
    }

    /// All, in the order of the table, in which a search tries them.
    pub(crate) fn all() -> impl Iterator<Item = Self> {
        (0..ROWS.len()).map(|row| Self { row })
    }

    /// Those that a check of images examines, in its order.
    pub(crate) fn examined() -> Vec<Self> {
        let mut examined: Vec<Self> = Self::all().filter(|optic| optic.row().check.is_some()).collect();
        examined.sort_by_key(|optic| optic.row().check);
        examined
    }

    /// Its word in a scene.
    pub fn word(self) -> &'static str {
        self.row().word
    }

    /// Its name in tables and sentences.
    pub fn name(self) -> String {
        self.row().word.replace('-', " ")
    }

    /// What it describes.
    pub(crate) fn about(self) -> &'static str {
        self.row().about
    }

    /// What else has the same effect, of one whose wrong value is a likely cause where the scene
    /// does not explain an image.
    pub(crate) fn as_cause(self) -> Option<&'static str> {
        self.row().cause
    }

    /// The numbers of the scene that it stands for; none for the reflectivities, which are 1 in
    /// every scene.
    pub(crate) fn parameters(self) -> &'static [Parameter] {
        self.row().parameters
    }

    /// Key of the scene that gives its value; `None` for the reflectivities, which are 1 in every
    /// scene, and for the illumination, which has several keys.
    pub fn key(self) -> Option<&'static str> {
        match self.parameters() {
            [one] => Some(one.key),
            _ => None,
        }
    }

    /// Its word with the keys that it fits, for the reference.
    pub(super) fn listed(self) -> String {
        let keys: Vec<&str> = self.parameters().iter().map(|parameter| parameter.key).collect();
        let of = match keys.split_last() {
            None => "of each segment".into(),
            Some((last, [])) => (*last).to_owned(),
            Some((last, others)) => format!("{} and {last}", others.join(", ")),
        };
        format!("{:?} ({of})", self.word())
    }
}

/// Equality of two words, also during compilation.
const fn is_equal(one: &str, other: &str) -> bool {
    let (one, other) = (one.as_bytes(), other.as_bytes());
    let mut at = 0;
    while at < one.len() && at < other.len() && one[at] == other[at] {
        at += 1;
    }
    at == one.len() && at == other.len()
}

impl fmt::Debug for Optic {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.word())
    }
}

impl FromToml for Vec<Optic> {
    fn accepted(_: &Range) -> String {
        format!("a list of {}", one_of(&Optic::all().map(Optic::word).collect::<Vec<_>>()))
    }
    fn from_toml(value: &Value, _: &Range) -> Option<Self> {
        let named = |item: &Value| item.as_str().and_then(|word| Optic::all().find(|optic| optic.word() == word));
        let optics: Self = items(value, named)?;
        let twice = (1..optics.len()).any(|i| optics[..i].contains(&optics[i]));
        (!twice).then_some(optics)
    }
    fn to_toml(&self) -> String {
        format!("{:?}", self.iter().map(|optic| optic.word()).collect::<Vec<_>>())
    }
}

impl Parameter {
    /// What in a scene has no such parameter, or an image that does not depend on it to first
    /// order.
    pub(crate) fn absence(&self, pupil: &PupilScene, image: &ImageScene) -> Option<&'static str> {
        (self.absence)(pupil, image)
    }

    /// Step of a difference of images that is their derivative by this parameter: about a twentieth
    /// of a pixel at the rim of a spot.
    pub(crate) fn step(&self, pupil: &PupilScene, image: &ImageScene) -> f64 {
        (self.step)(pupil, image)
    }

    /// Smallest difference of the images' value from the scene's that is a fault. The model is not
    /// exact: it has finitely many samples of the pupil and of modes.
    pub(crate) fn least_fault(&self, of_scene: f64) -> f64 {
        (self.least_fault)(of_scene)
    }

    /// Where the parameter is searched for in images that a scene does not explain; `None` where it
    /// is not.
    pub(crate) fn search(&self, pupil: &PupilScene, image: &ImageScene) -> Option<SearchRange> {
        (self.search)(pupil, image)
    }
}

impl Changes {
    /// Whether the pupil has another geometry.
    pub(crate) fn is_of_pupil(self) -> bool {
        matches!(self, Self::Modes | Self::Light)
    }
}

impl PartialEq for Parameter {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key
    }
}

/// What most parameters have: every scene has them, they change the imaging alone, and no search or
/// check looks for them.
const USUAL: Parameter = Parameter {
    key: "",
    changes: Changes::Imaging,
    absence: |_, _| None,
    step: |_, _| f64::NAN,
    search: |_, _| None,
    least_fault: |_| f64::INFINITY,
};

/// The table.
static ROWS: &[Row] = &[
    Row {
        word: "plate-scale",
        about: "pixels per λ/D",
        check: Some(1),
        cause: Some("another wavelength or size of the pupil has the same effect"),
        parameters: &[Parameter {
            key: "image.samples_per_lambda_over_d",
            changes: Changes::Samples,
            step: |_, image| 1e-3 * image.samples_per_lambda_over_d,
            search: |_, image| {
                let sampling = image.samples_per_lambda_over_d;
                Some(SearchRange {
                    kind: ParameterKind::Telescope,
                    range: 0.97 * sampling..=1.03 * sampling,
                    first_step: 0.01 * sampling,
                    last_step: 0.0003 * sampling,
                })
            },
            least_fault: |of_scene| 1e-3 * of_scene.abs(),
            ..USUAL
        }],
    },
    Row {
        word: "rotation",
        about: "rotation of the pupil",
        check: Some(2),
        cause: None,
        parameters: &[Parameter {
            key: "pupil.rotation_deg",
            changes: Changes::Modes,
            absence: |pupil, _| pupil.extent_m().is_none().then_some(FILE),
            step: |_, _| 0.05,
            least_fault: |_| 0.1,
            ..USUAL
        }],
    },
    Row {
        word: "defocus",
        about: "amplitude of the defocus",
        // It is among the modes.
        check: None,
        cause: None,
        parameters: &[Parameter {
            key: "image.diversity_focus_waves_rms",
            absence: |_, image| image.diversity_file.is_some().then_some("a diversity from a file"),
            step: |_, _| 5e-3,
            ..USUAL
        }],
    },
    Row {
        word: "diversity",
        about: "amplitude of the diversity from a file",
        check: None,
        cause: None,
        parameters: &[Parameter {
            key: "image.diversity_scale",
            absence: |_, image| image.diversity_file.is_none().then_some("a scene without image.diversity_file"),
            step: |_, _| 5e-3,
            ..USUAL
        }],
    },
    Row {
        word: "bandwidth",
        about: "width of the filter",
        check: Some(6),
        cause: None,
        parameters: &[Parameter {
            key: "image.bandwidth_fraction",
            changes: Changes::Wavelengths,
            absence: |_, image| match image.filter_file {
                Some(_) => Some("a filter from a file"),
                // The image depends on the square of the width: its derivative at 0 is 0.
                None => (image.bandwidth_fraction == 0.0).then_some("light of one wavelength"),
            },
            step: |_, image| WIDTH_STEP.min(0.5 * image.bandwidth_fraction),
            // The width of a filter from a file is known.
            search: |_, image| {
                image.filter_file.is_none().then_some(SearchRange {
                    kind: ParameterKind::Camera,
                    // From narrow-band filters, 1 to 2 %, to those of the atmosphere's windows, 15
                    // to 20 %.
                    range: 0.0..=0.25,
                    first_step: 0.01,
                    last_step: 0.001,
                })
            },
            least_fault: |of_scene| 0.05 * of_scene.abs(),
        }],
    },
    Row {
        word: "pixel-fill",
        about: "side of a pixel's sensitive square",
        check: Some(7),
        cause: None,
        parameters: &[Parameter {
            key: "image.pixel_fill",
            // The image depends on the square of the side.
            absence: |_, image| (image.pixel_fill == 0.0).then_some("a detector whose pixels are points"),
            step: |_, image| FILL_STEP.min(0.5 * image.pixel_fill),
            search: |_, image| {
                image.has_samples_of_pixels().then_some(SearchRange {
                    kind: ParameterKind::Camera,
                    range: 0.0..=1.2,
                    first_step: 0.5,
                    last_step: 0.05,
                })
            },
            least_fault: |_| 0.05,
            ..USUAL
        }],
    },
    Row {
        word: "charge-diffusion",
        about: "width of the diffusion of charge between pixels",
        // Its effect is nearly that of the pixels' side, which is examined.
        check: None,
        cause: None,
        parameters: &[Parameter {
            key: "image.charge_diffusion_pixels",
            // The image depends on the square of the width.
            absence: |_, image| {
                (image.charge_diffusion_pixels == 0.0).then_some("a detector without a diffusion of charge")
            },
            step: |_, image| DIFFUSION_STEP.min(0.5 * image.charge_diffusion_pixels),
            ..USUAL
        }],
    },
    Row {
        word: "obscuration",
        about: "diameter of the central obscuration",
        check: Some(4),
        cause: None,
        parameters: &[Parameter {
            key: "pupil.central_obscuration_m",
            changes: Changes::Light,
            absence: |pupil, _| match pupil.extent_m() {
                None => Some(FILE),
                Some(_) => (pupil.central_obscuration_m == 0.0).then_some("a pupil without an obscuration"),
            },
            step: |pupil, _| OBSCURATION_STEP * pupil.extent_m().unwrap_or(1.0),
            search: |pupil, _| shadow(pupil, pupil.central_obscuration_m, 0.5, 1e-2, 2.5e-4),
            least_fault: |_| 0.05,
        }],
    },
    Row {
        word: "spiders",
        about: "width of the spider's vanes",
        check: Some(5),
        cause: None,
        parameters: &[Parameter {
            key: "pupil.spider_width_m",
            changes: Changes::Light,
            absence: |pupil, _| match pupil.extent_m() {
                None => Some(FILE),
                Some(_) => (pupil.spider_width_m == 0.0).then_some("a pupil without a spider"),
            },
            step: |pupil, _| SPIDER_STEP_M.min(0.5 * pupil.spider_width_m),
            search: |pupil, _| shadow(pupil, pupil.spider_width_m, 0.01, 1e-3, 5e-5),
            least_fault: |_| 0.005,
        }],
    },
    Row {
        word: "stop",
        about: "diameter and centre of the stop of the camera",
        check: None,
        cause: None,
        parameters: &[stop("pupil.stop_diameter_m"), stop("pupil.stop_x_m"), stop("pupil.stop_y_m")],
    },
    Row {
        word: "reflectivities",
        about: "light that each segment reflects",
        check: None,
        cause: None,
        parameters: &[],
    },
    Row {
        word: "illumination",
        about: "light over the pupil",
        check: Some(3),
        cause: None,
        parameters: &[
            illumination("pupil.illumination_x"),
            illumination("pupil.illumination_y"),
            illumination("pupil.illumination_edge"),
        ],
    },
];

const fn stop(key: &'static str) -> Parameter {
    Parameter {
        key,
        changes: Changes::Light,
        absence: |pupil, _| match pupil.extent_m() {
            None => Some(FILE),
            Some(_) => (pupil.stop_diameter_m == 0.0).then_some("a pupil without a stop"),
        },
        step: |pupil, _| OBSCURATION_STEP * pupil.extent_m().unwrap_or(1.0),
        least_fault: |_| 0.05,
        ..USUAL
    }
}

/// What has no shadows and no rotation of its own: its map includes them.
const FILE: &str = "a pupil from a file";

const fn illumination(key: &'static str) -> Parameter {
    Parameter { key, step: |_, _| ILLUMINATION_STEP, least_fault: |_| 0.02, ..USUAL }
}

/// Search for a shadow of the pupil, which is `own` in the scene; steps are fractions of the
/// pupil's width, for half a percent of its area and less: on Keck 10 cm of an obscuration's
/// diameter and 1 cm of the spider's width.
fn shadow(pupil: &PupilScene, own: f64, farthest: f64, first_step: f64, last_step: f64) -> Option<SearchRange> {
    pupil.extent_m().map(|width_m| SearchRange {
        kind: ParameterKind::Telescope,
        range: 0.0..=(farthest * width_m).max(1.5 * own),
        first_step: first_step * width_m,
        last_step: last_step * width_m,
    })
}

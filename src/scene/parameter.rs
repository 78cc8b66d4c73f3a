//! Parameters: the numbers of the optics on which images depend, a row each. Fits, searches and checks of the optics read this table.

use super::sections::Sections;
use super::words::Optic;
use std::ops::RangeInclusive;

/// Step of a filter's width.
const WIDTH_STEP: f64 = 1e-3;
/// Step of the side of a pixel's square: it changes the highest frequencies of the image by 2 %.
const FILL_STEP: f64 = 0.03;
/// Step of the obscuration's diameter relative to the pupil: the pupil's area changes by 0.1 % at a third of its diameter.
const OBSCURATION_STEP: f64 = 2e-3;
/// Step of the spider's width, m.
const SPIDER_STEP_M: f64 = 1e-3;
/// Step of a term of the illumination: as that of a segment's amplitude.
const ILLUMINATION_STEP: f64 = 0.02;

/// A number of the optics on which images depend.
#[derive(Debug)]
pub(crate) struct Parameter {
    /// Its key in a scene, in whose unit its values are.
    pub(crate) key: &'static str,
    /// The word of `estimate.fit_optics` that it belongs to.
    pub(crate) optic: Optic,
    get: fn(&Sections) -> f64,
    set: fn(&mut Sections, f64),
    absence: fn(&Sections) -> Option<&'static str>,
    step: fn(&Sections) -> f64,
    search: fn(&Sections) -> Option<SearchRange>,
    least_fault: fn(f64) -> f64,
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

impl Parameter {
    /// The parameters that `optic` stands for; none for the reflectivities, which are 1 in every scene.
    pub(crate) fn of(optic: Optic) -> impl Iterator<Item = &'static Self> {
        PARAMETERS.iter().filter(move |parameter| parameter.optic == optic)
    }

    pub(crate) fn get(&self, sections: &Sections) -> f64 {
        (self.get)(sections)
    }

    pub(crate) fn set(&self, sections: &mut Sections, value: f64) {
        (self.set)(sections, value);
    }

    /// What in `sections` has no such parameter, or an image that does not depend on it to first order.
    pub(crate) fn absence(&self, sections: &Sections) -> Option<&'static str> {
        (self.absence)(sections)
    }

    /// Step of a difference of images that is their derivative by this parameter: about a twentieth of a pixel at the rim of a spot.
    pub(crate) fn step(&self, sections: &Sections) -> f64 {
        (self.step)(sections)
    }

    /// Smallest difference of the images' value from the scene's that is a fault. The model is not exact: it has finitely many samples of
    /// the pupil and of modes.
    pub(crate) fn least_fault(&self, of_scene: f64) -> f64 {
        (self.least_fault)(of_scene)
    }

    /// Where the parameter is searched for in images that `sections` do not explain; `None` where it is not.
    pub(crate) fn search(&self, sections: &Sections) -> Option<SearchRange> {
        (self.search)(sections)
    }
}

impl Optic {
    /// Key of the scene that gives its value; `None` for the reflectivities, which are 1 in every scene, and for the
    /// illumination, which has several keys.
    pub fn key(&self) -> Option<&'static str> {
        let mut parameters = Parameter::of(*self);
        parameters.next().filter(|_| parameters.next().is_none()).map(|parameter| parameter.key)
    }
}

impl PartialEq for Parameter {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key
    }
}

/// The table, in the order in which a search tries them.
pub(crate) static PARAMETERS: [Parameter; 10] = [
    Parameter {
        key: "image.samples_per_lambda_over_d",
        optic: Optic::PlateScale,
        get: |of| of.image.samples_per_lambda_over_d,
        set: |of, value| {
            of.image.samples_per_lambda_over_d = value;
            // Other forms give way.
            (of.image.pixel_mas, of.image.pixel_arcsec, of.image.pixel_pitch_um) = (None, None, None);
        },
        absence: |_| None,
        step: |of| 1e-3 * of.image.samples_per_lambda_over_d,
        search: |of| {
            let sampling = of.image.samples_per_lambda_over_d;
            Some(SearchRange {
                kind: ParameterKind::Telescope,
                range: 0.97 * sampling..=1.03 * sampling,
                first_step: 0.01 * sampling,
                last_step: 0.0003 * sampling,
            })
        },
        least_fault: |of_scene| 1e-3 * of_scene.abs(),
    },
    Parameter {
        key: "image.bandwidth_fraction",
        optic: Optic::Bandwidth,
        get: |of| of.image.bandwidth_fraction,
        set: |of, value| of.image.bandwidth_fraction = value,
        absence: |of| match &of.image {
            image if image.filter_file.is_some() => Some("a filter from a file"),
            // The image depends on the square of the width: its derivative at 0 is 0.
            image if image.bandwidth_fraction == 0.0 => Some("light of one wavelength"),
            _ => None,
        },
        step: |of| WIDTH_STEP.min(0.5 * of.image.bandwidth_fraction),
        // The width of a filter from a file is known.
        search: |of| {
            let is_unknown = of.estimate.wavelengths.is_none() && of.image.filter_file.is_none();
            is_unknown.then_some(SearchRange {
                kind: ParameterKind::Camera,
                // From narrow-band filters, 1 to 2 %, to those of the atmosphere's windows, 15 to 20 %.
                range: 0.0..=0.25,
                first_step: 0.01,
                last_step: 0.001,
            })
        },
        least_fault: |of_scene| 0.05 * of_scene.abs(),
    },
    Parameter {
        key: "image.pixel_fill",
        optic: Optic::PixelFill,
        get: |of| of.image.pixel_fill,
        set: |of, value| of.image.pixel_fill = value,
        // The image depends on the square of the side.
        absence: |of| (of.image.pixel_fill == 0.0).then_some("a detector whose pixels are points"),
        step: |of| FILL_STEP.min(0.5 * of.image.pixel_fill),
        search: |of| {
            of.image.has_samples_of_pixels().then_some(SearchRange {
                kind: ParameterKind::Camera,
                range: 0.0..=1.2,
                first_step: 0.5,
                last_step: 0.05,
            })
        },
        least_fault: |_| 0.05,
    },
    Parameter {
        key: "pupil.central_obscuration_m",
        optic: Optic::Obscuration,
        get: |of| of.pupil.central_obscuration_m,
        set: |of, value| of.pupil.central_obscuration_m = value,
        absence: |of| match &of.pupil {
            pupil if pupil.extent_m().is_none() => Some(FILE),
            pupil if pupil.central_obscuration_m == 0.0 => Some("a pupil without an obscuration"),
            _ => None,
        },
        step: |of| OBSCURATION_STEP * of.pupil.extent_m().unwrap_or(1.0),
        search: |of| shadow(of, of.pupil.central_obscuration_m, 0.5, 1e-2, 2.5e-4),
        least_fault: |_| 0.05,
    },
    Parameter {
        key: "pupil.spider_width_m",
        optic: Optic::Spiders,
        get: |of| of.pupil.spider_width_m,
        set: |of, value| of.pupil.spider_width_m = value,
        absence: |of| match &of.pupil {
            pupil if pupil.extent_m().is_none() => Some(FILE),
            pupil if pupil.spider_width_m == 0.0 => Some("a pupil without a spider"),
            _ => None,
        },
        step: |of| SPIDER_STEP_M.min(0.5 * of.pupil.spider_width_m),
        search: |of| shadow(of, of.pupil.spider_width_m, 0.01, 1e-3, 5e-5),
        least_fault: |_| 0.005,
    },
    Parameter {
        key: "pupil.rotation_deg",
        optic: Optic::Rotation,
        get: |of| of.pupil.rotation_deg,
        set: |of, value| of.pupil.rotation_deg = value,
        absence: |of| of.pupil.extent_m().is_none().then_some(FILE),
        step: |_| 0.05,
        search: |_| None,
        least_fault: |_| 0.1,
    },
    Parameter {
        key: "image.diversity_focus_waves_rms",
        optic: Optic::Defocus,
        get: |of| of.image.diversity_focus_waves_rms,
        set: |of, value| {
            let image = &mut of.image;
            image.diversity_focus_waves_rms = value;
            // Other forms give way.
            (image.diversity_focus_waves_pv, image.diversity_focus_nm_rms, image.diversity_stage_mm) =
                (None, None, None);
        },
        absence: |of| of.image.diversity_file.is_some().then_some("a diversity from a file"),
        step: |_| 5e-3,
        search: |_| None,
        // It is among the modes.
        least_fault: |_| f64::INFINITY,
    },
    illumination("pupil.illumination_x", |of| of.pupil.illumination_x, |of, value| of.pupil.illumination_x = value),
    illumination("pupil.illumination_y", |of| of.pupil.illumination_y, |of, value| of.pupil.illumination_y = value),
    illumination(
        "pupil.illumination_edge",
        |of| of.pupil.illumination_edge,
        |of, value| of.pupil.illumination_edge = value,
    ),
];

/// What has no shadows and no rotation of its own: its map includes them.
const FILE: &str = "a pupil from a file";

const fn illumination(key: &'static str, get: fn(&Sections) -> f64, set: fn(&mut Sections, f64)) -> Parameter {
    Parameter {
        key,
        optic: Optic::Illumination,
        get,
        set,
        absence: |_| None,
        step: |_| ILLUMINATION_STEP,
        search: |_| None,
        least_fault: |_| 0.02,
    }
}

/// Search for a shadow of the pupil, which is `own` in the scene; steps are fractions of the pupil's width, for half a percent of its area and
/// less: on Keck 10 cm of an obscuration's diameter and 1 cm of the spider's width.
fn shadow(of: &Sections, own: f64, farthest: f64, first_step: f64, last_step: f64) -> Option<SearchRange> {
    of.pupil.extent_m().map(|width_m| SearchRange {
        kind: ParameterKind::Telescope,
        range: 0.0..=(farthest * width_m).max(1.5 * own),
        first_step: first_step * width_m,
        last_step: last_step * width_m,
    })
}

//! Optical parameters: their values in a scene, steps of their derivatives, scene and telescope with other values.

use crate::modal::recipe::Recipe;
use crate::scene::{Optic, Scene};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::Array2;

/// Step of a filter's width.
const WIDTH_STEP: f64 = 1e-3;
/// Step of the side of a pixel's square: it changes the highest frequencies of the image by 2 %.
const FILL_STEP: f64 = 0.03;
/// Step of the obscuration's diameter relative to the pupil: the pupil's area changes by 0.1 % at a third of its diameter.
const OBSCURATION_STEP: f64 = 2e-3;
/// Step of the spider's width, m.
const SPIDER_STEP_M: f64 = 1e-3;
/// Step of a term of the illumination: as that of an amplitude.
const ILLUMINATION_STEP: f64 = 0.02;
/// Step of a segment's amplitude.
const AMPLITUDE_STEP: f64 = 0.01;

/// One parameter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::modal) enum Parameter {
    /// A number of the scene.
    Number(Optic, &'static str),
    /// Amplitude that a segment reflects, relative to that of the last one: a factor of all is the star's flux.
    Amplitude(usize),
}

/// A parameter with its value in a scene, and the step for its derivative: about a twentieth of a pixel at the rim of a spot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub(super) parameter: Parameter,
    pub(super) value: f64,
    pub(super) step: f64,
}

/// The parameters that `estimate.fit_optics` of `scene` names.
///
/// # Errors
/// [`Error::Scene`] where the scene has no such parameter.
pub(super) fn starts(scene: &Scene, recipe: &Recipe) -> Result<Vec<Start>> {
    let each = scene.estimate.fit_optics.iter().map(|&optic| starts_of(scene, recipe, optic));
    Ok(each.collect::<Result<Vec<_>>>()?.concat())
}

fn starts_of(scene: &Scene, recipe: &Recipe, optic: Optic) -> Result<Vec<Start>> {
    let missing = |what: &str| {
        Err(Error::Scene(format!(
            "estimate.fit_optics names \"{}\", which {what} does not have; leave it out",
            optic.word()
        )))
    };
    let (image, pupil) = (&scene.image, &scene.pupil);
    let (value, step) = match optic {
        Optic::PlateScale => (image.samples_per_lambda_over_d, 1e-3 * image.samples_per_lambda_over_d),
        Optic::Rotation | Optic::Obscuration | Optic::Spiders if pupil.extent_m().is_none() => {
            return missing("a pupil from a file");
        }
        Optic::Rotation => (pupil.rotation_deg, 0.05),
        Optic::Obscuration if pupil.central_obscuration_m == 0.0 => return missing("a pupil without an obscuration"),
        Optic::Obscuration => (pupil.central_obscuration_m, OBSCURATION_STEP * pupil.extent_m().unwrap_or(1.0)),
        Optic::Spiders if pupil.spider_width_m == 0.0 => return missing("a pupil without a spider"),
        Optic::Spiders => (pupil.spider_width_m, SPIDER_STEP_M.min(0.5 * pupil.spider_width_m)),
        Optic::Defocus if image.diversity_file.is_some() => return missing("a diversity from a file"),
        Optic::Defocus => (image.diversity_focus_waves_rms, 5e-3),
        Optic::Bandwidth if image.filter_file.is_some() => return missing("a filter from a file"),
        // The image depends on the square of the width: its derivative at 0 is 0.
        Optic::Bandwidth if image.bandwidth_fraction == 0.0 => return missing("light of one wavelength"),
        Optic::Bandwidth => (image.bandwidth_fraction, WIDTH_STEP.min(0.5 * image.bandwidth_fraction)),
        // It depends on the square of the side, too.
        Optic::PixelFill if image.pixel_fill == 0.0 => return missing("a detector whose pixels are points"),
        Optic::PixelFill => (image.pixel_fill, FILL_STEP.min(0.5 * image.pixel_fill)),
        Optic::Reflectivities => return amplitudes(scene, recipe, &missing),
        Optic::Illumination => return Ok(illumination(scene)),
    };
    let Some(key) = optic.key() else { return Err(Error::Internal(format!("{} has no key", optic.word()))) };
    Ok(vec![Start { parameter: Parameter::Number(optic, key), value, step }])
}

fn illumination(scene: &Scene) -> Vec<Start> {
    let pupil = &scene.pupil;
    let terms = [
        ("pupil.illumination_x", pupil.illumination_x),
        ("pupil.illumination_y", pupil.illumination_y),
        ("pupil.illumination_edge", pupil.illumination_edge),
    ];
    let start =
        |(key, value)| Start { parameter: Parameter::Number(Optic::Illumination, key), value, step: ILLUMINATION_STEP };
    terms.map(start).to_vec()
}

fn amplitudes(scene: &Scene, recipe: &Recipe, missing: &dyn Fn(&str) -> Result<Vec<Start>>) -> Result<Vec<Start>> {
    let segments = Telescope::new(scene)?.pupil.segments.len();
    if segments < 2 {
        return missing("a pupil of one segment");
    }
    if scene.modes.segment == crate::scene::SegmentModes::PistonTipTilt {
        return missing("a model whose segments tilt");
    }
    if recipe.pupil_model == crate::scene::PupilModel::Hard {
        return missing("a pupil with hard edges");
    }
    let start = |segment| Start { parameter: Parameter::Amplitude(segment), value: 1.0, step: AMPLITUDE_STEP };
    Ok((0..segments - 1).map(start).collect())
}

/// `scene` with these values of its numbers.
pub(super) fn with_numbers(scene: &Scene, parameters: &[Parameter], values: &[f64]) -> Result<Scene> {
    let texts: Vec<String> = values.iter().map(f64::to_string).collect();
    let settings = parameters.iter().zip(&texts).filter_map(|(parameter, text)| match parameter {
        Parameter::Number(_, key) => Some((*key, text.as_str())),
        Parameter::Amplitude(_) => None,
    });
    scene.with(&settings.collect::<Vec<_>>())
}

/// Telescope of `scene` with these amplitudes of its segments.
pub(super) fn telescope(scene: &Scene, parameters: &[Parameter], values: &[f64]) -> Result<Telescope> {
    let telescope = Telescope::new(scene)?;
    let pairs = parameters.iter().zip(values).filter(|(parameter, _)| matches!(parameter, Parameter::Amplitude(_)));
    let amplitudes: Vec<f64> = pairs.map(|(_, value)| *value).collect();
    if amplitudes.is_empty() {
        return Ok(telescope);
    }
    telescope.with_amplitudes(amplitudes.into_iter().chain([1.0]).collect())
}

/// Error bars of the amplitudes b of all segments, which [`Telescope::with_amplitudes`] scales so that Σ area·b² is the pupil's area.
/// `covariance` is that of the parameters.
///
/// Parameters a of a scale s = b/a change by δa: then δbᵢ = s δaᵢ − bᵢ Σ gⱼ s δaⱼ with gⱼ = areaⱼ bⱼ/Σ area·b².
pub(super) fn amplitude_sigmas(
    telescope: &Telescope,
    parameters: &[Parameter],
    values: &[f64],
    covariance: &Array2<f64>,
) -> Vec<f64> {
    let (amplitudes, areas_m2) = (telescope.amplitudes(), telescope.pupil.segment_areas());
    let light: f64 = areas_m2.iter().zip(amplitudes).map(|(area, b)| area * b * b).sum();
    // Derivative of the amplitude of segment `of` by parameter `k`.
    let slope = |of: usize, k: usize| match parameters[k] {
        Parameter::Number(..) => 0.0,
        Parameter::Amplitude(by) => {
            let own = if of == by { 1.0 } else { 0.0 };
            amplitudes[by] / values[k] * (own - amplitudes[of] * areas_m2[by] * amplitudes[by] / light)
        }
    };
    let count = parameters.len();
    let pairs = || (0..count).flat_map(|k| (0..count).map(move |l| (k, l)));
    let variance = |of: usize| pairs().map(|(k, l)| slope(of, k) * covariance[[k, l]] * slope(of, l)).sum::<f64>();
    (0..amplitudes.len()).map(|of| variance(of).max(0.0).sqrt()).collect()
}

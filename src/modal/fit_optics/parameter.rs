//! Optical parameters: their values in a scene, steps of their derivatives, scene and telescope
//! with other values.

use crate::modal::model::recipe::Recipe;
use crate::scene::{Optic, Parameter, System};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::Array2;

/// Step of a segment's amplitude.
const AMPLITUDE_STEP: f64 = 0.01;

/// A parameter that is fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::modal) enum FittedParameter {
    /// A number of the scene.
    Number(Optic, &'static Parameter),
    /// Amplitude that a segment reflects, relative to that of the last one: a factor of all is the
    /// star's flux.
    Amplitude(usize),
}

impl FittedParameter {
    /// Whether the pupil has another geometry where this changes.
    pub(super) fn changes_pupil(self) -> bool {
        matches!(self, Self::Number(_, number) if number.changes.is_of_pupil())
    }
}

/// A parameter with its value in a scene, and the step for its derivative: about a twentieth of a
/// pixel at the rim of a spot.
#[derive(Debug, Clone, Copy)]
pub(super) struct Start {
    pub(super) parameter: FittedParameter,
    pub(super) value: f64,
    pub(super) step: f64,
}

/// The parameters that `estimate.fit_optics` of `scene` names.
///
/// # Errors
/// [`Error::Scene`] where the scene has no such parameter.
pub(super) fn starts(scene: &System, recipe: &Recipe) -> Result<Vec<Start>> {
    let each = scene.estimate.fit_optics.iter().map(|&optic| starts_of(scene, recipe, optic));
    Ok(each.collect::<Result<Vec<_>>>()?.concat())
}

fn starts_of(scene: &System, recipe: &Recipe, optic: Optic) -> Result<Vec<Start>> {
    let missing = |what: &str| {
        Err(Error::Scene(format!(
            "estimate.fit_optics names \"{}\", which {what} does not have; leave it out",
            optic.word()
        )))
    };
    if optic == Optic::REFLECTIVITIES {
        return amplitudes(scene, recipe, &missing);
    }
    if let Some(what) = optic.parameters().iter().find_map(|parameter| parameter.absence(&scene.pupil, &scene.image)) {
        return missing(what);
    }
    let start = |parameter: &'static Parameter| Start {
        parameter: FittedParameter::Number(optic, parameter),
        value: parameter.get(scene),
        step: parameter.step(&scene.pupil, &scene.image),
    };
    Ok(optic.parameters().iter().map(start).collect())
}

fn amplitudes(scene: &System, recipe: &Recipe, missing: &dyn Fn(&str) -> Result<Vec<Start>>) -> Result<Vec<Start>> {
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
    let start = |segment| Start { parameter: FittedParameter::Amplitude(segment), value: 1.0, step: AMPLITUDE_STEP };
    Ok((0..segments - 1).map(start).collect())
}

/// `scene` with these values of its numbers.
pub(super) fn with_numbers(scene: &System, parameters: &[FittedParameter], values: &[f64]) -> Result<System> {
    scene.with(|sections| {
        for (parameter, value) in parameters.iter().zip(values) {
            if let FittedParameter::Number(_, number) = parameter {
                number.set(sections, *value);
            }
        }
    })
}

/// Telescope of `scene` with these amplitudes of its segments.
pub(super) fn telescope(scene: &System, parameters: &[FittedParameter], values: &[f64]) -> Result<Telescope> {
    let telescope = Telescope::new(scene)?;
    let pairs =
        parameters.iter().zip(values).filter(|(parameter, _)| matches!(parameter, FittedParameter::Amplitude(_)));
    let amplitudes: Vec<f64> = pairs.map(|(_, value)| *value).collect();
    if amplitudes.is_empty() {
        return Ok(telescope);
    }
    telescope.with_amplitudes(amplitudes.into_iter().chain([1.0]).collect())
}

/// Error bars of the amplitudes b of all segments, which [`Telescope::with_amplitudes`] scales so
/// that Σ area·b² is the pupil's area. `covariance` is that of the parameters.
///
/// Parameters a of a scale s = b/a change by δa: then δbᵢ = s δaᵢ − bᵢ Σ gⱼ s δaⱼ with gⱼ = areaⱼ
/// bⱼ/Σ area·b².
pub(super) fn amplitude_sigmas(
    telescope: &Telescope,
    parameters: &[FittedParameter],
    values: &[f64],
    covariance: &Array2<f64>,
) -> Vec<f64> {
    let (amplitudes, areas_m2) = (telescope.amplitudes(), telescope.pupil.segment_areas());
    let light: f64 = areas_m2.iter().zip(amplitudes).map(|(area, b)| area * b * b).sum();
    // Derivative of the amplitude of segment `of` by parameter `k`.
    let slope = |of: usize, k: usize| match parameters[k] {
        FittedParameter::Number(..) => 0.0,
        FittedParameter::Amplitude(by) => {
            let own = if of == by { 1.0 } else { 0.0 };
            amplitudes[by] / values[k] * (own - amplitudes[of] * areas_m2[by] * amplitudes[by] / light)
        }
    };
    let count = parameters.len();
    let pairs = || (0..count).flat_map(|k| (0..count).map(move |l| (k, l)));
    let variance = |of: usize| pairs().map(|(k, l)| slope(of, k) * covariance[[k, l]] * slope(of, l)).sum::<f64>();
    (0..amplitudes.len()).map(|of| variance(of).max(0.0).sqrt()).collect()
}

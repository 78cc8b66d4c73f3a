//! Optical parameters of the scene, all fitted together with the modes: which of them the images
//! contradict.

use super::finding::{CheckedQuantity, Finding, SAMPLING, Verdict, WAVELENGTH};
use crate::linear_algebra::SpdInverse;
use crate::modal::OpticsMinimum;
use crate::pipeline::consistency::Contradiction;
use crate::scene::{Optic, OpticalParameter, Scene, Setting};
use ndarray::{Array1, Array2};

/// Part of χ² beyond 1 that the optical parameters together may leave where one of them is the
/// cause of a misfit: of a companion, a saturated or a non-linear detector they leave more.
pub(super) const MOST_LEFT: f64 = 0.5;

/// The optical parameters that `scene` has, as a value of `estimate.fit_optics`.
pub(super) fn parameters(scene: &Scene) -> Vec<Optic> {
    let is_there = |optic: &Optic| {
        optic.parameters().iter().all(|parameter| parameter.absence(&scene.pupil, &scene.image).is_none())
    };
    Optic::examined().into_iter().filter(is_there).collect()
}

/// Smallest change of a parameter that is a fault, in the unit of its key.
fn least_fault(optic: Optic, of_scene: f64) -> f64 {
    optic.parameters().iter().map(|parameter| parameter.least_fault(of_scene)).fold(f64::INFINITY, f64::min)
}

pub(super) fn quantity(optic: Optic) -> CheckedQuantity {
    // Until a card of the file decides.
    if optic == Optic::PLATE_SCALE { CheckedQuantity::PlateScaleOrWavelength } else { CheckedQuantity::Optic(optic) }
}

/// One finding for each of `parameters` of `scene`. `scale` divides χ² (see
/// [`check`](super::super::check())); `is_explained` says that the parameters together may be the
/// cause.
pub(super) fn findings(
    (scene, parameters): (&Scene, &[Optic]),
    minimum: &OpticsMinimum,
    scale: f64,
    is_explained: bool,
) -> Vec<Finding> {
    let all = minimum.fitter.fitted_optics();
    let one = |&optic: &Optic| {
        let at: Vec<usize> = (0..all.len()).filter(|&i| all[i].optic == optic).collect();
        let group: Vec<&OpticalParameter> = at.iter().map(|&i| &all[i]).collect();
        finding(
            (scene, optic),
            &group,
            &minimum.covariance.select(ndarray::Axis(0), &at).select(ndarray::Axis(1), &at),
            minimum,
            (scale, is_explained),
        )
    };
    parameters.iter().map(one).collect()
}

fn finding(
    (own_scene, optic): (&Scene, Optic),
    group: &[&OpticalParameter],
    covariance: &Array2<f64>,
    minimum: &OpticsMinimum,
    (scale, is_explained): (f64, bool),
) -> Finding {
    let quantity = quantity(optic);
    let (Some(first), true) = (group.first(), group.iter().all(|one| one.is_identifiable())) else {
        return Finding::open(quantity, "the modes reproduce its effect on the images");
    };
    let change = Array1::from_iter(group.iter().map(|one| one.value - one.scene));
    // Rise of χ² where the group returns to the scene's values and all else is fitted again: Δᵀ C⁻¹
    // Δ of noise as stated.
    let rise = SpdInverse::new(covariance).map_or(0.0, |inverse| change.dot(&inverse.inverse.dot(&change)));
    let rise = rise * minimum.reduced_chi2[1].max(1.0);
    // Of an effect that is not linear, as that of a filter's width, this is too much: no parameter
    // explains more than all together.
    let decrease = (minimum.reduced_chi2[0] - minimum.reduced_chi2[1]) * minimum.pixels as f64;
    let rise = rise.min(decrease.max(0.0));
    let gain = rise / scale - group.len() as f64 * (minimum.pixels.max(2) as f64).ln();
    let length = change.dot(&change).sqrt();
    let sigma = group.iter().map(|one| one.sigma).fold(0.0, f64::max);
    let is_apart = gain > 0.0 && length > least_fault(optic, first.scene);
    let is_fault = is_apart && is_explained;
    let verdict = match (is_apart, is_explained) {
        (false, _) => Verdict::Agrees,
        (true, true) => Verdict::Fault,
        (true, false) => Verdict::NotDetermined,
    };
    let mut explanation = match group {
        [_, _, ..] => {
            let terms: Vec<String> =
                group.iter().map(|one| format!("{} = {:.4} ± {:.4}", one.key, one.value, one.sigma)).collect();
            format!("{}: {}", optic.about(), terms.join(", "))
        }
        _ => {
            let (key, value) = own_scene.own_form(&first.key, first.value);
            let (_, scene) = own_scene.own_form(&first.key, first.scene);
            let sigma = if key == first.key { first.sigma } else { first.sigma * (value / first.value).abs() };
            format!("{key} = {value:.5} ± {sigma:.5}, where the scene has {scene:.5}")
        }
    };
    if verdict == Verdict::NotDetermined {
        explanation += "; most of the residual has another cause, which changes this value";
    }
    let settings =
        group.iter().filter(|_| is_fault).map(|one| Setting::of_six_decimals(one.key.clone(), one.value)).collect();
    let (scene, found) = if group.len() == 1 { (first.scene, first.value) } else { (0.0, length) };
    Finding {
        scene: Some(scene),
        found: Some(found),
        sigma: Some(sigma),
        gain,
        settings,
        ..Finding::new(quantity, verdict, explanation)
    }
}

/// What else may be wrong where the scene has its pixel as a pitch: a focal length, which changes
/// the defocus of a stage, too. `factor` is the fitted sampling over the scene's.
fn of_focal_length(scene: &Scene, factor: f64) -> String {
    let Some((key, value, has_stage)) = scene.focal_form() else { return String::new() };
    let stage = if has_stage { ", and another defocus of the stage" } else { "" };
    format!(
        ". image.{key} = {:.5} in place of {value} has the same pixels{stage}: set it where the pitch is known",
        value * factor
    )
}

/// Decides between plate scale and wavelength by the file: a pixel of a fixed angle spans λ/D times
/// a factor that goes with 1/λ, so the sampling is proportional to the wavelength. Contradictions
/// of the file that the images confirm leave `contradictions`.
pub(super) fn with_header(
    finding: &mut Finding,
    scene: &Scene,
    has_wavelength: bool,
    contradictions: &mut Vec<Contradiction>,
) {
    let (Some(of_scene), Some(found), Some(sigma)) = (finding.scene, finding.found, finding.sigma) else { return };
    let agrees =
        |ratio: f64| (found / of_scene - ratio).abs() < (5.0 * sigma / of_scene).max(0.2 * (ratio - 1.0).abs());
    let stated = |contradictions: &[Contradiction], key: &str, value: f64| {
        let at = contradictions.iter().position(|one| one.of_file.key() == key)?;
        let ratio = contradictions[at].of_file.value().number()? / value;
        agrees(ratio).then_some(at)
    };
    if finding.verdict != Verdict::Fault {
        if has_wavelength && !contradictions.iter().any(|one| one.of_file.key() == WAVELENGTH) {
            finding.quantity = CheckedQuantity::Optic(Optic::PLATE_SCALE);
        }
        return;
    }
    if let Some(at) = stated(contradictions, WAVELENGTH, scene.image.wavelength_nm) {
        let one = contradictions.remove(at);
        contradictions.retain(|other| other.of_file.key() != SAMPLING);
        finding.quantity = CheckedQuantity::Wavelength;
        finding.explanation = format!(
            "{}; the images agree: {}. A defocus in waves changes with the wavelength",
            one.sentence, finding.explanation
        );
        finding.settings.push(one.of_file);
    } else if let Some(at) = stated(contradictions, SAMPLING, of_scene) {
        let one = contradictions.remove(at);
        contradictions.retain(|other| other.of_file.key() != SAMPLING);
        finding.quantity = CheckedQuantity::Optic(Optic::PLATE_SCALE);
        finding.explanation = format!("{}; the images agree: {}", one.sentence, finding.explanation);
    } else if has_wavelength && !contradictions.iter().any(|one| one.of_file.key() == WAVELENGTH) {
        finding.quantity = CheckedQuantity::Optic(Optic::PLATE_SCALE);
        finding.explanation += " (the file confirms the wavelength)";
    } else {
        finding.explanation +=
            ": another angle of a pixel, wavelength or size of the pupil, which one wavelength does not distinguish";
        finding.explanation += &of_focal_length(scene, found / of_scene);
    }
}

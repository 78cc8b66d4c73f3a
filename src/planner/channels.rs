//! Plan of a scene with channels: each channel is searched by itself, with the noise of the joint
//! estimate in the place of its own, and the choices are put together. Keys of `[estimate]` are
//! those of all channels, so that the finest one holds: the most samples and wavelengths, the
//! smallest tolerance, single precision where every channel bears it; the crop is each channel's
//! own. The result is measured: the same wavefronts are imaged in every channel, estimated by the
//! planned models and combined.
//!
//! A joint estimate is a mean of those of the channels whose weights add up to 1 for each mode, so
//! that its error from the models is about as large as theirs at most. Images in focus do not
//! determine a wavefront by themselves: their channels have the common choices, which a defocus
//! makes finer than they need, and the errors are those without them, larger than with them.

use super::plan::{FoundPlan, TriedValue};
use super::search::PlanSearch;
use super::trial::{joint_price, recipe};
use crate::control::Control;
use crate::modal::{ModalFitter, has_diversity};
use crate::scene::{Crop, Precision, System};
use crate::{Error, Result};

/// Largest RMS of the pistons that are drawn where the channels have several wavelengths, over the
/// shortest: single channels know pistons modulo their wavelength, and a plan is not about whole
/// wavelengths.
const PISTONS: f64 = 0.05;

/// As [`super::plan`], for a `scene` with channels.
pub(super) fn plan(scene: &System, budget_nm: f64, control: &Control) -> Result<FoundPlan> {
    let tried = tried(scene)?;
    let drawn = tried.iter().map(|&channel| with_small_pistons(scene, &scene.channels()[channel].system));
    let drawn = drawn.collect::<Result<Vec<_>>>()?;
    let searches = drawn.iter().map(|own| PlanSearch::new(own, budget_nm, control));
    let mut searches = searches.collect::<Result<Vec<_>>>()?;
    let references = searches.iter().map(PlanSearch::reference).collect::<Result<Vec<_>>>()?;
    let pairs: Vec<_> = references.iter().zip(&searches).map(|(one, search)| (&one.fitter, &search.trials)).collect();
    let reference = joint_price(scene, &pairs, control)?;
    let mut plans = Vec::with_capacity(searches.len());
    for (search, own) in searches.iter_mut().zip(&references) {
        let share = [0, 1].map(|part| reference.noise_nm[part] / own.price.noise_nm[part]);
        // Without modes of a part, or without an estimate, there is no share.
        search.trials.share_noise(share.map(|share| if share.is_finite() { share } else { 1.0 }));
        plans.push(search.run()?);
    }
    let planned = planned(scene, &tried, &plans)?;
    let fitters = tried.iter().zip(&references).map(|(&channel, like)| {
        let own = with_small_pistons(&planned, &planned.channels()[channel].system)?;
        like.fitter.variant(&own, recipe(&own))
    });
    let fitters: Vec<ModalFitter> = fitters.collect::<Result<_>>()?;
    let pairs: Vec<_> = fitters.iter().zip(&searches).map(|(fitter, search)| (fitter, &search.trials)).collect();
    let chosen = joint_price(scene, &pairs, control)?;
    let (mut choices, mut omissions) = (Vec::new(), Vec::new());
    for (channel, plan) in tried.iter().map(|&channel| &planned.channels()[channel]).zip(plans) {
        let name = Some(channel.name.clone());
        choices.extend(plan.choices.into_iter().map(|choice| {
            let kept = has_value(&channel.system, &choice);
            TriedValue { channel: name.clone(), kept, ..choice }
        }));
        let own = plan.omissions.into_iter();
        omissions.extend(own.map(|omission| super::Omission { channel: name.clone(), ..omission }));
    }
    Ok(FoundPlan { system: planned, reference, chosen, choices, omissions })
}

/// The channels that are tried: those that are not in focus.
///
/// # Errors
/// [`Error::Scene`] where there is none.
fn tried(scene: &System) -> Result<Vec<usize>> {
    let channels = scene.channels();
    let tried: Vec<usize> =
        (0..channels.len()).filter(|&channel| has_diversity(&channels[channel].system.image)).collect();
    if tried.is_empty() {
        return Err(Error::Scene(format!(
            "{}: all channels are in focus, where an image by itself does not determine the wavefront, and a plan tries each channel by itself: \
             one that is defocused is needed",
            scene.name()
        )));
    }
    Ok(tried)
}

/// The scene of a channel, with pistons that its images determine where the channels have several
/// wavelengths.
fn with_small_pistons(scene: &System, own: &System) -> Result<System> {
    let wavelengths_nm = || scene.channels().iter().map(|channel| channel.system.image.wavelength_nm);
    let (shortest, longest) = (wavelengths_nm().fold(f64::INFINITY, f64::min), wavelengths_nm().fold(0.0, f64::max));
    let most_nm = PISTONS * shortest;
    match &own.aberrations {
        Some(aberrations) if shortest < longest && aberrations.segment_piston_rms_nm > most_nm => {
            // In tenths of a nanometre, as it is printed.
            let most_nm = (10.0 * most_nm).round() / 10.0;
            own.with(|sections| {
                if let Some(aberrations) = &mut sections.aberrations {
                    aberrations.segment_piston_rms_nm = most_nm;
                }
            })
        }
        _ => Ok(own.clone()),
    }
}

/// Whether the plan has the value of a choice.
fn has_value(planned: &System, choice: &TriedValue) -> bool {
    let (estimate, image) = (&planned.estimate, &planned.image);
    let value = match (choice.key, image.crop_pixels) {
        ("estimate.samples", _) => estimate.samples.map(|samples| samples.to_string()),
        ("estimate.wavelengths", _) => estimate.wavelengths.map(|wavelengths| wavelengths.to_string()),
        ("estimate.precision", _) => Some(format!("\"{}\"", estimate.precision().word())),
        ("estimate.step_tolerance_nm", _) => estimate.step_tolerance_nm.map(|nm| nm.to_string()),
        ("image.crop_pixels", Crop::Pixels(pixels)) => Some(pixels.to_string()),
        _ => None,
    };
    value.as_ref() == Some(&choice.value)
}

/// The system with the choices of the `plans` of the channels `tried`.
fn planned(scene: &System, tried: &[usize], plans: &[FoundPlan]) -> Result<System> {
    let estimates = || plans.iter().map(|plan| &plan.system.estimate);
    let samples = estimates().filter_map(|own| own.samples).max();
    // A scene names them only where every channel has a filter with a width; else each channel
    // keeps those that it needs.
    let has_choice = |plan: &FoundPlan| plan.choices.iter().any(|choice| choice.key == "estimate.wavelengths");
    let of = |plan: &FoundPlan| if has_choice(plan) { plan.system.estimate.wavelengths } else { None };
    let wavelengths = plans.iter().map(of).collect::<Option<Vec<_>>>().and_then(|all| all.into_iter().max());
    let is_single = estimates().all(|own| own.precision() == Precision::F32);
    let tolerances: Option<Vec<f64>> = estimates().map(|own| own.step_tolerance_nm).collect();
    let tolerance_nm = tolerances.and_then(|all| all.into_iter().reduce(f64::min));
    let common = scene.with(|sections| {
        let estimate = &mut sections.estimate;
        estimate.samples = samples.or(estimate.samples);
        estimate.wavelengths = wavelengths.or(estimate.wavelengths);
        estimate.precision = Some(if is_single { Precision::F32 } else { Precision::F64 });
        estimate.step_tolerance_nm = tolerance_nm.or(estimate.step_tolerance_nm);
    })?;
    common.with_each_channel(|channel, sections| {
        let plan = tried.iter().position(|&own| own == channel).map(|place| &plans[place]);
        if let Some(crop @ Crop::Pixels(_)) = plan.map(|plan| plan.system.image.crop_pixels) {
            sections.image.crop_pixels = crop;
        }
    })
}

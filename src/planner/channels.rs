//! Plan of a scene with channels: each channel is searched by itself, with the noise of the joint estimate in the place of its own, and the
//! choices are put together. Keys of `[estimate]` are those of all channels, so that the finest one holds: the most samples and wavelengths,
//! the smallest tolerance, single precision where every channel bears it; the crop is each channel's own. The result is measured: the same
//! wavefronts are imaged in every channel, estimated by the planned models and combined.
//!
//! A joint estimate is a mean of those of the channels whose weights add up to 1 for each mode, so that its error from the models is
//! about as large as theirs at most.

use super::plan::{Choice, Plan};
use super::search::Search;
use super::trial::{DRAWS, joint_price, recipe};
use crate::modal::{ModalFitter, has_diversity};
use crate::optimize::CancelFlag;
use crate::scene::{Crop, Precision, Scene};
use crate::{Error, Result};

/// Largest RMS of the pistons that are drawn where the channels have several wavelengths, over the shortest: single channels know pistons
/// modulo their wavelength, and a plan is not about whole wavelengths.
const PISTONS: f64 = 0.05;

/// As [`super::plan`], for a `scene` with channels.
pub(super) fn plan(scene: &Scene, budget_nm: f64, cancel: Option<&CancelFlag>) -> Result<Plan> {
    refuse_focus(scene)?;
    let drawn = scene.channels().iter().map(|channel| with_small_pistons(scene, &channel.scene));
    let drawn = drawn.collect::<Result<Vec<_>>>()?;
    let searches = drawn.iter().map(|own| Search::new(own, budget_nm, cancel));
    let mut searches = searches.collect::<Result<Vec<_>>>()?;
    let references = searches.iter().map(Search::reference).collect::<Result<Vec<_>>>()?;
    let pairs: Vec<_> =
        references.iter().zip(&searches).map(|(one, search)| (&one.estimator, &search.trials)).collect();
    let reference = joint_price(scene, &pairs, cancel)?;
    let mut plans = Vec::with_capacity(searches.len());
    for (search, own) in searches.iter_mut().zip(&references) {
        let share = [0, 1].map(|part| reference.noise_nm[part] / own.price.noise_nm[part]);
        // Without modes of a part, or without an estimate, there is no share.
        search.trials.share_noise(share.map(|share| if share.is_finite() { share } else { 1.0 }));
        plans.push(search.run()?);
    }
    let settings = settings(scene, &plans);
    let planned = settings.iter().try_fold(scene.clone(), |scene, (key, value)| scene.with_override(key, value))?;
    let fitters = planned.channels().iter().zip(&references).map(|(channel, like)| {
        let own = with_small_pistons(&planned, &channel.scene)?;
        like.estimator.variant(&own, recipe(&own))
    });
    let fitters: Vec<ModalFitter> = fitters.collect::<Result<_>>()?;
    let pairs: Vec<_> = fitters.iter().zip(&searches).map(|(fitter, search)| (fitter, &search.trials)).collect();
    let chosen = joint_price(scene, &pairs, cancel)?;
    let (mut choices, mut omissions) = (Vec::new(), Vec::new());
    for (channel, plan) in scene.channels().iter().zip(plans) {
        let name = Some(channel.name.clone());
        choices.extend(plan.choices.into_iter().map(|choice| {
            let kept = settings.iter().any(|(key, value)| {
                (key == choice.key || *key == own_key(&channel.name, choice.key))
                    && value == choice.value.trim_matches('"')
            });
            Choice { channel: name.clone(), kept, ..choice }
        }));
        let own = plan.omissions.into_iter();
        omissions.extend(own.map(|omission| super::Omission { channel: name.clone(), ..omission }));
    }
    Ok(Plan { scene: planned, budget_nm, reference, chosen, choices, omissions, draws: DRAWS })
}

/// # Errors
/// [`Error::Scene`] for a channel whose images do not determine the wavefront by themselves.
fn refuse_focus(scene: &Scene) -> Result<()> {
    match scene.channels().iter().find(|channel| !has_diversity(&channel.scene.image)) {
        None => Ok(()),
        Some(channel) => Err(Error::Scene(format!(
            "{}: the channel '{}' is in focus, where an image by itself does not determine the wavefront, and a plan tries each channel by \
             itself: leave it out of the scene that is planned, and add it to the plan",
            scene.name(),
            channel.name
        ))),
    }
}

/// The scene of a channel, with pistons that its images determine where the channels have several wavelengths.
fn with_small_pistons(scene: &Scene, own: &Scene) -> Result<Scene> {
    let wavelengths_nm = || scene.channels().iter().map(|channel| channel.scene.image.wavelength_nm);
    let (shortest, longest) = (wavelengths_nm().fold(f64::INFINITY, f64::min), wavelengths_nm().fold(0.0, f64::max));
    let most_nm = PISTONS * shortest;
    match &own.aberrations {
        Some(aberrations) if shortest < longest && aberrations.segment_piston_rms_nm > most_nm => {
            own.with_override("aberrations.segment_piston_rms_nm", &format!("{most_nm:.1}"))
        }
        _ => Ok(own.clone()),
    }
}

/// Name of a key of `[image]` of a channel.
fn own_key(channel: &str, key: &str) -> String {
    format!("image.channel.{channel}.{}", key.trim_start_matches("image."))
}

/// Keys and values of a scene that has the choices of the plans of its channels.
fn settings(scene: &Scene, plans: &[Plan]) -> Vec<(String, String)> {
    let mut settings = Vec::new();
    let estimates = || plans.iter().map(|plan| &plan.scene.estimate);
    let mut set = |key: &str, value: Option<String>| settings.extend(value.map(|value| (key.to_owned(), value)));
    set("estimate.samples", estimates().filter_map(|own| own.samples).max().map(|samples| samples.to_string()));
    // A scene names them only where every channel has a filter with a width; else each channel keeps those that it needs.
    let has_choice = |plan: &Plan| plan.choices.iter().any(|choice| choice.key == "estimate.wavelengths");
    let of = |plan: &Plan| if has_choice(plan) { plan.scene.estimate.wavelengths } else { None };
    let wavelengths: Option<Vec<_>> = plans.iter().map(of).collect();
    set("estimate.wavelengths", wavelengths.and_then(|all| all.into_iter().max()).map(|count| count.to_string()));
    let precision = if estimates().all(|own| own.precision == Precision::F32) { "f32" } else { "f64" };
    set("estimate.precision", Some(precision.into()));
    let tolerances: Option<Vec<f64>> = estimates().map(|own| own.step_tolerance_nm).collect();
    let tolerance = tolerances.and_then(|all| all.into_iter().reduce(f64::min));
    set("estimate.step_tolerance_nm", tolerance.map(|nm| nm.to_string()));
    for (channel, plan) in scene.channels().iter().zip(plans) {
        if let Crop::Pixels(pixels) = plan.scene.image.crop_pixels {
            settings.push((own_key(&channel.name, "image.crop_pixels"), pixels.to_string()));
        }
    }
    settings
}

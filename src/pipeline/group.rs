//! Estimate from images of one wavefront that are fitted together: those of channels in focus or
//! with a small defocus, or of all channels where the scene says so.

use super::channels::{ChannelImages, Channels, combined, names};
use super::estimate::Estimate;
use super::modal_task::Fitted;
use super::policy::Policy;
use super::warnings::group_warnings;
use crate::control::{Control, Stage};
use crate::modal::{self, GroupChannel, GroupEstimate, JointEstimate, Minima, are_determined, is_weak};
use crate::scene::{Grouping, Optic, Scene, Weighting};
use crate::statistics::median;
use crate::{Error, Result};
use std::time::Instant;

/// Whether the images of `channels` are fitted together.
///
/// # Errors
/// Those of the diversities; [`Error::Scene`] for settings that a fit of several images together
/// does not have.
pub(super) fn is_group(scene: &Scene, policy: &Policy, channels: &[ChannelImages]) -> Result<bool> {
    if scene.estimate.posterior && (channels.len() > 1 || scene.estimate.group == Grouping::All) {
        return Err(Error::Scene(format!(
            "{}: estimate.posterior = true is for images of one channel that are fitted alone; leave it out",
            scene.name()
        )));
    }
    let images = fitted_images(scene, channels)?.iter().flatten().filter(|is_fitted| **is_fitted).count();
    let alone = || match &scene.estimate.fitted_images {
        None => Ok(false),
        Some(_) => Err(Error::Scene(format!(
            "{}: estimate.fitted_images names images that are fitted together, and each is fitted alone here; leave it out, or set \
             estimate.group = \"all\"",
            scene.name()
        ))),
    };
    let why = match scene.estimate.group {
        Grouping::Each => return alone(),
        Grouping::All if images > 1 => "estimate.group = \"all\" fits all images together".to_owned(),
        Grouping::All => {
            return Err(Error::Scene(format!(
                "{}: estimate.group = \"all\" fits all images together, and there is one: two or more are needed",
                scene.name()
            )));
        }
        Grouping::Auto if channels.len() < 2 => return alone(),
        Grouping::Auto => {
            let mut weak = None;
            for channel in channels {
                if is_weak(&channel.scene)? {
                    weak = channel.name;
                    break;
                }
            }
            let Some(name) = weak else { return alone() };
            format!(
                "the channel '{name}' is in focus or has less than half a wave of diversity, so that all images are fitted together"
            )
        }
    };
    let other = scene.estimate.fit_optics.iter().find(|optic| ![Optic::DEFOCUS, Optic::DIVERSITY].contains(optic));
    if let Some(optic) = other {
        return Err(Error::Scene(format!(
            "{}: {why}, where estimate.fit_optics = [\"{}\"] is not fitted; \"defocus\" and \"diversity\" are (estimate.group = \"each\" fits each \
             image alone)",
            scene.name(),
            optic.word()
        )));
    }
    if policy.recipe(scene).weighting != Weighting::Noise {
        return Err(Error::Scene(format!(
            "{}: {why}, which needs weights by the noise: estimate.weighting = \"noise\"",
            scene.name()
        )));
    }
    Ok(true)
}

/// Which images of each channel are fitted.
///
/// # Errors
/// [`Error::Scene`] for the number of an image that is not there.
fn fitted_images(scene: &Scene, channels: &[ChannelImages]) -> Result<Vec<Vec<bool>>> {
    let mut first = 0;
    let each = channels.iter().map(|channel| {
        let images = first..first + channel.images.len();
        first = images.end;
        let is_fitted = |number: usize| {
            scene.estimate.fitted_images.as_ref().is_none_or(|fitted| fitted.contains(&(number as i64)))
        };
        images.map(is_fitted).collect()
    });
    let fitted = each.collect();
    let odd = scene.estimate.fitted_images.iter().flatten().find(|number| **number >= first as i64);
    match odd {
        None => Ok(fitted),
        Some(number) => Err(Error::Scene(format!(
            "{}: estimate.fitted_images names image {number}, where there are {first}; 0 to {} are accepted",
            scene.name(),
            first.saturating_sub(1)
        ))),
    }
}

/// The error of parts of an estimate of `scene`, whose images are fitted together.
pub(super) fn refuse_parts(scene: &Scene) -> Error {
    Error::Scene(format!(
        "{}: its images are fitted together, which cannot be shared among parts: run it as one ('cophase estimate' without --part)",
        scene.name()
    ))
}

/// Estimates the wavefront of all images of `channels` together.
///
/// # Errors
/// Those of [`modal::estimate_group`].
pub(super) fn estimate(
    scene: &Scene,
    policy: &Policy,
    control: &Control,
    channels: &[ChannelImages],
) -> Result<Estimate> {
    let started = Instant::now();
    control.enter(Stage::Preparing, 0);
    let which = fitted_images(scene, channels)?;
    let own = channels.iter().zip(&which).map(|(channel, fitted)| {
        let own = channel.scene.changed(|sections| {
            sections.estimate.fit_optics.clear();
            sections.estimate.group = Grouping::Each;
            sections.estimate.fitted_images = None;
            sections.estimate.posterior = false;
        })?;
        let recipe = policy.recipe(&own);
        let fitter = modal::fitter_for(&own, recipe, &channel.cache, channel.images.cube())?;
        control.check("the models were built in part, no image was fitted")?;
        Ok((own, GroupChannel { fitter, cube: channel.images.cube(), fitted: fitted.clone() }))
    });
    let (scenes, members): (Vec<Scene>, Vec<GroupChannel>) = own.collect::<Result<Vec<_>>>()?.into_iter().unzip();
    let model_seconds = started.elapsed().as_secs_f64();
    let near = near_wavefront(scene, policy, control, channels)?;
    let near_nm = near.as_ref().map(|near| near.modes.coefficients_nm.as_slice());
    let GroupEstimate { mut joint, channels: fits, minima, most_different } =
        modal::estimate_group(scene, members, near_nm, control)?;
    joint.integers = near.map(|near| near.integers).unwrap_or_default();
    control.check("the images were fitted, nothing was written")?;
    let (mut each, mut used, mut refused, mut compared) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for (((fit, own), channel), fitted) in fits.into_iter().zip(scenes).zip(channels).zip(which) {
        let fit = match fit {
            Ok(fit) => fit,
            Err(reason) => {
                let of = channel.name.map(|name| format!("channel {name}: ")).unwrap_or_default();
                refused.push(format!("{of}no image can be used: {reason}"));
                continue;
            }
        };
        let scene = own.adopting(fit.0.scene())?;
        let model_seconds = if each.is_empty() { model_seconds } else { 0.0 };
        let fit = Fitted { fit, scene, selected: None, cause: None, changes: None, model_seconds };
        let mut own = fit.into_estimate(policy)?;
        for (image, _) in own.images.iter_mut().zip(fitted).filter(|(_, is_fitted)| !is_fitted) {
            image.is_used = false;
            if image.report.reduced_chi2.is_finite() {
                compared.push(image.report.reduced_chi2);
                let reason = if image.message.is_empty() { String::new() } else { format!("; {}", image.message) };
                image.message = format!("compared with the wavefront of other images{reason}");
            }
        }
        each.push(own);
        used.push(channel);
    }
    let is_contradictory = joint.is_contradictory();
    let mut estimate = combined(scene, joint, names(&used), each)?;
    estimate.warnings.splice(0..0, refused);
    if let Some(([channel, image], chi2)) = most_different.filter(|_| is_contradictory) {
        let of = channels[channel].name.map(|name| format!(" of channel {name}")).unwrap_or_default();
        estimate.warnings.push(format!(
            "image {image}{of} differs most from the wavefront of all: the reduced χ² of its difference is {chi2:.1}"
        ));
    }
    estimate.warnings.splice(0..0, group_warnings(&estimate.images));
    estimate.warnings.extend(warnings(&minima));
    estimate.remarks.insert(0, remark(&estimate, &compared, &minima));
    Ok(estimate)
}

/// The estimate from those of `channels` whose images can be fitted alone, where there are others
/// or several wavelengths, and they are of one wavefront.
fn near_wavefront(
    scene: &Scene,
    policy: &Policy,
    control: &Control,
    channels: &[ChannelImages],
) -> Result<Option<JointEstimate>> {
    let mut strong = Vec::new();
    for channel in channels {
        if !is_weak(&channel.scene)? {
            strong.push(channel);
        }
    }
    let wavelengths_nm: Vec<f64> = channels.iter().map(|channel| channel.scene.image.wavelength_nm).collect();
    if strong.is_empty() || (strong.len() == channels.len() && !are_determined(&wavelengths_nm)) {
        return Ok(None);
    }
    let policy = Policy { select_model: false, ..*policy };
    let (_, found) = Channels::new(scene, &policy, control, &strong)?.fit(None)?;
    Ok(Some(found).filter(|found| !found.is_contradictory()))
}

/// Warnings on the minima of a fit.
fn warnings(minima: &Minima) -> Vec<String> {
    let mut sentences = Vec::new();
    if minima.has_twin {
        sentences.push(
            "the turned wavefront −W(−x, −y) explains these images as well: their diversities are all even, or all odd; one more image, with a \
             diversity that is neither, decides"
                .to_owned(),
        );
    }
    if minima.is_suspicious && minima.in_best < 2 {
        sentences.push(format!(
            "only one of {} starts of the fit ended in this minimum, and χ² is larger than noise explains: it may be a wrong one",
            minima.starts
        ));
    }
    sentences
}

/// What a user should know of the fit, and of the images that were compared with it.
fn remark(estimate: &Estimate, compared_chi2: &[f64], minima: &Minima) -> String {
    let images = estimate.images.iter().filter(|image| image.is_used).count();
    let next = match minima.next {
        Some(next) => format!("the next minimum is at Δχ² = {next:.0}"),
        None => "no other minimum was found".into(),
    };
    let compared = match compared_chi2.iter().copied().reduce(f64::max) {
        None => String::new(),
        Some(most) => format!(
            " {} others are predicted from their wavefront with a reduced χ² of {:.2} in the median and {most:.2} at most.",
            compared_chi2.len(),
            median(compared_chi2)
        ),
    };
    format!(
        "{images} images were fitted together; {} of {} starts ended in this minimum, and {next}.{compared}",
        minima.in_best, minima.starts
    )
}

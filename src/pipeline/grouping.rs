//! Which images are of one wavefront and are fitted together.

use super::channels::ChannelImages;
use super::policy::Policy;
use crate::modal::{Search, is_weak};
use crate::scene::{Combine, DeviceChoice, Grouping, Optic, Precision, Scene, Weighting};
use crate::{Error, Result};

/// How the images of several channels are fitted together.
pub(super) struct Together {
    /// Which channels are in focus or have less than half a wave of diversity.
    pub(super) weak: Vec<bool>,
    pub(super) how: How,
}

/// What is done with images that are fitted together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum How {
    /// All are fitted, and images that one wavefront does not explain are said.
    All,
    /// All are fitted, or each alone where one wavefront does not explain them.
    AllOrEach,
    /// So many successive images of each channel are a group, and the mean of the groups is wanted.
    Successive(usize),
}

impl Together {
    /// How the images of `channels` are fitted together; `None` where each is fitted alone.
    ///
    /// # Errors
    /// Those of the diversities; [`Error::Scene`] for settings that a fit of several images
    /// together does not have.
    pub(super) fn of(scene: &Scene, policy: &Policy, channels: &[ChannelImages]) -> Result<Option<Self>> {
        let images = fitted_images(scene, channels)?.iter().flatten().filter(|is_fitted| **is_fitted).count();
        let alone = || match &scene.estimate.fitted_images {
            None => Ok(None),
            Some(_) => Err(Error::Scene(format!(
                "{}: estimate.fitted_images names images that are fitted together, and each is fitted alone here; leave it out, or set \
                 estimate.group = \"all\"",
                scene.name()
            ))),
        };
        let grouping = scene.estimate.group;
        if matches!((grouping, channels.len()), (Grouping::Each, _) | (Grouping::Auto | Grouping::Successive(1), 0 | 1))
        {
            return alone();
        }
        let groups = if let Grouping::Successive(size) = grouping { groups_of(scene, size, channels)? } else { 1 };
        let how = match grouping {
            Grouping::Successive(size) if groups > 1 => How::Successive(size),
            _ => How::All,
        };
        let weak = channels.iter().map(|channel| is_weak(&channel.scene)).collect::<Result<Vec<_>>>()?;
        let named = || format!("estimate.group = {} fits", grouping.shown());
        let why = match grouping {
            Grouping::Successive(_) => format!("{} images together", named()),
            Grouping::All if images > 1 => format!("{} all images together", named()),
            Grouping::All => {
                return Err(Error::Scene(format!(
                    "{}: {} all images together, and there is one: two or more are needed",
                    scene.name(),
                    named()
                )));
            }
            _ => match channels.iter().zip(&weak).find(|(_, is_weak)| **is_weak) {
                Some((channel, _)) => format!(
                    "the channel '{}' is in focus or has less than half a wave of diversity, so that all images are fitted together",
                    channel.name.unwrap_or_default()
                ),
                None if is_one_of_each(scene, policy, channels) => {
                    return Ok(Some(Self { weak, how: How::AllOrEach }));
                }
                None => return alone(),
            },
        };
        if let Some(optic) = other_optic(scene) {
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
        if let How::Successive(_) = how {
            refuse_of_sequence(scene, policy)?;
        }
        Ok(Some(Self { weak, how }))
    }

    /// How the minima are sought.
    pub(super) fn search(&self) -> Search {
        match self {
            Self { weak, .. } if weak.contains(&true) => Search::All,
            _ => Search::IfNeeded,
        }
    }
}

/// Number of the groups of `size` images of each of `channels`.
///
/// # Errors
/// [`Error::Scene`] where groups would differ.
fn groups_of(scene: &Scene, size: usize, channels: &[ChannelImages]) -> Result<usize> {
    let counts: Vec<usize> = channels.iter().map(|channel| channel.images.len()).collect();
    if counts.iter().any(|&count| count != counts[0] || count % size != 0) {
        let counts: Vec<String> = counts.iter().map(usize::to_string).collect();
        return Err(Error::Scene(format!(
            "{}: estimate.group = {} needs as many images of each channel, a multiple of {size}, and the channels have {}",
            scene.name(),
            scene.estimate.group.shown(),
            counts.join(", ")
        )));
    }
    Ok(counts[0] / size)
}

/// Refuses what a sequence of groups does not have.
///
/// # Errors
/// [`Error::Scene`].
fn refuse_of_sequence(scene: &Scene, policy: &Policy) -> Result<()> {
    let estimate = &scene.estimate;
    let odd = [
        (estimate.fitted_images.is_some(), "estimate.fitted_images"),
        (!estimate.fit_optics.is_empty(), "estimate.fit_optics"),
        (scene.tolerance.defocus_fraction > 0.0, "tolerance.defocus_fraction"),
        (policy.recipe(scene).combine == Combine::Median, "estimate.combine = \"median\""),
    ];
    match odd.iter().find(|(is_set, _)| *is_set) {
        None => Ok(()),
        Some((_, key)) => Err(Error::Scene(format!(
            "{}: estimate.group = {} makes a sequence of groups, which does not have {key}: leave it out, or set estimate.group = \"all\", \
             where all images are of one wavefront",
            scene.name(),
            estimate.group.shown()
        ))),
    }
}

/// Whether `channels` have one image each, which are fitted together where nothing in the scene
/// asks for what a group does not have.
fn is_one_of_each(scene: &Scene, policy: &Policy, channels: &[ChannelImages]) -> bool {
    let estimate = &scene.estimate;
    channels.iter().all(|channel| channel.images.len() == 1)
        && other_optic(scene).is_none()
        && policy.recipe(scene).weighting == Weighting::Noise
        && matches!(estimate.device, DeviceChoice::Auto | DeviceChoice::Cpu)
        && estimate.precision() == Precision::F64
}

/// An optical parameter that is to be fitted and that a group does not fit.
fn other_optic(scene: &Scene) -> Option<&Optic> {
    scene.estimate.fit_optics.iter().find(|optic| ![Optic::DEFOCUS, Optic::DIVERSITY].contains(optic))
}

/// Which images of each channel are fitted.
///
/// # Errors
/// [`Error::Scene`] for the number of an image that is not there.
pub(super) fn fitted_images(scene: &Scene, channels: &[ChannelImages]) -> Result<Vec<Vec<bool>>> {
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

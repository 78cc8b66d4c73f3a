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
    /// Channel and number of the images of each group, where there are several.
    pub(super) groups: Vec<Vec<[usize; 2]>>,
}

/// What is done with images that are fitted together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum How {
    /// All are fitted, and images that one wavefront does not explain are said.
    All,
    /// All are fitted, or each alone where one wavefront does not explain them.
    AllOrEach,
    /// Each group is fitted, and the mean of the groups is wanted.
    Groups,
}

impl Together {
    /// How the images of `channels` are fitted together; `None` where each is fitted alone. Each
    /// image of each channel is of the exposure `exposures`, where that is not its number.
    ///
    /// # Errors
    /// Those of the diversities; [`Error::Scene`] for settings that a fit of several images
    /// together does not have.
    pub(super) fn of(
        scene: &Scene,
        policy: &Policy,
        channels: &[ChannelImages],
        exposures: Option<&[Vec<usize>]>,
    ) -> Result<Option<Self>> {
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
        let mut groups = match grouping {
            Grouping::Successive(size) => groups_of(scene, size, channels, exposures)?,
            _ => Vec::new(),
        };
        let is_single = groups.first().is_some_and(|group| group.len() == 1);
        if grouping == Grouping::Each || is_single || (grouping == Grouping::Auto && channels.len() < 2) {
            return alone();
        }
        let how = if groups.len() > 1 { How::Groups } else { How::All };
        if how == How::All {
            groups.clear();
        }
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
                    return Ok(Some(Self { weak, how: How::AllOrEach, groups }));
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
        if how == How::Groups {
            refuse_of_sequence(scene, policy)?;
        }
        Ok(Some(Self { weak, how, groups }))
    }

    /// Refuses parts of an estimate whose images are one problem.
    ///
    /// # Errors
    /// [`Error::Scene`].
    pub(super) fn refuse_parts(&self, scene: &Scene) -> Result<()> {
        if self.how == How::Groups {
            return Ok(());
        }
        Err(Error::Scene(format!(
            "{}: all its images are fitted together, which cannot be shared among parts: run it as one ('cophase estimate' without --part)",
            scene.name()
        )))
    }

    /// How the minima are sought.
    pub(super) fn search(&self) -> Search {
        match self {
            Self { weak, .. } if weak.contains(&true) => Search::All,
            _ => Search::IfNeeded,
        }
    }
}

/// The groups of `size` successive exposures of each channel: channel and number of their images.
///
/// # Errors
/// [`Error::Scene`] where groups would differ.
fn groups_of(
    scene: &Scene,
    size: usize,
    channels: &[ChannelImages],
    exposures: Option<&[Vec<usize>]>,
) -> Result<Vec<Vec<[usize; 2]>>> {
    let exposure = |[channel, image]: [usize; 2]| exposures.map_or(image, |exposures| exposures[channel][image]);
    let images = channels.iter().enumerate();
    let places = images.flat_map(|(channel, own)| (0..own.images.len()).map(move |image| [channel, image]));
    let (mut groups, mut count): (Vec<Vec<[usize; 2]>>, usize) = (Vec::new(), 0);
    for place in places {
        let group = exposure(place) / size;
        count = count.max(exposure(place) + 1);
        groups.resize(groups.len().max(group + 1), Vec::new());
        groups[group].push(place);
    }
    if count % size != 0 || groups.iter().any(|group| group.len() != groups[0].len()) {
        let multiple = if size == 1 { String::new() } else { format!(", a multiple of {size}") };
        let counts: Vec<String> = groups.iter().map(|group| group.len().to_string()).collect();
        return Err(Error::Scene(format!(
            "{}: estimate.group = {} needs as many images of each channel{multiple}, and of {count} exposures its groups have {} images",
            scene.name(),
            scene.estimate.group.shown(),
            counts.join(", ")
        )));
    }
    Ok(groups)
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

//! Sequences of groups: each group has a wavefront of its own, and the estimate is their mean.

use crate::control::{Control, Stage};
use crate::modal::assess::status::Status;
use crate::modal::combine::joint::check_same_modes;
use crate::modal::fitter::ModalFitter;
use crate::modal::group::mean::{FittedGroup, Mean, mean_of};
use crate::modal::group::posterior::{GroupPosterior, LeftOutOfChannels};
use crate::modal::group::{GroupChannel, GroupEstimate, GroupSequence, Minima, Search, Solution, of_channels};
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::engine::{FitState, ImageFit, reason_of_none};
use crate::modal::solve::minimum::Minimum;
use crate::scene::System;
use crate::{Error, Result};
use rayon::prelude::*;
use std::time::Instant;

/// What the groups of a sequence are fitted with.
struct Task<'a> {
    scene: &'a System,
    fitters: &'a [ModalFitter],
    fits: &'a [Vec<ImageFit>],
    left_out: Option<&'a LeftOutOfChannels>,
    control: &'a Control,
}

/// The fit of one group.
struct GroupFit {
    group: FittedGroup,
    minima: Minima,
    is_explained: bool,
    /// Why one of its images cannot be used.
    refusal: Option<String>,
    /// Its images: channel and number, with the weights and the minimum of the fit.
    images: Vec<([usize; 2], PreparedFrame, Minimum)>,
}

impl Task<'_> {
    /// Whether all images of a group can be used.
    fn is_whole(&self, places: &[[usize; 2]]) -> bool {
        places.iter().all(|&[channel, image]| self.fits[channel][image].state == FitState::NotBegun)
    }

    /// Fits the group with the images `places`.
    fn fit(&self, places: &[[usize; 2]], how: (Option<&[f64]>, Search)) -> Result<GroupFit> {
        let (fitters, own) = (self.fitters, self.fitters.iter().collect::<Vec<_>>());
        let is_of_group = |place| places.contains(&place);
        let mut found = Solution::new(self.scene, &own, self.fits, is_of_group, how, self.control)?;
        let of_group = (&found.group, &found.best, &found.normal.each[..]);
        let posterior = self.left_out.map(|of| GroupPosterior::new(of_group, fitters, of)).transpose()?;
        if let Some(posterior) = &posterior {
            found.explain(&posterior.left_out.explained_chi2);
        }
        let inflation = posterior.as_ref().map_or(found.normal.inflation, |posterior| posterior.inflation);
        let equations = posterior.as_ref().map(|posterior| &posterior.equations);
        let of_group = (&found.group, &found.best);
        let group = FittedGroup::new(of_group, &found.normal.each, equations, inflation, &fitters[0])?;
        self.control.step(1);
        let members = found.group.members.iter().zip(&found.best.minima);
        let refusal = members.clone().find_map(|(member, minimum)| match member.status(minimum) {
            Status::Unusable(refusal) => Some(refusal.to_string()),
            _ => None,
        });
        let images = members.map(|(member, minimum)| (member.place, member.image.clone(), minimum.clone())).collect();
        Ok(GroupFit { group, minima: found.minima, is_explained: found.is_explained(), refusal, images })
    }
}

/// The error of `groups` none of which can be used, one for this `reason`.
fn none_of(groups: &[Vec<[usize; 2]>], reason: &str) -> Error {
    Error::Image(format!("each of {} groups has an image that cannot be used: {reason}", groups.len()))
}

/// Fits each of `groups`, channel and number of its images, alone, the first near `near_nm` or the
/// flat wavefront and the others near the first, and combines them.
///
/// # Errors
/// As [`super::estimate_group`]; [`Error::Image`] where every group has an image that cannot be
/// used.
pub(crate) fn estimate_sequence(
    scene: &System,
    channels: &[GroupChannel],
    groups: &[Vec<[usize; 2]>],
    how: (Option<&[f64]>, Search),
    marginalise: bool,
    control: &Control,
) -> Result<GroupEstimate> {
    let started = Instant::now();
    check_same_modes(channels.iter().map(|channel| &channel.fitter))?;
    let mut fits = channels.iter().map(|channel| channel.fitter.prepared(&channel.cube)).collect::<Result<Vec<_>>>()?;
    control.enter(Stage::Fitting, groups.len());
    let (fitters, names): (Vec<_>, Vec<_>) =
        channels.iter().map(|channel| (channel.fitter.clone(), channel.name.clone())).unzip();
    let left_out = marginalise.then(|| LeftOutOfChannels::new(scene, &fitters, &names, None)).transpose()?;
    let task = Task { scene, fitters: &fitters, fits: &fits, left_out: left_out.as_ref(), control };
    let numbers: Vec<usize> = (0..groups.len()).filter(|&group| task.is_whole(&groups[group])).collect();
    let Some((&first, others)) = numbers.split_first() else {
        return Err(none_of(groups, &reason_of_none(fits.iter().flatten())));
    };
    let first = task.fit(&groups[first], how)?;
    // Wavefronts of one telescope are alike.
    let near_nm = first.group.coefficients_nm.to_vec();
    let others = others.par_iter().map(|&group| task.fit(&groups[group], (Some(&near_nm), Search::IfNeeded)));
    let mut found = vec![first];
    found.extend(others.collect::<Result<Vec<_>>>()?);
    for (place, prepared, minimum) in found.iter_mut().flat_map(|group| group.images.drain(..)) {
        let fit = &mut fits[place[0]][place[1]];
        (fit.prepared, fit.minimum, fit.state) = (prepared, minimum, FitState::Fitted);
    }
    control.enter(Stage::Combining, 0);
    let is_explained = found.iter().all(|group| group.is_explained) && numbers.len() == groups.len();
    let minima = Minima {
        has_twin: found.iter().any(|group| group.minima.has_twin),
        ..found.iter().find(|group| group.minima.is_suspicious).unwrap_or(&found[0]).minima
    };
    let refusal = found[0].refusal.clone();
    let usable = numbers.into_iter().zip(found).filter(|(_, found)| found.refusal.is_none());
    let (numbers, fitted): (Vec<usize>, Vec<FittedGroup>) = usable.map(|(group, found)| (group, found.group)).unzip();
    if let (true, Some(reason)) = (fitted.is_empty(), refusal) {
        return Err(none_of(groups, &reason));
    }
    let Mean { joint, agreement, used, has_scatter } = mean_of(&fitted, &fitters[0], left_out.as_ref())?;
    Ok(GroupEstimate {
        joint,
        channels: of_channels(fitters, fits, started)?,
        minima,
        is_explained: is_explained && !agreement.is_contradictory(),
        differences: Vec::new(),
        sequence: Some(GroupSequence {
            has_scatter,
            agreement: agreement.of_images(&numbers),
            used: used.into_iter().map(|place| numbers[place]).collect(),
            fitted: numbers,
        }),
    })
}

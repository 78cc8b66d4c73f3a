//! Sequences of groups: each group has a wavefront of its own, and the estimate is their mean.

use crate::control::{Control, Stage};
use crate::modal::assess::status::Status;
use crate::modal::combine::joint::check_same_modes;
use crate::modal::fitter::ModalFitter;
use crate::modal::group::fit::Group;
use crate::modal::group::mean::{FittedGroup, Mean, mean_of};
use crate::modal::group::posterior::{GroupPosterior, LeftOutOfChannels};
use crate::modal::group::stored::GroupSeries;
use crate::modal::group::{GroupChannel, GroupEstimate, GroupSequence, Minima, Search, Solution, of_channels};
use crate::modal::prepare::PreparedFrame;
use crate::modal::prepare::rejection::reject_without_weight;
use crate::modal::solve::engine::{FitState, ImageFit, reason_of_none};
use crate::modal::solve::fit_series::{FIRST, StoredFit};
use crate::modal::solve::minimum::Minimum;
use crate::scene::System;
use crate::{Error, Result};
use rayon::prelude::*;
use std::time::Instant;

/// Groups of images that have a wavefront each.
pub(crate) struct Sequence<'a> {
    pub(crate) scene: &'a System,
    pub(crate) channels: &'a [GroupChannel<'a>],
    /// Channel and number of the images of each group.
    pub(crate) groups: &'a [Vec<[usize; 2]>],
    /// The modes near which the fit of the first group begins, in place of the flat wavefront.
    pub(crate) near_nm: Option<&'a [f64]>,
    pub(crate) search: Search,
    /// Whether what the modes leave out is marginalised.
    pub(crate) marginalise: bool,
    pub(crate) control: &'a Control,
}

/// Images of a sequence of groups, prepared, and what their fits need.
struct Prepared<'a> {
    scene: &'a System,
    control: &'a Control,
    fitters: Vec<ModalFitter>,
    fits: Vec<Vec<ImageFit>>,
    left_out: Option<LeftOutOfChannels>,
    /// The groups all of whose images can be used.
    numbers: Vec<usize>,
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

/// Word for the chain of fits of groups, which are of several images each.
const GROUP: &str = "group";

impl Prepared<'_> {
    /// Fits the group with the images `places`.
    fn fit(&self, places: &[[usize; 2]], how: (Option<&[f64]>, Search)) -> Result<GroupFit> {
        let (fitters, own) = (&self.fitters, self.fitters.iter().collect::<Vec<_>>());
        let is_of_group = |place| places.contains(&place);
        let mut found = Solution::new(self.scene, &own, &self.fits, is_of_group, how, self.control)?;
        let of_group = (&found.group, &found.best, &found.normal.each[..]);
        let posterior = self.left_out.as_ref().map(|of| GroupPosterior::new(of_group, fitters, of)).transpose()?;
        if let Some(posterior) = &posterior {
            found.explain(&posterior.left_out.explained_chi2);
        }
        let inflation = posterior.as_ref().map_or(found.normal.inflation, |posterior| posterior.inflation);
        let equations = posterior.as_ref().map(|posterior| &posterior.equations);
        let of_group = (&found.group, &found.best);
        let group = FittedGroup::new(of_group, &found.normal.each, equations, inflation, &fitters[0])?;
        self.control.step(1);
        let members = found.group.members.iter().zip(&found.best.minima);
        let refusal = refusal_of(members.clone().map(|(member, minimum)| member.status(minimum)));
        let images = members.map(|(member, minimum)| (member.place, member.image.clone(), minimum.clone())).collect();
        Ok(GroupFit { group, minima: found.minima, is_explained: found.is_explained(), refusal, images })
    }

    /// The fit of the group with the images `places` as it was stored; `None` where it is not, or
    /// is of another size.
    fn restored(&self, (group, places): (usize, &[[usize; 2]]), series: &GroupSeries) -> Result<Option<GroupFit>> {
        let Some(stored) = series.groups.get(&group) else { return Ok(None) };
        let own: Vec<&ModalFitter> = self.fitters.iter().collect();
        let unfitted = Group::new(&own, &self.fits, |place| places.contains(&place), None)?;
        let mut images = Vec::new();
        for mut member in unfitted.members {
            let [channel, image] = member.place;
            let Some([StoredFit { minimum, weights, .. }]) = series.fits.get(&(channel, image)).map(Vec::as_slice)
            else {
                return Ok(None);
            };
            if weights.len() != member.image.exposure.weight.len()
                || minimum.coefficients_nm.len() != member.fitter.model.optics.modes()
            {
                return Ok(None);
            }
            member.image.exposure.weight.copy_from_slice(weights);
            reject_without_weight(&mut member.image);
            let minimum = Minimum { images: places.len(), ..minimum.clone() };
            images.push((member.status(&minimum), (member.place, member.image, minimum)));
        }
        let Some(fitted) = FittedGroup::of_stored(stored, unfitted.prior) else { return Ok(None) };
        self.control.step(1);
        let is_explained = images.iter().all(|(status, _)| *status == Status::Ok);
        let refusal = refusal_of(images.iter().map(|(status, _)| *status));
        let images = images.into_iter().map(|(_, image)| image).collect();
        Ok(Some(GroupFit { group: fitted, minima: stored.minima, is_explained, refusal, images }))
    }

    /// The fit of a group, its number and the places of its images; and whether it was made.
    fn take_or_fit(
        &self,
        (group, places): (usize, &[[usize; 2]]),
        how: (Option<&[f64]>, Search),
        series: &GroupSeries,
    ) -> Result<(bool, GroupFit)> {
        match self.restored((group, places), series)? {
            Some(found) => Ok((false, found)),
            None => Ok((true, self.fit(places, how)?)),
        }
    }
}

/// The error of `groups` none of which can be used, one for this `reason`.
fn none_of(groups: &[Vec<[usize; 2]>], reason: &str) -> Error {
    Error::Image(format!("each of {} groups has an image that cannot be used: {reason}", groups.len()))
}

/// Why an image of a group with these statuses cannot be used.
fn refusal_of(statuses: impl Iterator<Item = Status>) -> Option<String> {
    statuses.into_iter().find_map(|status| match status {
        Status::Unusable(refusal) => Some(refusal.to_string()),
        _ => None,
    })
}

impl Sequence<'_> {
    /// # Errors
    /// As [`Sequence::estimate`].
    fn prepared(&self) -> Result<Prepared<'_>> {
        let &Self { scene, channels, groups, control, .. } = self;
        check_same_modes(channels.iter().map(|channel| &channel.fitter))?;
        let fits = channels.iter().map(|channel| channel.fitter.prepared(&channel.cube)).collect::<Result<Vec<_>>>()?;
        let (fitters, names): (Vec<_>, Vec<_>) =
            channels.iter().map(|channel| (channel.fitter.clone(), channel.name.clone())).unzip();
        let left_out = self.marginalise.then(|| LeftOutOfChannels::new(scene, &fitters, &names, None)).transpose()?;
        let is_usable = |&[channel, image]: &[usize; 2]| fits[channel][image].state == FitState::NotBegun;
        let numbers: Vec<usize> = (0..groups.len()).filter(|&group| groups[group].iter().all(is_usable)).collect();
        if numbers.is_empty() {
            return Err(none_of(groups, &reason_of_none(fits.iter().flatten())));
        }
        Ok(Prepared { scene, control, fitters, fits, left_out, numbers })
    }

    /// The fits of those `numbers` of the groups, the first of which begins near a wavefront and
    /// the others near the first: those of `series` are taken, the others made.
    ///
    /// # Errors
    /// As [`Sequence::estimate`].
    fn fit_each(&self, prepared: &Prepared, numbers: &[usize], series: &mut GroupSeries) -> Result<Vec<GroupFit>> {
        let of = |number: usize| (number, &self.groups[number][..]);
        let found = prepared.take_or_fit(of(numbers[0]), (self.near_nm, self.search), series)?;
        // Wavefronts of one telescope are alike.
        let near_nm = found.1.group.coefficients_nm.to_vec();
        let how = (Some(&near_nm[..]), Search::IfNeeded);
        let others = numbers[1..].par_iter().map(|&number| prepared.take_or_fit(of(number), how, series));
        let mut each = vec![found];
        each.extend(others.collect::<Result<Vec<_>>>()?);
        series.made = each.iter().filter(|(is_made, _)| *is_made).map(|(_, found)| found.images.len()).sum();
        Ok(each.into_iter().map(|(_, found)| found).collect())
    }

    /// Fits those groups that have the numbers `part`, and the first of all, near which the others
    /// are; fits of `earlier` are taken.
    ///
    /// # Errors
    /// As [`Sequence::estimate`].
    pub(crate) fn fit_part(&self, part: &[usize], mut earlier: GroupSeries) -> Result<GroupSeries> {
        self.control.enter(Stage::Fitting, part.len());
        let prepared = self.prepared()?;
        let (first, all) = (prepared.numbers[0], prepared.numbers.iter().copied());
        let numbers: Vec<usize> = all.filter(|group| *group == first || part.contains(group)).collect();
        let found = self.fit_each(&prepared, &numbers, &mut earlier)?;
        let mut series = GroupSeries::default();
        for (number, found) in numbers.into_iter().zip(found) {
            series.groups.insert(number, found.group.stored(found.minima));
            series.fits.extend(found.images.into_iter().map(|([channel, image], prepared, minimum)| {
                let weights = prepared.exposure.weight;
                ((channel, image), vec![StoredFit { step: FIRST, chain: GROUP.into(), minimum, weights }])
            }));
        }
        Ok(series)
    }

    /// Fits each group alone, the first near a wavefront and the others near the first, and
    /// combines them; fits of `series` are taken.
    ///
    /// # Errors
    /// As [`super::estimate_group`]; [`Error::Image`] where every group has an image that cannot be
    /// used.
    pub(crate) fn estimate(&self, series: &mut GroupSeries) -> Result<GroupEstimate> {
        let started = Instant::now();
        self.control.enter(Stage::Fitting, self.groups.len());
        let prepared = self.prepared()?;
        let mut found = self.fit_each(&prepared, &prepared.numbers, series)?;
        let Prepared { fitters, mut fits, left_out, numbers, .. } = prepared;
        for (place, prepared, minimum) in found.iter_mut().flat_map(|group| group.images.drain(..)) {
            let fit = &mut fits[place[0]][place[1]];
            (fit.prepared, fit.minimum, fit.state) = (prepared, minimum, FitState::Fitted);
        }
        self.control.enter(Stage::Combining, 0);
        let is_explained = found.iter().all(|group| group.is_explained) && numbers.len() == self.groups.len();
        let minima = Minima {
            has_twin: found.iter().any(|group| group.minima.has_twin),
            ..found.iter().find(|group| group.minima.is_suspicious).unwrap_or(&found[0]).minima
        };
        let refusal = found[0].refusal.clone();
        let usable = numbers.into_iter().zip(found).filter(|(_, found)| found.refusal.is_none());
        let (numbers, fitted): (Vec<usize>, Vec<FittedGroup>) =
            usable.map(|(group, found)| (group, found.group)).unzip();
        if let (true, Some(reason)) = (fitted.is_empty(), refusal) {
            return Err(none_of(self.groups, &reason));
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
}

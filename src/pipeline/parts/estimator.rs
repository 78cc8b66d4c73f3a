//! Estimators that fit a part of the images, or take the fits of parts.

use super::identity::identity;
use super::{FittedPart, Part, PartFits};
use crate::control::Stage;
use crate::modal::{FitSeries, GroupSeries};
use crate::pipeline::channels::{ChannelImages, Channels};
use crate::pipeline::cut_out::scene_of_cut_out;
use crate::pipeline::divided_images::DividedImages;
use crate::pipeline::estimate::Estimate;
use crate::pipeline::estimator::{EstimateInput, Estimator, acknowledged};
use crate::pipeline::group;
use crate::pipeline::grouping::Together;
use crate::pipeline::images::Images;
use crate::scene::{Method, Scene};
use crate::{Error, Result};
use std::collections::BTreeMap;

impl Estimator {
    /// [`Estimator::estimate`], which takes the fits of `parts` in place of its own.
    ///
    /// # Errors
    /// As [`Estimator::estimate`]; [`Error::Value`] where the parts are of another estimate.
    pub fn estimate_from_parts(
        &self,
        images: &(impl AsRef<[Images]> + ?Sized),
        parts: &mut PartFits,
    ) -> Result<Estimate> {
        self.estimate_with(images.as_ref(), None, Some(parts))
    }

    /// Fits the images of one part of the estimate from `images`, those of each channel as in
    /// [`Estimator::estimate`]. Fits of `earlier` parts, of any number and of this estimate or
    /// another, are not made again where they are its own.
    ///
    /// # Errors
    /// As [`Estimator::estimate`], except that no image of the part need be usable;
    /// [`Error::Scene`] for a MAP estimate, whose images are one problem, and for a scene with
    /// `estimate.budget_nm`.
    pub fn fit_part(
        &self,
        images: &(impl AsRef<[Images]> + ?Sized),
        part: Part,
        earlier: Vec<FittedPart>,
    ) -> Result<FittedPart> {
        if let Some(budget_nm) = self.given.estimate.budget_nm {
            return Err(Error::Scene(format!(
                "estimate.budget_nm = {budget_nm} is planned anew by every part: plan once ('cophase plan --output') and give the parts the \
                 scene that it writes"
            )));
        }
        self.fit_part_of(images.as_ref(), None, part, earlier)
    }

    /// [`Estimator::fit_part`], with `exposures` as in [`Estimator::estimate_with`].
    fn fit_part_of(
        &self,
        images: &[Images],
        exposures: Option<&[Vec<usize>]>,
        part: Part,
        earlier: Vec<FittedPart>,
    ) -> Result<FittedPart> {
        let in_order = self.begin(images)?;
        if let Some((scene, _)) = scene_of_cut_out(&self.given, &in_order)? {
            return self.variant(&scene)?.fit_part_of(images, exposures, part, earlier);
        }
        if let Some(divided) = DividedImages::of(&self.given, &in_order)? {
            let own = self.variant(&divided.scene)?;
            return own.fit_part_of(&divided.images, Some(&divided.exposures), part, earlier);
        }
        let found = self.fits_of(&in_order, exposures, part, earlier);
        self.control.enter(Stage::Idle, 0);
        acknowledged(&self.control, found)
    }

    fn fits_of(
        &self,
        images: &[&Images],
        exposures: Option<&[Vec<usize>]>,
        part: Part,
        earlier: Vec<FittedPart>,
    ) -> Result<FittedPart> {
        let cut = self.cut(images);
        let EstimateInput { scene, channels, .. } = self.ready(images, &cut)?;
        let identity = self.identity(&scene, &channels)?;
        let images = channels.iter().map(|channel| channel.images.len()).sum();
        let mut earlier = PartFits::of(identity, earlier);
        if let Some(together) = Together::of(&scene, &self.policy, &channels, exposures)? {
            together.refuse_parts(&scene)?;
            let groups = part.items(together.groups.len());
            let task = (&scene, &self.policy, &self.control);
            let GroupSeries { groups, fits, .. } =
                group::fit_part(task, &channels, &together, &groups, earlier.groups)?;
            return Ok(FittedPart { part, images, command: Vec::new(), identity, fits, groups });
        }
        let all: Vec<&ChannelImages> = channels.iter().collect();
        let channels = Channels::new(&scene, &self.policy, &self.control, &all)?;
        let mut fits = BTreeMap::new();
        for channel in 0..all.len() {
            let task = channels.task(channel);
            let which = part.items(task.images.len());
            let mut series = earlier.take(channel, which.iter().copied());
            channels.named(channel, task.fit_series(&which, &mut series))?;
            fits.extend(which.into_iter().map(|image| (channel, image)).zip(series.into_fits()));
        }
        Ok(FittedPart { part, images, command: Vec::new(), identity, fits, groups: BTreeMap::new() })
    }

    /// The series of `parts` for the fits of the `channels`.
    ///
    /// # Errors
    /// [`Error::Value`] where the parts are of another estimate.
    pub(in crate::pipeline) fn series<'a>(
        &self,
        parts: Option<&'a mut PartFits>,
        scene: &Scene,
        channels: &[ChannelImages],
    ) -> Result<Option<&'a mut [FitSeries]>> {
        let Some(parts) = parts else { return Ok(None) };
        self.check_identity(parts, scene, channels)?;
        let series = channels.iter().enumerate().map(|(number, channel)| parts.take(number, 0..channel.images.len()));
        parts.series = series.collect();
        Ok(Some(&mut parts.series))
    }

    /// The groups of `parts` for the images of the `channels` that are fitted `together`.
    ///
    /// # Errors
    /// [`Error::Value`] where the parts are of another estimate; [`Error::Scene`] where all images
    /// are one group.
    pub(in crate::pipeline) fn groups<'a>(
        &self,
        parts: Option<&'a mut PartFits>,
        scene: &Scene,
        (channels, together): (&[ChannelImages], &Together),
    ) -> Result<Option<&'a mut GroupSeries>> {
        let Some(parts) = parts else { return Ok(None) };
        together.refuse_parts(scene)?;
        self.check_identity(parts, scene, channels)?;
        Ok(Some(&mut parts.groups))
    }

    /// # Errors
    /// [`Error::Value`] where the parts are of another estimate.
    fn check_identity(&self, parts: &PartFits, scene: &Scene, channels: &[ChannelImages]) -> Result<()> {
        if parts.identity == self.identity(scene, channels)? {
            return Ok(());
        }
        Err(Error::Value(
            "the parts are of another estimate: the images or the scene have changed since they were made".into(),
        ))
    }

    /// Identity of the estimate from these images.
    ///
    /// # Errors
    /// Those of [`identity`]; [`Error::Scene`] for a MAP estimate.
    fn identity(&self, scene: &Scene, channels: &[ChannelImages]) -> Result<u128> {
        if scene.estimate.method == Method::FullPhase {
            return Err(Error::Scene(
                "estimate.method = \"full-phase\" separates static errors from all images together, which cannot be shared among parts: run \
                 it as one process, which uses all cores, or set estimate.method = \"modal\""
                    .into(),
            ));
        }
        identity(&self.policy, scene, channels)
    }
}

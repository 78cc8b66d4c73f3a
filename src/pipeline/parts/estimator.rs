//! Estimators that fit a part of the images, or take the fits of parts.

use super::identity::identity;
use super::{FittedPart, Part, PartFits};
use crate::modal::FitSeries;
use crate::pipeline::channels::{Channels, by_diversity};
use crate::pipeline::consistency::Electrons;
use crate::pipeline::control::Stage;
use crate::pipeline::cut_out::scene_of_cut_out;
use crate::pipeline::estimate::Estimate;
use crate::pipeline::estimator::{Estimator, Ready, ReadyChannels, acknowledged};
use crate::pipeline::images::Images;
use crate::pipeline::modal_task::ModalTask;
use crate::pipeline::pupil_turns::TurnedImages;
use crate::scene::{Method, Scene};
use crate::{Error, Result};
use std::collections::BTreeMap;

impl Estimator {
    /// [`Estimator::estimate_channels`], which takes the fits of `parts` in place of its own.
    ///
    /// # Errors
    /// As [`Estimator::estimate_channels`]; [`Error::Value`] where the parts are of another estimate.
    pub fn estimate_from_parts(&self, images: &[Images], parts: &mut PartFits) -> Result<Estimate> {
        self.estimate_each(images, Some(parts))
    }

    /// Fits the images of one part of the estimate from `images`, those of each channel as in [`Estimator::estimate_channels`]. Fits of
    /// `earlier` parts, of any number and of this estimate or another, are not made again where they are its own.
    ///
    /// # Errors
    /// As [`Estimator::estimate_channels`], except that no image of the part need be usable; [`Error::Scene`] for a MAP estimate, whose
    /// images are one problem, and for a scene with `estimate.budget_nm`.
    pub fn fit_part(&self, images: &[Images], part: Part, earlier: Vec<FittedPart>) -> Result<FittedPart> {
        if let Some(budget_nm) = self.given.estimate.budget_nm {
            return Err(Error::Scene(format!(
                "estimate.budget_nm = {budget_nm} is planned anew by every part: plan once ('cophase plan --output') and give the parts the \
                 scene that it writes"
            )));
        }
        let each = match (self.scene.channels(), images) {
            ([], [only]) => vec![only],
            _ => self.begin_channels(images)?,
        };
        if let Some((scene, _)) = scene_of_cut_out(&self.given, &each)? {
            return self.variant(&scene)?.fit_part(images, part, earlier);
        }
        if let Some(turned) = TurnedImages::of(&self.given, &each)? {
            return self.variant(&turned.scene)?.fit_part(&turned.images, part, earlier);
        }
        let found = self.fits_of(images, part, earlier);
        self.control.enter(Stage::Idle, 0);
        acknowledged(&self.control, found)
    }

    fn fits_of(&self, images: &[Images], part: Part, earlier: Vec<FittedPart>) -> Result<FittedPart> {
        let (policy, control) = (&self.policy, &self.control);
        if let ([], [only]) = (self.scene.channels(), images) {
            self.begin(only)?;
            let (cut, _) = only.without_odd_edge(self.given.image.fitted_shape());
            let Ready { scene, images, cache, .. } = self.ready(&cut)?;
            let identity = self.identity(&scene, &[(&scene, &images)])?;
            let task = ModalTask { scene: &scene, policy, control, cache: &cache, images: &images };
            return fitted(part, identity, images.len(), earlier, [task].into_iter(), |_, result| result);
        }
        let images = self.begin_channels(images)?;
        let cut = self.cut_channels(&images);
        let ReadyChannels { scene, channels, .. } = self.ready_channels(&images, &cut)?;
        let each: Vec<_> = channels.iter().map(|channel| (&channel.scene, &channel.images)).collect();
        let (identity, count) = (self.identity(&scene, &each)?, each.iter().map(|(_, images)| images.len()).sum());
        let [with, _] = by_diversity(&channels);
        let channels = Channels::new(&scene, policy, control, &self.cache(), &with)?;
        let tasks = (0..with.len()).map(|channel| channels.task(channel));
        fitted(part, identity, count, earlier, tasks, |channel, result| channels.named(channel, result))
    }

    /// The series of `parts` for an estimate from these images, of which each `fitted` channel has so many.
    ///
    /// # Errors
    /// [`Error::Value`] where the parts are of another estimate.
    pub(in crate::pipeline) fn series<'a>(
        &self,
        parts: Option<&'a mut PartFits>,
        scene: &Scene,
        each: &[(&Scene, &Electrons)],
        fitted: &[usize],
    ) -> Result<Option<&'a mut [FitSeries]>> {
        let Some(parts) = parts else { return Ok(None) };
        if parts.identity != self.identity(scene, each)? {
            return Err(Error::Value(
                "the parts are of another estimate: the images or the scene have changed since they were made".into(),
            ));
        }
        let series = fitted.iter().enumerate().map(|(channel, count)| parts.take(channel, 0..*count));
        parts.series = series.collect();
        Ok(Some(&mut parts.series))
    }

    /// Identity of the estimate from these images.
    ///
    /// # Errors
    /// Those of [`identity`]; [`Error::Scene`] for a MAP estimate.
    fn identity(&self, scene: &Scene, each: &[(&Scene, &Electrons)]) -> Result<u128> {
        if scene.estimate.method == Method::FullPhase {
            return Err(Error::Scene(
                "estimate.method = \"full-phase\" separates static errors from all images together, which cannot be shared among parts: run \
                 it as one process, which uses all cores, or set estimate.method = \"modal\""
                    .into(),
            ));
        }
        identity(&self.policy, scene, each)
    }
}

/// The images of `part` fitted by the task of each channel.
fn fitted<'a>(
    part: Part,
    identity: u128,
    images: usize,
    earlier: Vec<FittedPart>,
    tasks: impl Iterator<Item = ModalTask<'a>>,
    named: impl Fn(usize, Result<()>) -> Result<()>,
) -> Result<FittedPart> {
    let mut earlier = PartFits::of(identity, earlier);
    let mut fits = BTreeMap::new();
    for (channel, task) in tasks.enumerate() {
        let which = part.items(task.images.len());
        let mut series = earlier.take(channel, which.iter().copied());
        named(channel, task.fit_series(&which, &mut series))?;
        fits.extend(which.into_iter().map(|image| (channel, image)).zip(series.into_fits()));
    }
    Ok(FittedPart { part, images, command: Vec::new(), identity, fits })
}

//! Estimators that fit a part of the images, or take the fits of parts.

use super::channels;
use super::consistency::Electrons;
use super::estimator::{Estimator, Ready, ReadyChannels, acknowledged};
use super::images::Images;
use super::modal_task::ModalTask;
use super::parts::{FittedPart, Part, PartFits};
use crate::modal::{Hash, KeptFits};
use crate::scene::{Method, Scene};
use crate::{Error, Result};
use std::sync::Arc;

impl Estimator {
    /// This estimator with the fits of `parts`, which it does not make again.
    ///
    /// # Errors
    /// [`Error::Value`] where parts are not of one estimate, or not all of them are there, each once.
    pub fn with_parts(self, parts: &[FittedPart]) -> Result<Self> {
        let Some(first) = parts.first() else {
            return Err(Error::Value("there is no part: all parts of an estimate are needed".into()));
        };
        let of = first.part.of();
        for part in parts {
            if part.part.of() != of {
                let (one, other) = (first.part, part.part);
                return Err(Error::Value(format!("part {one} and part {other} are of different numbers of parts")));
            }
            if !part.is_of_same_estimate(first) {
                let (one, other) = (first.part, part.part);
                return Err(Error::Value(format!(
                    "part {one} and part {other} are of different estimates: of other images, another scene or other options"
                )));
            }
        }
        let count = |number: usize| parts.iter().filter(|part| part.part.number() == number).count();
        if let Some(twice) = (1..=of).find(|number| count(*number) > 1) {
            return Err(Error::Value(format!(
                "part {twice}/{of} is there {} times: each is needed once",
                count(twice)
            )));
        }
        let missing: Vec<String> = (1..=of).filter(|number| count(*number) == 0).map(|n| n.to_string()).collect();
        if !missing.is_empty() {
            let noun = if missing.len() == 1 { "part" } else { "parts" };
            let missing = missing.join(", ");
            return Err(Error::Value(format!("{noun} {missing} of {of} is missing: all are needed")));
        }
        Ok(Self { parts: Some(PartFits::of(parts, Some(first.identity))), ..self })
    }

    /// This estimator with the fits of some parts, of this estimate or another: those that are its own are not made again.
    pub fn with_fits_of(self, parts: &[FittedPart]) -> Self {
        Self { parts: Some(PartFits::of(parts, None)), ..self }
    }

    /// Number of fits of images that calls have made with [`Estimator::with_parts`] because no part had them.
    pub fn fits_made(&self) -> usize {
        self.parts.as_ref().map_or(0, |parts| parts.kept.made())
    }

    /// Fits the images of one part of the estimate from `images`, those of each channel as in [`Estimator::estimate_channels`].
    ///
    /// # Errors
    /// As [`Estimator::estimate_channels`], except that no image of the part need be usable; [`Error::Scene`] for a MAP estimate, whose
    /// images are one problem, and for a scene with `estimate.budget_nm`.
    pub fn fit_part(&self, images: &[Images], part: Part) -> Result<FittedPart> {
        if let Some(budget_nm) = self.given.estimate.budget_nm {
            return Err(Error::Scene(format!(
                "estimate.budget_nm = {budget_nm} is planned anew by every part: plan once ('cophase plan --output') and give the parts the \
                 scene that it writes"
            )));
        }
        let kept = self.parts.as_ref().map_or_else(Default::default, |parts| parts.kept.clone());
        let found = self.fit_part_into(images, part, &kept);
        self.control.enter(super::Stage::Idle, 0);
        let (identity, images) = acknowledged(&self.control, found)?;
        Ok(FittedPart { part, images, command: Vec::new(), identity, fits: kept.used(), psfs: kept.psfs() })
    }

    /// Fits the images of `part` into `kept`; returns the identity of the estimate, and the number of its images.
    fn fit_part_into(&self, images: &[Images], part: Part, kept: &Arc<KeptFits>) -> Result<(u128, usize)> {
        let (policy, control) = (&self.policy, &self.control);
        if let ([], [only]) = (self.scene.channels(), images) {
            self.begin(only)?;
            let (cut, _) = only.without_odd_edge(self.given.image.fitted_shape());
            let Ready { scene, images, cache, .. } = self.ready(&cut)?;
            refuse_map(&scene)?;
            let (images, kept) = (&images, Some(kept));
            ModalTask { scene: &scene, policy, control, cache: &cache, images, kept }
                .fit_share(&part.items(images.len()))?;
            return Ok((self.identity(&scene, &[(&scene, images)]), images.len()));
        }
        let images = self.begin_channels(images)?;
        let cut = self.cut_channels(&images);
        let ReadyChannels { scene, channels, .. } = self.ready_channels(&images, &cut)?;
        refuse_map(&scene)?;
        channels::fit_share(&scene, policy, control, &self.cache(), &channels, (kept, part))?;
        let each: Vec<_> = channels.iter().map(|channel| (&channel.scene, &channel.images)).collect();
        Ok((self.identity(&scene, &each), channels.iter().map(|channel| channel.images.len()).sum()))
    }

    /// The fits of the parts, for an estimate from these images.
    ///
    /// # Errors
    /// [`Error::Value`] where the parts are of another estimate.
    pub(super) fn kept_for(&self, scene: &Scene, each: &[(&Scene, &Electrons)]) -> Result<Option<&Arc<KeptFits>>> {
        let Some(parts) = &self.parts else { return Ok(None) };
        if parts.identity.is_some_and(|identity| identity != self.identity(scene, each)) {
            return Err(Error::Value(
                "the parts are of another estimate: the images or the scene have changed since they were made".into(),
            ));
        }
        Ok(Some(&parts.kept))
    }

    /// Hash of what an estimate depends on.
    fn identity(&self, scene: &Scene, each: &[(&Scene, &Electrons)]) -> u128 {
        let start = Hash::new().text(env!("CARGO_PKG_VERSION")).text(scene.text()).text(&format!("{:?}", self.policy));
        let of_channel = |hash: Hash, (scene, images): &(&Scene, &Electrons)| {
            let noise = images.read_noise_e.unwrap_or(-1.0);
            let pairs = images.images_e.outer_iter().zip(images.bad.outer_iter());
            pairs.fold(hash.text(scene.text()).numbers(&[noise]), |hash, (data_e, bad)| hash.frame(data_e, bad))
        };
        each.iter().fold(start, of_channel).value()
    }
}

/// Refuses a scene whose images are not fitted one by one.
fn refuse_map(scene: &Scene) -> Result<()> {
    if scene.estimate.method != Method::FullPhase {
        return Ok(());
    }
    Err(Error::Scene(
        "estimate.method = \"full-phase\" separates static errors from all images together, which cannot be shared among parts: run it as \
         one process, which uses all cores, or set estimate.method = \"modal\""
            .into(),
    ))
}

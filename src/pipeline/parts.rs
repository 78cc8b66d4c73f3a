//! Parts of an estimate: the fits of some of its images, made by one process of several, and the estimate from all of them.
//!
//! Part i of n has every n-th image from the i-th on. It ends with the fits of its images; an estimator that is given the parts
//! ([`Estimator::with_parts`]) makes the estimate as without them, and takes the fits from them. What no part could foresee,
//! because it depends on all images (restarts of fits that are outliers of a sequence, a larger model), it makes itself, so that
//! the estimate has the bits of one run.

use super::channels;
use super::consistency::Electrons;
use super::estimator::{Estimator, Ready, ReadyChannels, acknowledged};
use super::images::Images;
use super::modal_task::ModalTask;
use crate::modal::{Hash, KeptFit, KeptFits};
use crate::scene::{Method, Scene};
use crate::{Error, Result};
use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

/// Part `number` of `of`, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Part {
    number: usize,
    of: usize,
}

impl Part {
    /// Part `number` of `of`, counted from 1.
    ///
    /// # Errors
    /// [`Error::Value`] for a number that is not among 1 to `of`.
    pub fn new(number: usize, of: usize) -> Result<Self> {
        if (1..=of).contains(&number) {
            return Ok(Self { number, of });
        }
        Err(Error::Value(format!("part {number}/{of} does not exist: 1/N to N/N are the parts of N")))
    }

    /// Its number, from 1.
    pub fn number(self) -> usize {
        self.number
    }

    /// The number of all parts.
    pub fn of(self) -> usize {
        self.of
    }

    /// Its items of `count`: every `of`-th.
    pub fn items(self, count: usize) -> Vec<usize> {
        (self.number - 1..count).step_by(self.of).collect()
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Part {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        let numbers = text.split_once('/').and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
        let (number, of) =
            numbers.ok_or_else(|| Error::Value(format!("'{text:.60}' is no part: I/N is accepted, such as 1/8")))?;
        Self::new(number, of)
    }
}

/// Fits of one part of an estimate.
#[derive(Debug, Clone)]
pub struct FittedPart {
    /// Which part it is.
    pub part: Part,
    /// Number of images of the whole estimate, all channels together.
    pub images: usize,
    /// The command that made it, for a program that goes on with it: its words.
    pub command: Vec<String>,
    /// Hash of images, scene and policy of the whole estimate.
    pub(super) identity: u128,
    /// By ascending key.
    pub(super) fits: Vec<(u128, Arc<KeptFit>)>,
}

impl FittedPart {
    /// Number of fits: one for each image that can be used, and those of outlier rejection and restarts.
    pub fn fits(&self) -> usize {
        self.fits.len()
    }

    /// Whether both are of one estimate: of the same images, scene and policy.
    pub fn is_of_same_estimate(&self, other: &Self) -> bool {
        self.identity == other.identity && self.images == other.images
    }
}

/// Fits of parts, for the estimate that they are of.
pub(super) struct PartFits {
    identity: Option<u128>,
    kept: Arc<KeptFits>,
}

impl Estimator {
    /// This estimator with the fits of `parts`, which it does not make again.
    ///
    /// # Errors
    /// [`Error::Value`] where parts are not of one estimate, or not all of them are there, each once.
    pub fn with_parts(self, parts: &[FittedPart]) -> Result<Self> {
        let Some(first) = parts.first() else {
            return Err(Error::Value("there is no part: all parts of an estimate are needed".into()));
        };
        let of = first.part.of;
        for part in parts {
            if part.part.of != of {
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
        let count = |number: usize| parts.iter().filter(|part| part.part.number == number).count();
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
        let kept = KeptFits::new(parts.iter().flat_map(|part| part.fits.iter().cloned()));
        Ok(Self { parts: Some(PartFits { identity: Some(first.identity), kept: Arc::new(kept) }), ..self })
    }

    /// This estimator with the fits of some parts, of this estimate or another: those that are its own are not made again.
    pub fn with_fits_of(self, parts: &[FittedPart]) -> Self {
        let kept = KeptFits::new(parts.iter().flat_map(|part| part.fits.iter().cloned()));
        Self { parts: Some(PartFits { identity: None, kept: Arc::new(kept) }), ..self }
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
        Ok(FittedPart { part, images, command: Vec::new(), identity, fits: kept.used() })
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
        channels::fit_share(&scene, policy, control, &self.cache, &channels, (kept, part))?;
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
            pairs.fold(hash.text(scene.text()).numbers([&noise]), |hash, (data_e, bad)| hash.frame(data_e, bad))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_have_each_item_once_and_bad_words_are_refused() {
        let of = |of: usize, count: usize| -> Vec<usize> {
            let mut items: Vec<usize> =
                (1..=of).flat_map(|number| Part::new(number, of).unwrap().items(count)).collect();
            items.sort_unstable();
            items
        };
        for (parts, count) in [(1, 5), (2, 5), (4, 75), (8, 3)] {
            assert_eq!(of(parts, count), (0..count).collect::<Vec<_>>());
        }
        assert_eq!("3/8".parse::<Part>().unwrap(), Part { number: 3, of: 8 });
        for odd in ["", "3", "0/8", "9/8", "1/0", "a/b", "1/2/3"] {
            assert!(odd.parse::<Part>().is_err(), "{odd}");
        }
    }
}

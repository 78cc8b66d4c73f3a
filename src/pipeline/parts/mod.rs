//! Parts of an estimate: the fits of some of its images, made by one process of several, and the
//! estimate from all of them.
//!
//! Part i of n has every n-th image, or group of a sequence of groups, from the i-th on. It ends
//! with the fits of its images ([`Estimator::fit_part`]), and is a file ([`FittedPart::write`]).
//! [`Estimator::estimate_from_parts`] makes the estimate as without them, and takes the fits from
//! them. Fits that depend on all images (restarts of those that are outliers of a sequence, a
//! larger model) are in no part: it makes them itself, so that the estimate has the bits of one
//! run. The first group of a sequence of groups, near which the others are fitted, is in every
//! part.
//!
//! [`Estimator::fit_part`]: super::Estimator::fit_part
//! [`Estimator::estimate_from_parts`]: super::Estimator::estimate_from_parts

mod estimator;
mod file;
mod identity;

use crate::modal::{FitSeries, GroupSeries, StoredFit, StoredGroup};
use crate::{Error, Result};
use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

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
    /// The arguments of the command that made it, from which a program makes the other parts.
    pub command: Vec<String>,
    /// Identity of the whole estimate.
    identity: u128,
    fits: Fits,
    /// Of a sequence of groups, by their numbers, what each says.
    groups: BTreeMap<usize, StoredGroup>,
}

/// Fits of each image in the order in which they were made, by channel and image.
type Fits = BTreeMap<(usize, usize), Vec<StoredFit>>;

impl FittedPart {
    /// Number of fits: one for each image that can be used, and those of outlier rejection and
    /// restarts.
    pub fn fits(&self) -> usize {
        self.fits.values().map(Vec::len).sum()
    }

    /// Whether both are of one estimate: of the same images, scene and policy.
    pub fn is_of_same_estimate(&self, other: &Self) -> bool {
        self.identity == other.identity && self.images == other.images
    }
}

/// Fits of parts, for the estimate that they are of.
pub struct PartFits {
    identity: u128,
    /// What is left of the fits, and the groups.
    groups: GroupSeries,
    /// Of each channel, in the estimate that takes them.
    series: Vec<FitSeries>,
}

impl PartFits {
    /// The fits of all parts of an estimate.
    ///
    /// # Errors
    /// [`Error::Value`] where parts are not of one estimate, or not all of them are there, each
    /// once.
    pub fn of_all(parts: Vec<FittedPart>) -> Result<Self> {
        let Some(first) = parts.first() else {
            return Err(Error::Value("there is no part: all parts of an estimate are needed".into()));
        };
        let (one, of, identity) = (first.part, first.part.of, first.identity);
        for other in &parts {
            let fault = if other.part.of != of {
                "different numbers of parts"
            } else if !other.is_of_same_estimate(first) {
                "different estimates: of other images, another scene or other options"
            } else {
                continue;
            };
            return Err(Error::Value(format!("part {one} and part {} are of {fault}", other.part)));
        }
        let count = |number: usize| parts.iter().filter(|part| part.part.number == number).count();
        if let Some(twice) = (1..=of).find(|number| count(*number) > 1) {
            let times = count(twice);
            return Err(Error::Value(format!("part {twice}/{of} is there {times} times: each is needed once")));
        }
        let missing: Vec<String> = (1..=of).filter(|number| count(*number) == 0).map(|n| n.to_string()).collect();
        if !missing.is_empty() {
            let noun = if missing.len() == 1 { "part" } else { "parts" };
            let missing = missing.join(", ");
            return Err(Error::Value(format!("{noun} {missing} of {of} is missing: all are needed")));
        }
        Ok(Self::of(identity, parts))
    }

    /// The fits of those `parts` that are of the estimate `identity`; of an image in two, those of
    /// the last.
    fn of(identity: u128, parts: Vec<FittedPart>) -> Self {
        let mut groups = GroupSeries::default();
        for part in parts.into_iter().filter(|part| part.identity == identity) {
            groups.fits.extend(part.fits);
            groups.groups.extend(part.groups);
        }
        Self { identity, groups, series: Vec::new() }
    }

    /// Takes out the fits of these images of a channel.
    fn take(&mut self, channel: usize, images: impl Iterator<Item = usize>) -> FitSeries {
        FitSeries::new(images.map(|image| self.groups.fits.remove(&(channel, image)).unwrap_or_default()))
    }

    /// Number of fits of images that the estimate has made because no part had them.
    pub fn made(&self) -> usize {
        self.groups.made + self.series.iter().map(FitSeries::made).sum::<usize>()
    }
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

//! Parts of an estimate: the fits of some of its images, made by one process of several, and the estimate from all of them.
//!
//! Part i of n has every n-th image from the i-th on. It ends with the fits of its images; an estimator that is given the parts
//! ([`Estimator::with_parts`](super::Estimator::with_parts)) makes the estimate as without them, and takes the fits from them. What no part could foresee,
//! because it depends on all images (restarts of fits that are outliers of a sequence, a larger model), it makes itself, so that
//! the estimate has the bits of one run.

use crate::modal::{KeptFit, KeptFits, KeptPsf};
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
    /// PSFs at the ends of fits, by ascending key.
    pub(super) psfs: Vec<KeptPsf>,
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
    /// Identity of the estimate that they are of; `None` where they may be of others.
    pub(super) identity: Option<u128>,
    pub(super) kept: Arc<KeptFits>,
}

impl PartFits {
    /// The fits of `parts`.
    pub(super) fn of(parts: &[FittedPart], identity: Option<u128>) -> Self {
        let fits = parts.iter().flat_map(|part| part.fits.iter().cloned());
        let psfs = parts.iter().flat_map(|part| part.psfs.iter().cloned());
        Self { identity, kept: Arc::new(KeptFits::new(fits, psfs)) }
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

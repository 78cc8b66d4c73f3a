//! Fits of groups that were made before, for an estimate that takes them in place of its own.

use crate::modal::group::Minima;
use crate::modal::solve::fit_series::StoredFit;
use std::collections::BTreeMap;

/// What the fit of a group says of the wavefront; see [`super::mean`].
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StoredGroup {
    pub(crate) coefficients_nm: Vec<f64>,
    /// Of a relative error 1 of the amplitude of all diversities, by the modes.
    pub(crate) effect: Vec<f64>,
    /// By the modes and what they leave out.
    pub(crate) score: Vec<f64>,
    /// Row after row.
    pub(crate) information: Vec<f64>,
    /// Levels of the prior.
    pub(crate) levels_nm: Vec<f64>,
    pub(crate) inflation: f64,
    pub(crate) pixels: usize,
    pub(crate) minima: Minima,
}

/// Groups of a sequence by their numbers, and the fits of their images by channel and number.
#[derive(Default)]
pub(crate) struct GroupSeries {
    pub(crate) groups: BTreeMap<usize, StoredGroup>,
    pub(crate) fits: BTreeMap<(usize, usize), Vec<StoredFit>>,
    /// Number of fits of images that were not there and were made.
    pub(crate) made: usize,
}

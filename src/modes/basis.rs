//! Modes given as maps on the pupil grid: segment modes, and bases from a file.
//!
//! A segment mode is zero outside its segment and is stored as a list of its samples: three modes
//! of each of 798 segments on a grid of 1,024 samples a side take 19 GB as maps and 30 MB as lists.

mod products;

use crate::{Error, Result};
use ndarray::{Array3, ArrayViewMut2, Axis, s};
use std::collections::HashSet;
use std::ops::Range;

/// The estimated wavefront to which a mode belongs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Group {
    /// Phasing of the segments.
    Segment,
    /// Non-common path aberrations.
    Ncpa,
}

impl Group {
    /// Name in files: `segment` or `ncpa`.
    pub fn name(self) -> &'static str {
        match self {
            Group::Segment => "segment",
            Group::Ncpa => "ncpa",
        }
    }

    /// The group of that name. Surrounding white space, as in FITS tables, is ignored.
    ///
    /// # Errors
    /// [`Error::Value`] for any other name.
    pub fn parse(name: &str) -> Result<Self> {
        match name.trim() {
            "segment" => Ok(Group::Segment),
            "ncpa" => Ok(Group::Ncpa),
            other => Err(Error::Value(format!("mode group {other:.40?} is unknown: segment and ncpa are accepted"))),
        }
    }
}

/// A map as a list of its nonzero samples: `(y·samples + x, value)`, in ascending order.
pub(super) type SparseMap = Vec<(u32, f64)>;

/// Modes given by their values at the samples of a grid, OPD in nm per nm of coefficient. They
/// cannot be evaluated elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    names: Vec<String>,
    groups: Vec<Group>,
    /// The sparse modes, which precede the others.
    sparse: Vec<SparseMap>,
    /// The other modes, `[mode, y, x]`.
    dense: Array3<f64>,
}

impl Basis {
    /// Modes from a cube `[modes, y, x]` on the pupil grid, with a name and a group for each. Names
    /// are trimmed.
    ///
    /// # Errors
    /// [`Error::Shape`] where numbers differ or the maps are not square; [`Error::Value`] for a
    /// sample that is not finite or a name that is empty or used twice.
    pub fn from_cube(names: Vec<String>, groups: Vec<Group>, maps: Array3<f64>) -> Result<Self> {
        let (_, rows, columns) = maps.dim();
        if rows != columns {
            return Err(Error::Shape(format!("mode maps of {rows}×{columns} samples were given: they must be square")));
        }
        Self::checked(names, groups, Vec::new(), maps)
    }

    /// Modes given as lists of their nonzero samples, on a grid of `samples` a side.
    ///
    /// # Errors
    /// As [`Basis::from_cube`].
    pub(crate) fn from_lists(
        names: Vec<String>,
        groups: Vec<Group>,
        samples: usize,
        sparse: Vec<SparseMap>,
    ) -> Result<Self> {
        Self::checked(names, groups, sparse, Array3::zeros((0, samples, samples)))
    }

    fn checked(names: Vec<String>, groups: Vec<Group>, sparse: Vec<SparseMap>, dense: Array3<f64>) -> Result<Self> {
        let modes = sparse.len() + dense.dim().0;
        if names.len() != modes || groups.len() != modes {
            let text = format!(
                "{} names and {} groups were given for {modes} mode maps: as many of each are needed",
                names.len(),
                groups.len()
            );
            return Err(Error::Shape(text));
        }
        let names: Vec<String> = names.iter().map(|name| name.trim().to_owned()).collect();
        let mut seen = HashSet::new();
        if let Some(name) = names.iter().find(|name| name.is_empty() || !seen.insert(*name)) {
            return Err(Error::Value(format!("mode name {name:.80?} is empty or used twice: each mode needs its own")));
        }
        let samples = dense.dim().1;
        let lists = sparse.iter().zip(&names).flat_map(|(list, name)| list.iter().map(move |&(at, v)| (name, at, v)));
        let of_sparse = lists.map(|(name, at, v)| (name, [at as usize / samples, at as usize % samples], v));
        let maps = dense.outer_iter().zip(&names[sparse.len()..]);
        let broken = maps.filter(|(map, _)| !map.iter().all(|value| value.is_finite())).filter_map(|(map, name)| {
            map.indexed_iter().find(|(_, value)| !value.is_finite()).map(|((row, column), &v)| (name, [row, column], v))
        });
        if let Some((name, [row, column], value)) = of_sparse.filter(|(.., v)| !v.is_finite()).chain(broken).next() {
            let text = format!("mode {name:.80} is {value} at [{row}, {column}]: finite samples are needed");
            return Err(Error::Value(text));
        }
        Ok(Self { names, groups, sparse, dense })
    }

    /// Number of modes.
    pub fn len(&self) -> usize {
        self.names.len()
    }

    /// Whether there is no mode.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Names of the modes.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Groups of the modes.
    pub fn groups(&self) -> &[Group] {
        &self.groups
    }

    /// Samples along a side of the maps.
    pub fn samples(&self) -> usize {
        self.dense.dim().1
    }

    /// All maps, `[modes, y, x]`: gigabytes for many segments on a fine grid. [`Basis::combined`],
    /// [`Basis::along`], [`Basis::gram`] and [`Basis::variance`] do not need them.
    pub fn maps(&self) -> Array3<f64> {
        let samples = self.samples();
        let mut maps = Array3::zeros((self.len(), samples, samples));
        for (list, map) in self.sparse.iter().zip(maps.outer_iter_mut()) {
            scatter(list, map);
        }
        maps.slice_mut(s![self.sparse.len().., .., ..]).assign(&self.dense);
        maps
    }

    /// The modes `modes` alone.
    pub(crate) fn part(&self, modes: Range<usize>) -> Self {
        let lists = self.sparse.len();
        let sparse = self.sparse[modes.start.min(lists)..modes.end.min(lists)].to_vec();
        let dense =
            self.dense.slice(s![modes.start.max(lists) - lists..modes.end.max(lists) - lists, .., ..]).to_owned();
        Self { names: self.names[modes.clone()].to_vec(), groups: self.groups[modes].to_vec(), sparse, dense }
    }

    /// These modes, then those of `other`.
    ///
    /// # Errors
    /// [`Error::Shape`] where the maps differ in shape; [`Error::Value`] where a name appears in
    /// both.
    pub fn followed_by(mut self, other: Self) -> Result<Self> {
        let (left, right) = (self.samples(), other.samples());
        if left != right {
            return Err(Error::Shape(format!(
                "bases on grids of {left} and {right} samples cannot be joined: one grid is needed"
            )));
        }
        // Sparse modes come first; after a dense mode they are stored as dense.
        let maps = (!self.dense.is_empty() && !other.sparse.is_empty()).then(|| other.maps());
        let dense = maps.unwrap_or(other.dense);
        if self.dense.is_empty() {
            self.sparse.extend(other.sparse);
            self.dense = dense;
        } else {
            self.dense.append(Axis(0), dense.view()).map_err(|error| Error::Internal(error.to_string()))?;
        }
        self.names.extend(other.names);
        self.groups.extend(other.groups);
        Self::checked(self.names, self.groups, self.sparse, self.dense)
    }
}

/// Writes the samples of a list into a map of zeros.
fn scatter(list: &SparseMap, mut map: ArrayViewMut2<f64>) {
    let samples = map.ncols();
    list.iter().for_each(|&(at, value)| map[[at as usize / samples, at as usize % samples]] = value);
}

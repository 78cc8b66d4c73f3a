//! Modes given as maps on the pupil grid: segment modes, and bases from a file.

use crate::{Error, Result};
use ndarray::{Array2, Array3, ArrayView3, Axis};
use std::collections::HashSet;

/// Which of the two estimated wavefronts a mode belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Group {
    /// Phasing of the segments.
    Segment,
    /// Non-common path aberrations.
    Ncpa,
}

impl Group {
    /// The name in files: `segment` or `ncpa`.
    pub fn name(self) -> &'static str {
        match self {
            Group::Segment => "segment",
            Group::Ncpa => "ncpa",
        }
    }

    /// The group of that name; white space around it, as FITS tables leave it, does not matter.
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

/// Modes known by their samples only, OPD in nm per nm of coefficient; they cannot be evaluated elsewhere.
#[derive(Debug, Clone, PartialEq)]
pub struct Basis {
    names: Vec<String>,
    groups: Vec<Group>,
    maps: Array3<f64>,
}

impl Basis {
    /// Modes from a cube `[modes, y, x]` on the pupil grid, with a name and a group each. Names are trimmed.
    ///
    /// # Errors
    /// [`Error::Shape`] where numbers differ or the maps are not square; [`Error::Value`] for a sample that is not
    /// finite or a name that is empty or used twice.
    pub fn from_cube(names: Vec<String>, groups: Vec<Group>, maps: Array3<f64>) -> Result<Self> {
        let (modes, rows, columns) = maps.dim();
        if names.len() != modes || groups.len() != modes {
            let text = format!(
                "{} names and {} groups were given for {modes} mode maps: as many of each are needed",
                names.len(),
                groups.len()
            );
            return Err(Error::Shape(text));
        }
        if rows != columns {
            return Err(Error::Shape(format!("mode maps of {rows}×{columns} samples were given: they must be square")));
        }
        let names: Vec<String> = names.iter().map(|name| name.trim().to_owned()).collect();
        let mut seen = HashSet::new();
        for (name, map) in names.iter().zip(maps.outer_iter()) {
            if name.is_empty() || !seen.insert(name) {
                return Err(Error::Value(format!(
                    "mode name {name:.80?} is empty or used twice: each mode needs its own"
                )));
            }
            if let Some(((row, column), value)) = map.indexed_iter().find(|(_, value)| !value.is_finite()) {
                let text = format!("mode {name:.80} is {value} at [{row}, {column}]: finite samples are needed");
                return Err(Error::Value(text));
            }
        }
        Ok(Self { names, groups, maps })
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

    /// The maps, `[modes, y, x]`.
    pub fn maps(&self) -> ArrayView3<'_, f64> {
        self.maps.view()
    }

    /// These modes, then those of `other`.
    ///
    /// # Errors
    /// [`Error::Shape`] where the maps differ in shape; [`Error::Value`] where a name appears in both.
    pub fn followed_by(&self, other: &Self) -> Result<Self> {
        let maps = ndarray::concatenate(Axis(0), &[self.maps.view(), other.maps.view()]).map_err(|_| {
            let (_, left, _) = self.maps.dim();
            let (_, right, _) = other.maps.dim();
            Error::Shape(format!("bases on grids of {left} and {right} samples cannot be joined: one grid is needed"))
        })?;
        let names = self.names.iter().chain(&other.names).cloned().collect();
        Self::from_cube(names, self.groups.iter().chain(&other.groups).copied().collect(), maps)
    }

    /// Mean products of the modes over the pupil, `[modes, modes]`, weighted by `amplitude` `[y, x]` and with the mean
    /// of each mode removed first: what an image can see of them, since it never sees piston.
    ///
    /// # Errors
    /// [`Error::Shape`] where the amplitude has another shape than the maps; [`Error::Value`] where it sums to no
    /// positive number.
    pub fn visible_gram(&self, amplitude: &Array2<f64>) -> Result<Array2<f64>> {
        let (modes, rows, columns) = self.maps.dim();
        if amplitude.dim() != (rows, columns) {
            let text =
                format!("an amplitude of shape {:?} was given: {:?} is needed", amplitude.dim(), (rows, columns));
            return Err(Error::Shape(text));
        }
        let total = amplitude.sum();
        if !(total.is_finite() && total > 0.0) {
            return Err(Error::Value(format!("the pupil amplitude sums to {total}: a positive sum is needed")));
        }
        let lit: Vec<(usize, usize)> =
            amplitude.indexed_iter().filter(|(_, a)| **a != 0.0).map(|(index, _)| index).collect();
        let weights: Vec<f64> = lit.iter().map(|&index| amplitude[index] / total).collect();
        let mut values = Array2::from_shape_fn((modes, lit.len()), |(mode, point)| {
            let (row, column) = lit[point];
            self.maps[[mode, row, column]]
        });
        for mut mode in values.rows_mut() {
            let mean: f64 = mode.iter().zip(&weights).map(|(value, weight)| value * weight).sum();
            mode -= mean;
        }
        Ok((&values * &ndarray::aview1(&weights)).dot(&values.t()))
    }
}

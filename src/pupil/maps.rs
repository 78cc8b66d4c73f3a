//! Pupils given as maps, for instance from FITS files.

use super::sampled::{Pupil, Segment};
use crate::grid::Grid;
use crate::{Error, Result};
use ndarray::Array2;

/// Largest distance of an unlabelled illuminated sample from a labelled one, in samples: at an anti-aliased edge or a gap.
/// A larger distance means that a label is missing.
const RIM: usize = 2;

/// A pupil on a grid finer than the model's, with the segment of each sample: the input of a band-limited pupil. Its
/// maps are checked and cannot be changed.
#[derive(Debug, Clone)]
pub struct FinePupil(Pupil);

impl FinePupil {
    /// Checks and stores the maps `[y, x]`, as [`Pupil::from_maps`].
    ///
    /// # Errors
    /// Those of [`Pupil::from_maps`].
    pub fn new(grid: Grid, amplitude: Array2<f64>, labels: Option<Array2<i32>>) -> Result<Self> {
        Ok(Self(Pupil::from_maps(grid, amplitude, labels)?))
    }

    /// The maps.
    pub fn pupil(&self) -> &Pupil {
        &self.0
    }

    /// Grid of the maps.
    pub fn grid(&self) -> &Grid {
        &self.0.grid
    }

    /// Whether the maps are fine enough to be band-limited onto `grid`: at least twice as fine.
    pub fn resolves(&self, grid: &Grid) -> bool {
        self.grid().pitch_m() <= grid.pitch_m() / 2.0 * (1.0 + 1e-12)
    }
}

impl Pupil {
    /// A pupil from its maps: `amplitude` `[y, x]` in [0, 1], `labels` `[y, x]` = 0, 1, … for the segments and negative
    /// elsewhere; without labels, one segment (a monolithic telescope).
    ///
    /// An illuminated sample without a label takes the label of the nearest labelled illuminated sample within two samples (at
    /// an anti-aliased edge or a gap); a label outside the illuminated area is ignored. The centre of a segment is the
    /// centroid of its amplitude.
    ///
    /// # Errors
    /// [`Error::Shape`] for maps that do not have the grid's shape; [`Error::Value`] for an amplitude outside [0, 1] or
    /// not finite, a pupil without illuminated samples, a number between 0 and the largest label that no illuminated sample has, or
    /// an illuminated sample farther than two samples from any labelled one.
    pub fn from_maps(grid: Grid, amplitude: Array2<f64>, labels: Option<Array2<i32>>) -> Result<Self> {
        let samples = grid.samples();
        check_shape("pupil amplitude", amplitude.dim(), samples)?;
        if let Some(((y, x), value)) = amplitude.indexed_iter().find(|(_, a)| !(0.0..=1.0).contains(*a)) {
            return Err(Error::Value(format!(
                "the pupil amplitude at row {y}, column {x} is {value}: values in [0, 1] are accepted"
            )));
        }
        if !amplitude.iter().any(|&a| a > 0.0) {
            return Err(Error::Value(
                "the pupil amplitude is 0 everywhere: at least one illuminated sample is needed".into(),
            ));
        }
        let owner = match labels {
            None => amplitude.mapv(|a| if a > 0.0 { 0 } else { -1 }),
            Some(labels) => {
                check_shape("segment labels", labels.dim(), samples)?;
                owners(&amplitude, &labels)?
            }
        };
        let segments = centroids(&grid, &amplitude, &owner)?;
        Ok(Self { grid, amplitude, owner, segments })
    }
}

fn check_shape(name: &str, (rows, columns): (usize, usize), samples: usize) -> Result<()> {
    if (rows, columns) == (samples, samples) {
        return Ok(());
    }
    Err(Error::Shape(format!("the map of {name} is {rows} × {columns}: the grid needs {samples} × {samples}")))
}

/// The segment of each illuminated sample, −1 elsewhere.
fn owners(amplitude: &Array2<f64>, labels: &Array2<i32>) -> Result<Array2<i32>> {
    let mut owner = Array2::from_elem(labels.dim(), -1);
    for ((y, x), &a) in amplitude.indexed_iter() {
        if a > 0.0 {
            owner[[y, x]] = nearest_label(amplitude, labels, y, x).ok_or_else(|| {
                Error::Value(format!(
                    "the pupil is illuminated at row {y}, column {x}, but there is no segment label within {RIM} samples: label \
                     the segments 0, 1, …, and all other samples −1"
                ))
            })?;
        }
    }
    Ok(owner)
}

/// The label of the nearest labelled illuminated sample; among equally near ones, the first in grid order.
fn nearest_label(amplitude: &Array2<f64>, labels: &Array2<i32>, y: usize, x: usize) -> Option<i32> {
    if labels[[y, x]] >= 0 {
        return Some(labels[[y, x]]);
    }
    let around = |c: usize, end: usize| c.saturating_sub(RIM)..(c + RIM + 1).min(end);
    let near = around(y, labels.nrows()).flat_map(|v| around(x, labels.ncols()).map(move |u| (v, u)));
    near.filter(|&at| labels[at] >= 0 && amplitude[at] > 0.0)
        .min_by_key(|&(v, u)| v.abs_diff(y).pow(2) + u.abs_diff(x).pow(2))
        .map(|at| labels[at])
}

fn centroids(grid: &Grid, amplitude: &Array2<f64>, owner: &Array2<i32>) -> Result<Vec<Segment>> {
    let largest = owner.iter().copied().max().unwrap_or(-1);
    // A wrong label could request gigabytes of memory: no map has more segments than samples.
    if largest as usize >= owner.len() {
        return Err(Error::Value(format!(
            "the largest segment label is {largest}, more than the map has samples: label the segments 0, 1, …"
        )));
    }
    let mut moments = vec![[0.0f64; 3]; (largest + 1) as usize];
    for ((y, x), &segment) in owner.indexed_iter().filter(|(_, segment)| **segment >= 0) {
        let a = amplitude[[y, x]];
        let moment = &mut moments[segment as usize];
        moment[0] += a;
        moment[1] += a * grid.coordinate_m(x);
        moment[2] += a * grid.coordinate_m(y);
    }
    if let Some(missing) = moments.iter().position(|m| m[0] == 0.0) {
        return Err(Error::Value(format!(
            "no illuminated sample has the segment label {missing}: labels 0 to {largest} without a hole are needed"
        )));
    }
    Ok(moments.iter().map(|[a, x, y]| Segment { x_m: x / a, y_m: y / a }).collect())
}

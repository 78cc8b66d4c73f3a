//! Pupils given as maps, for instance from FITS files.

use super::labels::owners;
use super::sampled::{Pupil, Segment};
use crate::grid::Grid;
use crate::{Error, Result};
use ndarray::Array2;

/// A pupil on a grid finer than the model's, with the segment of each sample: the input of a
/// band-limited pupil. Its maps are checked and cannot be changed.
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
    /// A pupil from its maps: `amplitude` `[y, x]` in [0, 1], `labels` `[y, x]` of 0 or more for
    /// the segments and negative elsewhere; without labels, one segment (a monolithic telescope).
    /// Segments are counted from 0 by ascending label, for labels of any values
    /// ([`Segment::label`]). Where no label is negative, 0 is no segment if only samples at the rim
    /// of others have it, as where segments are labelled from 1.
    ///
    /// An illuminated sample without a label takes the label of the nearest labelled illuminated
    /// sample within two samples (at an anti-aliased edge or a gap); a label outside the
    /// illuminated area is ignored. The centre of a segment is the centroid of its amplitude.
    ///
    /// # Errors
    /// [`Error::Shape`] for maps that do not have the grid's shape; [`Error::Value`] for an
    /// amplitude outside [0, 1] or not finite, a pupil without illuminated samples, more than
    /// 10,000 segments, or an illuminated sample farther than two samples from any labelled one.
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
        let (owner, labels) = match labels {
            None => (amplitude.mapv(|a| if a > 0.0 { 0 } else { -1 }), vec![0]),
            Some(labels) => {
                check_shape("segment labels", labels.dim(), samples)?;
                owners(&amplitude, labels)?
            }
        };
        let segments = centroids(&grid, &amplitude, &owner, &labels);
        Ok(Self { grid, amplitude, owner, segments })
    }
}

fn check_shape(name: &str, (rows, columns): (usize, usize), samples: usize) -> Result<()> {
    if (rows, columns) == (samples, samples) {
        return Ok(());
    }
    Err(Error::Shape(format!("the map of {name} is {rows} × {columns}: the grid needs {samples} × {samples}")))
}

/// The segments, whose labels these are: the centroid of the amplitude of each.
fn centroids(grid: &Grid, amplitude: &Array2<f64>, owner: &Array2<i32>, labels: &[i32]) -> Vec<Segment> {
    let mut moments = vec![[0.0f64; 3]; labels.len()];
    for ((y, x), &segment) in owner.indexed_iter().filter(|(_, segment)| **segment >= 0) {
        let a = amplitude[[y, x]];
        let moment = &mut moments[segment as usize];
        moment[0] += a;
        moment[1] += a * grid.coordinate_m(x);
        moment[2] += a * grid.coordinate_m(y);
    }
    let segment = |([a, x, y], &label): (&[f64; 3], &i32)| Segment { x_m: x / a, y_m: y / a, label };
    moments.iter().zip(labels).map(segment).collect()
}

//! The lit samples of a pupil as points with weights: all that a basis needs to know of it.

use crate::pupil::Pupil;
use crate::{Error, Result};

/// Lit samples of a pupil, in grid order, with weights that sum to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// Flat grid index `y·samples + x` of each sample.
    pub indices: Vec<usize>,
    /// Coordinate along the columns, m.
    pub xs_m: Vec<f64>,
    /// Coordinate along the rows, m.
    pub ys_m: Vec<f64>,
    /// Share of the pupil's glass.
    pub weights: Vec<f64>,
}

impl Samples {
    /// The samples of `pupil` that hold glass.
    ///
    /// # Errors
    /// [`Error::Shape`] where the amplitude does not fit the grid; [`Error::Value`] for an amplitude that is negative
    /// or not finite, or a pupil without glass.
    pub fn of(pupil: &Pupil) -> Result<Self> {
        let n = pupil.grid.samples();
        if pupil.amplitude.dim() != (n, n) {
            let text =
                format!("a pupil amplitude of shape {:?} was given: {:?} is needed", pupil.amplitude.dim(), (n, n));
            return Err(Error::Shape(text));
        }
        let mut samples = Self { indices: vec![], xs_m: vec![], ys_m: vec![], weights: vec![] };
        for ((row, column), &amplitude) in pupil.amplitude.indexed_iter() {
            if !(amplitude.is_finite() && amplitude >= 0.0) {
                let text =
                    format!("the pupil amplitude {amplitude} at [{row}, {column}] is impossible: 0 to 1 is accepted");
                return Err(Error::Value(text));
            }
            if amplitude > 0.0 {
                samples.indices.push(row * n + column);
                samples.xs_m.push(pupil.grid.coordinate_m(column));
                samples.ys_m.push(pupil.grid.coordinate_m(row));
                samples.weights.push(amplitude);
            }
        }
        let total: f64 = samples.weights.iter().sum();
        if samples.indices.is_empty() {
            return Err(Error::Value("the pupil holds no glass: at least one sample must be lit".into()));
        }
        samples.weights.iter_mut().for_each(|weight| *weight /= total);
        Ok(samples)
    }

    /// Distance of the farthest sample from the axis, m.
    pub fn radius_m(&self) -> f64 {
        self.xs_m.iter().zip(&self.ys_m).map(|(x, y)| x.hypot(*y)).fold(0.0, f64::max)
    }
}

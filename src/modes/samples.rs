//! The illuminated samples of a pupil as points with weights, for the evaluation of bases.

use crate::pupil::Pupil;
use crate::{Error, Result};

/// Illuminated samples of a pupil, in grid order, with weights that sum to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Samples {
    /// Flat grid index `y·samples + x` of each sample.
    pub indices: Vec<usize>,
    /// Coordinate along the columns, m.
    pub xs_m: Vec<f64>,
    /// Coordinate along the rows, m.
    pub ys_m: Vec<f64>,
    /// Weight: amplitude over the sum of the amplitude.
    pub weights: Vec<f64>,
}

impl Samples {
    /// The samples of `pupil` with a positive amplitude.
    ///
    /// # Errors
    /// [`Error::Shape`] where the amplitude does not fit the grid; [`Error::Value`] for an
    /// amplitude that is negative or not finite, or a pupil without illuminated samples.
    pub fn from_pupil(pupil: &Pupil) -> Result<Self> {
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
            return Err(Error::Value(
                "the pupil amplitude is 0 everywhere: at least one illuminated sample is needed".into(),
            ));
        }
        samples.weights.iter_mut().for_each(|weight| *weight /= total);
        Ok(samples)
    }

    /// Largest distance of a sample from the axis, m.
    pub fn radius_m(&self) -> f64 {
        self.xs_m.iter().zip(&self.ys_m).map(|(x, y)| x.hypot(*y)).fold(0.0, f64::max)
    }
}

/// Checks that there are as many x as y coordinates.
pub(super) fn check_lengths(xs_m: &[f64], ys_m: &[f64]) -> Result<()> {
    if xs_m.len() == ys_m.len() {
        return Ok(());
    }
    Err(Error::Shape(format!(
        "{} x and {} y coordinates were given: the same number is needed",
        xs_m.len(),
        ys_m.len()
    )))
}

//! Square sampling grids of the pupil plane.

use crate::{Error, Result};

/// Square grid of `samples × samples` points over `width_m`, centred on the optical axis. The axis
/// lies between the two central samples of an even grid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    samples: usize,
    width_m: f64,
}

impl Grid {
    /// Grid of `samples` points a side over `width_m` metres.
    ///
    /// # Errors
    /// [`Error::Value`] for 0 samples, or a width that is not positive and finite.
    pub fn new(samples: usize, width_m: f64) -> Result<Self> {
        if samples == 0 {
            return Err(Error::Value("a pupil grid of 0 samples is impossible; at least 1 is needed".into()));
        }
        if !(width_m.is_finite() && width_m > 0.0) {
            return Err(Error::Value(format!(
                "a pupil grid {width_m} m wide is impossible; a positive width is needed"
            )));
        }
        Ok(Self { samples, width_m })
    }

    /// Samples along a side.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// Side of the grid, m.
    pub fn width_m(&self) -> f64 {
        self.width_m
    }

    /// Distance between neighbouring samples, m.
    pub fn pitch_m(&self) -> f64 {
        self.width_m / self.samples as f64
    }

    /// Coordinate of sample `j` along either axis, m.
    pub fn coordinate_m(&self, j: usize) -> f64 {
        (j as f64 - (self.samples as f64 - 1.0) / 2.0) * self.pitch_m()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axis_lies_between_the_central_samples() {
        let grid = Grid::new(4, 2.0).unwrap();
        let coordinates: Vec<f64> = (0..4).map(|j| grid.coordinate_m(j)).collect();
        assert_eq!(coordinates, [-0.75, -0.25, 0.25, 0.75]);
    }

    #[test]
    fn invalid_grids_are_refused() {
        assert!(Grid::new(0, 1.0).is_err());
        assert!(Grid::new(8, 0.0).is_err());
        assert!(Grid::new(8, f64::NAN).is_err());
    }
}

//! Least-squares removal of piston, tip and tilt, and statistics over the pupil, weighted with its
//! amplitude.

use super::sampled::Pupil;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView2};

impl Pupil {
    /// Σ A: the illuminated area in samples.
    pub fn weight_sum(&self) -> f64 {
        self.amplitude.sum()
    }

    /// Illuminated area of each segment, m².
    pub fn segment_areas(&self) -> Vec<f64> {
        let mut areas = vec![0.0; self.segments.len()];
        for (&amplitude, &owner) in self.amplitude.iter().zip(&self.owner).filter(|(_, owner)| **owner >= 0) {
            areas[owner as usize] += amplitude * self.grid.pitch_m().powi(2);
        }
        areas
    }

    /// The map `[y, x]` minus its weighted mean over the pupil; NaN outside. Values outside are
    /// ignored.
    ///
    /// # Errors
    /// [`Error::Shape`] for a map of another shape, [`Error::Value`] for a value in the pupil that
    /// is not finite.
    pub fn remove_piston(&self, map: ArrayView2<f64>) -> Result<Array2<f64>> {
        self.detrend(map, 1)
    }

    /// The map `[y, x]` minus its weighted least-squares plane over the pupil; NaN outside. Values
    /// outside are ignored.
    ///
    /// # Errors
    /// Those of [`Pupil::remove_piston`].
    pub fn remove_piston_tip_tilt(&self, map: ArrayView2<f64>) -> Result<Array2<f64>> {
        self.detrend(map, 3)
    }

    /// √(Σ A·map² / Σ A): the weighted root mean square over the pupil, nothing removed.
    ///
    /// # Errors
    /// Those of [`Pupil::remove_piston`].
    pub fn rms(&self, map: ArrayView2<f64>) -> Result<f64> {
        self.check(&map)?;
        let illuminated = self.amplitude.iter().zip(&map).filter(|(a, _)| **a > 0.0);
        Ok((illuminated.map(|(a, m)| a * m * m).sum::<f64>() / self.weight_sum()).sqrt())
    }

    /// Removes the first `terms` of 1, x, y, made orthogonal over the pupil one after the other; a
    /// term in the span of the earlier ones (on a pupil of one sample, or of one line) is skipped.
    fn detrend(&self, map: ArrayView2<f64>, terms: usize) -> Result<Array2<f64>> {
        self.check(&map)?;
        let samples = self.grid.samples();
        let illuminated: Vec<usize> =
            (0..samples * samples).filter(|i| self.amplitude[[i / samples, i % samples]] > 0.0).collect();
        let weight: Vec<f64> = illuminated.iter().map(|i| self.amplitude[[i / samples, i % samples]]).collect();
        let dot = |a: &[f64], b: &[f64]| -> f64 { weight.iter().zip(a).zip(b).map(|((w, a), b)| w * a * b).sum() };
        let half = self.grid.width_m() / 2.0;
        let term = |t: usize| {
            let value = move |&i: &usize| match t {
                0 => 1.0,
                1 => self.grid.coordinate_m(i % samples) / half,
                _ => self.grid.coordinate_m(i / samples) / half,
            };
            illuminated.iter().map(value).collect::<Vec<f64>>()
        };
        let mut residual: Vec<f64> = illuminated.iter().map(|i| map[[i / samples, i % samples]]).collect();
        let mut basis: Vec<Vec<f64>> = Vec::with_capacity(terms);
        for mut vector in (0..terms).map(term) {
            let before = dot(&vector, &vector);
            for b in &basis {
                let share = dot(&vector, b) / dot(b, b);
                subtract(&mut vector, b, share);
            }
            // The remainder of a dependent term is rounding: the square of 1e-16 of its length.
            if dot(&vector, &vector) > 1e-24 * before {
                let share = dot(&residual, &vector) / dot(&vector, &vector);
                subtract(&mut residual, &vector, share);
                basis.push(vector);
            }
        }
        let mut detrended = Array2::from_elem(map.dim(), f64::NAN);
        illuminated.iter().zip(residual).for_each(|(i, value)| detrended[[i / samples, i % samples]] = value);
        Ok(detrended)
    }

    fn check(&self, map: &ArrayView2<f64>) -> Result<()> {
        let (samples, (rows, columns)) = (self.grid.samples(), map.dim());
        if (rows, columns) != (samples, samples) {
            return Err(Error::Shape(format!(
                "a map of {rows} × {columns} does not fit the pupil: {samples} × {samples} is needed"
            )));
        }
        let inside = map.indexed_iter().filter(|(at, _)| self.amplitude[*at] > 0.0);
        match inside.into_iter().find(|(_, value)| !value.is_finite()) {
            Some(((y, x), value)) => Err(Error::Value(format!(
                "the map is {value} at row {y}, column {x}, inside the pupil: finite values are needed there"
            ))),
            None => Ok(()),
        }
    }
}

fn subtract(vector: &mut [f64], other: &[f64], share: f64) {
    vector.iter_mut().zip(other).for_each(|(v, o)| *v -= share * o);
}

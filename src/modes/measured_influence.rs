//! Measured influence functions of a deformable mirror: samples on square grids, interpolated
//! bilinearly.

use crate::{Error, Result};
use ndarray::{Array2, ArrayView2, ArrayView3, s};
use std::ops::Range;

/// Rows and columns at the edges of a function whose values are all below this fraction of its
/// largest one are left out: at a stroke of 10 µm they move the mirror by 1e-3 nm. It is the cut of
/// the Gaussian functions in simulations, and the rounding of single precision.
const NEGLIGIBLE: f64 = 1e-7;

/// Influence functions as they were measured, in wavefront relative to the command: of each
/// actuator over the pupil, or one that all actuators have in common.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredInfluence {
    /// Distance of the samples, m.
    pitch_m: f64,
    /// One for each actuator, or a single one about the place of each.
    patches: Vec<Patch>,
    is_common: bool,
}

/// Samples `[y, x]` of one function within the rectangle that holds its values; one sample beyond
/// it the function is 0.
#[derive(Debug, Clone, PartialEq)]
struct Patch {
    /// x and y of the first sample, m: from the optical axis, or from the actuator for a common
    /// function.
    first_m: [f64; 2],
    values: Array2<f32>,
    /// x and y of the sample with the largest absolute value, m, and this value.
    peak_m: [f64; 2],
    peak: f64,
}

impl MeasuredInfluence {
    /// Functions of all actuators, `[actuator, y, x]`, over a square of `width_m` about the optical
    /// axis that the samples tile.
    ///
    /// # Errors
    /// [`Error::Shape`] for maps that are not square; [`Error::Value`] for a width that is not
    /// positive, and for a function that is not finite or 0 everywhere.
    pub fn of_each(functions: ArrayView3<f64>, width_m: f64) -> Result<Self> {
        let (count, n, columns) = functions.dim();
        if n != columns || n == 0 || count == 0 {
            let text =
                format!("{count} influence functions of {columns}x{n} samples were given: square ones are needed");
            return Err(Error::Shape(text));
        }
        let pitch_m = checked_pitch(width_m / n as f64)?;
        let first_m = -(n as f64 + 1.0) / 2.0 * pitch_m;
        let patch = |(actuator, function): (usize, ArrayView2<f64>)| {
            check(function, format_args!("the influence function of actuator {actuator}"))?;
            // The samples at the edge stand for half a sample beyond them, too.
            let edge = |i: usize| i.saturating_sub(1).min(n - 1);
            let wider = Array2::from_shape_fn((n + 2, n + 2), |(y, x)| function[[edge(y), edge(x)]]);
            Ok(Patch::new(wider.view(), [first_m, first_m], pitch_m))
        };
        let patches = functions.outer_iter().enumerate().map(patch).collect::<Result<_>>()?;
        Ok(Self { pitch_m, patches, is_common: false })
    }

    /// One function of all actuators, `[y, x]` with samples `pitch_m` apart; the actuator is at
    /// sample [rows/2, columns/2], rounded down.
    ///
    /// # Errors
    /// [`Error::Value`] for a pitch that is not positive, and for a function that is not finite or
    /// 0 everywhere.
    pub fn common(function: ArrayView2<f64>, pitch_m: f64) -> Result<Self> {
        let pitch_m = checked_pitch(pitch_m)?;
        check(function, format_args!("the influence function"))?;
        let first_m = [function.ncols(), function.nrows()].map(|n| -((n / 2) as f64) * pitch_m);
        Ok(Self { pitch_m, patches: vec![Patch::new(function, first_m, pitch_m)], is_common: true })
    }

    /// Number of functions; `None` for one that all actuators have in common.
    pub fn count(&self) -> Option<usize> {
        (!self.is_common).then_some(self.patches.len())
    }

    /// Median of the largest absolute values of the functions.
    pub fn median_peak(&self) -> f64 {
        let mut peaks: Vec<f64> = self.patches.iter().map(|patch| patch.peak.abs()).collect();
        peaks.sort_by(f64::total_cmp);
        peaks[peaks.len() / 2]
    }

    /// x and y of the largest absolute value of each function, m; empty for a common one.
    pub fn peaks_m(&self) -> Vec<[f64; 2]> {
        if self.is_common { Vec::new() } else { self.patches.iter().map(|patch| patch.peak_m).collect() }
    }

    /// The function of one actuator alone.
    pub(super) fn single(&self, actuator: usize) -> Self {
        let patches = if self.is_common { self.patches.clone() } else { vec![self.patches[actuator].clone()] };
        Self { patches, ..*self }
    }

    /// Value of the function of `actuator`, which is at `place_m`, at (x, y).
    pub(super) fn value(&self, actuator: usize, place_m: (f64, f64), x_m: f64, y_m: f64) -> f64 {
        let (patch, [at_x_m, at_y_m]) = self.patch(actuator, place_m);
        patch.value(x_m - at_x_m, y_m - at_y_m, self.pitch_m)
    }

    /// Function of `actuator`, which is at `place_m`, on the square grid with these coordinates
    /// along both axes, ascending.
    pub(super) fn window(&self, actuator: usize, place_m: (f64, f64), coordinates_m: &[f64]) -> InfluenceWindow {
        let (patch, at_m) = self.patch(actuator, place_m);
        let (rows, columns) = patch.values.dim();
        let [columns, rows] = [(0, columns), (1, rows)].map(|(axis, samples)| {
            let low_m = patch.first_m[axis] + at_m[axis] - self.pitch_m;
            let high_m = low_m + (samples as f64 + 1.0) * self.pitch_m;
            let first = coordinates_m.partition_point(|&c_m| c_m <= low_m);
            first..coordinates_m.partition_point(|&c_m| c_m < high_m).max(first)
        });
        let values = Array2::from_shape_fn((rows.len(), columns.len()), |(y, x)| {
            let (x_m, y_m) = (coordinates_m[columns.start + x], coordinates_m[rows.start + y]);
            patch.value(x_m - at_m[0], y_m - at_m[1], self.pitch_m)
        });
        InfluenceWindow { rows, columns, values }
    }

    /// Samples of an actuator at `place_m`, and the point that they are relative to.
    fn patch(&self, actuator: usize, place_m: (f64, f64)) -> (&Patch, [f64; 2]) {
        if self.is_common { (&self.patches[0], [place_m.0, place_m.1]) } else { (&self.patches[actuator], [0.0; 2]) }
    }
}

/// Influence function on a square grid of samples; 0 outside these rows and columns.
pub(crate) struct InfluenceWindow {
    pub rows: Range<usize>,
    pub columns: Range<usize>,
    /// `[row, column]`.
    pub values: Array2<f64>,
}

impl Patch {
    fn new(map: ArrayView2<f64>, first_m: [f64; 2], pitch_m: f64) -> Self {
        let (mut at, mut peak) = ((0, 0), 0.0f64);
        for (place, &value) in map.indexed_iter() {
            if value.abs() > peak.abs() {
                (at, peak) = (place, value);
            }
        }
        let counts = |lane: ndarray::ArrayView1<f64>| lane.iter().any(|value| value.abs() > NEGLIGIBLE * peak.abs());
        let kept = |axis| {
            let lanes: Vec<bool> = map.axis_iter(ndarray::Axis(axis)).map(counts).collect();
            let first = lanes.iter().position(|&counts| counts).unwrap_or(0);
            first..lanes.iter().rposition(|&counts| counts).map_or(first, |last| last + 1)
        };
        let (rows, columns) = (kept(0), kept(1));
        let place_m = |y: usize, x: usize| [first_m[0] + x as f64 * pitch_m, first_m[1] + y as f64 * pitch_m];
        Self {
            first_m: place_m(rows.start, columns.start),
            peak_m: place_m(at.0, at.1),
            values: map.slice(s![rows, columns]).mapv(|value| value as f32),
            peak,
        }
    }

    fn value(&self, x_m: f64, y_m: f64, pitch_m: f64) -> f64 {
        let (rows, columns) = self.values.dim();
        let (x, y) = ((x_m - self.first_m[0]) / pitch_m, (y_m - self.first_m[1]) / pitch_m);
        if !(x > -1.0 && y > -1.0 && x < columns as f64 && y < rows as f64) {
            return 0.0;
        }
        let (left, low) = (x.floor(), y.floor());
        let (fx, fy) = (x - left, y - low);
        let (left, low) = (left as isize, low as isize);
        // A negative index is too large as an unsigned one.
        let at = |y: isize, x: isize| self.values.get([y as usize, x as usize]).map_or(0.0, |&value| f64::from(value));
        let row = |y: isize| at(y, left) * (1.0 - fx) + at(y, left + 1) * fx;
        row(low) * (1.0 - fy) + row(low + 1) * fy
    }
}

fn checked_pitch(pitch_m: f64) -> Result<f64> {
    if pitch_m.is_finite() && pitch_m > 0.0 {
        return Ok(pitch_m);
    }
    Err(Error::Value(format!(
        "samples of influence functions {pitch_m} m apart are impossible: a positive number is needed"
    )))
}

fn check(function: ArrayView2<f64>, what: std::fmt::Arguments) -> Result<()> {
    if let Some(((y, x), value)) = function.indexed_iter().find(|(_, value)| !value.is_finite()) {
        return Err(Error::Value(format!("{what} is {value} at row {y}, column {x}: finite values are needed")));
    }
    if function.iter().all(|&value| value == 0.0) {
        return Err(Error::Value(format!("{what} is 0 everywhere: an actuator that moves the mirror is needed")));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::Mirror;
    use super::*;
    use crate::grid::Grid;
    use ndarray::Array3;
    use std::sync::Arc;

    #[test]
    fn functions_are_interpolated_between_their_samples() {
        // Bilinear functions are exact between samples; single precision rounds to 6e-8.
        let plane = |x: f64, y: f64| 1.0 + 0.25 * x - 0.5 * y;
        let grid = Grid::new(8, 4.0).unwrap();
        let map = Array2::from_shape_fn((8, 8), |(y, x)| plane(grid.coordinate_m(x), grid.coordinate_m(y)));
        let cube = map.clone().insert_axis(ndarray::Axis(0));
        let each = MeasuredInfluence::of_each(cube.view(), 4.0).unwrap();
        for (x_m, y_m) in [(0.0, 0.0), (0.31, -0.9), (1.75, 1.75), (-1.2, 0.7)] {
            assert!((each.value(0, (9.0, 9.0), x_m, y_m) - plane(x_m, y_m)).abs() < 2e-7);
        }
        // Half a sample beyond the outermost ones is still theirs; 0 from two samples on.
        assert!((each.value(0, (0.0, 0.0), 2.0, 0.25) - plane(1.75, 0.25)).abs() < 2e-7);
        assert_eq!(each.value(0, (0.0, 0.0), 2.75, 0.25), 0.0);
        // A common one is about its actuator, which is at sample [4, 4], and 0 one sample beyond.
        let common = MeasuredInfluence::common(map.view(), 0.5).unwrap();
        assert!((common.value(3, (1.5, -2.0), 1.5, -2.0) - map[[4, 4]]).abs() < 2e-7);
        assert!((common.value(3, (1.5, -2.0), 1.75, -2.0) - (map[[4, 4]] + map[[4, 5]]) / 2.0).abs() < 2e-7);
        assert_eq!(common.value(3, (1.5, -2.0), 1.5 + 4.0 * 0.5, -2.0), 0.0);
    }

    #[test]
    fn a_window_holds_the_values_on_the_grid_that_are_not_0() {
        let grid = Grid::new(40, 4.0).unwrap();
        let coordinates_m: Vec<f64> = (0..40).map(|i| grid.coordinate_m(i)).collect();
        let actuators = Mirror::new(5, 0.75, 0.15).unwrap().all();
        let (xs_m, ys_m): (Vec<f64>, Vec<f64>) =
            (0..1600).map(|i| (coordinates_m[i % 40], coordinates_m[i / 40])).unzip();
        let bump =
            Array2::from_shape_fn((7, 9), |(y, x)| 1.0 / (1.0 + (y as f64 - 3.0).powi(2) + (x as f64 - 4.0).powi(2)));
        let measured = actuators.measured(Arc::new(MeasuredInfluence::common(bump.view(), 0.13).unwrap())).unwrap();
        let values = measured.evaluate(&xs_m, &ys_m).unwrap();
        for (actuator, row) in values.outer_iter().enumerate() {
            let window = measured.window(actuator, &coordinates_m).unwrap();
            for (at, value) in row.iter().enumerate() {
                let (y, x) = (at / 40, at % 40);
                let inside = window.rows.contains(&y) && window.columns.contains(&x);
                let there = if inside { window.values[[y - window.rows.start, x - window.columns.start]] } else { 0.0 };
                assert_eq!(there, *value, "actuator {actuator}, row {y}, column {x}");
            }
            // Nine and seven samples of 0.13 m, and one on either side, of 0.1 m: nothing else is
            // held.
            assert!(window.values.nrows() <= 11 && window.values.ncols() <= 13);
        }
    }

    #[test]
    fn invalid_functions_are_refused() {
        let good = Array3::from_elem((2, 4, 4), 1.0);
        let sentence =
            |cube: &Array3<f64>, width_m| MeasuredInfluence::of_each(cube.view(), width_m).unwrap_err().to_string();
        let mut gap = good.clone();
        gap[[1, 2, 3]] = f64::NAN;
        let gap = sentence(&gap, 1.0);
        assert!(["actuator 1", "NaN", "row 2, column 3", "finite"].iter().all(|fact| gap.contains(fact)), "{gap}");
        let mut dead = good.clone();
        dead.slice_mut(s![0, .., ..]).fill(0.0);
        let dead = sentence(&dead, 1.0);
        assert!(dead.contains("actuator 0") && dead.contains("0 everywhere"), "{dead}");
        assert!(sentence(&good, 0.0).contains("0 m apart are impossible"));
        assert!(sentence(&Array3::zeros((2, 4, 5)), 1.0).contains("5x4 samples"));
        assert!(MeasuredInfluence::common(good.slice(s![0, .., ..]), f64::NAN).is_err());
    }
}

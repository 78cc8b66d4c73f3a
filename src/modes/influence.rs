//! The deformable mirror: influence functions, Gaussian or measured, on a square grid of actuators.

use super::measured_influence::{InfluenceWindow, MeasuredInfluence};
use super::samples::{Samples, check_lengths};
use crate::pupil::Pupil;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, ArrayViewMut2};
use std::ops::Range;
use std::sync::Arc;

/// A square grid of actuators centred on the optical axis (Fried geometry: `actuators_across − 1`
/// lenslets across, an actuator on each lenslet corner).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mirror {
    actuators_across: usize,
    pitch_m: f64,
    coupling: f64,
}

impl Mirror {
    /// Default of the largest distance of an actuator from the nearest illuminated sample, in
    /// pitches. In the Fried geometry the actuators are at the lenslet corners, 1/√2 = 0.71 pitch
    /// from the centres: so all corners of a lenslet whose centre is illuminated are included, with
    /// a margin for the sampling of the pupil, and every included actuator moves the nearest
    /// illuminated sample by at least a third of its stroke (0.1458^(0.75²) = 0.34). Actuators
    /// farther away add little to the range of the mirror, and much to the condition number of its
    /// influence functions.
    pub const DEFAULT_MARGIN_PITCHES: f64 = 0.75;

    /// A mirror of `actuators_across` actuators a side, `pitch_m` apart as seen in the entrance
    /// pupil, whose influence falls to `coupling` (in (0, 1)) at the neighbouring actuator.
    ///
    /// # Errors
    /// [`Error::Value`] for no actuators, a pitch that is not positive, or a coupling outside (0,
    /// 1).
    pub fn new(actuators_across: usize, pitch_m: f64, coupling: f64) -> Result<Self> {
        if !(1..=4096).contains(&actuators_across) {
            let text = format!("a mirror {actuators_across} actuators across is impossible: 1 to 4096 are accepted");
            return Err(Error::Value(text));
        }
        if !(pitch_m.is_finite() && pitch_m > 0.0) {
            return Err(Error::Value(format!("an actuator pitch of {pitch_m} m is impossible: it must be positive")));
        }
        if !(coupling > 0.0 && coupling < 1.0) {
            let text = format!("an actuator coupling of {coupling} is impossible: it lies strictly between 0 and 1");
            return Err(Error::Value(text));
        }
        Ok(Self { actuators_across, pitch_m, coupling })
    }

    /// Actuators along a side.
    pub fn actuators_across(&self) -> usize {
        self.actuators_across
    }

    /// Distance between neighbouring actuators, m in the entrance pupil.
    pub fn pitch_m(&self) -> f64 {
        self.pitch_m
    }

    /// Influence on the neighbouring actuator.
    pub fn coupling(&self) -> f64 {
        self.coupling
    }

    /// Coordinate of actuator column or row `i`, m.
    pub fn coordinate_m(&self, i: usize) -> f64 {
        (i as f64 - (self.actuators_across as f64 - 1.0) / 2.0) * self.pitch_m
    }

    fn functions(&self, indices: Vec<usize>) -> InfluenceFunctions {
        InfluenceFunctions { mirror: *self, indices, measured: None }
    }

    /// All actuators of the square.
    pub fn all(&self) -> InfluenceFunctions {
        self.functions((0..self.actuators_across.pow(2)).collect())
    }

    /// The actuators within `margin_pitches` pitches of the nearest illuminated sample; see
    /// [`DEFAULT_MARGIN_PITCHES`](Self::DEFAULT_MARGIN_PITCHES).
    ///
    /// # Errors
    /// [`Error::Value`] for a margin that is negative or not finite, a pupil without illuminated
    /// samples, or no actuator within the margin.
    pub fn near(&self, pupil: &Pupil, margin_pitches: f64) -> Result<InfluenceFunctions> {
        if !(margin_pitches.is_finite() && margin_pitches >= 0.0) {
            let text = format!("an actuator margin of {margin_pitches} pitches is impossible: 0 or more is accepted");
            return Err(Error::Value(text));
        }
        let illuminated = Samples::from_pupil(pupil)?;
        let reach2 = (margin_pitches * self.pitch_m).powi(2);
        let across = self.actuators_across;
        let near = |&index: &usize| {
            let (x, y) = (self.coordinate_m(index % across), self.coordinate_m(index / across));
            illuminated.xs_m.iter().zip(&illuminated.ys_m).any(|(xs, ys)| (xs - x).powi(2) + (ys - y).powi(2) <= reach2)
        };
        let indices: Vec<usize> = (0..across * across).filter(near).collect();
        if indices.is_empty() {
            let text = format!(
                "no actuator of the mirror is within {margin_pitches} pitches of an illuminated sample: increase the margin"
            );
            return Err(Error::Value(text));
        }
        Ok(self.functions(indices))
    }

    /// The actuators for whose position (x, y), m, `keep` is true.
    ///
    /// # Errors
    /// [`Error::Value`] where there is none.
    pub fn select(&self, keep: impl Fn(f64, f64) -> bool) -> Result<InfluenceFunctions> {
        let across = self.actuators_across;
        let kept = |index: &usize| keep(self.coordinate_m(index % across), self.coordinate_m(index / across));
        let indices: Vec<usize> = (0..across * across).filter(kept).collect();
        if indices.is_empty() {
            return Err(Error::Value("no actuator of the mirror is selected: at least one is needed".into()));
        }
        Ok(self.functions(indices))
    }

    /// The actuators nearest to `places_m`, x and y.
    ///
    /// # Errors
    /// [`Error::Value`] where they are not in the order of the actuators, or two are the same.
    pub fn nearest(&self, places_m: &[[f64; 2]]) -> Result<InfluenceFunctions> {
        let last = self.actuators_across as f64 - 1.0;
        let line = |c_m: f64| (c_m / self.pitch_m + last / 2.0).round().clamp(0.0, last) as usize;
        let indices: Vec<usize> = places_m.iter().map(|[x, y]| line(*y) * self.actuators_across + line(*x)).collect();
        match indices.windows(2).position(|pair| pair[0] >= pair[1]) {
            Some(at) => Err(Error::Value(format!(
                "the actuators nearest to places {at} and {} are not in order, row by row from the smallest y",
                at + 1
            ))),
            None => Ok(self.functions(indices)),
        }
    }

    /// The actuators at the cells `row·actuators_across + column`, ascending.
    ///
    /// # Errors
    /// [`Error::Value`] for no cell, cells that do not ascend, or that the mirror does not have.
    pub fn at(&self, cells: Vec<usize>) -> Result<InfluenceFunctions> {
        let count = self.actuators_across * self.actuators_across;
        if cells.is_empty() {
            return Err(Error::Value("the actuator map marks no actuator: at least one is needed".into()));
        }
        if cells.windows(2).any(|pair| pair[0] >= pair[1]) || cells.last().is_some_and(|last| *last >= count) {
            return Err(Error::Value(format!(
                "the actuators {cells:?} were given: ascending ones below {count} are accepted"
            )));
        }
        Ok(self.functions(cells))
    }
}

/// The cells `row·across + column`, ascending, that are marked 1 in a map: `across` lines of as
/// many 0s and 1s, with or without white space between them; the first line is the row of smallest
/// y.
///
/// # Errors
/// [`Error::Shape`] where the map has another shape, [`Error::Value`] for any other entry.
pub fn marked_cells(map: &str, across: usize) -> Result<Vec<usize>> {
    let lines: Vec<&str> = map.lines().filter(|line| !line.trim().is_empty()).collect();
    if lines.len() != across {
        return Err(Error::Shape(format!("a map of {} lines was given: {across} are needed", lines.len())));
    }
    let mut marked = Vec::new();
    for (row, line) in lines.iter().enumerate() {
        let mut entries: Vec<&str> = line.split_whitespace().collect();
        if let [digits] = entries[..] {
            // One by one, on whole characters: anything but 0 and 1 is named below.
            entries = digits.split_inclusive(|_| true).collect();
        }
        if entries.len() != across {
            let text = format!("line {} of the map has {} entries: {across} are needed", row + 1, entries.len());
            return Err(Error::Shape(text));
        }
        for (column, entry) in entries.iter().enumerate() {
            match *entry {
                "0" => {}
                "1" => marked.push(row * across + column),
                other => {
                    let text = format!("line {} of the map contains {other:.20?}: only 0 and 1 are accepted", row + 1);
                    return Err(Error::Value(text));
                }
            }
        }
    }
    Ok(marked)
}

/// The influence functions of a mirror's actuators: the Gaussian `coupling^((r/pitch)²)`, 1 at the
/// actuator, or measured ones.
#[derive(Debug, Clone, PartialEq)]
pub struct InfluenceFunctions {
    mirror: Mirror,
    /// `row·actuators_across + column` of each actuator, ascending.
    indices: Vec<usize>,
    /// In place of the Gaussian.
    measured: Option<Arc<MeasuredInfluence>>,
}

impl InfluenceFunctions {
    /// These actuators with measured functions in place of the Gaussian ones.
    ///
    /// # Errors
    /// [`Error::Value`] for another number of functions than actuators, and for functions in
    /// another order: of which most have their peak farther than a pitch from their actuator.
    pub fn measured(self, measured: Arc<MeasuredInfluence>) -> Result<Self> {
        if let Some(count) = measured.count().filter(|&count| count != self.len()) {
            return Err(Error::Value(format!(
                "{count} influence functions were given: one for each of the {} actuators in use, or a single image for all of them, is needed",
                self.len()
            )));
        }
        let places_m = self.positions_m();
        let peaks_m = measured.peaks_m();
        let is_far = |(peak, place): (&[f64; 2], &(f64, f64))| {
            (peak[0] - place.0).hypot(peak[1] - place.1) > self.mirror.pitch_m
        };
        let far: Vec<usize> =
            peaks_m.iter().zip(&places_m).enumerate().filter(|(_, pair)| is_far(*pair)).map(|(at, _)| at).collect();
        // Those at the edge may have been measured within the pupil only, so that their peaks are
        // elsewhere.
        if 2 * far.len() > peaks_m.len() {
            let (at, [x, y], place) = (far[0], peaks_m[far[0]], places_m[far[0]]);
            return Err(Error::Value(format!(
                "the influence function of actuator {at} has its peak at ({x:.3}, {y:.3}) m, and the actuator is at ({:.3}, {:.3}) m: the \
                 order of the actuators, row by row from the smallest y, and the axes of the pupil are needed",
                place.0, place.1
            )));
        }
        Ok(Self { measured: Some(measured), ..self })
    }

    /// The function of one actuator alone.
    pub fn single(&self, actuator: usize) -> Self {
        let measured = self.measured.as_ref().map(|measured| Arc::new(measured.single(actuator)));
        Self { mirror: self.mirror, indices: vec![self.indices[actuator]], measured }
    }

    /// Whether the functions are products of one in x and one in y.
    pub fn is_separable(&self) -> bool {
        self.measured.is_none()
    }

    /// The measured function of `actuator` on the square grid with these coordinates along both
    /// axes, ascending; `None` for a Gaussian.
    pub(crate) fn window(&self, actuator: usize, coordinates_m: &[f64]) -> Option<InfluenceWindow> {
        let measured = self.measured.as_ref()?;
        Some(measured.window(actuator, self.position_m(self.indices[actuator]), coordinates_m))
    }

    /// Function of each actuator on the square grid with these coordinates along both axes,
    /// ascending. Those of a Gaussian end where they are below 10⁻⁸.
    pub(crate) fn windows(&self, coordinates_m: &[f64]) -> Vec<InfluenceWindow> {
        if !self.is_separable() {
            return (0..self.len()).filter_map(|actuator| self.window(actuator, coordinates_m)).collect();
        }
        let (along, actuators) = self.along(coordinates_m);
        let reach = reach(&along);
        let across = along.nrows();
        let window = |&actuator: &usize| {
            let (row, column) = (actuator / across, actuator % across);
            let (rows, columns) = (reach[row].clone(), reach[column].clone());
            let values = Array2::from_shape_fn((rows.len(), columns.len()), |(y, x)| {
                along[[row, rows.start + y]] * along[[column, columns.start + x]]
            });
            InfluenceWindow { rows, columns, values }
        };
        actuators.iter().map(window).collect()
    }

    /// The mirror.
    pub fn mirror(&self) -> &Mirror {
        &self.mirror
    }

    /// Number of actuators.
    #[allow(clippy::len_without_is_empty)] // never empty by construction
    pub fn len(&self) -> usize {
        self.indices.len()
    }

    /// `row·actuators_across + column` of each actuator, ascending.
    pub fn indices(&self) -> &[usize] {
        &self.indices
    }

    /// Position (x, y) of each actuator, m.
    pub fn positions_m(&self) -> Vec<(f64, f64)> {
        self.indices.iter().map(|&index| self.position_m(index)).collect()
    }

    fn position_m(&self, index: usize) -> (f64, f64) {
        let across = self.mirror.actuators_across;
        (self.mirror.coordinate_m(index % across), self.mirror.coordinate_m(index / across))
    }

    /// Values at the points (x, y), `[actuators, points]`.
    ///
    /// # Errors
    /// [`Error::Shape`] where the coordinates differ in number.
    pub fn evaluate(&self, xs_m: &[f64], ys_m: &[f64]) -> Result<Array2<f64>> {
        check_lengths(xs_m, ys_m)?;
        let mut values = Array2::zeros((self.indices.len(), xs_m.len()));
        self.fill(xs_m, ys_m, values.view_mut());
        Ok(values)
    }

    /// The factors of the influence functions along one coordinate,
    /// `[column or row of actuators, point]`, and the index `row·across + column` of each actuator
    /// among their products; for Gaussian functions only.
    pub(crate) fn along(&self, coordinates_m: &[f64]) -> (Array2<f64>, &[usize]) {
        let rate = self.mirror.coupling.ln() / self.mirror.pitch_m.powi(2);
        let line = Array2::from_shape_fn((self.mirror.actuators_across, coordinates_m.len()), |(i, point)| {
            (rate * (coordinates_m[point] - self.mirror.coordinate_m(i)).powi(2)).exp()
        });
        (line, &self.indices)
    }

    /// Writes the values into `values`, `[actuators, points]`. A Gaussian is the product of one in
    /// x and one in y: two exponentials per point and grid line instead of one per point and
    /// actuator.
    pub(super) fn fill(&self, xs_m: &[f64], ys_m: &[f64], mut values: ArrayViewMut2<f64>) {
        if let Some(measured) = &self.measured {
            for (actuator, mut row) in values.rows_mut().into_iter().enumerate() {
                let place_m = self.position_m(self.indices[actuator]);
                let points = xs_m.iter().zip(ys_m);
                row.iter_mut()
                    .zip(points)
                    .for_each(|(value, (x, y))| *value = measured.value(actuator, place_m, *x, *y));
            }
            return;
        }
        let across = self.mirror.actuators_across;
        let (along_x, along_y) = (self.along(xs_m).0, self.along(ys_m).0);
        for (mut row, &index) in values.rows_mut().into_iter().zip(&self.indices) {
            ndarray::Zip::from(&mut row)
                .and(along_x.row(index % across))
                .and(along_y.row(index / across))
                .for_each(|value, x, y| *value = x * y);
        }
    }
}

/// Samples that each line of actuators reaches, of functions with one maximum along an axis,
/// `[line, sample]`.
pub(crate) fn reach(along: &Array2<f64>) -> Vec<Range<usize>> {
    const NEGLIGIBLE: f64 = 1e-8;
    let seen = |value: &f64| *value > NEGLIGIBLE;
    let of_line = |line: ArrayView1<f64>| {
        let first = line.iter().position(seen).unwrap_or(0);
        first..line.iter().rposition(seen).map_or(first, |last| last + 1)
    };
    along.outer_iter().map(of_line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_influence_is_the_coupling_one_pitch_away() {
        let mirror = Mirror::new(21, 0.5625, 0.1458).unwrap();
        let values = mirror.all().evaluate(&[0.0, 0.5625, 0.5625, 1.125], &[0.0, 0.0, 0.5625, 0.0]).unwrap();
        let centre = 10 * 21 + 10;
        // c, c², c⁴ by definition of the Gaussian; one exp and a product: a few 1e-16.
        for (point, expected) in [1.0, 0.1458, 0.1458f64.powi(2), 0.1458f64.powi(4)].into_iter().enumerate() {
            assert!((values[[centre, point]] - expected).abs() < 1e-15);
        }
        // The next actuator along +x is in the next column.
        assert!((values[[centre + 1, 1]] - 1.0).abs() < 1e-15);
        assert_eq!(mirror.all().positions_m()[centre + 1], (0.5625, 0.0));
    }

    #[test]
    fn a_map_selects_its_actuators_and_invalid_maps_are_rejected() {
        let mirror = Mirror::new(3, 1.0, 0.2).unwrap();
        let chosen = |map: &str| mirror.at(marked_cells(map, 3)?);
        let cells = [1, 3, 4, 5, 8];
        for map in ["0 1 0\n1 1 1 \n0 0 1\n\n", "010\n111 \n001\n"] {
            assert_eq!(chosen(map).unwrap().indices(), cells);
        }
        for bad in [
            "0 1 0\n1 1 1\n",
            "01\n111\n001",
            "010\n1µ1\n001",
            "0 1\n1 1 1\n0 0 1",
            "0 1 0\n1 2 1\n0 0 1",
            "0 0 0\n0 0 0\n0 0 0",
            "",
        ] {
            assert!(chosen(bad).is_err(), "{bad:?}");
        }
        for bad in [vec![3, 3], vec![4, 1], vec![8, 9]] {
            assert!(mirror.at(bad).is_err());
        }
    }

    #[test]
    fn impossible_mirrors_are_refused() {
        for (across, pitch, coupling) in
            [(0, 1.0, 0.1), (3, 0.0, 0.1), (3, f64::NAN, 0.1), (3, 1.0, 0.0), (3, 1.0, 1.0), (3, 1.0, f64::NAN)]
        {
            assert!(Mirror::new(across, pitch, coupling).is_err());
        }
    }
}

//! The deformable mirror: Gaussian influence functions on a square grid of actuators.

use super::samples::{Samples, check_lengths};
use crate::pupil::Pupil;
use crate::{Error, Result};
use ndarray::{Array2, ArrayViewMut2};

/// A square grid of actuators centred on the optical axis (Fried geometry: `actuators_across − 1` lenslets across, an
/// actuator on each lenslet corner).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mirror {
    actuators_across: usize,
    pitch_m: f64,
    coupling: f64,
}

impl Mirror {
    /// Default of the largest distance of an actuator from the nearest illuminated sample, in pitches. In the Fried geometry
    /// the actuators are at the lenslet corners, 1/√2 = 0.71 pitch from the centres: so all corners of a lenslet whose
    /// centre is illuminated are included, with a margin for the sampling of the pupil, and every included actuator moves
    /// the nearest illuminated sample by at least a third of its stroke (0.1458^(0.75²) = 0.34). Actuators farther away add
    /// little to the range of the mirror, and much to the condition number of its influence functions.
    pub const DEFAULT_MARGIN_PITCHES: f64 = 0.75;

    /// A mirror of `actuators_across` actuators a side, `pitch_m` apart as seen in the entrance pupil, whose influence
    /// falls to `coupling` (in (0, 1)) at the neighbouring actuator.
    ///
    /// # Errors
    /// [`Error::Value`] for no actuators, a pitch that is not positive, or a coupling outside (0, 1).
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

    /// All actuators of the square.
    pub fn all(&self) -> InfluenceFunctions {
        InfluenceFunctions { mirror: *self, indices: (0..self.actuators_across.pow(2)).collect() }
    }

    /// The actuators within `margin_pitches` pitches of the nearest illuminated sample; see
    /// [`DEFAULT_MARGIN_PITCHES`](Self::DEFAULT_MARGIN_PITCHES).
    ///
    /// # Errors
    /// [`Error::Value`] for a margin that is negative or not finite, a pupil without illuminated samples, or no actuator within
    /// the margin.
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
        Ok(InfluenceFunctions { mirror: *self, indices })
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
        Ok(InfluenceFunctions { mirror: *self, indices })
    }

    /// The actuators marked 1 in a map: `actuators_across` lines of as many 0s and 1s, separated by white space; the
    /// first line is the row of smallest y.
    ///
    /// # Errors
    /// [`Error::Shape`] where the map has another shape, [`Error::Value`] for any other entry or an empty selection.
    pub fn from_map(&self, map: &str) -> Result<InfluenceFunctions> {
        let indices = marked_cells(map, self.actuators_across)?;
        if indices.is_empty() {
            return Err(Error::Value("the actuator map marks no actuator: at least one 1 is needed".into()));
        }
        Ok(InfluenceFunctions { mirror: *self, indices })
    }
}

/// The cells `row·across + column`, ascending, that are marked 1 in a map: `across` lines of as many 0s
/// and 1s, with or without white space between them; the first line is the row of smallest y.
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

/// The Gaussian influence functions of a mirror's actuators: `coupling^((r/pitch)²)`, 1 at the actuator.
#[derive(Debug, Clone, PartialEq)]
pub struct InfluenceFunctions {
    mirror: Mirror,
    /// `row·actuators_across + column` of each actuator, ascending.
    indices: Vec<usize>,
}

impl InfluenceFunctions {
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
        let across = self.mirror.actuators_across;
        let position = |&i: &usize| (self.mirror.coordinate_m(i % across), self.mirror.coordinate_m(i / across));
        self.indices.iter().map(position).collect()
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

    /// The factors of the influence functions along one coordinate, `[column or row of actuators, point]`, and the index
    /// `row·across + column` of each actuator among their products.
    pub(crate) fn along(&self, coordinates_m: &[f64]) -> (Array2<f64>, &[usize]) {
        let rate = self.mirror.coupling.ln() / self.mirror.pitch_m.powi(2);
        let line = Array2::from_shape_fn((self.mirror.actuators_across, coordinates_m.len()), |(i, point)| {
            (rate * (coordinates_m[point] - self.mirror.coordinate_m(i)).powi(2)).exp()
        });
        (line, &self.indices)
    }

    /// Writes the values into `values`, `[actuators, points]`. A Gaussian is the product of one in x and one in y:
    /// two exponentials per point and grid line instead of one per point and actuator.
    pub(super) fn fill(&self, xs_m: &[f64], ys_m: &[f64], mut values: ArrayViewMut2<f64>) {
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
        let chosen = mirror.from_map("0 1 0\n1 1 1 \n0 0 1\n\n").unwrap();
        assert_eq!(chosen.indices(), [1, 3, 4, 5, 8]);
        assert_eq!(mirror.from_map("010\n111 \n001\n").unwrap().indices(), chosen.indices());
        for bad in [
            "0 1 0\n1 1 1\n",
            "01\n111\n001",
            "010\n1µ1\n001",
            "0 1\n1 1 1\n0 0 1",
            "0 1 0\n1 2 1\n0 0 1",
            "0 0 0\n0 0 0\n0 0 0",
            "",
        ] {
            assert!(mirror.from_map(bad).is_err(), "{bad:?}");
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

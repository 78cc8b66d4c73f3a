//! Orientations of images, the map of a poke under each, and its comparison with a difference of
//! maps.

use crate::ao::actuators_in_use;
use crate::pupil::Pupil;
use crate::scene::{Aperture, Scene};
use crate::telescope::{SegmentPlace, Telescope};
use crate::{Error, Result};
use ndarray::Array2;

/// A known change of the wavefront, nm of wavefront.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Poke {
    /// Piston of a segment, by its index from 0 on; [`Poke::of_segment`] takes its label.
    Segment(usize, f64),
    /// Command of an actuator, by its index in the table ACTUATORS, from 0 on.
    Actuator(usize, f64),
}

impl Poke {
    /// Piston of the segment of `scene` with the label `label`: that of `pupil.segment_labels` or
    /// of the pupil's file, else its number.
    ///
    /// # Errors
    /// Those of [`Telescope::new`]; [`Error::Value`] for a label that no segment has.
    pub fn of_segment(scene: &Scene, label: &str, nm: f64) -> Result<Self> {
        let places = SegmentPlace::all(scene, &Telescope::new(scene)?.pupil.segments);
        Ok(Self::Segment(SegmentPlace::labelled(&places, label)?.number, nm))
    }
}

/// The segment or actuator whose motion explains the images best in the scene's own orientation.
#[derive(Debug, Clone, PartialEq)]
pub struct MovedPart {
    /// "segment" or "actuator", and its label or number.
    pub name: String,
    /// Whether it is the one that was stated.
    pub is_stated: bool,
    /// Correlation of the difference between the images' maps with the expected map.
    pub correlation: f64,
    /// Amplitude in the images over that of the poke.
    pub amplitude: f64,
    /// Logarithm of its likelihood over that of no poke.
    pub log_likelihood: f64,
}

/// An orientation of the images, and how well it explains the poke.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrientationCandidate {
    /// Whether x, and y, are flipped after the rotation.
    pub flip: [bool; 2],
    /// Rotation, counter-clockwise, degrees.
    pub rotation_deg: f64,
    /// 1, or −1 where the poke has the opposite sign.
    pub sign: f64,
    /// Correlation of the difference between the images' maps with the expected map.
    pub correlation: f64,
    /// Amplitude of the poke in the images over the expected one.
    pub amplitude: f64,
    /// Logarithm of its likelihood over that of no poke.
    pub log_likelihood: f64,
}

/// Expected map of a poke.
pub(super) struct ExpectedMap {
    poke: Poke,
    /// Position of the actuator, and the influence of the mirror; `None` for a segment.
    influence: Option<crate::modes::InfluenceFunctions>,
    /// The parts that may move, as messages name them.
    names: Vec<String>,
}

impl ExpectedMap {
    pub(super) fn new(scene: &Scene, telescope: &Telescope, poke: Poke) -> Result<Self> {
        let (what, index, nm, names, influence) = match poke {
            Poke::Segment(index, nm) => {
                let places = SegmentPlace::all(scene, &telescope.pupil.segments);
                ("segment", index, nm, places.into_iter().map(|place| place.label).collect::<Vec<_>>(), None)
            }
            Poke::Actuator(index, nm) => {
                let influence = actuators_in_use(scene, telescope)?;
                (
                    "actuator",
                    index,
                    nm,
                    (0..influence.len()).map(|number| number.to_string()).collect(),
                    Some(influence),
                )
            }
        };
        let count = names.len();
        if index >= count {
            let last = count.saturating_sub(1);
            return Err(Error::Value(format!("{what} {index} does not exist: 0 to {last} is accepted")));
        }
        if !nm.is_finite() || nm == 0.0 {
            return Err(Error::Value(format!("a poke of {nm} nm was given: a finite one other than 0 is needed")));
        }
        Ok(Self { poke, influence, names: names.iter().map(|name| format!("{what} {name}")).collect() })
    }

    pub(super) fn name(&self) -> String {
        let (Poke::Segment(index, nm) | Poke::Actuator(index, nm)) = self.poke;
        format!("the poke of {} by {nm} nm", self.names[index])
    }

    /// The part whose poke of either sign explains the difference best in the scene's own
    /// orientation.
    pub(super) fn moved(&self, pupil: &Pupil, difference_nm: &Array2<f64>, modes: usize) -> Result<Option<MovedPart>> {
        let (Poke::Segment(stated, nm) | Poke::Actuator(stated, nm)) = self.poke;
        let mut best: Option<MovedPart> = None;
        for (index, name) in self.names.iter().enumerate() {
            let poke = match self.poke {
                Poke::Segment(..) => Poke::Segment(index, nm),
                Poke::Actuator(..) => Poke::Actuator(index, nm),
            };
            let map_nm = self.map_of(poke, pupil, [false; 2], 0.0)?;
            let (correlation, amplitude) = compare(pupil, difference_nm, &map_nm);
            if best.as_ref().is_none_or(|best| correlation.abs() > best.correlation.abs()) {
                let (name, is_stated) = (name.clone(), index == stated);
                let log_likelihood = log_likelihood(correlation.abs(), modes);
                best = Some(MovedPart { name, is_stated, correlation, amplitude, log_likelihood });
            }
        }
        Ok(best)
    }

    /// The map `[y, x]` under an orientation, without piston, tip and tilt.
    pub(super) fn map_nm(&self, pupil: &Pupil, flip: [bool; 2], rotation_deg: f64) -> Result<Array2<f64>> {
        self.map_of(self.poke, pupil, flip, rotation_deg)
    }

    fn map_of(&self, poke: Poke, pupil: &Pupil, flip: [bool; 2], rotation_deg: f64) -> Result<Array2<f64>> {
        let (grid, n) = (&pupil.grid, pupil.grid.samples());
        let (sin, cos) = rotation_deg.to_radians().sin_cos();
        // x = R(−θ)·F·u.
        let place = |y: usize, x: usize| {
            let (u, v) = (grid.coordinate_m(x), grid.coordinate_m(y));
            let (u, v) = (if flip[0] { -u } else { u }, if flip[1] { -v } else { v });
            (cos * u + sin * v, cos * v - sin * u)
        };
        let index = |c_m: f64| (c_m / grid.pitch_m() + (n as f64 - 1.0) / 2.0).round();
        let mut map = Array2::zeros((n, n));
        let (xs_m, ys_m): (Vec<f64>, Vec<f64>) = (0..n * n).map(|at| place(at / n, at % n)).unzip();
        match (poke, &self.influence) {
            (Poke::Segment(segment, nm), _) => {
                for ((value, x_m), y_m) in map.iter_mut().zip(&xs_m).zip(&ys_m) {
                    let (x, y) = (index(*x_m), index(*y_m));
                    let inside = (0.0..n as f64).contains(&x) && (0.0..n as f64).contains(&y);
                    if inside && pupil.owner[[y as usize, x as usize]] == segment as i32 {
                        *value = nm;
                    }
                }
            }
            (Poke::Actuator(actuator, nm), Some(influence)) => {
                let shapes = influence.single(actuator).evaluate(&xs_m, &ys_m)?;
                map.iter_mut().zip(shapes).for_each(|(value, shape)| *value = nm * shape);
            }
            (Poke::Actuator(..), None) => {}
        }
        pupil.remove_piston_tip_tilt(map.view())
    }

    /// All orientations of the pupil's symmetry group with either sign, the likeliest first and
    /// among equals the simplest.
    pub(super) fn candidates(
        &self,
        pupil: &Pupil,
        scene: &Scene,
        difference_nm: &Array2<f64>,
        modes: usize,
    ) -> Result<Vec<OrientationCandidate>> {
        let mut found = Vec::new();
        for &rotation_deg in rotations_deg(scene, pupil) {
            for flip in [[false, false], [true, false], [false, true], [true, true]] {
                let map_nm = self.map_nm(pupil, flip, rotation_deg)?;
                let (correlation, amplitude) = compare(pupil, difference_nm, &map_nm);
                for sign in [1.0, -1.0] {
                    let log_likelihood = log_likelihood(sign * correlation, modes);
                    let (correlation, amplitude) = (sign * correlation, sign * amplitude);
                    found.push(OrientationCandidate {
                        flip,
                        rotation_deg,
                        sign,
                        correlation,
                        amplitude,
                        log_likelihood,
                    });
                }
            }
        }
        found.sort_by(|a, b| b.log_likelihood.total_cmp(&a.log_likelihood));
        Ok(found)
    }
}

/// Logarithm of the likelihood, over that of no poke, of a map with this correlation: residuals of
/// as many coefficients, of unknown variance.
fn log_likelihood(correlation: f64, modes: usize) -> f64 {
    let explained = correlation.clamp(0.0, 1.0 - 1e-9).powi(2);
    -0.5 * modes as f64 * (1.0 - explained).ln()
}

/// Rotations besides flips under which the pupil equals itself; two flips are a rotation by 180°.
fn rotations_deg(scene: &Scene, pupil: &Pupil) -> &'static [f64] {
    if !matches!(scene.pupil.aperture, Aperture::File(_)) {
        return &[0.0, 60.0, -60.0];
    }
    let is_square = pupil.amplitude.indexed_iter().all(|((y, x), a)| (a - pupil.amplitude[[x, y]]).abs() < 0.05);
    if is_square { &[0.0, 90.0] } else { &[0.0] }
}

/// Correlation of two maps over the pupil, and the amplitude of the second in the first.
pub(super) fn compare(pupil: &Pupil, one: &Array2<f64>, other: &Array2<f64>) -> (f64, f64) {
    let (mut aa, mut ab, mut bb) = (0.0, 0.0, 0.0);
    for ((weight, a), b) in pupil.amplitude.iter().zip(one).zip(other) {
        if *weight > 0.0 && a.is_finite() && b.is_finite() {
            (aa, ab, bb) = (aa + weight * a * a, ab + weight * a * b, bb + weight * b * b);
        }
    }
    let norm = (aa * bb).sqrt();
    if norm > 0.0 { (ab / norm, ab / bb) } else { (0.0, 0.0) }
}

/// An orientation in words.
pub(super) fn described(candidate: &OrientationCandidate) -> String {
    let flips = match candidate.flip {
        [false, false] => "the scene's orientation",
        [true, false] => "a flip left to right",
        [false, true] => "a flip up to down",
        [true, true] => "a rotation by 180°",
    };
    let rotation = match candidate.rotation_deg {
        0.0 => String::new(),
        degrees => format!(" after a rotation by {degrees}°"),
    };
    let sign = if candidate.sign < 0.0 { " with the opposite sign" } else { "" };
    format!("{flips}{rotation}{sign}")
}

impl OrientationCandidate {
    /// The orientation in words.
    pub fn description(&self) -> String {
        described(self)
    }
}

//! Parts of a pupil that its spider separates, on which petal modes are defined (low-wind effect).
//!
//! Arms that meet at the centre cut the pupil into sectors. In maps the parts are the connected
//! components of the illuminated samples. Gaps between segments separate nothing: see
//! [`PupilParts::of_maps`].

use super::sampled::Pupil;
use crate::grid::Grid;
use ndarray::Array2;
use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};

/// Widest gap between segments of a map, samples: a wider dark strip between two segments is an arm
/// of the spider.
const WIDEST_GAP: usize = 2;
/// Least share of the illuminated samples that is a part: corners that an arm cuts off a segment or
/// the rim are smaller, and belong to the nearest part.
const LEAST_SHARE: f64 = 0.01;
/// Directions that differ by less are one, rad: far below a sample at the rim of any pupil.
const SAME_DIRECTION_RAD: f64 = 1e-6;

/// Parts of a pupil, numbered by the polar angle of their centre in [0, 2π), counter-clockwise from
/// +x.
#[derive(Debug, Clone, PartialEq)]
pub struct PupilParts {
    places: Places,
    count: usize,
}

#[derive(Debug, Clone, PartialEq)]
enum Places {
    /// Directions of the arms, rad in [0, 2π), ascending; the sector across +x is the first where
    /// `begins_across_x`, else the last.
    Sectors { arms_rad: Vec<f64>, begins_across_x: bool },
    /// Part of each sample, `[y, x]`; a dark sample has that of the nearest part.
    Map { grid: Grid, part: Array2<usize> },
}

impl PupilParts {
    /// The sectors between arms that leave the centre in these directions, rad.
    pub(super) fn between_arms(directions_rad: impl Iterator<Item = f64>) -> Self {
        let mut arms_rad: Vec<f64> = directions_rad.map(|arm| arm.rem_euclid(TAU)).collect();
        // Rounding puts a direction of 0 on either end.
        arms_rad.iter_mut().filter(|arm| TAU - **arm < SAME_DIRECTION_RAD).for_each(|arm| *arm = 0.0);
        arms_rad.sort_by(f64::total_cmp);
        arms_rad.dedup_by(|next, arm| *next - *arm < SAME_DIRECTION_RAD);
        // One arm separates nothing.
        let count = arms_rad.len().max(1);
        let begins_across_x = match (arms_rad.first(), arms_rad.last()) {
            (Some(first), Some(last)) => first + last > TAU - SAME_DIRECTION_RAD,
            _ => false,
        };
        Self { places: Places::Sectors { arms_rad, begins_across_x }, count }
    }

    /// The connected components of the samples of `pupil` with at least half of the largest
    /// amplitude. Samples of two segments are connected across up to two darker samples between
    /// them, which are a gap of the mirror. Components of less than 1 % of the samples belong to
    /// the nearest part.
    pub fn of_maps(pupil: &Pupil) -> Self {
        let least = 0.5 * pupil.amplitude.iter().copied().fold(0.0, f64::max);
        let is_bright = pupil.amplitude.mapv(|a| a >= least && a > 0.0);
        let all = is_bright.iter().filter(|is_bright| **is_bright).count() as f64;
        let components = components(pupil, &is_bright);
        let large = components.into_iter().filter(|component| component.len() as f64 >= LEAST_SHARE * all);
        let mut parts: Vec<(f64, Vec<[usize; 2]>)> =
            large.map(|samples| (direction(pupil, &samples), samples)).collect();
        parts.sort_by(|one, other| one.0.total_cmp(&other.0));
        let mut part = Array2::from_elem(is_bright.dim(), usize::MAX);
        let mut queue = VecDeque::new();
        for (number, (_, samples)) in parts.iter().enumerate() {
            for &at in samples {
                part[at] = number;
                queue.push_back(at);
            }
        }
        // The part of a dark sample is that from which the fewest steps lead to it.
        while let Some(at) = queue.pop_front() {
            for next in neighbours(at, pupil.grid.samples()) {
                if part[next] == usize::MAX {
                    part[next] = part[at];
                    queue.push_back(next);
                }
            }
        }
        Self { places: Places::Map { grid: pupil.grid, part }, count: parts.len() }
    }

    /// Number of parts: 1 for a pupil that no spider divides.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Part of a point of the pupil plane; of a point in shadow or outside of the pupil the
    /// nearest.
    pub fn part_at(&self, x_m: f64, y_m: f64) -> usize {
        match &self.places {
            _ if self.count == 1 => 0,
            Places::Sectors { arms_rad, begins_across_x } => {
                let angle_rad = y_m.atan2(x_m).rem_euclid(TAU);
                let before = arms_rad.iter().filter(|arm| **arm <= angle_rad).count();
                (before + self.count - usize::from(!begins_across_x)) % self.count
            }
            Places::Map { grid, part } => part[sample_at(grid, x_m, y_m)],
        }
    }
}

/// Sample `[y, x]` of `grid` that holds a point, or the nearest one.
fn sample_at(grid: &Grid, x_m: f64, y_m: f64) -> [usize; 2] {
    let last = (grid.samples() - 1) as f64;
    [y_m, x_m].map(|at_m| (at_m / grid.pitch_m() + last / 2.0).round().clamp(0.0, last) as usize)
}

/// Connected components of the bright samples of `pupil`, `[y, x]`.
fn components(pupil: &Pupil, is_bright: &Array2<bool>) -> Vec<Vec<[usize; 2]>> {
    let mut is_left = is_bright.clone();
    let mut components = Vec::new();
    for ((y, x), _) in is_bright.indexed_iter().filter(|(_, is_bright)| **is_bright) {
        if !std::mem::take(&mut is_left[[y, x]]) {
            continue;
        }
        let mut component = vec![[y, x]];
        let mut done = 0;
        while let Some(&at) = component.get(done) {
            done += 1;
            for next in connected(at, pupil, is_bright) {
                if std::mem::take(&mut is_left[next]) {
                    component.push(next);
                }
            }
        }
        components.push(component);
    }
    components
}

/// Bright samples beside `at`, and those of other segments beyond a gap.
fn connected(at: [usize; 2], pupil: &Pupil, is_bright: &Array2<bool>) -> Vec<[usize; 2]> {
    let samples = pupil.grid.samples();
    let mut found = Vec::with_capacity(4);
    for step in STEPS {
        let along = std::iter::successors(moved(at, step, samples), |&next| moved(next, step, samples));
        let bright = along.take(WIDEST_GAP + 1).enumerate().find(|(_, next)| is_bright[*next]);
        if let Some((dark, next)) = bright
            && (dark == 0 || pupil.owner[next] != pupil.owner[at])
        {
            found.push(next);
        }
    }
    found
}

/// Steps to the neighbours of a sample, `[y, x]`.
const STEPS: [[isize; 2]; 4] = [[0, 1], [1, 0], [0, -1], [-1, 0]];

/// The sample one step from `at`, where the grid has one.
fn moved(at: [usize; 2], step: [isize; 2], samples: usize) -> Option<[usize; 2]> {
    let next = [at[0].checked_add_signed(step[0])?, at[1].checked_add_signed(step[1])?];
    (next[0] < samples && next[1] < samples).then_some(next)
}

fn neighbours(at: [usize; 2], samples: usize) -> impl Iterator<Item = [usize; 2]> {
    STEPS.into_iter().filter_map(move |step| moved(at, step, samples))
}

/// Polar angle of the centre of these samples in [0, 2π), rad; 0 for one on +x up to the pitch of
/// the grid.
fn direction(pupil: &Pupil, samples: &[[usize; 2]]) -> f64 {
    let sum = |axis: usize| samples.iter().map(|at| pupil.grid.coordinate_m(at[axis])).sum::<f64>();
    let (y, x) = (sum(0), sum(1));
    let angle_rad = y.atan2(x);
    let is_on_x = angle_rad.abs() < PI / pupil.grid.samples() as f64;
    if is_on_x { 0.0 } else { angle_rad.rem_euclid(TAU) }
}

//! Continuation of a map beyond the edge of the pupil.
//!
//! Other programs write 0 (POPPY, HCIPy) or NaN (prysm, interferometers) outside the pupil.
//! Interpolated as they are, these values change the map within a sample of its edge, and a
//! band-limited pupil takes values some samples beyond it: an estimate is off by 6 to 30 nm. So
//! samples that the map does not have are filled with the quadratic surface through known ones
//! about the nearest known one; the map of smooth optics is such a surface but for the third order.

use crate::linear_algebra::SpdInverse;
use crate::pupil::Pupil;
use ndarray::{Array1, Array2, Axis};
use rayon::prelude::*;

/// Share of the samples outside the pupil that are exactly 0, from which 0 means that there is no
/// value.
const MOSTLY: f64 = 0.9;
/// Share of the samples inside that may be exactly 0 then: those in gaps between segments.
const RARELY: f64 = 0.03;
/// How far a map is continued, in samples of the pupil: the weights of a band-limited pupil ring
/// that far beyond an edge.
const REACH: f64 = 12.0;
/// Half of the window whose known samples determine the surface, in samples of the pupil, and the
/// least in samples of the map.
const WINDOW: f64 = 4.0;
const LEAST_WINDOW: usize = 3;
/// Samples along a side of the window that are used at most: of a finer map each second or third.
const ACROSS: usize = 13;
/// Least samples that determine a quadratic surface, twice its terms.
const ENOUGH: usize = 12;

/// Map `[y, x]` over `width_m` with the values that it does not have, those that are not finite and
/// zeros outside `pupil`, continued from inside. Beyond the reach they are 0.
pub(crate) fn continued(map: &Array2<f64>, width_m: f64, pupil: &Pupil) -> Array2<f64> {
    let pitch_m = width_m / map.ncols() as f64;
    let is_masked = has_zeros_for_none(map, pitch_m, pupil);
    let is_known = map.mapv(|value| value.is_finite() && !(is_masked && value == 0.0));
    let mut out = map.mapv(|value| if value.is_finite() { value } else { 0.0 });
    let samples = |of_pupil: f64| (of_pupil * pupil.grid.pitch_m() / pitch_m).ceil() as usize;
    let half = samples(WINDOW).max(LEAST_WINDOW);
    let filled = nearest_known(&is_known, samples(REACH) + 1);
    let mut sources: Vec<usize> = filled.iter().map(|(_, source)| *source).collect();
    sources.sort_unstable();
    sources.dedup();
    let place = |index: usize| (index / map.ncols(), index % map.ncols());
    let surfaces: Vec<Array1<f64>> =
        sources.par_iter().map(|&source| surface(map, &is_known, place(source), half)).collect();
    for ((y, x), source) in filled {
        let Ok(at) = sources.binary_search(&source) else { continue };
        let (row, column) = place(source);
        out[[y, x]] = surfaces[at].dot(&terms(x as f64 - column as f64, y as f64 - row as f64, half));
    }
    out
}

/// Whether a map is 0 where it has no value: outside `pupil`, and not inside, where it may be a
/// step or that of one segment.
fn has_zeros_for_none(map: &Array2<f64>, pitch_m: f64, pupil: &Pupil) -> bool {
    let at_m = |index: usize| (index as f64 - (map.ncols() as f64 - 1.0) / 2.0) * pitch_m;
    let near = Nearness { pupil, reach_m: pupil.grid.pitch_m() + pitch_m };
    let [mut inside, mut outside] = [[0usize; 2]; 2];
    for ((y, x), value) in map.indexed_iter().filter(|(_, value)| value.is_finite()) {
        let [zeros, all] = match near.of(at_m(x), at_m(y)) {
            Place::Inside => &mut inside,
            Place::Outside => &mut outside,
            Place::Edge => continue,
        };
        (*zeros, *all) = (*zeros + usize::from(*value == 0.0), *all + 1);
    }
    let share = |[zeros, all]: [usize; 2]| zeros as f64 / all as f64;
    share(outside) >= MOSTLY && share(inside) < RARELY
}

/// Place of a sample of a map.
enum Place {
    Inside,
    Edge,
    Outside,
}

/// Place of points relative to the edge of a pupil, within a reach.
struct Nearness<'a> {
    pupil: &'a Pupil,
    reach_m: f64,
}

impl Nearness<'_> {
    fn of(&self, x_m: f64, y_m: f64) -> Place {
        let (grid, last) = (&self.pupil.grid, self.pupil.grid.samples() as f64 - 1.0);
        let span = |c_m: f64| {
            let centre = c_m / grid.pitch_m() + last / 2.0;
            let reach = self.reach_m / grid.pitch_m();
            (centre - reach, centre + reach)
        };
        let ((left, right), (low, high)) = (span(x_m), span(y_m));
        // Beyond the grid there is no pupil.
        let mut has_dark = left < 0.0 || low < 0.0 || right > last || high > last;
        let mut has_light = false;
        let range = |from: f64, to: f64| from.ceil().max(0.0) as usize..=to.floor().clamp(0.0, last) as usize;
        for y in range(low, high) {
            for x in range(left, right) {
                let amplitude = self.pupil.amplitude[[y, x]];
                has_light |= amplitude > 0.0;
                // A gap between segments takes less than half of a sample.
                has_dark |= amplitude < 0.5;
            }
        }
        match (has_light, has_dark) {
            (true, false) => Place::Inside,
            (true, true) => Place::Edge,
            (false, _) => Place::Outside,
        }
    }
}

/// The samples that are not known, within `most` of known ones along rows and columns, each with
/// the index of a nearest known one.
fn nearest_known(is_known: &Array2<bool>, most: usize) -> Vec<((usize, usize), usize)> {
    let (rows, columns) = is_known.dim();
    let around = |(y, x): (usize, usize)| {
        let (top, left) = (y.saturating_sub(1), x.saturating_sub(1));
        (top..(y + 2).min(rows)).flat_map(move |v| (left..(x + 2).min(columns)).map(move |u| (v, u)))
    };
    let is_edge = |at: (usize, usize)| around(at).any(|near| !is_known[near]);
    let known = is_known.indexed_iter().filter(|(at, known)| **known && is_edge(*at));
    let mut front: Vec<((usize, usize), usize)> = known.map(|((y, x), _)| ((y, x), y * columns + x)).collect();
    let (mut is_reached, mut found) = (is_known.clone(), Vec::new());
    for _ in 0..most {
        let mut next = Vec::new();
        for (at, source) in front {
            for near in around(at) {
                if !std::mem::replace(&mut is_reached[near], true) {
                    next.push((near, source));
                }
            }
        }
        found.extend_from_slice(&next);
        front = next;
    }
    found
}

/// Terms of the quadratic surface at an offset of `x` columns and `y` rows, in windows of `half`.
fn terms(x: f64, y: f64, half: usize) -> Array1<f64> {
    let (a, b) = (x / half as f64, y / half as f64);
    Array1::from(vec![1.0, a, b, a * a, a * b, b * b])
}

/// Coefficients of the quadratic surface through the known samples of `map` within `half` of
/// `(y, x)`, which is known; that value alone where they do not determine one.
fn surface(map: &Array2<f64>, is_known: &Array2<bool>, (y, x): (usize, usize), half: usize) -> Array1<f64> {
    let (rows, columns) = map.dim();
    let step = (2 * half + 1).div_ceil(ACROSS);
    let (mut normal, mut right, mut count) = (Array2::<f64>::zeros((6, 6)), Array1::<f64>::zeros(6), 0usize);
    for v in (y.saturating_sub(half)..(y + half + 1).min(rows)).step_by(step) {
        for u in (x.saturating_sub(half)..(x + half + 1).min(columns)).step_by(step) {
            if is_known[[v, u]] {
                let own = terms(u as f64 - x as f64, v as f64 - y as f64, half);
                right.scaled_add(map[[v, u]], &own);
                normal += &(own.view().insert_axis(Axis(1)).dot(&own.view().insert_axis(Axis(0))));
                count += 1;
            }
        }
    }
    let inverse = (count >= ENOUGH).then(|| SpdInverse::of_normal_equations(normal).ok()).flatten();
    let found = inverse.map(|found| found.inverse.dot(&right)).filter(|found| found.iter().all(|c| c.is_finite()));
    found.unwrap_or_else(|| Array1::from(vec![map[[y, x]], 0.0, 0.0, 0.0, 0.0, 0.0]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use crate::telescope::{MapOnGrid, Telescope};

    #[test]
    fn map_is_the_same_inside_whatever_is_outside() {
        let scene = Scene::preset("keck-artificial").unwrap();
        let pupil = Telescope::new(&scene).unwrap().pupil;
        let width_m = pupil.grid.width_m();
        // Focus of 1.5 waves, and a trefoil of 100 nm.
        let surface_nm = |x_m: f64, y_m: f64| {
            let (x, y) = (x_m / 5.0, y_m / 5.0);
            5000.0 * (2.0 * (x * x + y * y) - 1.0) + 100.0 * (3.0 * x * x * y - y * y * y)
        };
        for samples in [120, 301, 480] {
            let at_m = |index: usize| (index as f64 - (samples as f64 - 1.0) / 2.0) * width_m / samples as f64;
            let whole = Array2::from_shape_fn((samples, samples), |(y, x)| surface_nm(at_m(x), at_m(y)));
            let nearest = |c_m: f64| ((c_m / pupil.grid.pitch_m() + 59.5).round().clamp(0.0, 119.0)) as usize;
            let is_inside = |y: usize, x: usize| pupil.amplitude[[nearest(at_m(y)), nearest(at_m(x))]] > 0.5;
            let expected = MapOnGrid::new(whole.clone(), width_m).unwrap();
            for outside in [0.0, f64::NAN] {
                let cut =
                    Array2::from_shape_fn(
                        (samples, samples),
                        |(y, x)| {
                            if is_inside(y, x) { whole[[y, x]] } else { outside }
                        },
                    );
                let found = MapOnGrid::new(continued(&cut, width_m, &pupil), width_m).unwrap();
                let mut worst_nm = 0.0f64;
                for ((y, x), _) in pupil.amplitude.indexed_iter().filter(|(_, amplitude)| **amplitude > 0.0) {
                    let (x_m, y_m) = (pupil.grid.coordinate_m(x), pupil.grid.coordinate_m(y));
                    worst_nm = worst_nm.max((found.at(x_m, y_m) - expected.at(x_m, y_m)).abs());
                }
                // The focus is exact; the third order of the trefoil, 0.8 nm/m³, leaves less than 1
                // nm some samples from the edge.
                assert!(worst_nm < 1.0, "{samples} {outside}: {worst_nm} nm");
            }
        }
    }

    #[test]
    fn map_that_is_zero_inside_is_kept() {
        let scene = Scene::preset("keck-artificial").unwrap();
        let pupil = Telescope::new(&scene).unwrap().pupil;
        let map = Array2::from_shape_fn(pupil.amplitude.dim(), |at| if pupil.owner[at] == 3 { 100.0 } else { 0.0 });
        assert_eq!(continued(&map, pupil.grid.width_m(), &pupil), map);
    }
}

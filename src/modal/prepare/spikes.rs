//! Spikes: pixels so much brighter than those around them that no star makes them, and so bright
//! that they would mislead centroid and start of a fit. Fainter outliers are left to the fit, which
//! rejects them.

use super::extent::Extent;
use ndarray::{Array2, ArrayView2};

/// Brightness of the pixels that are looked at, as a share of the brightest.
const SHARE: f64 = 0.05;
/// Standard deviations of the dark frame from which a pixel can be a spike.
const SIGMA: f64 = 8.0;
/// Ratio of a spike to the third brightest pixel around it. A star in focus on the middle of a
/// pixel has 2 at 2 pixels per λ/D, 3.5 at 1.5, 7 at 1.2.
const RATIO: f64 = 12.0;
/// Half a side of the square of pixels around one. Two of them can be of the same track.
const REACH: usize = 2;
/// Most times that spikes are looked for after brighter ones were taken out.
const ROUNDS: usize = 8;
/// Most spikes of a frame; the rest is left to the fit.
const MOST: usize = 4096;

/// Finds spikes, in memory that is allocated once.
pub(super) struct Spikes {
    /// Row and column of each.
    found: Vec<(usize, usize)>,
}

impl Spikes {
    pub(super) fn new() -> Self {
        Self { found: Vec::with_capacity(MOST) }
    }

    /// Begins another frame.
    pub(super) fn clear(&mut self) {
        self.found.clear();
    }

    /// All that were found.
    pub(super) fn found(&self) -> &[(usize, usize)] {
        &self.found
    }

    /// Adds the spikes among the brightest pixels that are not `bad` of a frame with the border's
    /// `level_e`, this variance in the dark and these extents of its rows. Returns how many they
    /// are.
    fn find(
        &mut self,
        (data_e, bad): (ArrayView2<f64>, ArrayView2<bool>),
        (level_e, variance_e2): (f64, f64),
        extents: &[Extent],
    ) -> usize {
        let before = self.found.len();
        let brightest_e = extents.iter().fold(f64::MIN, |most, row| most.max(row.most)) - level_e;
        let least_e = (SHARE * brightest_e).max(SIGMA * variance_e2.sqrt());
        for (y, row) in data_e.outer_iter().enumerate().filter(|(y, _)| extents[*y].most - level_e > least_e) {
            for (x, &e) in row.iter().enumerate() {
                let above_e = e - level_e;
                if above_e <= least_e || bad[(y, x)] {
                    continue;
                }
                // The third brightest of four neighbours is at most that of all around.
                if above_e <= RATIO * (third_brightest_beside(data_e, (y, x)) - level_e) {
                    continue;
                }
                let around_e = third_brightest_around(data_e, bad, (y, x)) - level_e;
                if above_e > RATIO * around_e.max(0.0) + SIGMA * (variance_e2 + around_e.max(0.0)).sqrt() {
                    if self.found.len() == MOST {
                        return MOST - before;
                    }
                    self.found.push((y, x));
                }
            }
        }
        self.found.len() - before
    }

    /// Takes the spikes out of a frame: they become bad pixels of `data_e`, which are 0. It holds
    /// the frame, or where there is an `original` is made its copy. Returns whether there are some.
    pub(super) fn take_out(
        &mut self,
        original: Option<(ArrayView2<f64>, ArrayView2<bool>)>,
        (data_e, bad): (&mut Array2<f64>, &mut Array2<bool>),
        dark: (f64, f64),
        extents: &mut [Extent],
    ) -> bool {
        let first = original.unwrap_or((data_e.view(), bad.view()));
        let mut found = self.find(first, dark, extents);
        if found == 0 {
            return false;
        }
        if let Some((original_e, marks)) = original {
            data_e.assign(&original_e);
            bad.assign(&marks);
        }
        for round in 1..=ROUNDS {
            for &(y, x) in &self.found[self.found.len() - found..] {
                (data_e[(y, x)], bad[(y, x)]) = (0.0, true);
                let good = data_e.row(y).into_iter().zip(bad.row(y)).filter(|(_, bad)| !**bad);
                extents[y] = good.fold(Extent::EMPTY, |extent, (&value, _)| extent.with(value));
            }
            // Without the brightest, fainter ones stand out. All that were found are taken out,
            // also after the last round.
            found = if round < ROUNDS { self.find((data_e.view(), bad.view()), dark, extents) } else { 0 };
            if found == 0 {
                break;
            }
        }
        true
    }

    /// Gives each spike of `data_e` the mean of the pixels around it that are not bad, and marks it
    /// as good.
    pub(super) fn fill(&self, data_e: &mut Array2<f64>, bad: &mut Array2<bool>, level_e: f64) {
        for &at in &self.found {
            let (mut sum_e, mut count) = (0.0, 0);
            for other in around(data_e.dim(), at).filter(|&other| !bad[other]) {
                (sum_e, count) = (sum_e + data_e[other], count + 1);
            }
            data_e[at] = if count > 0 { sum_e / f64::from(count) } else { level_e };
        }
        self.found.iter().for_each(|&at| bad[at] = false);
    }
}

/// The pixels around one, without it.
fn around((rows, columns): (usize, usize), at: (usize, usize)) -> impl Iterator<Item = (usize, usize)> {
    let range = |at: usize, size: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(size);
    let columns = range(at.1, columns);
    range(at.0, rows).flat_map(move |y| columns.clone().map(move |x| (y, x))).filter(move |&other| other != at)
}

/// The third brightest of the four pixels beside one, of which bad ones are 0; −∞ on the border.
fn third_brightest_beside(data_e: ArrayView2<f64>, (y, x): (usize, usize)) -> f64 {
    let (rows, columns) = data_e.dim();
    if !(1..rows - 1).contains(&y) || !(1..columns - 1).contains(&x) {
        return f64::NEG_INFINITY;
    }
    let (left, right) = (data_e[(y, x - 1)], data_e[(y, x + 1)]);
    let (above, below) = (data_e[(y - 1, x)], data_e[(y + 1, x)]);
    left.min(right).max(above.min(below)).min(left.max(right).min(above.max(below)))
}

/// The third brightest of the pixels around one that are not bad.
fn third_brightest_around(data_e: ArrayView2<f64>, bad: ArrayView2<bool>, at: (usize, usize)) -> f64 {
    let mut brightest = [f64::MIN; 3];
    for other in around(data_e.dim(), at).filter(|&other| !bad[other]) {
        let mut e = data_e[other];
        for place in &mut brightest {
            if e > *place {
                std::mem::swap(&mut e, place);
            }
        }
    }
    brightest[2]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(data_e: &Array2<f64>) -> Vec<(usize, usize)> {
        let extents: Vec<Extent> = data_e.outer_iter().map(|row| Extent::from_row(row.as_slice().unwrap())).collect();
        let bad = data_e.mapv(|_| false);
        let mut spikes = Spikes::new();
        spikes.find((data_e.view(), bad.view()), (0.0, 100.0), &extents);
        spikes.found().to_vec()
    }

    #[test]
    fn stars_have_no_spikes() {
        // Gaussian cores of a half to two pixels: the sharpest has 0.14 of its peak beside it,
        // sharper than 1.5 pixels per λ/D.
        for width in [0.5, 0.7, 1.0, 2.0] {
            for offset in [0.0, 0.25, 0.5] {
                let square = |at: usize| (at as f64 - 16.0 - offset).powi(2);
                let star = Array2::from_shape_fn((32, 32), |(y, x)| {
                    1e5 * (-(square(y) + square(x)) / (2.0 * width * width)).exp()
                });
                assert_eq!(found(&star), []);
            }
        }
    }

    #[test]
    fn tracks_of_three_pixels_are_spikes() {
        let mut frame = Array2::from_shape_fn((32, 32), |(y, x)| ((7 * y + 13 * x) % 20) as f64 + 500.0);
        let track = [(10, 10), (11, 11), (12, 12)];
        track.iter().for_each(|&at| frame[at] = 5e4);
        assert_eq!(found(&frame), track);
        let mut bad = frame.mapv(|_| false);
        track.iter().for_each(|&at| bad[at] = true);
        let spikes = Spikes { found: track.to_vec() };
        spikes.fill(&mut frame, &mut bad, 0.0);
        // The others are 500 to 519.
        assert!(track.iter().all(|&at| (500.0..520.0).contains(&frame[at]) && !bad[at]));
    }

    #[test]
    fn spikes_that_are_found_are_all_taken_out() {
        // Each hides the next: more of them than there are rounds.
        let ladder: Vec<(usize, usize)> = (1..=2 * ROUNDS).map(|rung| (2, 8 * rung)).collect();
        let frame = Array2::from_shape_fn((8, 8 * (2 * ROUNDS + 1)), |at| {
            ladder.iter().position(|&rung| rung == at).map_or(0.0, |rung| 1e5 * 30f64.powi((2 * ROUNDS - rung) as i32))
        });
        let mut extents: Vec<Extent> =
            frame.outer_iter().map(|row| Extent::from_row(row.as_slice().unwrap())).collect();
        let (mut data_e, mut bad) = (Array2::zeros(frame.dim()), Array2::from_elem(frame.dim(), false));
        let marks = bad.clone();
        let mut spikes = Spikes::new();
        let original = Some((frame.view(), marks.view()));
        assert!(spikes.take_out(original, (&mut data_e, &mut bad), (0.0, 100.0), &mut extents));
        assert_eq!(spikes.found(), &ladder[..ROUNDS]);
        let marked: Vec<_> = bad.indexed_iter().filter(|(_, bad)| **bad).map(|(at, _)| at).collect();
        assert_eq!(spikes.found(), marked);
        assert_eq!(extents[2].good, frame.ncols() - ROUNDS);
    }
}

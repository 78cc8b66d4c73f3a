//! From pass to pass: where the next one looks, and how much of what is still missing a pass recovers.
//!
//! A retrieval by maximum a posteriori takes a part of whatever static wavefront it is not told of for chance, and gives back the
//! share a of it that the image insists on: `found = about + a·(truth − about) + error`. Passes approach the truth as a
//! geometric series, which two of them determine; and where they end, the error has become error/a.

use ndarray::{Array1, s};
use std::ops::Range;

/// Most that a pass is led beyond what it found, in steps from the pass before: beyond three times the last step the series is
/// not geometric.
const FARTHEST: f64 = 2.0;

/// Least share of what is missing that a pass is taken to recover: less would be a step that went nowhere.
const LEAST_RECOVERED: f64 = 0.2;

/// A pass: where its phases were sought, and what came of it; nm, pistons and NCPA.
struct Step {
    about: Array1<f64>,
    found: Array1<f64>,
}

/// The passes so far. Each arrives at what it found, and departs to where the next one looks.
#[derive(Default)]
pub(super) struct Path {
    steps: Vec<Step>,
    next: Option<Array1<f64>>,
}

impl Path {
    /// Where the pass that is under way looks; none before the first has departed.
    pub(super) fn about(&self) -> Option<&Array1<f64>> {
        self.next.as_ref()
    }

    /// Takes down what the pass that was under way found.
    pub(super) fn arrive(&mut self, found: Array1<f64>) {
        let about = self.next.take().unwrap_or_else(|| Array1::zeros(found.len()));
        if about.len() != found.len() {
            // Other modes: a new path, and what it looked about is not known in them.
            self.steps.clear();
            self.steps.push(Step { about: found.clone(), found });
            return;
        }
        self.steps.push(Step { about, found });
    }

    /// Where to look next: the end of the geometric series (Anderson's acceleration of depth one).
    pub(super) fn depart(&mut self) -> Array1<f64> {
        let mut next = self.steps.last().map_or_else(|| Array1::zeros(0), |step| step.found.clone());
        if let [.., before, now] = &self.steps[..] {
            let [left_before, left_now] = [before, now].map(|step| &step.found - &step.about);
            let turn = &left_now - &left_before;
            let share = left_now.dot(&turn) / turn.dot(&turn).max(f64::MIN_POSITIVE);
            next.scaled_add(-share.clamp(-FARTHEST, 0.5), &(&now.found - &before.found));
        }
        self.next = Some(next.clone());
        next
    }

    /// The share of what is missing that a pass recovers, among the coefficients `range`; 1 after one pass. The images are
    /// the same in all of them, and so are their errors, which drop out.
    pub(super) fn recovered(&self, range: Range<usize>) -> f64 {
        let (mut kept, mut moved) = (0.0, 0.0);
        for pair in self.steps.windows(2) {
            let range = s![range.start..range.end.min(pair[0].about.len())];
            let about = &pair[1].about.slice(range) - &pair[0].about.slice(range);
            kept += (&pair[1].found.slice(range) - &pair[0].found.slice(range)).dot(&about);
            moved += about.dot(&about);
        }
        if moved == 0.0 { 1.0 } else { (1.0 - kept / moved).clamp(LEAST_RECOVERED, 1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_geometric_series_is_at_its_end_in_three_passes() {
        // Each pass recovers 55 % of what its static wavefront lacks.
        let truth = Array1::from(vec![30.0, -12.0, 5.0]);
        let pass = |about: &Array1<f64>| about + &((&truth - about) * 0.55);
        let (mut path, mut about) = (Path::default(), Array1::zeros(3));
        for _ in 0..2 {
            path.arrive(pass(&about));
            about = path.depart();
        }
        // 45 % of 45 % would be left without the extrapolation; rounding is with it.
        assert!((&about - &truth).iter().all(|off| off.abs() < 1e-10), "{about}");
        assert!((path.recovered(0..1) - 0.55).abs() < 1e-12 && (path.recovered(1..usize::MAX) - 0.55).abs() < 1e-12);
    }

    #[test]
    fn one_pass_and_other_modes_say_nothing_of_the_share() {
        let mut path = Path::default();
        path.arrive(Array1::ones(3));
        assert_eq!(path.recovered(0..3), 1.0);
        path.depart();
        path.arrive(Array1::ones(4));
        assert_eq!((path.recovered(0..4), path.depart()), (1.0, Array1::ones(4)));
    }
}

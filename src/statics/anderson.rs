//! Anderson acceleration, of depth one, of the iterations of the static estimate, and the fraction
//! that each recovers.
//!
//! MAP retrieval takes a part of any static wavefront that it is not given for chance, and returns
//! a fraction a of the remainder: `output = input + a·(truth − input) + error`. Plain iterations
//! approach the truth as a geometric series, which two of them determine; at its end the error has
//! grown to error/a.

use ndarray::{Array1, s};
use std::ops::Range;

/// Largest extrapolation beyond an output, in steps from the last output: beyond three times the
/// step the series is not geometric.
const MAX_EXTRAPOLATION: f64 = 2.0;

/// Least recovered fraction: less would be a step without effect.
const MIN_RECOVERED: f64 = 0.2;

/// An iteration: static coefficients about which wavefronts are retrieved, and those estimated from
/// them, pistons and NCPA, nm.
struct Step {
    input: Array1<f64>,
    output: Array1<f64>,
}

/// Anderson acceleration over the iterations so far.
#[derive(Default)]
pub(super) struct AndersonAcceleration {
    steps: Vec<Step>,
    next: Option<Array1<f64>>,
}

impl AndersonAcceleration {
    /// An acceleration that begins with the input of the current iteration, `None` for zeros.
    pub(super) fn from_input(input: Option<Array1<f64>>) -> Self {
        Self { steps: Vec::new(), next: input }
    }

    /// Input of the current iteration; `None` in the first.
    pub(super) fn input(&self) -> Option<&Array1<f64>> {
        self.next.as_ref()
    }

    /// Records the output of the current iteration.
    pub(super) fn record(&mut self, output: Array1<f64>) {
        let input = self.next.take().unwrap_or_else(|| Array1::zeros(output.len()));
        if input.len() != output.len() {
            // Another basis: the series restarts, because the input is not known in it.
            self.steps.clear();
            self.steps.push(Step { input: output.clone(), output });
            return;
        }
        self.steps.push(Step { input, output });
    }

    /// Extrapolates the next input: the end of the geometric series of the last two steps.
    pub(super) fn next_input(&mut self) -> Array1<f64> {
        let mut next = self.steps.last().map_or_else(|| Array1::zeros(0), |step| step.output.clone());
        if let [.., before, now] = &self.steps[..] {
            let [residual_before, residual_now] = [before, now].map(|step| &step.output - &step.input);
            let difference = &residual_now - &residual_before;
            let share = residual_now.dot(&difference) / difference.dot(&difference).max(f64::MIN_POSITIVE);
            next.scaled_add(-share.clamp(-MAX_EXTRAPOLATION, 0.5), &(&now.output - &before.output));
        }
        self.next = Some(next.clone());
        next
    }

    /// Estimates the fraction a that an iteration recovers, among the coefficients `range`; 1 after
    /// one iteration. The images are the same in all of them, so their errors cancel in the
    /// differences.
    pub(super) fn recovered_fraction(&self, range: Range<usize>) -> f64 {
        let (mut kept, mut moved) = (0.0, 0.0);
        for pair in self.steps.windows(2) {
            let range = s![range.start..range.end.min(pair[0].input.len())];
            let input = &pair[1].input.slice(range) - &pair[0].input.slice(range);
            kept += (&pair[1].output.slice(range) - &pair[0].output.slice(range)).dot(&input);
            moved += input.dot(&input);
        }
        if moved == 0.0 { 1.0 } else { (1.0 - kept / moved).clamp(MIN_RECOVERED, 1.0) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_geometric_series_converges_in_three_iterations() {
        // Each iteration recovers 55 % of the difference to the truth.
        let truth = Array1::from(vec![30.0, -12.0, 5.0]);
        let iterate = |input: &Array1<f64>| input + &((&truth - input) * 0.55);
        let (mut acceleration, mut input) = (AndersonAcceleration::default(), Array1::zeros(3));
        for _ in 0..2 {
            acceleration.record(iterate(&input));
            input = acceleration.next_input();
        }
        // Without the extrapolation 45 % of 45 % would remain; with it, rounding.
        assert!((&input - &truth).iter().all(|off| off.abs() < 1e-10), "{input}");
        assert!((acceleration.recovered_fraction(0..1) - 0.55).abs() < 1e-12);
        assert!((acceleration.recovered_fraction(1..usize::MAX) - 0.55).abs() < 1e-12);
    }

    #[test]
    fn recovered_fraction_needs_two_iterations_in_one_basis() {
        let mut acceleration = AndersonAcceleration::default();
        acceleration.record(Array1::ones(3));
        assert_eq!(acceleration.recovered_fraction(0..3), 1.0);
        acceleration.next_input();
        acceleration.record(Array1::ones(4));
        assert_eq!((acceleration.recovered_fraction(0..4), acceleration.next_input()), (1.0, Array1::ones(4)));
    }
}

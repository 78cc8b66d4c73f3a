//! How far to go along one direction: a state machine over φ(α) = f(x + α·p), told one point at a time.
//!
//! Unit steps first, Armijo's sufficient decrease, safeguarded cubic interpolation on the way back, and extrapolation
//! where the weak Wolfe condition says that the slope has hardly changed (Nocedal & Wright, *Numerical Optimization*,
//! chapter 3). Below the resolution of φ the slope decides instead of the value: the approximate Wolfe conditions of
//! Hager & Zhang (SIAM J. Optim. 16, 2005, eq. 4.1).

/// Armijo: φ(α) ≤ φ(0) + c·α·φ'(0). The usual value: nearly any decrease will do.
const SUFFICIENT_DECREASE: f64 = 1e-4;
/// Wolfe: φ'(α) ≥ c·φ'(0). The usual value for quasi-Newton directions, whose unit step is nearly always good.
const CURVATURE: f64 = 0.9;
/// Approximate Wolfe: φ'(α) ≤ (2δ − 1)·φ'(0) with Hager & Zhang's δ = 0.1.
const LARGEST_RISE: f64 = 0.8;
/// A step back shortens at least and at most this much: an interpolation outside trusts too few points too far.
const BACKTRACK: (f64, f64) = (0.1, 0.5);
/// A step forward lengthens at least and at most this much.
const EXTEND: (f64, f64) = (1.5, 5.0);
/// Steps forward per search: 5⁴ = 625 times the model's step is the last that is believed.
const MOST_EXTENSIONS: usize = 4;
/// Steps back per search over finite values: between 1e-3 and 1e-10 of the first.
const MOST_BACKTRACKS: usize = 10;
/// Halvings per search out of a region where φ is not finite: to 1e-9 of the first step.
const MOST_HALVINGS: usize = 30;

/// φ and φ' at one step length.
#[derive(Debug, Clone, Copy)]
struct Sample {
    alpha: f64,
    value: f64,
    slope: f64,
}

/// What to do about the point just told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Verdict {
    /// Go there.
    Accept,
    /// Go back to the point that was kept.
    AcceptKept,
    /// It will not do: evaluate here.
    Try(f64),
    /// It would do, but more lies ahead: keep it and evaluate here.
    KeepAndTry(f64),
    /// Its value says nothing any more but its slope does: go there, and stop.
    AcceptUnresolved,
    /// Neither its value nor its slope shows descent: stay, and stop.
    Unresolved,
    /// Nothing finite near the origin.
    NotFinite,
    /// No descent however short the step.
    NoDescent,
}

/// The search along one direction.
#[derive(Debug, Clone)]
pub(super) struct LineSearch {
    origin: Sample,
    /// The smallest difference of φ that means something.
    noise: f64,
    /// From the start φ cannot show the decrease to come.
    unresolved: bool,
    longest: f64,
    alpha: f64,
    kept: Option<Sample>,
    extensions: usize,
    backtracks: usize,
    halvings: usize,
}

impl LineSearch {
    /// A search from φ(0) = `value`, φ'(0) = `slope` < 0 that first tries the step `first` and never goes beyond
    /// `longest`. `noise` is the smallest difference of φ that means something; `unresolved` that the whole decrease
    /// to come is below it.
    pub fn new(value: f64, slope: f64, first: f64, longest: f64, noise: f64, unresolved: bool) -> Self {
        LineSearch {
            origin: Sample { alpha: 0.0, value, slope },
            noise,
            unresolved,
            longest,
            alpha: first,
            kept: None,
            extensions: 0,
            backtracks: 0,
            halvings: 0,
        }
    }

    /// The step length to evaluate.
    pub fn alpha(&self) -> f64 {
        self.alpha
    }

    /// The step length of the point that was kept, if one was.
    pub fn kept_alpha(&self) -> Option<f64> {
        self.kept.map(|kept| kept.alpha)
    }

    /// Takes φ and φ' at [`alpha`](Self::alpha).
    pub fn tell(&mut self, value: f64, slope: f64) -> Verdict {
        let here = Sample { alpha: self.alpha, value, slope };
        let finite = value.is_finite() && slope.is_finite();
        if self.kept.is_some_and(|kept| !finite || value >= kept.value) {
            return Verdict::AcceptKept;
        }
        if !finite {
            return self.halve();
        }
        if self.unresolved {
            let stop = if self.approximate_wolfe(here) { Verdict::AcceptUnresolved } else { Verdict::Unresolved };
            return stop;
        }
        if value <= self.origin.value + SUFFICIENT_DECREASE * here.alpha * self.origin.slope {
            return self.lower(here);
        }
        if self.approximate_wolfe(here) {
            return Verdict::AcceptUnresolved;
        }
        self.back(here)
    }

    /// Hager & Zhang's test, which trusts the slope within the noise of the value.
    fn approximate_wolfe(&self, here: Sample) -> bool {
        let steepness = -self.origin.slope;
        here.value <= self.origin.value + self.noise
            && here.slope >= -CURVATURE * steepness
            && here.slope <= LARGEST_RISE * steepness
    }

    /// A point that lies lower: go there, unless it still falls as steeply as at the origin.
    fn lower(&mut self, here: Sample) -> Verdict {
        // Room for less than the least extension is not worth an evaluation.
        let room = self.longest >= EXTEND.0 * here.alpha;
        if here.slope >= CURVATURE * self.origin.slope || self.extensions == MOST_EXTENSIONS || !room {
            return Verdict::Accept;
        }
        // After a step back the far side is known to be too far.
        if self.backtracks + self.halvings > 0 {
            return Verdict::Accept;
        }
        let before = self.kept.unwrap_or(self.origin);
        // Where the slope, continued linearly, vanishes; the farthest allowed where it is not even rising.
        let change = here.slope - before.slope;
        let ahead = if change > 0.0 { -here.slope * (here.alpha - before.alpha) / change } else { f64::INFINITY };
        let alpha = (here.alpha + ahead).clamp(EXTEND.0 * here.alpha, EXTEND.1 * here.alpha).min(self.longest);
        self.kept = Some(here);
        self.extensions += 1;
        self.alpha = alpha;
        Verdict::KeepAndTry(alpha)
    }

    /// A point that does not lie low enough: step back, unless what is left to win is below the noise.
    fn back(&mut self, here: Sample) -> Verdict {
        let alpha = self.interpolate(here);
        if -0.5 * alpha * self.origin.slope < self.noise {
            return Verdict::Unresolved;
        }
        if self.backtracks == MOST_BACKTRACKS {
            return Verdict::NoDescent;
        }
        self.backtracks += 1;
        self.alpha = alpha;
        Verdict::Try(alpha)
    }

    /// A point where φ does not exist: halve.
    fn halve(&mut self) -> Verdict {
        if self.halvings == MOST_HALVINGS {
            return Verdict::NotFinite;
        }
        self.halvings += 1;
        self.alpha *= 0.5;
        Verdict::Try(self.alpha)
    }

    /// The minimum of the cubic through both values and slopes (Nocedal & Wright, eq. 3.59), safeguarded.
    fn interpolate(&self, here: Sample) -> f64 {
        let Sample { value: f0, slope: d0, .. } = self.origin;
        let d1 = d0 + here.slope - 3.0 * (here.value - f0) / here.alpha;
        let radicand = d1 * d1 - d0 * here.slope;
        let fraction = if radicand >= 0.0 {
            let d2 = radicand.sqrt();
            1.0 - (here.slope + d2 - d1) / (here.slope - d0 + 2.0 * d2)
        } else {
            BACKTRACK.1
        };
        let fraction = if fraction.is_finite() { fraction } else { BACKTRACK.1 };
        here.alpha * fraction.clamp(BACKTRACK.0, BACKTRACK.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn search(noise: f64, unresolved: bool) -> LineSearch {
        LineSearch::new(1.0, -1.0, 1.0, f64::INFINITY, noise, unresolved)
    }

    #[test]
    fn the_minimum_of_a_cubic_is_found_in_one_step_back() {
        // φ = 1 − α + 2α² + α³ has its minimum where 3α² + 4α − 1 = 0, at 0.2153; φ(1) = 3, φ'(1) = 6.
        let mut search = search(0.0, false);
        let Verdict::Try(alpha) = search.tell(3.0, 6.0) else { panic!("a rise must be refused") };
        let root = (-4.0 + 28.0_f64.sqrt()) / 6.0;
        // The interpolation is exact on cubics: rounding of ten operations.
        assert!((alpha - root).abs() < 1e-14, "{alpha} instead of {root}");
    }

    #[test]
    fn a_steep_descent_is_followed_and_the_lower_point_taken() {
        let mut search = search(0.0, false);
        assert_eq!(search.tell(0.0, -1.0), Verdict::KeepAndTry(5.0));
        assert_eq!(search.kept_alpha(), Some(1.0));
        assert_eq!(search.tell(f64::NAN, 0.0), Verdict::AcceptKept);
    }

    #[test]
    fn where_nothing_is_finite_the_search_halves_and_then_gives_up() {
        let mut search = search(0.0, false);
        assert_eq!(search.tell(f64::INFINITY, 0.0), Verdict::Try(0.5));
        assert_eq!(search.tell(0.0, f64::NAN), Verdict::Try(0.25));
        let verdicts: Vec<_> = (0..40).map(|_| search.tell(f64::NAN, f64::NAN)).collect();
        assert_eq!(verdicts.iter().position(|v| *v == Verdict::NotFinite), Some(MOST_HALVINGS - 2));
    }

    #[test]
    fn below_the_resolution_the_slope_decides() {
        assert_eq!(search(1e-3, true).tell(1.0005, 0.1), Verdict::AcceptUnresolved);
        assert_eq!(search(1e-3, true).tell(1.0005, 0.9), Verdict::Unresolved);
        assert_eq!(search(1e-3, true).tell(1.0015, 0.1), Verdict::Unresolved);
        // Without noise the same point is a rise to step back from.
        assert!(matches!(search(0.0, false).tell(1.0005, 0.1), Verdict::Try(_)));
    }
}

//! Line search: chooses the step length α that decreases φ(α) = f(x + α·p) sufficiently, one
//! evaluated point at a time.
//!
//! The unit step first; Armijo's sufficient decrease; safeguarded cubic interpolation for steps
//! back; and extrapolation where the slope still violates the weak Wolfe condition (Nocedal &
//! Wright, *Numerical Optimization*, chapter 3). Below the resolution of φ the slope replaces the
//! value: the approximate Wolfe conditions of Hager & Zhang (SIAM J. Optim. 16, 2005, eq. 4.1).

/// Armijo: φ(α) ≤ φ(0) + c·α·φ'(0). The usual value, which accepts nearly any decrease.
const SUFFICIENT_DECREASE: f64 = 1e-4;
/// Wolfe: φ'(α) ≥ c·φ'(0). The usual value for quasi-Newton directions, whose unit step is nearly
/// always good.
const CURVATURE: f64 = 0.9;
/// Approximate Wolfe: φ'(α) ≤ (2δ − 1)·φ'(0) with Hager & Zhang's δ = 0.1.
const LARGEST_RISE: f64 = 0.8;
/// Smallest and largest factor of a step back: safeguard of the interpolation, which rests on two
/// points.
const BACKTRACK: (f64, f64) = (0.1, 0.5);
/// Smallest and largest factor of a step forward.
const EXTEND: (f64, f64) = (1.5, 5.0);
/// Steps forward per search: at most 5⁴ = 625 times the model's step.
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

/// What follows from the point just evaluated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum LineSearchDecision {
    /// Accept the point.
    Accept,
    /// Accept the point kept before instead.
    AcceptKept,
    /// Reject the point, and evaluate at this step length.
    Try(f64),
    /// Keep the point, which is acceptable, and evaluate at this longer step length.
    KeepAndTry(f64),
    /// The decrease is below the resolution, and the slope shows descent: accept the point, and
    /// stop.
    AcceptUnresolved,
    /// The decrease is below the resolution, and the slope does not show descent: stop at the
    /// origin.
    Unresolved,
    /// No finite value near the origin.
    NotFinite,
    /// No descent at any step length.
    NoDescent,
}

/// The search along one direction.
#[derive(Debug, Clone)]
pub(super) struct LineSearch {
    origin: Sample,
    /// The smallest significant difference of φ.
    noise: f64,
    /// Whether the predicted decrease is below `noise` from the start.
    unresolved: bool,
    longest: f64,
    alpha: f64,
    kept: Option<Sample>,
    extensions: usize,
    backtracks: usize,
    halvings: usize,
}

impl LineSearch {
    /// A search from φ(0) = `value`, φ'(0) = `slope` < 0 with the first step `first` and the
    /// longest step `longest`. `noise` is the smallest significant difference of φ; `unresolved`:
    /// the predicted decrease is below it.
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

    /// The step length of the kept point, if there is one.
    pub fn kept_alpha(&self) -> Option<f64> {
        self.kept.map(|kept| kept.alpha)
    }

    /// Processes φ and φ' at [`alpha`](Self::alpha).
    pub fn advance(&mut self, value: f64, slope: f64) -> LineSearchDecision {
        let here = Sample { alpha: self.alpha, value, slope };
        let finite = value.is_finite() && slope.is_finite();
        if self.kept.is_some_and(|kept| !finite || value >= kept.value) {
            return LineSearchDecision::AcceptKept;
        }
        if !finite {
            return self.halve();
        }
        if self.unresolved {
            let stop = if self.approximate_wolfe(here) {
                LineSearchDecision::AcceptUnresolved
            } else {
                LineSearchDecision::Unresolved
            };
            return stop;
        }
        if value <= self.origin.value + SUFFICIENT_DECREASE * here.alpha * self.origin.slope {
            return self.lower(here);
        }
        if self.approximate_wolfe(here) {
            return LineSearchDecision::AcceptUnresolved;
        }
        self.back(here)
    }

    /// Hager & Zhang's test: the slope decides where the value is within its noise.
    fn approximate_wolfe(&self, here: Sample) -> bool {
        let steepness = -self.origin.slope;
        here.value <= self.origin.value + self.noise
            && here.slope >= -CURVATURE * steepness
            && here.slope <= LARGEST_RISE * steepness
    }

    /// A point with sufficient decrease: accept it, unless φ still falls nearly as steeply as at
    /// the origin.
    fn lower(&mut self, here: Sample) -> LineSearchDecision {
        // An extension below the smallest factor is not worth an evaluation.
        let can_extend = self.longest >= EXTEND.0 * here.alpha;
        if here.slope >= CURVATURE * self.origin.slope || self.extensions == MOST_EXTENSIONS || !can_extend {
            return LineSearchDecision::Accept;
        }
        // After a step back, longer steps are known to be too long.
        if self.backtracks + self.halvings > 0 {
            return LineSearchDecision::Accept;
        }
        let before = self.kept.unwrap_or(self.origin);
        // The zero of the linearly extrapolated slope; the longest extension where the slope does
        // not increase.
        let change = here.slope - before.slope;
        let ahead = if change > 0.0 { -here.slope * (here.alpha - before.alpha) / change } else { f64::INFINITY };
        let alpha = (here.alpha + ahead).clamp(EXTEND.0 * here.alpha, EXTEND.1 * here.alpha).min(self.longest);
        self.kept = Some(here);
        self.extensions += 1;
        self.alpha = alpha;
        LineSearchDecision::KeepAndTry(alpha)
    }

    /// A point without sufficient decrease: step back, unless the possible decrease is below the
    /// noise.
    fn back(&mut self, here: Sample) -> LineSearchDecision {
        let alpha = self.interpolate(here);
        if -0.5 * alpha * self.origin.slope < self.noise {
            return LineSearchDecision::Unresolved;
        }
        if self.backtracks == MOST_BACKTRACKS {
            return LineSearchDecision::NoDescent;
        }
        self.backtracks += 1;
        self.alpha = alpha;
        LineSearchDecision::Try(alpha)
    }

    /// A point where φ is not finite: halve the step.
    fn halve(&mut self) -> LineSearchDecision {
        if self.halvings == MOST_HALVINGS {
            return LineSearchDecision::NotFinite;
        }
        self.halvings += 1;
        self.alpha *= 0.5;
        LineSearchDecision::Try(self.alpha)
    }

    /// The minimum of the cubic through both values and slopes (Nocedal & Wright, eq. 3.59),
    /// safeguarded.
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
        // φ = 1 − α + 2α² + α³ has its minimum where 3α² + 4α − 1 = 0, at 0.2153; φ(1) = 3, φ'(1) =
        // 6.
        let mut search = search(0.0, false);
        let LineSearchDecision::Try(alpha) = search.advance(3.0, 6.0) else { panic!("an increase must be rejected") };
        let root = (-4.0 + 28.0_f64.sqrt()) / 6.0;
        // The interpolation is exact on cubics: rounding of ten operations.
        assert!((alpha - root).abs() < 1e-14, "{alpha} instead of {root}");
    }

    #[test]
    fn a_steep_descent_is_extended_and_the_lower_point_accepted() {
        let mut search = search(0.0, false);
        assert_eq!(search.advance(0.0, -1.0), LineSearchDecision::KeepAndTry(5.0));
        assert_eq!(search.kept_alpha(), Some(1.0));
        assert_eq!(search.advance(f64::NAN, 0.0), LineSearchDecision::AcceptKept);
    }

    #[test]
    fn without_finite_values_the_search_halves_and_then_stops() {
        let mut search = search(0.0, false);
        assert_eq!(search.advance(f64::INFINITY, 0.0), LineSearchDecision::Try(0.5));
        assert_eq!(search.advance(0.0, f64::NAN), LineSearchDecision::Try(0.25));
        let decisions: Vec<_> = (0..40).map(|_| search.advance(f64::NAN, f64::NAN)).collect();
        assert_eq!(decisions.iter().position(|v| *v == LineSearchDecision::NotFinite), Some(MOST_HALVINGS - 2));
    }

    #[test]
    fn below_the_resolution_the_slope_decides() {
        assert_eq!(search(1e-3, true).advance(1.0005, 0.1), LineSearchDecision::AcceptUnresolved);
        assert_eq!(search(1e-3, true).advance(1.0005, 0.9), LineSearchDecision::Unresolved);
        assert_eq!(search(1e-3, true).advance(1.0015, 0.1), LineSearchDecision::Unresolved);
        // Without noise the same point is an increase, and the search steps back.
        assert!(matches!(search(0.0, false).advance(1.0005, 0.1), LineSearchDecision::Try(_)));
    }
}

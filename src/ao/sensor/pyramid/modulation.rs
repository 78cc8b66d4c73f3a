//! Circular modulation of a pyramid: points on the circle, and the strips of the focal plane that
//! cross its edges from point to point.
//!
//! At the point (mx, my), in units of λ/D, the focal field is shifted by it, so that the edges of
//! the pyramid lie at u = −mx and v = −my. From one point to the next an edge passes over a strip
//! of frequencies. The light of a strip is a Fourier integral over its width, which Gauss-Legendre
//! quadrature gives with a few nodes, since the field of a pupil of width D varies slowly over a
//! fraction of λ/D.

use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Relative error of the light of a strip between opposite edges of the grid, the worst pair of
/// points: a tenth of the difference between f32 and f64 that the tests allow.
const STRIP_ERROR: f64 = 1e-4;

/// Points on the circle, and what changes between them.
#[derive(Clone)]
pub(super) struct Modulation {
    /// Number of points; 1 without modulation.
    pub points: usize,
    /// Different positions of an edge, λ/D, descending.
    pub offsets: Vec<f64>,
    /// Frequencies of the quadrature in cycles over the grid, and their weights.
    pub nodes: Vec<f64>,
    pub weights: Vec<f64>,
    /// From each point to the next.
    pub steps: Vec<ModulationStep>,
}

/// Change from a point of the modulation to the next.
#[derive(Clone)]
pub(super) struct ModulationStep {
    /// Strips that the edges across u and across v pass over.
    pub strips: [Option<Strip>; 2],
    /// Position of the edge across v before the step, and of that across u after it: indices of
    /// [`Modulation::offsets`].
    pub v_before: usize,
    pub u_after: usize,
}

/// Strip of frequencies that changes sides.
#[derive(Clone)]
pub(super) struct Strip {
    /// Its nodes.
    pub nodes: Range<usize>,
    /// 1 where it goes to the positive side.
    pub sign: f64,
}

/// Least number of points for a radius of `radius` λ/D: the least multiple of 4 from 16 on that is
/// 2πr + 3(2πr)^⅓ or more.
///
/// An intensity behind the pyramid is a sum over pairs of points of the pupil, and a pair at a
/// distance of d varies around the circle as exp(2πi·m·d/λ): harmonics J_n(2πr·d/D), d ≤ D. A mean
/// over M points is exact but for harmonics that are multiples of M, and J_n(z) vanishes faster
/// than exponentially beyond n = z + 2 z^⅓ (Abramowitz and Stegun 9.3.4).
pub(super) fn least_points(radius: f64) -> usize {
    let z = TAU * radius;
    ((z + 3.0 * z.cbrt()) as usize + 1).next_multiple_of(4).max(16)
}

impl Modulation {
    /// Modulation with a radius of `radius` λ/D over `points` points, a multiple of 4.
    pub(super) fn new(radius: f64, points: Option<usize>) -> Self {
        if radius == 0.0 {
            return Self { points: 1, offsets: vec![0.0], nodes: vec![], weights: vec![], steps: vec![] };
        }
        let points = points.unwrap_or_else(|| least_points(radius));
        // Points at half steps from the axes: offsets of both edges are then the same numbers, each
        // of four or two points.
        let offsets: Vec<f64> =
            (0..points / 2).map(|i| radius * (TAU * (i as f64 + 0.5) / points as f64).cos()).collect();
        let (mut nodes, mut weights, mut strips) = (Vec::new(), Vec::new(), Vec::new());
        for pair in offsets.windows(2) {
            let (middle, half) = (-0.5 * (pair[0] + pair[1]), 0.5 * (pair[0] - pair[1]));
            let first = nodes.len();
            for (node, weight) in gauss_legendre(nodes_of_strip(2.0 * half)) {
                nodes.push(middle + half * node);
                weights.push(half * weight);
            }
            strips.push(first..nodes.len());
        }
        // Index of the offset r·cos θ of point j, and of r·sin θ = r·cos(θ − π/2).
        let along_u = |j: usize| (j % points).min(points - 1 - j % points);
        let along_v = |j: usize| along_u(j + points - points / 4);
        let strip = |from: usize, to: usize| {
            // A falling offset moves the edge to the right: the strip leaves the positive side.
            let sign = if to > from { -1.0 } else { 1.0 };
            (from != to).then(|| Strip { nodes: strips[from.min(to)].clone(), sign })
        };
        let step = |j: usize| ModulationStep {
            strips: [strip(along_u(j), along_u(j + 1)), strip(along_v(j), along_v(j + 1))],
            v_before: along_v(j),
            u_after: along_u(j + 1),
        };
        let steps = (0..points - 1).map(step).collect();
        Self { points, offsets, nodes, weights, steps }
    }

    /// Indices of the first point's offsets.
    pub(super) fn start(&self) -> [usize; 2] {
        if self.points == 1 { [0, 0] } else { [0, self.points / 4 - 1] }
    }
}

/// Number of nodes for a strip of `width` λ/D.
fn nodes_of_strip(width: f64) -> usize {
    // Remainder of the quadrature of cos(at) on [−1, 1] with n nodes (Abramowitz and Stegun
    // 25.4.30), relative to the integral at a = 0.
    let a = PI * width;
    let factorial = |n: usize| (1..=n).map(|i| i as f64).product::<f64>();
    let remainder = |n: usize| {
        (2.0 * a).powi(2 * n as i32) * factorial(n).powi(4) / ((2 * n + 1) as f64 * factorial(2 * n).powi(3))
    };
    (1..24).find(|&n| remainder(n) <= STRIP_ERROR).unwrap_or(24)
}

/// Nodes and weights of Gauss-Legendre quadrature on [−1, 1], by Newton's method on the Legendre
/// polynomial.
fn gauss_legendre(count: usize) -> Vec<(f64, f64)> {
    let n = count as f64;
    let root = |i: usize| {
        let mut x = (PI * (i as f64 + 0.75) / (n + 0.5)).cos();
        let mut slope = 1.0;
        // Quadratic convergence from four digits.
        for _ in 0..6 {
            let (mut last, mut value) = (1.0, x);
            for k in 2..=count {
                let k = k as f64;
                (last, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * last) / k);
            }
            slope = n * (x * value - last) / (x * x - 1.0);
            x -= value / slope;
        }
        (x, 2.0 / ((1.0 - x * x) * slope * slope))
    };
    (0..count).map(root).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quadrature_is_exact_for_polynomials_of_its_degree() {
        for count in 1..=24 {
            for power in 0..2 * count {
                let sum: f64 = gauss_legendre(count).iter().map(|(x, w)| w * x.powi(power as i32)).sum();
                let exact = if power % 2 == 0 { 2.0 / (power as f64 + 1.0) } else { 0.0 };
                // Rounding of some ten operations in each of 24 terms of order 1.
                assert!((sum - exact).abs() < 1e-13, "{count} {power}: {sum}");
            }
        }
    }

    #[test]
    fn steps_lead_around_the_circle() {
        for (radius, points) in [(1.0, 16), (3.0, 28), (3.0, 20), (5.0, 44)] {
            let modulation = Modulation::new(radius, Some(points));
            let mut at = modulation.start();
            let position = |j: usize| {
                let angle = TAU * (j as f64 + 0.5) / points as f64;
                [radius * angle.cos(), radius * angle.sin()]
            };
            let mut edges = position(0);
            for (j, step) in modulation.steps.iter().enumerate() {
                assert_eq!(step.v_before, at[1]);
                for (edge, strip) in edges.iter_mut().zip(&step.strips) {
                    let Some(strip) = strip else { continue };
                    // The strip's width is what the edge moves by.
                    *edge += strip.sign * modulation.weights[strip.nodes.clone()].iter().sum::<f64>();
                }
                for (edge, expected) in edges.iter().zip(position(j + 1)) {
                    assert!((edge - expected).abs() < 1e-12, "{points} {j}: {edge} {expected}");
                }
                let index = |value: f64| modulation.offsets.iter().position(|o| (o - value).abs() < 1e-9).unwrap();
                at = position(j + 1).map(index);
                assert_eq!(step.u_after, at[0]);
            }
        }
        assert_eq!([0.5, 1.0, 3.0, 5.0].map(least_points), [16, 16, 28, 44]);
    }
}

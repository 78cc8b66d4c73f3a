//! Zernike polynomials in Noll's order, as polynomials in x and y, which are defined also outside
//! the disc.

use super::samples::check_lengths;
use crate::{Error, Result};
use ndarray::{Array2, ArrayViewMut2, s};

/// The largest Noll index accepted: 60 complete radial orders, far more than a pupil of 120 samples
/// resolves.
pub const LARGEST_NOLL: usize = 1891;

/// Points that are evaluated together.
const BLOCK: usize = 512;

/// Radial order n and signed azimuthal order m of the Zernike polynomial with Noll index `noll`
/// (from 1): m > 0 for the cosine (even indices), m < 0 for the sine (odd indices).
///
/// Noll (1976), "Zernike polynomials and atmospheric turbulence", J. Opt. Soc. Am. 66, 207.
///
/// # Errors
/// [`Error::Value`] for an index outside 1..=`LARGEST_NOLL`.
pub fn noll_orders(noll: usize) -> Result<(usize, isize)> {
    if !(1..=LARGEST_NOLL).contains(&noll) {
        return Err(Error::Value(format!("Noll index {noll} is out of range: 1 to {LARGEST_NOLL} are accepted")));
    }
    // Order n has the indices n(n+1)/2 + 1 ..= (n+1)(n+2)/2.
    let mut n = 0;
    while (n + 1) * (n + 2) / 2 < noll {
        n += 1;
    }
    let place = noll - n * (n + 1) / 2 - 1;
    // Within an order |m| grows in pairs: 0, 2, 2, 4, 4 … for even n; 1, 1, 3, 3 … for odd n.
    let m: usize = if n % 2 == 0 { 2 * place.div_ceil(2) } else { 2 * (place / 2) + 1 };
    let m = m as isize;
    Ok((n, if noll.is_multiple_of(2) { m } else { -m }))
}

/// A set of Zernike polynomials over a disc of `radius_m` about the axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Zernikes {
    nolls: Vec<usize>,
    radius_m: f64,
    /// Terms in the order of the recurrences: by m, then by degree.
    plan: Vec<Term>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Term {
    /// Azimuthal order, without its sign.
    m: usize,
    /// Degree of the radial polynomial in r²: (n − m)/2.
    degree: usize,
    /// Row of its values.
    row: usize,
    norm: f64,
    sine: bool,
}

impl Zernikes {
    /// The polynomials of the Noll indices `nolls` (from 1, any order) over a disc of radius
    /// `radius_m`.
    ///
    /// # Errors
    /// [`Error::Value`] for an index outside 1..=`LARGEST_NOLL` or a radius that is not positive
    /// and finite.
    pub fn new(nolls: impl IntoIterator<Item = usize>, radius_m: f64) -> Result<Self> {
        if !(radius_m.is_finite() && radius_m > 0.0) {
            return Err(Error::Value(format!("a Zernike radius of {radius_m} m is impossible: it must be positive")));
        }
        let nolls: Vec<usize> = nolls.into_iter().collect();
        let mut plan = Vec::with_capacity(nolls.len());
        for (row, &noll) in nolls.iter().enumerate() {
            let (n, signed) = noll_orders(noll)?;
            let m = signed.unsigned_abs();
            // Unit RMS over the disc; cos² and sin² average to 1/2.
            let norm = ((n + 1) as f64 * if m == 0 { 1.0 } else { 2.0 }).sqrt();
            plan.push(Term { m, degree: (n - m) / 2, row, norm, sine: signed < 0 });
        }
        plan.sort_by_key(|term| (term.m, term.degree));
        Ok(Self { nolls, radius_m, plan })
    }

    /// The Noll indices, in the order of the rows.
    pub fn nolls(&self) -> &[usize] {
        &self.nolls
    }

    /// Radius of the disc, m.
    pub fn radius_m(&self) -> f64 {
        self.radius_m
    }

    /// Values at the points (x, y), `[polynomials, points]`; unit RMS over the disc.
    ///
    /// # Errors
    /// [`Error::Shape`] where the coordinates differ in number.
    pub fn evaluate(&self, xs_m: &[f64], ys_m: &[f64]) -> Result<Array2<f64>> {
        check_lengths(xs_m, ys_m)?;
        let mut values = Array2::zeros((self.nolls.len(), xs_m.len()));
        self.fill(xs_m, ys_m, values.view_mut());
        Ok(values)
    }

    /// Writes the values into `values`, `[polynomials, points]`.
    ///
    /// Z = norm · P(2r²−1) · Re or Im (x + iy)^m, with P the Jacobi polynomial of weights (0, m):
    /// the three-term recurrence is accurate where the sum over explicit coefficients loses all
    /// digits (order 30 and higher); no angle is needed, and the centre is not a special case.
    pub(super) fn fill(&self, xs_m: &[f64], ys_m: &[f64], mut values: ArrayViewMut2<f64>) {
        // All points of a block take a step together, in vectors.
        for first in (0..xs_m.len()).step_by(BLOCK) {
            let points = first..(first + BLOCK).min(xs_m.len());
            let scaled = |m: &[f64]| m[points.clone()].iter().map(|m| m / self.radius_m).collect::<Vec<f64>>();
            self.fill_block(&scaled(xs_m), &scaled(ys_m), values.slice_mut(s![.., points.clone()]));
        }
    }

    /// [`Zernikes::fill`] for points (x, y) in units of the radius.
    fn fill_block(&self, xs: &[f64], ys: &[f64], mut values: ArrayViewMut2<f64>) {
        let ts: Vec<f64> = xs.iter().zip(ys).map(|(x, y)| 2.0 * (x * x + y * y) - 1.0).collect();
        let mut terms = self.plan.iter().peekable();
        let (mut m, mut cosines, mut sines) = (0, vec![1.0; xs.len()], vec![0.0; xs.len()]);
        let (mut befores, mut radials) = (sines.clone(), cosines.clone());
        while let Some(first) = terms.peek() {
            while m < first.m {
                for ((cosine, sine), (x, y)) in cosines.iter_mut().zip(&mut sines).zip(xs.iter().zip(ys)) {
                    (*cosine, *sine) = (*cosine * x - *sine * y, *cosine * y + *sine * x);
                }
                m += 1;
            }
            befores.fill(0.0);
            radials.fill(1.0);
            let mut degree = 0;
            while let Some(term) = terms.next_if(|term| term.m == m) {
                while degree < term.degree {
                    degree += 1;
                    next_jacobi(degree, m, &ts, &mut radials, &mut befores);
                }
                let angular = if term.sine { &sines } else { &cosines };
                for (value, (radial, angular)) in values.row_mut(term.row).iter_mut().zip(radials.iter().zip(angular)) {
                    *value = term.norm * radial * angular;
                }
            }
        }
    }
}

/// P_k of the Jacobi polynomials with weights (0, m) at `ts`, from P_{k−1} in `radials` and P_{k−2}
/// in `befores`, which become P_k and P_{k−1} (Abramowitz & Stegun 22.7.1).
fn next_jacobi(k: usize, m: usize, ts: &[f64], radials: &mut [f64], befores: &mut [f64]) {
    let (k, m) = (k as f64, m as f64);
    let sum = 2.0 * k + m;
    let last = 2.0 * (k - 1.0) * (k + m - 1.0) * sum;
    let divisor = 2.0 * k * (k + m) * (sum - 2.0);
    for (t, (radial, before)) in ts.iter().zip(radials.iter_mut().zip(befores)) {
        let next = if k == 1.0 {
            1.0 + (m + 2.0) * (t - 1.0) / 2.0
        } else {
            let linear = (sum - 1.0) * (sum * (sum - 2.0) * t - m * m);
            (linear * *radial - last * *before) / divisor
        };
        (*before, *radial) = (*radial, next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(noll: usize, x: f64, y: f64) -> f64 {
        Zernikes::new([noll], 1.0).unwrap().evaluate(&[x], &[y]).unwrap()[[0, 0]]
    }

    #[test]
    fn the_order_and_the_signs_are_nolls() {
        // Noll's table I, first 15 indices.
        let table = [
            (0, 0),
            (1, 1),
            (1, -1),
            (2, 0),
            (2, -2),
            (2, 2),
            (3, -1),
            (3, 1),
            (3, -3),
            (3, 3),
            (4, 0),
            (4, 2),
            (4, -2),
            (4, 4),
            (4, -4),
        ];
        for (i, &orders) in table.iter().enumerate() {
            assert_eq!(noll_orders(i + 1).unwrap(), orders, "Noll {}", i + 1);
        }
        assert!(noll_orders(0).is_err());
        assert!(noll_orders(LARGEST_NOLL + 1).is_err());
        assert_eq!(noll_orders(LARGEST_NOLL).unwrap().0, 60);
    }

    #[test]
    fn low_orders_are_the_textbook_polynomials_in_and_off_the_disc() {
        for (x, y) in [(0.3f64, -0.4f64), (0.0, 0.0), (-0.9, 0.8)] {
            let r2: f64 = x * x + y * y;
            let expected = [
                (2, 2.0 * x),
                (3, 2.0 * y),
                (4, 3f64.sqrt() * (2.0 * r2 - 1.0)),
                (5, 6f64.sqrt() * 2.0 * x * y),
                (6, 6f64.sqrt() * (x * x - y * y)),
                (7, 8f64.sqrt() * (3.0 * r2 - 2.0) * y),
                (11, 5f64.sqrt() * (6.0 * r2 * r2 - 6.0 * r2 + 1.0)),
                (22, 7f64.sqrt() * (20.0 * r2.powi(3) - 30.0 * r2 * r2 + 12.0 * r2 - 1.0)),
            ];
            for (noll, textbook) in expected {
                // A dozen operations on numbers up to a few tens: 1e-14, and a margin of ten.
                assert!((value(noll, x, y) - textbook).abs() < 1e-13, "Noll {noll} at ({x}, {y})");
            }
        }
    }

    #[test]
    fn high_orders_keep_their_value_on_the_rim() {
        // R(1) = 1, so Z(1, 0) is the norm for every cosine of any order: explicit coefficients of
        // order 30 alternate at 1e10 and keep six digits, the recurrence keeps all but the few of
        // its 15 to 30 steps.
        for noll in (2..=LARGEST_NOLL).step_by(2) {
            let (n, m) = noll_orders(noll).unwrap();
            let norm = ((n + 1) as f64 * if m == 0 { 1.0 } else { 2.0 }).sqrt();
            assert!((value(noll, 1.0, 0.0) / norm - 1.0).abs() < 1e-12, "Noll {noll}");
        }
    }

    #[test]
    fn the_first_500_are_orthonormal_over_the_disc() {
        // Exact integration: products of two polynomials of order ≤ 30 have angular frequency ≤ 60
        // < 64 and degree ≤ 30 in r² (odd powers occur only in pairs), and 32 Gauss-Legendre nodes
        // in r² are exact to degree 63.
        let (nodes, weights) = gauss_legendre(32);
        let (mut xs, mut ys, mut ws) = (vec![], vec![], vec![]);
        for (node, weight) in nodes.iter().zip(&weights) {
            let r = ((node + 1.0) / 2.0).sqrt();
            for k in 0..64 {
                let angle = std::f64::consts::TAU * (k as f64 + 0.25) / 64.0;
                xs.push(r * angle.cos());
                ys.push(r * angle.sin());
                ws.push(weight / 2.0 / 64.0);
            }
        }
        let z = Zernikes::new(1..=496, 1.0).unwrap().evaluate(&xs, &ys).unwrap();
        let gram = (&z * &ndarray::Array1::from(ws)).dot(&z.t());
        let error = (&gram - &Array2::<f64>::eye(496)).iter().fold(0f64, |worst, e| worst.max(e.abs()));
        // 2,048 terms of size up to 60, unit sum: rounding of 1e-13 and the nodes' own 1e-15 times
        // the slope n² ≈ 1e3.
        assert!(error < 1e-11, "worst Gram error {error:.1e}");
    }

    /// Nodes and weights on [−1, 1] by Newton's method on the Legendre recurrence.
    fn gauss_legendre(count: usize) -> (Vec<f64>, Vec<f64>) {
        let n = count as f64;
        (0..count)
            .map(|i| {
                let mut x = (std::f64::consts::PI * (i as f64 + 0.75) / (n + 0.5)).cos();
                let mut slope = 0.0;
                for _ in 0..100 {
                    let (mut before, mut p) = (1.0, x);
                    for k in 2..=count {
                        let k = k as f64;
                        (before, p) = (p, ((2.0 * k - 1.0) * x * p - (k - 1.0) * before) / k);
                    }
                    slope = n * (x * p - before) / (x * x - 1.0);
                    x -= p / slope;
                }
                (x, 2.0 / ((1.0 - x * x) * slope * slope))
            })
            .unzip()
    }
}

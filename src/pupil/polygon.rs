//! Convex polygons: clipping, area, and the closed form of their Fourier transform.

use num_complex::Complex64;
use std::f64::consts::PI;

/// A point or vector of the pupil plane, m.
pub(crate) type Point = [f64; 2];

/// A convex polygon with counter-clockwise vertices; it may be empty after clipping.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Polygon(pub(crate) Vec<Point>);

impl Polygon {
    /// The regular polygon of `sides` sides around `centre`, its first vertex in the direction
    /// `first_rad` from +x.
    pub(crate) fn regular(sides: usize, centre: Point, radius: f64, first_rad: f64) -> Self {
        let vertex = |i: usize| {
            let (sin, cos) = (2.0 * PI * i as f64 / sides as f64 + first_rad).sin_cos();
            [centre[0] + radius * cos, centre[1] + radius * sin]
        };
        Self((0..sides).map(vertex).collect())
    }

    /// Pairs of consecutive vertices, including the closing edge.
    pub(crate) fn edges(&self) -> impl Iterator<Item = (Point, Point)> + '_ {
        self.0.iter().copied().zip(self.0.iter().copied().cycle().skip(1))
    }

    /// Area, m². Computed relative to the first vertex, so that a small polygon far from the origin
    /// does not lose precision.
    pub(crate) fn area(&self) -> f64 {
        let Some(&[x0, y0]) = self.0.first() else { return 0.0 };
        self.edges().map(|(a, b)| (a[0] - x0) * (b[1] - y0) - (b[0] - x0) * (a[1] - y0)).sum::<f64>() / 2.0
    }

    /// The part where `normal·r ≥ offset` (one step of Sutherland and Hodgman, CACM 17, 32, 1974).
    pub(crate) fn clip(&self, normal: Point, offset: f64) -> Self {
        let height = |p: Point| normal[0] * p[0] + normal[1] * p[1] - offset;
        self.clip_by(height, |a, b, t| [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])])
    }

    /// The part with `low ≤ r[axis] ≤ high`. New vertices are exactly on the cut.
    pub(crate) fn clip_band(&self, axis: usize, low: f64, high: f64) -> Self {
        let cut = |at: f64| {
            move |a: Point, b: Point, t: f64| {
                let mut p = [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])];
                p[axis] = at;
                p
            }
        };
        self.clip_by(|p| p[axis] - low, cut(low)).clip_by(|p| high - p[axis], cut(high))
    }

    fn clip_by(&self, height: impl Fn(Point) -> f64, cut: impl Fn(Point, Point, f64) -> Point) -> Self {
        let mut kept = Vec::with_capacity(self.0.len() + 1);
        for (a, b) in self.edges() {
            let (ha, hb) = (height(a), height(b));
            if ha >= 0.0 {
                kept.push(a);
            }
            if ha * hb < 0.0 {
                kept.push(cut(a, b, ha / (ha - hb)));
            }
        }
        Self(kept)
    }

    /// Intersection with another convex polygon.
    pub(crate) fn intersection(&self, other: &Self) -> Self {
        other.edges().fold(self.clone(), |kept, (a, b)| {
            let normal = [a[1] - b[1], b[0] - a[0]];
            kept.clip(normal, normal[0] * a[0] + normal[1] * a[1])
        })
    }

    /// Whether the point lies inside or on the edge.
    pub(crate) fn contains(&self, p: Point) -> bool {
        self.edges().all(|(a, b)| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) >= 0.0)
    }

    /// Smallest and largest coordinate along `axis`; an empty range (∞, −∞) for an empty polygon.
    pub(crate) fn range(&self, axis: usize) -> (f64, f64) {
        self.0.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p[axis]), high.max(p[axis])))
    }

    /// Adds `sign · ∬ exp(−2πi f·(r − origin)) dA` to `spectrum[fy, fx]`, row by row of `fy`,
    /// cycles per metre.
    ///
    /// By the divergence theorem each edge from a to b contributes
    /// `i (k×e)/|k|² · e^{−ik·m} · sinc(k·e/2)`, with k = 2πf, e = b − a, m its midpoint (Lee and
    /// Mittra, IEEE Trans. Antennas Propag. 31, 99, 1983). The exponentials factor into one table
    /// per axis and edge, so that the inner loop has no transcendental function.
    pub(crate) fn add_spectrum(&self, sign: f64, origin: Point, fy: &[f64], fx: &[f64], spectrum: &mut [Complex64]) {
        let unit = |angle: f64| Complex64::new(angle.cos(), angle.sin());
        for (a, b) in self.edges() {
            let e = [b[0] - a[0], b[1] - a[1]];
            let m = [(a[0] + b[0]) / 2.0 - origin[0], (a[1] + b[1]) / 2.0 - origin[1]];
            let along_x: Vec<_> =
                fx.iter().map(|f| (2.0 * PI * f, unit(-2.0 * PI * f * m[0]), unit(PI * f * e[0]))).collect();
            for (row, f) in spectrum.chunks_exact_mut(fx.len()).zip(fy) {
                let (ky, shift_y, half_y) = (2.0 * PI * f, unit(-2.0 * PI * f * m[1]), unit(PI * f * e[1]));
                for (value, &(kx, shift_x, half_x)) in row.iter_mut().zip(&along_x) {
                    let k2 = kx * kx + ky * ky;
                    let angle = (kx * e[0] + ky * e[1]) / 2.0;
                    // Below 1e-4 the absolute rounding of the tables would dominate sin(x)/x; the
                    // error of the series is 1e-17.
                    let sinc = if angle.abs() > 1e-4 {
                        (half_x.re * half_y.im + half_x.im * half_y.re) / angle
                    } else {
                        1.0 - angle * angle / 6.0
                    };
                    // At k = 0 the value is the area, which is added below.
                    let scale = if k2 > 0.0 { sign * (kx * e[1] - ky * e[0]) / k2 * sinc } else { 0.0 };
                    *value += shift_x * shift_y * Complex64::new(0.0, scale);
                }
            }
        }
        let area = sign * self.area();
        for (row, f) in spectrum.chunks_exact_mut(fx.len()).zip(fy) {
            for (value, g) in row.iter_mut().zip(fx) {
                if *f == 0.0 && *g == 0.0 {
                    *value += area;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Polygon {
        Polygon(vec![[1.0, 2.0], [3.0, 2.0], [3.0, 3.0], [1.0, 3.0]])
    }

    #[test]
    fn clipping_keeps_the_correct_side() {
        let half = square().clip([1.0, 0.0], 2.5);
        assert_eq!(half.area(), 0.5);
        assert_eq!(square().clip_band(0, 1.5, 2.0).area(), 0.5);
        assert_eq!(square().clip([0.0, 1.0], 4.0), Polygon::default());
        assert_eq!(square().intersection(&Polygon::regular(4, [1.0, 2.0], 1.0, 0.0)).area(), 0.5);
    }

    #[test]
    fn the_spectrum_of_a_rectangle_is_a_product_of_sincs() {
        let (fx, fy) = ([0.0, 0.3, 1.7], [-0.9, 0.0, 0.4]);
        let mut spectrum = vec![Complex64::default(); 9];
        square().add_spectrum(1.0, [0.0; 2], &fy, &fx, &mut spectrum);
        let sinc = |x: f64| if x == 0.0 { 1.0 } else { (PI * x).sin() / (PI * x) };
        for (i, f) in fy.iter().enumerate() {
            for (j, g) in fx.iter().enumerate() {
                let shift = Complex64::from_polar(1.0, -2.0 * PI * (f * 2.5 + g * 2.0));
                let expected = shift * 2.0 * sinc(2.0 * g) * sinc(*f);
                // A few roundings of terms of size |e|/|k| ≤ 2.
                assert!((spectrum[3 * i + j] - expected).norm() < 1e-14, "{f} {g}: {}", spectrum[3 * i + j]);
            }
        }
    }
}

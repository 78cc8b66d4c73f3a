//! Functions to minimise whose minimum is known.

use cophase::Result;
use ndarray::{Array1, Array2};
use num_complex::Complex64;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Chained Rosenbrock: minimum 0 at (1, …, 1).
pub fn rosenbrock(x: &[f64]) -> Result<(f64, Vec<f64>)> {
    let mut f = 0.0;
    let mut g = vec![0.0; x.len()];
    for i in 0..x.len() - 1 {
        let (a, b) = (1.0 - x[i], x[i + 1] - x[i] * x[i]);
        f += a * a + 100.0 * b * b;
        g[i] += -2.0 * a - 400.0 * x[i] * b;
        g[i + 1] += 200.0 * b;
    }
    Ok((f, g))
}

/// J = |A (x − truth)|² + floor: A is `[2n, n]` and random, its columns falling from 1 to
/// 1/`condition`.
pub struct Quadratic {
    a: Array2<f64>,
    pub truth: Array1<f64>,
    /// Added to the objective, so that its rounding limits the descent.
    pub floor: f64,
}

impl Quadratic {
    pub fn new(n: usize, condition: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut a = Array2::from_shape_fn((2 * n, n), |_| rng.random_range(-1.0..1.0));
        for (k, mut column) in a.columns_mut().into_iter().enumerate() {
            column *= condition.powf(-(k as f64) / (n as f64 - 1.0).max(1.0));
        }
        let truth = Array1::from_shape_fn(n, |_| rng.random_range(-100.0..100.0));
        Quadratic { a, truth, floor: 0.0 }
    }

    pub fn gauss_newton(&self) -> Array2<f64> {
        self.a.t().dot(&self.a)
    }

    pub fn evaluate(&self, x: &[f64]) -> (f64, Vec<f64>) {
        let r = self.a.dot(&(&Array1::from(x.to_vec()) - &self.truth));
        (r.dot(&r) + self.floor, (2.0 * self.a.t().dot(&r)).to_vec())
    }

    /// The same in f32 arithmetic.
    pub fn evaluate_f32(&self, x: &[f64]) -> (f64, Vec<f64>) {
        let a = self.a.mapv(|v| v as f32);
        let d = Array1::from_iter(x.iter().zip(&self.truth).map(|(x, t)| *x as f32 - *t as f32));
        let r = a.dot(&d);
        let f = r.iter().fold(self.floor as f32, |f, r| f + r * r);
        (f.into(), a.t().dot(&r).iter().map(|g| f64::from(2.0 * g)).collect())
    }

    pub fn largest_error(&self, x: &[f64]) -> f64 {
        x.iter().zip(&self.truth).fold(0.0, |m, (x, t)| (x - t).abs().max(m))
    }
}

const GRID: usize = 16;

/// A small phase retrieval: J = Σ w (|F(A e^{i(Bc + θ)})|² − d)² over 16 × 16 pixels, F a Fourier
/// sum, B four quadrant pistons and six polynomials, θ a defocus, d with the noise of 1e5 photons,
/// w = 1/(d + read variance).
pub struct Retrieval {
    amplitude: Array2<f64>,
    modes: Vec<Array2<f64>>,
    diversity: Array2<f64>,
    kernel: Array2<Complex64>,
    data: Array2<f64>,
    weights: Array2<f64>,
}

impl Retrieval {
    pub fn new(rms_rad: f64, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let at = |i: usize| (i as f64 - 7.5) / 7.5;
        let map = |f: &dyn Fn(f64, f64) -> f64| Array2::from_shape_fn((GRID, GRID), |(i, j)| f(at(j), at(i)));
        let quadrant = |a: f64, b: f64| map(&move |x, y| f64::from(u8::from(a * x > 0.0 && b * y > 0.0)));
        let mut modes = vec![quadrant(1.0, 1.0), quadrant(-1.0, 1.0), quadrant(-1.0, -1.0), quadrant(1.0, -1.0)];
        let polynomials: [fn(f64, f64) -> f64; 6] = [
            |x, _| x,
            |_, y| y,
            |x, y| x * y,
            |x, y| x * x - y * y,
            |x, y| x * (x * x + y * y) - 0.7 * x,
            |x, y| (x * x + y * y).powi(2) - x * x - y * y,
        ];
        modes.extend(polynomials.iter().map(|p| map(p)));
        // Two samples per λ/D.
        let kernel = Array2::from_shape_fn((GRID, GRID), |(u, j)| {
            let phase = -std::f64::consts::PI * (u as f64 - 8.0) * (j as f64 - 7.5) / GRID as f64;
            Complex64::from_polar(1.0 / GRID as f64, phase)
        });
        let truth: Vec<f64> = modes.iter().map(|_| rms_rad * 1.7 * rng.random_range(-1.0..1.0)).collect();
        let mut toy = Retrieval {
            amplitude: map(&|x, y| if x * x + y * y < 1.05 { 1.0 } else { 0.0 }),
            modes,
            diversity: map(&|x, y| 2.5 * (x * x + y * y)),
            kernel,
            data: Array2::zeros((GRID, GRID)),
            weights: Array2::zeros((GRID, GRID)),
        };
        let flux = 1e5;
        let psf = toy.focus(&toy.field(&truth)).mapv(|u| u.norm_sqr());
        toy.amplitude *= (flux / psf.sum()).sqrt();
        let mean = &psf * (flux / psf.sum());
        // Photon noise, as a normal deviate from twelve uniform ones; a read noise of 3.
        toy.data = mean.mapv(|h| h + (h + 9.0).sqrt() * ((0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0));
        toy.weights = toy.data.mapv(|d| 1.0 / (d.max(0.0) + 9.0));
        toy
    }

    pub fn len(&self) -> usize {
        self.modes.len()
    }

    /// Weights from the model at `c` instead of the data.
    pub fn reweight(&mut self, c: &[f64]) {
        self.weights = self.focus(&self.field(c)).mapv(|u| 1.0 / (u.norm_sqr() + 9.0));
    }

    fn field(&self, c: &[f64]) -> Array2<Complex64> {
        let mut phase = self.diversity.clone();
        for (c, mode) in c.iter().zip(&self.modes) {
            phase.scaled_add(*c, mode);
        }
        Array2::from_shape_fn((GRID, GRID), |p| Complex64::from_polar(self.amplitude[p], phase[p]))
    }

    fn focus(&self, field: &Array2<Complex64>) -> Array2<Complex64> {
        self.kernel.dot(field).dot(&self.kernel.t())
    }

    pub fn evaluate(&self, c: &[f64]) -> (f64, Vec<f64>) {
        let field = self.field(c);
        let u = self.focus(&field);
        let r = u.mapv(|u| u.norm_sqr()) - &self.data;
        let f = (&self.weights * &r * &r).sum();
        // dJ/dφ = 4 Im(conj(E) · F†(w r u)).
        let back = Array2::from_shape_fn((GRID, GRID), |p| u[p] * (self.weights[p] * r[p]));
        let adjoint = self.kernel.t().mapv(|k| k.conj());
        let back = adjoint.dot(&back).dot(&adjoint.t());
        let phase_bar = Array2::from_shape_fn((GRID, GRID), |p| 4.0 * (field[p].conj() * back[p]).im);
        (f, self.modes.iter().map(|m| (m * &phase_bar).sum()).collect())
    }

    /// Jᵀ W J at the flat wavefront.
    pub fn gauss_newton(&self) -> Array2<f64> {
        let n = self.modes.len();
        let field = self.field(&vec![0.0; n]);
        let u = self.focus(&field);
        let jacobian: Vec<Array2<f64>> = (self.modes.iter())
            .map(|mode| {
                let moved = self.focus(&(&field * &mode.mapv(|m| Complex64::new(0.0, m))));
                Array2::from_shape_fn((GRID, GRID), |p| 2.0 * (u[p].conj() * moved[p]).re)
            })
            .collect();
        Array2::from_shape_fn((n, n), |(i, j)| (&jacobian[i] * &jacobian[j] * &self.weights).sum())
    }
}

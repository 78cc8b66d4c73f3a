//! Von Kármán turbulence on a lattice: its power spectrum, and a short recursion with that
//! spectrum.

use crate::Result;
use crate::modes::VonKarman;
use std::f64::consts::{PI, TAU};

/// Poles of a [`Process`]. With five, the spectrum has errors of at most 0.4 % for Keck with an
/// outer scale of 50 m, and of at most 1.2 % for an outer scale of 20 pupils (from a NumPy
/// prototype), the structure function of 0.1 % (from the tests). With four the spectrum's errors
/// would be 1.6 % and 4 %.
pub(super) const POLES: usize = 5;
/// Number of zeros with positive location; one more lies beyond the Nyquist frequency.
const ZEROS: usize = POLES - 2;
/// Parameters of the fit, as logarithms: scale, poles, zeros, last zero.
const UNKNOWNS: usize = 2 * POLES;

/// Power spectral density of the wavefront sampled on a square lattice of unit pitch, for a Fried
/// parameter of one pitch: the sum over all aliases of the continuous spectrum, nm² per (cycle per
/// sample)².
///
/// Samples with this spectrum have exactly the covariance of the continuous wavefront at
/// whole-sample separations.
pub(super) struct Lattice {
    /// Continuous spectrum: scale·(f² + corner2)^(−11/6), f in cycles per sample.
    scale: f64,
    corner2: f64,
    /// Sum of the far aliases: far + far2·f².
    far: f64,
    far2: f64,
}

const EXPONENT: f64 = 11.0 / 6.0;

impl Lattice {
    /// Spectrum for an outer scale in samples.
    pub(super) fn new(outer_scale: f64) -> Result<Self> {
        let corner2 = outer_scale.powi(-2);
        let scale = VonKarman::new(1.0, outer_scale)?.psd_nm2_m2(0.0) * corner2.powf(EXPONENT);
        let (mut far, mut far2) = (0.0, 0.0);
        // Beyond this radius a sum over the lattice and an integral over the plane agree to 1e-5.
        const RADIUS: i32 = 30;
        for a in -RADIUS..=RADIUS {
            for b in -RADIUS..=RADIUS {
                let n2 = f64::from(a * a + b * b);
                if a.abs().max(b.abs()) > 1 && n2 <= f64::from(RADIUS * RADIUS) {
                    // g = (n² + c)^(−s); averaged over the lattice's symmetry, g(n + f) = g(n) +
                    // f²/4·∇²g + O(f⁴).
                    let base = n2 + corner2;
                    let g = base.powf(-EXPONENT);
                    far += g;
                    far2 += EXPONENT * g / base * ((EXPONENT + 1.0) * n2 / base - 1.0);
                }
            }
        }
        let tail = EXPONENT - 1.0;
        far += PI / tail * (f64::from(RADIUS * RADIUS) + corner2).powf(-tail);
        Ok(Self { scale, corner2, far: scale * far, far2: scale * far2 })
    }

    /// Spectrum at the angular frequencies `along` and `across`, radians per sample within ±π.
    pub(super) fn at(&self, along: f64, across: f64) -> f64 {
        let (u, v) = (along / TAU, across / TAU);
        let mut near = 0.0;
        for a in [-1.0, 0.0, 1.0] {
            for b in [-1.0, 0.0, 1.0] {
                near += ((u + a).powi(2) + (v + b).powi(2) + self.corner2).powf(-EXPONENT);
            }
        }
        self.scale * near + self.far + self.far2 * (u * u + v * v)
    }

    /// Corner frequency of the spectrum along, radians per sample.
    fn corner(&self, across: f64) -> f64 {
        (TAU * TAU * self.corner2 + across * across).sqrt()
    }
}

/// Stationary Gaussian process: a sum of first-order recursions driven by the same unit white noise
/// w, s_i(t) = pole_i·s_i(t−1) + gain_i·w(t), y = Σ s_i.
///
/// The spectrum along a ribbon at one frequency across is close to (k² + κ²)^(−11/6), which no
/// finite recursion reproduces exactly. It is fitted by a ratio of polynomials in u = 4 sin²(k/2),
/// C·(4 + b − u)·Π(u + z_j)/Π(u + p_i), all terms positive; the fit minimises the error of ln S on
/// a logarithmic range of k from below κ to π. An error of ln S of at most ε implies a relative
/// error of at most ε of every structure function, which is an integral over S with the positive
/// weight 2(1 − cos kr). (An autoregressive fit to the first lags would underestimate the low
/// frequencies.) Every factor is
/// |1 − c·e^(−ik)|² up to scale.
#[derive(Debug, Clone, Copy)]
pub(super) struct Process {
    pub(super) poles: [f64; POLES],
    pub(super) gains: [f64; POLES],
}

/// Frequencies of the fit.
const POINTS: usize = 40;
/// Error of ln S at which the fit stops: far below the largest error at the lowest frequencies.
const CLOSE_ENOUGH: f64 = 5e-4;
/// Ridge penalty on the distance from the start: keeps parameters that the data do not determine
/// (of a flat spectrum) there, and so the poles distinct.
const RIDGE: f64 = 1e-5;

/// Target spectrum and start of the fit.
struct Target {
    u: [f64; POINTS],
    log_s: [f64; POINTS],
    start: [f64; UNKNOWNS],
}

impl Process {
    /// Fits the process along the ribbon at the angular frequency `across` it, radians per sample.
    pub(super) fn fit(lattice: &Lattice, across: f64) -> Self {
        let target = Target::new(lattice, across);
        let mut at = target.start;
        let mut damping = 1e-2;
        let (mut cost, mut residuals) = target.cost(&at);
        // Levenberg-Marquardt; 5 to 30 steps.
        for _ in 0..60 {
            if residuals.iter().all(|r| r.abs() < CLOSE_ENOUGH) || damping > 1e6 {
                break;
            }
            let next = target.step(&at, &residuals, damping);
            let (next_cost, next_residuals) = target.cost(&next);
            if next_cost < cost {
                let done = cost - next_cost < 1e-3 * cost;
                (at, cost, residuals) = (next, next_cost, next_residuals);
                damping = (damping / 5.0).max(1e-9);
                if done {
                    break;
                }
            } else {
                damping *= 4.0;
            }
        }
        Self::from_parameters(&at)
    }

    /// Process of fitted parameters: partial fractions of the product.
    fn from_parameters(at: &[f64; UNKNOWNS]) -> Self {
        // c + 1/c − 2 = x: then u + x = |1 − c·e^(−ik)|²/c.
        let root = |log_x: &f64| {
            let x = log_x.exp();
            2.0 / (2.0 + x + (x * x + 4.0 * x).sqrt())
        };
        let poles: [f64; POLES] = std::array::from_fn(|i| root(&at[1 + i]));
        let mut zeros: [f64; ZEROS + 1] = std::array::from_fn(|j| root(&at[1 + POLES + j]));
        let scale = at[0].exp() * poles.iter().product::<f64>() / zeros.iter().product::<f64>();
        zeros[ZEROS] *= -1.0;
        let gains = std::array::from_fn(|i| {
            let above: f64 = zeros.iter().map(|z| 1.0 - z / poles[i]).product();
            let below: f64 = (0..POLES).filter(|&j| j != i).map(|j| 1.0 - poles[j] / poles[i]).product();
            scale.sqrt() * above / below
        });
        Self { poles, gains }
    }

    /// Lower Cholesky factor of the states' stationary covariance, gain_i·gain_j/(1 −
    /// pole_i·pole_j).
    pub(super) fn stationary(&self) -> [[f64; POLES]; POLES] {
        let entry = |i: usize, j: usize| self.gains[i] * self.gains[j] / (1.0 - self.poles[i] * self.poles[j]);
        cholesky(std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j))))
    }

    /// Covariance of y at two times `lag` apart.
    #[cfg(test)]
    pub(super) fn covariance(&self, lag: i32) -> f64 {
        let mut sum = 0.0;
        for (pole, gain) in self.poles.iter().zip(self.gains) {
            let others: f64 = self.poles.iter().zip(self.gains).map(|(p, g)| g / (1.0 - p * pole)).sum();
            sum += gain * pole.powi(lag) * others;
        }
        sum
    }
}

impl Target {
    fn new(lattice: &Lattice, across: f64) -> Self {
        let corner = lattice.corner(across);
        let first = (0.1 * corner).min(0.1).ln();
        let along = |i: usize| (first + (PI.ln() - first) * i as f64 / (POINTS - 1) as f64).exp();
        let u = std::array::from_fn(|i| 4.0 * (along(i) / 2.0).sin().powi(2));
        let log_s = std::array::from_fn(|i| lattice.at(along(i), across).ln());
        let mut target = Self { u, log_s, start: initial_guess(corner) };
        let (_, residuals) = target.cost(&target.start);
        target.start[0] = -residuals.iter().sum::<f64>() / POINTS as f64;
        target
    }

    /// Computes the sum of squared residuals with the ridge, and the residual of ln S at each
    /// frequency.
    fn cost(&self, at: &[f64; UNKNOWNS]) -> (f64, [f64; POINTS]) {
        let x: [f64; UNKNOWNS] = at.map(f64::exp);
        let residuals: [f64; POINTS] = std::array::from_fn(|k| {
            let u = self.u[k];
            let above: f64 = x[1 + POLES..UNKNOWNS - 1].iter().map(|z| u + z).product();
            let below: f64 = x[1..1 + POLES].iter().map(|p| u + p).product();
            at[0] + ((4.0 + x[UNKNOWNS - 1] - u) * above / below).ln() - self.log_s[k]
        });
        let ridge: f64 = (1..UNKNOWNS).map(|i| (at[i] - self.start[i]).powi(2)).sum();
        (residuals.iter().map(|r| r * r).sum::<f64>() + RIDGE * ridge, residuals)
    }

    /// Takes a damped Gauss-Newton step, at most a factor e in any parameter.
    fn step(&self, at: &[f64; UNKNOWNS], residuals: &[f64; POINTS], damping: f64) -> [f64; UNKNOWNS] {
        let x: [f64; UNKNOWNS] = at.map(f64::exp);
        let mut matrix = [[0.0; UNKNOWNS]; UNKNOWNS];
        let mut slope = [0.0; UNKNOWNS];
        for (&u, &residual) in self.u.iter().zip(residuals) {
            let row: [f64; UNKNOWNS] = std::array::from_fn(|i| match i {
                0 => 1.0,
                _ if i <= POLES => -x[i] / (u + x[i]),
                _ if i < UNKNOWNS - 1 => x[i] / (u + x[i]),
                _ => x[i] / (4.0 + x[i] - u),
            });
            for i in 0..UNKNOWNS {
                slope[i] += row[i] * residual;
                for j in 0..UNKNOWNS {
                    matrix[i][j] += row[i] * row[j];
                }
            }
        }
        for i in 0..UNKNOWNS {
            if i > 0 {
                matrix[i][i] += RIDGE;
                slope[i] += RIDGE * (at[i] - self.start[i]);
            }
            matrix[i][i] *= 1.0 + damping;
        }
        let step = solve(&cholesky(matrix), slope);
        std::array::from_fn(|i| at[i] - step[i].clamp(-1.0, 1.0))
    }
}

/// Start of the fit: (u + κ²)^(−11/6) = (u + κ²)^(−2)·(u + κ²)^(1/6) is two poles at the corner,
/// then pairs of a zero and a pole a sixth of their spacing apart. For a nearly flat spectrum
/// (κ > 2) the corner is 2.
fn initial_guess(corner: f64) -> [f64; UNKNOWNS] {
    let low = (corner * corner).min(4.0).ln();
    let spacing = ((10f64.ln() - low) / ZEROS as f64).max(0.5);
    let zero = |j: usize| low + spacing * (j as f64 + 0.6);
    std::array::from_fn(|i| match i {
        0 => 0.0,
        1 => low - 0.1,
        2 => low + 0.2,
        _ if i <= POLES => zero(i - 3) + spacing / 6.0,
        _ if i < UNKNOWNS - 1 => zero(i - 1 - POLES),
        _ => 4f64.ln(),
    })
}

/// Lower Cholesky factor of a matrix that is positive semi-definite up to rounding; a pivot at the
/// level of rounding is taken as 0.
fn cholesky<const N: usize>(mut a: [[f64; N]; N]) -> [[f64; N]; N] {
    for j in 0..N {
        let diagonal = a[j][j];
        let pivot = diagonal - a[j][..j].iter().map(|x| x * x).sum::<f64>();
        let pivot = if pivot > 1e-15 * diagonal { pivot.sqrt() } else { 0.0 };
        a[j][j] = pivot;
        for i in j + 1..N {
            let dot: f64 = (0..j).map(|k| a[i][k] * a[j][k]).sum();
            a[i][j] = if pivot > 0.0 { (a[i][j] - dot) / pivot } else { 0.0 };
        }
        a[j][j + 1..].fill(0.0);
    }
    a
}

/// Solves L·Lᵀ·x = b; a zero pivot gives a zero component.
fn solve<const N: usize>(l: &[[f64; N]; N], mut b: [f64; N]) -> [f64; N] {
    let divide = |x: f64, pivot: f64| if pivot > 0.0 { x / pivot } else { 0.0 };
    for i in 0..N {
        let dot: f64 = (0..i).map(|k| l[i][k] * b[k]).sum();
        b[i] = divide(b[i] - dot, l[i][i]);
    }
    for i in (0..N).rev() {
        let dot: f64 = (i + 1..N).map(|k| l[k][i] * b[k]).sum();
        b[i] = divide(b[i] - dot, l[i][i]);
    }
    b
}

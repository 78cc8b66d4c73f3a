//! The transform as products with real matrices, folded about the axis.
//!
//! Along one axis, with `x_j = j + ½` for the upper half of the samples and the field split into
//! its even and odd parts `e_j = E(x_j) + E(−x_j)`, `o_j = E(x_j) − E(−x_j)`:
//!
//! `U(±u) = C_u ∓ i·S_u`,  `C_u = Σ_j cos(2π·step·u·x_j)·e_j`,  `S_u = Σ_j sin(2π·step·u·x_j)·o_j`,
//! u = 0 … m/2,
//!
//! which takes a quarter of the operations of a complex matrix product. The adjoint folds the
//! pixels instead (`P_u = G(u) + G(−u)`, `Q_u = G(u) − G(−u)`) and runs through the same matrices
//! transposed. Pixel −m/2 has no partner: folding treats pixel +m/2 as zero, and unfolding drops
//! it.

use super::product::{Factors, panel_len};
use super::real::Real;
use super::sampling::Sampling;
use super::workspace::Workspace;

/// Folded matrix transform of one sampling. Tables are shared by all threads; each thread has its
/// own [`Workspace`].
#[derive(Clone)]
pub struct MatrixTransform<T: Real> {
    sampling: Sampling,
    /// cos(2π·step·u·x_j), row-major [u = 0..=m/2][j = 0..n/2].
    cos: Vec<T>,
    /// sin(2π·step·u·x_j), in the same order.
    sin: Vec<T>,
    /// cos, row-major [j][u].
    cos_across: Vec<T>,
    /// sin, row-major [j][u].
    sin_across: Vec<T>,
}

impl<T: Real> MatrixTransform<T> {
    /// Tables of n/2 × (m/2 + 1) cosines and sines, in both orders.
    pub fn new(sampling: Sampling) -> Self {
        let (half, harmonics) = (sampling.samples / 2, sampling.pixels / 2 + 1);
        let angle = |u: usize, j: usize| {
            // Reduced to one turn before it becomes an angle, so that high harmonics keep full
            // precision.
            let turns = sampling.step() * u as f64 * (j as f64 + 0.5);
            std::f64::consts::TAU * (turns - turns.round())
        };
        let table = |f: fn(f64) -> f64| {
            (0..harmonics).flat_map(|u| (0..half).map(move |j| T::narrow(f(angle(u, j))))).collect::<Vec<T>>()
        };
        let (cos, sin) = (table(f64::cos), table(f64::sin));
        let across = |table: &[T]| (0..half).flat_map(|j| (0..harmonics).map(move |u| table[u * half + j])).collect();
        Self { sampling, cos_across: across(&cos), sin_across: across(&sin), cos, sin }
    }

    pub(super) fn workspace(&self) -> Workspace<T> {
        Workspace { real: vec![T::default(); self.sizes().iter().sum()], complex: Vec::new() }
    }

    /// Sizes of the scratch areas: folded even, folded odd (each large enough for either axis and
    /// direction), the half-transformed field; the two products, and the panel used to compute
    /// them.
    fn sizes(&self) -> [usize; 6] {
        let (n, m) = (self.sampling.samples, self.sampling.pixels);
        let (half, harmonics) = (n / 2, m / 2 + 1);
        let folded = (2 * n * half).max(2 * m * half).max(2 * m * harmonics).max(2 * n * harmonics);
        [folded, folded, 2 * n * m, folded, folded, panel_len(half.max(harmonics))]
    }

    #[inline(always)]
    pub(super) fn forward(&self, pupil: &[T], focus: &mut [T], workspace: &mut Workspace<T>) {
        let (n, m) = (self.sampling.samples, self.sampling.pixels);
        let (half, harmonics) = (n / 2, m / 2 + 1);
        let [even, odd, middle, c, s, panel] = areas(&mut workspace.real, self.sizes());
        // Along y: rows of 2n (real parts, imaginary parts) are folded in pairs.
        fold_rows(pupil, even, odd, 2 * n, half);
        product((harmonics, half, 2 * n), &self.cos, even, c, panel);
        product((harmonics, half, 2 * n), &self.sin, odd, s, panel);
        unfold_rows(c, s, middle, n, m);
        // Along x: 2m rows (real parts and imaginary parts of each pixel row) of n are folded end
        // to end.
        fold_columns(middle, even, odd, 2 * m, n);
        product((2 * m, half, harmonics), even, &self.cos_across, c, panel);
        product((2 * m, half, harmonics), odd, &self.sin_across, s, panel);
        unfold_columns(c, s, focus, m);
    }

    #[inline(always)]
    pub(super) fn adjoint(&self, focus: &[T], pupil: &mut [T], workspace: &mut Workspace<T>) {
        let (n, m) = (self.sampling.samples, self.sampling.pixels);
        let (half, harmonics) = (n / 2, m / 2 + 1);
        let [even, odd, middle, c, s, panel] = areas(&mut workspace.real, self.sizes());
        unfold_columns_adjoint(focus, even, odd, m);
        product((2 * m, harmonics, half), even, &self.cos, c, panel);
        product((2 * m, harmonics, half), odd, &self.sin, s, panel);
        fold_columns_adjoint(c, s, middle, m, n);
        unfold_rows_adjoint(middle, even, odd, n, m);
        product((half, harmonics, 2 * n), &self.cos_across, even, c, panel);
        product((half, harmonics, 2 * n), &self.sin_across, odd, s, panel);
        fold_rows_adjoint(c, s, pupil, n);
    }
}

fn areas<T>(memory: &mut [T], sizes: [usize; 6]) -> [&mut [T]; 6] {
    let mut rest = memory;
    sizes.map(|size| {
        let (area, tail) = std::mem::take(&mut rest).split_at_mut(size);
        rest = tail;
        area
    })
}

/// `out[rows × cols] = left[rows × depth] · right[depth × cols]`, all row-major.
#[inline(always)]
fn product<T: Real>(
    (rows, depth, cols): (usize, usize, usize),
    left: &[T],
    right: &[T],
    out: &mut [T],
    panel: &mut [T],
) {
    let (left, right) = (&left[..rows * depth], &right[..depth * cols]);
    T::product(&Factors { left, right, rows, depth, cols }, &mut out[..rows * cols], panel);
}

/// even[j] = row(n/2 + j) + row(n/2 − 1 − j), odd[j] = their difference.
#[inline(always)]
fn fold_rows<T: Real>(rows: &[T], even: &mut [T], odd: &mut [T], width: usize, half: usize) {
    for j in 0..half {
        let upper = &rows[(half + j) * width..][..width];
        let lower = &rows[(half - 1 - j) * width..][..width];
        let even = &mut even[j * width..][..width];
        let odd = &mut odd[j * width..][..width];
        for x in 0..width {
            even[x] = upper[x] + lower[x];
            odd[x] = upper[x] - lower[x];
        }
    }
}

/// field(±x_j) = C_j ± i·S_j, the adjoint of [`fold_rows`] with the factor i of the sine part.
#[inline(always)]
fn fold_rows_adjoint<T: Real>(c: &[T], s: &[T], rows: &mut [T], n: usize) {
    let half = n / 2;
    for j in 0..half {
        let (c, s) = (&c[2 * n * j..][..2 * n], &s[2 * n * j..][..2 * n]);
        let (lower, upper) = rows.split_at_mut(2 * n * half);
        let upper = &mut upper[2 * n * j..][..2 * n];
        let lower = &mut lower[2 * n * (half - 1 - j)..][..2 * n];
        for x in 0..n {
            upper[x] = c[x] - s[n + x];
            upper[n + x] = c[n + x] + s[x];
            lower[x] = c[x] + s[n + x];
            lower[n + x] = c[n + x] - s[x];
        }
    }
}

/// T(±v) = C_v ∓ i·S_v into pixel rows m/2 ± v of width n.
#[inline(always)]
fn unfold_rows<T: Real>(c: &[T], s: &[T], rows: &mut [T], n: usize, m: usize) {
    for v in 0..=m / 2 {
        let (c, s) = (&c[2 * n * v..][..2 * n], &s[2 * n * v..][..2 * n]);
        if v < m / 2 {
            let plus = &mut rows[2 * n * (m / 2 + v)..][..2 * n];
            for x in 0..n {
                plus[x] = c[x] + s[n + x];
                plus[n + x] = c[n + x] - s[x];
            }
        }
        if v > 0 {
            let minus = &mut rows[2 * n * (m / 2 - v)..][..2 * n];
            for x in 0..n {
                minus[x] = c[x] - s[n + x];
                minus[n + x] = c[n + x] + s[x];
            }
        }
    }
}

/// P_v = T(v) + T(−v), Q_v = T(v) − T(−v); for a row without a partner, P and Q are that row alone.
#[inline(always)]
fn unfold_rows_adjoint<T: Real>(rows: &[T], even: &mut [T], odd: &mut [T], n: usize, m: usize) {
    let width = 2 * n;
    for v in 0..=m / 2 {
        let (even, odd) = (&mut even[width * v..][..width], &mut odd[width * v..][..width]);
        let minus = &rows[width * (m / 2 - v)..][..width];
        if v == 0 {
            even.copy_from_slice(minus);
            odd.fill(T::zero());
        } else if v == m / 2 {
            even.copy_from_slice(minus);
            odd.iter_mut().zip(minus).for_each(|(o, &g)| *o = -g);
        } else {
            let plus = &rows[width * (m / 2 + v)..][..width];
            for x in 0..width {
                even[x] = plus[x] + minus[x];
                odd[x] = plus[x] - minus[x];
            }
        }
    }
}

/// Each of `count` rows of n folded end to end into n/2 even and odd parts.
#[inline(always)]
fn fold_columns<T: Real>(rows: &[T], even: &mut [T], odd: &mut [T], count: usize, n: usize) {
    let half = n / 2;
    for r in 0..count {
        let (lower, upper) = rows[r * n..][..n].split_at(half);
        let (even, odd) = (&mut even[r * half..][..half], &mut odd[r * half..][..half]);
        for j in 0..half {
            even[j] = upper[j] + lower[half - 1 - j];
            odd[j] = upper[j] - lower[half - 1 - j];
        }
    }
}

/// field(±x_j) = C_j ± i·S_j along the rows, the adjoint of [`fold_columns`] with the factor i of
/// the sine part.
#[inline(always)]
fn fold_columns_adjoint<T: Real>(c: &[T], s: &[T], rows: &mut [T], m: usize, n: usize) {
    let half = n / 2;
    for v in 0..m {
        let (c_re, c_im) = c[2 * v * half..][..2 * half].split_at(half);
        let (s_re, s_im) = s[2 * v * half..][..2 * half].split_at(half);
        let (re, im) = rows[2 * v * n..][..2 * n].split_at_mut(n);
        for j in 0..half {
            re[half + j] = c_re[j] - s_im[j];
            im[half + j] = c_im[j] + s_re[j];
            re[half - 1 - j] = c_re[j] + s_im[j];
            im[half - 1 - j] = c_im[j] - s_re[j];
        }
    }
}

/// U(±u) = C_u ∓ i·S_u along the rows of the image.
#[inline(always)]
fn unfold_columns<T: Real>(c: &[T], s: &[T], focus: &mut [T], m: usize) {
    let harmonics = m / 2 + 1;
    for v in 0..m {
        let (c_re, c_im) = c[2 * v * harmonics..][..2 * harmonics].split_at(harmonics);
        let (s_re, s_im) = s[2 * v * harmonics..][..2 * harmonics].split_at(harmonics);
        let (re, im) = focus[2 * v * m..][..2 * m].split_at_mut(m);
        for u in 0..m / 2 {
            re[m / 2 + u] = c_re[u] + s_im[u];
            im[m / 2 + u] = c_im[u] - s_re[u];
        }
        for u in 1..harmonics {
            re[m / 2 - u] = c_re[u] - s_im[u];
            im[m / 2 - u] = c_im[u] + s_re[u];
        }
    }
}

/// P_u = G(u) + G(−u), Q_u = G(u) − G(−u) along the rows of the image; for a pixel without a
/// partner, P and Q are that pixel alone.
#[inline(always)]
fn unfold_columns_adjoint<T: Real>(focus: &[T], even: &mut [T], odd: &mut [T], m: usize) {
    let harmonics = m / 2 + 1;
    for r in 0..2 * m {
        let row = &focus[r * m..][..m];
        let (even, odd) = (&mut even[r * harmonics..][..harmonics], &mut odd[r * harmonics..][..harmonics]);
        even[0] = row[m / 2];
        odd[0] = T::zero();
        for u in 1..m / 2 {
            even[u] = row[m / 2 + u] + row[m / 2 - u];
            odd[u] = row[m / 2 + u] - row[m / 2 - u];
        }
        even[m / 2] = row[0];
        odd[m / 2] = -row[0];
    }
}

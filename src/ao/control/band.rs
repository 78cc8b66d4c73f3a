//! Symmetric band matrix, its factorisation `A = L·D·Lᵀ` in double precision, and the solution with
//! the factors in single precision.
//!
//! With b numbers below the diagonal and n unknowns, a solution reads 8·n·b bytes, where an inverse
//! has 4·n². It has an order of additions that does not depend on the length of the processor's
//! vectors.

use crate::ao::aligned::AlignedBuffer;
use crate::ao::footprint::LANES;
use pulp::{Arch, Simd, WithSimd};

/// Lower half of a symmetric band matrix.
#[derive(Debug, Clone)]
pub(super) struct SymmetricBand {
    size: usize,
    width: usize,
    /// `[column][diagonal, then `width` numbers below it]`.
    columns: Vec<f64>,
}

impl SymmetricBand {
    /// Zeros: `size` columns with `width` numbers below the diagonal.
    pub(super) fn zeros(size: usize, width: usize) -> Self {
        Self { size, width, columns: vec![0.0; size * (width + 1)] }
    }

    /// Numbers below the diagonal.
    pub(super) fn width(&self) -> usize {
        self.width
    }

    /// Adds to the entry at `row`, `column`, which is not above the diagonal and within the band.
    pub(super) fn add(&mut self, row: usize, column: usize, value: f64) {
        self.columns[column * (self.width + 1) + row - column] += value;
    }

    /// The diagonal and the numbers below it in a column.
    pub(super) fn column(&self, column: usize) -> &[f64] {
        let below = self.width.min(self.size - 1 - column);
        &self.columns[column * (self.width + 1)..][..=below]
    }

    /// Sum of the magnitudes of the entries of each row farther than `width` from the diagonal, the
    /// largest of all rows.
    pub(super) fn largest_rest(&self, width: usize) -> f64 {
        let mut sums = vec![0.0f64; self.size];
        for column in 0..self.size {
            for (below, value) in self.column(column).iter().enumerate().skip(width + 1) {
                sums[column] += value.abs();
                sums[column + below] += value.abs();
            }
        }
        sums.into_iter().fold(0.0, f64::max)
    }

    /// The same matrix without the entries farther than `width` from the diagonal.
    pub(super) fn narrowed(&self, width: usize) -> Self {
        let mut band = Self::zeros(self.size, width.min(self.width));
        for (column, out) in band.columns.chunks_exact_mut(band.width + 1).enumerate() {
            let from = self.column(column);
            let kept = from.len().min(out.len());
            out[..kept].copy_from_slice(&from[..kept]);
        }
        band
    }

    /// Product with a vector.
    pub(super) fn product(&self, vector: &[f64]) -> Vec<f64> {
        let mut out = vec![0.0; self.size];
        for column in 0..self.size {
            for (below, value) in self.column(column).iter().enumerate() {
                out[column + below] += value * vector[column];
                if below > 0 {
                    out[column] += value * vector[column + below];
                }
            }
        }
        out
    }

    /// Largest eigenvalue of a positive semidefinite matrix, by the power method: within a per cent
    /// from below.
    pub(super) fn largest_eigenvalue(&self) -> f64 {
        // No eigenvector of a mirror is orthogonal to this one.
        let mut vector: Vec<f64> = (0..self.size).map(|i| (1.0 + i as f64 * i as f64 * 0.37).sin()).collect();
        let mut value = 0.0;
        // The error of the Rayleigh quotient after m steps is below ln(n)/2m.
        for _ in 0..400 {
            let length = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
            if length == 0.0 {
                break;
            }
            vector.iter_mut().for_each(|x| *x /= length);
            let next = self.product(&vector);
            value = vector.iter().zip(&next).map(|(a, b)| a * b).sum();
            vector = next;
        }
        value
    }

    /// Replaces the matrix by its factors: D on the diagonal, L below. Without pivoting, which a
    /// positive definite matrix does not need. The signs of D are those of the eigenvalues
    /// (Sylvester's law of inertia).
    pub(super) fn factorise(&mut self) {
        let stride = self.width + 1;
        for column in 0..self.size {
            let below = self.column(column).len() - 1;
            let (own, rest) = self.columns[column * stride..].split_at_mut(stride);
            let pivot = own[0];
            for k in 1..=below {
                let factor = own[k] / pivot;
                let target = &mut rest[(k - 1) * stride..][..=below - k];
                for (out, value) in target.iter_mut().zip(&own[k..=below]) {
                    *out -= factor * value;
                }
            }
            own[1..=below].iter_mut().for_each(|value| *value /= pivot);
        }
    }

    /// Solution of `A·x = right` with the factors of [`SymmetricBand::factorise`].
    pub(super) fn solution(&self, right: &[f64]) -> Vec<f64> {
        let mut x = right.to_vec();
        for column in 0..self.size {
            for (below, value) in self.column(column).iter().enumerate().skip(1) {
                x[column + below] -= value * x[column];
            }
        }
        for column in (0..self.size).rev() {
            let own = self.column(column);
            let sum: f64 = own[1..].iter().zip(&x[column + 1..]).map(|(value, x)| value * x).sum();
            x[column] = x[column] / own[0] - sum;
        }
        x
    }

    /// Diagonal.
    pub(super) fn diagonal(&self) -> impl Iterator<Item = f64> + '_ {
        self.columns.chunks_exact(self.width + 1).map(|column| column[0])
    }
}

/// Factors of a symmetric band matrix in single precision, in panels of [`LANES`] columns.
///
/// A panel has a square on the diagonal, of which the inverse is stored, and `depth` rows below it,
/// stored twice: column by column of each [`LANES`] rows for the forward pass, row by row for the
/// backward pass. Every number is then part of a vector that is multiplied by one number of the
/// other operand, and no vector of the solution straddles two that were just written, which a
/// processor would wait for (a column at a time takes six times as long).
#[derive(Debug)]
pub(super) struct BandSolver {
    /// Rows below the square of a panel, a multiple of [`LANES`].
    depth: usize,
    /// Inverse of each square, `[column][row]`, and its transpose.
    inverse: [AlignedBuffer; 2],
    /// Rows below each square, `[LANES rows][column][row]`.
    forward: AlignedBuffer,
    /// The same, `[row][column]`.
    backward: AlignedBuffer,
    inverse_diagonal: AlignedBuffer,
}

/// Numbers of a square of a panel.
const SQUARE: usize = LANES * LANES;

impl BandSolver {
    /// Solver with the factors of [`SymmetricBand::factorise`].
    pub(super) fn new(factors: &SymmetricBand) -> Self {
        let (panels, depth) = (factors.size.div_ceil(LANES), factors.width.next_multiple_of(LANES));
        let at = |row: usize, column: usize| {
            let is_inside = column < factors.size && row > column && row - column < factors.column(column).len();
            if is_inside { factors.column(column)[row - column] } else { 0.0 }
        };
        let [mut inverse, mut transposed] = [0, 1].map(|_| AlignedBuffer::zeros(panels * SQUARE));
        let [mut forward, mut backward] = [0, 1].map(|_| AlignedBuffer::zeros(panels * depth * LANES));
        for panel in 0..panels {
            let first = panel * LANES;
            let square = inverse_of_square(|row, column| at(first + row, first + column));
            for (row, values) in square.iter().enumerate() {
                for (column, &value) in values.iter().enumerate() {
                    inverse[panel * SQUARE + column * LANES + row] = value as f32;
                    transposed[panel * SQUARE + row * LANES + column] = value as f32;
                }
            }
            for row in 0..depth {
                for column in 0..LANES {
                    let value = at(first + LANES + row, first + column) as f32;
                    let group = panel * depth + row / LANES * LANES;
                    forward[(group + column) * LANES + row % LANES] = value;
                    backward[(panel * depth + row) * LANES + column] = value;
                }
            }
        }
        let mut inverse_diagonal = AlignedBuffer::zeros(panels * LANES);
        inverse_diagonal.iter_mut().zip(factors.diagonal()).for_each(|(out, pivot)| *out = (1.0 / pivot) as f32);
        Self { depth, inverse: [inverse, transposed], forward, backward, inverse_diagonal }
    }

    /// Length of the vector of [`BandSolver::solve`]: the unknowns, and zeros behind them.
    pub(super) fn length(&self) -> usize {
        self.inverse_diagonal.len() + self.depth
    }

    /// Bytes that a solution reads.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.forward[..]) + size_of_val(&self.backward[..]) + 2 * size_of_val(&self.inverse[0][..])
    }

    /// Solves `A·x = vector` in place. What lies behind the unknowns is 0 before and after.
    pub(super) fn solve(&self, vector: &mut [f32]) {
        Arch::new().dispatch(Solve { solver: self, vector });
    }
}

/// Inverse of a lower triangular matrix with ones on its diagonal, `[row][column]`, by forward
/// substitution.
fn inverse_of_square(at: impl Fn(usize, usize) -> f64) -> [[f64; LANES]; LANES] {
    let columns: [[f64; LANES]; LANES] = std::array::from_fn(|column| {
        let mut solution = [0.0; LANES];
        solution[column] = 1.0;
        for row in column + 1..LANES {
            solution[row] = -(column..row).map(|k| at(row, k) * solution[k]).sum::<f64>();
        }
        solution
    });
    std::array::from_fn(|row| std::array::from_fn(|column| columns[column][row]))
}

/// Kernel of [`BandSolver::solve`].
struct Solve<'a> {
    solver: &'a BandSolver,
    vector: &'a mut [f32],
}

impl WithSimd for Solve<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { solver, vector } = self;
        // Vectors of a number of LANES rows, of a square, and of the rows below it.
        let pieces = LANES / S::F32_LANES;
        let (square, below) = (LANES * pieces, solver.depth * pieces);
        let [inverse, transposed] = solver.inverse.each_ref().map(|inverse| S::as_simd_f32s(inverse).0);
        let (forward, backward) = (S::as_simd_f32s(&solver.forward).0, S::as_simd_f32s(&solver.backward).0);
        let inverse_diagonal = S::as_simd_f32s(&solver.inverse_diagonal).0;
        let panels = solver.inverse_diagonal.len() / LANES;
        for panel in 0..panels {
            let (own, rest) = vector[panel * LANES..].split_at_mut(LANES);
            let Some(own) = own.first_chunk_mut::<LANES>() else { return };
            *own = product(simd, &inverse[panel * square..][..square], own);
            let rest = S::as_mut_simd_f32s(rest).0.chunks_exact_mut(pieces);
            for (rest, lower) in rest.zip(forward[panel * below..][..below].chunks_exact(square)) {
                for (piece, rest) in rest.iter_mut().enumerate() {
                    let mut sum = *rest;
                    for column in 0..LANES {
                        let own = simd.splat_f32s(-own[column]);
                        sum = simd.mul_add_f32s(lower[column * pieces + piece], own, sum);
                    }
                    *rest = sum;
                }
            }
        }
        for panel in (0..panels).rev() {
            let (own, rest) = vector[panel * LANES..].split_at_mut(LANES);
            let Some(own) = own.first_chunk_mut::<LANES>() else { return };
            let rest = rest.as_chunks::<LANES>().0;
            let lower = &backward[panel * below..][..below];
            let mut scaled = [0.0f32; LANES];
            let vectors = S::as_mut_simd_f32s(&mut scaled[..]).0.iter_mut().zip(S::as_simd_f32s(&own[..]).0);
            for (piece, (scaled, own)) in vectors.enumerate() {
                // Four sums hide the latency of the additions.
                let mut sums = [simd.splat_f32s(0.0); 4];
                for (rest, lower) in rest.iter().zip(lower.chunks_exact(square)) {
                    for row in 0..LANES {
                        let rest = simd.splat_f32s(rest[row]);
                        sums[row % 4] = simd.mul_add_f32s(lower[row * pieces + piece], rest, sums[row % 4]);
                    }
                }
                let own = simd.mul_f32s(*own, inverse_diagonal[panel * pieces + piece]);
                *scaled = simd.sub_f32s(own, sum_of_four(simd, sums));
            }
            *own = product(simd, &transposed[panel * square..][..square], &scaled);
        }
    }
}

/// Product of a square, `[column][row]`, and a vector.
#[inline(always)]
fn product<S: Simd>(simd: S, square: &[S::f32s], vector: &[f32; LANES]) -> [f32; LANES] {
    let pieces = LANES / S::F32_LANES;
    let mut out = [0.0; LANES];
    for (piece, out) in S::as_mut_simd_f32s(&mut out[..]).0.iter_mut().enumerate() {
        let mut sums = [simd.splat_f32s(0.0); 4];
        for column in 0..LANES {
            let factor = simd.splat_f32s(vector[column]);
            sums[column % 4] = simd.mul_add_f32s(square[column * pieces + piece], factor, sums[column % 4]);
        }
        *out = sum_of_four(simd, sums);
    }
    out
}

#[inline(always)]
fn sum_of_four<S: Simd>(simd: S, [a, b, c, d]: [S::f32s; 4]) -> S::f32s {
    simd.add_f32s(simd.add_f32s(a, b), simd.add_f32s(c, d))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A matrix of `size` unknowns that is dominated by its diagonal.
    fn matrix(size: usize, width: usize) -> SymmetricBand {
        let mut band = SymmetricBand::zeros(size, width);
        for column in 0..size {
            band.add(column, column, 2.0 * width as f64 + 1.0);
            for below in 1..=width.min(size - 1 - column) {
                band.add(column + below, column, ((column * 7 + below * 3) as f64).sin());
            }
        }
        band
    }

    #[test]
    fn the_solution_satisfies_the_equations() {
        for (size, width) in [(1, 0), (5, 4), (40, 7), (100, 33)] {
            let band = matrix(size, width);
            let solution: Vec<f64> = (0..size).map(|i| (i as f64 * 0.7).cos()).collect();
            let right = band.product(&solution);
            let mut factors = band.clone();
            factors.factorise();
            let exact = factors.solution(&right);
            // The same bound with ε = 2.2e-16.
            assert!(exact.iter().zip(&solution).all(|(found, known)| (found - known).abs() < 3e-14), "{size} {width}");
            let solver = BandSolver::new(&factors);
            let mut vector = vec![0.0f32; solver.length()];
            vector.iter_mut().zip(&right).for_each(|(out, value)| *out = *value as f32);
            solver.solve(&mut vector);
            for (found, known) in vector.iter().zip(&solution) {
                // A condition number below 3 and sums of up to 2·33 terms: 3·66·ε/2 with ε =
                // 1.2e-7.
                assert!((f64::from(*found) - known).abs() < 1.2e-5, "{size} {width}: {found} {known}");
            }
            assert!(vector[size..].iter().all(|value| *value == 0.0));
        }
    }

    #[test]
    fn pivots_count_the_eigenvalues_below_a_shift() {
        // The second difference of n points has the eigenvalues 4 sin²(πk/2(n + 1)), k = 1 … n.
        let size = 30;
        let shifted = |shift: f64| {
            let mut band = SymmetricBand::zeros(size, 1);
            for column in 0..size {
                band.add(column, column, 2.0 - shift);
                if column + 1 < size {
                    band.add(column + 1, column, -1.0);
                }
            }
            band
        };
        let known = |k: usize| 4.0 * (std::f64::consts::PI * k as f64 / (2.0 * (size + 1) as f64)).sin().powi(2);
        for k in [0, 7, 29] {
            let mut band = shifted((known(k) + known(k + 1)) / 2.0);
            band.factorise();
            assert_eq!(band.diagonal().filter(|pivot| *pivot < 0.0).count(), k);
        }
        let found = shifted(0.0).largest_eigenvalue();
        assert!(found <= known(size) && found > 0.99 * known(size), "{found}");
    }

    #[test]
    fn what_is_narrowed_away_is_the_rest() {
        let band = matrix(20, 6);
        assert_eq!(band.largest_rest(6), 0.0);
        let (vector, narrow) = (vec![1.0; 20], band.narrowed(4));
        let difference = band
            .product(&vector)
            .iter()
            .zip(narrow.product(&vector))
            .fold(0.0f64, |most, (a, b)| most.max((a - b).abs()));
        // The entries have both signs, so that the rows' sums of magnitudes bound the difference.
        assert!(difference > 0.0 && difference <= band.largest_rest(4));
    }
}

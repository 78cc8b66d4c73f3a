//! Symmetric band matrix, its factorisation `A = L·D·Lᵀ` in double precision, and the solution with the factors in single precision.
//!
//! A column of L is contiguous, `width` numbers below the diagonal:
//!
//! ```text
//! forward    x[j+1 ..] −= x[j]·L[j+1 .., j]       one multiply-add of a column
//! backward   x[j] = x[j]/d[j] − L[j+1 .., j]·x[j+1 ..]   one dot product
//! ```
//!
//! Both have an order of additions that does not depend on the length of the processor's vectors. For n unknowns a solution reads
//! 8·n·width bytes, where an inverse has 4·n².

use crate::ao::aligned::AlignedBuffer;
use crate::ao::footprint::LANES;
use pulp::{Arch, NullaryFnOnce};

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

    /// Sum of the magnitudes of the entries of each row farther than `width` from the diagonal, the largest of all rows.
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

    /// Largest eigenvalue of a positive semidefinite matrix, by the power method: within a per cent from below.
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

    /// Replaces the matrix by its factors: D on the diagonal, L below. Without pivoting, which a positive definite matrix does not
    /// need. The signs of D are those of the eigenvalues (Sylvester's law of inertia).
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

    /// Diagonal.
    pub(super) fn diagonal(&self) -> impl Iterator<Item = f64> + '_ {
        self.columns.chunks_exact(self.width + 1).map(|column| column[0])
    }
}

/// Factors of a symmetric band matrix in single precision.
#[derive(Debug)]
pub(super) struct BandSolver {
    /// Numbers below the diagonal, a multiple of [`LANES`].
    width: usize,
    lower: AlignedBuffer,
    inverse_diagonal: Vec<f32>,
}

impl BandSolver {
    /// Solver with the factors of [`SymmetricBand::factorise`].
    pub(super) fn new(factors: &SymmetricBand) -> Self {
        let width = factors.width.next_multiple_of(LANES);
        let mut lower = AlignedBuffer::zeros(factors.size * width);
        for (column, out) in lower.chunks_exact_mut(width.max(1)).enumerate() {
            for (out, value) in out.iter_mut().zip(&factors.column(column)[1..]) {
                *out = *value as f32;
            }
        }
        Self { width, lower, inverse_diagonal: factors.diagonal().map(|pivot| (1.0 / pivot) as f32).collect() }
    }

    /// Length of the vector of [`BandSolver::solve`]: the unknowns, and a window of zeros behind them.
    pub(super) fn length(&self) -> usize {
        self.inverse_diagonal.len() + self.width
    }

    /// Bytes of the factors.
    pub(super) fn bytes(&self) -> usize {
        size_of_val(&self.lower[..])
    }

    /// Solves `A·x = vector` in place. What lies behind the unknowns is 0 before and after.
    pub(super) fn solve(&self, vector: &mut [f32]) {
        Arch::new().dispatch(Solve { solver: self, vector });
    }
}

/// Kernel of [`BandSolver::solve`].
struct Solve<'a> {
    solver: &'a BandSolver,
    vector: &'a mut [f32],
}

impl NullaryFnOnce for Solve<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { solver: BandSolver { width, lower, inverse_diagonal }, vector } = self;
        let width = *width;
        let size = inverse_diagonal.len();
        for column in 0..size {
            let own = vector[column];
            let lower = lower[column * width..][..width].as_chunks::<LANES>().0;
            let below = vector[column + 1..][..width].as_chunks_mut::<LANES>().0;
            for (below, lower) in below.iter_mut().zip(lower) {
                for lane in 0..LANES {
                    below[lane] = lower[lane].mul_add(-own, below[lane]);
                }
            }
        }
        for column in (0..size).rev() {
            let lower = lower[column * width..][..width].as_chunks::<LANES>().0;
            let below = vector[column + 1..][..width].as_chunks::<LANES>().0;
            let mut sums = [0.0f32; LANES];
            for (below, lower) in below.iter().zip(lower) {
                for lane in 0..LANES {
                    sums[lane] = lower[lane].mul_add(below[lane], sums[lane]);
                }
            }
            let mut length = LANES / 2;
            while length > 0 {
                for lane in 0..length {
                    sums[lane] += sums[lane + length];
                }
                length /= 2;
            }
            vector[column] = vector[column].mul_add(inverse_diagonal[column], -sums[0]);
        }
    }
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
            let solver = BandSolver::new(&factors);
            let mut vector = vec![0.0f32; solver.length()];
            vector.iter_mut().zip(&right).for_each(|(out, value)| *out = *value as f32);
            solver.solve(&mut vector);
            for (found, known) in vector.iter().zip(&solution) {
                // A condition number below 3 and sums of up to 2·33 terms: 3·66·ε/2 with ε = 1.2e-7.
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

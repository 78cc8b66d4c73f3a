//! Gauss-Newton matrix Jᵀ W J: weighted products over the pixels of the derivatives by the modes,
//! computed in tiles of pixels, because the derivatives of 2,400 modes at a million pixels would
//! take 20 GB.
//!
//! A fitted flux and a fitted background have rows of their own in J: the PSF, and ones. They are
//! projected out of the finished matrix.

use crate::imaging::LinearModel;
use cophase_numerics::product::{Matrix, MatrixMut};
use ndarray::{Array1, Array2, ArrayViewMut1, Axis, s};
use rayon::prelude::*;

/// Fewest and most rows of a product in one task, a strip, of which there are some [`STRIPS`]. Only
/// the lower triangle is needed: a strip computes half a square of its rows in excess; and it
/// arranges all columns before it in memory again, a third of the time for strips of 48 of 2,500.
const STRIP: [usize; 2] = [48, 192];
/// Strips of a product.
const STRIPS: usize = 16;
/// Share of a nuisance row's squared norm, after the rows before it were projected out, below which
/// it is a copy of them: rounding of sums over 10⁴ pixels.
const DEGENERATE_SHARE: f64 = 1e-13;

/// Rows that a fitted flux and background add to those of the modes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::modal) enum Nuisances {
    None,
    Flux,
    FluxAndBackground,
}

impl Nuisances {
    pub(in crate::modal) fn new(fit_flux: bool, fit_background: bool) -> Self {
        match (fit_flux, fit_background) {
            (false, _) => Self::None,
            (true, false) => Self::Flux,
            (true, true) => Self::FluxAndBackground,
        }
    }

    pub(in crate::modal) fn count(self) -> usize {
        self as usize
    }
}

/// Rows of pixels of a tile whose derivatives, plain and weighted, take at most `bytes`; one at
/// least.
pub(in crate::modal) fn rows_of_tile(modes: usize, pixels: usize, bytes: usize) -> usize {
    (bytes / bytes_of_row(modes, pixels)).clamp(1, pixels)
}

/// Bytes of one row of pixels in a tile.
pub(in crate::modal) fn bytes_of_row(modes: usize, pixels: usize) -> usize {
    // The modes, two nuisances at most, plain and weighted.
    2 * (modes + 2) * pixels * size_of::<f64>()
}

/// Derivatives that are stored for products with other weights.
pub(in crate::modal) struct StoredDerivatives(Array2<f64>);

impl StoredDerivatives {
    /// All of them: `[row, pixel]`.
    pub(in crate::modal) fn new(linear: &LinearModel, nuisances: Nuisances) -> Self {
        Self(derivatives(linear, &[], nuisances, 0..linear.pixels()))
    }

    /// As [`products`], from the stored derivatives.
    pub(in crate::modal) fn products(&self, weights: &[Vec<f64>]) -> Vec<Array2<f64>> {
        let mut all = zeros(self.0.nrows(), weights.len());
        add_products(&self.0, weights, 0, &mut all);
        all.iter_mut().for_each(mirror);
        all
    }
}

/// For each list of weights (one of each pixel, 0 or more), Σ over the pixels of weight × row ×
/// row, `[row, row]`: rows are the modes' derivatives per nm, for a flux of 1, those of `further`
/// unknowns, and the nuisances. Computed in tiles of `tile` rows of pixels.
pub(in crate::modal) fn products(
    linear: &LinearModel,
    further: &[Array1<f64>],
    nuisances: Nuisances,
    weights: &[Vec<f64>],
    tile: usize,
) -> Vec<Array2<f64>> {
    let m = linear.pixels();
    let mut all = zeros(linear.unknowns() + further.len() + nuisances.count(), weights.len());
    for first in (0..m).step_by(tile) {
        let tile = derivatives(linear, further, nuisances, first..m.min(first + tile));
        add_products_within(tile, weights, first * m, &mut all);
    }
    all.iter_mut().for_each(mirror);
    all
}

fn zeros(rows: usize, count: usize) -> Vec<Array2<f64>> {
    (0..count).map(|_| Array2::zeros((rows, rows))).collect()
}

fn derivatives(
    linear: &LinearModel,
    further: &[Array1<f64>],
    nuisances: Nuisances,
    rows: std::ops::Range<usize>,
) -> Array2<f64> {
    let (m, modes) = (linear.pixels(), linear.unknowns());
    // New pages, which the threads that write them take: one thread alone takes as long for these
    // as for a product.
    let mut tile = Array2::zeros((modes + further.len() + nuisances.count(), rows.len() * m));
    linear.derivatives(rows.clone(), tile.slice_mut(s![..modes, ..]));
    for (column, mut row) in further.iter().zip(tile.slice_mut(s![modes.., ..]).outer_iter_mut()) {
        row.assign(&column.slice(s![rows.start * m..rows.end * m]));
    }
    let modes = modes + further.len();
    if nuisances != Nuisances::None {
        let psf = &linear.psf()[rows.start * m..rows.end * m];
        tile.row_mut(modes).iter_mut().zip(psf).for_each(|(value, h)| *value = *h);
        // The background, where it is fitted.
        tile.slice_mut(s![modes + 1.., ..]).fill(1.0);
    }
    tile
}

/// Adds a tile's part to the lower triangles; its first pixel is `first` of the image.
fn add_products(tile: &Array2<f64>, weights: &[Vec<f64>], first: usize, all: &mut [Array2<f64>]) {
    if weights.is_empty() {
        return;
    }
    let mut weighted = Array2::zeros(tile.dim());
    for (weight, product) in weights.iter().zip(all) {
        let roots = roots(weight, first, tile.ncols());
        weighted.axis_iter_mut(Axis(0)).into_par_iter().zip(tile.axis_iter(Axis(0))).for_each(|(mut to, from)| {
            to.iter_mut().zip(from).zip(&roots).for_each(|((to, from), root)| *to = from * root);
        });
        add_gram(&weighted, product);
    }
}

/// As [`add_products`], in the memory of the tile for the last weights: new pages take as long as
/// the products.
fn add_products_within(mut tile: Array2<f64>, weights: &[Vec<f64>], first: usize, all: &mut [Array2<f64>]) {
    let (Some((weight, others)), Some((product, rest))) = (weights.split_last(), all.split_last_mut()) else { return };
    add_products(&tile, others, first, rest);
    let roots = roots(weight, first, tile.ncols());
    tile.axis_iter_mut(Axis(0)).into_par_iter().for_each(|mut row| {
        row.iter_mut().zip(&roots).for_each(|(value, root)| *value *= root);
    });
    add_gram(&tile, product);
}

/// Roots of the weights of `count` pixels from `first` on.
fn roots(weight: &[f64], first: usize, count: usize) -> Vec<f64> {
    weight[first..first + count].iter().map(|weight| weight.sqrt()).collect()
}

/// Adds a·aᵀ: the lower triangle, and the excess of its strips.
fn add_gram(a: &Array2<f64>, product: &mut Array2<f64>) {
    let (rows, columns) = a.dim();
    let (Some(a), Some(product)) = (a.as_slice(), product.as_slice_mut()) else { return };
    let height = rows.div_ceil(STRIPS).clamp(STRIP[0], STRIP[1]);
    product.par_chunks_mut(height * rows).enumerate().for_each(|(strip, out)| {
        let (first, count) = (strip * height, out.len() / rows);
        let all = Matrix::from_rows(&a[..(first + count) * columns], first + count, columns);
        let (mut out, _) = MatrixMut::from_rows(out, count, rows).split_at_column(first + count);
        out.add_product(1.0, all.part(first..first + count, 0..columns), all.transpose());
    });
}

/// Copies the lower triangle to the upper one, a block at a time, because a column of a large
/// matrix is in as many pages.
fn mirror(matrix: &mut Array2<f64>) {
    const BLOCK: usize = 32;
    let rows = matrix.nrows();
    for first in (0..rows).step_by(BLOCK) {
        for left in (0..=first).step_by(BLOCK) {
            for i in first..rows.min(first + BLOCK) {
                for j in left..i.min(left + BLOCK) {
                    matrix[[j, i]] = matrix[[i, j]];
                }
            }
        }
    }
}

/// Shares of the rows of a fitted flux and background in each other row, for some weights.
pub(in crate::modal) struct NuisanceShares {
    /// For each nuisance, the multiple of its row that is subtracted from each other row.
    shares: Vec<Vec<f64>>,
    modes: usize,
}

impl NuisanceShares {
    /// From `products` with the weights of the fit, whose last rows are the nuisances.
    pub(in crate::modal) fn new(products: &Array2<f64>, nuisances: Nuisances) -> Self {
        let modes = products.nrows() - nuisances.count();
        // Rows of the nuisances, less those before them.
        let mut rest = products.slice(s![modes.., ..]).to_owned();
        let mut shares = Vec::new();
        for k in modes..products.nrows() {
            let row = rest.row(k - modes).to_owned();
            let pivot = row[k];
            let share: Vec<f64> = if pivot > DEGENERATE_SHARE * products[[k, k]] {
                row.iter().enumerate().map(|(i, v)| if i == k { 0.0 } else { v / pivot }).collect()
            } else {
                vec![0.0; products.nrows()]
            };
            for (other, mut line) in (modes..).zip(rest.outer_iter_mut()) {
                add_shares(&mut line, [other, k], &share, &row);
            }
            shares.push(share);
        }
        Self { shares, modes }
    }

    /// The modes' part of a matrix of products, with the nuisances projected out.
    pub(in crate::modal) fn project_out(&self, mut products: Array2<f64>) -> Array2<f64> {
        for (k, share) in (self.modes..).zip(&self.shares) {
            subtract_row(&mut products, k, share);
        }
        products.slice(s![..self.modes, ..self.modes]).to_owned()
    }
}

/// row_i ← row_i − share_i·row_k, on both sides of the product.
fn subtract_row(products: &mut Array2<f64>, k: usize, share: &[f64]) {
    let row = products.row(k).to_owned();
    products.axis_iter_mut(Axis(0)).into_par_iter().enumerate().for_each(|(i, mut line)| {
        add_shares(&mut line, [i, k], share, &row);
    });
}

/// The part of [`subtract_row`] in row `i`, where `row` is that of `k`.
fn add_shares(line: &mut ArrayViewMut1<f64>, [i, k]: [usize; 2], share: &[f64], row: &Array1<f64>) {
    let own = row[k];
    for ((value, share_of), row_of) in line.iter_mut().zip(share).zip(row) {
        // The same expression for [i, j] and [j, i], so that the matrix stays symmetric to the last
        // bit.
        *value += share[i] * share_of * own - (share[i] * row_of + share_of * row[i]);
    }
}

#[cfg(test)]
mod tests;

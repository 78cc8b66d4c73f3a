//! Smooth modes on a square grid as sums of products of a function of y and a function of x. Their
//! sum then takes n·K·n operations and two small tables; as maps, every value of every mode is read
//! from memory each time.

use super::smooth::{Functions, SmoothBasis};
use super::zernike::{Zernikes, noll_orders};
use crate::Result;
use crate::grid::Grid;
use ndarray::{Array2, Array3, ArrayView2, Axis, s};
use std::f64::consts::PI;

/// `mode_i(x, y) = Σ_g Σ_ab matrix_{i,g,a,b} · f_{g,a}(y) · f_{g,b}(x)`: Gaussian influence
/// functions are such products, and a polynomial of degree d is an exact sum of products of
/// Chebyshev polynomials with (d + 1)² coefficients.
#[derive(Debug, Clone, PartialEq)]
pub struct SeparableBasis {
    /// The functions at the coordinates of the grid, `[function, sample]`, group by group.
    pub lines: Array2<f64>,
    /// Number of functions of each group.
    pub groups: Vec<usize>,
    /// `[mode, coefficient]`: K² coefficients per group, `[function of y][function of x]`.
    pub matrix: Array2<f64>,
}

impl SeparableBasis {
    /// The modes of `basis` on `grid`.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for modes of measured influence functions or petals, which are no
    /// such products ([`SmoothBasis::is_separable`]).
    pub fn new(basis: &SmoothBasis, grid: Grid) -> Result<Self> {
        let refusal = || {
            let sentence = "measured influence functions and petals are no products of functions of x and of y: maps of them are needed";
            Err(crate::Error::Value(sentence.into()))
        };
        if !basis.is_separable() {
            return refusal();
        }
        let coordinates: Vec<f64> = (0..grid.samples()).map(|j| grid.coordinate_m(j)).collect();
        let (mut lines, mut groups, mut matrices) = (Vec::new(), Vec::new(), Vec::new());
        let mut constant = None;
        let mut first = 0;
        for functions in basis.functions() {
            let count = functions.count();
            let combination = basis.matrix().slice_move(s![.., first..first + count]);
            first += count;
            let (line, products) = match functions {
                Functions::Zernike(zernikes) => {
                    // The product of the first two polynomials is the constant 1.
                    constant.get_or_insert((groups.len(), 0));
                    chebyshev(zernikes, &coordinates, grid.width_m() / 2.0)?
                }
                Functions::Influence(influence) => {
                    let (line, cells) = influence.along(&coordinates);
                    let across = line.nrows();
                    let mut products = Array2::zeros((count, across * across));
                    for (mut row, &cell) in products.outer_iter_mut().zip(cells) {
                        row[cell] = 1.0;
                    }
                    (line, products)
                }
                Functions::Petals(_) => return refusal(),
            };
            groups.push(line.nrows());
            lines.push(line);
            matrices.push(combination.dot(&products));
        }
        if constant.is_none() {
            constant = Some((groups.len(), 0));
            groups.push(1);
            lines.push(Array2::ones((1, grid.samples())));
            matrices.push(Array2::zeros((basis.len(), 1)));
        }
        if let Some((group, entry)) = constant {
            let mut column = matrices[group].column_mut(entry);
            column += &basis.offset();
        }
        let joined = |parts: &[Array2<f64>], axis| {
            let views: Vec<ArrayView2<f64>> = parts.iter().map(|part| part.view()).collect();
            ndarray::concatenate(Axis(axis), &views).map_err(|error| crate::Error::Internal(error.to_string()))
        };
        Ok(Self { lines: joined(&lines, 0)?, groups, matrix: joined(&matrices, 1)?.as_standard_layout().to_owned() })
    }

    /// Number of multiply-adds for the sum of all modes on the grid.
    pub fn operations(&self) -> usize {
        let (samples, functions) = (self.lines.ncols(), self.lines.nrows());
        let squares: usize = self.groups.iter().map(|k| k * k).sum();
        self.matrix.len() + squares * samples + functions * samples * samples
    }
}

/// Chebyshev polynomials over ±`half_m` at `coordinates_m`, `[polynomial, point]`, and the
/// coefficients of the Zernike polynomials in their products, `[zernike, K²]`: interpolation at K²
/// nodes, which is exact for degrees below K.
fn chebyshev(zernikes: &Zernikes, coordinates_m: &[f64], half_m: f64) -> Result<(Array2<f64>, Array2<f64>)> {
    let orders = zernikes.nolls().iter().map(|&noll| Ok(noll_orders(noll)?.0)).collect::<Result<Vec<usize>>>()?;
    let k = orders.into_iter().max().unwrap_or(0) + 1;
    let angle = |node: usize| PI * (node as f64 + 0.5) / k as f64;
    let nodes: Vec<f64> = (0..k).map(|node| half_m * angle(node).cos()).collect();
    let (xs, ys): (Vec<f64>, Vec<f64>) = (0..k * k).map(|i| (nodes[i % k], nodes[i / k])).unzip();
    let values = zernikes.evaluate(&xs, &ys)?;
    let transform = Array2::from_shape_fn((k, k), |(degree, node)| {
        let norm = if degree == 0 { 1.0 } else { 2.0 } / k as f64;
        norm * (degree as f64 * angle(node)).cos()
    });
    let mut coefficients = Array3::zeros((values.nrows(), k, k));
    for (mut out, values) in coefficients.outer_iter_mut().zip(values.outer_iter()) {
        let values = Array2::from_shape_fn((k, k), |(y, x)| values[y * k + x]);
        out.assign(&transform.dot(&values).dot(&transform.t()));
    }
    let mut line = Array2::ones((k, coordinates_m.len()));
    for (point, &x_m) in coordinates_m.iter().enumerate() {
        let t = x_m / half_m;
        for degree in 1..k {
            line[[degree, point]] =
                if degree == 1 { t } else { 2.0 * t * line[[degree - 1, point]] - line[[degree - 2, point]] };
        }
    }
    let flat = (values.nrows(), k * k);
    let coefficients = coefficients.into_shape_with_order(flat);
    Ok((line, coefficients.map_err(|error| crate::Error::Internal(error.to_string()))?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::modes::Mirror;

    /// Largest difference between the modes of `basis` as functions and as sums of products, on a
    /// grid.
    fn difference(basis: &SmoothBasis, grid: Grid) -> f64 {
        let separable = SeparableBasis::new(basis, grid).unwrap();
        let n = grid.samples();
        let points = (0..n * n).map(|i| (grid.coordinate_m(i % n), grid.coordinate_m(i / n)));
        let (xs, ys): (Vec<f64>, Vec<f64>) = points.unzip();
        let expected = basis.evaluate(&xs, &ys).unwrap();
        let mut worst = 0.0f64;
        for (mode, coefficients) in separable.matrix.outer_iter().enumerate() {
            let (mut map, mut function, mut entry) = (Array2::<f64>::zeros((n, n)), 0, 0);
            for &k in &separable.groups {
                let line = separable.lines.slice(s![function..function + k, ..]);
                let c = Array2::from_shape_fn((k, k), |(a, b)| coefficients[entry + a * k + b]);
                map = map + line.t().dot(&c.dot(&line));
                (function, entry) = (function + k, entry + k * k);
            }
            worst = map.iter().zip(expected.row(mode)).fold(worst, |worst, (a, b)| worst.max((a - b).abs()));
        }
        worst
    }

    #[test]
    fn products_agree_with_the_modes() {
        let grid = Grid::new(22, 4.6).unwrap();
        let zernikes = SmoothBasis::zernike(Zernikes::new(2..=66, 2.1).unwrap());
        let mirror = SmoothBasis::influence(
            Mirror::new(7, 0.7, 0.14).unwrap().at((0..49).filter(|i| i % 7 % 6 > 0).collect()).unwrap(),
        );
        let mixed = zernikes.followed_by(&mirror);
        let combination = Array2::from_shape_fn((9, mixed.len()), |(i, j)| ((3 * i + 7 * j) as f64).sin());
        let mean = ndarray::Array1::from_shape_fn(mixed.len(), |j| (j as f64).cos());
        let names = (0..9).map(|i| format!("mode-{i}")).collect();
        let combined = mixed.combined(names, &combination, &mean);
        // Order 10 reaches 300 in the corners of the grid, beyond the disc; a few hundred roundings
        // of 1e-16 of that.
        for (basis, bound) in [(&zernikes, 1e-10), (&mirror, 1e-14), (&combined, 1e-9)] {
            let worst = difference(basis, grid);
            assert!(worst < bound, "{worst:e}");
        }
    }

    #[test]
    fn a_large_basis_takes_fewer_operations_than_its_maps() {
        let mirror = SmoothBasis::influence(Mirror::new(21, 0.5, 0.14).unwrap().all());
        let grid = Grid::new(120, 10.0).unwrap();
        assert!(SeparableBasis::new(&mirror, grid).unwrap().operations() < 441 * 120 * 120 / 8);
    }
}

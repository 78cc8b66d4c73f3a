//! Lattice of integer vectors in a metric: reduced basis (Lenstra, Lenstra & Lovász 1982, Math.
//! Ann. 261, 515) and the vector near a point (Babai 1986, Combinatorica 6, 1).

use ndarray::Array2;

/// Least ratio of successive orthogonalised squares, up to the square of their coefficient: the
/// authors' 3/4.
const LOVASZ: f64 = 0.75;

/// A basis of the integer vectors that are short and nearly orthogonal in a metric.
pub(super) struct IntegerLattice {
    /// Its vectors.
    pub(super) basis: Vec<Vec<i64>>,
    /// Scalar products of the basis.
    gram: Array2<f64>,
    /// Scalar products of the basis (rows) with the orthogonalised one (columns), lower triangle.
    products: Array2<f64>,
}

impl IntegerLattice {
    /// The reduced basis in the metric `gram`, which is positive definite.
    pub(super) fn new(gram: Array2<f64>) -> Self {
        let size = gram.nrows();
        let basis = (0..size).map(|row| (0..size).map(|column| i64::from(row == column)).collect()).collect();
        let mut lattice = Self { basis, gram, products: Array2::zeros((size, size)) };
        let mut row = 0;
        while row < size {
            lattice.orthogonalise(row);
            if row == 0 {
                row = 1;
                continue;
            }
            lattice.shorten(row);
            let coefficient = lattice.coefficient(row, row - 1);
            let least = (LOVASZ - coefficient * coefficient) * lattice.products[[row - 1; 2]];
            if lattice.products[[row; 2]] >= least {
                row += 1;
            } else {
                lattice.swap(row);
                row -= 1;
            }
        }
        lattice
    }

    /// A vector near the minimum of half a quadratic form, whose second derivatives are the metric
    /// and whose gradient at 0 is `gradient`: the nearest where orthogonalised vectors are long.
    pub(super) fn near_minimum(&self, gradient: &[f64]) -> Vec<i64> {
        let size = self.basis.len();
        // Scalar products of the minimum with the orthogonalised basis.
        let mut along = vec![0.0; size];
        for row in 0..size {
            let own: f64 = self.basis[row].iter().zip(gradient).map(|(step, slope)| -(*step as f64) * slope).sum();
            along[row] = own - (0..row).map(|column| self.coefficient(row, column) * along[column]).sum::<f64>();
        }
        let mut found = vec![0; size];
        for row in (0..size).rev() {
            let multiple = (along[row] / self.products[[row; 2]]).round();
            for (column, product) in along.iter_mut().enumerate().take(row) {
                *product -= multiple * self.products[[row, column]];
            }
            for (sum, step) in found.iter_mut().zip(&self.basis[row]) {
                *sum += multiple as i64 * step;
            }
        }
        found
    }

    /// Coefficient of `row` along the orthogonalised vector `column`.
    fn coefficient(&self, row: usize, column: usize) -> f64 {
        self.products[[row, column]] / self.products[[column; 2]]
    }

    /// Gram-Schmidt products of `row`, from those of the rows before it.
    fn orthogonalise(&mut self, row: usize) {
        for column in 0..=row {
            let mut product = self.gram[[row, column]];
            for before in 0..column {
                product -= self.coefficient(column, before) * self.products[[row, before]];
            }
            self.products[[row, column]] = product;
        }
    }

    /// Subtracts from `row` the multiples of the rows before it that make its coefficients at most
    /// a half.
    fn shorten(&mut self, row: usize) {
        for column in (0..row).rev() {
            let multiple = self.coefficient(row, column).round();
            if multiple == 0.0 {
                continue;
            }
            let [subtracted, changed] = [column, row].map(|index| self.basis[index].clone());
            let pairs = changed.iter().zip(&subtracted);
            self.basis[row] = pairs.map(|(a, b)| a - multiple as i64 * b).collect();
            let own = self.gram[[row; 2]] - 2.0 * multiple * self.gram[[row, column]]
                + multiple * multiple * self.gram[[column; 2]];
            for other in 0..self.basis.len() {
                let product = self.gram[[row, other]] - multiple * self.gram[[column, other]];
                self.gram[[row, other]] = product;
                self.gram[[other, row]] = product;
            }
            self.gram[[row; 2]] = own;
            for before in 0..=column {
                self.products[[row, before]] -= multiple * self.products[[column, before]];
            }
        }
    }

    /// Exchanges `row` and the one before it.
    fn swap(&mut self, row: usize) {
        self.basis.swap(row, row - 1);
        for other in 0..self.basis.len() {
            self.gram.swap([row, other], [row - 1, other]);
        }
        for other in 0..self.basis.len() {
            self.gram.swap([other, row], [other, row - 1]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The integers with x ≈ 0.75 y: in a metric that punishes their difference, (3, 4) is short
    /// and (1, 0) is not.
    #[test]
    fn the_shortest_vector_is_found() {
        let (stiff, soft) = (1e4, 1.0);
        // stiff (4 x − 3 y)² + soft (x² + y²)
        let gram = ndarray::arr2(&[[16.0 * stiff + soft, -12.0 * stiff], [-12.0 * stiff, 9.0 * stiff + soft]]);
        let basis = IntegerLattice::new(gram).basis;
        assert_eq!(basis[0].iter().map(|x| x.abs()).collect::<Vec<_>>(), [3, 4]);
        let determinant = basis[0][0] * basis[1][1] - basis[0][1] * basis[1][0];
        assert_eq!(determinant.abs(), 1, "{basis:?} spans all integers");
    }

    /// Differences of two integers are short, single integers are long: one vector of the basis at
    /// most has a sum.
    #[test]
    fn a_hidden_short_combination_is_found() {
        let size = 12;
        // 1e6 (Σ x)² + Σ x²
        let gram = Array2::from_shape_fn((size, size), |(i, j)| 1e6 + f64::from(u8::from(i == j)));
        let basis = IntegerLattice::new(gram).basis;
        for vector in &basis[..size - 1] {
            assert_eq!(vector.iter().sum::<i64>(), 0, "{vector:?}");
        }
        assert_eq!(basis[size - 1].iter().sum::<i64>().abs(), 1, "{:?}", basis[size - 1]);
    }

    /// Of integers near a point in a skew metric the nearest is found, where rounding each alone is
    /// far off.
    #[test]
    fn the_nearest_vector_is_found() {
        let gram = ndarray::arr2(&[[1601.0, -1200.0], [-1200.0, 901.0]]);
        // The minimum is at (7.1, 9.2); (7, 9) is nearest among all within 20.
        let minimum = [7.1, 9.2];
        let gradient: Vec<f64> = gram.dot(&ndarray::arr1(&minimum)).iter().map(|x| -x).collect();
        let form = |x: i64, y: i64| {
            let off = ndarray::arr1(&[x as f64 - minimum[0], y as f64 - minimum[1]]);
            off.dot(&gram.dot(&off))
        };
        let all = (-20..=20).flat_map(|x| (-20..=20).map(move |y| (x, y)));
        let nearest = all.min_by(|a, b| form(a.0, a.1).total_cmp(&form(b.0, b.1))).unwrap();
        assert_eq!(IntegerLattice::new(gram.clone()).near_minimum(&gradient), [nearest.0, nearest.1]);
    }
}

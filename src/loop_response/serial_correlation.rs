//! Serial correlation of a sequence: by how much the mean of values that follow each other is less certain than that of independent ones.
//!
//! Turbulence stays over a pupil of 30 m for four seconds, so that what it leaves in one image it leaves, in part, in the next. Values are
//! modelled as a first-order autoregression, whose coefficient ρ is that of the lag-one autocorrelation. Taking out the mean lowers the
//! autocorrelation (Kendall 1954, Biometrika 41, 403), so that ρ is found as the coefficient whose expected autocorrelation, with the mean taken
//! out, is the measured one.

use ndarray::{Array1, ArrayView2, s};

/// Directions on either side whose autocorrelation is pooled with one's own: of 25 images a single one has an error of 0.2, nine of them 0.07.
const NEIGHBOURS: usize = 4;
/// Fewest values whose correlation is sought.
const FEWEST_VALUES: usize = 8;
/// Largest coefficient: beyond it the sequence is one value.
const MAX_COEFFICIENT: f64 = 0.98;
/// Steps of bisection: the coefficient to 10⁻⁴.
const STEPS: usize = 14;

/// Variance of the mean of each direction over that of independent values with the same scatter, at least 1; `scatter` are values about
/// their mean, `[image, direction]`, directions that are alike beside each other.
pub(super) fn mean_variance_factors(scatter: ArrayView2<f64>) -> Array1<f64> {
    let (images, directions) = scatter.dim();
    if images < FEWEST_VALUES {
        return Array1::ones(directions);
    }
    let (before, after) = (scatter.slice(s![..-1, ..]), scatter.slice(s![1.., ..]));
    let squares: Vec<f64> = scatter.columns().into_iter().map(|values| values.dot(&values)).collect();
    let products: Vec<f64> = before.columns().into_iter().zip(after.columns()).map(|(a, b)| a.dot(&b)).collect();
    Array1::from_shape_fn(directions, |direction| {
        let pooled = direction.saturating_sub(NEIGHBOURS)..directions.min(direction + NEIGHBOURS + 1);
        let square: f64 = squares[pooled.clone()].iter().sum();
        let product: f64 = products[pooled].iter().sum();
        if square > 0.0 {
            Autoregression::with_autocorrelation(product / square, images).mean_variance_factor()
        } else {
            1.0
        }
    })
}

/// Sums over the covariance ρ^|i − j| of n values.
struct Autoregression {
    values: f64,
    /// Σ over all pairs.
    all: f64,
    /// Expected sum of squares about the mean.
    squares: f64,
    /// Expected sum of products of neighbours about the mean.
    products: f64,
}

impl Autoregression {
    fn new(coefficient: f64, values: usize) -> Self {
        let n = values as f64;
        // Σ over j of ρ^|i − j|: two geometric series.
        let beside = |count: usize| (0..count).fold(0.0, |sum, _| (sum + 1.0) * coefficient);
        let rows: Vec<f64> = (0..values).map(|i| 1.0 + beside(i) + beside(values - 1 - i)).collect();
        let all: f64 = rows.iter().sum();
        let inner = 2.0 * all - rows[0] - rows[values - 1];
        Self { values: n, all, squares: n - all / n, products: (n - 1.0) * (coefficient + all / (n * n)) - inner / n }
    }

    /// The autoregression whose expected autocorrelation about the mean is `measured`; without correlation where that is less.
    fn with_autocorrelation(measured: f64, values: usize) -> Self {
        let is_below = |coefficient: f64| {
            let expected = Self::new(coefficient, values);
            expected.products / expected.squares < measured
        };
        let (mut low, mut high) = (0.0, MAX_COEFFICIENT);
        if !is_below(low) {
            return Self::new(0.0, values);
        }
        for _ in 0..STEPS {
            let middle = (low + high) / 2.0;
            if is_below(middle) { low = middle } else { high = middle }
        }
        Self::new((low + high) / 2.0, values)
    }

    /// Variance of the mean over (sum of squares about it)/(n − 1)/n.
    fn mean_variance_factor(&self) -> f64 {
        self.all / self.values * (self.values - 1.0) / self.squares
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, Axis};
    use rand_distr::{Distribution, StandardNormal};

    /// Values of a first-order autoregression of unit variance, `[image, direction]`.
    fn sequence(coefficient: f64, images: usize, directions: usize, seed: u64) -> Array2<f64> {
        let mut rng = crate::source::stream(11, seed);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let mut values = Array2::zeros((images, directions));
        for direction in 0..directions {
            let mut last = normal();
            for image in 0..images {
                values[[image, direction]] = last;
                last = coefficient * last + (1.0 - coefficient * coefficient).sqrt() * normal();
            }
        }
        values
    }

    #[test]
    fn error_bars_of_means_cover_their_errors() {
        for coefficient in [0.0, 0.4, 0.8] {
            let (images, directions) = (25, 4000);
            let values = sequence(coefficient, images, directions, 1);
            let mean = values.mean_axis(Axis(0)).unwrap();
            let scatter = &values - &mean;
            let factors = mean_variance_factors(scatter.view());
            let variances = scatter.mapv(|value| value * value).sum_axis(Axis(0)) / (images * (images - 1)) as f64;
            let expected: f64 = (&variances * &factors).sum();
            let ratio = (mean.dot(&mean) / expected).sqrt();
            // 4,000 squares give 1.1 %. Nine pooled directions scatter by 0.07 in the coefficient, which raises the mean factor: of independent
            // values by a tenth, since none is below 1, and towards strong correlation by more.
            assert!((0.85..1.05).contains(&ratio), "{coefficient}: {ratio}");
        }
    }

    #[test]
    fn sums_over_the_covariance_are_those_of_the_matrix() {
        let (n, coefficient) = (9, 0.6f64);
        let covariance = Array2::from_shape_fn((n, n), |(i, j)| coefficient.powi((i as i32 - j as i32).abs()));
        let centre = Array2::<f64>::eye(n) - 1.0 / n as f64;
        let centred = centre.dot(&covariance).dot(&centre);
        let found = Autoregression::new(coefficient, n);
        let products: f64 = (0..n - 1).map(|i| centred[[i, i + 1]]).sum();
        // Rounding of sums of 81 numbers.
        assert!((found.all - covariance.sum()).abs() < 1e-12 && (found.squares - centred.diag().sum()).abs() < 1e-12);
        assert!((found.products - products).abs() < 1e-12);
        assert!((Autoregression::with_autocorrelation(products / found.squares, n).all / found.all - 1.0).abs() < 1e-3);
    }

    #[test]
    fn few_values_and_opposite_neighbours_change_nothing() {
        let alternating = Array2::from_shape_fn((10, 3), |(image, _)| if image % 2 == 0 { 1.0 } else { -1.0 });
        assert_eq!(mean_variance_factors(alternating.view()), Array1::ones(3));
        assert_eq!(mean_variance_factors(sequence(0.9, 5, 3, 2).view()), Array1::ones(3));
        assert_eq!(mean_variance_factors(Array2::zeros((10, 2)).view()), Array1::ones(2));
    }
}

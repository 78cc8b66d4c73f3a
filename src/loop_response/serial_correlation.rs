//! Serial correlation of a sequence: by how much the mean of values that follow each other is less
//! certain than that of independent ones.
//!
//! Turbulence stays over a pupil of 30 m for four seconds, so that what it leaves in one image it
//! leaves, in part, in the next; noise is new in each. Values are modelled as the sum of a
//! first-order autoregression, of coefficient ρ, and of white noise: the autocorrelation at lag l >
//! 0 is a share of ρˡ. Taking out the mean lowers the autocorrelation (Kendall 1954, Biometrika 41,
//! 403), so ρ and both variances are those whose expected products of values about their mean, at
//! the first lags, are nearest to the measured ones.

use ndarray::{Array1, ArrayView2, s};

/// Directions on either side whose products are pooled with one's own: the autocorrelation of 25
/// images has an error of 0.2 in a single one, of 0.05 in 17.
const NEIGHBOURS: usize = 8;
/// Lags at which products are compared, beside the squares.
const LAGS: usize = 4;
/// Fewest values whose correlation is sought: twice the lags.
const FEWEST_VALUES: usize = 8;
/// Coefficients ρ that are tried: with a larger one 25 values cannot distinguish a correlation from
/// an offset.
const COEFFICIENTS: std::ops::RangeInclusive<usize> = 2..=18;
/// Step between them.
const STEP: f64 = 0.05;

/// Variance of the mean of each direction over that of independent values with the same scatter, at
/// least 1; `scatter` are values about their mean, `[image, direction]`, directions that are alike
/// beside each other.
pub(super) fn mean_variance_factors(scatter: ArrayView2<f64>) -> Array1<f64> {
    let (images, directions) = scatter.dim();
    if images < FEWEST_VALUES {
        return Array1::ones(directions);
    }
    let products: Vec<[f64; LAGS + 1]> = scatter
        .columns()
        .into_iter()
        .map(|values| std::array::from_fn(|lag| values.slice(s![lag..]).dot(&values.slice(s![..images - lag]))))
        .collect();
    let white = Autoregression::new(0.0, images);
    let slow: Vec<Autoregression> =
        COEFFICIENTS.map(|steps| Autoregression::new(steps as f64 * STEP, images)).collect();
    Array1::from_shape_fn(directions, |direction| {
        let pooled = direction.saturating_sub(NEIGHBOURS)..directions.min(direction + NEIGHBOURS + 1);
        let sums = std::array::from_fn(|lag| products[pooled.clone()].iter().map(|of_lag| of_lag[lag]).sum());
        mean_variance_factor(&sums, &white, &slow)
    })
}

/// Variance of the mean over that of independent values with the same squares, of the mixture of
/// white noise with one of `slow` whose expected products at each lag are nearest to `sums`.
fn mean_variance_factor(sums: &[f64; LAGS + 1], white: &Autoregression, slow: &[Autoregression]) -> f64 {
    if sums[0] <= 0.0 {
        return 1.0;
    }
    let mut nearest = (f64::INFINITY, 1.0);
    for slow in slow {
        // With the share q of the squares in the autoregression: sums[l] / sums[0] = (1 − q)·w[l] +
        // q·s[l].
        let (mut square, mut product, mut rest) = (0.0, 0.0, 0.0);
        let terms = (1..=LAGS).map(|lag| (slow.share(lag) - white.share(lag), sums[lag] / sums[0] - white.share(lag)));
        for (change, wanted) in terms {
            (square, product, rest) = (square + change * change, product + change * wanted, rest + wanted * wanted);
        }
        let share = (product / square).clamp(0.0, 1.0);
        let distance = rest - share * (2.0 * product - share * square);
        if distance < nearest.0 {
            let variance = (1.0 - share) * white.mean / white.products[0] + share * slow.mean / slow.products[0];
            nearest = (distance, variance * white.products[0] / white.mean);
        }
    }
    nearest.1.max(1.0)
}

/// Expectations of n values of covariance ρ^|i − j|.
struct Autoregression {
    /// Variance of their mean.
    mean: f64,
    /// Sums of products of values about their mean, at lag 0 and the first lags.
    products: [f64; LAGS + 1],
}

impl Autoregression {
    fn new(coefficient: f64, values: usize) -> Self {
        let n = values as f64;
        // Σ over j of ρ^|i − j|: two geometric series.
        let beside = |count: usize| (0..count).fold(0.0, |sum, _| (sum + 1.0) * coefficient);
        let rows: Vec<f64> = (0..values).map(|i| 1.0 + beside(i) + beside(values - 1 - i)).collect();
        let mean = rows.iter().sum::<f64>() / (n * n);
        let products = std::array::from_fn(|lag| {
            let with_mean: f64 = rows[lag..].iter().chain(&rows[..values - lag]).sum();
            (values - lag) as f64 * (coefficient.powi(lag as i32) + mean) - with_mean / n
        });
        Self { mean, products }
    }

    /// Products at a lag over the squares.
    fn share(&self, lag: usize) -> f64 {
        self.products[lag] / self.products[0]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, Axis};
    use rand_distr::{Distribution, StandardNormal};

    /// White noise, of variance `noise`, and a first-order autoregression, together of unit
    /// variance, `[image, direction]`.
    fn sequence(coefficient: f64, noise: f64, images: usize, directions: usize) -> Array2<f64> {
        let mut rng = crate::source::stream(11, 1);
        let mut normal = move || -> f64 { StandardNormal.sample(&mut rng) };
        let mut values = Array2::zeros((images, directions));
        for direction in 0..directions {
            let mut last = normal();
            for image in 0..images {
                values[[image, direction]] = (1.0 - noise).sqrt() * last + noise.sqrt() * normal();
                last = coefficient * last + (1.0 - coefficient * coefficient).sqrt() * normal();
            }
        }
        values
    }

    #[test]
    fn error_bars_of_means_cover_their_errors() {
        for (coefficient, noise) in [(0.0, 0.0), (0.4, 0.0), (0.8, 0.0), (0.6, 0.3), (0.8, 0.5)] {
            let (images, directions) = (25, 4000);
            let values = sequence(coefficient, noise, images, directions);
            let mean = values.mean_axis(Axis(0)).unwrap();
            let scatter = &values - &mean;
            let factors = mean_variance_factors(scatter.view());
            let variances = scatter.mapv(|value| value * value).sum_axis(Axis(0)) / (images * (images - 1)) as f64;
            let expected: f64 = (&variances * &factors).sum();
            let ratio = (mean.dot(&mean) / expected).sqrt();
            // 4,000 squares give 1.1 %. The autocorrelation of 17 pooled directions scatters by
            // 0.05 at each lag, which raises the mean factor: of independent values by a fifth (9 %
            // of an error bar), since none is below 1, and towards strong correlation by more.
            assert!((0.85..1.05).contains(&ratio), "{coefficient} {noise}: {ratio}");
        }
    }

    #[test]
    fn sums_over_the_covariance_are_those_of_the_matrix() {
        let (n, coefficient) = (9, 0.6f64);
        let covariance = Array2::from_shape_fn((n, n), |(i, j)| coefficient.powi((i as i32 - j as i32).abs()));
        let centre = Array2::<f64>::eye(n) - 1.0 / n as f64;
        let centred = centre.dot(&covariance).dot(&centre);
        let found = Autoregression::new(coefficient, n);
        // Rounding of sums of 81 numbers.
        assert!((found.mean - covariance.mean().unwrap()).abs() < 1e-12);
        for (lag, found) in found.products.into_iter().enumerate() {
            let expected: f64 = (0..n - lag).map(|i| centred[[i, i + lag]]).sum();
            assert!((found - expected).abs() < 1e-12, "{lag}: {found} {expected}");
        }
    }

    #[test]
    fn few_values_and_opposite_neighbours_change_nothing() {
        let alternating = Array2::from_shape_fn((10, 3), |(image, _)| if image % 2 == 0 { 1.0 } else { -1.0 });
        assert_eq!(mean_variance_factors(alternating.view()), Array1::<f64>::ones(3));
        assert_eq!(mean_variance_factors(sequence(0.9, 0.0, 5, 3).view()), Array1::<f64>::ones(3));
        assert_eq!(mean_variance_factors(Array2::zeros((10, 2)).view()), Array1::<f64>::ones(2));
    }
}

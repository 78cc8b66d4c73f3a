use super::*;
use rand::SeedableRng;
use rand_chacha::ChaCha12Rng;
use rand_distr::{Distribution, StandardNormal};

/// Normal draws, `[image, mode]`, that share a part of weight `common`: their correlation is
/// `common²`.
fn draws(images: usize, modes: usize, common: f64, seed: u64) -> Array2<f64> {
    let mut rng = ChaCha12Rng::seed_from_u64(seed);
    let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
    let own = (1.0 - common * common).sqrt();
    let mut rows = Array2::zeros((images, modes));
    for mut row in rows.outer_iter_mut() {
        let shared = normal();
        row.mapv_inplace(|_: f64| common * shared + own * normal());
    }
    rows
}

fn equicorrelated(modes: usize, r: f64) -> Array2<f64> {
    Array2::from_shape_fn((modes, modes), |(i, j)| if i == j { 1.0 } else { r })
}

/// Mean of the entries off the diagonal.
fn off_diagonal(matrix: &Array2<f64>) -> f64 {
    (matrix.sum() - matrix.diag().sum()) / (matrix.len() - matrix.nrows()) as f64
}

#[test]
fn outliers_are_found_by_their_distance_from_the_others() {
    // Within a factor of 2 nothing is an outlier, however alike the others are.
    let mut chi2 = vec![1.0; 12];
    chi2[3] = 1.9;
    assert!(outliers(&chi2).iter().all(|out| !out));
    chi2[3] = 2.1;
    assert_eq!(outliers(&chi2).iter().position(|out| *out), Some(3));
    // Three of eight cannot hide one another, nor can a NaN; what is far below is no outlier.
    let found = outliers(&[1500.0, 9e5, 1400.0, f64::NAN, 1600.0, 8e5, 1450.0, 1.0, 1550.0]);
    assert_eq!(found, [false, true, false, true, false, true, false, false, false]);
    // A factor of 10 among values that spread by as much is none.
    let spread: Vec<f64> = (0..20).map(|i| 10f64.powf(f64::from(i) / 10.0)).collect();
    assert!(outliers(&spread).iter().all(|out| !out));
    // Images without any scatter are all alike.
    assert!(outliers(&[0.0; 9]).iter().all(|out| !out));
}

#[test]
fn a_row_far_from_the_others_is_found_in_any_direction() {
    let mut rows = draws(40, 60, 0.3, 1);
    // 3σ in each of 60 modes: ten times the others' square distance.
    rows.row_mut(7).mapv_inplace(|nm| nm + 3.0);
    let found = outliers(&distances(&rows));
    assert_eq!(found.iter().enumerate().filter(|(_, out)| **out).map(|(i, _)| i).collect::<Vec<_>>(), [7]);
}

#[test]
fn the_error_bars_are_those_of_mean_and_median() {
    // The true location is 0. Pulls of 400 independent modes scatter by 1/√800 = 3.5 % about 1, and
    // with error bars that are themselves from 50 images (10 % each for the mean, 16 % for the
    // median deviation) their square grows by 3 and 8 %: 4 standard deviations around that.
    let (images, modes) = (50, 400);
    let noise = Array2::from_diag_elem(modes, 1e-3);
    for (how, expected) in [(Combine::Mean, 1.015), (Combine::Median, 1.04)] {
        let rows = draws(images, modes, 0.0, 2);
        let variance = scatter(&rows, how, &noise).diag().mapv(|v| v * shrinkage_of_variance(how, images));
        let pulls = location(&rows, how).iter().zip(&variance).map(|(x, v)| x * x / v).sum::<f64>();
        let rms = (pulls / modes as f64).sqrt();
        assert!((rms - expected).abs() < 0.14, "{how:?}: {rms}");
    }
}

#[test]
fn correlations_of_few_images_are_those_of_the_noise() {
    // Draws with the correlation of the noise: 8 images of 60 modes show 0.3 ± 0.4, and shrinkage
    // gives 0.3.
    let rows = draws(8, 60, 0.3f64.sqrt(), 3);
    let noise = equicorrelated(60, 0.3);
    let found = scatter(&rows, Combine::Mean, &noise);
    // Variances are those of the scatter, where it is not below the noise.
    let sample = Array1::from_iter(rows.columns().into_iter().map(|c| c.var(1.0).max(1.0)));
    assert!(found.diag().iter().zip(&sample).all(|(a, b)| (a - b).abs() < 1e-12 * b));
    let correlation = correlation_of(&found);
    assert!((off_diagonal(&correlation) - 0.3).abs() < 0.1, "{}", off_diagonal(&correlation));
    // Positive, though there are fewer images than modes: the smallest eigenvalue of the target is
    // 0.7.
    let metric = crate::optimize::Metric::from_gauss_newton(&correlation, 1e-3).unwrap();
    assert_eq!(metric.rank(), 60);
}

#[test]
fn correlations_of_many_images_are_their_own() {
    // The noise says −0.01, the images have 0.6; 400 of them know it to 0.04 each, and all pairs
    // share one cause, whose strength 400 draws know to 0.05.
    let noise = equicorrelated(20, -0.01);
    for (how, expected) in [(Combine::Mean, 0.6), (Combine::Median, (0.6f64).asin() * 2.0 / std::f64::consts::PI)] {
        let rows = draws(400, 20, 0.6f64.sqrt(), 4);
        let found = off_diagonal(&correlation_of(&scatter(&rows, how, &noise)));
        // Of signs: 2/π·arcsin(r). Three times the spread.
        assert!((found - expected).abs() < 0.15, "{how:?}: {found} for {expected}");
    }
}

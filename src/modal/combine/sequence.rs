//! Statistics of a sequence: outliers among its images, their mean or median, and its covariance
//! from their scatter.

use crate::scene::Combine;
use crate::statistics::median;
use ndarray::{Array1, Array2, ArrayView1, Axis, Zip};

/// Fewest images of a sequence: the median and the median deviation of eight withstand three that
/// are arbitrarily bad, and the deviation is accurate to 40 %.
pub(in crate::modal) const SEQUENCE: usize = 8;
/// Images that scatter up to this many times as much as the others are never outliers: a mean of n
/// images gains by leaving one out only where its variance is more than 2 + 1/(n−1) times theirs.
const WORTH_LEAVING_OUT: f64 = 2.0;
/// Robust standard deviations beyond the median from which an image is an outlier (Iglewicz and
/// Hoaglin 1993, *How to Detect and Handle Outliers*): 2 of 10,000 normal ones are, 0.05 of a
/// sequence of 200.
const OUTLYING: f64 = 3.5;
/// Median deviation of a normal distribution to its standard deviation.
const NORMAL_MAD: f64 = 1.4826;
/// Variance of the median over that of the mean, for normal draws: its standard error is 1.2533
/// times as large.
const MEDIAN_VARIANCE: f64 = std::f64::consts::FRAC_PI_2;

/// Which of these variances are outliers: above the median by more than their own spread explains
/// (of the logarithms, because variances are positive and skewed), and so large that the mean gains
/// by leaving them out. NaN is an outlier.
pub(in crate::modal) fn outliers(variances: &[f64]) -> Vec<bool> {
    // A variance of 0 has an infinite logarithm, which would make all others outliers.
    let logarithm = |variance: &f64| variance.max(f64::MIN_POSITIVE).ln();
    let logarithms: Vec<f64> = variances.iter().filter(|v| !v.is_nan()).map(logarithm).collect();
    let middle = median(&logarithms);
    let spread = NORMAL_MAD * median_deviation(&logarithms, middle);
    let limit = middle + (OUTLYING * spread).max(WORTH_LEAVING_OUT.ln());
    variances.iter().map(|variance| variance.is_nan() || logarithm(variance) > limit).collect()
}

/// Distance of each row from the median of all: the mean over the columns of the squared difference
/// in units of the column's variance.
pub(in crate::modal) fn distances(rows: &Array2<f64>) -> Vec<f64> {
    let middle = location(rows, Combine::Median);
    let scatter = robust_variances(rows, &middle);
    let squares = |row: ArrayView1<f64>| -> f64 {
        let terms = row.iter().zip(&middle).zip(&scatter).filter(|(_, variance)| **variance > 0.0);
        terms.map(|((nm, middle), variance)| (nm - middle).powi(2) / variance).sum()
    };
    rows.outer_iter().map(|row| squares(row) / rows.ncols().max(1) as f64).collect()
}

/// Mean or median of each column.
pub(in crate::modal) fn location(rows: &Array2<f64>, how: Combine) -> Array1<f64> {
    match how {
        Combine::Mean | Combine::ClippedMean => rows.sum_axis(Axis(0)) / rows.nrows() as f64,
        Combine::Median => rows.columns().into_iter().map(|column| median(&column.to_vec())).collect(),
    }
}

/// Variance of the [`location`] of `count` images over that of one image.
pub(in crate::modal) fn shrinkage_of_variance(how: Combine, count: usize) -> f64 {
    let median = match how {
        // The median of one or two is their mean.
        Combine::Median if count > 2 => MEDIAN_VARIANCE,
        _ => 1.0,
    };
    median / count as f64
}

/// Covariance of one image's coefficients, from how they scatter: `rows` is `[image, mode]`, at
/// least two images.
///
/// The variances are those of the scatter, and at least those of the noise, which are known. The
/// correlations of fewer images than modes are singular, and those of few more images are mostly
/// noise: they are shrunk towards those of the noise (`noise_nm2`, one image's covariance by its
/// Fisher matrix) by the amount that minimises the expected square error (Schäfer and Strimmer
/// 2005, *Stat. Appl. Genet. Mol. Biol.* 4, 32, with that target). So images that differ by noise
/// alone have the Fisher matrix's correlations, and long sequences their own. For the median,
/// scatter is the median deviation, and the correlation is that of the signs of the deviations:
/// what medians have asymptotically.
pub(in crate::modal) fn scatter(rows: &Array2<f64>, how: Combine, noise_nm2: &Array2<f64>) -> Array2<f64> {
    let centre = location(rows, how);
    let deviations = rows - &centre.view().insert_axis(Axis(0));
    let (variances, standard) = match how {
        Combine::Median => (robust_variances(rows, &centre), deviations.mapv(sign)),
        Combine::Mean | Combine::ClippedMean => {
            let freedom = rows.nrows().saturating_sub(1).max(1) as f64;
            ((&deviations * &deviations).sum_axis(Axis(0)) / freedom, deviations)
        }
    };
    let sigma = Zip::from(&variances).and(noise_nm2.diag()).map_collect(|scatter, noise| scatter.max(*noise).sqrt());
    let mut covariance = correlation(standard, &correlation_of(noise_nm2));
    covariance *= &sigma.view().insert_axis(Axis(1));
    covariance *= &sigma.view().insert_axis(Axis(0));
    covariance
}

/// Correlation matrix of the columns of `deviations`, shrunk towards `target`.
fn correlation(mut deviations: Array2<f64>, target: &Array2<f64>) -> Array2<f64> {
    let count = deviations.nrows() as f64;
    for mut column in deviations.columns_mut() {
        let rms = (column.dot(&column) / count).sqrt();
        column.mapv_inplace(|z| if rms > 0.0 { z / rms } else { 0.0 });
    }
    let sample = deviations.t().dot(&deviations) / count;
    // Variance of each entry, an average of z_i·z_j over the images: (⟨z_i² z_j²⟩ − r²)/(n − 1).
    let squares = deviations.mapv(|z| z * z);
    let fourth = squares.t().dot(&squares) / count;
    let (mut noise, mut distance) = (0.0, 0.0);
    for ((at, r), fourth) in sample.indexed_iter().zip(&fourth).filter(|(((i, j), _), _)| i != j) {
        noise += (fourth - r * r) / (count - 1.0);
        distance += (r - target[at]).powi(2);
    }
    let towards = if distance > 0.0 { (noise / distance).clamp(0.0, 1.0) } else { 1.0 };
    let mut shrunk = target * towards + sample * (1.0 - towards);
    shrunk.diag_mut().fill(1.0);
    shrunk
}

/// The correlation matrix of a covariance; a mode without variance has no correlation with others.
fn correlation_of(covariance: &Array2<f64>) -> Array2<f64> {
    let scale = covariance.diag().mapv(|v| if v > 0.0 { v.sqrt().recip() } else { 0.0 });
    let mut correlation = covariance * &scale.view().insert_axis(Axis(1)) * scale.view().insert_axis(Axis(0));
    correlation.diag_mut().fill(1.0);
    correlation
}

/// Squared median deviations, scaled to variances of normal draws.
fn robust_variances(rows: &Array2<f64>, middle: &Array1<f64>) -> Array1<f64> {
    let deviation = |(column, middle): (ArrayView1<f64>, &f64)| median_deviation(&column.to_vec(), *middle);
    rows.columns().into_iter().zip(middle).map(deviation).map(|mad| (NORMAL_MAD * mad).powi(2)).collect()
}

fn median_deviation(values: &[f64], middle: f64) -> f64 {
    median(&values.iter().map(|value| (value - middle).abs()).collect::<Vec<_>>())
}

fn sign(value: f64) -> f64 {
    if value == 0.0 { 0.0 } else { value.signum() }
}

#[cfg(test)]
mod tests;

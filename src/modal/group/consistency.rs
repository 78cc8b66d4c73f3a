//! Whether the images of a group are of one wavefront.
//!
//! At the minimum of all, g_i = −½ ∇J_i is what image i alone would change: its own minimum is
//! Λ_i⁺ g_i away. (A prior moves the minimum: g_i less Λ_i Λ⁺ Σ g_j is that at the minimum without
//! it.) In coordinates in which the information of all is 1, with M_i that of image i,
//! g_i has the covariance M − M² where the images are of one wavefront by one model. So the sum of
//! (v·g_i)²/μ over the eigenvectors v of M_i and its eigenvalues μ has the expectation Σ (1 − μ).
//! Directions of which an image knows little cannot contradict, and are left out.

use crate::Result;
use crate::modal::assess::fisher::{null_floor, root_of_pseudo_inverse, score_without, without};
use crate::modal::group::fit::Group;
use crate::optimize::Metric;
use ndarray::{Array1, Array2};

/// Share of an image's best known direction below which a direction of it is left out.
const LEAST_SHARE: f64 = 0.1;

/// Differences of the images of a group from the wavefront of all.
pub(super) struct Consistency {
    /// Reduced χ² of the differences and its degrees of freedom; (1, 0) where there are none.
    pub(super) of_all: (f64, f64),
    /// Reduced χ² of each image.
    pub(super) of_each: Vec<f64>,
}

/// The differences of the images, where they have the Gauss-Newton matrices `each` and the
/// `scores` g_i; variances are `scale` times those of the noise.
///
/// # Errors
/// [`crate::Error::Value`] where no mode changes the images.
pub(super) fn consistency(
    group: &Group,
    each: &[Array2<f64>],
    scores: Vec<Array1<f64>>,
    scale: f64,
) -> Result<Consistency> {
    let tilts = group.unknowns.tilts();
    let shared = group.unknowns.shared();
    let of_image = |(own, score): (&Array2<f64>, Array1<f64>)| {
        // The own tip and tilt of an image take up what is along them.
        let score = score_without(own, score, &tilts);
        (without(own.clone(), &tilts), score)
    };
    let each = each.iter().zip(scores).map(of_image).collect::<Vec<_>>();
    let all = each.iter().fold(Array2::zeros((shared, shared)), |sum, (own, _)| sum + own);
    let root = root_of_pseudo_inverse(&all, null_floor(shared, group.pixels()))?;
    let (mut chi2, mut freedom, mut of_each) = (0.0, 0.0, Vec::new());
    let pull: Array1<f64> = each.iter().fold(Array1::zeros(shared), |sum, (_, score)| sum + score);
    let pull = root.t().dot(&pull);
    for (own, score) in &each {
        let before = (chi2, freedom);
        let own = root.t().dot(&own.dot(&root));
        let score = root.t().dot(score) - own.dot(&pull);
        // Columns v/√μ.
        let metric = Metric::from_gauss_newton(&((&own + &own.t()) * 0.5), LEAST_SHARE);
        let columns = metric.ok().and_then(|metric| metric.whitening().map(|columns| columns.to_owned()));
        let columns = columns.unwrap_or_else(|| Array2::zeros((score.len(), 0)));
        for column in columns.columns() {
            chi2 += column.dot(&score).powi(2) / scale;
            freedom += (1.0 - column.dot(&column).recip()).max(0.0);
        }
        of_each.push((chi2 - before.0) / (freedom - before.1).max(1.0));
    }
    let of_all = if freedom >= 1.0 { (chi2 / freedom, freedom) } else { (1.0, 0.0) };
    Ok(Consistency { of_all, of_each })
}

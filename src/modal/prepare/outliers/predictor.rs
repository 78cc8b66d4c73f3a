//! Prediction of a pixel from those around it.

use crate::fourier::disc;
use cophase_numerics::cholesky::Cholesky;
use ndarray::{Array2, ArrayView2, Axis};

/// Half a side of the pixels from which one is predicted.
pub(super) const REACH: usize = 3;
/// Their number.
pub(super) const AROUND: usize = (2 * REACH + 1).pow(2) - 1;
/// Places of a line that differ in what is around them: those near one end, in the middle, and near
/// the other end.
pub(super) const EDGES: usize = 2 * REACH + 1;

/// Predictions of pixels of frames of one sampling and brightness.
pub(super) struct Predictor {
    /// Rows and columns from a pixel to those that predict it.
    pub(super) offsets: Vec<[isize; 2]>,
    /// Variance of the noise as a share of that of the light.
    noise_share: f64,
    /// Covariance of these with each other, and with the pixel.
    covariance: Array2<f64>,
    with_pixel: Array2<f64>,
    /// The pixels around one that are in the frame, and the prediction from them where none is bad:
    /// for each place of a row and of a column that differs ([`Predictor::edge`]).
    pub(super) predictions: Vec<(Vec<usize>, Prediction)>,
}

/// Prediction of a pixel from those around it.
pub(super) struct Prediction {
    /// Share of each.
    pub(super) shares: Vec<f64>,
    /// Variance of the difference for noise of variance 1 in every pixel.
    pub(super) noise: f64,
    /// The same for light of mean 1.
    pub(super) light: f64,
}

impl Predictor {
    pub(super) fn new(sampling: f64, noise_share: f64) -> Option<Self> {
        let reach = REACH as isize;
        let all = (-reach..=reach).flat_map(|y| (-reach..=reach).map(move |x| [y, x]));
        let offsets: Vec<[isize; 2]> = all.filter(|offset| *offset != [0, 0]).collect();
        let between = |[y, x]: [isize; 2], [v, u]: [isize; 2]| {
            1.0 + disc(((y - v) as f64).hypot((x - u) as f64) / sampling / 2.0)
        };
        let covariance = Array2::from_shape_fn((AROUND, AROUND), |(i, j)| {
            between(offsets[i], offsets[j]) + if i == j { noise_share } else { 0.0 }
        });
        let with_pixel = Array2::from_shape_fn((AROUND, 1), |(i, _)| between(offsets[i], [0, 0]));
        let mut predictor = Self { offsets, noise_share, covariance, with_pixel, predictions: Vec::new() };
        // The distance of a pixel to the nearer border decides what is around it, in each
        // direction.
        for [y, x] in (0..EDGES).flat_map(|y| (0..EDGES).map(move |x| [y, x])) {
            let is_inside = |offset: isize, edge: usize| match edge {
                0..REACH => offset >= -(edge as isize),
                REACH => true,
                _ => offset <= (EDGES - 1 - edge) as isize,
            };
            let around =
                (0..AROUND).filter(|&i| is_inside(predictor.offsets[i][0], y) && is_inside(predictor.offsets[i][1], x));
            let around: Vec<usize> = around.collect();
            let prediction = predictor.prediction(&around)?;
            predictor.predictions.push((around, prediction));
        }
        Some(predictor)
    }

    /// The prediction of a pixel from these of those around it.
    pub(super) fn prediction(&self, around: &[usize]) -> Option<Prediction> {
        let covariance = self.covariance.select(Axis(0), around).select(Axis(1), around);
        Prediction::new(covariance.view(), self.with_pixel.select(Axis(0), around).view(), self.noise_share)
    }

    /// Which pixels are around one at this place of a line of `size`.
    pub(super) fn edge(at: usize, size: usize) -> usize {
        if at < REACH { at } else { (EDGES + at).saturating_sub(size).max(REACH) }
    }
}

impl Prediction {
    fn new(covariance: ArrayView2<f64>, with_pixel: ArrayView2<f64>, noise_share: f64) -> Option<Self> {
        let shares = Cholesky::new(covariance).ok()?.solve(with_pixel).into_raw_vec_and_offset().0;
        let explained: f64 = shares.iter().zip(with_pixel).map(|(share, with)| share * with).sum();
        let noise: f64 = shares.iter().map(|share| share * share).sum();
        // 2 is the mean square of speckle of mean 1. The error of the prediction has a part from
        // the noise that it was made for.
        Some(Self { shares, noise: 1.0 + noise, light: (2.0 - explained - noise_share * noise).max(0.0) })
    }
}

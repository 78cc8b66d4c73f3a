//! χ² of an exposure under a fitted model, with its expectation and its scatter.

use crate::imaging::{Exposure, Photometry};

/// Independent partial sums, so that they are vectorised.
const LANES: usize = 8;

/// Variance of a pixel whose expected signal is `electrons`: photon noise, and the floor (infinite
/// for a bad pixel).
pub(in crate::modal) fn pixel_variance(electrons: f64, floor_variance_e2: f64) -> f64 {
    electrons.max(0.0) + floor_variance_e2
}

/// χ² per degree of freedom of a minimum, and its distribution where the model is right.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ReducedChi2 {
    /// χ² per degree of freedom.
    pub(crate) value: f64,
    /// Smallest expectation: 1 where all variances are stated, the stated part of them on average
    /// otherwise.
    pub(crate) least: f64,
    /// Standard deviation.
    pub(crate) scatter: f64,
    /// Square of the star's signal-to-noise ratio, over all pixels.
    pub(crate) square_snr: f64,
    /// Degrees of freedom.
    pub(crate) freedom: f64,
}

impl ReducedChi2 {
    /// That of a fit without a result.
    pub(in crate::modal) const NONE: Self =
        Self { value: f64::NAN, least: f64::NAN, scatter: f64::NAN, square_snr: f64::NAN, freedom: f64::NAN };

    /// What a relative error `error` of the star's image adds to it.
    pub(in crate::modal) fn excess(&self, error: f64) -> f64 {
        error.powi(2) * self.square_snr / self.freedom
    }

    /// χ² of `exposure` under the model with this PSF, flux and background.
    ///
    /// A pixel with μ expected electrons and the floor f has the variance v = μ + f, of which μ + s
    /// f are stated
    /// ([`PreparedFrame::stated_share`](crate::modal::prepare::PreparedFrame::stated_share)). Its
    /// share of χ² has the expectation (μ + s f)/v or more, and the variance 2 + μ/v²: that of a
    /// square of a normal variable, and the excess kurtosis of μ Poisson electrons.
    pub(in crate::modal) fn new(
        psf: &[f64],
        (flux_e, background_e): (f64, f64),
        exposure: &Exposure,
        (floor_variance_e2, stated_share): (&[f64], f64),
        modes: usize,
    ) -> Self {
        let mut sums = [[0.0; LANES]; 5];
        let [squares, good, photons, kurtosis, square_snr] = &mut sums;
        let pixels = psf.chunks(LANES).zip(exposure.data_e.chunks(LANES)).zip(floor_variance_e2.chunks(LANES));
        for ((psf, data), floor) in pixels {
            for (i, ((h, d), &floor)) in psf.iter().zip(data).zip(floor).enumerate() {
                let expected = flux_e * h + background_e;
                // An infinite variance excludes a pixel.
                let weight = 1.0 / pixel_variance(expected, floor);
                let share = expected.max(0.0) * weight;
                squares[i] += (expected - d).powi(2) * weight;
                good[i] += if floor < f64::INFINITY { 1.0 } else { 0.0 };
                photons[i] += share;
                kurtosis[i] += share * weight;
                square_snr[i] += (flux_e * h).powi(2) * weight;
            }
        }
        let [squares, good, photons, kurtosis, square_snr] = sums.map(|lanes| lanes.iter().sum::<f64>());
        let freedom = (good as usize).saturating_sub(modes + nuisances(exposure)).max(1) as f64;
        Self {
            value: squares / freedom,
            least: stated_share + (1.0 - stated_share) * photons / good.max(1.0),
            scatter: (2.0 * freedom + kurtosis).sqrt() / freedom,
            square_snr,
            freedom,
        }
    }
}

/// Number of photometric parameters that are fitted to an exposure.
pub(in crate::modal) fn nuisances(exposure: &Exposure) -> usize {
    match exposure.photometry {
        Photometry::Fixed { .. } => 0,
        Photometry::FitFlux { .. } => 1,
        Photometry::FitBoth => 2,
    }
}

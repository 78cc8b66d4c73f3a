//! Noise of a reduced image.
//!
//! For a frame of `c` coadds with the noise `r` of a dark (electrons RMS of one coadd: reads and
//! dark current, measured where there are two darks, else the read noise that is stated), dark `D`
//! of `k` frames of `C` coadds each and a sky from `n` frames of `c'` coadds with the level `B`,
//! scaled by `s`, the variance of a pixel without light of the star is
//!
//! ```text
//! c·r²                                   the reads of the frame
//! + c²·r²/C·v(k)                         the dark; none where the sky had the same dark and s·c' = c, for then it cancels
//! + v(n)·s²·(c'·r² + B) + s·B            the sky: its frames, and the photons of the sky in the frame itself
//! ```
//!
//! with `v(n)` the variance of a median over that of one value. Its root is the card `RON_E`. The
//! noise of the flat is neglected: a flat of 10⁵ electrons adds 0.3 % of a pixel's signal, as much
//! as photon noise at 10⁵ electrons.

use crate::statistics::{NORMAL_MEDIAN_DEVIATION, median};

/// Variance of the median of `count` normal values over the variance of one: π/(2·(count + π/2 −
/// 1)) for odd counts (within 2 % of Kendall & Stuart, The Advanced Theory of Statistics, vol. 1,
/// section 14), of two values that of their mean, and of other even counts that of one value less,
/// times the gain of the mean of the middle two.
pub(super) fn median_variance(count: usize) -> f64 {
    use std::f64::consts::PI;
    match count {
        0 => 0.0,
        2 => 0.5,
        4 => 0.298,
        6 => 0.215,
        _ => PI / (2.0 * (count as f64 + PI / 2.0 - 1.0)),
    }
}

/// Robust standard deviation of the finite values about their median.
pub(super) fn scatter(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    let centre = median(&values);
    values.iter_mut().for_each(|value| *value = (*value - centre).abs());
    median(&values) / NORMAL_MEDIAN_DEVIATION
}

/// Deviations, in robust standard deviations, within which values count for [`clipped_scatter`]: of
/// normal noise all but 6e-7.
const CLIP: f64 = 5.0;

/// Standard deviation of the finite values but for outliers. The median deviation of whole counts
/// is itself a whole count, which is off by 5 % for noise of 5 counts; the root mean square is not.
pub(super) fn clipped_scatter(values: impl Iterator<Item = f64>) -> f64 {
    let values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
    let centre = median(&values);
    let rms = |limit: f64| {
        let within = values.iter().map(|value| (value - centre).abs()).filter(|deviation| *deviation <= limit);
        let (sum, count) =
            within.fold((0.0, 0usize), |(sum, count), deviation| (sum + deviation * deviation, count + 1));
        (sum / count as f64).sqrt()
    };
    let robust = scatter(values.iter().copied());
    // More than half of the values are equal where the noise is below half a count.
    rms(CLIP * if robust > 0.0 { robust } else { rms(f64::INFINITY) })
}

/// What the noise of a frame is made of; see the module.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct NoiseTerms {
    /// `c`.
    pub(super) coadds: f64,
    /// `r`, electrons.
    pub(super) read_noise_e: f64,
    /// `v(k)/C`; 0 without a dark.
    pub(super) dark: f64,
    /// The sky, where one is subtracted.
    pub(super) sky: Option<SkyTerms>,
}

/// What the noise of a sky is made of.
#[derive(Debug, Clone, Copy)]
pub(super) struct SkyTerms {
    /// `v(n)`.
    pub(super) variance: f64,
    /// `s`.
    pub(super) scale: f64,
    /// `c'`.
    pub(super) coadds: f64,
    /// `B`, electrons in a frame of the sky.
    pub(super) level_e: f64,
    /// `v(k)/C` of the sky's dark, and whether it is the frame's.
    pub(super) dark: f64,
    pub(super) has_same_dark: bool,
}

impl NoiseTerms {
    /// Variance of a pixel without light of the star, electrons².
    pub(super) fn variance(&self) -> f64 {
        let read = self.read_noise_e.powi(2);
        let own_dark = self.coadds.powi(2) * self.dark * read;
        let frame = self.coadds * read;
        let Some(sky) = self.sky else { return frame + own_dark };
        let sky_dark = (sky.scale * sky.coadds).powi(2) * sky.dark * read;
        let darks = if sky.has_same_dark {
            (self.coadds - sky.scale * sky.coadds).powi(2) * self.dark * read
        } else {
            own_dark + sky_dark
        };
        let level_e = sky.level_e.max(0.0);
        let of_sky = sky.variance * sky.scale.powi(2) * (sky.coadds * read + level_e);
        frame + darks + of_sky + sky.scale * level_e
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_is_that_of_its_terms() {
        let bare = NoiseTerms { coadds: 4.0, read_noise_e: 10.0, dark: 0.0, sky: None };
        assert_eq!(bare.variance(), 400.0);
        // One dark of 4 coadds is as noisy as the frame.
        assert_eq!(NoiseTerms { dark: 1.0 / 4.0, ..bare }.variance(), 800.0);
        // A − B of equal frames, whose dark cancels: twice the reads and the sky's photons.
        let sky = SkyTerms { variance: 1.0, scale: 1.0, coadds: 4.0, level_e: 50.0, dark: 0.25, has_same_dark: true };
        assert_eq!(NoiseTerms { dark: 0.25, sky: Some(sky), ..bare }.variance(), 900.0);
    }

    #[test]
    fn noise_of_whole_counts_is_measured_without_their_steps() {
        use rand_distr::{Distribution, StandardNormal};
        let mut rng = crate::source::stream(2, 0);
        for sigma in [0.3, 1.0, 5.0, 7.07] {
            let mut values: Vec<f64> = (0..20_000)
                .map(|_| {
                    let normal: f64 = StandardNormal.sample(&mut rng);
                    (sigma * normal).round()
                })
                .collect();
            // A cosmic ray in 1,000 pixels.
            values.iter_mut().step_by(1000).for_each(|value| *value += 500.0);
            let expected = (sigma * sigma + 1.0 / 12.0f64).sqrt();
            let found = clipped_scatter(values.into_iter());
            // 20,000 values know it to 0.5 %: four times that; below half a count the rounding is
            // no uniform noise.
            let tolerance = if sigma < 0.5 { 0.3 } else { 0.02 };
            assert!((found / expected - 1.0).abs() < tolerance, "{sigma}: {found}");
        }
    }

    #[test]
    fn medians_are_as_noisy_as_draws_of_them() {
        use rand_distr::{Distribution, StandardNormal};
        let mut rng = crate::source::stream(1, 0);
        for count in 1..=12 {
            let draws: Vec<f64> = (0..4000)
                .map(|_| median(&(0..count).map(|_| StandardNormal.sample(&mut rng)).collect::<Vec<f64>>()))
                .collect();
            let variance = draws.iter().map(|draw| draw * draw).sum::<f64>() / draws.len() as f64;
            // A variance of 4000 draws is known to 2.2 %: four times that; even counts are below
            // the formula by up to 6 %.
            let ratio = variance / median_variance(count);
            assert!((0.85..1.09).contains(&ratio), "{count}: {ratio}");
        }
    }
}

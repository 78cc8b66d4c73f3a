//! Why a frame cannot be used.

use super::extent::Extent;
use std::fmt;

/// Noises by which the brightest pixel exceeds the border's level where there is a star whose light
/// may be lost in the noise of all pixels: as in 74 of 200 frames of 96 × 96 with a star in focus
/// whose peak has 20 noises. Of 100 million pixels of noise none is beyond.
const STAR: f64 = 6.0;

/// Why a frame cannot be used. A value without text, so that it can be returned where nothing may
/// be allocated; `Display` writes the sentence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Refusal {
    /// All pixels are bad, in the frame or in the part of it that is fitted.
    NoGoodPixel,
    /// Too few are good.
    FewGoodPixels {
        /// Number of good pixels.
        good: usize,
    },
    /// All good pixels have the same value.
    Constant {
        /// Value of all good pixels, e⁻.
        value: f64,
    },
    /// No good pixel is above 0.
    NoPositivePixel {
        /// The largest value, e⁻.
        largest: f64,
    },
    /// The frame is no brighter than its border.
    NoStar {
        /// Electrons above the border's level.
        flux_e: f64,
    },
    /// The fit ends with a negative star: the scene does not describe the image.
    NegativeStar {
        /// Electrons of the star that was fitted.
        flux_e: f64,
    },
    /// The star that was fitted is no brighter than what a fit makes of noise.
    FaintStar {
        /// Its signal-to-noise ratio over all pixels.
        snr: f64,
        /// The least that is accepted.
        least_snr: f64,
    },
    /// Pixels are bad in a frame whose sampling is to be reduced.
    BadPixelsWouldRing {
        /// Number of bad pixels.
        bad: usize,
    },
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the image ")?;
        match self {
            Self::NoGoodPixel => f.write_str(
                "has no good pixel in the part that is fitted: all are bad or not finite there (in a map of good pixels true and false must change places)",
            ),
            Self::FewGoodPixels { good } => write!(f, "has only {good} good pixels: at least 64 are needed"),
            Self::Constant { value } => write!(f, "is constant: every good pixel holds {value}"),
            Self::NoPositivePixel { largest } => {
                write!(f, "has no positive pixel: the largest value is {largest}, and electrons are needed")
            }
            Self::NoStar { flux_e } => {
                write!(
                    f,
                    "holds no star: its flux above the border's level is {flux_e:.3e}, where that of a star is positive, or is lost \
                     in the noise of the frame beside a pixel of six noises and more"
                )
            }
            Self::NegativeStar { flux_e } => write!(
                f,
                "does not resemble those of the scene: the star that fits it best has {flux_e:.3e} electrons, which must be positive"
            ),
            Self::FaintStar { snr, least_snr } => write!(
                f,
                "holds no star that differs from noise: its signal-to-noise ratio over all pixels is {snr:.1}, and at least \
                 {least_snr:.1} is needed for the modes of this scene"
            ),
            Self::BadPixelsWouldRing { bad } => write!(
                f,
                "has {bad} bad pixels, which would ring where the sampling is reduced: estimate.sampling = \"native\" \
                 accepts them"
            ),
        }
    }
}

/// Refuses frames without a star in them. `level` is the border's, `noise_e` that of a pixel
/// without light.
pub(super) fn refuse_unusable(rows: &[Extent], level: f64, noise_e: f64) -> Result<(), Refusal> {
    let Extent { good, least, most, sum } = rows.iter().fold(Extent::EMPTY, |all, row| all.and(row));
    let flux_e = sum - level * good as f64;
    // Noise, with the error that it makes of the level, takes less than one noise a pixel.
    let is_seen = most - level > STAR * noise_e && flux_e > -noise_e * good as f64;
    match good {
        0 => Err(Refusal::NoGoodPixel),
        // Fewer pixels than this cannot fix even a handful of modes.
        1..64 => Err(Refusal::FewGoodPixels { good }),
        _ if least == most => Err(Refusal::Constant { value: least }),
        _ if most <= 0.0 => Err(Refusal::NoPositivePixel { largest: most }),
        _ if flux_e <= 0.0 && !is_seen => Err(Refusal::NoStar { flux_e }),
        _ => Ok(()),
    }
}

//! Why a frame cannot be used.

use std::fmt;

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

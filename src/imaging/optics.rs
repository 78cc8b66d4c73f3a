//! The immutable optical model of one scene, in double precision, from which every chain is
//! constructed.

use crate::fourier::{PixelResponse, Sampling};
use crate::modes::SeparableBasis;
use crate::pupil::SegmentWeights;
use crate::{Error, Result};
use ndarray::Array2;
use std::borrow::Cow;

/// Effect of one coefficient. Its unit is nm of OPD.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Mode {
    /// Piston of a segment.
    Piston(usize),
    /// Tilt of a segment along x, unit RMS over the segment.
    Tip(usize),
    /// Tilt of a segment along y, unit RMS over the segment.
    Tilt(usize),
    /// Row of the smooth basis.
    Smooth(usize),
}

/// One wavelength of a polychromatic model.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Colour {
    /// Ratio of this wavelength to that of the model.
    pub ratio: f64,
    /// Fraction of the flux.
    pub share: f64,
}

impl Colour {
    /// All flux at the wavelength of the model.
    pub const MONOCHROMATIC: Self = Self { ratio: 1.0, share: 1.0 };
}

/// The arrays of an [`Optics`].
#[derive(Debug, Clone)]
pub struct OpticsParts {
    /// Sizes of pupil and image.
    pub sampling: Sampling,
    /// Wavelength of the model, nm, to which `sampling` refers.
    pub wavelength_nm: f64,
    /// The wavelengths, whose images are added; the fractions sum to 1.
    pub colours: Vec<Colour>,
    /// Response of a pixel of the model along x and y.
    pub pixel: [PixelResponse; 2],
    /// Weights of the segments in the illuminated samples.
    pub weights: SegmentWeights,
    /// Coordinates of each entry of `weights` on its segment along x and y, scaled to unit RMS over
    /// the segment; required where a mode is the tip or tilt of a segment.
    pub slopes: Option<(Vec<f64>, Vec<f64>)>,
    /// Diversity at the illuminated samples, nm.
    pub diversity_nm: Vec<f64>,
    /// Smooth modes at the illuminated samples, `[mode, sample]`, nm per nm.
    pub basis: Array2<f64>,
    /// The same modes on the whole grid as sums of products of functions of x and y, if available.
    pub products: Option<SeparableBasis>,
    /// Effect of each coefficient.
    pub modes: Vec<Mode>,
}

/// The model of one scene: pupil, diversity, modes, sampling. Immutable, and shared by all chains
/// and threads.
#[derive(Debug, Clone)]
pub struct Optics {
    parts: OpticsParts,
    /// The wavelength that this model represents, where it is a part of a polychromatic one.
    colour: Colour,
}

impl Optics {
    /// Checks that the parts fit each other.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Value`], naming the part.
    pub fn new(parts: OpticsParts) -> Result<Self> {
        let illuminated = parts.weights.illuminated.len();
        let entries = parts.weights.weight.len();
        let samples = parts.sampling.samples;
        if !(parts.wavelength_nm.is_finite() && parts.wavelength_nm > 0.0) {
            return Err(Error::Value(format!(
                "a wavelength of {} nm is impossible: a positive number is needed",
                parts.wavelength_nm
            )));
        }
        let bad = |value: f64| !(value.is_finite() && value > 0.0);
        let total: f64 = parts.colours.iter().map(|colour| colour.share).sum();
        // The fractions are quotients, with a rounding of 1e-16 each.
        if parts.colours.iter().any(|colour| bad(colour.ratio) || bad(colour.share)) || (total - 1.0).abs() > 1e-9 {
            let text = format!(
                "the wavelengths {:?} are impossible: positive ratios, and positive shares of sum 1 are needed",
                parts.colours
            );
            return Err(Error::Value(text));
        }
        if illuminated == 0 || !(parts.weights.energy.is_finite() && parts.weights.energy > 0.0) {
            return Err(Error::Value("the pupil has no illuminated sample: at least one is needed".into()));
        }
        if parts.weights.illuminated.iter().any(|&p| p as usize >= samples * samples) {
            return Err(Error::Shape(format!(
                "an illuminated sample is outside the pupil grid of {samples}x{samples} samples"
            )));
        }
        let fits = parts.weights.offsets.len() == illuminated + 1
            && parts.weights.segment.len() == entries
            && parts.weights.offsets.last() == Some(&(entries as u32))
            && parts.weights.segment.iter().all(|&s| (s as usize) < parts.weights.segments);
        if !fits {
            return Err(Error::Shape(
                "the segment weights do not fit the illuminated samples: see SegmentWeights for the format".into(),
            ));
        }
        for (what, length) in [("diversity", parts.diversity_nm.len()), ("smooth basis", parts.basis.ncols())] {
            if length != illuminated {
                return Err(Error::Shape(format!(
                    "the {what} has {length} samples, and the pupil {illuminated} illuminated ones: as many are needed"
                )));
            }
        }
        if let Some(products) = &parts.products {
            let functions: usize = products.groups.iter().sum();
            let coefficients: usize = products.groups.iter().map(|k| k * k).sum();
            let fit = products.lines.dim() == (functions, samples)
                && products.matrix.dim() == (parts.basis.nrows(), coefficients)
                && products.lines.iter().chain(&products.matrix).all(|v| v.is_finite());
            if !fit {
                return Err(Error::Shape("the products of functions do not fit the smooth basis on this grid".into()));
            }
        }
        let finite = parts.diversity_nm.iter().chain(&parts.basis).chain(&parts.weights.weight).all(|v| v.is_finite());
        if !finite {
            return Err(Error::Value(
                "the diversity, a mode or the pupil contains a value that is not finite: finite numbers are needed"
                    .into(),
            ));
        }
        for mode in &parts.modes {
            let ok = match *mode {
                Mode::Smooth(row) => row < parts.basis.nrows(),
                Mode::Piston(segment) => segment < parts.weights.segments,
                Mode::Tip(segment) | Mode::Tilt(segment) => {
                    segment < parts.weights.segments
                        && parts.slopes.as_ref().is_some_and(|(x, y)| x.len() == entries && y.len() == entries)
                }
            };
            if !ok {
                return Err(Error::Shape(format!(
                    "{mode:?} refers to a segment or a basis row that the model does not have"
                )));
            }
        }
        Ok(Self { parts, colour: Colour::MONOCHROMATIC })
    }

    /// The arrays.
    pub fn parts(&self) -> &OpticsParts {
        &self.parts
    }

    /// Number of coefficients.
    pub fn modes(&self) -> usize {
        self.parts.modes.len()
    }

    /// Sizes of pupil and image.
    pub fn sampling(&self) -> Sampling {
        self.parts.sampling
    }

    /// The monochromatic models of all wavelengths, whose images are added. A pixel is a fixed
    /// angle: in units of λ/D it is smaller for a longer λ.
    pub fn colours(&self) -> Vec<Cow<'_, Self>> {
        let monochromatic = |&colour: &Colour| {
            let Sampling { samples, pixels, pixels_per_lambda_over_d } = self.parts.sampling;
            let parts = OpticsParts {
                sampling: Sampling {
                    samples,
                    pixels,
                    pixels_per_lambda_over_d: pixels_per_lambda_over_d * colour.ratio,
                },
                wavelength_nm: self.parts.wavelength_nm * colour.ratio,
                colours: vec![Colour::MONOCHROMATIC],
                ..self.parts.clone()
            };
            Cow::Owned(Self { parts, colour })
        };
        if self.has_one_wavelength() {
            vec![Cow::Borrowed(self)]
        } else {
            self.parts.colours.iter().map(monochromatic).collect()
        }
    }

    /// Whether the model is monochromatic.
    pub fn has_one_wavelength(&self) -> bool {
        self.parts.colours == [Colour::MONOCHROMATIC]
    }

    /// The wavelength that this model represents in a polychromatic one; [`Colour::MONOCHROMATIC`]
    /// for a complete model.
    pub(super) fn colour(&self) -> Colour {
        self.colour
    }

    /// Factor of |U|² with which the PSF sums to the flux fraction over an unbounded detector: by
    /// Parseval, the fraction times 1/((n·q)²·ΣA²).
    pub fn intensity_scale(&self) -> f64 {
        self.colour.share * self.parts.sampling.step().powi(2) / self.parts.weights.energy
    }

    /// The diversity in turns, reduced to [−½, ½]: the same field, without loss of accuracy in
    /// single precision.
    pub fn diversity_turns(&self) -> Vec<f64> {
        let turns = |nm: &f64| nm / self.parts.wavelength_nm;
        self.parts.diversity_nm.iter().map(turns).map(|t| t - t.round()).collect()
    }

    /// Whether any coefficient tilts a segment.
    pub fn tilts_segments(&self) -> bool {
        self.parts.modes.iter().any(|mode| matches!(mode, Mode::Tip(_) | Mode::Tilt(_)))
    }
}

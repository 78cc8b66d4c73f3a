//! What light meets: the immutable model of one scene, in double precision, from which every chain is made.

use crate::fourier::Sampling;
use crate::modes::Separable;
use crate::pupil::SegmentWeights;
use crate::{Error, Result};
use ndarray::Array2;

/// What one coefficient moves. Its unit is nm of OPD.
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

/// One of the wavelengths that a model's image is made of.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Colour {
    /// Its wavelength over that of the model.
    pub ratio: f64,
    /// Its share of the light.
    pub share: f64,
}

impl Colour {
    /// All light, at the model's own wavelength.
    pub const ALONE: Self = Self { ratio: 1.0, share: 1.0 };
}

/// The plain arrays that make an [`Optics`].
#[derive(Debug, Clone)]
pub struct OpticsParts {
    /// Shapes of pupil and image.
    pub sampling: Sampling,
    /// Wavelength, nm: the one to which `sampling` belongs.
    pub wavelength_nm: f64,
    /// The wavelengths of the light, whose images add; shares sum to 1.
    pub colours: Vec<Colour>,
    /// How the segments show in the lit samples.
    pub weights: SegmentWeights,
    /// Coordinates of each entry of `weights` on its segment along x and y, scaled to unit RMS over the segment; needed
    /// only where a mode is a segment's tip or tilt.
    pub slopes: Option<(Vec<f64>, Vec<f64>)>,
    /// Diversity at the lit samples, nm.
    pub diversity_nm: Vec<f64>,
    /// Smooth modes at the lit samples, `[mode, lit]`, nm per nm.
    pub basis: Array2<f64>,
    /// The same modes on the whole grid as products of functions of x and y, where they are known so.
    pub products: Option<Separable>,
    /// What each coefficient moves.
    pub modes: Vec<Mode>,
}

/// The model of one scene: pupil, diversity, modes, sampling. Immutable, and shared by all chains and threads.
#[derive(Debug, Clone)]
pub struct Optics {
    parts: OpticsParts,
    /// What part of the whole this is, where it is one colour of a model of several.
    colour: Colour,
}

impl Optics {
    /// Checks that the parts fit each other.
    ///
    /// # Errors
    /// [`Error::Shape`] or [`Error::Value`], naming the part.
    pub fn new(parts: OpticsParts) -> Result<Self> {
        let lit = parts.weights.lit.len();
        let entries = parts.weights.weight.len();
        let samples = parts.sampling.samples;
        if !(parts.wavelength_nm.is_finite() && parts.wavelength_nm > 0.0) {
            return Err(Error::Value(format!("a wavelength of {} nm is impossible", parts.wavelength_nm)));
        }
        let bad = |value: f64| !(value.is_finite() && value > 0.0);
        let light: f64 = parts.colours.iter().map(|colour| colour.share).sum();
        // Shares are quotients: rounding leaves 1e-16 a colour.
        if parts.colours.iter().any(|colour| bad(colour.ratio) || bad(colour.share)) || (light - 1.0).abs() > 1e-9 {
            let text = format!("colours {:?} are impossible: positive ratios, and shares of sum 1", parts.colours);
            return Err(Error::Value(text));
        }
        if lit == 0 || !(parts.weights.energy.is_finite() && parts.weights.energy > 0.0) {
            return Err(Error::Value("the pupil holds no glass: no sample is lit".into()));
        }
        if parts.weights.lit.iter().any(|&p| p as usize >= samples * samples) {
            return Err(Error::Shape(format!("a lit sample lies outside the {samples}x{samples} pupil grid")));
        }
        let fits = parts.weights.offsets.len() == lit + 1
            && parts.weights.segment.len() == entries
            && parts.weights.offsets.last() == Some(&(entries as u32))
            && parts.weights.segment.iter().all(|&s| (s as usize) < parts.weights.segments);
        if !fits {
            return Err(Error::Shape("the segment weights do not describe the lit samples".into()));
        }
        for (what, length) in [("diversity", parts.diversity_nm.len()), ("smooth basis", parts.basis.ncols())] {
            if length != lit {
                return Err(Error::Shape(format!("the {what} has {length} samples, the pupil {lit} lit ones")));
            }
        }
        if let Some(products) = &parts.products {
            let functions: usize = products.groups.iter().sum();
            let coefficients: usize = products.groups.iter().map(|k| k * k).sum();
            let fit = products.lines.dim() == (functions, samples)
                && products.matrix.dim() == (parts.basis.nrows(), coefficients)
                && products.lines.iter().chain(&products.matrix).all(|v| v.is_finite());
            if !fit {
                return Err(Error::Shape("the products do not describe the smooth basis on this grid".into()));
            }
        }
        let finite = parts.diversity_nm.iter().chain(&parts.basis).chain(&parts.weights.weight).all(|v| v.is_finite());
        if !finite {
            return Err(Error::Value("the diversity, a mode or the pupil holds a value that is not finite".into()));
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
                    "{mode:?} names a segment or a basis row that the model does not have"
                )));
            }
        }
        Ok(Self { parts, colour: Colour::ALONE })
    }

    /// The arrays inside.
    pub fn parts(&self) -> &OpticsParts {
        &self.parts
    }

    /// Number of coefficients.
    pub fn modes(&self) -> usize {
        self.parts.modes.len()
    }

    /// Shapes of pupil and image.
    pub fn sampling(&self) -> Sampling {
        self.parts.sampling
    }

    /// The model at each of its wavelengths, whose images add. A pixel is a fixed angle: it spans fewer λ/D where λ is longer.
    pub fn colours(&self) -> Vec<Self> {
        let alone = |&colour: &Colour| {
            let Sampling { samples, pixels, pixels_per_lambda_over_d } = self.parts.sampling;
            let parts = OpticsParts {
                sampling: Sampling {
                    samples,
                    pixels,
                    pixels_per_lambda_over_d: pixels_per_lambda_over_d * colour.ratio,
                },
                wavelength_nm: self.parts.wavelength_nm * colour.ratio,
                colours: vec![Colour::ALONE],
                ..self.parts.clone()
            };
            Self { parts, colour }
        };
        if self.has_one_wavelength() { vec![self.clone()] } else { self.parts.colours.iter().map(alone).collect() }
    }

    /// Whether all light has the model's wavelength.
    pub fn has_one_wavelength(&self) -> bool {
        self.parts.colours == [Colour::ALONE]
    }

    /// What part of a model of several wavelengths this is; [`Colour::ALONE`] for a whole one.
    pub(super) fn colour(&self) -> Colour {
        self.colour
    }

    /// Factor on |U|² that makes the PSF sum to the share of the light over an unbounded detector: 1/((n·q)²·ΣA²) of it by
    /// Parseval.
    pub fn intensity_scale(&self) -> f64 {
        self.colour.share * self.parts.sampling.step().powi(2) / self.parts.weights.energy
    }

    /// The diversity in turns, reduced to [−½, ½]: the same field, with its digits where single precision can see them.
    pub fn diversity_turns(&self) -> Vec<f64> {
        let turns = |nm: &f64| nm / self.parts.wavelength_nm;
        self.parts.diversity_nm.iter().map(turns).map(|t| t - t.round()).collect()
    }

    /// Whether any coefficient tilts a segment.
    pub fn tilts_segments(&self) -> bool {
        self.parts.modes.iter().any(|mode| matches!(mode, Mode::Tip(_) | Mode::Tilt(_)))
    }
}

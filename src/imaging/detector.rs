//! The focal field to the objective, and back.
//!
//! `h = |U|²`, `J = Σ w·(S·h + b − d)²`. Flux S and background b are given, or are those that minimise J: they enter
//! linearly, so their 2×2 normal equations are solved at each evaluation (variable projection), and by the envelope
//! theorem the gradient in the other unknowns is the one at fixed S and b. Backwards: `Ū = dJ/dh·U = 2·w·r·S·U`.

use super::phasor::Polynomial;
use crate::{Error, Result};

/// How flux and background are found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Photometry {
    /// Both are known.
    Fixed {
        /// Electrons in the whole PSF.
        flux_e: f64,
        /// Electrons per pixel.
        background_e: f64,
    },
    /// The flux is fitted, the background is known.
    FitFlux {
        /// Electrons per pixel.
        background_e: f64,
    },
    /// Both are fitted.
    FitBoth,
}

/// One image as a chain takes it: m×m data with their weights.
#[derive(Debug, Clone)]
pub struct Exposure {
    /// Electrons, `[y][x]`; ignored (but finite) where the weight is 0.
    pub data_e: Vec<f64>,
    /// Weight of each pixel: 1/variance, or what the caller minimises; 0 for a bad pixel.
    pub weight: Vec<f64>,
    /// How flux and background are found.
    pub photometry: Photometry,
}

/// What one evaluation returns.
#[derive(Debug, Clone, Default)]
pub struct Evaluation {
    /// J = Σ w (S·h + b − d)².
    pub objective: f64,
    /// Flux S, electrons.
    pub flux_e: f64,
    /// Background b, electrons per pixel.
    pub background_e: f64,
    /// dJ/dc, per nm of each coefficient.
    pub gradient: Vec<f64>,
}

impl Exposure {
    /// Checks an exposure against an image of `pixels` a side.
    ///
    /// # Errors
    /// [`Error::Shape`] for a wrong size, [`Error::Value`] for values that are not finite or negative weights.
    pub fn check(&self, pixels: usize) -> Result<()> {
        if self.data_e.len() != pixels * pixels || self.weight.len() != pixels * pixels {
            return Err(Error::Shape(format!(
                "an exposure of {} pixels with {} weights does not fit a model of {pixels}x{pixels} pixels",
                self.data_e.len(),
                self.weight.len()
            )));
        }
        if self.data_e.iter().any(|d| !d.is_finite()) || self.weight.iter().any(|w| !(w.is_finite() && *w >= 0.0)) {
            return Err(Error::Value(
                "an exposure's data must be finite, and its weights finite and not negative".into(),
            ));
        }
        Ok(())
    }
}

/// An exposure in the chain's precision, with the sums that do not depend on the model.
#[derive(Clone)]
pub struct Loaded<T> {
    data: Vec<T>,
    weight: Vec<T>,
    photometry: Photometry,
    sum_w: f64,
    sum_wd: f64,
}

/// Independent partial sums, in double precision.
const LANES: usize = 8;

impl<T: Polynomial> Loaded<T> {
    /// Room for an exposure of `pixels` a side, in which nothing has weight yet.
    pub(super) fn room(pixels: usize) -> Self {
        let zeros = || vec![T::zero(); pixels * pixels];
        let photometry = Photometry::Fixed { flux_e: 0.0, background_e: 0.0 };
        Self { data: zeros(), weight: zeros(), photometry, sum_w: 0.0, sum_wd: 0.0 }
    }

    /// Takes up an exposure of the same size, in the memory of the last.
    pub(super) fn set(&mut self, exposure: &Exposure) {
        let fill = |to: &mut [T], from: &[f64]| to.iter_mut().zip(from).for_each(|(to, &from)| *to = T::of(from));
        fill(&mut self.data, &exposure.data_e);
        fill(&mut self.weight, &exposure.weight);
        self.photometry = exposure.photometry;
        self.sum_w = exposure.weight.iter().sum();
        self.sum_wd = exposure.weight.iter().zip(&exposure.data_e).map(|(w, d)| w * d).sum();
    }

    /// |U|² from the row-planar focal field.
    #[inline(always)]
    pub(super) fn intensity(focus: &[T], psf: &mut [T], pixels: usize) {
        for (row, psf) in focus.chunks_exact(2 * pixels).zip(psf.chunks_exact_mut(pixels)) {
            let (re, im) = row.split_at(pixels);
            for u in 0..pixels {
                psf[u] = re[u].mul_add(re[u], im[u] * im[u]);
            }
        }
    }

    /// Flux and background for this PSF, and the objective, into `evaluation`. In f32 the model and the residual are rounded to 6e-8 of
    /// the brightest pixel; all sums over pixels run in double precision.
    #[inline(always)]
    pub(super) fn forward(&self, psf: &[T], evaluation: &mut Evaluation) {
        let (flux_e, background_e) = self.photometry(psf);
        let (flux, background) = (T::of(flux_e), T::of(background_e));
        let mut lanes = [0.0; LANES];
        for ((psf, data), weight) in psf.chunks(LANES).zip(self.data.chunks(LANES)).zip(self.weight.chunks(LANES)) {
            for i in 0..psf.len() {
                let residual = psf[i].mul_add(flux, background - data[i]);
                lanes[i] += (weight[i] * residual * residual).wide();
            }
        }
        (evaluation.objective, evaluation.flux_e, evaluation.background_e) = (lanes.iter().sum(), flux_e, background_e);
    }

    #[inline(always)]
    fn photometry(&self, psf: &[T]) -> (f64, f64) {
        if let Photometry::Fixed { flux_e, background_e } = self.photometry {
            return (flux_e, background_e);
        }
        let (mut wh, mut whh, mut whd) = ([0.0; LANES], [0.0; LANES], [0.0; LANES]);
        for ((psf, data), weight) in psf.chunks(LANES).zip(self.data.chunks(LANES)).zip(self.weight.chunks(LANES)) {
            for i in 0..psf.len() {
                let product = weight[i] * psf[i];
                wh[i] += product.wide();
                whh[i] += (product * psf[i]).wide();
                whd[i] += (product * data[i]).wide();
            }
        }
        let [wh, whh, whd] = [wh, whh, whd].map(|lanes| lanes.iter().sum::<f64>());
        self.photometry.solve(self.sum_w, self.sum_wd, wh, whh, whd)
    }

    /// Ū on the row-planar grid, written over the focal field.
    #[inline(always)]
    pub(super) fn adjoint(&self, evaluation: &Evaluation, psf: &[T], focus: &mut [T], pixels: usize) {
        let (flux, background) = (T::of(evaluation.flux_e), T::of(evaluation.background_e));
        let twice_flux = T::of(2.0 * evaluation.flux_e);
        for (v, row) in focus.chunks_exact_mut(2 * pixels).enumerate() {
            let (re, im) = row.split_at_mut(pixels);
            let line = v * pixels..(v + 1) * pixels;
            let (psf, data, weight) = (&psf[line.clone()], &self.data[line.clone()], &self.weight[line]);
            for u in 0..pixels {
                let residual = psf[u].mul_add(flux, background - data[u]);
                let slope = twice_flux * weight[u] * residual;
                re[u] *= slope;
                im[u] *= slope;
            }
        }
    }
}

impl Photometry {
    /// Flux and background that minimise J, from its sums Σw, Σwd, Σwh, Σwh², Σwhd. A PSF that carries nothing where the
    /// weights are (a determinant of rounding size) leaves the flux at 0.
    pub fn solve(self, w: f64, wd: f64, wh: f64, whh: f64, whd: f64) -> (f64, f64) {
        match self {
            Photometry::Fixed { flux_e, background_e } => (flux_e, background_e),
            Photometry::FitFlux { background_e } => {
                (if whh > 0.0 { (whd - background_e * wh) / whh } else { 0.0 }, background_e)
            }
            Photometry::FitBoth => {
                let determinant = w * whh - wh * wh;
                if determinant <= 1e-14 * w * whh {
                    return (0.0, if w > 0.0 { wd / w } else { 0.0 });
                }
                ((w * whd - wh * wd) / determinant, (whh * wd - wh * whd) / determinant)
            }
        }
    }
}

//! Detector stage: from the focal field to the objective, and the adjoint.
//!
//! `h = |U|²` (with the response of the pixels, where they have an area: see `pixels`),
//! `J = Σ w·(S·h + b − d)²`. Flux S and background b are given, or minimise J: they enter linearly,
//! so their 2×2 normal equations are solved at each evaluation (variable projection), and by the
//! envelope theorem the gradient by the other unknowns is that at fixed S and b. The adjoint:
//! `Ū = dJ/dh·U = 2·w·r·S·U`.

use super::phasor::Polynomial;
use crate::{Error, Result};

/// Whether flux and background are known or fitted.
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

/// One image as input of a chain: m×m data with their weights.
#[derive(Debug)]
pub struct Exposure {
    /// Electrons, `[y][x]`; ignored (but finite) where the weight is 0.
    pub data_e: Vec<f64>,
    /// Weight of each pixel in the objective, usually 1/variance; 0 for a bad pixel.
    pub weight: Vec<f64>,
    /// Whether flux and background are known or fitted.
    pub photometry: Photometry,
}

impl Clone for Exposure {
    fn clone(&self) -> Self {
        Self { data_e: self.data_e.clone(), weight: self.weight.clone(), photometry: self.photometry }
    }

    /// Without another allocation where the images have one size.
    fn clone_from(&mut self, source: &Self) {
        let Self { data_e, weight, photometry } = source;
        self.data_e.clone_from(data_e);
        self.weight.clone_from(weight);
        self.photometry = *photometry;
    }
}

/// Results of one evaluation.
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
    /// [`Error::Shape`] for a wrong size, [`Error::Value`] for values that are not finite or
    /// negative weights.
    pub fn check(&self, pixels: usize) -> Result<()> {
        if self.data_e.len() != pixels * pixels || self.weight.len() != pixels * pixels {
            return Err(Error::Shape(format!(
                "an exposure of {} pixels with {} weights does not fit a model of {pixels}x{pixels} pixels",
                self.data_e.len(),
                self.weight.len()
            )));
        }
        // 0 times a number that is not finite is NaN. Without an early exit the loop is vectorised.
        let (mut zeros, mut negative) = ([0.0; LANES], false);
        let (data, weight) = (self.data_e.chunks(LANES), self.weight.chunks(LANES));
        for (data, weight) in data.zip(weight) {
            for ((zero, data), weight) in zeros.iter_mut().zip(data).zip(weight) {
                *zero += 0.0 * data + 0.0 * weight;
                negative |= *weight < 0.0;
            }
        }
        if negative || zeros.iter().any(|zero| *zero != 0.0) {
            return Err(Error::Value(
                "an exposure's data must be finite, and its weights finite and not negative".into(),
            ));
        }
        Ok(())
    }
}

/// An exposure in the precision of the chain, with the sums that do not depend on the model.
#[derive(Clone)]
pub struct LoadedImage<T> {
    data: Vec<T>,
    weight: Vec<T>,
    photometry: Photometry,
    sum_w: f64,
    sum_wd: f64,
}

/// Number of independent partial sums, for vectorisation.
const LANES: usize = 16;
/// Number of vectors summed in the precision of the chain before the sums continue in double
/// precision: in f32 the rounding of so few additions is that of the products.
const SPAN: usize = 4;

impl<T: Polynomial> LoadedImage<T> {
    /// Memory for an exposure of `pixels` a side, with all weights 0.
    pub(super) fn empty(pixels: usize) -> Self {
        let zeros = || vec![T::zero(); pixels * pixels];
        let photometry = Photometry::Fixed { flux_e: 0.0, background_e: 0.0 };
        Self { data: zeros(), weight: zeros(), photometry, sum_w: 0.0, sum_wd: 0.0 }
    }

    /// Replaces the data by those of an exposure of the same size.
    pub(super) fn set(&mut self, exposure: &Exposure) {
        let fill = |to: &mut [T], from: &[f64]| to.iter_mut().zip(from).for_each(|(to, &from)| *to = T::narrow(from));
        fill(&mut self.data, &exposure.data_e);
        fill(&mut self.weight, &exposure.weight);
        self.photometry = exposure.photometry;
        let (mut w, mut wd) = ([0.0; LANES], [0.0; LANES]);
        for (weight, data) in exposure.weight.chunks(LANES).zip(exposure.data_e.chunks(LANES)) {
            for (i, (weight, data)) in weight.iter().zip(data).enumerate() {
                w[i] += weight;
                wd[i] += weight * data;
            }
        }
        [self.sum_w, self.sum_wd] = [w, wd].map(|lanes| lanes.iter().sum());
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

    /// As [`LoadedImage::intensity`], added to the intensity of other wavelengths.
    #[inline(always)]
    pub(super) fn add_intensity(focus: &[T], psf: &mut [T], pixels: usize) {
        for (row, psf) in focus.chunks_exact(2 * pixels).zip(psf.chunks_exact_mut(pixels)) {
            let (re, im) = row.split_at(pixels);
            for u in 0..pixels {
                psf[u] += re[u].mul_add(re[u], im[u] * im[u]);
            }
        }
    }

    /// Flux and background for this PSF, into `evaluation`. In f32 the model and the residual are
    /// rounded to 6e-8 of the brightest pixel; sums over pixels run in double precision.
    #[inline(always)]
    pub(super) fn forward(&self, psf: &[T], evaluation: &mut Evaluation) {
        (evaluation.flux_e, evaluation.background_e) = self.photometry(psf);
    }

    #[inline(always)]
    fn photometry(&self, psf: &[T]) -> (f64, f64) {
        if let Photometry::Fixed { flux_e, background_e } = self.photometry {
            return (flux_e, background_e);
        }
        let mut sums = [[0.0; LANES]; 3];
        let spans = psf.chunks(SPAN * LANES).zip(self.data.chunks(SPAN * LANES)).zip(self.weight.chunks(SPAN * LANES));
        for ((psf, data), weight) in spans {
            let mut lanes = [[T::zero(); LANES]; 3];
            for ((psf, data), weight) in psf.chunks(LANES).zip(data.chunks(LANES)).zip(weight.chunks(LANES)) {
                match (psf.first_chunk(), data.first_chunk(), weight.first_chunk()) {
                    (Some(psf), Some(data), Some(weight)) => add_moments(&mut lanes, psf, data, weight),
                    _ => add_moments(&mut lanes, &filled(psf), &filled(data), &filled(weight)),
                }
            }
            for (sums, lanes) in sums.iter_mut().zip(&lanes) {
                sums.iter_mut().zip(lanes).for_each(|(sum, lane)| *sum += lane.widen());
            }
        }
        let [wh, whh, whd] = sums.map(|lanes| lanes.iter().sum::<f64>());
        self.photometry.solve(self.sum_w, self.sum_wd, wh, whh, whd)
    }

    /// Writes the objective at the flux and background of `evaluation` into it, and replaces the
    /// focal field by Ū, on the row-planar grid.
    #[inline(always)]
    pub(super) fn adjoint(&self, evaluation: &mut Evaluation, psf: &[T], focus: &mut [T], pixels: usize) {
        let (flux, background) = (T::narrow(evaluation.flux_e), T::narrow(evaluation.background_e));
        let twice_flux = flux + flux;
        let mut sums = [0.0; LANES];
        for (v, row) in focus.chunks_exact_mut(2 * pixels).enumerate() {
            let (re, im) = row.split_at_mut(pixels);
            let line = v * pixels..(v + 1) * pixels;
            let (psf, data, weight) = (&psf[line.clone()], &self.data[line.clone()], &self.weight[line]);
            let mut lanes = [T::zero(); LANES];
            let whole = pixels - pixels % LANES;
            let mut pixel = |u: usize, lane: &mut T| {
                let residual = psf[u].mul_add(flux, background - data[u]);
                let weighted = weight[u] * residual;
                *lane = weighted.mul_add(residual, *lane);
                let slope = twice_flux * weighted;
                re[u] *= slope;
                im[u] *= slope;
            };
            for first in (0..whole).step_by(LANES) {
                for (i, lane) in lanes.iter_mut().enumerate() {
                    pixel(first + i, lane);
                }
            }
            for u in whole..pixels {
                pixel(u, &mut lanes[u - whole]);
            }
            sums.iter_mut().zip(&lanes).for_each(|(sum, lane)| *sum += lane.widen());
        }
        evaluation.objective = sums.iter().sum();
    }
}

/// The adjoint in two steps, for an image whose pixels have an area: their stage is between them.
impl<T: Polynomial> LoadedImage<T> {
    /// Writes the objective at the flux and background of `evaluation` into it, and dJ/dh = 2·w·r·S
    /// of each pixel into `slope`.
    #[inline(always)]
    pub(super) fn slope(&self, evaluation: &mut Evaluation, psf: &[T], slope: &mut [T]) {
        let (flux, background) = (T::narrow(evaluation.flux_e), T::narrow(evaluation.background_e));
        let twice_flux = flux + flux;
        let mut sum = 0.0;
        let pixels = psf.iter().zip(&self.data).zip(&self.weight).zip(slope);
        for (((&psf, &data), &weight), slope) in pixels {
            let residual = psf.mul_add(flux, background - data);
            let weighted = weight * residual;
            sum += (weighted * residual).widen();
            *slope = twice_flux * weighted;
        }
        evaluation.objective = sum;
    }

    /// Replaces the focal field by Ū, its product with the slope of each pixel.
    #[inline(always)]
    pub(super) fn times_slope(slope: &[T], focus: &mut [T], pixels: usize) {
        for (row, slope) in focus.chunks_exact_mut(2 * pixels).zip(slope.chunks_exact(pixels)) {
            let (re, im) = row.split_at_mut(pixels);
            for u in 0..pixels {
                re[u] *= slope[u];
                im[u] *= slope[u];
            }
        }
    }
}

/// Adds w·h, w·h² and w·h·d of a vector of pixels.
#[inline(always)]
fn add_moments<T: Polynomial>(
    [wh, whh, whd]: &mut [[T; LANES]; 3],
    psf: &[T; LANES],
    data: &[T; LANES],
    weight: &[T; LANES],
) {
    for i in 0..LANES {
        let product = weight[i] * psf[i];
        wh[i] += product;
        whh[i] = product.mul_add(psf[i], whh[i]);
        whd[i] = product.mul_add(data[i], whd[i]);
    }
}

/// A partial vector, filled up with zeros.
#[inline(always)]
fn filled<T: Polynomial>(part: &[T]) -> [T; LANES] {
    let mut lanes = [T::zero(); LANES];
    lanes[..part.len()].copy_from_slice(part);
    lanes
}

impl Photometry {
    /// Flux and background that minimise J, from its sums Σw, Σwd, Σwh, Σwh², Σwhd. The flux is 0
    /// for a PSF that is constant within rounding where the weights are positive.
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

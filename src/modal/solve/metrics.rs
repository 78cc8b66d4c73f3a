//! Metrics of the optimiser: the Gauss-Newton matrix of the flat wavefront, with the weights of an
//! image of this brightness. In its coordinates the objective is nearly spherical.
//!
//! For a star of flux S and a variance f without photons the weights are 1/(S·h + f) and the
//! derivatives S·dh: in units of the flux, S times the matrix of weights 1/(h + f/S). So f/S is the
//! only parameter of the family, and the flux scales the coordinates. All metrics share one set of
//! derivatives.

use crate::imaging::CpuChain;
use crate::linear_algebra::times_transposed;
use crate::modal::assess::fisher::null_floor;
use crate::modal::model::memory::MATRICES_AT_ONCE;
use crate::modal::model::recipe::Recipe;
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::gauss_newton::{NuisanceShares, Nuisances, StoredDerivatives, products, rows_of_tile};
use crate::optimize::Metric;
use crate::scene::Weighting;
use crate::{Error, Result};
use ndarray::{Array1, Array2};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::{Arc, OnceLock};

/// Ratio of neighbouring values of f/S: the value of an image is within a factor of two of one of
/// them, and so is the variance of each pixel.
const STEP: f64 = 4.0;
/// Values of f/S, from the brightest pixel of the flat wavefront's PSF times `STEP` down: above it
/// the weights are uniform and scale with 1/f; below the last (1e-5 of the brightest pixel) the
/// pixels whose variance is mostly the floor hold no light.
const LEVELS: usize = 10;

/// Image of the flat wavefront and its derivatives, for a flux of 1.
struct FlatImage {
    psf: Vec<f64>,
    /// The derivatives, where memory holds them.
    kept: Option<StoredDerivatives>,
    /// Value of the brightest pixel.
    peak: f64,
}

/// Metrics of one model, each computed at its first use.
pub(in crate::modal) struct Metrics {
    weighting: Weighting,
    nuisances: Nuisances,
    /// Bytes for derivatives.
    tile_bytes: usize,
    flat: OnceLock<FlatImage>,
    made: [OnceLock<Arc<Metric>>; LEVELS],
}

impl Metrics {
    /// No metric yet; derivatives will take `tile_bytes` at a time.
    pub(in crate::modal) fn new(recipe: &Recipe, tile_bytes: usize) -> Self {
        Self {
            weighting: recipe.weighting,
            nuisances: Nuisances::new(recipe.fit_flux, recipe.fit_background),
            tile_bytes,
            flat: OnceLock::new(),
            made: [const { OnceLock::new() }; LEVELS],
        }
    }

    /// Computes all of them, so that [`Metrics::for_image`] only looks up.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode changes the image.
    pub(in crate::modal) fn make_all(&self, reference: &CpuChain<f64>) -> Result<()> {
        let levels = if self.weighting == Weighting::None { 1 } else { LEVELS };
        // As many at once as the memory formula has room for.
        (0..levels)
            .step_by(MATRICES_AT_ONCE)
            .try_for_each(|first| self.make(reference, first..levels.min(first + MATRICES_AT_ONCE)))
    }

    /// Computes what all of them are made of. It uses all threads, and those that wait for it must
    /// not be among them: to be called before [`Metrics::for_image`] in threads of the pool.
    pub(in crate::modal) fn prepare(&self, reference: &CpuChain<f64>) {
        self.flat(reference);
    }

    /// The first of them, for callers that need its size alone.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode changes the image.
    pub(in crate::modal) fn first(&self, reference: &CpuChain<f64>) -> Result<&Arc<Metric>> {
        self.level(reference, 0)
    }

    /// The metric of an image and the scale of its coordinates, which depend on this image alone:
    /// so a fit does not depend on what else is in the batch.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode changes the image.
    pub(in crate::modal) fn for_image(
        &self,
        reference: &CpuChain<f64>,
        image: &PreparedFrame,
    ) -> Result<(&Arc<Metric>, f64)> {
        // Unweighted, the data are in units of the brightest pixel: neither flux nor noise matters.
        if self.weighting == Weighting::None {
            return Ok((self.level(reference, 0)?, 1.0));
        }
        let (level, flux_e) = self.level_and_flux(reference, image);
        Ok((self.level(reference, level)?, flux_e.sqrt().recip()))
    }

    /// The level of the metric of an image, and the flux of its scale, electrons.
    fn level_and_flux(&self, reference: &CpuChain<f64>, image: &PreparedFrame) -> (usize, f64) {
        let (flux_e, floor) = flux_and_floor(image);
        let relative = floor / flux_e;
        let peak = self.flat(reference).peak;
        let steps = ((STEP * peak / relative).ln() / STEP.ln()).round();
        let level = steps.clamp(0.0, (LEVELS - 1) as f64) as usize;
        // Beyond the first level the weights are uniform, and go as 1/f.
        let largest = Self::relative_floor(peak, 0);
        (level, if relative > largest { flux_e * largest / relative } else { flux_e })
    }

    /// Levels between which an image of `flux_e` and the least variance `floor_e2` lies, with the
    /// multiples of [`Metrics::information`] that add up to the information of the image on a flat
    /// wavefront. With α of the lower and 1 − α of the higher f/S the weights
    /// 1/(h + f) are right where h is 0 and where it is large; between the two they are up to 11 %
    /// too low.
    pub(in crate::modal) fn between(&self, reference: &CpuChain<f64>, flux_e: f64, floor_e2: f64) -> [(usize, f64); 2] {
        let (peak, last, flux_e) = (self.flat(reference).peak, LEVELS - 1, flux_e.max(1.0));
        let floor_of = |level| Self::relative_floor(peak, level);
        let relative = (floor_e2 / flux_e).max(floor_of(last));
        if relative >= floor_of(0) {
            // The weights are uniform, and go as 1/f.
            return [(0, flux_e * floor_of(0) / relative), (0, 0.0)];
        }
        let level = (((floor_of(0) / relative).ln() / STEP.ln()) as usize).min(last - 1);
        let [high, low] = [level, level + 1].map(floor_of);
        let share = ((relative.recip() - high.recip()) / (low.recip() - high.recip())).clamp(0.0, 1.0);
        [(level + 1, flux_e * share), (level, flux_e * (1.0 - share))]
    }

    /// Number of levels.
    pub(in crate::modal) fn levels() -> usize {
        LEVELS
    }

    /// Information on the modes of an image of the flat wavefront with the flux 1 at a level, per
    /// nm²: without directions that are null by rounding.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode changes the image.
    pub(in crate::modal) fn information(&self, reference: &CpuChain<f64>, level: usize) -> Result<Array2<f64>> {
        let metric = self.level(reference, level)?;
        // The columns are the eigenvectors over the roots of their eigenvalues.
        let mut columns = metric.whitening().map(|columns| columns.to_owned()).unwrap_or_default();
        for mut column in columns.columns_mut() {
            column /= column.dot(&column);
        }
        Ok(times_transposed(columns.view(), columns.view()))
    }

    /// f/S of a level.
    fn relative_floor(peak: f64, level: usize) -> f64 {
        peak * STEP.powi(1 - level as i32)
    }

    fn flat(&self, reference: &CpuChain<f64>) -> &FlatImage {
        self.flat.get_or_init(|| {
            let linear = reference.linearise(Array1::zeros(reference.optics().modes()).view());
            let peak = linear.psf().iter().copied().fold(0.0, f64::max);
            let rows = rows_of_tile(linear.unknowns(), linear.pixels(), self.tile_bytes);
            let kept = (rows == linear.pixels()).then(|| StoredDerivatives::new(&linear, self.nuisances));
            FlatImage { psf: linear.psf().to_vec(), kept, peak }
        })
    }

    fn level(&self, reference: &CpuChain<f64>, level: usize) -> Result<&Arc<Metric>> {
        if self.made[level].get().is_none() {
            self.make(reference, level..level + 1)?;
        }
        self.made[level].get().ok_or_else(|| Error::Internal("a metric was made and is not there".into()))
    }

    /// Computes some levels together: where the derivatives are not stored, they are computed once
    /// for all of them.
    fn make(&self, reference: &CpuChain<f64>, levels: Range<usize>) -> Result<()> {
        let flat = self.flat(reference);
        let weights: Vec<Vec<f64>> = levels.clone().map(|level| self.weights(flat, level)).collect();
        let matrices = match &flat.kept {
            Some(kept) => kept.products(&weights),
            None => {
                let linear = reference.linearise(Array1::zeros(reference.optics().modes()).view());
                let rows = rows_of_tile(linear.unknowns(), linear.pixels(), self.tile_bytes);
                products(&linear, &[], self.nuisances, &weights, rows)
            }
        };
        let floor = null_floor(reference.optics().modes(), flat.psf.len());
        levels.into_par_iter().zip(matrices).try_for_each(|(level, matrix)| {
            // Directions of a fitted flux or background carry no curvature.
            let projected = NuisanceShares::new(&matrix, self.nuisances).project_out(matrix);
            let metric = Arc::new(Metric::from_gauss_newton(&projected, floor)?);
            self.made[level].get_or_init(|| metric);
            Ok(())
        })
    }

    /// The metric and the cost must use the same kind of weights: mixing them loses the capture
    /// range.
    fn weights(&self, flat: &FlatImage, level: usize) -> Vec<f64> {
        match self.weighting {
            Weighting::Noise => {
                let floor = Self::relative_floor(flat.peak, level);
                flat.psf.iter().map(|h| 1.0 / (h + floor)).collect()
            }
            Weighting::None => vec![flat.peak.powi(-2); flat.psf.len()],
        }
    }
}

/// Flux above the level in an image's good pixels, electrons (1 at the least), and the smallest
/// variance of a pixel without the star. The metric ignores bad pixels: an image with many of them
/// has coordinates that are a little less spherical.
pub(in crate::modal) fn flux_and_floor(image: &PreparedFrame) -> (f64, f64) {
    const LANES: usize = 8;
    let (mut flux, mut least) = ([0.0; LANES], [f64::INFINITY; LANES]);
    for (data, floor) in image.exposure.data_e.chunks(LANES).zip(image.floor_variance_e2.chunks(LANES)) {
        for (i, (d, &floor)) in data.iter().zip(floor).enumerate() {
            flux[i] += if floor < f64::INFINITY { d - image.level_e } else { 0.0 };
            least[i] = if floor < least[i] { floor } else { least[i] };
        }
    }
    (flux.iter().sum::<f64>().max(1.0), least.into_iter().fold(f64::INFINITY, f64::min))
}

//! Coordinates in which an image's objective looks round: the Gauss-Newton matrix of the flat wavefront, with the
//! weights that an image of this brightness would have.
//!
//! For a star of flux S and a variance f without photons the weights are 1/(S·h + f) and the derivatives S·dh: in units
//! of the flux, S times the matrix of weights 1/(h + f/S). So one parameter makes the family, and the flux is a scale of
//! the coordinates. All members share one Jacobian.

use super::fisher::NULL_FLOOR;
use super::prepare::Prepared;
use super::recipe::Recipe;
use crate::Result;
use crate::imaging::CpuChain;
use crate::optimize::Metric;
use crate::scene::Weighting;
use faer::linalg::matmul::triangular::{BlockStructure, matmul};
use faer::{Accum, MatMut, MatRef, Par};
use ndarray::{Array1, Array2, Axis};
use rayon::prelude::*;
use std::sync::{Arc, OnceLock};

/// Ratio of neighbouring values of f/S: no image's own is more than a factor of two from one of them, as much as the
/// variance of a pixel is off at the most.
const STEP: f64 = 4.0;
/// Values of f/S, from the brightest pixel of the flat wavefront's PSF times `STEP` down: above it the weights are
/// uniform and scale with 1/f, below the last (1e-5 of the brightest pixel) the pixels that the floor still rules hold
/// no light.
const LEVELS: usize = 10;

/// The image of the flat wavefront and its derivatives, for a flux of 1.
struct Flat {
    psf: Array1<f64>,
    /// `[mode, pixel]`, per nm.
    jacobian: Array2<f64>,
    /// Value of the brightest pixel.
    peak: f64,
}

/// The metrics of one model, each made when it is first asked for.
pub(super) struct Metrics {
    weighting: Weighting,
    fit_flux: bool,
    fit_background: bool,
    flat: OnceLock<Flat>,
    made: [OnceLock<Arc<Metric>>; LEVELS],
}

impl Metrics {
    pub(super) fn new(recipe: &Recipe) -> Self {
        Self {
            weighting: recipe.weighting,
            fit_flux: recipe.fit_flux,
            fit_background: recipe.fit_background,
            flat: OnceLock::new(),
            made: [const { OnceLock::new() }; LEVELS],
        }
    }

    /// Makes all of them, so that [`Metrics::of`] only looks up.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode is seen at all.
    pub(super) fn make_all(&self, judge: &CpuChain<f64>) -> Result<()> {
        let levels = if self.weighting == Weighting::None { 1 } else { LEVELS };
        (0..levels).into_par_iter().try_for_each(|level| self.level(judge, level).map(|_| ()))
    }

    /// Any of them, for its size.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode is seen at all.
    pub(super) fn any(&self, judge: &CpuChain<f64>) -> Result<&Arc<Metric>> {
        self.level(judge, 0)
    }

    /// The metric of an image and the scale of its coordinates, which depend on this image alone: so a fit does not
    /// depend on what else is in the batch.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode is seen at all.
    pub(super) fn of(&self, judge: &CpuChain<f64>, image: &Prepared) -> Result<(&Arc<Metric>, f64)> {
        // Unweighted, the data are in units of the brightest pixel: neither flux nor noise matters.
        if self.weighting == Weighting::None {
            return Ok((self.level(judge, 0)?, 1.0));
        }
        let good = || image.exposure.data_e.iter().zip(&image.floor_variance_e2).filter(|(_, floor)| floor.is_finite());
        let flux_e: f64 = good().map(|(d, _)| d - image.level_e).sum::<f64>().max(1.0);
        // Bad pixels are an image's own; one that has many only looks a little less round.
        let floor = good().map(|(_, floor)| *floor).fold(f64::INFINITY, f64::min);
        let relative = floor / flux_e;
        let peak = self.flat(judge).peak;
        let steps = ((STEP * peak / relative).ln() / STEP.ln()).round();
        let level = steps.clamp(0.0, (LEVELS - 1) as f64) as usize;
        // Beyond the first level the weights are uniform, and go as 1/f.
        let largest = Self::relative_floor(peak, 0);
        let flux_e = if relative > largest { flux_e * largest / relative } else { flux_e };
        Ok((self.level(judge, level)?, flux_e.sqrt().recip()))
    }

    /// f/S of a level.
    fn relative_floor(peak: f64, level: usize) -> f64 {
        peak * STEP.powi(1 - level as i32)
    }

    fn flat(&self, judge: &CpuChain<f64>) -> &Flat {
        self.flat.get_or_init(|| {
            let (psf, jacobian) = judge.jacobian(Array1::zeros(judge.optics().modes()).view());
            let peak = psf.iter().copied().fold(0.0, f64::max);
            Flat { psf: Array1::from(psf), jacobian, peak }
        })
    }

    fn level(&self, judge: &CpuChain<f64>, level: usize) -> Result<&Arc<Metric>> {
        if let Some(metric) = self.made[level].get() {
            return Ok(metric);
        }
        let metric = Arc::new(self.make(self.flat(judge), level)?);
        Ok(self.made[level].get_or_init(|| metric))
    }

    fn make(&self, flat: &Flat, level: usize) -> Result<Metric> {
        // The metric and the cost must use the same kind of weights: mixing them loses the capture range.
        let weight = match self.weighting {
            Weighting::Noise => {
                let floor = Self::relative_floor(flat.peak, level);
                flat.psf.mapv(|h| 1.0 / (h + floor))
            }
            Weighting::None => Array1::from_elem(flat.psf.len(), flat.peak.powi(-2)),
        };
        let nuisances = match (self.fit_flux, self.fit_background) {
            (true, true) => vec![flat.psf.clone(), Array1::ones(weight.len())],
            (true, false) => vec![flat.psf.clone()],
            (false, _) => Vec::new(),
        };
        let root = weight.mapv(f64::sqrt);
        let weighted = &flat.jacobian * &root;
        let mut matrix = gram(&weighted);
        for direction in orthonormal(nuisances.into_iter().map(|nuisance| nuisance * &root)) {
            // What a fitted flux or background would absorb is no curvature: F − n nᵀ, n = J W d.
            let along = weighted.dot(&direction);
            for (mut row, &a) in matrix.axis_iter_mut(Axis(0)).zip(&along) {
                row.scaled_add(-a, &along);
            }
        }
        Metric::from_gauss_newton(&matrix, NULL_FLOOR)
    }
}

/// Gram-Schmidt.
fn orthonormal(vectors: impl Iterator<Item = Array1<f64>>) -> Vec<Array1<f64>> {
    let mut directions: Vec<Array1<f64>> = Vec::new();
    for mut vector in vectors {
        for direction in &directions {
            let along = vector.dot(direction);
            vector.scaled_add(-along, direction);
        }
        let norm = vector.dot(&vector).sqrt();
        if norm > 0.0 {
            directions.push(vector / norm);
        }
    }
    directions
}

/// a·aᵀ of a `[mode, pixel]` array in standard layout: one triangle computed, the other mirrored.
fn gram(a: &Array2<f64>) -> Array2<f64> {
    let (rows, columns) = a.dim();
    let mut product = Array2::zeros((rows, rows));
    if let (Some(a), Some(out)) = (a.as_slice(), product.as_slice_mut()) {
        let a = MatRef::from_row_major_slice(a, rows, columns);
        let out = MatMut::from_row_major_slice_mut(out, rows, rows);
        let (lower, full) = (BlockStructure::TriangularLower, BlockStructure::Rectangular);
        matmul(out, lower, Accum::Replace, a, full, a.transpose(), full, 1.0, Par::Seq);
    }
    for i in 0..rows {
        for j in 0..i {
            product[[j, i]] = product[[i, j]];
        }
    }
    product
}

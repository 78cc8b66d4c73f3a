//! Normal equations of the optical parameters with the modes eliminated: the terms of each image,
//! and their solution.

use crate::imaging::Photometry;
use crate::modal::assess::fisher::{Sensitivity, pseudo_inverse};
use crate::modal::fitter::ModalFitter;
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::minimum::Minimum;
use crate::statistics::median;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, Axis};

/// Smallest identifiable share of a parameter that is fitted: 6e-7 of a defocus where the modes
/// have Zernikes, 0.8 of a plate scale.
const MIN_IDENTIFIABLE_SHARE: f64 = 1e-5;

/// One iteration of the fit of the optical parameters.
pub(super) struct ParameterIteration {
    /// Median reduced χ² of the images.
    pub(super) reduced_chi2: f64,
    /// Pixels with a weight, of all images.
    pub(super) pixels: usize,
    /// By how much the step would lower it if the images depended linearly on the parameters.
    pub(super) expected_drop: f64,
    /// Step of each parameter.
    pub(super) step: Vec<f64>,
    /// Error bar of each parameter; infinite where it is not identifiable.
    pub(super) sigma: Vec<f64>,
    /// Covariance of the parameters; 0 for those that are not identifiable.
    pub(super) covariance: Array2<f64>,
    /// Identifiable share of each parameter.
    pub(super) identifiable_share: Vec<f64>,
    /// Covariance of the mean modes from the errors of the parameters, nm²: all images share it.
    pub(super) shared_nm2: Array2<f64>,
}

/// Normal equations, summed over the images.
pub(super) struct NormalEquations {
    images: usize,
    /// Pixels with a weight, of all images.
    pixels: usize,
    chi2: Vec<f64>,
    /// S.
    reduced: Array2<f64>,
    /// Σ Jθᵀ W Jθ, diagonal.
    full: Array1<f64>,
    /// Σ Jθᵀ W r.
    right_side: Array1<f64>,
    /// Σ F⁻¹ c, `[mode, parameter]`, nm per unit.
    moves_nm: Array2<f64>,
}

impl NormalEquations {
    pub(super) fn new(optics: usize, modes: usize) -> Self {
        Self {
            images: 0,
            pixels: 0,
            chi2: Vec::new(),
            reduced: Array2::zeros((optics, optics)),
            full: Array1::zeros(optics),
            right_side: Array1::zeros(optics),
            moves_nm: Array2::zeros((modes, optics)),
        }
    }

    /// Adds an image; `derivatives` are those of its electrons by the parameters,
    /// `[parameter, pixel]`, per unit.
    pub(super) fn add(
        &mut self,
        fitter: &ModalFitter,
        image: &PreparedFrame,
        minimum: &Minimum,
        derivatives: &[Array1<f64>],
    ) -> Result<()> {
        let at = ArrayView1::from(&minimum.coefficients_nm);
        let mut linear = fitter.reference.linearise(at);
        let (exposure, flux_e) = (&image.exposure, minimum.flux_e);
        let weight = ArrayView1::from(&exposure.weight);
        let psf = ArrayView1::from(linear.psf());
        let model = psf.mapv(|h| flux_e * h + minimum.background_e);
        let nuisances: Vec<Array1<f64>> = match exposure.photometry {
            Photometry::Fixed { .. } => Vec::new(),
            Photometry::FitFlux { .. } => vec![psf.to_owned()],
            Photometry::FitBoth => vec![psf.to_owned(), Array1::ones(psf.len())],
        };
        let nuisances = orthogonalised(nuisances, weight);
        let optics = derivatives.iter().cloned().map(|derivative| orthogonalise(derivative, weight, &nuisances));
        let optics: Vec<Array1<f64>> = optics.collect();
        let weighted: Vec<Array1<f64>> = optics.iter().map(|optic| optic * &weight).collect();
        let tile_bytes = fitter.model.tiles().derivative_bytes;
        // Derivatives by the modes are those of the PSF, for a flux of 1.
        let mut products = Array2::zeros((linear.unknowns(), weighted.len()));
        for (weighted, mut column) in weighted.iter().zip(products.columns_mut()) {
            let [of_modes, _] = linear.products(weighted.as_slice().unwrap_or_default());
            column.assign(&(Array1::from(of_modes) * flux_e));
        }
        let noise = (exposure.weight.as_slice(), None);
        let sensitivity = Sensitivity::at(&fitter.reference, at, flux_e, noise, exposure.photometry, tile_bytes);
        let moves = sensitivity.covariance()?.dot(&products);
        let residual = &ArrayView1::from(&exposure.data_e) - &model;
        for (i, weighted) in weighted.iter().enumerate() {
            for (j, optic) in optics.iter().enumerate() {
                let full = weighted.dot(optic);
                self.reduced[[i, j]] += full - products.column(i).dot(&moves.column(j));
                if i == j {
                    self.full[i] += full;
                }
            }
            self.right_side[i] += weighted.dot(&residual);
        }
        self.moves_nm += &moves;
        self.chi2.push(minimum.reduced_chi2());
        self.images += 1;
        self.pixels += weight.iter().filter(|weight| **weight > 0.0).count();
        Ok(())
    }

    /// Solves for the step, the error bars and the identifiable shares.
    pub(super) fn solve(self, fitter: &ModalFitter) -> Result<ParameterIteration> {
        if self.images == 0 {
            return Err(Error::Image("no image converged, and estimate.fit_optics needs at least one".into()));
        }
        let count = self.full.len();
        let mut kept: Vec<usize> = (0..count).collect();
        let (mut shares, mut inverse) = (vec![0.0; count], Array2::zeros((0, 0)));
        // The least identifiable parameter is dropped first, until all others are identifiable.
        while !kept.is_empty() {
            let reduced = self.reduced.select(Axis(0), &kept).select(Axis(1), &kept);
            // Where S is 0 there is no inverse, and no parameter is identifiable.
            inverse = pseudo_inverse(&reduced, f64::EPSILON).unwrap_or_else(|_| Array2::zeros(reduced.dim()));
            let share = |place: usize| 1.0 / (inverse[[place, place]] * self.full[kept[place]]);
            let kept_shares: Vec<f64> = (0..kept.len()).map(share).collect();
            kept.iter()
                .zip(&kept_shares)
                .for_each(|(&optic, &share)| shares[optic] = if share.is_finite() { share } else { 0.0 });
            let least = (0..kept.len()).min_by(|&a, &b| shares[kept[a]].total_cmp(&shares[kept[b]]));
            match least.filter(|&place| shares[kept[place]] < MIN_IDENTIFIABLE_SHARE) {
                Some(place) => drop(kept.remove(place)),
                None => break,
            }
        }
        let reduced_chi2 = median(&self.chi2);
        let (mut step, mut sigma) = (vec![0.0; count], vec![f64::INFINITY; count]);
        let (mut shared_nm2, mut all) = (Array2::zeros([self.moves_nm.nrows(); 2]), Array2::zeros((count, count)));
        if !kept.is_empty() {
            let covariance = inverse * reduced_chi2.max(1.0);
            let right_side = self.right_side.select(Axis(0), &kept);
            let solution = covariance.dot(&right_side) / reduced_chi2.max(1.0);
            for (place, &optic) in kept.iter().enumerate() {
                (step[optic], sigma[optic]) = (solution[place], covariance[[place, place]].sqrt());
                for (other_place, &other) in kept.iter().enumerate() {
                    all[[optic, other]] = covariance[[place, other_place]];
                }
            }
            let moves_nm = self.moves_nm.select(Axis(1), &kept) / self.images as f64;
            shared_nm2 = fitter.motions.removed_from(&moves_nm.dot(&covariance).dot(&moves_nm.t()));
        }
        let drop = self.right_side.iter().zip(&step).map(|(right, step)| right * step).sum::<f64>();
        let expected_drop = drop / self.pixels.max(1) as f64;
        Ok(ParameterIteration {
            reduced_chi2,
            pixels: self.pixels,
            expected_drop,
            step,
            sigma,
            covariance: all,
            identifiable_share: shares,
            shared_nm2,
        })
    }
}

/// Vectors orthogonalised to those before them, under `weight`.
fn orthogonalised(vectors: Vec<Array1<f64>>, weight: ArrayView1<f64>) -> Vec<Array1<f64>> {
    let mut done = Vec::new();
    for vector in vectors {
        let vector = orthogonalise(vector, weight, &done);
        done.push(vector);
    }
    done
}

/// `vector` orthogonalised to `others`, which are orthogonal to each other.
fn orthogonalise(mut vector: Array1<f64>, weight: ArrayView1<f64>, others: &[Array1<f64>]) -> Array1<f64> {
    for other in others {
        let weighted = other * &weight;
        let share = weighted.dot(&vector) / weighted.dot(other);
        if share.is_finite() {
            vector.scaled_add(-share, other);
        }
    }
    vector
}

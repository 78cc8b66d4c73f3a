//! The normal equations of optics beside modes: what each image adds, and what all say together.

use crate::imaging::Photometry;
use crate::modal::fisher::{Sensitivity, pseudo_inverse};
use crate::modal::fitter::ModalFitter;
use crate::modal::gauss_newton::{along, rows_of_tile};
use crate::modal::minimum::Minimum;
use crate::modal::prepare::Prepared;
use crate::statistics::median;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1, Axis};

/// Share of what the optics do to the image that the modes have to leave, or the optics are theirs: of a defocus, Zernikes
/// leave 6e-7, of a plate scale 0.8.
const TOLD: f64 = 1e-5;

/// One round: what the images say about some optics.
pub(super) struct Round {
    /// Median over the images.
    pub(super) reduced_chi2: f64,
    /// For each optic: the step that the images ask for, its error bar, the share that is told.
    pub(super) step: Vec<f64>,
    pub(super) sigma: Vec<f64>,
    pub(super) told: Vec<f64>,
    /// Covariance of the mean modes, nm².
    pub(super) common_nm2: Array2<f64>,
}

/// What images say together.
pub(super) struct Sum {
    images: usize,
    chi2: Vec<f64>,
    /// S, and the part of it that is left before the modes take theirs (diagonal).
    left: Array2<f64>,
    whole: Array1<f64>,
    /// Σ Jθᵀ W r.
    towards: Array1<f64>,
    /// Σ F⁻¹ c, `[mode, optic]`, nm per unit.
    moves_nm: Array2<f64>,
}

impl Sum {
    pub(super) fn of(optics: usize, modes: usize) -> Self {
        Self {
            images: 0,
            chi2: Vec::new(),
            left: Array2::zeros((optics, optics)),
            whole: Array1::zeros(optics),
            towards: Array1::zeros(optics),
            moves_nm: Array2::zeros((modes, optics)),
        }
    }

    /// Adds an image; `derivatives` of its electrons by the optics, `[optic, pixel]`, per unit.
    pub(super) fn add(
        &mut self,
        estimator: &ModalFitter,
        image: &Prepared,
        minimum: &Minimum,
        derivatives: &[Array1<f64>],
    ) -> Result<()> {
        let at = ArrayView1::from(&minimum.coefficients_nm);
        let linear = estimator.reference.linearise(at);
        let (exposure, flux_e) = (&image.exposure, minimum.flux_e);
        let weight = ArrayView1::from(&exposure.weight);
        let psf = ArrayView1::from(linear.psf());
        let model = psf.mapv(|h| flux_e * h + minimum.background_e);
        let absorbing: Vec<Array1<f64>> = match exposure.photometry {
            Photometry::Fixed { .. } => Vec::new(),
            Photometry::FitFlux { .. } => vec![psf.to_owned()],
            Photometry::FitBoth => vec![psf.to_owned(), Array1::ones(psf.len())],
        };
        let absorbed = cleared(absorbing, weight);
        let optics = derivatives.iter().cloned().map(|derivative| clear(derivative, weight, &absorbed));
        let optics: Vec<Array1<f64>> = optics.collect();
        let weighted: Vec<Array1<f64>> = optics.iter().map(|optic| optic * &weight).collect();
        let tile_bytes = estimator.model.tiles().derivative_bytes;
        // Derivatives by the modes are those of the PSF, for a flux of 1.
        let seen = along(&linear, &weighted, rows_of_tile(linear.modes(), linear.pixels(), tile_bytes)) * flux_e;
        let noise = (exposure.weight.as_slice(), None);
        let sensitivity = Sensitivity::at(&estimator.reference, at, flux_e, noise, exposure.photometry, tile_bytes);
        let moves = sensitivity.covariance()?.dot(&seen);
        let residual = &ArrayView1::from(&exposure.data_e) - &model;
        for (i, weighted) in weighted.iter().enumerate() {
            for (j, optic) in optics.iter().enumerate() {
                let whole = weighted.dot(optic);
                self.left[[i, j]] += whole - seen.column(i).dot(&moves.column(j));
                if i == j {
                    self.whole[i] += whole;
                }
            }
            self.towards[i] += weighted.dot(&residual);
        }
        self.moves_nm += &moves;
        self.chi2.push(minimum.reduced_chi2);
        self.images += 1;
        Ok(())
    }

    /// The step, the error bars, and what is told.
    pub(super) fn solved(self, estimator: &ModalFitter) -> Result<Round> {
        if self.images == 0 {
            return Err(Error::Image("no image converged from which estimate.fit_optics could be found".into()));
        }
        let count = self.whole.len();
        let mut kept: Vec<usize> = (0..count).collect();
        let (mut told, mut inverse) = (vec![0.0; count], Array2::zeros((0, 0)));
        // The least told goes first, until all that stay are.
        while !kept.is_empty() {
            let left = self.left.select(Axis(0), &kept).select(Axis(1), &kept);
            // Where nothing at all is left there is no inverse, and nothing is told.
            inverse = pseudo_inverse(&left, f64::EPSILON).unwrap_or_else(|_| Array2::zeros(left.dim()));
            let share = |place: usize| 1.0 / (inverse[[place, place]] * self.whole[kept[place]]);
            let shares: Vec<f64> = (0..kept.len()).map(share).collect();
            kept.iter()
                .zip(&shares)
                .for_each(|(&optic, &share)| told[optic] = if share.is_finite() { share } else { 0.0 });
            let least = (0..kept.len()).min_by(|&a, &b| told[kept[a]].total_cmp(&told[kept[b]]));
            match least.filter(|&place| told[kept[place]] < TOLD) {
                Some(place) => drop(kept.remove(place)),
                None => break,
            }
        }
        let reduced_chi2 = median(&self.chi2);
        let (mut step, mut sigma) = (vec![0.0; count], vec![f64::INFINITY; count]);
        let mut common_nm2 = Array2::zeros([self.moves_nm.nrows(); 2]);
        if !kept.is_empty() {
            let covariance = inverse * reduced_chi2.max(1.0);
            let towards = self.towards.select(Axis(0), &kept);
            let solution = covariance.dot(&towards) / reduced_chi2.max(1.0);
            for (place, &optic) in kept.iter().enumerate() {
                (step[optic], sigma[optic]) = (solution[place], covariance[[place, place]].sqrt());
            }
            let moves_nm = self.moves_nm.select(Axis(1), &kept) / self.images as f64;
            common_nm2 = estimator.pistons.centred(&moves_nm.dot(&covariance).dot(&moves_nm.t()));
        }
        Ok(Round { reduced_chi2, step, sigma, told, common_nm2 })
    }
}

/// Vectors cleared of each other, under `weight`.
fn cleared(vectors: Vec<Array1<f64>>, weight: ArrayView1<f64>) -> Vec<Array1<f64>> {
    let mut done = Vec::new();
    for vector in vectors {
        let vector = clear(vector, weight, &done);
        done.push(vector);
    }
    done
}

/// `vector` cleared of `others`, which are clear of each other.
fn clear(mut vector: Array1<f64>, weight: ArrayView1<f64>, others: &[Array1<f64>]) -> Array1<f64> {
    for other in others {
        let weighted = other * &weight;
        let share = weighted.dot(&vector) / weighted.dot(other);
        if share.is_finite() {
            vector.scaled_add(-share, other);
        }
    }
    vector
}

//! Fisher and covariance matrices of the images of a call. Images of one static wavefront have
//! nearly the same Fisher matrix and share it, because one takes as long as a hundred evaluations.

use crate::Result;
use crate::modal::assess::fisher::Sensitivity;
use crate::modal::fitter::ModalFitter;
use crate::modal::model::memory::MATRICES_AT_ONCE;
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::minimum::Minimum;
use crate::scene::Weighting;
use ndarray::{Array2, ArrayView1};
use rayon::prelude::*;

/// Wavefronts that differ by less than this, in waves RMS over the modes, share a Fisher matrix:
/// 0.02 rad change an error bar by about 2 % at the most.
const ALIKE_WAVES: f64 = 0.003;
/// Fluxes that differ by less than this fraction do, too: an error bar goes as the flux to the
/// power −½ to −1.
const ALIKE_FLUX: f64 = 0.02;

/// Fisher and covariance matrices of the images of a call.
pub(in crate::modal) struct ImageCovariances {
    /// Place of each image's matrices in `matrices`.
    place: Vec<usize>,
    /// Fisher matrix (per nm²) and covariance (nm², pistons about their mean).
    matrices: Vec<(Array2<f64>, Array2<f64>)>,
}

impl ImageCovariances {
    /// Computes the matrices of some `images` among the minima of `prepared`; afterwards an image
    /// is named by its place in `images`. `variance_e2` is that of the pixels of each under its
    /// fitted model.
    ///
    /// # Errors
    /// [`crate::Error::Value`] where no mode changes an image.
    pub(in crate::modal) fn new(
        fitter: &ModalFitter,
        images: &[usize],
        prepared: &[PreparedFrame],
        minima: &[Minimum],
        variance_e2: &[Vec<f64>],
    ) -> Result<Self> {
        let alike_nm = ALIKE_WAVES * fitter.model.optics.parts().wavelength_nm;
        let alike = |a: usize, b: usize| {
            let (a, b) = (images[a], images[b]);
            let differences =
                minima[a].coefficients_nm.iter().zip(&minima[b].coefficients_nm).map(|(a, b)| (a - b).powi(2));
            (minima[a].flux_e / minima[b].flux_e - 1.0).abs() < ALIKE_FLUX
                && prepared[a].floor_variance_e2 == prepared[b].floor_variance_e2
                && differences.sum::<f64>().sqrt() < alike_nm
        };
        let mut heads: Vec<usize> = Vec::new();
        let mut places = Vec::with_capacity(images.len());
        for image in 0..images.len() {
            let place = heads.iter().position(|&head| alike(image, head));
            places.push(place.unwrap_or(heads.len()));
            if place.is_none() {
                heads.push(image);
            }
        }
        let motions = &fitter.motions;
        // Images that are worked on at once share the memory.
        let threads = MATRICES_AT_ONCE.min(heads.len()).max(1);
        let compute = |&head: &usize| {
            let (image, minimum) = (&prepared[images[head]], &minima[images[head]]);
            let (at, exposure) = (ArrayView1::from(&minimum.coefficients_nm), &image.exposure);
            let variance_e2 = match fitter.recipe.weighting {
                Weighting::Noise => None,
                Weighting::None => Some(variance_e2[head].as_slice()),
            };
            let noise = (exposure.weight.as_slice(), variance_e2);
            let (reference, tile_bytes) = (&fitter.reference, fitter.model.tiles().derivative_bytes / threads);
            let sensitivity = Sensitivity::at(reference, at, minimum.flux_e, noise, exposure.photometry, tile_bytes);
            let covariance = motions.removed_from(&sensitivity.covariance()?);
            Ok((sensitivity.fisher, covariance))
        };
        let mut matrices = Vec::with_capacity(heads.len());
        for heads in heads.chunks(MATRICES_AT_ONCE) {
            matrices.extend(heads.par_iter().map(compute).collect::<Result<Vec<_>>>()?);
        }
        Ok(Self { place: places, matrices })
    }

    /// The matrices of one image, whose Fisher matrix and covariance from the noise are these.
    pub(in crate::modal) fn of_one(fitter: &ModalFitter, (fisher, noise_nm2): (Array2<f64>, Array2<f64>)) -> Self {
        Self { place: vec![0], matrices: vec![(fisher, fitter.motions.removed_from(&noise_nm2))] }
    }

    /// The Fisher matrix of an image, per nm².
    pub(in crate::modal) fn fisher(&self, image: usize) -> &Array2<f64> {
        &self.matrices[self.place[image]].0
    }

    /// The covariance of an image's modes, nm², if the model is right.
    pub(in crate::modal) fn covariance(&self, image: usize) -> &Array2<f64> {
        &self.matrices[self.place[image]].1
    }
}

//! An image of a group, with the model of its channel.

use crate::imaging::{CpuChain, Evaluation, LoadedImage, Mode, Optics, OpticsParts, Scratch};
use crate::modal::assess::chi2::ReducedChi2;
use crate::modal::assess::fisher::Sensitivity;
use crate::modal::assess::residual::{photometry, reweigh};
use crate::modal::assess::status::{Status, assess};
use crate::modal::fitter::ModalFitter;
use crate::modal::prepare::PreparedFrame;
use crate::modal::prepare::rejection::{reject, weigh_dead};
use crate::modal::solve::minimum::Minimum;
use crate::optimize::StopReason;
use crate::{Error, Result};
use ndarray::{Array1, Array2, concatenate};
use std::sync::Arc;

/// An image of a group.
pub(super) struct Member<'a> {
    pub(super) fitter: &'a ModalFitter,
    /// The model, with the amplitude of the diversity behind the modes where it is fitted.
    chain: Arc<CpuChain<f64>>,
    /// Channel and number of the image there.
    pub(super) place: [usize; 2],
    /// The image as it was prepared, with the weights of the data's own noise.
    original: PreparedFrame,
    /// With the weights of the present fit, without the outlier pixels that it rejected.
    pub(super) image: PreparedFrame,
    loaded: LoadedImage<f64>,
    scratch: Scratch<f64>,
    pub(super) evaluation: Evaluation,
}

/// The chain of `fitter`, with a last coefficient that adds its diversity, one nm of which is
/// `unit_nm`⁻¹ of it.
///
/// # Errors
/// Those of [`Optics::new`].
pub(super) fn chain_with_amplitude(fitter: &ModalFitter, unit_nm: f64) -> Result<Arc<CpuChain<f64>>> {
    let parts = fitter.model.optics.parts().clone();
    let diversity = Array2::from_shape_vec((1, parts.diversity_nm.len()), parts.diversity_nm.clone());
    let diversity = diversity.map_err(|error| Error::Internal(error.to_string()))? / unit_nm;
    let basis = concatenate(ndarray::Axis(0), &[parts.basis.view(), diversity.view()])
        .map_err(|error| Error::Internal(error.to_string()))?;
    let mut modes = parts.modes.clone();
    modes.push(Mode::Smooth(parts.basis.nrows()));
    let optics = Optics::new(OpticsParts { basis, modes, products: None, ..parts })?;
    Ok(Arc::new(CpuChain::new(Arc::new(optics))))
}

impl<'a> Member<'a> {
    pub(super) fn new(
        fitter: &'a ModalFitter,
        chain: Arc<CpuChain<f64>>,
        place: [usize; 2],
        prepared: &PreparedFrame,
    ) -> Self {
        let (loaded, scratch, evaluation) = (chain.empty_image(), chain.scratch(), chain.evaluation());
        let (original, image) = (prepared.clone(), prepared.clone());
        Self { fitter, chain, place, original, image, loaded, scratch, evaluation }
    }

    /// Number of pixels.
    pub(super) fn pixels(&self) -> usize {
        self.image.exposure.weight.len()
    }

    /// Takes the image as it was prepared.
    pub(super) fn begin(&mut self) -> Result<()> {
        self.image.clone_from(&self.original);
        if self.fitter.recipe.reject_outliers {
            weigh_dead(&mut self.image);
        }
        self.chain.set(&mut self.loaded, &self.image.exposure)
    }

    /// Objective and gradient at `coefficients`, into [`Member::evaluation`].
    pub(super) fn evaluate(&mut self, coefficients: &Array1<f64>) {
        self.chain.evaluate_one(&self.loaded, coefficients.view(), &mut self.scratch, &mut self.evaluation);
    }

    fn psf(&mut self, coefficients: &Array1<f64>) -> Vec<f64> {
        self.chain.psf_in(coefficients.view(), &mut self.scratch).to_vec()
    }

    /// Renews the weights from the model at `coefficients`; whether other pixels are rejected than
    /// before.
    pub(super) fn renew(&mut self, coefficients: &Array1<f64>) -> Result<bool> {
        let psf = self.psf(coefficients);
        let (found, has_other_pixels) = if self.fitter.recipe.reject_outliers {
            reject(&mut self.image, &psf, |image| photometry(&image.exposure, &psf))
        } else {
            (photometry(&self.image.exposure, &psf), false)
        };
        reweigh(&mut self.image.exposure, &psf, found, &self.image.floor_variance_e2);
        self.chain.set(&mut self.loaded, &self.image.exposure)?;
        Ok(has_other_pixels)
    }

    /// Gauss-Newton matrix at `coefficients`, flux and background projected out.
    pub(super) fn information(&mut self, coefficients: &Array1<f64>) -> Array2<f64> {
        let psf = self.psf(coefficients);
        let exposure = &self.image.exposure;
        let (flux_e, _) = photometry(exposure, &psf);
        let weights = (exposure.weight.as_slice(), None);
        let bytes = self.fitter.model.tiles().derivative_bytes;
        Sensitivity::at(&self.chain, coefficients.view(), flux_e, weights, exposure.photometry, bytes).fisher
    }

    /// Status of the minimum of this image.
    pub(super) fn status(&self, minimum: &Minimum) -> Status {
        assess(&self.fitter.model, &self.fitter.tilts, &self.image, minimum).status
    }

    /// The minimum of this image at `coefficients`, where the group has `unknowns` in `images`.
    pub(super) fn minimum(&mut self, coefficients: &Array1<f64>, (unknowns, images): (usize, usize)) -> Minimum {
        let psf = self.psf(coefficients);
        let found = photometry(&self.image.exposure, &psf);
        let noise = (self.image.floor_variance_e2.as_slice(), self.image.stated_share);
        let modes = self.fitter.model.optics.modes();
        Minimum {
            coefficients_nm: coefficients.slice(ndarray::s![..modes]).to_vec(),
            flux_e: found.0,
            background_e: found.1,
            evaluations: 0,
            reason: StopReason::Unfinished,
            chi2: ReducedChi2::new(&psf, found, &self.image.exposure, noise, unknowns.div_ceil(images)),
            images,
            is_unconfirmed: false,
        }
    }
}

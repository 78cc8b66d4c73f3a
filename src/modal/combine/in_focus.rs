//! Likelihood of the modes by images in focus, near an estimate from other images of the same
//! wavefront.
//!
//! An image in focus is the same for an even aberration and for its negative. Its objective J = Σ w
//! r² has many minima, and near the flat wavefront it is not quadratic: its own minimum may be far
//! from the truth in modes on which it has little information. With the estimate c₀ of other images
//! and their information Λ₀, both have a minimum, which Gauss-Newton steps find:
//!
//! ```text
//! K(c) = J(c) + (c − c₀)ᵀ Λ₀ (c − c₀)         F: half of the Gauss-Newton matrix of J
//! c ← c − (F + Λ₀)⁺ (½ ∇J + Λ₀ (c − c₀))
//! ½ J(c + x) ≈ ½ J(c) − xᵀ g + ½ xᵀ F x       g = −½ ∇J: the likelihood of the image about the minimum of K
//! ```
//!
//! Tip and tilt are each image's own, so that Λ₀ says nothing of them.

use crate::modal::assess::fisher::{Sensitivity, null_floor, pseudo_inverse, without};
use crate::modal::assess::tilts::spanned_tip_and_tilt;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::fitter::ModalFitter;
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::minimum::Minimum;
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1};

/// Gauss-Newton steps. The estimate of the others is within some error bars, 0.01 rad, of the
/// minimum, so that the second step is 1e-4 of the first; where modes on which the others say
/// little are farther away, the third is still below an error bar.
const STEPS: usize = 3;

/// Normal likelihood of the modes about a point that is not its mean.
#[derive(Debug, Clone)]
pub(in crate::modal) struct NearLikelihood {
    /// The point c, nm.
    pub(in crate::modal) coefficients_nm: Array1<f64>,
    /// F, per nm².
    pub(in crate::modal) information: Array2<f64>,
    /// g = F (mean − c), per nm.
    pub(in crate::modal) gradient: Array1<f64>,
}

impl NearLikelihood {
    /// Likelihood of the images `prepared`, near the minima of their own, which the minima of K
    /// replace.
    ///
    /// # Errors
    /// [`Error::Image`] where no image was fitted; [`Error::Value`] where no mode changes the
    /// images.
    pub(in crate::modal) fn new(
        fitter: &ModalFitter,
        prepared: &[PreparedFrame],
        minima: &mut [Minimum],
        others: &CombinedModes,
    ) -> Result<Self> {
        let modes = fitter.model.optics.modes();
        let own = spanned_tip_and_tilt(&fitter.model)?;
        let prior = without(pseudo_inverse(&others.covariance_nm2, null_floor(modes, modes))?, &own);
        let (mut information, mut right) = (Array2::zeros((modes, modes)), Array1::zeros(modes));
        let (mut sum_nm, mut count) = (Array1::zeros(modes), 0.0);
        for (frame, minimum) in prepared.iter().zip(minima) {
            if !minimum.reason.has_converged() {
                continue;
            }
            let image = Self::of_image(fitter, frame, minimum, &prior, &others.coefficients_nm)?;
            minimum.coefficients_nm = image.coefficients_nm.to_vec();
            // Images that the model does not explain say less, as in the combination of images.
            let weight = minimum.reduced_chi2().max(1.0).recip();
            let own_information = without(image.information, &own) * weight;
            right += &(own_information.dot(&image.coefficients_nm) + image.gradient * weight);
            information += &own_information;
            sum_nm += &image.coefficients_nm;
            count += 1.0;
        }
        if count == 0.0 {
            return Err(Error::Image("no image in focus was fitted".into()));
        }
        let coefficients_nm = sum_nm / count;
        let gradient = right - information.dot(&coefficients_nm);
        Ok(Self { coefficients_nm, information, gradient })
    }

    /// Likelihood of one image about the minimum of K, which is sought from `minimum`.
    fn of_image(
        fitter: &ModalFitter,
        frame: &PreparedFrame,
        minimum: &Minimum,
        prior: &Array2<f64>,
        others_nm: &[f64],
    ) -> Result<Self> {
        let (chain, exposure) = (&fitter.reference, &frame.exposure);
        let (mut image, mut scratch, mut evaluation) = (chain.empty_image(), chain.scratch(), chain.evaluation());
        chain.set(&mut image, exposure)?;
        let mut coefficients_nm = Array1::from(minimum.coefficients_nm.clone());
        let floor = null_floor(coefficients_nm.len(), exposure.weight.len());
        let mut step = 0;
        loop {
            chain.evaluate_one(&image, coefficients_nm.view(), &mut scratch, &mut evaluation);
            let noise = (exposure.weight.as_slice(), None);
            let tile_bytes = fitter.model.tiles().derivative_bytes;
            let (at, flux_e) = (coefficients_nm.view(), evaluation.flux_e);
            let information = Sensitivity::at(chain, at, flux_e, noise, exposure.photometry, tile_bytes).fisher;
            let gradient = ArrayView1::from(&evaluation.gradient).mapv(|slope| -0.5 * slope);
            if step == STEPS {
                return Ok(Self { coefficients_nm, information, gradient });
            }
            let to_others = ArrayView1::from(others_nm).to_owned() - &coefficients_nm;
            let downhill = &gradient + &prior.dot(&to_others);
            coefficients_nm += &pseudo_inverse(&(&information + prior), floor)?.dot(&downhill);
            step += 1;
        }
    }
}

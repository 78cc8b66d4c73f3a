//! Images that are combined, and the covariance of one of them: from the noise of a few, from the
//! scatter of many.

use crate::modal::assess::image_covariances::ImageCovariances;
use crate::modal::assess::residual::variance;
use crate::modal::assess::status::{ImageReport, Selection, Status, nothing_fitted};
use crate::modal::combine::agreement::{Agreement, TestedImages, Verdict, Whitening};
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::combine::sequence::{SEQUENCE, location, scatter};
use crate::modal::fitter::ModalFitter;
use crate::modal::left_out::{LeftOut, NormalEquations};
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::minimum::Minimum;
use crate::scene::Combine;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, Axis};
use rayon::prelude::*;
use std::slice::from_ref;

/// Covariances of the coefficients of one image, nm², pistons about their mean.
#[derive(Debug, Clone)]
pub(in crate::modal) struct SingleImage {
    /// From the noise.
    pub(super) noise_nm2: Array2<f64>,
    /// From the scatter of the images.
    pub(super) scatter_nm2: Array2<f64>,
    /// From an error of the model that the images share, and that does not average out.
    pub(super) shared_nm2: Array2<f64>,
}

/// Fits of images, which are combined.
pub(super) struct Fits<'a> {
    pub(super) fitter: &'a ModalFitter,
    pub(super) prepared: &'a [PreparedFrame],
    pub(super) minima: &'a [Minimum],
    pub(super) reports: &'a [ImageReport],
}

/// Which images are combined, and the covariance of one.
pub(super) struct Combined {
    /// Modes of each image, `[image, mode]`, nm, pistons by the same whole wavelengths.
    pub(super) fitted_nm: Array2<f64>,
    pub(super) used: Vec<usize>,
    pub(super) clipped: Vec<usize>,
    pub(super) agreement: Agreement,
    pub(super) single: SingleImage,
    /// Per nm².
    pub(super) fisher: Array2<f64>,
    /// Normal equations with what is left out, where one image is all there is.
    pub(super) equations: Option<NormalEquations>,
}

impl Fits<'_> {
    /// Eight images or more: error bars are from their scatter.
    pub(super) fn sequence(&self, mut fitted_nm: Array2<f64>, is_tested: bool) -> Result<Combined> {
        let (fitter, how) = (self.fitter, self.fitter.recipe.combine);
        let reports: Vec<&ImageReport> = self.reports.iter().collect();
        let Selection { mut used, mut clipped } = Selection::new(&reports, &fitted_nm, how);
        let (mut noise_nm2, mut fisher) =
            self.noise_at(used[0], &centre(&fitter.motions, &fitted_nm.select(Axis(0), &used), how))?;
        let is_plausible = |&image: &usize| matches!(self.reports[image].status, Status::Ok | Status::Misfit);
        let tested: Vec<usize> = (0..self.reports.len()).filter(is_plausible).collect();
        let mut agreement = Agreement::untested();
        if is_tested && tested.len() > 1 {
            let whitening = Whitening::new(fitter, &noise_nm2)?;
            let first = self.minima[used[0]].chi2.square_snr;
            let variance = |&image: &usize| self.scale(image) * first / self.minima[image].chi2.square_snr;
            let rows_nm = fitted_nm.select(Axis(0), &tested);
            let images = TestedImages::new(fitter, &whitening, rows_nm, tested.iter().map(variance).collect());
            agreement = images.agreement(&whitening).of_images(&tested);
            for (row_nm, &image) in images.coefficients_nm.outer_iter().zip(&tested) {
                fitted_nm.row_mut(image).assign(&row_nm);
            }
            let before = used.clone();
            Selection { used, clipped } = Selection::new(&reports, &fitted_nm, how);
            match &agreement.verdict {
                Verdict::Outliers(outliers) if how == Combine::ClippedMean => {
                    let (out, kept) = used.into_iter().partition(|image| outliers.contains(image));
                    (used, clipped) = (kept, [clipped, out].concat());
                    clipped.sort_unstable();
                }
                Verdict::SeveralWavefronts(_) => {
                    clipped.retain(|image| !tested.contains(image));
                    used = tested;
                }
                _ => {}
            }
            if used != before {
                let centre_nm = centre(&fitter.motions, &fitted_nm.select(Axis(0), &used), how);
                (noise_nm2, fisher) = self.noise_at(used[0], &centre_nm)?;
            }
        }
        let scatter_nm2 = fitter.motions.removed_from(&scatter(&fitted_nm.select(Axis(0), &used), how, &noise_nm2));
        let single = SingleImage { shared_nm2: Array2::zeros(noise_nm2.dim()), noise_nm2, scatter_nm2 };
        Ok(Combined { fitted_nm, used, clipped, agreement, single, fisher, equations: None })
    }

    /// Up to seven images that converged. The covariance of one is the mean over the used images of
    /// that from the noise, scaled by χ² where the model misfits; from four images on that of their
    /// scatter where it is larger (a static wavefront under a changing one scatters more than its
    /// noise); where they are not of one wavefront it is scaled by the reduced χ² of their
    /// differences. The equations with what is `left_out` have the Fisher matrix of an only image.
    pub(super) fn few_images(
        &self,
        mut fitted_nm: Array2<f64>,
        is_tested: bool,
        left_out: Option<&LeftOut>,
    ) -> Result<Combined> {
        let fitter = self.fitter;
        let reports: Vec<&ImageReport> = self.reports.iter().collect();
        let Selection { mut used, mut clipped } = Selection::new(&reports, &fitted_nm, fitter.recipe.combine);
        if used.is_empty() {
            return Err(nothing_fitted(&reports));
        }
        let variance_e2 = |&image: &usize| {
            let psf = fitter.reference.psf(ArrayView1::from(&self.minima[image].coefficients_nm));
            variance(&psf, &self.minima[image], &self.prepared[image].floor_variance_e2)
        };
        let mut noise_nm2 = Array2::<f64>::zeros([fitter.model.optics.modes(); 2]);
        let mut fisher = None;
        let mut agreement = Agreement::untested();
        let is_tested = is_tested && used.len() > 1 && reports[used[0]].status.has_converged();
        let only = left_out.filter(|_| used.len() == 1);
        let only =
            only.map(|of| of.normal_equations(&fitter.model, &[(&self.prepared[used[0]], &self.minima[used[0]])]));
        let mut equations = only.transpose()?;
        // Where no fit converged there may be many images, and each keeps two matrices.
        for images in used.clone().chunks(SEQUENCE) {
            let covariances = if let Some(own) = &mut equations {
                ImageCovariances::of_one(fitter, own.of_modes(fitter.model.optics.modes())?)
            } else {
                let variances: Vec<Vec<f64>> = images.par_iter().map(variance_e2).collect();
                ImageCovariances::new(fitter, images, self.prepared, self.minima, &variances)?
            };
            if is_tested {
                let rows_nm = fitted_nm.select(Axis(0), images);
                let tested = self.agreement_of_few(&covariances, images, rows_nm)?;
                agreement = tested.1.of_images(images);
                for (row_nm, &image) in tested.0.outer_iter().zip(images) {
                    fitted_nm.row_mut(image).assign(&row_nm);
                }
                if let Verdict::Outliers(outliers) = &agreement.verdict
                    && fitter.recipe.combine == Combine::ClippedMean
                {
                    clipped.clone_from(outliers);
                    used.retain(|image| !outliers.contains(image));
                }
            }
            for (place, &image) in images.iter().enumerate().filter(|(_, image)| used.contains(image)) {
                let share = self.scale(image) / used.len() as f64;
                noise_nm2.scaled_add(share, covariances.covariance(place));
                fisher.get_or_insert_with(|| covariances.fisher(place).clone());
            }
        }
        let used_nm = fitted_nm.select(Axis(0), &used);
        let scatter_nm2 = if agreement.is_significant() && clipped.is_empty() {
            // A common factor, as for channels: a sum of few scatters is of low rank, and the prior
            // of other modes would determine what scatters.
            &noise_nm2 * agreement.reduced_chi2
        } else {
            covariance_with_scatter(noise_nm2.clone(), &used_nm)
        };
        let fisher = fisher.ok_or_else(|| Error::Internal("no image is used".into()))?;
        let single = SingleImage { shared_nm2: Array2::zeros(noise_nm2.dim()), noise_nm2, scatter_nm2 };
        Ok(Combined { fitted_nm, used, clipped, agreement, single, fisher, equations })
    }

    /// Whether a few `images` with the modes `rows_nm` are of one wavefront, and their modes by the
    /// same whole wavelengths.
    fn agreement_of_few(
        &self,
        covariances: &ImageCovariances,
        images: &[usize],
        rows_nm: Array2<f64>,
    ) -> Result<(Array2<f64>, Agreement)> {
        let each = (0..images.len()).map(|place| covariances.covariance(place));
        let sum_nm2 =
            each.clone().fold(Array2::zeros([rows_nm.ncols(); 2]), |sum, covariance_nm2| sum + covariance_nm2);
        let whitening = Whitening::new(self.fitter, &(sum_nm2 / images.len() as f64))?;
        let pairs = each.zip(images);
        let variances = pairs.map(|(covariance_nm2, &image)| self.scale(image) * whitening.variance(covariance_nm2));
        let tested = TestedImages::new(self.fitter, &whitening, rows_nm, variances.collect());
        let agreement = tested.agreement(&whitening);
        Ok((tested.coefficients_nm, agreement))
    }

    /// Factor by which the variance of the noise of an image is scaled: its χ² where the model
    /// misfits.
    fn scale(&self, image: usize) -> f64 {
        self.reports[image].reduced_chi2.max(1.0)
    }

    /// Covariance of the image `image` from its noise (nm²), and its Fisher matrix (per nm²), at
    /// the wavefront of the whole sequence. One matrix serves all images, because the noise is the
    /// smallest part of their scatter.
    fn noise_at(&self, image: usize, coefficients_nm: &[f64]) -> Result<(Array2<f64>, Array2<f64>)> {
        let (fitter, prepared) = (self.fitter, &self.prepared[image]);
        let minimum = Minimum { coefficients_nm: coefficients_nm.to_vec(), ..self.minima[image].clone() };
        let psf = fitter.reference.psf(ArrayView1::from(coefficients_nm));
        let variance_e2 = variance(&psf, &minimum, &prepared.floor_variance_e2);
        let covariances =
            ImageCovariances::new(fitter, &[0], from_ref(prepared), from_ref(&minimum), from_ref(&variance_e2))?;
        Ok((covariances.covariance(0).clone(), covariances.fisher(0).clone()))
    }
}

/// Mean factor by which [`Fits::few_images`] scales the noise of the images `used`.
pub(super) fn scale_of_noise(reports: &[ImageReport], used: &[usize]) -> f64 {
    used.iter().map(|&image| reports[image].reduced_chi2.max(1.0)).sum::<f64>() / used.len() as f64
}

/// Covariance of one of a few images, `noise_nm2` from its noise: from four images on it is scaled
/// up to their scatter where that is larger.
pub(in crate::modal) fn covariance_with_scatter(mut noise_nm2: Array2<f64>, used_nm: &Array2<f64>) -> Array2<f64> {
    if used_nm.nrows() >= 4 {
        let deviations = used_nm - &location(used_nm, Combine::Mean).insert_axis(Axis(0));
        // A common factor keeps the matrix positive definite; the mean over the modes averages its
        // own scatter.
        let scatter = (&deviations * &deviations).sum() / (used_nm.nrows() - 1) as f64;
        noise_nm2 *= (scatter / noise_nm2.diag().sum()).max(1.0);
    }
    noise_nm2
}

/// Mean or median of images, pistons about their mean.
pub(in crate::modal) fn centre(motions: &GlobalMotions, used_nm: &Array2<f64>, how: Combine) -> Vec<f64> {
    let mut coefficients_nm = location(used_nm, how).to_vec();
    motions.remove(&mut coefficients_nm);
    coefficients_nm
}

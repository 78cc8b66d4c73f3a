//! Combination of the minima of single images into one estimate: mean or median, error bars, maps.

pub(in crate::modal) mod accumulator;
pub(in crate::modal) mod combined_modes;
pub(in crate::modal) mod diversity_error;
pub(in crate::modal) mod global_motions;
pub(in crate::modal) mod integers;
pub(in crate::modal) mod joint;
pub(in crate::modal) mod pistons;
pub(in crate::modal) mod sequence;
pub(in crate::modal) mod static_maps;

use super::fitter::ModalFitter;
use super::model::Model;
use super::prepare::PreparedFrame;
use crate::imaging::Precision;
use crate::modal::assess::image_covariances::ImageCovariances;
use crate::modal::assess::mean_residual::{EXPLAINED, mean_residual_chi2};
use crate::modal::assess::residual::variance;
use crate::modal::assess::status::{ImageReport, Selection, Status};
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::combine::sequence::{SEQUENCE, location, scatter, shrinkage_of_variance};
use crate::modal::combine::static_maps::StaticMaps;
use crate::modal::estimate::image_fits::{FittedCube, ImageFits};
use crate::modal::solve::minimum::Minimum;
use crate::modal::solve::restart::is_same_minimum;
use crate::modes::{Degeneracy, WEAK_BELOW};
use crate::scene::Combine;
use crate::statistics::median;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, Axis};
use rayon::prelude::*;
use std::slice::from_ref;

/// One image beside its fitted model, for pictures: `[y, x]`, electrons at the model's sampling.
#[derive(Debug, Clone)]
pub struct FittedImage {
    /// The data; NaN where bad.
    pub data_e: Array2<f64>,
    /// The fitted model.
    pub model_e: Array2<f64>,
    /// (data − model) in standard deviations; NaN where bad.
    pub residual_sigma: Array2<f64>,
}

/// Combination of some images: which, and the static wavefront of them.
#[derive(Debug, Clone)]
pub struct Combination {
    /// The images that were combined: of up to seven those with the best kind of status, from eight
    /// on all that converged and were not clipped.
    pub used_images: Vec<usize>,
    /// Images that converged and that the clipped mean left out.
    pub clipped_images: Vec<usize>,
    /// Mean or median over the images that were used.
    pub modes: CombinedModes,
    /// The part of the covariance that further images would average out, nm², with the prior; the
    /// rest is [`ModalFitter::shared_errors`].
    pub averaged_covariance_nm2: Array2<f64>,
    /// Segment errors and NCPA.
    pub maps: StaticMaps,
    /// Error bars of the maps.
    pub sigma_maps: StaticMaps,
}

impl Combination {
    /// That of images whose modes are `likelihood`, without a prior and without the errors that all
    /// images share.
    fn new(
        fitter: &ModalFitter,
        likelihood: CombinedModes,
        used_images: Vec<usize>,
        clipped_images: Vec<usize>,
    ) -> Result<Self> {
        let model = &fitter.model;
        let CombinedModes { coefficients_nm, covariance_nm2: averaged_covariance_nm2 } = with_prior(model, likelihood)?;
        let covariance_nm2 = fitter.with_shared(averaged_covariance_nm2.clone());
        let modes = CombinedModes { coefficients_nm, covariance_nm2 };
        let (maps, sigma_maps) = (StaticMaps::of_modes(model, &modes), StaticMaps::of_error_bars(model, &modes));
        Ok(Self { used_images, clipped_images, modes, averaged_covariance_nm2, maps, sigma_maps })
    }
}

/// Modal estimate of the static wavefront; see [`ModalFitter::estimate`].
#[derive(Debug, Clone)]
pub struct ModalEstimate {
    /// Report of each image, in order.
    pub images: Vec<ImageReport>,
    /// Coefficients of each image, `[image, mode]`, nm; NaN for unusable ones.
    pub image_coefficients_nm: Array2<f64>,
    /// How they were combined.
    pub combine: Combine,
    /// The static wavefront of the images that were used.
    pub combined: Combination,
    /// Reduced χ² of the mean residual of the images that were used, which shows errors of the
    /// model that are too small to be seen in one image; that of one image is its own. Where the
    /// median of χ² is above 2 it is 1: error bars of a wavefront that changes are from the
    /// scatter.
    pub mean_residual_chi2: f64,
    /// The first image that was used, with its model.
    pub compared: FittedImage,
    /// Combinations of modes that change the images little or not at all.
    pub degeneracy: Degeneracy,
    /// Wall-clock time of the estimate, without building the model.
    pub seconds: f64,
    /// Where it ran.
    pub device: String,
    /// Why the device that `auto` selected failed, as a sentence; `None` where it did not.
    pub device_failure: Option<String>,
    /// Precision of the chain.
    pub precision: Precision,
    /// The combined modes without a prior and without the errors that all images share.
    likelihood: CombinedModes,
    /// Whether the images were fitted together with those of other channels.
    pub(super) is_of_group: bool,
    /// Covariances of a single image.
    single: SingleImage,
}

/// Covariances of the coefficients of one image, nm², pistons about their mean.
#[derive(Debug, Clone)]
struct SingleImage {
    /// From the noise.
    noise_nm2: Array2<f64>,
    /// From the scatter of the images.
    scatter_nm2: Array2<f64>,
    /// From an error of the model that the images share, and that does not average out.
    shared_nm2: Array2<f64>,
}

impl ModalEstimate {
    /// The combined modes without a prior and without the errors that all images share.
    pub(super) fn likelihood(&self) -> &CombinedModes {
        &self.likelihood
    }

    /// Whether the images were fitted together with those of other channels, which determine what
    /// these do not.
    pub(crate) fn is_of_group(&self) -> bool {
        self.is_of_group
    }

    /// Number of images that were combined.
    pub fn used(&self) -> usize {
        self.combined.used_images.len()
    }

    /// Median reduced χ² of the images that were used.
    pub fn reduced_chi2(&self) -> f64 {
        median(&self.combined.used_images.iter().map(|&image| self.images[image].reduced_chi2).collect::<Vec<_>>())
    }

    /// Whether this estimate explains the images better than another one of them: by χ², or by its
    /// status where they ended in the same minimum.
    pub(crate) fn is_better_than(&self, other: &Self) -> bool {
        let [own, others] = [self, other].map(Self::reduced_chi2);
        let is_same = is_same_minimum(own, others);
        if is_same { self.status().rank() < other.status().rank() } else { own < others || others.is_nan() }
    }

    /// Whether eight images or more converged: then they are assessed as a sequence, and error bars
    /// are from the scatter between them.
    pub fn is_sequence(&self) -> bool {
        is_sequence(&self.images.iter().collect::<Vec<_>>())
    }

    /// The worst status among the images.
    pub fn status(&self) -> &Status {
        Status::worst(self.images.iter().map(|image| &image.status))
    }
}

pub(super) fn is_sequence(reports: &[&ImageReport]) -> bool {
    reports.iter().filter(|report| report.status.has_converged()).count() >= SEQUENCE
}

/// Combines the fits of all images of a call.
pub(super) fn combine(fitter: &ModalFitter, mut fitted: FittedCube) -> Result<ModalEstimate> {
    let (model, motions) = (&fitter.model, &fitter.motions);
    let ImageFits { coefficients_nm: image_coefficients_nm, reports: images } = fitted.assess(fitter);
    let FittedCube { indices, prepared, minima, .. } = &fitted;
    let reports: Vec<ImageReport> = indices.iter().map(|&image| images[image]).collect();
    let how = fitter.recipe.combine;
    let fitted_reports: Vec<&ImageReport> = reports.iter().collect();
    let fitted_nm = image_coefficients_nm.select(Axis(0), indices);
    let Selection { used, clipped } = Selection::new(&fitted_reports, &fitted_nm, how);
    let Some(&first) = used.first() else { return Err(nothing_fitted(&fitted_reports)) };
    let used_nm = fitted_nm.select(Axis(0), &used);
    let coefficients_nm = centre(motions, &used_nm, how);
    let (mut single, fisher) = if is_sequence(&fitted_reports) {
        let (noise_nm2, fisher) = noise_at(fitter, &prepared[first], &minima[first], &coefficients_nm)?;
        let scatter_nm2 = motions.removed_from(&scatter(&used_nm, how, &noise_nm2));
        (SingleImage { shared_nm2: Array2::zeros(noise_nm2.dim()), noise_nm2, scatter_nm2 }, fisher)
    } else {
        few_images(fitter, prepared, minima, &reports, &used, &used_nm)?
    };
    let mean_residual_chi2 = mean_residual_chi2(fitter, prepared, minima, &reports, &used);
    let shrinkage = shrinkage_of_variance(how, used.len());
    // The noise of a few images is scaled by their own χ² already.
    let scaled = if is_sequence(&fitted_reports) { 1.0 } else { scale_of_noise(&reports, &used) };
    if used.len() > 1 && mean_residual_chi2 > EXPLAINED.max(scaled) {
        single.shared_nm2 = &single.noise_nm2 * ((mean_residual_chi2 / scaled - 1.0) * shrinkage);
    }
    let covariance_nm2 = &single.scatter_nm2 * shrinkage + &single.shared_nm2;
    let likelihood = CombinedModes { coefficients_nm, covariance_nm2 };
    let images_of = |places: &[usize]| places.iter().map(|&place| indices[place]).collect::<Vec<_>>();
    Ok(ModalEstimate {
        combine: how,
        combined: Combination::new(fitter, likelihood.clone(), images_of(&used), images_of(&clipped))?,
        mean_residual_chi2,
        compared: fitted_image(fitter, &minima[first], &prepared[first]),
        degeneracy: Degeneracy::from_matrix(&fisher, model.basis.names(), WEAK_BELOW)?,
        images,
        image_coefficients_nm,
        likelihood,
        is_of_group: false,
        single,
        seconds: 0.0,
        device: String::new(),
        device_failure: None,
        precision: Precision::default(),
    })
}

impl ModalFitter {
    /// Combines some images of `estimate`, which this fitter made, without fitting them again: for
    /// a study of the number of images, or of another way to combine them.
    ///
    /// The images are combined as if there were no others, by the rules of [`Combine`] and
    /// [`Status`]; only the error bars of fewer than eight are from the scatter of the whole
    /// estimate, over the root of their number.
    ///
    /// # Errors
    /// [`Error::Value`] for an image that does not exist, [`Error::Image`] where none of them was
    /// fitted, [`Error::Shape`] for an estimate of another model.
    pub fn combine_subset(&self, estimate: &ModalEstimate, images: &[usize], how: Combine) -> Result<Combination> {
        let count = estimate.images.len();
        let (modes, own) = (estimate.image_coefficients_nm.ncols(), self.model.optics.modes());
        if modes != own {
            return Err(Error::Shape(format!("the estimate has {modes} modes where its fitter has {own}")));
        }
        if let Some(image) = images.iter().find(|&&image| image >= count) {
            return Err(Error::Value(format!(
                "image {image} does not exist: the estimate has {count} images, numbered from 0"
            )));
        }
        let reports: Vec<&ImageReport> = images.iter().map(|&image| &estimate.images[image]).collect();
        let coefficients_nm = estimate.image_coefficients_nm.select(Axis(0), images);
        let Selection { used, clipped } = Selection::new(&reports, &coefficients_nm, how);
        if used.is_empty() {
            return Err(nothing_fitted(&reports));
        }
        let motions = &self.motions;
        let used_nm = coefficients_nm.select(Axis(0), &used);
        let single_nm2 = if is_sequence(&reports) {
            motions.removed_from(&scatter(&used_nm, how, &estimate.single.noise_nm2))
        } else {
            estimate.single.scatter_nm2.clone()
        };
        let likelihood = CombinedModes {
            coefficients_nm: centre(motions, &used_nm, how),
            covariance_nm2: single_nm2 * shrinkage_of_variance(how, used.len()) + &estimate.single.shared_nm2,
        };
        let images_of = |places: &[usize]| places.iter().map(|&place| images[place]).collect::<Vec<_>>();
        Combination::new(self, likelihood, images_of(&used), images_of(&clipped))
    }
}

fn nothing_fitted(reports: &[&ImageReport]) -> Error {
    let reason = match reports.first().map(|report| &report.status) {
        Some(Status::NotConverged(reason)) => reason.to_string(),
        Some(Status::Unusable(refusal)) => refusal.to_string(),
        Some(other) => other.word().into(),
        None => "there is none".into(),
    };
    Error::Image(format!("no image could be fitted: {reason}"))
}

/// `likelihood` with the prior of the model's modes. Covariance and coefficients are of pistons
/// about their mean, and so is the result, which is moved along columns of that covariance.
pub(super) fn with_prior(model: &Model, likelihood: CombinedModes) -> Result<CombinedModes> {
    match &model.prior {
        Some(prior) => prior.posterior(&likelihood),
        None => Ok(likelihood),
    }
}

/// Mean or median of images, pistons about their mean.
pub(super) fn centre(motions: &GlobalMotions, used_nm: &Array2<f64>, how: Combine) -> Vec<f64> {
    let mut coefficients_nm = location(used_nm, how).to_vec();
    motions.remove(&mut coefficients_nm);
    coefficients_nm
}

/// Covariance of one image from its noise (nm²), and its Fisher matrix (per nm²), at the wavefront
/// of the whole sequence. One matrix serves all images, because the noise is the smallest part of
/// their scatter.
fn noise_at(
    fitter: &ModalFitter,
    prepared: &PreparedFrame,
    minimum: &Minimum,
    coefficients_nm: &[f64],
) -> Result<(Array2<f64>, Array2<f64>)> {
    let minimum = Minimum { coefficients_nm: coefficients_nm.to_vec(), ..minimum.clone() };
    let psf = fitter.reference.psf(ArrayView1::from(coefficients_nm));
    let variance_e2 = variance(&psf, &minimum, &prepared.floor_variance_e2);
    let covariances =
        ImageCovariances::new(fitter, &[0], from_ref(prepared), from_ref(&minimum), from_ref(&variance_e2))?;
    Ok((covariances.covariance(0).clone(), covariances.fisher(0).clone()))
}

/// Mean factor by which [`few_images`] scales the noise of the images `used`.
fn scale_of_noise(reports: &[ImageReport], used: &[usize]) -> f64 {
    used.iter().map(|&image| reports[image].reduced_chi2.max(1.0)).sum::<f64>() / used.len() as f64
}

/// Covariance of one of a few images, and the Fisher matrix of the first: the mean over the used
/// images of the covariance from the noise, scaled by χ² where the model misfits; from four images
/// on that of their scatter where it is larger (a static wavefront under a changing one scatters
/// more than its noise).
fn few_images(
    fitter: &ModalFitter,
    prepared: &[PreparedFrame],
    minima: &[Minimum],
    reports: &[ImageReport],
    used: &[usize],
    used_nm: &Array2<f64>,
) -> Result<(SingleImage, Array2<f64>)> {
    let variance_e2 = |&image: &usize| {
        let psf = fitter.reference.psf(ArrayView1::from(&minima[image].coefficients_nm));
        variance(&psf, &minima[image], &prepared[image].floor_variance_e2)
    };
    let count = used.len() as f64;
    let mut noise_nm2 = Array2::<f64>::zeros([fitter.model.optics.modes(); 2]);
    let mut fisher = None;
    // Where no fit converged there may be many images, and each keeps two matrices.
    for images in used.chunks(SEQUENCE) {
        let variances: Vec<Vec<f64>> = images.par_iter().map(variance_e2).collect();
        let covariances = ImageCovariances::new(fitter, images, prepared, minima, &variances)?;
        for (place, &image) in images.iter().enumerate() {
            noise_nm2.scaled_add(reports[image].reduced_chi2.max(1.0) / count, covariances.covariance(place));
        }
        fisher.get_or_insert_with(|| covariances.fisher(0).clone());
    }
    let scatter_nm2 = covariance_with_scatter(noise_nm2.clone(), used_nm);
    let fisher = fisher.ok_or_else(|| Error::Internal("no image is used".into()))?;
    Ok((SingleImage { shared_nm2: Array2::zeros(noise_nm2.dim()), noise_nm2, scatter_nm2 }, fisher))
}

/// Covariance of one of a few images, `noise_nm2` from its noise: from four images on it is scaled
/// up to their scatter where that is larger.
pub(super) fn covariance_with_scatter(mut noise_nm2: Array2<f64>, used_nm: &Array2<f64>) -> Array2<f64> {
    if used_nm.nrows() >= 4 {
        let deviations = used_nm - &location(used_nm, Combine::Mean).insert_axis(Axis(0));
        // A common factor keeps the matrix positive definite; the mean over the modes averages its
        // own scatter.
        let scatter = (&deviations * &deviations).sum() / (used_nm.nrows() - 1) as f64;
        noise_nm2 *= (scatter / noise_nm2.diag().sum()).max(1.0);
    }
    noise_nm2
}

/// The image of a fit beside its model.
pub(super) fn fitted_image(fitter: &ModalFitter, minimum: &Minimum, prepared: &PreparedFrame) -> FittedImage {
    let psf = fitter.reference.psf(ArrayView1::from(&minimum.coefficients_nm));
    let variance_e2 = variance(&psf, minimum, &prepared.floor_variance_e2);
    let size = fitter.model.preparation.pixels;
    let pixel = |(v, u): (usize, usize)| v * size + u;
    let model_e = Array2::from_shape_fn((size, size), |at| minimum.flux_e * psf[pixel(at)] + minimum.background_e);
    let data_e = Array2::from_shape_fn((size, size), |at| {
        if variance_e2[pixel(at)].is_finite() { prepared.exposure.data_e[pixel(at)] } else { f64::NAN }
    });
    let residual_sigma =
        Array2::from_shape_fn((size, size), |at| (data_e[at] - model_e[at]) / variance_e2[pixel(at)].sqrt());
    FittedImage { data_e, model_e, residual_sigma }
}

//! Combination of the minima of single images into one estimate: mean or median, error bars, maps.

pub(in crate::modal) mod accumulator;
pub(in crate::modal) mod agreement;
pub(in crate::modal) mod combined_modes;
pub(in crate::modal) mod diversity_error;
pub(in crate::modal) mod global_motions;
pub(in crate::modal) mod integers;
pub(in crate::modal) mod joint;
pub(in crate::modal) mod pistons;
pub(in crate::modal) mod sequence;
pub(in crate::modal) mod single_image;
pub(in crate::modal) mod staircases;
pub(in crate::modal) mod static_maps;

use super::fitter::ModalFitter;
use super::model::Model;
use super::prepare::PreparedFrame;
use crate::imaging::Precision;
use crate::modal::assess::mean_residual::{EXPLAINED, mean_residual_chi2};
use crate::modal::assess::residual::variance;
use crate::modal::assess::status::{ImageReport, Selection, Status, assess_all, nothing_fitted};
use crate::modal::combine::agreement::Agreement;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::sequence::{SEQUENCE, scatter, shrinkage_of_variance};
use crate::modal::combine::single_image::{Combined, Fits, SingleImage, centre, scale_of_noise};
use crate::modal::combine::static_maps::StaticMaps;
use crate::modal::estimate::image_fits::{FittedCube, ImageFits};
use crate::modal::left_out::{OwnEquations, WholeWavefront, WithLeftOut};
use crate::modal::solve::minimum::Minimum;
use crate::modal::solve::restart::is_same_minimum;
use crate::modes::{Degeneracy, WEAK_BELOW};
use crate::scene::Combine;
use crate::statistics::median;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1, Axis};

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
    /// images share; `whole` has what was left out of them, and takes both.
    fn new(
        fitter: &ModalFitter,
        likelihood: CombinedModes,
        whole: Option<&mut WholeWavefront>,
        used_images: Vec<usize>,
        clipped_images: Vec<usize>,
    ) -> Result<Self> {
        let model = &fitter.model;
        let CombinedModes { coefficients_nm, covariance_nm2: averaged_covariance_nm2 } = with_prior(model, likelihood)?;
        let covariance_nm2 = fitter.with_shared(averaged_covariance_nm2.clone());
        let modes = CombinedModes { coefficients_nm, covariance_nm2 };
        let [maps, sigma_maps] = match whole {
            Some(whole) => {
                whole.take_prior(model)?;
                whole.take_fitted(&modes);
                whole.maps(model)
            }
            None => [StaticMaps::of_modes(model, &modes), StaticMaps::of_error_bars(model, &modes)],
        };
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
    /// Whether the images are of one wavefront.
    pub agreement: Agreement,
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
    /// The combined modes without a prior and without the errors that all images share, as if
    /// nothing was left out.
    likelihood: CombinedModes,
    /// Report of each image by its modes alone, where what they leave out was marginalised.
    by_modes: Option<Vec<ImageReport>>,
    /// What the modes leave out, where that was marginalised.
    left_out: Option<WithLeftOut>,
    /// The equations of what is left out, for a combination with other channels.
    left_out_equations: Option<OwnEquations>,
    /// Whether the images were fitted together with those of other channels.
    pub(super) is_of_group: bool,
    /// Covariances of a single image.
    single: SingleImage,
}

impl ModalEstimate {
    /// The combined modes without a prior and without the errors that all images share, as if
    /// nothing was left out.
    pub(super) fn likelihood(&self) -> &CombinedModes {
        &self.likelihood
    }

    /// Report of an image by its modes alone, before what these leave out explains a part of χ².
    pub(crate) fn report_by_modes(&self, image: usize) -> &ImageReport {
        &self.by_modes.as_ref().unwrap_or(&self.images)[image]
    }

    /// The worst status among the images by these reports.
    pub(crate) fn status_by_modes(&self) -> &Status {
        let reports = self.by_modes.as_ref().unwrap_or(&self.images);
        Status::worst(reports.iter().map(|image| &image.status))
    }

    /// What the modes leave out, where it is marginalised.
    pub(crate) fn left_out(&self) -> Option<&WithLeftOut> {
        self.left_out.as_ref()
    }

    /// The equations of what is left out, where it is marginalised.
    pub(super) fn left_out_equations(&self) -> Option<&OwnEquations> {
        self.left_out_equations.as_ref()
    }

    /// Forgets what the modes of this channel leave out, which that of all channels replaces.
    pub(crate) fn forget_left_out(&mut self) {
        self.left_out = None;
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

    /// The worst status among the images, and contradictory where they are of several wavefronts.
    pub fn status_of_all(&self) -> Status {
        let contradiction = self.agreement.is_contradictory().then_some(&Status::Contradictory);
        *Status::worst(self.images.iter().map(|image| &image.status).chain(contradiction))
    }

    /// The worst status among the images.
    pub fn status(&self) -> &Status {
        Status::worst(self.images.iter().map(|image| &image.status))
    }
}

pub(super) fn is_sequence(reports: &[&ImageReport]) -> bool {
    reports.iter().filter(|report| report.status.has_converged()).count() >= SEQUENCE
}

/// Combines the fits of all images of a call; `is_tested` whether they are to be of one wavefront.
pub(super) fn combine(fitter: &ModalFitter, mut fitted: FittedCube, is_tested: bool) -> Result<ModalEstimate> {
    let (model, motions) = (&fitter.model, &fitter.motions);
    let ImageFits { mut coefficients_nm, reports: mut images } = fitted.assess(fitter);
    let FittedCube { indices, prepared, minima, .. } = &mut fitted;
    let reports: Vec<ImageReport> = indices.iter().map(|&image| images[image]).collect();
    let how = fitter.recipe.combine;
    let fitted_reports: Vec<&ImageReport> = reports.iter().collect();
    let is_sequence = is_sequence(&fitted_reports);
    let fits = Fits { fitter, prepared, minima, reports: &reports };
    let fitted_nm = coefficients_nm.select(Axis(0), indices);
    let left_out_of_modes = fitter.left_out()?;
    let Combined { fitted_nm, used, clipped, agreement, mut single, fisher, equations } = if is_sequence {
        fits.sequence(fitted_nm, is_tested)?
    } else {
        fits.few_images(fitted_nm, is_tested, left_out_of_modes)?
    };
    for ((row_nm, &image), minimum) in fitted_nm.outer_iter().zip(indices.iter()).zip(minima.iter_mut()) {
        minimum.coefficients_nm = row_nm.to_vec();
        coefficients_nm.row_mut(image).assign(&row_nm);
    }
    let (prepared, first) = (&*prepared, used[0]);
    let mean_residual_chi2 = mean_residual_chi2(fitter, prepared, minima, &reports, &used);
    // The mean of several wavefronts is as far from each of them as they are from each other.
    let shrinkage = if agreement.is_contradictory() { 1.0 } else { shrinkage_of_variance(how, used.len()) };
    // The noise of a few images is scaled by their own χ² already.
    let scaled = if is_sequence { 1.0 } else { scale_of_noise(&reports, &used) };
    if used.len() > 1 && mean_residual_chi2 > EXPLAINED.max(scaled) {
        single.shared_nm2 = &single.noise_nm2 * ((mean_residual_chi2 / scaled - 1.0) * shrinkage);
    }
    let covariance_nm2 = &single.scatter_nm2 * shrinkage + &single.shared_nm2;
    let centre_nm = centre(motions, &fitted_nm.select(Axis(0), &used), how);
    let mut likelihood = CombinedModes { coefficients_nm: centre_nm, covariance_nm2 };
    let (mut combined, mut left_out, mut left_out_equations, mut by_modes) = (likelihood.clone(), None, None, None);
    let degeneracy = || Degeneracy::from_matrix(&fisher, model.basis.names(), WEAK_BELOW);
    let mut weak = None;
    if let Some(modes) = left_out_of_modes {
        let fits = || used.iter().map(|&image| (&prepared[image], &minima[image])).collect::<Vec<_>>();
        let equations = equations.map_or_else(|| modes.normal_equations(model, &fits()), Ok)?;
        let noise_nm2 = &single.noise_nm2 * shrinkage + &single.shared_nm2;
        let mean_chi2 = if used.len() > 1 { mean_residual_chi2 } else { 1.0 };
        // Both have parts of one thread.
        let marginalised = || modes.marginalised(motions, (equations, mean_chi2), &likelihood, &noise_nm2);
        let (found, of_modes) = rayon::join(marginalised, degeneracy);
        weak = Some(of_modes?);
        let (found, alone, equations) = found?;
        (combined, likelihood, left_out_equations) = (found.modes.clone(), alone, Some(equations));
        for (&place, explained) in used.iter().zip(&found.explained_chi2) {
            let chi2 = &mut minima[place].chi2;
            chi2.value -= explained / chi2.freedom;
        }
        by_modes = Some(images.clone());
        for (&image, report) in indices.iter().zip(assess_all(fitter, prepared, minima)) {
            // In a wrong minimum what was left out explains a part of χ², in a right one all of it.
            let is_explained = report.reduced_chi2 <= report.suspicious_chi2;
            let status = if is_explained { report.status } else { images[image].status };
            images[image] = ImageReport { status, ..report };
        }
        left_out = Some(found);
    }
    let images_of = |places: &[usize]| places.iter().map(|&place| indices[place]).collect::<Vec<_>>();
    Ok(ModalEstimate {
        combine: how,
        combined: Combination::new(
            fitter,
            combined,
            left_out.as_mut().map(|left_out| &mut left_out.whole),
            images_of(&used),
            images_of(&clipped),
        )?,
        mean_residual_chi2,
        agreement: agreement.of_images(indices),
        compared: fitted_image(fitter, &minima[first], &prepared[first]),
        degeneracy: weak.map_or_else(degeneracy, Ok)?,
        images,
        image_coefficients_nm: coefficients_nm,
        likelihood,
        by_modes,
        left_out,
        left_out_equations,
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
        Combination::new(self, likelihood, None, images_of(&used), images_of(&clipped))
    }
}

/// `likelihood` with the prior of the model's modes. Covariance and coefficients are of pistons
/// about their mean, and so is the result, which is moved along columns of that covariance.
pub(super) fn with_prior(model: &Model, likelihood: CombinedModes) -> Result<CombinedModes> {
    match &model.prior {
        Some(prior) => prior.posterior(&likelihood),
        None => Ok(likelihood),
    }
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

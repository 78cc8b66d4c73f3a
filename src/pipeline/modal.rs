//! Modal estimate: static modes fitted to each image, and the images combined.

use super::budget::ErrorTerm;
use super::consistency::Electrons;
use super::control::{Control, Stage};
use super::estimate::{Basis, Estimate, Figure, OpticalParameter};
use super::image_changes::{CHANGING, image_changes};
use super::misfit;
use super::model_selection;
use super::outcome::ImageOutcome;
use super::policy::Policy;
use super::warnings;
use crate::Result;
use crate::imaging::Chain;
use crate::metrics::MapGram;
use crate::modal::{self, BasisCache, Cube, FittedOptic, ImageStatus, Model};
use crate::modes::Group;
use crate::scene::{NollRange, Scene};
use ndarray::Array2;
use std::sync::Arc;
use std::time::Instant;

/// Fit of the images of one channel.
pub(super) struct Fitted {
    /// The fitter, and what it found.
    pub(super) fit: modal::ModalFit,
    /// The extension of the scene's model that explains the images, where there is one.
    pub(super) selected: Option<model_selection::Selected>,
    /// Likely cause of a misfit, as a sentence.
    cause: Option<String>,
    /// Reduced χ² of the differences of the images, where they are not explained.
    changes: Option<f64>,
    model_seconds: f64,
}

pub(super) fn estimate(
    scene: &Scene,
    policy: &Policy,
    control: &Control,
    cache: &BasisCache,
    images: &Electrons,
) -> Result<Estimate> {
    fit(scene, policy, control, cache, images)?.into_estimate(policy)
}

/// Fits the images of one channel by its scene.
pub(super) fn fit(
    scene: &Scene,
    policy: &Policy,
    control: &Control,
    cache: &BasisCache,
    images: &Electrons,
) -> Result<Fitted> {
    let started = Instant::now();
    let count = images.len();
    control.enter(Stage::Preparing, 0);
    let mut open = |estimator: &modal::ModalFitter| {
        control.check("the model was built, no image was fitted")?;
        estimator.model().check_images(count)?;
        control.enter(Stage::Fitting, count);
        let optics = estimator.model().optics.clone();
        // No more images than this are fitted at once.
        let capacity = count.min(estimator.model().tiles().images);
        Chain::open(optics, scene.estimate.device.into(), scene.estimate.precision.into(), capacity)
    };
    let mut watch = |done: usize, all: usize| {
        control.advance_to(done);
        if done == all {
            control.enter(Stage::Combining, 0);
        }
    };
    let cube = Cube { images_e: images.images_e.view(), bad: images.bad.view(), read_noise_e: images.read_noise_e };
    let recipe = policy.recipe(scene);
    let mut fitted = modal::estimate_with(scene, recipe, cache, cube, &mut open, Some(control.flag()), &mut watch)?;
    control.check("the images were fitted, nothing was written")?;
    // Only a misfit asks for a cause.
    let is_explained = fitted.1.status().kind() == ImageStatus::Ok;
    let changes = if is_explained { None } else { image_changes(scene, images) };
    let (mut cause, mut selected) = (None, None);
    if let Some(&image) = fitted.1.used_images.first()
        && !is_explained
        && changes.is_none_or(|chi2| chi2 < CHANGING)
    {
        control.check("the images were fitted, the cause of a residual was not sought")?;
        let (model, diversity) = (fitted.0.model(), fitted.0.diversity_projection()?);
        let case = misfit::Case { scene, policy, control, cache, images, image, model, diversity: &diversity };
        cause = case.likely_cause(&fitted.1)?;
        if cause.is_none() && model_selection::may_extend(scene, policy) {
            let mut one = |scene: &Scene| fit_one(scene, policy, control, cache, cube, image);
            selected = model_selection::select(scene, control, &fitted, image, &mut one)?;
        }
    }
    if let Some(selected) = &selected {
        let (scene, flag) = (&selected.scene, Some(control.flag()));
        fitted = modal::estimate_with(scene, policy.recipe(scene), cache, cube, &mut open, flag, &mut watch)?;
        control.check("the images were fitted, nothing was written")?;
    }
    let model_seconds = started.elapsed().as_secs_f64() - fitted.1.seconds;
    Ok(Fitted { fit: fitted, selected, cause, changes, model_seconds })
}

impl Fitted {
    /// The estimate of this channel alone.
    pub(super) fn into_estimate(self, policy: &Policy) -> Result<Estimate> {
        let Self { fit: (fitter, found), selected, cause, changes, model_seconds } = self;
        let model = fitter.model();
        let diversity = fitter.diversity_projection()?;
        let errors = ExpectedErrors::new(model)?;
        let sigma_nm = errors.rms_nm(&found.combined.covariance_nm2)?;
        let pupil = model.telescope.pupil.clone();
        let wavefront_nm = &found.phasing_nm + &found.ncpa_nm;
        let scene_used = fitter.scene();
        let remarks = [
            selected.as_ref().map(|selected| selected.remark.clone()),
            warnings::diversity_remark(&diversity, scene_used),
            warnings::orientation_remark(scene_used, &model.telescope)?,
        ];
        let outcomes = found.images.iter().enumerate().map(|(image, report)| {
            let is_in = |list: &[usize]| list.contains(&image);
            ImageOutcome::from_modal(report, is_in(&found.used_images), is_in(&found.clipped_images))
        });
        Ok(Estimate {
            policy: *policy,
            basis: Basis { names: model.basis.names().to_vec(), groups: model.basis.groups().to_vec() },
            phasing: Figure::from_map(&pupil, found.phasing_nm.view(), sigma_nm[0])?,
            ncpa: Figure::from_map(&pupil, found.ncpa_nm.view(), sigma_nm[1])?,
            wavefront: Figure::from_map(&pupil, wavefront_nm.view(), sigma_nm[2])?,
            error_budget: error_budget(&errors, &fitter, &found)?,
            images: outcomes.collect(),
            combine: Some(found.combine),
            reduced_chi2: found.reduced_chi2(),
            is_sequence: found.is_sequence(),
            status: found.status().kind(),
            model: added_modes(fitter.recipe(), selected.as_ref().map(|selected| selected.added.as_str())),
            optics: fitter.fitted_optics().iter().map(OpticalParameter::from).collect(),
            warnings: warnings::modal_warnings(&fitter, &diversity, &found, changes).into_iter().chain(cause).collect(),
            remarks: remarks.into_iter().flatten().collect(),
            scene: fitter.scene().clone(),
            pupil,
            precision: fitter.scene().estimate.precision,
            model_seconds,
            seconds: found.seconds,
            device: found.device,
            coefficients_nm: found.combined.coefficients_nm,
            covariance_nm2: found.combined.covariance_nm2,
            phasing_nm: found.phasing_nm,
            ncpa_nm: found.ncpa_nm,
            phasing_sigma_nm: found.phasing_sigma_nm,
            ncpa_sigma_nm: found.ncpa_sigma_nm,
            image_coefficients_nm: found.image_coefficients_nm,
            compared: Some(found.compared),
            degeneracy: Some(found.degeneracy),
            truth: None,
            fitter: Some(Arc::new(fitter)),
            map: None,
            channels: Vec::new(),
            integers: Vec::new(),
        })
    }
}

impl From<&FittedOptic> for OpticalParameter {
    fn from(optic: &FittedOptic) -> Self {
        let FittedOptic { segment, scene, value, sigma, identifiable_share, .. } = *optic;
        Self { key: optic.key(), segment, scene, value, sigma, identifiable: identifiable_share }
    }
}

/// Fit of image `image` of `cube` alone by `scene`; `None` where the optical parameters that the scene fits would not lower
/// χ² enough in a first step.
fn fit_one(
    scene: &Scene,
    policy: &Policy,
    control: &Control,
    cache: &BasisCache,
    cube: Cube,
    image: usize,
) -> Result<Option<(modal::ModalFitter, modal::ModalEstimate)>> {
    let only = ndarray::s![image..=image, .., ..];
    let cube = Cube { images_e: cube.images_e.slice(only), bad: cube.bad.slice(only), ..cube };
    // A model that explains the image does so at its first minimum; restarts of the others would take most of the time.
    let (recipe, flag) = (modal::Recipe { restarts: 0, ..policy.recipe(scene) }, Some(control.flag()));
    let mut open = |fitter: &modal::ModalFitter| {
        let optics = fitter.model().optics.clone();
        Chain::open(optics, scene.estimate.device.into(), scene.estimate.precision.into(), 1)
    };
    if scene.estimate.fit_optics.is_empty() {
        return modal::estimate_with(scene, recipe, cache, cube, &mut open, flag, &mut |_, _| {}).map(Some);
    }
    let Some((fitter, _)) = modal::explaining_fit(scene, &recipe, cache, cube, 1.0, flag)? else { return Ok(None) };
    let mut chain = open(&fitter)?;
    let Cube { images_e, bad, read_noise_e } = cube;
    let found = fitter.estimate(&mut chain, images_e, bad, read_noise_e, flag, &mut |_, _| {})?;
    Ok(Some((fitter, found)))
}

/// Description of the modes that were added to those of the scene, `selected` among them.
fn added_modes(recipe: &modal::Recipe, selected: Option<&str>) -> String {
    let exact = match recipe.exact_zernikes {
        NollRange::None => "the scene's modes".into(),
        NollRange::Span { first, last } => format!("Zernikes {first} to {last} added"),
    };
    let with_prior = match recipe.prior_zernikes {
        NollRange::Span { first, last } if recipe.exact_zernikes != NollRange::None => {
            format!("{exact}, {first} to {last} with a prior")
        }
        _ => exact,
    };
    match selected {
        None => with_prior,
        Some(selected) => format!("{with_prior}; extended by {selected}"),
    }
}

/// Expected RMS over the pupil of errors of the coefficients, piston, tip and tilt removed as in a residual.
pub(super) struct ExpectedErrors {
    gram: MapGram,
    groups: Vec<Group>,
}

impl ExpectedErrors {
    pub(super) fn new(model: &Model) -> Result<Self> {
        let pupil = &model.telescope.pupil;
        let weight = &pupil.amplitude / pupil.weight_sum();
        let [piston, tip, tilt] = MapGram::planes(pupil).map(|plane| model.basis.along(&(plane * &weight)));
        let gram = MapGram::from_products(model.basis.gram(&weight)?, [piston?, tip?, tilt?]);
        Ok(Self { gram, groups: model.basis.groups().to_vec() })
    }

    /// Expected RMS of the errors of phasing, NCPA and their sum, nm.
    pub(super) fn rms_nm(&self, covariance_nm2: &Array2<f64>) -> Result<[f64; 3]> {
        let rms_nm = |keep: &dyn Fn(Group) -> bool| {
            let inside = |(k, l): (usize, usize)| keep(self.groups[k]) && keep(self.groups[l]);
            let part =
                Array2::from_shape_fn(covariance_nm2.dim(), |at| if inside(at) { covariance_nm2[at] } else { 0.0 });
            self.gram.expected_rms_nm(part.view())
        };
        Ok([rms_nm(&|group| group == Group::Segment)?, rms_nm(&|group| group == Group::Ncpa)?, rms_nm(&|_| true)?])
    }
}

/// Terms of the covariance: the part that the images average out, and the errors that all of them share.
fn error_budget(
    errors: &ExpectedErrors,
    fitter: &modal::ModalFitter,
    found: &modal::ModalEstimate,
) -> Result<Vec<ErrorTerm>> {
    let averaged = if found.is_sequence() { "scatter between images" } else { "noise" };
    let shared = fitter.shared_errors().iter().map(|shared| (shared.name, &shared.covariance_nm2));
    let term = |(name, covariance_nm2): (&str, &Array2<f64>)| -> Result<ErrorTerm> {
        let [phasing_nm, ncpa_nm, _] = errors.rms_nm(covariance_nm2)?;
        Ok(ErrorTerm { name: name.into(), phasing_nm, ncpa_nm })
    };
    std::iter::once((averaged, &found.averaged_covariance_nm2)).chain(shared).map(term).collect()
}

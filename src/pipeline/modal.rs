//! Modal estimate of one channel: from the fit of its images, with maps, error bars, warnings and
//! remarks.

use super::estimate::{Basis, Estimate, Figures, MethodResult, ModalSummary, Run, WithoutStaircases};
use super::modal_task::Fitted;
use super::outcome::ImageOutcome;
use super::policy::Policy;
use super::{remarks, warnings};
use crate::metrics::MapGram;
use crate::modal::{self, Combination, Model, WithLeftOut};
use crate::scene::NollRange;
use crate::statics::ErrorTerm;
use crate::telescope::unit_remark;
use crate::{Error, Result};
use ndarray::{Array2, s};
use std::ops::Range;
use std::sync::Arc;

/// Name of the term of the error budget that has what the modes leave out.
pub(super) const NOT_FITTED: &str = "what is not fitted";

impl Fitted {
    /// The estimate of this channel alone.
    pub(super) fn into_estimate(self, policy: &Policy) -> Result<Estimate> {
        let Self { fit: (fitter, found), scene, selected, cause, changes, model_seconds } = self;
        let model = fitter.model();
        let diversity = fitter.diversity_projection()?;
        let errors = ExpectedErrors::new(model, found.left_out())?;
        let pupil = model.telescope.pupil.clone();
        let sigma_nm = errors.of_maps_nm(&found.combined.modes.covariance_nm2, found.left_out())?;
        let figures = Figures::new(&pupil, &found.combined.maps, sigma_nm)?;
        let without_staircases = WithoutStaircases::of((&errors, model), found.left_out(), &figures)?;
        let open = without_staircases.as_ref().map(|without| without.remark(&figures));
        let (status, of_step) = (found.status_of_all(), warnings::meaningful_left_out(&found, changes));
        let left_out = of_step.map(remarks::left_out_remarks).unwrap_or_default();
        let extended = selected.as_ref().map(|selected| selected.remark.clone());
        let of_scene = [
            remarks::diversity_remark(&diversity, &scene),
            remarks::averaged_pupil_remark(&scene, &model.telescope),
            remarks::dark_segments_remark(&scene),
            remarks::orientation_remark(&scene, &model.telescope)?,
            unit_remark(&scene)?,
        ];
        let Combination { used_images, clipped_images, .. } = &found.combined;
        let outcomes = found.images.iter().enumerate().map(|(image, report)| ImageOutcome {
            report: *report,
            channel: 0,
            message: report.sentence(),
            is_used: used_images.contains(&image),
            is_clipped: clipped_images.contains(&image),
        });
        Ok(Estimate {
            policy: *policy,
            basis: Basis { names: model.basis.names().to_vec(), groups: model.basis.groups().to_vec() },
            figures,
            without_staircases,
            error_budget: error_budget(&errors, &fitter, &found)?,
            model_errors: of_step.map(|left_out| left_out.errors.clone()).unwrap_or_default(),
            images: outcomes.collect(),
            channels: Vec::new(),
            status,
            reduced_chi2: found.reduced_chi2(),
            is_sequence: found.is_sequence(),
            model: added_modes(fitter.recipe(), selected.as_ref().map(|selected| selected.added.as_str())),
            optics: fitter.fitted_optics().to_vec(),
            integers: Vec::new(),
            warnings: warnings::modal_warnings(&fitter, &diversity, &found, changes).into_iter().chain(cause).collect(),
            remarks: extended.into_iter().chain(open).chain(left_out).chain(of_scene.into_iter().flatten()).collect(),
            scene,
            pupil,
            run: Run { device: found.device, precision: found.precision, seconds: found.seconds, model_seconds },
            modes: found.combined.modes,
            maps: found.combined.maps,
            sigma_maps: found.combined.sigma_maps,
            truth: None,
            method: MethodResult::Modal(ModalSummary {
                combine: found.combine,
                image_coefficients_nm: found.image_coefficients_nm,
                compared: vec![found.compared],
                degeneracy: found.degeneracy,
                fitter: Arc::new(fitter),
            }),
        })
    }
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

/// Expected RMS over the pupil of errors of the coefficients, piston, tip and tilt removed as in a
/// residual.
pub(super) struct ExpectedErrors {
    fitted: MapErrors,
    /// Of the fitted modes and of what was left out; `None` where nothing was.
    whole: Option<MapErrors>,
}

/// [`ExpectedErrors`] of the modes of one basis.
struct MapErrors {
    gram: MapGram,
    /// The first modes are those of the segments.
    segment_modes: usize,
}

impl MapErrors {
    fn rms_nm(&self, covariance_nm2: &Array2<f64>) -> Result<[f64; 3]> {
        let (segments, modes) = (self.segment_modes, covariance_nm2.nrows());
        let rms_nm =
            |of: Range<usize>| self.gram.expected_rms_of_nm(of.clone(), covariance_nm2.slice(s![of.clone(), of]));
        Ok([rms_nm(0..segments)?, rms_nm(segments..modes)?, rms_nm(0..modes)?])
    }
}

impl ExpectedErrors {
    pub(super) fn new(model: &Model, left_out: Option<&WithLeftOut>) -> Result<Self> {
        let (pupil, segment_modes) = (&model.telescope.pupil, model.segment_modes);
        let Some(whole) = left_out.map(|left_out| &left_out.whole) else {
            let gram = MapGram::of_basis(pupil, &model.basis)?;
            return Ok(Self { fitted: MapErrors { gram, segment_modes }, whole: None });
        };
        let gram = MapGram::of_products(pupil, whole.basis(), whole.products().clone())?;
        let fitted = MapErrors { gram: gram.of_modes(whole.fitted()), segment_modes };
        Ok(Self { fitted, whole: Some(MapErrors { gram, segment_modes: whole.segment_modes() }) })
    }

    /// Expected RMS of the errors of phasing, NCPA and their sum, of the fitted modes, nm.
    pub(super) fn rms_nm(&self, covariance_nm2: &Array2<f64>) -> Result<[f64; 3]> {
        self.fitted.rms_nm(covariance_nm2)
    }

    /// The same of the fitted modes and of what was left out, from the covariance of all.
    pub(super) fn of_whole_nm(&self, covariance_nm2: &Array2<f64>) -> Result<[f64; 3]> {
        let whole = self.whole.as_ref();
        let whole = whole.ok_or_else(|| Error::Internal("nothing was left out of the modes".into()))?;
        whole.rms_nm(covariance_nm2)
    }

    /// The same of an estimate whose fitted modes have this covariance.
    pub(super) fn of_maps_nm(&self, covariance_nm2: &Array2<f64>, left_out: Option<&WithLeftOut>) -> Result<[f64; 3]> {
        match left_out {
            Some(left_out) => self.of_whole_nm(&left_out.whole.modes.covariance_nm2),
            None => self.rms_nm(covariance_nm2),
        }
    }

    /// Takes what was left out from the term `images`, whose covariance has it, too; its own term.
    pub(super) fn take_left_out(&self, images: &mut ErrorTerm, left_out: &WithLeftOut) -> Result<ErrorTerm> {
        let [phasing_nm, ncpa_nm, _] = self.rms_nm(&left_out.added_nm2)?;
        let less = |all_nm: f64, own_nm: f64| (all_nm * all_nm - own_nm * own_nm).max(0.0).sqrt();
        images.phasing_nm = less(images.phasing_nm, phasing_nm);
        images.ncpa_nm = less(images.ncpa_nm, ncpa_nm);
        let [phasing_nm, ncpa_nm, _] = self.of_whole_nm(&left_out.whole.added_nm2)?;
        Ok(ErrorTerm { name: NOT_FITTED.into(), phasing_nm, ncpa_nm })
    }
}

/// Terms of the covariance: the part that the images average out, and the errors that all of them
/// share.
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
    let mut terms: Vec<ErrorTerm> = std::iter::once((averaged, &found.combined.averaged_covariance_nm2))
        .chain(shared)
        .map(term)
        .collect::<Result<_>>()?;
    if let Some(left_out) = found.left_out() {
        let own = errors.take_left_out(&mut terms[0], left_out)?;
        terms.push(own);
    }
    Ok(terms)
}

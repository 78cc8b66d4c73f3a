//! Maximum a posteriori (MAP) estimate: the wavefront behind each exposure of a sequence, and the static errors that all
//! share.

use super::budget::ErrorTerm;
use super::control::{Control, Stage};
use super::estimate::{Basis, Estimate, Figure, MapSummary, OpticalParameter};
use super::images::Images;
use super::outcome::{ImageOutcome, ImageStatus};
use super::policy::Policy;
use super::warnings;
use crate::modes::Group;
use crate::scene::{Knows, Scene};
use crate::sequence_estimate::{self, FullPhase, SkyImages};
use crate::statics::{Iteration};
use crate::{Error, Result};
use ndarray::Array2;

pub(super) fn estimate(scene: &Scene, policy: &Policy, control: &Control, images: &Images) -> Result<Estimate> {
    let count = images.len();
    // A level below telemetry uses no slopes, and those of a file may then be anything.
    let uses_telemetry = scene.estimate.knows.is_none_or(|knows| knows >= Knows::Telemetry);
    let slopes_mas = images.slopes_mas.as_ref().filter(|_| uses_telemetry);
    if let Some(slopes_mas) = slopes_mas.filter(|slopes_mas| slopes_mas.nrows() != count) {
        return Err(Error::Shape(format!(
            "the telemetry holds {} sets of slopes for {count} images: one each is needed",
            slopes_mas.nrows()
        )));
    }
    let sequence = SkyImages {
        images_e: images.images_e.clone(),
        bad: images.bad.clone(),
        read_noise_e: images.read_noise_e,
        slopes_mas: slopes_mas.cloned(),
    };
    control.enter(Stage::Retrieving, count);
    let found = sequence_estimate::read(scene, &sequence, Some(control.flag()), &|_| control.advance())?;
    control.check("the images were read, nothing was written")?;
    let (sentences, has_settled, misfits) = (found.warnings()?, found.settled()?, found.misfits()?);
    let outcomes = (0..count).map(|image| outcome(&found, image)).collect();
    let Some(last) = found.passes.last() else { return Err(Error::Internal("an estimate without iteration".into())) };
    let pupil = found.pupil.clone();
    let wavefront_nm = &last.phasing_nm + &last.ncpa_nm;
    Ok(Estimate {
        policy: *policy,
        basis: basis(last),
        coefficients_nm: last.coefficients_nm(),
        covariance_nm2: last.errors.covariance_nm2.clone(),
        phasing: Figure::of_map(&pupil, last.phasing_nm.view(), last.expected_nm[0])?,
        ncpa: Figure::of_map(&pupil, last.ncpa_nm.view(), last.expected_nm[1])?,
        wavefront: Figure::of_map(&pupil, wavefront_nm.view(), f64::NAN)?,
        phasing_nm: last.phasing_nm.clone(),
        ncpa_nm: last.ncpa_nm.clone(),
        phasing_sigma_nm: last.phasing_sigma_nm.clone(),
        ncpa_sigma_nm: last.ncpa_sigma_nm.clone(),
        error_budget: error_budget(last),
        images: outcomes,
        image_coefficients_nm: Array2::zeros((0, last.coefficients_nm().len())),
        combine: None,
        reduced_chi2: last.reduced_chi2,
        is_sequence: true,
        status: if misfits { ImageStatus::Misfit } else { ImageStatus::Ok },
        model: format!("{} NCPA modes, {:?}", last.ncpa_names.len(), last.family),
        optics: optics(scene, &found),
        warnings: sentences,
        remarks: warnings::of_diversity(&last.diversity, &found.scene).into_iter().collect(),
        pupil,
        device: found.device,
        precision: found.precision,
        seconds: found.seconds,
        model_seconds: 0.0,
        compared: None,
        degeneracy: None,
        truth: None,
        fitter: None,
        map: Some(MapSummary {
            knows: found.knows,
            iterations: found.passes,
            has_settled,
            retrieval_seconds: found.retrieval_seconds,
            segment_reflectivities: found.optics.segment_reflectivities,
        }),
        scene: found.scene,
    })
}

fn outcome(found: &FullPhase, image: usize) -> ImageOutcome {
    let report = &found.reports[image];
    let is_used = found.passes.last().is_some_and(|last| last.used_images.contains(&image));
    let status = match &report.refusal {
        Some(_) => ImageStatus::Unusable,
        None if report.reason.converged() => ImageStatus::Ok,
        None => ImageStatus::NotConverged,
    };
    ImageOutcome {
        status,
        message: found.about_image(image).unwrap_or_default(),
        is_used,
        is_clipped: !is_used && status != ImageStatus::Unusable,
        evaluations: report.evaluations,
        reduced_chi2: report.reduced_chi2,
        flux_e: report.flux_e,
        background_e: report.background_e,
        tip_tilt_nm: [f64::NAN; 2],
        bad_pixels: 0,
        rejected_pixels: found.cut_pixels[image],
    }
}

fn basis(last: &Iteration) -> Basis {
    let (segments, ncpa) = (last.errors.pistons_nm.len(), last.ncpa_names.len());
    let groups = [vec![Group::Segment; segments], vec![Group::Ncpa; ncpa]].concat();
    Basis { names: last.mode_names(), groups }
}

fn optics(given: &Scene, found: &FullPhase) -> Vec<OpticalParameter> {
    let parameter = |key: &str, scene: f64, value: f64| OpticalParameter {
        key: key.into(),
        scene,
        value,
        sigma: f64::NAN,
        identifiable: f64::NAN,
    };
    let mut parameters = Vec::new();
    let (optics, sampling) = (&found.optics, given.image.samples_per_lambda_over_d);
    if optics.plate_scale != 1.0 {
        let key = "image.samples_per_lambda_over_d";
        parameters.push(parameter(key, sampling, sampling * optics.plate_scale));
    }
    let pupil = &given.pupil;
    let others = [
        ("pupil.central_obscuration_m", pupil.central_obscuration_m, optics.central_obscuration_m),
        ("pupil.spider_width_m", pupil.spider_width_m, optics.spider_width_m),
    ];
    parameters.extend(others.into_iter().filter_map(|(key, scene, value)| Some(parameter(key, scene, value?))));
    parameters
}

/// The terms of an iteration's error bars: what the images average out, and what all of them share.
fn error_budget(last: &Iteration) -> Vec<ErrorTerm> {
    let term = |name: &str, phasing_nm: f64, ncpa_nm: f64| ErrorTerm { name: name.into(), phasing_nm, ncpa_nm };
    let [phasing_nm, ncpa_nm] = last.averaged_nm;
    let rest = |i: usize, known: f64| {
        (last.expected_nm[i].powi(2) - last.averaged_nm[i].powi(2) - known.powi(2)).max(0.0).sqrt()
    };
    let known_nm = last.beyond_nm.hypot(last.answer_nm);
    [
        term("noise and turbulence", phasing_nm, ncpa_nm),
        term("diversity", rest(0, 0.0), rest(1, known_nm)),
        term("NCPA beyond the modes", 0.0, last.beyond_nm),
        term("unknown loop response", 0.0, last.answer_nm),
    ]
    .into_iter()
    .filter(|term| term.phasing_nm > 0.0 || term.ncpa_nm > 0.0)
    .collect()
}

//! The figures of `cophase estimate --json`.

use cophase::pipeline::{ErrorTerm, Estimate, Figures, ModelError};
use serde::Serialize;

/// What `estimate --json` prints; scripts rely on these keys.
#[derive(Serialize)]
pub(super) struct Summary<'a> {
    channels: &'a [String],
    images: usize,
    used: usize,
    clipped: usize,
    combine: Option<&'static str>,
    seconds: f64,
    phasing_rms_nm: f64,
    ncpa_rms_nm: f64,
    phasing_sigma_nm: f64,
    ncpa_sigma_nm: f64,
    phasing_residual_nm: Option<f64>,
    ncpa_residual_nm: Option<f64>,
    reduced_chi2: f64,
    evaluations: usize,
    device: &'a str,
    precision: String,
    status: &'static str,
    warnings: &'a [String],
    policy: &'static str,
    model: &'a str,
    method: &'static str,
    ao_knowledge: Option<&'static str>,
    iterations: Option<usize>,
    telemetry_gain: Option<f64>,
    telemetry_correlation: Option<f64>,
    error_budget: Vec<BudgetTerm<'a>>,
    model_errors: Vec<ErrorOfModel<'a>>,
    without_staircases: Option<Apart>,
}

/// Phasing and NCPA without focus and astigmatisms of the whole pupil.
#[derive(Serialize)]
struct Apart {
    phasing_rms_nm: f64,
    ncpa_rms_nm: f64,
    phasing_sigma_nm: f64,
    ncpa_sigma_nm: f64,
}

#[derive(Serialize)]
struct BudgetTerm<'a> {
    name: &'a str,
    phasing_nm: f64,
    ncpa_nm: f64,
}

#[derive(Serialize)]
struct ErrorOfModel<'a> {
    name: &'a str,
    value: f64,
    sigma: f64,
    tolerance: f64,
    significance: f64,
}

impl From<Figures> for Apart {
    fn from(Figures { phasing, ncpa, .. }: Figures) -> Self {
        Self {
            phasing_rms_nm: phasing.rms_nm,
            ncpa_rms_nm: ncpa.rms_nm,
            phasing_sigma_nm: phasing.sigma_nm,
            ncpa_sigma_nm: ncpa.sigma_nm,
        }
    }
}

impl<'a> From<&'a ErrorTerm> for BudgetTerm<'a> {
    fn from(term: &'a ErrorTerm) -> Self {
        Self { name: &term.name, phasing_nm: term.phasing_nm, ncpa_nm: term.ncpa_nm }
    }
}

impl<'a> From<&'a ModelError> for ErrorOfModel<'a> {
    fn from(error: &'a ModelError) -> Self {
        let ModelError { value, sigma, tolerance, significance, .. } = *error;
        Self { name: &error.name, value, sigma, tolerance, significance }
    }
}

impl<'a> Summary<'a> {
    pub(super) fn new(estimate: &'a Estimate) -> Self {
        let residual_nm = estimate.truth.as_ref().map(|(_, residual)| residual.rms_nm);
        let map = estimate.full_phase();
        let telemetry = map.and_then(|map| map.telemetry.as_ref());
        Self {
            channels: &estimate.channels,
            images: estimate.images.len(),
            used: estimate.used(),
            clipped: estimate.clipped(),
            combine: estimate.modal().map(|modal| modal.combine.word()),
            seconds: estimate.run.seconds,
            phasing_rms_nm: estimate.figures.phasing.rms_nm,
            ncpa_rms_nm: estimate.figures.ncpa.rms_nm,
            phasing_sigma_nm: estimate.figures.phasing.sigma_nm,
            ncpa_sigma_nm: estimate.figures.ncpa.sigma_nm,
            phasing_residual_nm: residual_nm.map(|nm| nm[0]),
            ncpa_residual_nm: residual_nm.map(|nm| nm[1]),
            reduced_chi2: estimate.reduced_chi2,
            evaluations: estimate.evaluations(),
            device: &estimate.run.device,
            precision: estimate.run.precision.to_string(),
            status: estimate.status.word(),
            warnings: &estimate.warnings,
            policy: estimate.policy.name(),
            model: &estimate.model,
            method: estimate.method.word(),
            ao_knowledge: map.map(|map| map.ao_knowledge.word()),
            iterations: map.map(|map| map.iterations.len()),
            telemetry_gain: telemetry.map(|check| check.gain),
            telemetry_correlation: telemetry.map(|check| check.correlation),
            error_budget: estimate.error_budget.iter().map(BudgetTerm::from).collect(),
            model_errors: estimate.model_errors.iter().map(ErrorOfModel::from).collect(),
            without_staircases: estimate.without_staircases.as_ref().map(|without| without.figures.into()),
        }
    }
}

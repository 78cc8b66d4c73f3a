//! What the step finds of the errors that a fit leaves out, and which of them are named.

use crate::empirical_bayes::Posterior;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::left_out::AMPLITUDE_UNIT;
use crate::modal::left_out::groups::{Group, Of};
use crate::modal::model::Model;
use ndarray::Array2;

/// Standard deviations from which an error is named: of fifteen, one is beyond by chance in one
/// estimate of 1,000.
const SIGNIFICANT: f64 = 4.0;
/// Share of the tolerance from which it is: at a peak S/N of 500 the approximations of the model
/// are a tenth of that of the response.
const REMARKABLE: f64 = 0.25;

/// Share of the significance of the clearest error from which another is named: the step is linear,
/// and the second order of an error lights others. A scale that is 0.1 % off along both axes, each
/// 38 standard deviations, lights a blur by 5.
const SECOND_ORDER: f64 = 0.2;

/// Modes with the errors of what was left out.
#[derive(Debug, Clone)]
pub(crate) struct WithLeftOut {
    /// Their mean and covariance.
    pub(crate) modes: CombinedModes,
    /// The part of the covariance that what was left out adds.
    pub(crate) added_nm2: Array2<f64>,
    /// RMS of what was left out of the phasing, which the map does not have, nm.
    pub(crate) phasing_nm: f64,
    /// How large each group is.
    pub(crate) terms: Vec<LeftOutTerm>,
    /// Errors of the optics and the camera.
    pub(crate) errors: Vec<ModelError>,
    /// χ² of each image that what was left out explains.
    pub(crate) explained_chi2: Vec<f64>,
}

impl WithLeftOut {
    /// Errors of the optics and the camera that the images show, and that are not small beside
    /// their tolerances.
    pub(crate) fn shown_errors(&self) -> impl Iterator<Item = &ModelError> {
        let most = self.errors.iter().map(|error| error.significance.abs()).fold(0.0, f64::max);
        let least = SIGNIFICANT.max(SECOND_ORDER * most);
        let is_shown = move |error: &&ModelError| {
            error.significance.abs() > least && error.value.abs() > REMARKABLE * error.tolerance
        };
        self.errors.iter().filter(is_shown)
    }

    /// `modes`, in which what was left out has the posterior `found`, and adds `added_nm2`.
    pub(in crate::modal) fn new(
        model: &Model,
        groups: &[Group],
        found: &Posterior,
        (modes, added_nm2): (CombinedModes, Array2<f64>),
    ) -> Self {
        let (mut terms, mut errors) = (Vec::new(), Vec::new());
        for (group, &rms) in groups.iter().zip(&found.prior_rms_nm) {
            match group.of {
                Of::Tolerance(tolerance) => errors.push(group.error(tolerance, found)),
                Of::Amplitudes => {
                    terms.push(LeftOutTerm { name: group.name.clone(), size: 100.0 * AMPLITUDE_UNIT * rms, unit: "%" })
                }
                _ => terms.push(LeftOutTerm { name: group.name.clone(), size: rms, unit: "nm" }),
            }
        }
        let phasing_nm = Self::phasing_nm(groups, model, found);
        Self { modes, added_nm2, phasing_nm, terms, errors, explained_chi2: Vec::new() }
    }

    /// RMS over the pupil of what is left out of the segments, nm, which the maps do not have:
    /// modes of a segment have the share of its area.
    fn phasing_nm(groups: &[Group], model: &Model, found: &Posterior) -> f64 {
        let areas = model.telescope.pupil.segment_areas();
        let total: f64 = areas.iter().sum();
        let mut square_nm2 = 0.0;
        for group in groups {
            for (place, column) in group.columns.clone().enumerate() {
                let share = match group.of {
                    Of::Tilts => areas[place % areas.len()] / total,
                    Of::Figures => areas[place / 3] / total,
                    Of::AllSegments => 1.0,
                    Of::FittedTilts | Of::Ncpa | Of::Amplitudes | Of::Tolerance(_) => 0.0,
                };
                square_nm2 += share * (found.coefficients_nm[column].powi(2) + found.covariance_nm2[[column, column]]);
            }
        }
        square_nm2.sqrt()
    }
}

/// An error of the optics or the camera that the scene takes to have none, as the images show it
/// within its tolerance.
#[derive(Debug, Clone, PartialEq)]
pub struct ModelError {
    /// What is wrong, as the subject of a sentence, with the unit of the values where they are not
    /// relative.
    pub name: String,
    /// Posterior mean.
    pub value: f64,
    /// Posterior standard deviation.
    pub sigma: f64,
    /// Standard deviation before the images (`[tolerance]`).
    pub tolerance: f64,
    /// Value by the images alone, over its error bar, with all other errors unknown within their
    /// tolerances.
    pub significance: f64,
}

/// Modes that were left out of the fit, and how large the images say they are.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LeftOutTerm {
    /// What they are.
    pub(crate) name: String,
    /// Standard deviation of each of its modes, in this unit.
    pub(crate) size: f64,
    pub(crate) unit: &'static str,
}

impl Group {
    /// The error that this group is of, whose prior standard deviation is `tolerance`.
    fn error(&self, tolerance: f64, found: &Posterior) -> ModelError {
        let place = self.columns.start;
        let (value, variance) = (found.coefficients_nm[place], found.covariance_nm2[[place, place]]);
        // Without the prior of variance 1: 1/variance = 1/own + 1, value/variance = seen/own.
        let own = variance / (1.0 - variance).max(f64::EPSILON);
        ModelError {
            name: self.name.clone(),
            value: value * tolerance,
            sigma: variance.sqrt() * tolerance,
            tolerance,
            significance: value / variance * own.sqrt(),
        }
    }
}

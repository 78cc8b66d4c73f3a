//! What the step finds of the errors that a fit leaves out, and which of them are named.

use crate::empirical_bayes::Posterior;
use crate::linear_algebra::SpdInverse;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::global_motions::GlobalMotions;
use crate::modal::left_out::groups::{Group, Of};
use crate::modal::left_out::step::Step;
use crate::modal::left_out::whole::WholeWavefront;
use crate::modal::left_out::{AMPLITUDE_UNIT, LeftOut};
use ndarray::{Array2, s};
use std::fmt::{Display, Formatter};

/// Standard deviations from which an error is named: of fifteen, one is beyond by chance in one
/// estimate of 1,000.
const SIGNIFICANT: f64 = 4.0;
/// Share of the tolerance from which it is: at a peak S/N of 500 the samples of a simulated pupil
/// show as a half of that of a blur.
const REMARKABLE: f64 = 0.6;

/// Share of the significance of the clearest error from which another is named: the step is linear,
/// and the second order of an error lights others. A scale that is 0.1 % off along both axes, each
/// 38 standard deviations, lights a blur by 5.
const SECOND_ORDER: f64 = 0.2;

/// Standard deviations from which a figure that all segments share is shown.
const SHOWN: f64 = 2.0;
/// χ² of its three shapes from which a user has to decide what it is: noise alone is beyond in one
/// estimate of 1,000.
const DOUBTFUL: f64 = 16.27;
/// Surface of the whole mirror, nm RMS, from which it matters what the figure is. The samples of a
/// model show as a figure of 0.02 nm, or a surface below 0.5, in 20 images at a peak S/N of 500.
const LEAST_SURFACE_NM: f64 = 1.0;

/// Modes with the errors of what was left out.
#[derive(Debug, Clone)]
pub(crate) struct WithLeftOut {
    /// Their mean and covariance.
    pub(crate) modes: CombinedModes,
    /// The part of the covariance that what was left out adds.
    pub(crate) added_nm2: Array2<f64>,
    /// Modes and what was left out of the wavefront.
    pub(crate) whole: WholeWavefront,
    /// How large each group is.
    pub(crate) terms: Vec<LeftOutTerm>,
    /// The figure that all segments share, where the images show one.
    pub(crate) shared_figure: Option<SharedFigure>,
    /// Errors of the optics and the camera.
    pub(crate) errors: Vec<ModelError>,
    /// χ² of each image that what was left out explains.
    pub(crate) explained_chi2: Vec<f64>,
    /// What it leaves of the reduced χ² of the mean residual of several images.
    pub(crate) mean_residual_chi2: f64,
}

impl WithLeftOut {
    /// Errors of the optics and the camera that the images show, and that are not small beside
    /// their tolerances: those that exceed these, or those that do not.
    pub(crate) fn shown_errors(&self, beyond: bool) -> impl Iterator<Item = &ModelError> {
        let most = self.errors.iter().map(|error| error.significance.abs()).fold(0.0, f64::max);
        let least = SIGNIFICANT.max(SECOND_ORDER * most);
        let is_shown = move |error: &&ModelError| {
            let share = error.value.abs() / error.tolerance;
            error.significance.abs() > least && share > REMARKABLE && (share > 1.0) == beyond
        };
        self.errors.iter().filter(is_shown)
    }

    /// `modes` of an estimate that has taken `step`, whose covariances are to be multiplied by
    /// `scale`, with what `left_out` has in `groups`.
    pub(in crate::modal) fn new(
        (left_out, motions): (&LeftOut, &GlobalMotions),
        groups: &[Group],
        step: &Step,
        modes: CombinedModes,
        scale: f64,
    ) -> Self {
        let (found, count) = (&step.found, modes.coefficients_nm.len());
        let added_nm2 = motions.removed_from(&step.added.slice(s![..count, ..count]).to_owned()) * scale;
        let whole = WholeWavefront::new((&left_out.whole, motions), step, &modes, scale);
        let (mut terms, mut errors) = (Vec::new(), Vec::new());
        for (group, &rms) in groups.iter().zip(&found.prior_rms_nm) {
            match group.of {
                Of::Tolerance(tolerance) => errors.push(group.error(tolerance, found)),
                Of::Amplitudes => {
                    terms.push(LeftOutTerm { name: group.name.clone(), size: 100.0 * AMPLITUDE_UNIT * rms, unit: "%" })
                }
                // The size of its prior is a tolerance.
                Of::AllSegments => {
                    let size = group.shown_rms(found).unwrap_or_default();
                    terms.push(LeftOutTerm { name: group.name.clone(), size, unit: "nm" })
                }
                _ => terms.push(LeftOutTerm { name: group.name.clone(), size: rms, unit: "nm" }),
            }
        }
        let shared_figure = SharedFigure::of(groups, found, left_out.surfaces);
        let (explained_chi2, mean_residual_chi2) = (Vec::new(), 1.0);
        Self { modes, added_nm2, whole, terms, shared_figure, errors, explained_chi2, mean_residual_chi2 }
    }
}

/// A figure that all segments share. Where the segments stand along a smooth surface of the whole
/// mirror with their pistons, tips and tilts, the images are those of a smooth NCPA and the
/// opposite of such a figure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct SharedFigure {
    /// RMS over each segment, nm.
    pub(crate) rms_nm: f64,
    /// RMS over the pupil of that surface, nm.
    pub(crate) surface_nm: f64,
}

impl SharedFigure {
    /// The mean figure of the segments, by what a step has `found` of `groups`, where it is beyond
    /// what noise makes and what figures that each segment has of its own have in the mean.
    /// `surfaces` are as in [`LeftOut`].
    fn of(groups: &[Group], found: &Posterior, surfaces: [f64; 3]) -> Option<Self> {
        let mut mean = Array2::zeros((3, found.coefficients_nm.len()));
        let mut expected_nm2 = 0.0;
        for (group, &rms_nm) in groups.iter().zip(&found.prior_rms_nm) {
            let segments = match group.of {
                Of::AllSegments => 1,
                Of::Figures => group.columns.len() / 3,
                _ => continue,
            };
            for (place, column) in group.columns.clone().enumerate() {
                mean[[place % 3, column]] = 1.0 / segments as f64;
            }
            if matches!(group.of, Of::Figures) {
                expected_nm2 += rms_nm * rms_nm / segments as f64;
            }
        }
        let figure_nm = mean.dot(&found.coefficients_nm);
        let covariance_nm2 = mean.dot(&found.covariance_nm2).dot(&mean.t()) + expected_nm2 * Array2::eye(3);
        // Without figures among the groups it has no inverse.
        let inverse = SpdInverse::new(&covariance_nm2).ok()?.inverse;
        let rms = |weights: [f64; 3]| {
            figure_nm.iter().zip(weights).map(|(nm, weight)| (nm * weight).powi(2)).sum::<f64>().sqrt()
        };
        let (rms_nm, surface_nm) = (rms([1.0; 3]), rms(surfaces));
        let is_doubtful = figure_nm.dot(&inverse.dot(&figure_nm)) > DOUBTFUL && surface_nm > LEAST_SURFACE_NM;
        is_doubtful.then_some(Self { rms_nm, surface_nm })
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

impl Display for ModelError {
    fn fmt(&self, f: &mut Formatter) -> std::fmt::Result {
        let Self { name, value, sigma, tolerance, significance } = self;
        let deviations = significance.abs();
        write!(
            f,
            "{name} is off by {value:.2e} ± {sigma:.0e} ({deviations:.0} standard deviations; up to {tolerance:.0e} is expected)"
        )
    }
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
    /// RMS of the modes of this group together, which are orthonormal; `None` where the images do
    /// not show it.
    fn shown_rms(&self, found: &Posterior) -> Option<f64> {
        let of = self.columns.clone();
        let square: f64 = of.clone().map(|column| found.coefficients_nm[column].powi(2)).sum();
        let variance: f64 = of.map(|column| found.covariance_nm2[[column, column]]).sum();
        (square > SHOWN.powi(2) * variance).then(|| square.sqrt())
    }

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

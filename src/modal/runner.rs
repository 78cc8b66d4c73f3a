//! One image's way to its minimum: asked for a point, told its objective, weighted anew where it converged, until done.
//! It neither evaluates nor allocates: the batch in lock-step and the loop over single images drive the same machine.

use super::minimum::Minimum;
use super::model::Model;
use super::prepare::Prepared;
use super::recipe::Recipe;
use super::residual::{photometry, reduced_chi2, reweigh};
use crate::Result;
use crate::imaging::{Evaluation, Precision};
use crate::optimize::{
    CancelFlag, Metric, Progress, QuasiNewton, RESOLUTION_F32, RESOLUTION_F64, Settings, StopReason,
};
use crate::scene::Weighting;
use std::sync::Arc;
use std::time::Instant;

/// Most often that the weights are renewed from the fitted model. Where the model is right two renewals settle it;
/// where it misfits, each brings about a digit.
const REWEIGHTINGS: usize = 8;
/// Decrease of χ² that is left where a fit stops, at the default step tolerance: √(2·1e-5) = 0.4 % of a σ. Another step
/// tolerance changes it as its square.
const DECREMENT: f64 = 1e-5;
/// The same where the first weights, those of the data's own noise, have done their work: one σ along one of a hundred
/// directions. Beyond, the weights of the model lead to a better minimum by the same steps.
const APPROACH: f64 = 1.0;
/// New weights move the minimum by at most a tenth of what moved it since the last ones (where the model misfits; where
/// it is right, by far less): they are not worth another fit where that is less than the step tolerance.
const SETTLED_STEPS: f64 = 10.0;
/// The first weights have done their work where the next step is this many tolerances too: less than [`SETTLED_STEPS`],
/// so that what the fit still moves rarely asks for new weights once more.
const APPROACH_STEPS: f64 = 5.0;
/// The step tolerance to which [`DECREMENT`] belongs.
const DECREMENT_STEP_NM: f64 = 1e-3;
/// Largest step of one iteration, as a fraction of the wavelength: about one radian, beyond which the linearisation
/// that made the metric says nothing.
const LARGEST_STEP_WAVES: f64 = 0.2;

/// What an image's fit asks for next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[must_use]
pub(super) enum Next {
    /// Objective and gradient at [`Runner::point`].
    Evaluation,
    /// The PSF at [`Runner::point`] for [`Runner::renew`], and then objective and gradient there, of the exposure with its
    /// new weights.
    Renewal,
    /// The PSF at [`Runner::point`], for [`Runner::settle`], and no more.
    Psf,
}

/// One image on its way.
pub(super) struct Runner {
    solver: QuasiNewton,
    reweighs: bool,
    /// Step, nm, and decrease of the objective below which a fit ends.
    tolerances: (f64, f64),
    settled_nm: f64,
    reweightings: usize,
    /// Where the last weights were made.
    weighted_at: Vec<f64>,
    flux_e: f64,
    background_e: f64,
    reduced_chi2: f64,
}

impl Runner {
    /// A machine for a model of the metric's dimension.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a tolerance out of range.
    pub(super) fn new(metric: &Arc<Metric>, recipe: &Recipe, settings: Settings) -> Result<Self> {
        let zeros = vec![0.0; metric.dimension()];
        let tolerances = (settings.step_tolerance, settings.decrement_tolerance);
        let settled_nm = SETTLED_STEPS * settings.step_tolerance;
        Ok(Self {
            solver: QuasiNewton::new(metric.clone(), &zeros, settings)?,
            reweighs: recipe.weighting == Weighting::Noise,
            tolerances,
            settled_nm,
            reweightings: 0,
            weighted_at: zeros,
            flux_e: f64::NAN,
            background_e: f64::NAN,
            reduced_chi2: f64::NAN,
        })
    }

    /// Takes up another image, in the coordinates that [`super::metrics::Metrics::of`] gives it.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a start that is not finite, [`crate::Error::Shape`] for one of another length.
    pub(super) fn begin(
        &mut self,
        (metric, scale): (&Arc<Metric>, f64),
        start_nm: &[f64],
        deadline: Option<Instant>,
    ) -> Result<()> {
        self.solver.begin(metric, scale, start_nm)?;
        self.solver.set_deadline(deadline);
        self.reweightings = 0;
        self.set_tolerances()?;
        (self.flux_e, self.background_e, self.reduced_chi2) = (f64::NAN, f64::NAN, f64::NAN);
        Ok(())
    }

    /// Where to evaluate.
    pub(super) fn point(&self) -> &[f64] {
        self.solver.point()
    }

    /// Takes objective and gradient at [`Runner::point`].
    pub(super) fn tell(&mut self, evaluation: &Evaluation) -> Next {
        if self.solver.advance(evaluation.objective, &evaluation.gradient) == Progress::Continue {
            return Next::Evaluation;
        }
        let renews = self.reweighs && self.unsettled() && self.reason().has_converged();
        if renews && self.solver.restart_objective() == Progress::Continue { Next::Renewal } else { Next::Psf }
    }

    /// Renews the weights from the PSF at [`Runner::point`].
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a tolerance out of range.
    pub(super) fn renew(&mut self, psf: &[f64], image: &mut Prepared) -> Result<()> {
        let photometry = photometry(&image.exposure, psf);
        reweigh(&mut image.exposure, psf, photometry, &image.floor_variance_e2);
        self.reweightings += 1;
        self.weighted_at.copy_from_slice(self.solver.point());
        self.set_tolerances()
    }

    /// Takes the PSF where the solver ended: finds flux, background and χ².
    pub(super) fn settle(&mut self, psf: &[f64], image: &Prepared) {
        let photometry = photometry(&image.exposure, psf);
        (self.flux_e, self.background_e) = photometry;
        self.reduced_chi2 =
            reduced_chi2(psf, photometry, &image.exposure, &image.floor_variance_e2, self.weighted_at.len());
    }

    fn set_tolerances(&mut self) -> Result<()> {
        let (step_nm, decrement) = self.tolerances;
        if self.reweighs && self.reweightings == 0 {
            // What a step in nm is worth depends on the star's brightness: of a faint one the decrease decides.
            self.solver.set_tolerances(APPROACH_STEPS * step_nm, decrement.max(APPROACH))
        } else {
            self.solver.set_tolerances(step_nm, decrement)
        }
    }

    /// Why it stopped.
    pub(super) fn reason(&self) -> StopReason {
        self.solver.outcome().reason
    }

    /// Writes where it ends. Flux, background and χ² are those of the best point that was evaluated, from which the last
    /// step, where there is one, leads by less than the tolerances.
    pub(super) fn write(&self, minimum: &mut Minimum) {
        let outcome = self.solver.outcome();
        self.solver.write_solution(&mut minimum.coefficients_nm);
        (minimum.flux_e, minimum.background_e) = (self.flux_e, self.background_e);
        (minimum.evaluations, minimum.reason) = (outcome.evaluations, outcome.reason);
        minimum.reduced_chi2 = self.reduced_chi2;
    }

    /// Whether new weights could still move the minimum by more than matters.
    fn unsettled(&self) -> bool {
        let moved = self.solver.outcome().x.iter().zip(&self.weighted_at).map(|(a, b)| (a - b).abs());
        self.reweightings == 0 || (self.reweightings < REWEIGHTINGS && moved.fold(0.0, f64::max) > self.settled_nm)
    }
}

/// How far the solver goes.
pub(super) fn settings(model: &Model, recipe: &Recipe, precision: Precision, cancel: Option<&CancelFlag>) -> Settings {
    Settings {
        max_evaluations: recipe.max_evaluations,
        step_tolerance: recipe.step_tolerance_nm,
        step_weights: Some(model.mean_squares.clone()),
        decrement_tolerance: match recipe.weighting {
            Weighting::Noise => (DECREMENT * (recipe.step_tolerance_nm / DECREMENT_STEP_NM).powi(2)).min(APPROACH),
            Weighting::None => 0.0,
        },
        relative_decrement_tolerance: 0.0,
        resolution: match precision {
            Precision::F32 => RESOLUTION_F32,
            Precision::F64 => RESOLUTION_F64,
        },
        max_step: LARGEST_STEP_WAVES * model.optics.parts().wavelength_nm,
        cancel: cancel.cloned(),
        ..Settings::default()
    }
}

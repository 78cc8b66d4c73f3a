//! Runner: state machine of one image's fit by reverse communication. The caller evaluates
//! objective and gradient at [`Runner::point`] and passes them to [`Runner::advance`], which says
//! what it needs next; the weights are renewed where the fit converged. A runner neither evaluates
//! nor allocates: the lock-step batch on a device and the loop over images on a CPU thread use the
//! same one.

use crate::Result;
use crate::control::Control;
use crate::imaging::{Evaluation, Precision};
use crate::modal::assess::chi2::ReducedChi2;
use crate::modal::assess::residual::{photometry, reweigh};
use crate::modal::model::Model;
use crate::modal::model::recipe::Recipe;
use crate::modal::prepare::PreparedFrame;
use crate::modal::prepare::rejection::reject;
use crate::modal::solve::minimum::Minimum;
use crate::optimize::{Advance, Metric, QuasiNewton, RESOLUTION_F32, RESOLUTION_F64, Settings, StopReason};
use crate::scene::Weighting;
use std::sync::Arc;
use std::time::Instant;

/// Most renewals of the weights from the fitted model. Where the model is right two are enough;
/// where it misfits, each gains about one digit.
const REWEIGHTINGS: usize = 8;
/// Expected decrease of χ² below which a fit stops, at the default step tolerance: √(2·1e-5) = 0.4
/// % of a σ. Another step tolerance scales it as its square.
const DECREMENT: f64 = 1e-5;
/// The same for the fit with the first weights, those of the data's own noise: one σ along one of a
/// hundred directions. Further steps are better made with the weights of the model.
pub(in crate::modal) const APPROACH: f64 = 1.0;
/// New weights move the minimum by at most a tenth of the distance since the last ones (where the
/// model misfits; by far less where it is right): they are not renewed where that is less than the
/// step tolerance.
pub(in crate::modal) const REWEIGHTING_STEPS: f64 = 10.0;
/// The fit with the first weights also stops where the next step is this many tolerances: less than
/// [`REWEIGHTING_STEPS`], so that the remaining steps rarely need another renewal.
pub(in crate::modal) const APPROACH_STEPS: f64 = 5.0;
/// The step tolerance to which [`DECREMENT`] belongs.
const DECREMENT_STEP_NM: f64 = 1e-3;
/// Largest step of one iteration, as a fraction of the wavelength: about one radian, beyond which
/// the linearisation behind the metric does not hold.
const LARGEST_STEP_WAVES: f64 = 0.2;

/// What a fit needs next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[must_use]
pub(in crate::modal) enum Next {
    /// Objective and gradient at [`Runner::point`].
    Evaluation,
    /// The PSF at [`Runner::point`] for [`Runner::renew`], and then objective and gradient there,
    /// of the exposure with its new weights.
    Renewal,
    /// The PSF at [`Runner::point`] for [`Runner::settle`], which ends the fit.
    Psf,
}

/// Fit of one image, by reverse communication.
pub(in crate::modal) struct Runner {
    solver: QuasiNewton,
    has_noise_weights: bool,
    /// Whether pixels that the model does not explain are rejected.
    rejects: bool,
    /// Whether the last renewal has rejected other pixels than the one before.
    has_other_pixels: bool,
    /// Step, nm, and decrease of the objective below which a fit ends.
    tolerances: (f64, f64),
    /// Distance of the minimum from `weighted_at` beyond which the weights are renewed, nm.
    reweighting_nm: f64,
    reweightings: usize,
    /// Point of the last renewal, nm.
    weighted_at: Vec<f64>,
    flux_e: f64,
    background_e: f64,
    chi2: ReducedChi2,
}

impl Runner {
    /// A runner for a model of the metric's dimension.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a tolerance out of range.
    pub(in crate::modal) fn new(metric: &Arc<Metric>, recipe: &Recipe, settings: Settings) -> Result<Self> {
        let zeros = vec![0.0; metric.dimension()];
        let tolerances = (settings.step_tolerance, settings.decrement_tolerance);
        let reweighting_nm = REWEIGHTING_STEPS * settings.step_tolerance;
        Ok(Self {
            solver: QuasiNewton::new(metric.clone(), &zeros, settings)?,
            has_noise_weights: recipe.weighting == Weighting::Noise,
            rejects: recipe.reject_outliers,
            has_other_pixels: false,
            tolerances,
            reweighting_nm,
            reweightings: 0,
            weighted_at: zeros,
            flux_e: f64::NAN,
            background_e: f64::NAN,
            chi2: ReducedChi2::NONE,
        })
    }

    /// The metric, in whose place another one is until the next fit.
    pub(in crate::modal) fn replace_metric(&mut self, other: &Arc<Metric>) -> Arc<Metric> {
        self.solver.replace_metric(other)
    }

    /// Begins the fit of another image, in the coordinates that
    /// [`crate::modal::solve::metrics::Metrics::for_image`] gives it.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a start that is not finite, [`crate::Error::Shape`] for one of
    /// another length.
    pub(in crate::modal) fn begin(
        &mut self,
        (metric, scale): (&Arc<Metric>, f64),
        start_nm: &[f64],
        deadline: Option<Instant>,
    ) -> Result<()> {
        self.solver.begin(metric, scale, start_nm)?;
        self.solver.set_deadline(deadline);
        (self.reweightings, self.has_other_pixels) = (0, false);
        self.set_tolerances()?;
        (self.flux_e, self.background_e, self.chi2) = (f64::NAN, f64::NAN, ReducedChi2::NONE);
        Ok(())
    }

    /// Point of the next evaluation, nm.
    pub(in crate::modal) fn point(&self) -> &[f64] {
        self.solver.point()
    }

    /// Advances the fit by the objective and gradient at [`Runner::point`].
    pub(in crate::modal) fn advance(&mut self, evaluation: &Evaluation) -> Next {
        if self.solver.advance(evaluation.objective, &evaluation.gradient) == Advance::Continue {
            return Next::Evaluation;
        }
        let renews = self.has_noise_weights && self.needs_new_weights() && self.reason().has_converged();
        if renews && self.solver.restart_objective() == Advance::Continue { Next::Renewal } else { Next::Psf }
    }

    /// Renews the weights from the PSF at [`Runner::point`].
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a tolerance out of range.
    pub(in crate::modal) fn renew(&mut self, psf: &[f64], image: &mut PreparedFrame) -> Result<()> {
        let has_other_pixels = self.reweigh(psf, image);
        self.has_renewed(has_other_pixels)
    }

    /// Renews the weights of an image from its PSF at the point; whether it has rejected other
    /// pixels than before. [`Runner::has_renewed`] follows, once all images of a fit have theirs.
    pub(in crate::modal) fn reweigh(&self, psf: &[f64], image: &mut PreparedFrame) -> bool {
        let (found, has_other_pixels) = if self.rejects {
            reject(image, psf, |image| photometry(&image.exposure, psf))
        } else {
            (photometry(&image.exposure, psf), false)
        };
        reweigh(&mut image.exposure, psf, found, &image.floor_variance_e2);
        has_other_pixels
    }

    /// Goes on with new weights, at the present point.
    ///
    /// # Errors
    /// [`crate::Error::Value`] for a tolerance out of range.
    pub(in crate::modal) fn has_renewed(&mut self, has_other_pixels: bool) -> Result<()> {
        self.has_other_pixels = has_other_pixels;
        self.reweightings += 1;
        self.weighted_at.copy_from_slice(self.solver.point());
        self.set_tolerances()
    }

    /// Ends the fit: computes flux, background and χ² from the PSF at the point where the solver
    /// ended.
    pub(in crate::modal) fn settle(&mut self, psf: &[f64], image: &PreparedFrame) {
        let photometry = photometry(&image.exposure, psf);
        (self.flux_e, self.background_e) = photometry;
        let noise = (image.floor_variance_e2.as_slice(), image.stated_share);
        self.chi2 = ReducedChi2::new(psf, photometry, &image.exposure, noise, self.weighted_at.len());
    }

    fn set_tolerances(&mut self) -> Result<()> {
        let (step_nm, decrement) = self.tolerances;
        if self.has_noise_weights && self.reweightings == 0 {
            // A step in nm is a smaller part of the error bars of a fainter star: there the
            // decrease ends the fit.
            self.solver.set_tolerances(APPROACH_STEPS * step_nm, decrement.max(APPROACH))
        } else {
            self.solver.set_tolerances(step_nm, decrement)
        }
    }

    /// Why the fit stopped.
    pub(in crate::modal) fn reason(&self) -> StopReason {
        self.solver.outcome().reason
    }

    /// Writes the minimum. Flux, background and χ² are those of the best point that was evaluated;
    /// the last step from there, where there is one, is below the tolerances.
    pub(in crate::modal) fn write(&self, minimum: &mut Minimum) {
        (minimum.evaluations, minimum.reason) = self.write_solution(&mut minimum.coefficients_nm);
        (minimum.flux_e, minimum.background_e) = (self.flux_e, self.background_e);
        minimum.chi2 = self.chi2;
    }

    /// Whether `gradient` is that of the best point.
    pub(in crate::modal) fn has_gradient(&self, gradient: &[f64]) -> bool {
        self.solver.outcome().gradient == gradient
    }

    /// Writes where the fit ended, the last step, which is below the tolerances, included; the
    /// number of evaluations and why it ended.
    pub(in crate::modal) fn write_solution(&self, point: &mut [f64]) -> (usize, StopReason) {
        self.solver.write_solution(point);
        let outcome = self.solver.outcome();
        (outcome.evaluations, outcome.reason)
    }

    /// Whether new weights could move the minimum by more than the step tolerance.
    fn needs_new_weights(&self) -> bool {
        let moved = self.solver.outcome().x.iter().zip(&self.weighted_at).map(|(a, b)| (a - b).abs());
        let has_moved = moved.fold(0.0, f64::max) > self.reweighting_nm;
        self.reweightings == 0 || (self.reweightings < REWEIGHTINGS && (has_moved || self.has_other_pixels))
    }
}

/// Settings of the solver.
pub(in crate::modal) fn settings(model: &Model, recipe: &Recipe, precision: Precision, control: &Control) -> Settings {
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
        cancel: Some(control.flag().clone()),
        ..Settings::default()
    }
}

//! Fit of a group from one start: Gauss-Newton coordinates of all images together, L-BFGS in them,
//! weights of the data first and of the model then; the levels of the prior with the last ones.

use crate::control::Control;
use crate::modal::assess::fisher::null_floor;
use crate::modal::assess::tilts::spanned_tip_and_tilt;
use crate::modal::combine::integers::are_determined;
use crate::modal::combine::pistons;
use crate::modal::fitter::ModalFitter;
use crate::modal::group::member::{Member, chain_with_amplitude};
use crate::modal::group::prior::Prior;
use crate::modal::group::unknowns::{Amplitude, Unknowns};
use crate::modal::solve::engine::{FitState, ImageFit, reason_of_none};
use crate::modal::solve::minimum::Minimum;
use crate::modal::solve::runner::{APPROACH, APPROACH_STEPS, REWEIGHTING_STEPS, settings};
use crate::optimize::{Advance, Metric, QuasiNewton, StopReason};
use crate::{Error, Result};
use ndarray::{Array1, Array2, ArrayView1};
use rayon::prelude::*;
use std::sync::Arc;

/// Most renewals of the weights, of the levels of the prior, and of the coordinates: where the
/// images show the modes the second moves nothing.
const RENEWALS: usize = 6;

/// Squared distance, in units of the noise, up to which the Gauss-Newton matrix of another point
/// serves: one error bar along one direction.
const NEAR: f64 = 1.0;

/// NCPA modes, the first of them, that a search of the minimum begins with: with all of 44 Zernikes
/// a tenth as many random starts end in the best minimum of real images in focus.
const LOW_MODES: usize = 25;

/// The images of a group, with their models.
pub(super) struct Group<'a> {
    pub(super) members: Vec<Member<'a>>,
    pub(super) unknowns: Unknowns,
    /// Prior before the images say more.
    pub(super) prior: Prior,
    /// The largest diversity, nm RMS over its samples: the unit of the amplitude.
    unit_nm: f64,
    /// Standard deviation of the amplitude before the images say more, nm; infinite for none.
    amplitude_nm: f64,
    step_weights: Arc<[f64]>,
}

/// What a fit finds, and how well.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Freedom {
    /// Everything, until it is clear which minimum it is: one renewal of the weights, steps of an
    /// error bar.
    Minimum,
    /// Everything, with the weights of the model at the minimum and the levels of the prior, from
    /// a start near the minimum.
    Wavefront,
    /// The same from a start that may be far: the first weights are those of the data.
    Whole,
    /// Tip and tilt of the first image, with the weights of the model.
    Tilts,
}

/// A minimum of a group.
#[derive(Debug, Clone)]
pub(super) struct Trial {
    /// The unknowns.
    pub(super) point: Vec<f64>,
    /// Of each image, in order.
    pub(super) minima: Vec<Minimum>,
    /// Prior of the modes with the last levels.
    pub(super) prior: Prior,
    /// The squares of the unknowns in units of the prior before the images said more.
    penalty: f64,
    /// Gauss-Newton matrix of each image within an error bar of the point, with weights of the
    /// model; `None` where that of the fit is of another point or of other weights.
    pub(super) each: Option<Vec<Array2<f64>>>,
}

impl Trial {
    /// χ² of all images.
    pub(super) fn chi2(&self) -> f64 {
        self.minima.iter().map(|minimum| minimum.chi2.value * minimum.chi2.freedom).sum()
    }

    /// χ² with the prior before the images said more, by which minima are compared.
    pub(super) fn objective(&self) -> f64 {
        self.chi2() + self.penalty
    }

    /// χ² of all images per degree of freedom.
    pub(super) fn reduced_chi2(&self) -> f64 {
        self.chi2() / self.minima.iter().map(|minimum| minimum.chi2.freedom).sum::<f64>()
    }

    pub(super) fn has_converged(&self) -> bool {
        self.minima.iter().all(|minimum| minimum.reason.has_converged())
    }

    /// Relative error of the amplitude of the diversities; 0 where it is known.
    pub(super) fn amplitude(&self, group: &Group) -> f64 {
        group.unknowns.amplitude().map_or(0.0, |place| self.point[place] / group.unit_nm)
    }
}

impl<'a> Group<'a> {
    /// The images of each channel that can be used, `fits`, by its fitter: those `chosen` by
    /// channel and number. The amplitude of their diversities is unknown where it has a relative
    /// standard deviation, infinite for none before the images.
    ///
    /// # Errors
    /// [`Error::Image`] where there is none; [`Error::Scene`] for an amplitude of diversities that
    /// are all 0.
    pub(super) fn new(
        fitters: &[&'a ModalFitter],
        fits: &[Vec<ImageFit>],
        chosen: impl Fn([usize; 2]) -> bool,
        amplitude_sigma: Option<f64>,
    ) -> Result<Self> {
        let rms_nm = |fitter: &&ModalFitter| {
            let diversity_nm = &fitter.model.optics.parts().diversity_nm;
            (diversity_nm.iter().map(|nm| nm * nm).sum::<f64>() / diversity_nm.len() as f64).sqrt()
        };
        let unit_nm = fitters.iter().map(rms_nm).fold(0.0, f64::max);
        if amplitude_sigma.is_some_and(f64::is_infinite) && unit_nm == 0.0 {
            return Err(Error::Scene(
                "the amplitude of the diversities is to be fitted (estimate.fit_optics), and all of them are 0: one that is not is needed"
                    .into(),
            ));
        }
        // An error of nothing is nothing.
        let amplitude_nm = amplitude_sigma.filter(|_| unit_nm > 0.0).map(|sigma| sigma * unit_nm);
        let has_amplitude = amplitude_nm.is_some();
        let mut members = Vec::new();
        for (channel, (fitter, fits)) in fitters.iter().zip(fits).enumerate() {
            let chain = if has_amplitude { chain_with_amplitude(fitter, unit_nm)? } else { fitter.reference.clone() };
            let usable = fits.iter().enumerate().filter(|(_, fit)| fit.state == FitState::NotBegun);
            let usable = usable.filter(|(image, _)| chosen([channel, *image]));
            members
                .extend(usable.map(|(image, fit)| Member::new(fitter, chain.clone(), [channel, image], &fit.prepared)));
        }
        if members.is_empty() {
            return Err(Error::Image(reason_of_none(fits.iter().flatten())));
        }
        let model = &members[0].fitter.model;
        let tilts = spanned_tip_and_tilt(model)?;
        let wavelengths_nm: Vec<f64> =
            members.iter().map(|member| member.fitter.model.optics.parts().wavelength_nm).collect();
        let range_nm = members[0].fitter.scene.modes.piston_range_nm;
        let prior = Prior::new(model, tilts.clone(), are_determined(&wavelengths_nm).then_some(range_nm));
        let amplitude = if has_amplitude { Amplitude::Coefficient } else { Amplitude::Known };
        let unknowns = Unknowns::new(model.optics.modes(), amplitude, tilts, members.len());
        // Of a step of the own tips and tilts the mean over the images counts.
        let own = 1.0 / members.len() as f64;
        let mut step_weights = vec![own; unknowns.count()];
        step_weights[..model.mean_squares.len()].copy_from_slice(&model.mean_squares);
        if let Some(place) = unknowns.amplitude() {
            step_weights[place] = 1.0;
        }
        let amplitude_nm = amplitude_nm.unwrap_or(f64::INFINITY);
        Ok(Self { members, unknowns, prior, unit_nm, amplitude_nm, step_weights: step_weights.into() })
    }

    /// Whether the sign of the diversities is not known.
    pub(super) fn has_unknown_sign(&self) -> bool {
        self.unknowns.amplitude().is_some() && self.amplitude_nm >= self.unit_nm
    }

    /// Unit of the amplitude, nm.
    pub(super) fn amplitude_unit_nm(&self) -> f64 {
        self.unit_nm
    }

    /// Number of pixels of all images.
    pub(super) fn pixels(&self) -> usize {
        self.members.iter().map(Member::pixels).sum()
    }

    /// Applies `work` to each image, on all threads, with its number and its coefficients.
    fn for_each<R: Send>(&mut self, point: &[f64], work: impl Fn(&mut Member, &Array1<f64>) -> R + Sync) -> Vec<R> {
        let Self { members, unknowns, .. } = self;
        let each = members.par_iter_mut().with_max_len(1).enumerate();
        each.map(|(image, member)| work(member, &unknowns.of_image(image, point))).collect()
    }

    /// Gauss-Newton matrix of all images at `point`, with their present weights.
    pub(super) fn information(&mut self, point: &[f64]) -> Array2<f64> {
        let each = self.information_of_each(point);
        self.sum_of(&each)
    }

    /// Gauss-Newton matrix of each image at `point`, by the unknowns that all share.
    pub(super) fn information_of_each(&mut self, point: &[f64]) -> Vec<Array2<f64>> {
        self.for_each(point, |member, coefficients| member.information(coefficients))
    }

    /// Gauss-Newton matrix of all images, from that of each, with what is known of the amplitude.
    pub(super) fn sum_of(&self, each: &[Array2<f64>]) -> Array2<f64> {
        let mut sum = Array2::zeros((self.unknowns.count(), self.unknowns.count()));
        if let Some(place) = self.unknowns.amplitude() {
            sum[[place, place]] = self.amplitude_nm.powi(-2);
        }
        for (image, own) in each.iter().enumerate() {
            self.unknowns.add_information(image, own, &mut sum);
        }
        (&sum + &sum.t()) * 0.5
    }

    /// Inverse covariance of what is known before the images, by `prior`: nothing of the modes
    /// `free`.
    pub(super) fn precision(&self, prior: &Prior, free: std::ops::Range<usize>) -> Array2<f64> {
        let mut precision = prior.precision_but(self.unknowns.count(), free);
        if let Some(place) = self.unknowns.amplitude() {
            precision[[place, place]] += self.amplitude_nm.powi(-2);
        }
        precision
    }

    /// −½ of the gradient of each image, where it was evaluated last, by the unknowns that all
    /// share.
    pub(super) fn scores(&self) -> Vec<Array1<f64>> {
        let score = |member: &Member| member.evaluation.gradient.iter().map(|slope| -0.5 * slope).collect();
        self.members.iter().map(score).collect()
    }

    /// −½ of the gradient of all images, where they were evaluated last, by all unknowns.
    pub(super) fn score(&self) -> Array1<f64> {
        let mut sum = vec![0.0; self.unknowns.count()];
        for (image, member) in self.members.iter().enumerate() {
            self.unknowns.add_gradient(image, &member.evaluation.gradient, &mut sum);
        }
        Array1::from(sum) * -0.5
    }

    /// Objective and gradient of all images at `point`.
    pub(super) fn evaluate(&mut self, point: &[f64]) -> (f64, Vec<f64>) {
        self.for_each(point, |member, coefficients| member.evaluate(coefficients));
        let mut gradient = vec![0.0; self.unknowns.count()];
        let mut objective = 0.0;
        if let Some(place) = self.unknowns.amplitude() {
            objective = (point[place] / self.amplitude_nm).powi(2);
            gradient[place] = 2.0 * point[place] / self.amplitude_nm.powi(2);
        }
        for (image, member) in self.members.iter().enumerate() {
            objective += member.evaluation.objective;
            self.unknowns.add_gradient(image, &member.evaluation.gradient, &mut gradient);
        }
        (objective, gradient)
    }

    /// Renews the weights and the rejected pixels of each image from its model at `point`.
    fn renew(&mut self, point: &[f64]) -> Result<()> {
        let renewed = self.for_each(point, |member, coefficients| member.renew(coefficients));
        renewed.into_iter().collect::<Result<Vec<_>>>().map(drop)
    }

    /// Fits all images from `start`.
    ///
    /// # Errors
    /// [`Error::Interrupted`]; [`Error::Value`] where no mode changes the images.
    pub(super) fn fit(&mut self, start: &[f64], freedom: Freedom, control: &Control) -> Result<Trial> {
        self.members.par_iter_mut().try_for_each(Member::begin)?;
        let (recipe, model) = (self.members[0].fitter.recipe.clone(), self.members[0].fitter.model.clone());
        let mut settings = settings(&model, &recipe, crate::imaging::Precision::F64, control);
        settings.step_weights = Some(self.step_weights.clone());
        let (step_nm, decrement) = (settings.step_tolerance, settings.decrement_tolerance);
        let count = self.unknowns.count();
        let floor = null_floor(count, self.pixels());
        let mut prior = self.prior.clone();
        let mut known = prior.precision(count);
        if freedom == Freedom::Tilts {
            known.fill(0.0);
        }
        let (mut point, mut evaluations) = (start.to_vec(), 0);
        let mut reason = StopReason::Unfinished;
        if matches!(freedom, Freedom::Wavefront | Freedom::Tilts) {
            self.renew(&point)?;
        }
        let (mut each, mut information, mut informed_at) = (Vec::new(), Array2::zeros((0, 0)), Array1::zeros(0));
        let mut has_model_weights = false;
        let is_near = |at: &Array1<f64>, informed_at: &Array1<f64>, information: &Array2<f64>| {
            let off = at - informed_at;
            off.dot(&information.dot(&off)) < NEAR
        };
        for renewal in 0..=RENEWALS {
            let at = Array1::from(point.clone());
            if renewal == 0 || !is_near(&at, &informed_at, &information) {
                each = self.information_of_each(&point);
                (information, informed_at) = (self.sum_of(&each), at.clone());
                has_model_weights = renewal > 0 || freedom == Freedom::Wavefront;
            }
            let is_approach = freedom == Freedom::Minimum || (freedom == Freedom::Whole && renewal == 0);
            if !is_approach && freedom != Freedom::Tilts {
                let (_, gradient) = self.evaluate(&point);
                let score = Array1::from(gradient) * -0.5;
                prior.learn(&information, &(information.dot(&at) + score))?;
                known = prior.precision(count);
            }
            let mut curvature = &information + &known;
            if freedom == Freedom::Tilts {
                let along = self.unknowns.tilts();
                curvature = along.t().dot(&along.dot(&curvature).dot(&along.t())).dot(&along);
            }
            if renewal == 0 && freedom == Freedom::Minimum {
                // Directions without information stay where they are.
                for mode in model.segment_modes + LOW_MODES..model.optics.modes() {
                    curvature.row_mut(mode).fill(0.0);
                    curvature.column_mut(mode).fill(0.0);
                }
            }
            let metric = Arc::new(Metric::from_gauss_newton(&curvature, floor)?);
            let mut solver = QuasiNewton::new(metric, &point, settings.clone())?;
            if is_approach {
                solver.set_tolerances(APPROACH_STEPS * step_nm, decrement.max(APPROACH))?;
            }
            loop {
                let at = Array1::from(solver.point().to_vec());
                let (mut objective, mut gradient) = self.evaluate(at.as_slice().unwrap_or_default());
                let pull = known.dot(&at);
                objective += at.dot(&pull);
                gradient.iter_mut().zip(&pull).for_each(|(slope, pull)| *slope += 2.0 * pull);
                if solver.advance(objective, &gradient) == Advance::Done {
                    break;
                }
            }
            let before = point.clone();
            solver.write_solution(&mut point);
            (evaluations, reason) = (evaluations + solver.outcome().evaluations, solver.outcome().reason);
            control.check("the images were fitted in part, nothing was written")?;
            let moved = point.iter().zip(&before).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let has_settled = moved <= REWEIGHTING_STEPS * step_nm || freedom == Freedom::Minimum;
            if !reason.has_converged() || (renewal > 0 && has_settled) || renewal == RENEWALS {
                break;
            }
            self.renew(&point)?;
        }
        let fitted = if freedom == Freedom::Tilts { self.unknowns.tilts().nrows() } else { count };
        let size = (fitted, self.members.len());
        let minima = self.for_each(&point, |member, coefficients| member.minimum(coefficients, size));
        let minima = minima.into_iter().map(|minimum| Minimum { evaluations, reason, ..minimum }).collect();
        let at = ArrayView1::from(&point);
        let penalty = at.dot(&self.precision(&self.prior, 0..0).dot(&at));
        let is_known = has_model_weights && is_near(&at.to_owned(), &informed_at, &information);
        Ok(Trial { minima, prior, penalty, each: is_known.then_some(each), point })
    }

    /// Moves pistons by whole wavelengths to those of the smallest spread, where all images are of
    /// one wavelength and do not show them.
    pub(super) fn gather_pistons(&self, best: &mut Trial) {
        let wavelength_nm = |member: &Member| member.fitter.model.optics.parts().wavelength_nm;
        let Some(first) = self.members.first() else { return };
        if self.members.iter().any(|member| wavelength_nm(member) != wavelength_nm(first)) {
            return;
        }
        let (model, modes) = (&first.fitter.model, first.fitter.model.optics.modes());
        let flat_nm = vec![0.0; modes];
        pistons::wrap_if_monochromatic(&mut best.point[..modes], &flat_nm, model);
        for minimum in &mut best.minima {
            pistons::wrap_if_monochromatic(&mut minimum.coefficients_nm, &flat_nm, model);
        }
    }

    /// Writes the minima of `best`, which was fitted last, into the fits of the channels.
    pub(super) fn write(&self, best: &Trial, fits: &mut [Vec<ImageFit>]) {
        for (member, minimum) in self.members.iter().zip(&best.minima) {
            let [channel, image] = member.place;
            let fit = &mut fits[channel][image];
            fit.prepared.clone_from(&member.image);
            fit.minimum.clone_from(minimum);
            fit.state = FitState::Fitted;
        }
    }

    /// The gradient by the unknowns of what images of the Gauss-Newton matrices `each` know of a
    /// relative error 1 of the amplitude of their diversities.
    ///
    /// # Errors
    /// [`Error::File`] for a map of it that cannot be read.
    pub(super) fn effect_of_diversities(&self, each: &[Array2<f64>]) -> Result<Array1<f64>> {
        let mut gradient = vec![0.0; self.unknowns.count()];
        for (image, (member, information)) in self.members.iter().zip(each).enumerate() {
            let diversity_nm = member.fitter.diversity_projection()?.coefficients_nm;
            self.unknowns.add_gradient(image, &information.dot(&diversity_nm).to_vec(), &mut gradient);
        }
        Ok(Array1::from(gradient))
    }
}

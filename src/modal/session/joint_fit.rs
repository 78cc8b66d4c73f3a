//! Fit of the frames of a group: one objective of all channels,
//!
//! ```text
//! J(c, δ, t) = Σ_i J_i(c + δ p_i + T t_i) + xᵀ P x
//! T: tip and tilt of all channels but the first; δ: the amplitude of the diversities, where it is unknown
//! P: the inverse covariance of what is known of the unknowns x before the images
//! ```
//!
//! with the weights of the data first and those of the model then, as [`Runner`] has them for one
//! image. Some channels join where the fit of the others has converged with its first weights:
//! those in focus or with less than half a wave of diversity, whose own objective has many minima,
//! where there are others; and those of another wavelength than the first of these, because pistons
//! beyond half a wavelength are right by one wavelength and not by two. The groups of a call
//! advance in lock-step, each by itself, on one thread one after the other.

use super::channel::{SessionChannel, interrupted};
use super::channel_fitters::ChannelFitters;
use super::information::GroupInformation;
use super::options::{FitOptions, GroupResult};
use crate::control::Control;
use crate::imaging::{Evaluation, Precision, Scratch};
use crate::modal::assess::chi2::ReducedChi2;
use crate::modal::assess::residual::photometry;
use crate::modal::assess::status::{Status, WRONG_MINIMUM};
use crate::modal::combine::diversity_error::is_weak;
use crate::modal::combine::joint::contradict;
use crate::modal::combine::pistons;
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::engine::FitState;
use crate::modal::solve::metrics::flux_and_floor;
use crate::modal::solve::runner::{Next, Runner, settings};
use crate::optimize::{Metric, StopReason};
use crate::{Error, Result};
use ndarray::{Array2, ArrayViewMut1, s};
use std::sync::Arc;
use std::time::Instant;

/// Memory for the fits of some groups at once.
pub(super) struct JointFit {
    information: GroupInformation,
    /// Which channels join later.
    joins_later: Vec<bool>,
    /// Whether all channels have one wavelength, and whether that is without a width, so that
    /// pistons are known modulo it.
    has_one_wavelength: bool,
    is_monochromatic: bool,
    slots: Vec<Slot>,
    /// Group of the first slot.
    first: usize,
    /// Slots whose groups advance, in ascending order.
    active: Vec<usize>,
    /// Of one channel: those of its images that are evaluated, with coefficients and results.
    evaluated: Vec<usize>,
    points: Array2<f64>,
    objectives: Vec<f64>,
    gradients: Vec<f64>,
    /// Of each channel, for PSFs in double precision.
    scratch: Vec<Scratch<f64>>,
    /// Unknowns of one group, and where its fit ended.
    point: Vec<f64>,
    minimum: Vec<f64>,
    /// Metric of a runner while its own is written.
    idle: Arc<Metric>,
}

/// Memory for the fit of one group.
struct Slot {
    runner: Runner,
    /// Objective of all its images and what is known before them, at the runner's point.
    sum: Evaluation,
    /// Gradient of each image, `[channel, mode]`.
    gradients: Array2<f64>,
    /// Whether the channels that join later have joined, and the evaluations before.
    has_all: bool,
    evaluations: usize,
}

impl JointFit {
    /// Memory for `at_once` groups of one frame of each of `channels`.
    ///
    /// # Errors
    /// As [`GroupInformation::new`]; those of [`is_weak`].
    pub(super) fn new(
        fitters: &ChannelFitters,
        channels: &[SessionChannel],
        at_once: usize,
        control: &Control,
    ) -> Result<Self> {
        let is_weak = fitters.iter().map(|(_, fitter)| is_weak(&fitter.scene)).collect::<Result<Vec<_>>>()?;
        let information = GroupInformation::new(fitters, &is_weak)?;
        let (model, modes) = (&fitters.first().model, fitters.first().model.optics.modes());
        let parts = || channels.iter().map(|channel| channel.fitter().model.optics.parts());
        let wavelengths_nm: Vec<f64> = parts().map(|parts| parts.wavelength_nm).collect();
        let first_nm = wavelengths_nm[is_weak.iter().position(|weak| !weak).unwrap_or(0)];
        let is_of_others = |(weak, nm): (&bool, &f64)| (*weak && is_weak.contains(&false)) || *nm != first_nm;
        let joins_later = is_weak.iter().zip(&wavelengths_nm).map(is_of_others).collect();
        let has_one_wavelength = wavelengths_nm.iter().all(|nm| *nm == first_nm);
        let is_monochromatic = has_one_wavelength && parts().all(|parts| parts.colours.len() == 1);
        let is_single = channels.iter().any(|channel| channel.precision == Precision::F32);
        let precision = if is_single { Precision::F32 } else { Precision::F64 };
        let count = information.unknowns.count();
        let mut settings = settings(model, channels[0].recipe(), precision, control);
        // That of the first channel is a part of its wavelength.
        let shortest_nm = wavelengths_nm.iter().copied().fold(f64::INFINITY, f64::min);
        settings.max_step *= shortest_nm / wavelengths_nm[0];
        // Of a step of the own tips and tilts the mean over the images counts.
        let mut step_weights = vec![1.0 / channels.len() as f64; count];
        step_weights[..model.mean_squares.len()].copy_from_slice(&model.mean_squares);
        if let Some(place) = information.unknowns.amplitude() {
            step_weights[place] = 1.0;
        }
        settings.step_weights = Some(step_weights.into());
        let slot = |_| {
            Ok(Slot {
                runner: Runner::new(&Arc::new(information.empty_metric()), channels[0].recipe(), settings.clone())?,
                sum: Evaluation { gradient: vec![0.0; count], ..Evaluation::default() },
                gradients: Array2::zeros((channels.len(), modes)),
                has_all: true,
                evaluations: 0,
            })
        };
        Ok(Self {
            joins_later,
            has_one_wavelength,
            is_monochromatic,
            slots: (0..at_once).map(slot).collect::<Result<_>>()?,
            first: 0,
            active: Vec::with_capacity(at_once),
            evaluated: Vec::with_capacity(at_once),
            points: Array2::zeros((at_once, modes)),
            objectives: vec![0.0; at_once],
            gradients: vec![0.0; at_once * modes],
            scratch: channels.iter().map(|channel| channel.fitter().reference.scratch()).collect(),
            point: vec![0.0; count],
            minimum: vec![0.0; count],
            idle: Arc::new(information.empty_metric()),
            information,
        })
    }

    /// Fits the frames of the first groups, one for each of `results`, and writes these and those
    /// of their images.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where the control was cancelled; those of the chains.
    pub(super) fn fit(
        &mut self,
        channels: &mut [SessionChannel],
        results: &mut [GroupResult],
        options: &FitOptions,
        control: &Control,
    ) -> Result<()> {
        channels.iter_mut().for_each(|channel| channel.begin(results.len(), options.start_nm));
        for (number, results) in results.chunks_mut(self.slots.len()).enumerate() {
            let began = Instant::now();
            self.first = number * self.slots.len();
            self.begin(channels, results, options, control)?;
            while !self.active.is_empty() {
                let active = std::mem::take(&mut self.active);
                let evaluated = self.evaluate(channels, &active);
                self.active = active;
                evaluated?;
                self.advance(channels, results, began, control)?;
            }
        }
        Ok(())
    }

    /// Begins the fit of each group with a frame that can be used.
    fn begin(
        &mut self,
        channels: &mut [SessionChannel],
        results: &mut [GroupResult],
        options: &FitOptions,
        control: &Control,
    ) -> Result<()> {
        self.active.clear();
        if control.is_cancelled() {
            return Err(interrupted());
        }
        let is_late = control.is_late();
        if !is_late {
            let groups = self.first..self.first + results.len();
            channels.iter_mut().try_for_each(|channel| channel.prepare(groups.clone(), options.read_noise_e))?;
        }
        for (slot, result) in results.iter_mut().enumerate() {
            let group = self.first + slot;
            let members = || channels.iter().zip(&self.joins_later).filter(|(channel, _)| channel.is_member(group));
            if is_late || members().next().is_none() {
                channels.iter_mut().for_each(|channel| channel.report(group));
                without_modes(result, channels, group);
                continue;
            }
            self.slots[slot].has_all = members().all(|(_, later)| *later) || !members().any(|(_, later)| *later);
            self.slots[slot].evaluations = 0;
            let start_nm = &channels[0].fits[group].start_nm;
            self.point.fill(0.0);
            self.point[..start_nm.len()].copy_from_slice(start_nm);
            self.start(channels, slot, control)?;
            self.active.push(slot);
        }
        Ok(())
    }

    /// Starts the runner of a slot at the point, with the metric of the images that take part.
    fn start(&mut self, channels: &[SessionChannel], slot: usize, control: &Control) -> Result<()> {
        let group = self.first + slot;
        for (number, channel) in channels.iter().enumerate() {
            if self.takes_part(channels, number, slot) {
                let image = flux_and_floor(&channel.fits[group].prepared);
                self.information.take(number, channel.fitter(), image);
            } else {
                self.information.take_none(number);
            }
        }
        let runner = &mut self.slots[slot].runner;
        let mut metric = runner.replace_metric(&self.idle);
        let own = Arc::get_mut(&mut metric).ok_or_else(|| Error::Internal("a metric has two owners".into()))?;
        self.information.write_metric(own);
        runner.begin((&metric, 1.0), &self.point, control.deadline())
    }

    /// Whether the image of a channel is fitted now.
    fn takes_part(&self, channels: &[SessionChannel], number: usize, slot: usize) -> bool {
        let has_joined = self.slots[slot].has_all || !self.joins_later[number];
        has_joined && channels[number].is_member(self.first + slot)
    }

    /// Objective and gradient of the groups in some slots.
    fn evaluate(&mut self, channels: &mut [SessionChannel], slots: &[usize]) -> Result<()> {
        for &slot in slots {
            let Slot { runner, sum, .. } = &mut self.slots[slot];
            sum.gradient.fill(0.0);
            sum.objective = self.information.add_prior(runner.point(), &mut sum.gradient);
        }
        let modes = self.points.ncols();
        for number in 0..channels.len() {
            self.evaluated.clear();
            for &slot in slots {
                if self.takes_part(channels, number, slot) {
                    let row = self.points.row_mut(self.evaluated.len());
                    let runner = &self.slots[slot].runner;
                    self.information.unknowns.write_coefficients(number, runner.point(), row);
                    self.evaluated.push(slot);
                }
            }
            let count = self.evaluated.len();
            if count == 0 {
                continue;
            }
            let (objectives, gradients) = (&mut self.objectives[..count], &mut self.gradients[..count * modes]);
            let points = self.points.slice(s![..count, ..]);
            channels[number].engine.evaluate(&self.evaluated, points, objectives, gradients)?;
            let found = objectives.iter().zip(gradients.chunks_exact(modes));
            for (&slot, (objective, gradient)) in self.evaluated.iter().zip(found) {
                let Slot { sum, gradients, .. } = &mut self.slots[slot];
                sum.objective += objective;
                self.information.unknowns.add_gradient(number, gradient, &mut sum.gradient);
                gradients.row_mut(number).iter_mut().zip(gradient).for_each(|(to, from)| *to = *from);
            }
        }
        Ok(())
    }

    /// Advances each group by its evaluation; those that end have their results.
    fn advance(
        &mut self,
        channels: &mut [SessionChannel],
        results: &mut [GroupResult],
        began: Instant,
        control: &Control,
    ) -> Result<()> {
        let mut kept = 0;
        for place in 0..self.active.len() {
            let slot = self.active[place];
            let Slot { runner, sum, .. } = &mut self.slots[slot];
            let next = runner.advance(sum);
            if next == Next::Evaluation || (next == Next::Renewal && self.renew(channels, slot, control)?) {
                self.active[kept] = slot;
                kept += 1;
                continue;
            }
            let ended = if next == Next::Psf { None } else { Some(StopReason::StepBelowTolerance) };
            if next == Next::Psf && !self.slots[slot].runner.has_gradient(&self.slots[slot].sum.gradient) {
                // The best point is an earlier one.
                self.evaluate(channels, &[slot])?;
            }
            self.settle(channels, &mut results[slot], (slot, ended), began)?;
        }
        self.active.truncate(kept);
        Ok(())
    }

    /// Lets the channels that join later join, or renews the weights of the images from the model.
    /// Not where the pistons of several wavelengths are whole wavelengths off: such a fit goes from
    /// one wrong minimum to the next with each renewal.
    fn renew(&mut self, channels: &mut [SessionChannel], slot: usize, control: &Control) -> Result<bool> {
        if !self.slots[slot].has_all {
            let Slot { runner, has_all, evaluations, .. } = &mut self.slots[slot];
            *evaluations += runner.write_solution(&mut self.point).0;
            *has_all = true;
            self.start(channels, slot, control)?;
            return Ok(true);
        }
        let group = self.first + slot;
        let (mut has_other_pixels, mut worst) = (false, 0.0);
        let runner = &mut self.slots[slot].runner;
        for (number, channel) in channels.iter_mut().enumerate().filter(|(_, channel)| channel.is_member(group)) {
            let mut own = self.points.row_mut(0);
            self.information.unknowns.write_coefficients(number, runner.point(), own.view_mut());
            let psf = channel.shared.fitter.reference.psf_in(own.view(), &mut self.scratch[number]);
            let prepared = &mut channel.fits[group].prepared;
            has_other_pixels |= runner.reweigh(psf, prepared);
            worst = f64::max(worst, chi2_of(psf, prepared, own.len()).1.value);
            channel.engine.replace(slot, &prepared.exposure)?;
        }
        if worst > WRONG_MINIMUM && !self.has_one_wavelength {
            return Ok(false);
        }
        runner.has_renewed(has_other_pixels)?;
        Ok(true)
    }

    /// Ends the fit of a group, for the reason `ended` or that of its runner.
    fn settle(
        &mut self,
        channels: &mut [SessionChannel],
        result: &mut GroupResult,
        (slot, ended): (usize, Option<StopReason>),
        began: Instant,
    ) -> Result<()> {
        let group = self.first + slot;
        let Self { information, points, scratch, point, minimum, .. } = self;
        let Slot { runner, evaluations, .. } = &self.slots[slot];
        if runner.reason() == StopReason::Cancelled {
            return Err(interrupted());
        }
        let members = channels.iter().filter(|channel| channel.is_member(group)).count();
        let unknowns = point.len().div_ceil(members);
        let seconds = began.elapsed().as_secs_f64() / channels.len() as f64;
        let mut own = points.row_mut(0);
        for (number, channel) in channels.iter_mut().enumerate().filter(|(_, channel)| channel.is_member(group)) {
            information.unknowns.write_coefficients(number, runner.point(), own.view_mut());
            let psf = channel.shared.fitter.reference.psf_in(own.view(), &mut scratch[number]);
            let fit = &mut channel.fits[group];
            let ((flux_e, background_e), chi2) = chi2_of(psf, &fit.prepared, unknowns);
            (fit.minimum.flux_e, fit.minimum.background_e) = (flux_e, background_e);
            (fit.minimum.chi2, fit.minimum.images) = (chi2, members);
        }
        let (last, reason) = runner.write_solution(minimum);
        let (evaluations, reason) = (evaluations + last, ended.unwrap_or(reason));
        point.copy_from_slice(minimum);
        if self.is_monochromatic {
            let start_nm = &channels[0].fits[group].start_nm;
            let modes = own.len();
            pistons::wrap_if_monochromatic(&mut point[..modes], start_nm, &channels[0].shared.fitter.model);
        }
        for (number, channel) in channels.iter_mut().enumerate() {
            if channel.is_member(group) {
                let fit = &mut channel.fits[group];
                (fit.minimum.evaluations, fit.minimum.reason, fit.seconds) = (evaluations, reason, seconds);
                let own = ArrayViewMut1::from(&mut fit.minimum.coefficients_nm[..]);
                information.unknowns.write_coefficients(number, point, own);
                fit.state = FitState::Fitted;
            }
            channel.report(group);
        }
        without_modes(result, channels, group);
        if members == channels.len() && result.status.has_converged() {
            self.write_modes(result, channels, slot);
        }
        Ok(())
    }

    /// Writes the modes of a group whose images were all fitted, to the point, and how well they
    /// are known.
    fn write_modes(&mut self, result: &mut GroupResult, channels: &[SessionChannel], slot: usize) {
        let (modes, group) = (result.coefficients_nm.len(), self.first + slot);
        result.coefficients_nm.copy_from_slice(&self.point[..modes]);
        channels[0].fitter().motions.remove(&mut result.coefficients_nm);
        for (number, channel) in channels.iter().enumerate() {
            let fit = &channel.fits[group];
            let floor_e2 = fit.prepared.floor_variance_e2.iter().copied().fold(f64::INFINITY, f64::min);
            self.information.take(number, channel.fitter(), (fit.minimum.flux_e, floor_e2));
        }
        let scale = |channel: &SessionChannel| channel.results()[group].report.reduced_chi2.max(1.0);
        let gradients = self.slots[slot].gradients.outer_iter();
        result.disagreement = self.information.differences(&self.minimum, gradients.zip(channels.iter().map(scale)));
        result.is_contradictory = contradict(result.disagreement);
        self.information.write_sigma(&mut result.sigma_nm);
        // Images that disagree by more than their noise are wrong by at least as much.
        let scale = channels.iter().map(scale).fold(1.0, f64::max) * result.disagreement.0.max(1.0);
        result.sigma_nm.iter_mut().for_each(|sigma| *sigma *= scale.sqrt());
    }
}

/// Flux, electrons, and background, electrons a pixel, of an image with `unknowns` of its own, and
/// its χ².
fn chi2_of(psf: &[f64], image: &PreparedFrame, unknowns: usize) -> ((f64, f64), ReducedChi2) {
    let found = photometry(&image.exposure, psf);
    let noise = (image.floor_variance_e2.as_slice(), image.stated_share);
    (found, ReducedChi2::new(psf, found, &image.exposure, noise, unknowns))
}

/// Writes the result of a group without common modes.
fn without_modes(result: &mut GroupResult, channels: &[SessionChannel], group: usize) {
    let images = channels.iter().map(|channel| &channel.results()[group]);
    result.seconds = images.clone().map(|image| image.seconds).sum();
    result.status = *Status::worst(images.map(|image| &image.report.status));
    (result.disagreement, result.is_contradictory) = ((f64::NAN, 0.0), false);
    result.coefficients_nm.fill(f64::NAN);
    result.sigma_nm.fill(f64::NAN);
}

//! Fit of the frames of a group: one objective of all channels,
//!
//! ```text
//! J(c, δ, t) = Σ_i J_i(c + δ p_i + T t_i) + δ²/σ²
//! T: tip and tilt of all channels but the first; δ: the amplitude of the diversities, where it is unknown
//! ```
//!
//! with the weights of the data first and those of the model then, as [`Runner`] has them for one
//! image. Some channels join with the second weights: those in focus or with less than half a wave
//! of diversity, whose own objective has many minima, where there are others; and those of another
//! wavelength than the first of these, because pistons beyond half a wavelength are right by one
//! wavelength and not by two. The groups of a call advance in lock-step, each by itself, on one
//! thread one after the other.

use super::channel::{SessionChannel, interrupted};
use super::channel_fitters::ChannelFitters;
use super::information::GroupInformation;
use super::options::GroupResult;
use crate::Result;
use crate::control::Control;
use crate::imaging::{Evaluation, Precision, Scratch};
use crate::modal::assess::chi2::ReducedChi2;
use crate::modal::assess::residual::photometry;
use crate::modal::assess::status::Status;
use crate::modal::combine::diversity_error::is_weak;
use crate::modal::combine::joint::contradict;
use crate::modal::combine::pistons;
use crate::modal::prepare::PreparedFrame;
use crate::modal::solve::engine::FitState;
use crate::modal::solve::metrics::flux_and_floor;
use crate::modal::solve::runner::{Next, Runner, settings};
use crate::optimize::{Metric, StopReason};
use ndarray::{Array2, ArrayViewMut1, s};
use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

/// Reduced χ² of an image beyond which a fit of several wavelengths ends where it has converged:
/// its pistons are whole wavelengths off, and it goes from one wrong minimum to the next with each
/// renewal of the weights.
const HOPELESS: f64 = 30.0;

/// Memory for the fits of the groups of a call.
pub(super) struct JointFit {
    information: GroupInformation,
    /// Which channels join with the second weights.
    joins_later: Vec<bool>,
    /// Whether all channels have one wavelength, so that pistons are known modulo it.
    has_one_wavelength: bool,
    /// Of each group: its runner, and the objective of all its images where that is.
    runners: Vec<Runner>,
    sums: Vec<Evaluation>,
    /// Of each channel: the coefficients and the gradients of the groups that advance.
    points: Vec<Array2<f64>>,
    gradients: Vec<Array2<f64>>,
    objectives: Vec<f64>,
    /// Of each channel, for PSFs in double precision.
    scratch: Vec<Scratch<f64>>,
    /// Groups that advance, in ascending order, and how many at once.
    active: Vec<usize>,
    at_once: usize,
    /// Unknowns of one group.
    point: Vec<f64>,
    /// Metric of a runner while its own is written.
    idle: Arc<Metric>,
}

impl JointFit {
    /// Memory for groups of one frame of each of `channels`, as many as these have, `at_once` of
    /// which advance together.
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
        let (model, modes, capacity) =
            (&fitters.first().model, fitters.first().model.optics.modes(), channels[0].capacity());
        let wavelengths_nm: Vec<f64> =
            channels.iter().map(|channel| channel.fitter().model.optics.parts().wavelength_nm).collect();
        let first_nm = wavelengths_nm[is_weak.iter().position(|weak| !weak).unwrap_or(0)];
        let is_of_others = |(weak, nm): (&bool, &f64)| (*weak && is_weak.contains(&false)) || *nm != first_nm;
        let joins_later: Vec<bool> = is_weak.iter().zip(&wavelengths_nm).map(is_of_others).collect();
        let has_one_wavelength = wavelengths_nm.iter().all(|nm| *nm == first_nm);
        let is_single = channels.iter().any(|channel| channel.precision == Precision::F32);
        let precision = if is_single { Precision::F32 } else { Precision::F64 };
        let count = information.unknowns.count();
        let mut settings = settings(model, channels[0].recipe(), precision, control);
        // Of a step of the own tips and tilts the mean over the images counts.
        let mut step_weights = vec![1.0 / channels.len() as f64; count];
        step_weights[..model.mean_squares.len()].copy_from_slice(&model.mean_squares);
        if let Some(place) = information.unknowns.amplitude() {
            step_weights[place] = 1.0;
        }
        settings.step_weights = Some(step_weights.into());
        let runner = |_| Runner::new(&Arc::new(information.empty_metric()), channels[0].recipe(), settings.clone());
        let runners = (0..capacity).map(runner).collect::<Result<Vec<_>>>()?;
        let of_groups = || vec![Array2::zeros((capacity, modes)); channels.len()];
        Ok(Self {
            joins_later,
            has_one_wavelength,
            runners,
            sums: vec![Evaluation { gradient: vec![0.0; count], ..Evaluation::default() }; capacity],
            points: of_groups(),
            gradients: of_groups(),
            objectives: vec![0.0; capacity],
            scratch: channels.iter().map(|channel| channel.fitter().reference.scratch()).collect(),
            active: Vec::with_capacity(capacity),
            at_once,
            point: vec![0.0; count],
            idle: Arc::new(information.empty_metric()),
            information,
        })
    }

    /// Fits the frames of the first groups, one for each of `results`, that `channels` have
    /// prepared, and writes their results and those of their images.
    ///
    /// # Errors
    /// [`crate::Error::Interrupted`] where the control was cancelled; those of the chains.
    pub(super) fn fit(
        &mut self,
        channels: &mut [SessionChannel],
        results: &mut [GroupResult],
        control: &Control,
    ) -> Result<()> {
        let count = results.len();
        for first in (0..count).step_by(self.at_once) {
            let began = Instant::now();
            self.begin(channels, results, first..count.min(first + self.at_once), control)?;
            while !self.active.is_empty() {
                self.evaluate(channels)?;
                self.advance(channels, results, began)?;
            }
        }
        Ok(())
    }

    /// Begins the fit of each of `groups` with a frame that can be used.
    fn begin(
        &mut self,
        channels: &mut [SessionChannel],
        results: &mut [GroupResult],
        groups: Range<usize>,
        control: &Control,
    ) -> Result<()> {
        self.active.clear();
        if control.is_cancelled() {
            return Err(interrupted());
        }
        for group in groups {
            let result = &mut results[group];
            if control.is_late() || !channels.iter().any(|channel| channel.is_member(group)) {
                channels.iter_mut().for_each(|channel| channel.report(group));
                without_modes(result, channels, group);
                continue;
            }
            let start_nm = &channels[0].fits[group].start_nm;
            self.point.fill(0.0);
            self.point[..start_nm.len()].copy_from_slice(start_nm);
            for (number, channel) in channels.iter().enumerate() {
                if channel.is_member(group) {
                    let image = flux_and_floor(&channel.fits[group].prepared);
                    self.information.take(number, channel.fitter(), image);
                } else {
                    self.information.take_none(number);
                }
            }
            let runner = &mut self.runners[group];
            let mut metric = runner.replace_metric(&self.idle);
            if let Some(own) = Arc::get_mut(&mut metric) {
                self.information.write_metric(own);
            }
            runner.begin((&metric, 1.0), &self.point, control.deadline())?;
            self.active.push(group);
        }
        Ok(())
    }

    /// Objective and gradient of each group that advances.
    fn evaluate(&mut self, channels: &mut [SessionChannel]) -> Result<()> {
        let Self { information, joins_later, runners, sums, points, gradients, objectives, active, .. } = self;
        for &group in active.iter() {
            let sum = &mut sums[group];
            sum.gradient.fill(0.0);
            sum.objective = information.add_prior(runners[group].point(), &mut sum.gradient);
        }
        for (number, channel) in channels.iter_mut().enumerate() {
            let (points, gradients, count) = (&mut points[number], &mut gradients[number], active.len());
            for (row, &group) in points.outer_iter_mut().zip(active.iter()) {
                information.unknowns.write_coefficients(number, runners[group].point(), row);
            }
            let modes = points.ncols();
            let Some(gradients) = gradients.as_slice_mut() else { return Ok(()) };
            let (objectives, gradients) = (&mut objectives[..count], &mut gradients[..count * modes]);
            channel.engine.evaluate(active, points.slice(s![..count, ..]), objectives, gradients)?;
            for ((&group, objective), gradient) in
                active.iter().zip(objectives.iter()).zip(gradients.chunks_exact(modes))
            {
                let joins = !(joins_later[number] && runners[group].has_first_weights());
                if joins && channel.is_member(group) {
                    sums[group].objective += objective;
                    information.unknowns.add_gradient(number, gradient, &mut sums[group].gradient);
                }
            }
        }
        Ok(())
    }

    /// Advances each group by its evaluation; those that end have their results.
    fn advance(&mut self, channels: &mut [SessionChannel], results: &mut [GroupResult], began: Instant) -> Result<()> {
        let mut kept = 0;
        for row in 0..self.active.len() {
            let group = self.active[row];
            let next = self.runners[group].advance(&self.sums[group]);
            if next == Next::Evaluation || (next == Next::Renewal && self.renew(channels, group)?) {
                self.active[kept] = group;
                kept += 1;
            } else {
                let ended = if next == Next::Psf { None } else { Some(StopReason::StepBelowTolerance) };
                self.settle(channels, &mut results[group], (group, row, ended), began)?;
            }
        }
        self.active.truncate(kept);
        Ok(())
    }

    /// Renews the weights of the images of a group from the model; or not, where it is
    /// [`HOPELESS`].
    fn renew(&mut self, channels: &mut [SessionChannel], group: usize) -> Result<bool> {
        let is_last = !self.has_one_wavelength && !self.runners[group].has_first_weights();
        let (mut has_other_pixels, mut worst) = (false, 0.0);
        for (number, channel) in channels.iter_mut().enumerate().filter(|(_, channel)| channel.is_member(group)) {
            let runner = &self.runners[group];
            let mut own = self.points[number].row_mut(0);
            self.information.unknowns.write_coefficients(number, runner.point(), own.view_mut());
            let psf = channel.shared.fitter.reference.psf_in(own.view(), &mut self.scratch[number]);
            let prepared = &mut channel.fits[group].prepared;
            if is_last {
                worst = f64::max(worst, chi2_of(psf, prepared, own.len()).1.value);
            }
            has_other_pixels |= runner.reweigh(psf, prepared);
            channel.engine.replace(group, &prepared.exposure)?;
        }
        if worst > HOPELESS {
            return Ok(false);
        }
        self.runners[group].has_renewed(has_other_pixels)?;
        Ok(true)
    }

    /// Ends the fit of a group, which was evaluated last in `row`, for the reason `ended` or that
    /// of its runner.
    fn settle(
        &mut self,
        channels: &mut [SessionChannel],
        result: &mut GroupResult,
        (group, row, ended): (usize, usize, Option<StopReason>),
        began: Instant,
    ) -> Result<()> {
        let Self { information, runners, points, scratch, point, .. } = self;
        let runner = &runners[group];
        if runner.reason() == StopReason::Cancelled {
            return Err(interrupted());
        }
        let members = channels.iter().filter(|channel| channel.is_member(group)).count();
        let unknowns = point.len().div_ceil(members);
        let seconds = began.elapsed().as_secs_f64() / channels.len() as f64;
        for (number, channel) in channels.iter_mut().enumerate().filter(|(_, channel)| channel.is_member(group)) {
            let mut own = points[number].row_mut(row);
            information.unknowns.write_coefficients(number, runner.point(), own.view_mut());
            let psf = channel.shared.fitter.reference.psf_in(own.view(), &mut scratch[number]);
            let fit = &mut channel.fits[group];
            let ((flux_e, background_e), chi2) = chi2_of(psf, &fit.prepared, unknowns);
            (fit.minimum.flux_e, fit.minimum.background_e) = (flux_e, background_e);
            (fit.minimum.chi2, fit.minimum.images) = (chi2, members);
        }
        let (evaluations, reason) = runner.write_solution(point);
        let reason = ended.unwrap_or(reason);
        let modes = points[0].ncols();
        if self.has_one_wavelength {
            let start_nm = &channels[0].fits[group].start_nm;
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
            self.write_modes(result, channels, (group, row));
        }
        Ok(())
    }

    /// Writes the modes of a group whose images were all fitted, to `point`, and how well they are
    /// known.
    fn write_modes(&mut self, result: &mut GroupResult, channels: &[SessionChannel], (group, row): (usize, usize)) {
        let modes = result.coefficients_nm.len();
        result.coefficients_nm.copy_from_slice(&self.point[..modes]);
        channels[0].fitter().motions.remove(&mut result.coefficients_nm);
        for (number, channel) in channels.iter().enumerate() {
            let fit = &channel.fits[group];
            let floor_e2 = fit.prepared.floor_variance_e2.iter().copied().fold(f64::INFINITY, f64::min);
            self.information.take(number, channel.fitter(), (fit.minimum.flux_e, floor_e2));
        }
        let scale = |channel: &SessionChannel| channel.results()[group].report.reduced_chi2.max(1.0);
        let gradients = self.gradients.iter().map(|gradients| gradients.row(row));
        result.disagreement = self.information.differences(&self.point, gradients.zip(channels.iter().map(scale)));
        result.is_contradictory = contradict(result.disagreement);
        self.information.write_sigma(&mut result.sigma_nm);
        // Images that disagree by more than their noise are wrong by at least as much.
        let scale = channels.iter().map(scale).fold(result.disagreement.0, f64::max).max(1.0).sqrt();
        result.sigma_nm.iter_mut().for_each(|sigma| *sigma *= scale);
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

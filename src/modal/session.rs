//! Session: fits in real time of the images of wavefronts, with all memory allocated when it is
//! created. The images of one wavefront are a *group*: one frame of each channel of the scene,
//! which is one image where the scene has one channel.
//!
//! Frames are fitted as [`Policy::realtime`](crate::pipeline::Policy::realtime) says: one basis, no
//! search for outliers in frames that are reduced, no restarts. Those of several channels are
//! fitted together (`joint_fit`). Their error bars are from the information at the flat wavefront,
//! at the flux and the noise of each frame (`information`); at the fitted wavefront it would take
//! some hundred evaluations: [`Session::refine`] has it.

mod channel;
pub(in crate::modal) mod channel_fitters;
mod information;
mod joint_fit;
mod options;
#[cfg(all(test, feature = "opencl", debug_assertions))]
mod tests;

pub use channel::SessionChannel;
pub use options::{FitOptions, GroupResult, ImageResult, RefinedGroup, SessionOptions};

use super::combine::combine;
use crate::control::Control;
use crate::modal::combine::combined_modes::CombinedModes;
use crate::modal::combine::diversity_error::has_diversity;
use crate::modal::combine::integers::are_determined;
use crate::modal::combine::joint::joint;
use crate::modal::estimate::image_fits::FittedCube;
use crate::modal::fitter::ModalFitter;
use crate::modal::group::refined;
use crate::modal::session::channel_fitters::ChannelFitters;
use crate::scene::{Grouping, Weighting};
use crate::{Error, Result};
use joint_fit::JointFit;
use ndarray::{ArrayView2, ArrayViewMut2};
use options::check_read_noise;
use std::time::Instant;

/// A workspace for fits with the models of the channels of a scene: frames are written into it
/// ([`Session::frame_mut`]), fitted, and their results read. It is one thread's at a time.
///
/// It follows [`Policy::realtime`](crate::pipeline::Policy::realtime): one fit of the scene's
/// modes, no modes with a prior, but for channels none of which determines the wavefront by itself,
/// no restarts; pixels that the model does not explain are rejected
/// in the fit. Device and precision are the scene's (`estimate.device`, `estimate.precision`) where
/// [`SessionOptions`] leave them open.
///
/// On the CPU with one thread, [`Session::fit`], [`Session::load`] and [`Session::evaluate`]
/// neither allocate nor free memory, take no lock and format no text, except for an error message.
/// A fit depends on its own group alone, for any number of groups and threads; that of one channel
/// is that of [`ModalFitter::estimate`](super::ModalFitter::estimate) to the last bit.
///
/// In several wavelengths pistons are taken within half a wavelength of the start; where that is
/// wrong, the channels contradict each other, and [`Session::refine`] finds the whole wavelengths.
pub struct Session {
    fitters: ChannelFitters,
    channels: Vec<SessionChannel>,
    /// What fits the frames of several channels together.
    joint: Option<JointFit>,
    control: Control,
    results: Vec<GroupResult>,
    /// Number of groups of the last fit.
    fitted: usize,
}

impl Session {
    /// Allocates all memory, and computes the metrics of the fitters where they have none yet
    /// (about a second for a large model).
    ///
    /// # Errors
    /// [`Error::Value`] for options out of range and for a recipe with the paper's BFGS, which
    /// cannot be stopped and resumed; [`Error::Device`] where the device cannot run the model;
    /// [`Error::Scene`] for several channels that are all in focus, that are not weighted by their
    /// noise, that are to be fitted each by itself, or whose modes do not span an error of the
    /// diversity.
    pub fn new(fitters: impl Into<ChannelFitters>, options: &SessionOptions) -> Result<Self> {
        let fitters = fitters.into();
        options.check()?;
        let is_joint = fitters.len() > 1;
        if is_joint {
            check_channels(&fitters)?;
        }
        let control = Control::default();
        let channels = fitters
            .iter()
            .map(|(name, fitter)| SessionChannel::new((name, fitter.clone()), options, control.clone(), is_joint))
            .collect::<Result<Vec<_>>>()?;
        // On one thread nothing is gained by several at once, and a deadline leaves the last.
        let is_alone = options.threads == 1 && channels.iter().all(|channel| channel.device_name() == "cpu");
        let at_once = if is_alone { 1 } else { options.capacity };
        let joint = is_joint.then(|| JointFit::new(&fitters, &channels, at_once, &control)).transpose()?;
        let results = vec![GroupResult::new(fitters.first().model.optics.modes()); options.capacity];
        Ok(Self { fitters, channels, joint, control, results, fitted: 0 })
    }

    /// The fitters of the channels.
    pub fn fitters(&self) -> &ChannelFitters {
        &self.fitters
    }

    /// The channels, with the fits of their images.
    pub fn channels(&self) -> &[SessionChannel] {
        &self.channels
    }

    /// Where it runs: `cpu`, or the address and the name of a device.
    pub fn device_name(&self) -> &str {
        self.channels[0].device_name()
    }

    /// Most groups of a call.
    pub fn capacity(&self) -> usize {
        self.results.len()
    }

    /// Buffers of the frame of a group in a channel, `[y, x]`: electrons and bad pixels, which the
    /// caller writes before a fit. A fit does not change them.
    ///
    /// # Errors
    /// [`Error::Shape`] beyond the capacity, [`Error::Value`] for a channel that does not exist.
    pub fn frame_mut(
        &mut self,
        group: usize,
        channel: usize,
    ) -> Result<(ArrayViewMut2<'_, f64>, ArrayViewMut2<'_, bool>)> {
        let capacity = self.capacity();
        self.channel_mut(channel)?.frame_mut(group).ok_or_else(|| {
            Error::Shape(format!(
                "frame {group} does not exist: the session has a capacity of {capacity}, numbered from 0"
            ))
        })
    }

    /// Fits the frames of groups 0 to `count` − 1, those of a group together. A start of `options`
    /// is that of all channels; the deadline holds for all fits together. A frame that cannot be
    /// fitted has its status in its result.
    ///
    /// # Errors
    /// [`Error::Interrupted`] where [`Session::control`] was cancelled, which leaves no results;
    /// [`Error::Shape`] for more groups than the capacity or a start of another shape,
    /// [`Error::Value`] for an option out of range, [`Error::Device`] where a device fails.
    pub fn fit(&mut self, count: usize, options: &FitOptions) -> Result<()> {
        let began = Instant::now();
        self.discard_results();
        self.check_count(count)?;
        options.check(count, self.modes())?;
        // A deadline that the clock cannot represent is no deadline.
        let deadline = options.deadline.and_then(|time| began.checked_add(time));
        let fitted = self.fit_until(deadline, count, options);
        if let Err(error) = fitted {
            if let Error::Interrupted(_) = error {
                self.control.acknowledge();
            }
            self.discard_results();
            return Err(error);
        }
        self.fitted = count;
        Ok(())
    }

    fn fit_until(&mut self, deadline: Option<Instant>, count: usize, options: &FitOptions) -> Result<()> {
        match &mut self.joint {
            Some(joint) => {
                let control = self.control.silent().until(deadline);
                joint.fit(&mut self.channels, &mut self.results[..count], options, &control)
            }
            None => {
                let channel = &mut self.channels[0];
                channel.fit(count, options.start_nm, options.read_noise_e, deadline)?;
                channel.results().iter().zip(&mut self.results).for_each(|(image, result)| result.take(image));
                Ok(())
            }
        }
    }

    /// The result of each group of the last fit; none after a fit that failed.
    pub fn results(&self) -> &[GroupResult] {
        &self.results[..self.fitted]
    }

    /// The result of a group of the last fit with its covariance: in one channel that of the noise
    /// at the fitted wavefront, scaled by χ² where the model misfits. The images of several
    /// channels are fitted together, and the whole wavelengths of pistons found: the estimate of
    /// [`Estimator`](crate::pipeline::Estimator) by the policy realtime from the same frames. It
    /// allocates, and takes some hundred evaluations of each channel.
    ///
    /// # Errors
    /// [`Error::Value`] for a group that was not fitted or that no mode changes, and unless the
    /// fit of several channels converged.
    pub fn refine(&self, group: usize) -> Result<RefinedGroup> {
        if self.joint.is_none() {
            let channel = &self.channels[0];
            let covariance_nm2 = channel.covariance_nm2(group)?;
            let coefficients_nm = channel.results()[group].coefficients_nm.clone();
            return Ok(RefinedGroup::of_one(CombinedModes { coefficients_nm, covariance_nm2 }));
        }
        if !self.results().get(group).is_some_and(|result| result.status.has_converged()) {
            return Err(Error::Value(format!(
                "group {group} has no joint result, which needs a fit of all channels that converged; the last fit was of {} groups: fit \
                 them first",
                self.fitted
            )));
        }
        let scene = self.fitters.scene();
        let wavelengths_nm: Vec<f64> =
            self.fitters.iter().map(|(_, fitter)| fitter.model.optics.parts().wavelength_nm).collect();
        let own: Vec<&ModalFitter> = self.fitters.iter().map(|(_, fitter)| &**fitter).collect();
        let together = |near_nm: &[f64]| {
            let fits = self.channels.iter().map(|channel| vec![channel.unfitted(group)]);
            refined(scene, &own, fits.collect(), near_nm)
        };
        if !are_determined(&wavelengths_nm)
            && let Some(joint) = together(&self.results[group].coefficients_nm)?
        {
            return Ok(joint.into());
        }
        let found = self.channels.iter().map(|channel| {
            let fitted = FittedCube::from_fits(vec![channel.fitted_alone(group)?]);
            combine(channel.fitter(), fitted, false).map_err(|error| error.of_channel(channel.name()))
        });
        let found = found.collect::<Result<Vec<_>>>()?;
        let each: Vec<_> =
            self.channels.iter().zip(&found).map(|(channel, found)| (&**channel.fitter(), found)).collect();
        let joint = joint(scene, &each, &[])?;
        let near_nm = &joint.modes.coefficients_nm;
        match (!joint.is_contradictory()).then(|| together(near_nm)).transpose()?.flatten() {
            Some(found) => Ok(RefinedGroup { integers: joint.integers, ..found.into() }),
            None => Ok(joint.into()),
        }
    }

    /// Cancels the running fit, or else the next, from another thread.
    pub fn control(&self) -> &Control {
        &self.control
    }

    /// Prepares the frames of a channel in groups 0 to `count` − 1 for [`Session::evaluate`],
    /// weighted by the noise of their own pixels.
    ///
    /// # Errors
    /// [`Error::Image`] for the first that cannot be used, [`Error::Shape`] for more than the
    /// capacity, [`Error::Value`] for a channel that does not exist or a read noise out of range,
    /// [`Error::Device`] where a device fails.
    pub fn load(&mut self, channel: usize, count: usize, read_noise_e: Option<f64>) -> Result<()> {
        self.discard_results();
        self.check_count(count)?;
        check_read_noise(read_noise_e)?;
        self.channel_mut(channel)?.load(count, read_noise_e)
    }

    /// Objectives of the loaded images of a channel at `coefficients_nm` (`[image, mode]`, nm;
    /// fewer images than are loaded are the first ones), and their gradients per nm, image by
    /// image.
    ///
    /// # Errors
    /// [`Error::Shape`] where the arrays do not fit each other, the model or what is loaded;
    /// [`Error::Value`] where nothing is, and for a channel that does not exist; [`Error::Device`]
    /// where a device fails.
    pub fn evaluate(
        &mut self,
        channel: usize,
        coefficients_nm: ArrayView2<f64>,
        objectives: &mut [f64],
        gradients: &mut [f64],
    ) -> Result<()> {
        self.channel_mut(channel)?.evaluate(coefficients_nm, objectives, gradients)
    }

    fn modes(&self) -> usize {
        self.fitters.first().model.optics.modes()
    }

    fn channel_mut(&mut self, channel: usize) -> Result<&mut SessionChannel> {
        self.fitters.get(channel)?;
        Ok(&mut self.channels[channel])
    }

    fn check_count(&self, count: usize) -> Result<()> {
        let capacity = self.capacity();
        if count > capacity {
            return Err(Error::Shape(format!("{count} groups were given: the session accepts up to {capacity}")));
        }
        Ok(())
    }

    fn discard_results(&mut self) {
        self.fitted = 0;
        self.channels.iter_mut().for_each(SessionChannel::discard_results);
    }
}

/// Refuses channels that cannot be fitted together in real time.
fn check_channels(fitters: &ChannelFitters) -> Result<()> {
    if let Some((_, fitter)) = fitters.iter().find(|(_, fitter)| fitter.recipe.weighting != Weighting::Noise) {
        return Err(Error::Scene(format!(
            "{}: a session of several channels needs estimate.weighting = \"noise\", by which they are weighed against each other",
            fitter.scene.name()
        )));
    }
    if fitters.scene().estimate.group == Grouping::Each {
        return Err(Error::Scene(format!(
            "{}: a session fits one image of each channel together, which estimate.group = \"each\" excludes: leave it out",
            fitters.scene().name()
        )));
    }
    if !fitters.iter().any(|(_, fitter)| has_diversity(&fitter.scene.image)) {
        return Err(Error::Scene(format!(
            "{}: all channels are in focus, where images do not determine the signs of even aberrations: one that is defocused \
             (diversity_focus_waves_rms) or has a known shape of the mirror (diversity_file) is needed",
            fitters.scene().name(),
        )));
    }
    Ok(())
}

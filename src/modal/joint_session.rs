//! Session of several channels: one frame of each is fitted in real time, and the fits are combined, with all memory allocated when it
//! is created.
//!
//! The combination is that of `joint.rs`, with the information of each channel taken at the flat wavefront, at the flux and the noise of
//! its frame, where `joint.rs` computes it at the fitted wavefront in some hundred evaluations: [`JointSession::refine`] does so.
//! Weights that are off by a few per cent leave the estimate without bias, and change it by as many per cent of its error bar.

mod combiner;

use super::combine::combine;
use super::diversity_error::has_diversity;
use super::fitter::ModalFitter;
use super::integers::PistonInteger;
use super::joint::{contradict, joint};
use super::model_cache::ModelCache;
use super::recipe::Recipe;
use super::session::{FitOptions, ImageResult, Session, SessionOptions};
use super::status::{Status, worst};
use crate::optimize::{CancelFlag, StopReason};
use crate::scene::{System, Weighting};
use crate::{Error, Result};
use combiner::{Combiner, FittedChannel};
use ndarray::{Array2, ArrayViewMut2};
use std::sync::Arc;
use std::time::Instant;

/// A workspace for fits of one frame of each channel of a scene. Frames are written into it ([`JointSession::frame_mut`]), fitted,
/// and the common modes read. It is one thread's at a time.
///
/// Each channel is fitted as a [`Session`] fits a frame, by [`Policy::realtime`](crate::pipeline::Policy::realtime), and to the same
/// bits. In several wavelengths pistons are taken within half a wavelength of the start; where that is wrong, the channels contradict
/// each other, and [`JointSession::refine`] finds the whole wavelengths.
///
/// On the CPU with one thread, [`JointSession::fit`] neither allocates nor frees memory, takes no lock and formats no text, except for
/// an error message.
pub struct JointSession {
    scene: System,
    names: Vec<String>,
    sessions: Vec<Session>,
    combiner: Combiner,
    cancel: CancelFlag,
    fit: JointFit,
    /// Whether the last fit gave results.
    is_fitted: bool,
}

/// Joint result of one frame of each channel.
#[derive(Debug, Clone)]
pub struct JointFit {
    /// Every mode, nm, pistons about their mean over the pupil; NaN unless the fits of all channels converged.
    pub coefficients_nm: Vec<f64>,
    /// Error bar of each mode, 1σ, nm: from the information at the flat wavefront, scaled by the root of χ² where a channel's model
    /// misfits, and where the channels contradict each other. Bad pixels are not left out.
    pub sigma_nm: Vec<f64>,
    /// The worst status of the channels.
    pub status: Status,
    /// Reduced χ² of the differences of the channels, where noise gives 1, and its degrees of freedom; (NaN, 0) without coefficients.
    pub disagreement: (f64, f64),
    /// Whether the channels differ by more than their noise: one is flipped, of another wavelength or diversity than the scene says, or
    /// in another minimum.
    pub is_contradictory: bool,
    /// Wall-clock time of the call, s.
    pub seconds: f64,
}

/// Combination of the last fits by their information at the fitted wavefront; see [`JointSession::refine`].
#[derive(Debug, Clone)]
pub struct RefinedFit {
    /// Every mode, nm.
    pub coefficients_nm: Vec<f64>,
    /// Its covariance, `[mode, mode]`, nm².
    pub covariance_nm2: Array2<f64>,
    /// As in [`JointFit::disagreement`].
    pub disagreement: (f64, f64),
    /// As in [`JointFit::is_contradictory`].
    pub is_contradictory: bool,
    /// Whole wavelengths of each segment's piston; none where the channels have one wavelength.
    pub integers: Vec<PistonInteger>,
}

impl JointSession {
    /// Builds the models of the channels of `scene` and allocates all memory.
    ///
    /// # Errors
    /// [`Error::Scene`] for a scene without channels or with one in focus, and for what a [`ModalFitter`] refuses; those of
    /// [`Session::new`]; [`Error::Value`] for a capacity other than 1.
    pub fn new(scene: &System, options: &SessionOptions) -> Result<Self> {
        check(scene, options)?;
        let (cancel, first) = (CancelFlag::default(), &scene.channels()[0].system);
        let cache = ModelCache::default();
        let sessions = scene.channels().iter().map(|channel| {
            let (own, recipe) = (&channel.system, Recipe::from_scene(&channel.system));
            if recipe.weighting != Weighting::Noise {
                return Err(Error::Scene(format!(
                    "{}: a session of several channels needs estimate.weighting = \"noise\", by which they are weighed against each other",
                    own.name()
                )));
            }
            let fitter = ModalFitter::with_scene_basis(own, recipe, false, cache.for_scene(first, own).basis)?;
            Session::with_cancel_flag(Arc::new(fitter), options, cancel.clone())
        });
        let sessions = sessions.collect::<Result<Vec<_>>>()?;
        let combiner =
            Combiner::new(scene, &sessions.iter().map(|session| &**session.estimator()).collect::<Vec<_>>())?;
        let names = scene.channels().iter().map(|channel| channel.name.clone()).collect();
        let modes = sessions[0].estimator().model.optics.modes();
        let unknown = vec![f64::NAN; modes];
        let fit = JointFit {
            coefficients_nm: unknown.clone(),
            sigma_nm: unknown,
            status: Status::NotConverged(StopReason::Unfinished),
            disagreement: (f64::NAN, 0.0),
            is_contradictory: false,
            seconds: 0.0,
        };
        Ok(Self { scene: scene.clone(), names, sessions, combiner, cancel, fit, is_fitted: false })
    }

    /// The scene.
    pub fn scene(&self) -> &System {
        &self.scene
    }

    /// Names of the channels, in order.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The fitter of a channel, numbered from 0, whose model has the modes that all channels share.
    ///
    /// # Errors
    /// [`Error::Value`] for a channel that does not exist.
    pub fn estimator(&self, channel: usize) -> Result<&Arc<ModalFitter>> {
        self.sessions.get(channel).map(Session::estimator).ok_or_else(|| no_channel(channel, self.sessions.len()))
    }

    /// Where it runs: `cpu`, or the address and the name of a device.
    pub fn device_name(&self) -> String {
        self.sessions[0].device_name()
    }

    /// The sessions of the channels.
    pub(crate) fn sessions(&self) -> &[Session] {
        &self.sessions
    }

    /// Buffers of the frame of a channel, `[y, x]`: electrons and bad pixels, which the caller writes before a fit.
    ///
    /// # Errors
    /// [`Error::Value`] for a channel that does not exist.
    pub fn frame_mut(&mut self, channel: usize) -> Result<(ArrayViewMut2<'_, f64>, ArrayViewMut2<'_, bool>)> {
        let count = self.sessions.len();
        self.sessions.get_mut(channel).ok_or_else(|| no_channel(channel, count))?.frame_mut(0)
    }

    /// Fits the frames, one channel after the other, and combines the fits. A start of `options` is one row, for all channels; the
    /// deadline holds for all fits together.
    ///
    /// # Errors
    /// As [`Session::fit`]. A frame that cannot be fitted has its status in [`JointSession::results`].
    pub fn fit(&mut self, options: &FitOptions) -> Result<()> {
        let began = Instant::now();
        self.is_fitted = false;
        // A deadline that the clock cannot represent is no deadline.
        let deadline = options.deadline.and_then(|time| began.checked_add(time));
        for (session, name) in self.sessions.iter_mut().zip(&self.names) {
            let deadline = deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
            session.fit(1, &FitOptions { deadline, ..options.clone() }).map_err(|error| error.of_channel(name))?;
        }
        self.combine();
        self.fit.seconds = began.elapsed().as_secs_f64();
        self.is_fitted = true;
        Ok(())
    }

    /// The joint result of the last fit; `None` after a fit that failed.
    pub fn result(&self) -> Option<&JointFit> {
        self.is_fitted.then_some(&self.fit)
    }

    /// The result of each channel's own fit; none after a fit that failed.
    pub fn results(&self) -> impl ExactSizeIterator<Item = &ImageResult> {
        let all = if self.is_fitted { &self.sessions[..] } else { &[] };
        all.iter().map(|session| &session.results()[0])
    }

    /// Combines the last fits by the information at their wavefronts, and resolves the whole wavelengths of pistons: the estimate of
    /// [`Estimator`](crate::pipeline::Estimator) with the policy realtime from the same frames. It allocates, and takes some hundred
    /// evaluations.
    ///
    /// # Errors
    /// [`Error::Value`] where the last fit failed or that of a channel did not converge.
    pub fn refine(&self) -> Result<RefinedFit> {
        if !self.is_fitted || !self.fit.status.has_converged() {
            return Err(Error::Value(
                "a joint estimate needs frames of all channels that were fitted: fit them first".into(),
            ));
        }
        let found = self.sessions.iter().zip(&self.names).map(|(session, name)| {
            let (fits, fitter) = (session.fits(), session.estimator());
            let prepared: Vec<_> = fits.iter().map(|fit| fit.prepared.clone()).collect();
            let minima: Vec<_> = fits.iter().map(|fit| fit.minimum.clone()).collect();
            combine(fitter, vec![None], &[0], &prepared, minima).map_err(|error| error.of_channel(name))
        });
        let found = found.collect::<Result<Vec<_>>>()?;
        let each: Vec<_> =
            self.sessions.iter().zip(&found).map(|(session, found)| (&**session.estimator(), found)).collect();
        let joint = joint(&self.scene, &each)?;
        Ok(RefinedFit {
            disagreement: joint.disagreement,
            is_contradictory: joint.is_contradictory(),
            coefficients_nm: joint.combined.coefficients_nm,
            covariance_nm2: joint.combined.covariance_nm2,
            integers: joint.integers,
        })
    }

    /// The flag that cancels the running fit, or else the next, as [`Session::cancel_flag`].
    pub fn cancel_flag(&self) -> CancelFlag {
        self.cancel.clone()
    }

    /// Writes the joint result of fits that have ended.
    fn combine(&mut self) {
        let each = self.sessions.iter().map(|session| &session.results()[0].report.status);
        self.fit.status = *worst(each);
        let converged = self.fit.status.has_converged();
        self.fit.disagreement = (f64::NAN, 0.0);
        if converged {
            let channels = self.sessions.iter().map(|session| FittedChannel {
                fitter: session.estimator(),
                fit: &session.fits()[0],
                result: &session.results()[0],
            });
            let JointFit { coefficients_nm, sigma_nm, .. } = &mut self.fit;
            self.fit.disagreement = self.combiner.combine(channels, coefficients_nm, sigma_nm);
        } else {
            self.fit.coefficients_nm.fill(f64::NAN);
            self.fit.sigma_nm.fill(f64::NAN);
        }
        self.fit.is_contradictory = contradict(self.fit.disagreement);
    }
}

fn no_channel(given: usize, count: usize) -> Error {
    Error::Value(format!("channel {given} does not exist: the session has {count}, numbered from 0"))
}

/// Refuses scenes and options that a session of several channels does not have.
fn check(scene: &System, options: &SessionOptions) -> Result<()> {
    let channels = scene.channels();
    if channels.is_empty() {
        return Err(Error::Scene(format!(
            "{}: a session of several channels needs a scene with [[image.channel]]; a scene of one camera has a model and a session of it",
            scene.name()
        )));
    }
    if options.capacity != 1 {
        return Err(Error::Value(format!(
            "capacity is {}: 1 is accepted in a session of several channels, which fits one frame of each",
            options.capacity
        )));
    }
    match channels.iter().find(|channel| !has_diversity(&channel.system.image)) {
        None => Ok(()),
        Some(channel) => Err(Error::Scene(format!(
            "{}: the channel '{}' is in focus, where an image does not determine the signs of even aberrations and a fit in real time would \
             end in one of many minima: leave it out, or give this scene to the full pipeline ('cophase estimate', pipeline::Estimator, \
             cophase_estimator_create)",
            scene.name(),
            channel.name
        ))),
    }
}

//! Estimator: a scene, a policy, and the estimate of images by them.

use super::channels::{ChannelImages, by_diversity};
use super::consistency::{Electrons, reconcile};
use super::control::{Control, Stage};
use super::cut_out::scene_of_cut_out;
use super::estimate::Estimate;
use super::image_changes::{CHANGING, image_changes};
use super::images::{Images, TruthMaps, counted};
use super::modal_task::ModalTask;
use super::parts::PartFits;
use super::policy::Policy;
use super::pupil_turns::TurnedImages;
use super::scene_files::{FileState, check_for_estimate, file_states};
use super::sequence_channel::{Sequence, SequenceChannel};
use super::{channel_sequence, channels, map, modal};
use crate::modal::{ModelCache, check_frame_shape};
use crate::planner;
use crate::scene::{Channel, Method, Scene};
use crate::{Error, Result};
use std::borrow::Cow;
use std::sync::{Mutex, PoisonError};

/// Estimates the static wavefront behind images of one scene. The model of a modal estimate is kept for the next one, unless the image file,
/// fitted optics or a file that the scene names change it.
pub struct Estimator {
    /// The scene as given.
    pub(super) given: Scene,
    /// The scene with the choices of its plan.
    pub(super) scene: Scene,
    pub(super) policy: Policy,
    pub(super) control: Control,
    /// What was built, and the files' states then.
    pub(super) cache: Mutex<(Vec<FileState>, ModelCache)>,
    /// Why a plan does not meet its budget.
    pub(super) shortfall: Option<String>,
}

impl Estimator {
    /// An estimator with the default policy. Where the scene names `estimate.budget_nm` the model is planned here, which
    /// takes some seconds.
    ///
    /// # Errors
    /// [`Error::File`] for a file that the scene names and that does not exist; those of [`planner::plan`].
    pub fn new(scene: &Scene) -> Result<Self> {
        Self::with_policy(scene, Policy::default(), Control::default())
    }

    /// An estimator with a policy and a control of the caller's.
    ///
    /// # Errors
    /// As [`Estimator::new`]; [`Error::Scene`] for a key that the policy does not honour; [`Error::Interrupted`].
    pub fn with_policy(scene: &Scene, policy: Policy, control: Control) -> Result<Self> {
        policy.check(scene)?;
        check_for_estimate(scene)?;
        let (given, (scene, shortfall)) = (scene.clone(), planned(scene, &control)?);
        Ok(Self { given, scene, policy, control, cache: Mutex::default(), shortfall })
    }

    /// An estimator of another scene with this one's policy and control. It shares the Karhunen-Loève basis, which takes most
    /// of the time of building a model, where telescope, mirror, turbulence and modes are the same.
    ///
    /// # Errors
    /// As [`Estimator::with_policy`].
    pub fn variant(&self, scene: &Scene) -> Result<Self> {
        let cache = self.cache().for_scene(&self.scene, scene);
        let variant = Self::with_policy(scene, self.policy, self.control.clone())?;
        Ok(Self { cache: Mutex::new((file_states(&variant.scene), cache)), ..variant })
    }

    /// What earlier estimates have built; nothing where a file of the scene has changed since.
    pub(super) fn cache(&self) -> ModelCache {
        let files = file_states(&self.scene);
        let mut kept = self.cache.lock().unwrap_or_else(PoisonError::into_inner);
        if kept.0 != files {
            *kept = (files, ModelCache::default());
        }
        kept.1.clone()
    }

    /// The scene, with the choices of its plan where it named a budget.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The policy.
    pub fn policy(&self) -> &Policy {
        &self.policy
    }

    /// Progress and cancellation of [`Estimator::estimate`].
    pub fn control(&self) -> &Control {
        &self.control
    }

    /// Estimates the static wavefront behind `images`. Problems of single images are in their outcomes; warnings on the whole
    /// are in [`Estimate::warnings`].
    ///
    /// # Errors
    /// [`Error::Image`] for a file that contradicts the scene where [`Images::trust`] does not decide, and for images in counts
    /// without a gain. Those of building the telescope and its modes; [`Error::Shape`] for images of another size than the scene says,
    /// or telemetry of another number; [`Error::Image`] where no image can be used (two in a MAP estimate);
    /// [`Error::Device`] where the device that the scene names does not exist or fails; [`Error::Interrupted`] after
    /// [`Control::cancel`].
    pub fn estimate(&self, images: &Images) -> Result<Estimate> {
        self.estimate_one(images, None)
    }

    /// [`Estimator::estimate`], with the fits of parts.
    fn estimate_one(&self, images: &Images, parts: Option<&mut PartFits>) -> Result<Estimate> {
        self.begin(images)?;
        if let Some((scene, remark)) = scene_of_cut_out(&self.given, &[images])? {
            let estimate = self.variant(&scene)?.estimate_one(images, parts)?;
            return Ok(with_remark(estimate, remark));
        }
        if let Some(turned) = TurnedImages::of(&self.given, &[images])? {
            return self.estimate_turned(turned, parts, images);
        }
        let (cut_images, cut) = images.without_odd_edge(self.given.image.fitted_shape());
        let Ready { scene, images: electrons, cache, notes, remarks } = self.ready(&cut_images)?;
        let (policy, control) = (&self.policy, &self.control);
        let found = match scene.estimate.method {
            Method::FullPhase => {
                let channels = [SequenceChannel { scene: &scene, images: &electrons }];
                let Electrons { slopes_mas, moved_reference_mas, .. } = electrons;
                let is_simultaneous = false;
                let channels = &channels;
                map::estimate(
                    &scene,
                    Sequence { channels, is_simultaneous, slopes_mas, moved_reference_mas, policy, control },
                )
            }
            Method::Modal | Method::Auto => {
                let series = self.series(parts, &scene, &[(&scene, &electrons)], &[electrons.len()])?;
                let task = ModalTask { scene: &scene, policy, control, cache: &cache, images: &electrons };
                modal::estimate(&task, series.and_then(|series| series.first_mut()))
            }
        };
        self.control.enter(Stage::Idle, 0);
        let mut estimate = acknowledged(&self.control, found)?;
        estimate.warnings.splice(0..0, notes);
        estimate.remarks.splice(0..0, cut.into_iter().chain(remarks));
        compare_with_truth(&mut estimate, images.truth.as_ref());
        Ok(estimate)
    }

    /// Checks the images of a call that begins.
    pub(super) fn begin(&self, images: &Images) -> Result<()> {
        self.given.refuse_channels("the images of one cube")?;
        images.check()?;
        self.control.reset_progress();
        Ok(())
    }

    /// What an estimate from `images`, which are of the fitted size, works on.
    pub(super) fn ready<'a>(&self, images: &'a Images) -> Result<Ready<'a>> {
        check_size(images, &self.given)?;
        let consistent = reconcile(images, &self.given)?;
        let (scene, shortfall, cache) = if consistent.is_changed {
            let (scene, shortfall) = planned(&consistent.scene, &self.control)?;
            (scene, shortfall, ModelCache::default())
        } else {
            (self.scene.clone(), self.shortfall.clone(), self.cache())
        };
        let (scene, chosen) = resolved(&scene, &consistent.images)?;
        let notes = shortfall.into_iter().chain(images.notes.iter().cloned()).collect();
        let remarks = consistent.remarks.into_iter().chain(chosen).collect();
        Ok(Ready { scene, images: consistent.images, cache, notes, remarks })
    }

    /// As [`Estimator::estimate`], for the images of each channel of the scene: in the order of [`Scene::channels`], or in any order where
    /// [`Images::channel`] names the channel of each. For a scene without channels it is [`Estimator::estimate`] of the only images.
    ///
    /// # Errors
    /// As [`Estimator::estimate`]; [`Error::Shape`] for images of other channels than the scene has.
    pub fn estimate_channels(&self, images: &[Images]) -> Result<Estimate> {
        self.estimate_each(images, None)
    }

    /// [`Estimator::estimate_channels`], with the fits of parts.
    pub(super) fn estimate_each(&self, images: &[Images], parts: Option<&mut PartFits>) -> Result<Estimate> {
        if let ([], [only]) = (self.scene.channels(), images) {
            return self.estimate_one(only, parts);
        }
        let in_order = self.begin_channels(images)?;
        if let Some((scene, remark)) = scene_of_cut_out(&self.given, &in_order)? {
            let estimate = self.variant(&scene)?.estimate_each(images, parts)?;
            return Ok(with_remark(estimate, remark));
        }
        let images = in_order;
        if let Some(turned) = TurnedImages::of(&self.given, &images)? {
            return self.estimate_turned(turned, parts, images[0]);
        }
        let cut = self.cut_channels(&images);
        let ReadyChannels { scene, channels: ready, notes, remarks } = self.ready_channels(&images, &cut)?;
        let (policy, control) = (&self.policy, &self.control);
        let found = match scene.estimate.method {
            Method::FullPhase => channel_sequence::estimate(&scene, policy, control, &ready),
            Method::Modal | Method::Auto => {
                let each: Vec<_> = ready.iter().map(|channel| (&channel.scene, &channel.images)).collect();
                let fitted: Vec<_> = by_diversity(&ready)[0].iter().map(|channel| channel.images.len()).collect();
                let series = self.series(parts, &scene, &each, &fitted)?;
                channels::estimate(&scene, policy, control, &self.cache(), &ready, series)
            }
        };
        self.control.enter(Stage::Idle, 0);
        let mut estimate = acknowledged(&self.control, found)?;
        estimate.warnings.splice(0..0, notes);
        estimate.remarks.splice(0..0, remarks);
        compare_with_truth(&mut estimate, images.first().and_then(|images| images.truth.as_ref()));
        Ok(estimate)
    }

    /// The estimate of images of different turns of the pupil, the `first` of which have the truth.
    fn estimate_turned(&self, turned: TurnedImages, parts: Option<&mut PartFits>, first: &Images) -> Result<Estimate> {
        let found = self.variant(&turned.scene)?.estimate_each(&turned.images, parts)?;
        let mut estimate = turned.in_given_order(found);
        compare_with_truth(&mut estimate, first.truth.as_ref());
        Ok(estimate)
    }

    /// The images of each channel, in order and checked, of a call that begins.
    pub(super) fn begin_channels<'a>(&self, images: &'a [Images]) -> Result<Vec<&'a Images>> {
        let images = in_order_of(self.scene.channels(), images)?;
        images.iter().try_for_each(|images| images.check())?;
        self.control.reset_progress();
        Ok(images)
    }

    /// The images of each channel in the size that is fitted.
    pub(super) fn cut_channels<'a>(&self, images: &[&'a Images]) -> Vec<CutImages<'a>> {
        let pairs = images.iter().zip(self.scene.channels());
        pairs.map(|(images, channel)| images.without_odd_edge(channel.scene.image.fitted_shape())).collect()
    }

    /// What an estimate from the images of all channels works on.
    pub(super) fn ready_channels<'a>(&'a self, images: &[&Images], cut: &'a [CutImages]) -> Result<ReadyChannels<'a>> {
        let (mut ready, mut notes, mut remarks) = (Vec::new(), Vec::new(), Vec::new());
        notes.extend(self.shortfall.clone());
        for ((channel, whole), (images, cut)) in self.scene.channels().iter().zip(images).zip(cut) {
            let name = &channel.name;
            let consistent = check_size(images, &channel.scene).and_then(|()| reconcile(images, &channel.scene));
            let consistent = consistent.map_err(|error| error.of_channel(name))?;
            notes.extend(whole.notes.iter().map(|note| format!("channel {name}: {note}")));
            remarks.extend(cut.iter().chain(&consistent.remarks).map(|remark| format!("Channel {name}: {remark}")));
            ready.push(ChannelImages { name, scene: consistent.scene, images: consistent.images });
        }
        let (scene, chosen) = resolved_for(&self.scene, &ready)?;
        remarks.extend(chosen);
        Ok(ReadyChannels { scene, channels: ready, notes, remarks })
    }
}

/// Images in the size that is fitted, and a sentence where that is smaller.
pub(super) type CutImages<'a> = (Cow<'a, Images>, Option<String>);

/// What an estimate from one cube of images works on.
pub(super) struct Ready<'a> {
    /// The scene, with the choices of its plan, the file's values that are trusted, and the method.
    pub(super) scene: Scene,
    pub(super) images: Electrons<'a>,
    pub(super) cache: ModelCache,
    notes: Vec<String>,
    remarks: Vec<String>,
}

/// What an estimate from the images of several channels works on.
pub(super) struct ReadyChannels<'a> {
    /// The scene, with the method.
    pub(super) scene: Scene,
    pub(super) channels: Vec<ChannelImages<'a>>,
    notes: Vec<String>,
    remarks: Vec<String>,
}

/// Refuses images of another size than the scene's before their cards are compared with its keys: those of a whole raw frame contradict
/// more than that. In a file with a scene of its own the difference of the scenes is the reason, and it is named first.
pub(super) fn check_size(images: &Images, scene: &Scene) -> Result<()> {
    let (_, rows, columns) = images.images_e.dim();
    if images.scene.is_some() { Ok(()) } else { check_frame_shape((rows, columns), scene.image.fitted_shape()) }
}

/// Adds the truth and the residual against it, or a warning.
fn compare_with_truth(estimate: &mut Estimate, truth: Option<&TruthMaps>) {
    let Some(truth) = truth else { return };
    match estimate.compare(truth) {
        Ok(residual) => estimate.truth = Some((truth.clone(), residual)),
        // A truth on another grid cannot be compared; the estimate is valid without it.
        Err(error) => estimate.warnings.push(format!("the truth of these images is not shown: {error}")),
    }
}

/// `estimate` with one more remark, the first.
fn with_remark(mut estimate: Estimate, remark: String) -> Estimate {
    estimate.remarks.insert(0, remark);
    estimate
}

/// The images of each channel, in the order of the channels.
fn in_order_of<'a>(channels: &[Channel], images: &'a [Images]) -> Result<Vec<&'a Images>> {
    let names = || channels.iter().map(|channel| channel.name.as_str()).collect::<Vec<_>>().join(", ");
    if images.len() != channels.len() {
        let (given, wanted) = (counted(images.len(), "channel"), channels.len().max(1));
        return Err(Error::Shape(format!(
            "there are images of {given}, where the scene has {wanted} ({})",
            if channels.is_empty() { "no [[image.channel]]".into() } else { names() }
        )));
    }
    if images.iter().all(|images| images.channel.is_none()) {
        return Ok(images.iter().collect());
    }
    let of = |channel: &Channel| {
        let found = images.iter().find(|images| images.channel.as_ref() == Some(&channel.name));
        found.ok_or_else(|| {
            let given = images.iter().map(|images| images.channel.as_deref().unwrap_or("no name")).collect::<Vec<_>>();
            Error::Shape(format!(
                "there are no images of the channel '{}': there are those of {}, and the scene has {}",
                channel.name,
                given.join(", "),
                names()
            ))
        })
    };
    channels.iter().map(of).collect()
}

/// `scene` with the choices of its plan, and why the plan does not meet its budget.
fn planned(scene: &Scene, control: &Control) -> Result<(Scene, Option<String>)> {
    let Some(budget_nm) = scene.estimate.budget_nm else { return Ok((scene.clone(), None)) };
    control.enter(Stage::Planning, 0);
    let plan = acknowledged(control, planner::plan(scene, budget_nm, Some(control.flag())))?;
    let shortfall = plan.shortfall();
    Ok((plan.scene, shortfall))
}

/// The scene with the method that `estimate.method = "auto"` chooses for these images, and a sentence on it.
///
/// A MAP estimate needs two images or more that differ by more than noise, and a scene that says what changes them: an AO loop or
/// turbulence.
fn resolved(scene: &Scene, images: &Electrons) -> Result<(Scene, Option<String>)> {
    if scene.estimate.method != Method::Auto {
        return Ok((scene.clone(), None));
    }
    let varies = scene.control.is_some() || scene.wavefront_sensor.is_some() || !scene.turbulence.fractions.is_empty();
    let changes = image_changes(scene, images);
    let (method, because) = match changes {
        None => ("modal", "there are fewer than two images with enough signal to compare".into()),
        Some(chi2) if chi2 < CHANGING => (
            "modal",
            format!("the images do not change from one to the next (reduced χ² of their differences {chi2:.1})"),
        ),
        Some(chi2) if !varies => (
            "modal",
            format!(
                "the images change from one to the next (reduced χ² of their differences {chi2:.1}), but the scene has neither \
                 an AO loop nor turbulence"
            ),
        ),
        Some(chi2) => (
            "full-phase",
            format!("the images change from one to the next (reduced χ² of their differences {chi2:.1})"),
        ),
    };
    let sentence = format!("estimate.method = \"auto\" chose \"{method}\": {because}.");
    Ok((scene.with_override("estimate.method", method)?, Some(sentence)))
}

/// As [`resolved`], for the images of all channels: those of one suffice that change.
fn resolved_for(scene: &Scene, channels: &[ChannelImages]) -> Result<(Scene, Option<String>)> {
    let mut chosen = None;
    for channel in channels.iter().filter(|_| scene.estimate.method == Method::Auto) {
        let (own, sentence) = resolved(&channel.scene, &channel.images)?;
        let is_full_phase = own.estimate.method == Method::FullPhase;
        if is_full_phase || chosen.is_none() {
            chosen = Some((own.estimate.method, sentence));
        }
        if is_full_phase {
            break;
        }
    }
    match chosen {
        None => Ok((scene.clone(), None)),
        Some((method, sentence)) => Ok((scene.with_override("estimate.method", method.word())?, sentence)),
    }
}

/// Lowers the cancel flag after a call that it has ended.
pub(super) fn acknowledged<T>(control: &Control, outcome: Result<T>) -> Result<T> {
    if let Err(Error::Interrupted(_)) = outcome {
        control.acknowledge();
    }
    outcome
}

//! Estimator: a scene, a policy, and the estimate of images by them.

use super::channels::{ChannelImages, named};
use super::consistency::{Electrons, reconcile};
use super::cut_out::scene_of_cut_out;
use super::divided_images::DividedImages;
use super::estimate::Estimate;
use super::grouping::Together;
use super::image_changes::{CHANGING, image_changes};
use super::images::{Images, counted};
use super::parts::PartFits;
use super::policy::Policy;
use super::remarks::{modulo_wavelength_remark, noise_alone_remark};
use super::scene_files::{FileState, check_for_estimate, file_states};
use super::{channels, full_phase, group};
use crate::control::{Control, Stage};
use crate::modal::{ModelCache, StaticMaps, check_frame_shape};
use crate::planner;
use crate::scene::{Method, Scene};
use crate::{Error, Result};
use std::borrow::Cow;
use std::sync::{Mutex, PoisonError};

/// Estimates the static wavefront behind images of one scene. The model of a modal estimate is kept
/// for the next one, unless the image file, fitted optics or a file that the scene names change it.
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
    /// An estimator with the default policy. Where the scene names `estimate.budget_nm` the model
    /// is planned here, which takes some seconds.
    ///
    /// # Errors
    /// [`Error::File`] for a file that the scene names and that does not exist; those of
    /// [`planner::plan`].
    pub fn new(scene: &Scene) -> Result<Self> {
        Self::with_policy(scene, Policy::default(), Control::default())
    }

    /// An estimator with a policy and a control of the caller's.
    ///
    /// # Errors
    /// As [`Estimator::new`]; [`Error::Scene`] for a key that the policy does not honour;
    /// [`Error::Interrupted`].
    pub fn with_policy(scene: &Scene, policy: Policy, control: Control) -> Result<Self> {
        policy.check(scene)?;
        check_for_estimate(scene)?;
        let (given, (scene, shortfall)) = (scene.clone(), planned(scene, &control)?);
        Ok(Self { given, scene, policy, control, cache: Mutex::default(), shortfall })
    }

    /// An estimator of another scene with this one's policy and control. It shares the
    /// Karhunen-Loève basis, which takes most of the time of building a model, where telescope,
    /// mirror, turbulence and modes are the same.
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

    /// Estimates the static wavefront behind `images`: one [`Images`], or a list with those of each
    /// channel of the scene, in the order of [`Scene::each_channel`], or in any order where
    /// [`Images::channel`] names the channel of each. Problems of single images are in their
    /// outcomes; warnings on the whole are in [`Estimate::warnings`].
    ///
    /// # Errors
    /// [`Error::Image`] for a file that contradicts the scene where [`Images::trust`] does not
    /// decide, and for images in counts without a gain. Those of building the telescope and its
    /// modes; [`Error::Shape`] for images of other channels or of another size than the scene says,
    /// or telemetry of another number; [`Error::Image`] where no image can be used (two in a MAP
    /// estimate); [`Error::Device`] where the device that the scene names does not exist or fails;
    /// [`Error::Interrupted`] after [`Control::cancel`].
    pub fn estimate(&self, images: &(impl AsRef<[Images]> + ?Sized)) -> Result<Estimate> {
        self.estimate_with(images.as_ref(), None, None)
    }

    /// [`Estimator::estimate`], with the fits of parts; each image of each channel is of the
    /// exposure `exposures`, where that is not its number.
    pub(super) fn estimate_with(
        &self,
        images: &[Images],
        exposures: Option<&[Vec<usize>]>,
        parts: Option<&mut PartFits>,
    ) -> Result<Estimate> {
        let in_order = self.begin(images)?;
        if let Some((scene, remark)) = scene_of_cut_out(&self.given, &in_order)? {
            let mut estimate = self.variant(&scene)?.estimate_with(images, exposures, parts)?;
            estimate.remarks.insert(0, remark);
            return Ok(estimate);
        }
        let truth = in_order[0].truth.as_ref();
        if let Some(divided) = DividedImages::of(&self.given, &in_order)? {
            let found =
                self.variant(&divided.scene)?.estimate_with(&divided.images, Some(&divided.exposures), parts)?;
            let mut estimate = divided.in_given_order(found);
            compare_with_truth(&mut estimate, truth);
            return Ok(estimate);
        }
        let cut = self.cut(&in_order);
        let EstimateInput { scene, channels, notes, remarks } = self.ready(&in_order, &cut)?;
        let (policy, control) = (&self.policy, &self.control);
        let found = match scene.estimate.method {
            Method::FullPhase => full_phase::estimate(&scene, policy, control, &channels),
            Method::Modal | Method::Auto => match (Together::of(&scene, policy, &channels, exposures)?, parts) {
                (Some(together), parts) => {
                    let groups = self.groups(parts, &scene, (&channels, &together))?;
                    group::estimate(&scene, policy, control, &channels, &together, groups)
                }
                (None, parts) => {
                    let series = self.series(parts, &scene, &channels)?;
                    channels::estimate(&scene, policy, control, &channels, series)
                }
            },
        };
        self.control.enter(Stage::Idle, 0);
        let mut estimate = acknowledged(&self.control, found)?;
        estimate.remarks.extend(noise_alone_remark(&scene, policy));
        estimate.remarks.extend(modulo_wavelength_remark(&estimate));
        estimate.warnings.splice(0..0, notes);
        estimate.remarks.splice(0..0, remarks);
        compare_with_truth(&mut estimate, truth);
        Ok(estimate)
    }

    /// The images of each channel, in order and checked, of a call that begins.
    pub(super) fn begin<'a>(&self, images: &'a [Images]) -> Result<Vec<&'a Images>> {
        let images = in_order_of(&self.scene, images)?;
        images.iter().try_for_each(|images| images.check())?;
        self.control.reset_progress();
        Ok(images)
    }

    /// The images of each channel in the size that is fitted.
    pub(super) fn cut<'a>(&self, images: &[&'a Images]) -> Vec<CutImages<'a>> {
        let pairs = images.iter().zip(self.scene.each_channel());
        pairs.map(|(images, (_, scene))| images.without_odd_edge(scene.image.fitted_shape())).collect()
    }

    /// What an estimate from the images of all channels works on.
    pub(super) fn ready<'a>(&'a self, images: &[&Images], cut: &'a [CutImages]) -> Result<EstimateInput<'a>> {
        let planned_scenes = self.scene.each_channel();
        // A plan of several channels is of all together, and holds where a file replaces a value of
        // one.
        let own_scenes = if images.len() > 1 { planned_scenes.clone() } else { self.given.each_channel() };
        let (cache, mut shortfall, mut channels) = (self.cache(), self.shortfall.clone(), Vec::new());
        let (mut notes, mut remarks) = (Vec::new(), Vec::new());
        for (number, (whole, (images, cut))) in images.iter().zip(cut).enumerate() {
            let (name, own) = own_scenes[number];
            let consistent = check_size(images, own).and_then(|()| reconcile(images, own));
            let consistent = named(name, consistent)?;
            notes.extend(whole.notes.iter().map(|note| (name, note.clone())));
            remarks.extend(cut.iter().chain(&consistent.remarks).map(|remark| (name, remark.clone())));
            let scene = match consistent.scene {
                _ if !consistent.is_changed => planned_scenes[number].1.clone(),
                scene if scene.estimate.budget_nm.is_none() => scene,
                scene => {
                    let (scene, of_plan) = planned(&scene, &self.control)?;
                    shortfall = of_plan;
                    scene
                }
            };
            let cache = cache.for_scene(&self.scene, &scene);
            channels.push(ChannelImages { name, scene, images: consistent.images, cache });
        }
        let mut remarks = once_where_all("Channel", remarks, channels.len());
        let notes = once_where_all("channel", notes, channels.len());
        remarks.extend(choose_method(&mut channels)?);
        // One that lists its channels stays as it was given: what a file replaces is a value of its
        // channel.
        let scene = match &channels[..] {
            [ChannelImages { name: None, scene, .. }] => scene.clone(),
            _ => with_method(&self.scene, channels[0].scene.estimate.method)?,
        };
        Ok(EstimateInput { scene, channels, notes: shortfall.into_iter().chain(notes).collect(), remarks })
    }
}

/// Sentences on channels, which begin with `word` and the channel's name; one that holds for all
/// `channels` once, without a name.
fn once_where_all(word: &str, given: Vec<(Option<&str>, String)>, channels: usize) -> Vec<String> {
    let holds_for_all = |sentence: &String| given.iter().filter(|(_, other)| other == sentence).count() == channels;
    let mut sentences: Vec<String> = Vec::new();
    for (name, sentence) in &given {
        let sentence = match name {
            Some(name) if !holds_for_all(sentence) => format!("{word} {name}: {sentence}"),
            _ => sentence.clone(),
        };
        if !sentences.contains(&sentence) {
            sentences.push(sentence);
        }
    }
    sentences
}

/// Images in the size that is fitted, and a sentence where that is smaller.
pub(super) type CutImages<'a> = (Cow<'a, Images>, Option<String>);

/// Input of an estimate: checked channels, and the scene with plan and method applied.
pub(super) struct EstimateInput<'a> {
    /// The scene with the choices of its plan and the method; one without channels with the file's
    /// values that are trusted, too.
    pub(super) scene: Scene,
    pub(super) channels: Vec<ChannelImages<'a>>,
    notes: Vec<String>,
    remarks: Vec<String>,
}

/// Refuses images of another size than the scene's before their cards are compared with its keys:
/// those of a whole raw frame contradict more than that. In a file with a scene of its own the
/// difference of the scenes is the reason, and it is named first.
pub(super) fn check_size(images: &Images, scene: &Scene) -> Result<()> {
    let (_, rows, columns) = images.images_e.dim();
    if images.scene.is_some() { Ok(()) } else { check_frame_shape((rows, columns), scene.image.fitted_shape()) }
}

/// Adds the truth and the residual against it, or a warning.
fn compare_with_truth(estimate: &mut Estimate, truth: Option<&StaticMaps>) {
    let Some(truth) = truth else { return };
    match estimate.compare(truth) {
        Ok(residual) => estimate.truth = Some((truth.clone(), residual)),
        // A truth on another grid cannot be compared; the estimate is valid without it.
        Err(error) => estimate.warnings.push(format!("the truth of these images is not shown: {error}")),
    }
}

/// The images of each channel of `scene`, in their order.
pub(super) fn in_order_of<'a>(scene: &Scene, images: &'a [Images]) -> Result<Vec<&'a Images>> {
    let channels = scene.each_channel();
    let names: Vec<&str> = channels.iter().filter_map(|(name, _)| *name).collect();
    if images.len() != channels.len() {
        let (given, wanted) = (counted(images.len(), "channel"), channels.len());
        return Err(Error::Shape(format!(
            "there are images of {given}, where the scene has {wanted} ({})",
            if names.is_empty() { "no [[image.channel]]".into() } else { names.join(", ") }
        )));
    }
    if names.is_empty() || images.iter().all(|images| images.channel.is_none()) {
        return Ok(images.iter().collect());
    }
    let of = |name: &&str| {
        let found = images.iter().find(|images| images.channel.as_deref() == Some(name));
        found.ok_or_else(|| {
            let given = images.iter().map(|images| images.channel.as_deref().unwrap_or("no name")).collect::<Vec<_>>();
            Error::Shape(format!(
                "there are no images of the channel '{name}': there are those of {}, and the scene has {}",
                given.join(", "),
                names.join(", ")
            ))
        })
    };
    names.iter().map(of).collect()
}

/// `scene` with the choices of its plan, and why the plan does not meet its budget.
fn planned(scene: &Scene, control: &Control) -> Result<(Scene, Option<String>)> {
    let Some(budget_nm) = scene.estimate.budget_nm else { return Ok((scene.clone(), None)) };
    let plan = acknowledged(control, planner::plan(scene, budget_nm, control))?;
    let shortfall = plan.shortfall();
    Ok((plan.scene, shortfall))
}

/// Gives the scenes of `channels` the method that `estimate.method = "auto"` chooses for all of
/// them, where they have it, and returns a sentence on it: the images of one channel suffice that
/// change.
fn choose_method(channels: &mut [ChannelImages]) -> Result<Option<String>> {
    if channels[0].scene.estimate.method != Method::Auto {
        return Ok(None);
    }
    let mut each: Vec<_> = channels.iter().map(|channel| method_for(&channel.scene, &channel.images)).collect();
    let first = each.iter().position(|(method, _)| *method == Method::FullPhase).unwrap_or_default();
    let (method, because) = each.swap_remove(first);
    for channel in channels {
        channel.scene = with_method(&channel.scene, method)?;
    }
    Ok(Some(format!("estimate.method = \"auto\" chose \"{}\": {because}.", method.word())))
}

fn with_method(scene: &Scene, method: Method) -> Result<Scene> {
    if scene.estimate.method == method {
        Ok(scene.clone())
    } else {
        scene.changed(|sections| sections.estimate.method = method)
    }
}

/// The method for the `images` of one channel, and the reason.
///
/// A MAP estimate needs two images or more that differ by more than noise, and a scene that says
/// what changes them: an AO loop or turbulence.
fn method_for(scene: &Scene, images: &Electrons) -> (Method, String) {
    match image_changes(scene, images) {
        None => (Method::Modal, "there are fewer than two images with enough signal to compare".into()),
        Some(chi2) if chi2 < CHANGING => (
            Method::Modal,
            format!("the images do not change from one to the next (reduced χ² of their differences {chi2:.1})"),
        ),
        Some(chi2) if !scene.has_changing_wavefront() => (
            Method::Modal,
            format!(
                "the images change from one to the next (reduced χ² of their differences {chi2:.1}), but the scene has neither \
                 an AO loop nor turbulence"
            ),
        ),
        Some(chi2) => (
            Method::FullPhase,
            format!("the images change from one to the next (reduced χ² of their differences {chi2:.1})"),
        ),
    }
}

/// Lowers the cancel flag after a call that it has ended.
pub(super) fn acknowledged<T>(control: &Control, outcome: Result<T>) -> Result<T> {
    if let Err(Error::Interrupted(_)) = outcome {
        control.acknowledge();
    }
    outcome
}

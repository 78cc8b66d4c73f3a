//! Modal estimate: the images of each channel fitted by its own scene; the fits of several are
//! combined.

use super::consistency::Electrons;
use super::estimate::{Estimate, Figures, MethodResult, ModalSummary, Run, WithoutStaircases};
use super::explain::explain;
use super::modal::ExpectedErrors;
use super::modal_task::{Fitted, ModalTask};
use super::model_selection::{Extension, Selected};
use super::outcome::ImageOutcome;
use super::policy::Policy;
use super::remarks::{ON_DIVERSITY, common_orientation_remark, is_on_orientation};
use super::warnings::{contradiction_warning, integers_warning, left_out_warnings};
use crate::control::{Control, Stage};
use crate::modal::{FitSeries, JointEstimate, ModelCache, Status, WithLeftOut, joint};
use crate::scene::{Grouping, Optic, OpticalParameter, Scene, Sections};
use crate::statics::ErrorTerm;
use crate::statistics::median;
use crate::{Error, Result};
use ndarray::{Array1, Axis, concatenate};

/// The images of one channel, with the scene that they are read by.
pub(super) struct ChannelImages<'a> {
    /// Its name, where the scene lists its channels.
    pub(super) name: Option<&'a str>,
    pub(super) scene: Scene,
    pub(super) images: Electrons<'a>,
    /// What was built for its scene.
    pub(super) cache: ModelCache,
}

/// Names of `channels`; none where the scene does not list them.
pub(super) fn names(channels: &[&ChannelImages]) -> Vec<String> {
    channels.iter().filter_map(|channel| channel.name).map(str::to_owned).collect()
}

/// Result of a channel, whose error has its name.
pub(super) fn named<T>(name: Option<&str>, result: Result<T>) -> Result<T> {
    result.map_err(|error| name.into_iter().fold(error, Error::of_channel))
}

/// How often channels that contradict each other, or do not explain their images, are fitted again.
const ROUNDS: usize = 6;
/// How often without a better minimum, where what the modes leave out explains both: it explains
/// wrong whole wavelengths, too, which channels of several wavelengths may have.
const VAIN_ROUNDS: [usize; 2] = [1, 3];

/// Estimates the static wavefront behind the images of all `channels` of `scene`. The `series` are
/// of the channels with diversity, in order: fits that they have are taken.
///
/// # Errors
/// Those of the fits of each channel; [`Error::Scene`] for an estimate that channels do not have;
/// [`Error::Interrupted`].
pub(super) fn estimate(
    scene: &Scene,
    policy: &Policy,
    control: &Control,
    channels: &[ChannelImages],
    series: Option<&mut [FitSeries]>,
) -> Result<Estimate> {
    let all: Vec<&ChannelImages> = channels.iter().collect();
    let own = Channels::new(scene, policy, control, &all)?;
    if let [ChannelImages { name: None, .. }] = channels {
        return own.only(series);
    }
    let begun = own.fit(series)?;
    own.estimate(begun)
}

/// The channels of a scene, and how they are fitted.
pub(super) struct Channels<'a> {
    scene: &'a Scene,
    channels: &'a [&'a ChannelImages<'a>],
    /// Scene and Karhunen-Loève basis by which each is fitted.
    scenes: Vec<(Scene, ModelCache)>,
    policy: Policy,
    control: &'a Control,
}

impl<'a> Channels<'a> {
    /// # Errors
    /// Those of a scene.
    pub(super) fn new(
        scene: &'a Scene,
        policy: &Policy,
        control: &'a Control,
        channels: &'a [&'a ChannelImages<'a>],
    ) -> Result<Self> {
        let scenes = channels.iter().map(|channel| {
            let own = match channel.name {
                Some(_) => own_scene(&channel.scene)?,
                None => channel.scene.clone(),
            };
            Ok((own, channel.cache.clone()))
        });
        Ok(Self { scene, channels, scenes: scenes.collect::<Result<_>>()?, policy: *policy, control })
    }

    /// These channels by scenes with `extensions`, which no channel extends further.
    fn extended(&self, extensions: &[Extension]) -> Result<Self> {
        let add = |sections: &mut Sections| extensions.iter().for_each(|extension| extension.add_to(sections));
        let scenes = self.scenes.iter().map(|(own, cache)| {
            let extended = own.changed(add)?;
            let cache = cache.for_scene(own, &extended);
            Ok((extended, cache))
        });
        let policy = Policy { select_model: false, ..self.policy };
        Ok(Self { scenes: scenes.collect::<Result<_>>()?, policy, ..*self })
    }

    /// The fits of the channel `channel`.
    pub(super) fn task(&self, channel: usize) -> ModalTask<'_> {
        let (scene, cache) = &self.scenes[channel];
        let images = &self.channels[channel].images;
        ModalTask { scene, policy: &self.policy, control: self.control, cache, images }
    }

    /// Result of the channel `channel`, whose error has its name.
    pub(super) fn named<T>(&self, channel: usize, result: Result<T>) -> Result<T> {
        named(self.channels[channel].name, result)
    }

    /// The estimate of the only channel.
    fn only(&self, series: Option<&mut [FitSeries]>) -> Result<Estimate> {
        let task = self.task(0);
        let mut fitted = task.fit(series.and_then(|series| series.first_mut()))?;
        explain(&task, &mut fitted)?;
        let mut estimate = fitted.into_estimate(task.policy)?;
        for parameter in &mut estimate.optics {
            // An extension of the model has a value of its own, from which its fit began.
            let own = task.scene.setting(&parameter.key).and_then(|setting| setting.value().number());
            parameter.scene = own.unwrap_or(parameter.scene);
            parameter.take_form_of(task.scene);
        }
        Ok(estimate)
    }

    /// The estimate from the fits of several channels.
    pub(super) fn estimate(&self, begun: (Vec<Fitted>, JointEstimate)) -> Result<Estimate> {
        let (mut fits, found) = self.with_extensions(begun)?;
        if found.left_out.is_some() {
            fits.iter_mut().for_each(|fitted| fitted.fit.1.forget_left_out());
        }
        let each = fits.into_iter().map(|fitted| fitted.into_estimate(&self.policy)).collect::<Result<Vec<_>>>()?;
        let scatter = each.iter().any(|one| one.is_sequence).then_some("images");
        combined(self.scene, found, names(self.channels), (each, scatter))
    }

    /// The fits of each channel; all by the same modes, which are those of a scene that was
    /// extended where one channel asks for it.
    fn with_extensions(&self, begun: (Vec<Fitted>, JointEstimate)) -> Result<(Vec<Fitted>, JointEstimate)> {
        let (mut fits, joint) = begun;
        let Some((chosen, selected)) = self.explain(&mut fits)? else { return Ok((fits, joint)) };
        let extended = self.extended(&selected.extensions)?;
        let (mut fits, joint) = extended.fit(None)?;
        extended.explain(&mut fits)?;
        fits[chosen].selected = Some(selected);
        Ok((fits, joint))
    }

    /// Looks for the causes of residuals, until one channel has a larger model that explains it:
    /// its number, and that model.
    fn explain(&self, fits: &mut [Fitted]) -> Result<Option<(usize, Selected)>> {
        for (channel, fitted) in fits.iter_mut().enumerate() {
            self.named(channel, explain(&self.task(channel), fitted))?;
            if let Some(selected) = fitted.selected.take() {
                return Ok(Some((channel, selected)));
            }
        }
        Ok(None)
    }

    /// Fits each channel, and again from the results of the others while they contradict each other
    /// or do not explain their images.
    pub(super) fn fit(&self, mut series: Option<&mut [FitSeries]>) -> Result<(Vec<Fitted>, JointEstimate)> {
        let each = (0..self.channels.len()).map(|channel| {
            let series = series.as_deref_mut().and_then(|series| series.get_mut(channel));
            self.named(channel, self.task(channel).fit(series))
        });
        let mut fits = each.collect::<Result<Vec<_>>>()?;
        let mut joint = self.combine(&fits)?;
        let wavelengths_nm = || self.channels.iter().map(|channel| channel.scene.image.wavelength_nm);
        let has_one = wavelengths_nm().all(|nm| Some(nm) == wavelengths_nm().next());
        let mut vain = 0;
        for round in (1..=ROUNDS).filter(|_| self.policy.restart) {
            let is_explained = |fitted: &Fitted| *fitted.fit.1.status_by_modes() == Status::Ok;
            if !joint.is_contradictory_by_modes() && fits.iter().all(is_explained) {
                break;
            }
            if self.improve(&mut fits, &joint, round)? {
                joint = self.combine(&fits)?;
                continue;
            }
            vain += 1;
            if !joint.is_contradictory() && vain >= VAIN_ROUNDS[usize::from(!has_one)] {
                // An error that all minima have.
                break;
            }
        }
        Ok((fits, joint))
    }

    fn combine(&self, fits: &[Fitted]) -> Result<JointEstimate> {
        self.control.enter(Stage::Combining, 0);
        let each: Vec<_> = fits.iter().map(|Fitted { fit: (fitter, found), .. }| (fitter, found)).collect();
        joint(self.scene, &each, &names(self.channels))
    }

    /// Fits each channel from the joint result, from that of each other channel and from a
    /// perturbed start; whether a better minimum was found.
    fn improve(&self, fits: &mut [Fitted], joint: &JointEstimate, round: usize) -> Result<bool> {
        let mut is_better = false;
        for (channel, fitted) in fits.iter_mut().enumerate() {
            let (fitter, found) = &fitted.fit;
            let attempt = fitter.recipe().restarts + round;
            let perturbed_nm = fitter.perturbed_start(&found.combined.modes.coefficients_nm, attempt);
            let others_nm = joint.channels_nm.iter().enumerate().filter(|(other, _)| *other != channel);
            let starts_nm = others_nm.map(|(_, nm)| nm).chain([&joint.modes.coefficients_nm, &perturbed_nm]);
            for start_nm in starts_nm {
                is_better |= self.named(channel, self.task(channel).improve(fitted, start_nm))?;
            }
        }
        Ok(is_better)
    }
}

/// The scene by which one channel is fitted: without the amplitude of its diversity, which only all
/// channels together determine, and alone.
fn own_scene(scene: &Scene) -> Result<Scene> {
    scene.changed(|sections| {
        sections.estimate.fit_optics.retain(|optic| ![Optic::DEFOCUS, Optic::DIVERSITY].contains(optic));
        sections.estimate.group = Grouping::Each;
    })
}

/// The estimate of all channels, from the joint one and those of each channel; its error bars are
/// from the `scatter` between these, or from the noise.
pub(super) fn combined(
    scene: &Scene,
    found: JointEstimate,
    names: Vec<String>,
    (each, scatter): (Vec<Estimate>, Option<&str>),
) -> Result<Estimate> {
    let fits: Vec<&ModalSummary> = each.iter().filter_map(Estimate::modal).collect();
    let ([own, ..], [first, ..]) = (&fits[..], &each[..]) else {
        return Err(Error::Internal("there is no modal estimate of a channel".into()));
    };
    let errors = ExpectedErrors::new(own.fitter.model(), found.left_out.as_ref())?;
    let views: Vec<_> = fits.iter().map(|one| one.image_coefficients_nm.view()).collect();
    let method = MethodResult::Modal(ModalSummary {
        combine: own.combine,
        image_coefficients_nm: concatenate(Axis(0), &views).map_err(|error| Error::Internal(error.to_string()))?,
        compared: fits.iter().flat_map(|one| one.compared.iter().cloned()).collect(),
        degeneracy: own.degeneracy.clone(),
        fitter: own.fitter.clone(),
    });
    let of_channel = |(channel, one): (usize, &Estimate)| -> Vec<ImageOutcome> {
        one.images.iter().map(|image| ImageOutcome { channel, ..image.clone() }).collect()
    };
    let images: Vec<ImageOutcome> = each.iter().enumerate().flat_map(of_channel).collect();
    let used = images.iter().filter(|image| image.is_used);
    let sum = |value: fn(&Run) -> f64| each.iter().map(|one| value(&one.run)).sum::<f64>();
    let name = scatter.map_or_else(|| "noise".to_owned(), |of| format!("scatter between {of}"));
    let is_unknown = scene.tolerance.defocus_fraction > 0.0 || found.defocus.is_some();
    let name = format!("{name}{}", if is_unknown { ", amplitude of the diversities" } else { "" });
    let [phasing_nm, ncpa_nm, _] = errors.rms_nm(&found.modes.covariance_nm2)?;
    let mut error_budget = vec![ErrorTerm { name, phasing_nm, ncpa_nm }];
    if let Some(left_out) = &found.left_out {
        let own = errors.take_left_out(&mut error_budget[0], left_out)?;
        error_budget.push(own);
    }
    let left_out = found.left_out.as_ref();
    let sigma_nm = errors.of_maps_nm(&found.modes.covariance_nm2, left_out)?;
    let figures = Figures::new(&first.pupil, &found.maps, sigma_nm)?;
    let without_staircases = WithoutStaircases::of((&errors, own.fitter.model()), left_out, &figures)?;
    let of_staircases = without_staircases.as_ref().map(|without| without.remark(&figures));
    let contradiction = found.is_contradictory().then_some(&Status::Contradictory);
    Ok(Estimate {
        // The scene as given, with its channels.
        scene: scene.clone(),
        policy: first.policy,
        basis: first.basis.clone(),
        figures,
        without_staircases,
        pupil: first.pupil.clone(),
        error_budget,
        model_errors: of_step(&found, &each).map(|left_out| left_out.errors.clone()).unwrap_or_default(),
        reduced_chi2: median(&used.map(|image| image.report.reduced_chi2).collect::<Vec<_>>()),
        images,
        status: *Status::worst(each.iter().map(|one| &one.status).chain(contradiction)),
        is_sequence: scatter.is_some(),
        model: first.model.clone(),
        optics: optics(&found, &names, &each),
        warnings: warnings(&found, &names, &each),
        remarks: of_staircases.into_iter().chain(remarks(&found, &errors, &each)?).collect(),
        run: Run { seconds: sum(|run| run.seconds), model_seconds: sum(|run| run.model_seconds), ..first.run.clone() },
        channels: names,
        modes: found.modes,
        maps: found.maps,
        sigma_maps: found.sigma_maps,
        integers: found.integers,
        truth: None,
        method,
    })
}

/// What the step found; `None` where a fit ended far from its minimum, from where a linear step has
/// no meaning.
fn of_step<'a>(found: &'a JointEstimate, each: &[Estimate]) -> Option<&'a WithLeftOut> {
    let mut used = each.iter().flat_map(|one| &one.images).filter(|image| image.is_used);
    found.left_out.as_ref().filter(|_| used.all(|image| image.report.status.is_near_minimum()))
}

fn warnings(found: &JointEstimate, names: &[String], each: &[Estimate]) -> Vec<String> {
    let mut sentences: Vec<String> = Vec::new();
    for (number, one) in each.iter().enumerate() {
        let about = names.get(number).map(|name| format!("channel {name}: ")).unwrap_or_default();
        sentences.extend(one.warnings.iter().map(|sentence| format!("{about}{sentence}")));
    }
    if let Some(defocus) = found.defocus.as_ref().filter(|defocus| !defocus.is_identifiable()) {
        sentences.push(format!(
            "estimate.fit_optics names \"{}\", and these channels do not determine the amplitude of the diversities: it stays as the \
             scene says, and the error bars do not include its error; two channels with different diversities determine it",
            defocus.optic.word()
        ));
    }
    sentences.extend(of_step(found, each).map(left_out_warnings).unwrap_or_default());
    sentences.extend(integers_warning(&found.integers));
    sentences.extend(found.is_contradictory().then(|| contradiction_warning(found.disagreement)));
    sentences
}

/// Remarks of the channels, each once; those on the diversity and the orientation are of all
/// channels together.
fn remarks(found: &JointEstimate, errors: &ExpectedErrors, each: &[Estimate]) -> Result<Vec<String>> {
    let mut sentences: Vec<String> = of_step(found, each).map(super::remarks::left_out_remarks).unwrap_or_default();
    for sentence in each.iter().flat_map(|one| &one.remarks) {
        let is_of_all = sentence.starts_with(ON_DIVERSITY) || is_on_orientation(sentence);
        if !is_of_all && !sentences.contains(sentence) {
            sentences.push(sentence.clone());
        }
    }
    let on_orientation = |one: &Estimate| one.remarks.iter().find(|remark| is_on_orientation(remark)).cloned();
    let orientations: Vec<Option<String>> = each.iter().map(on_orientation).collect();
    sentences.extend(common_orientation_remark(&orientations.iter().map(Option::as_deref).collect::<Vec<_>>()));
    if let Some(effect_nm) = &found.diversity_effect_nm {
        let column: Array1<f64> = effect_nm * 0.01;
        let column = column.insert_axis(Axis(1));
        let nm = errors.rms_nm(&column.dot(&column.t()))?[1];
        sentences.push(format!(
            "{ON_DIVERSITY} An error of 1 % of all of them changes the NCPA by {nm:.2} nm (estimate.fit_optics = [\"defocus\"] fits their \
             amplitude where the channels determine it)."
        ));
    }
    Ok(sentences)
}

/// Optical parameters of each channel, and the amplitude of the diversities.
fn optics(found: &JointEstimate, names: &[String], each: &[Estimate]) -> Vec<OpticalParameter> {
    let of_channels = names.iter().zip(each).flat_map(|(name, one)| {
        let named = move |optic: &OpticalParameter| OpticalParameter {
            key: format!("{} (channel {name})", optic.key),
            ..optic.clone()
        };
        one.optics.iter().map(named)
    });
    of_channels.chain(found.defocus.clone()).collect()
}

//! Estimate from images of one wavefront that are fitted together: those of channels in focus or
//! with a small defocus, or of all channels where the scene says so.

use super::channels::{ChannelImages, Channels, combined, names};
use super::estimate::Estimate;
use super::grouping::{How, Together, fitted_images};
use super::images::counted;
use super::modal_task::Fitted;
use super::outcome::ImageOutcome;
use super::policy::Policy;
use super::warnings::{agreement_sentence, group_warnings, named};
use crate::Result;
use crate::control::{Control, Stage};
use crate::modal::{
    self, GroupChannel, GroupEstimate, GroupSequence, GroupSeries, JointEstimate, Minima, ModalFitter, Search,
    Sequence, Status, are_determined,
};
use crate::scene::{Combine, Grouping, Scene};
use crate::statistics::median;
use std::time::Instant;

/// Estimates the wavefront of all images of `channels` together.
///
/// # Errors
/// Those of [`modal::estimate_group`].
pub(super) fn estimate(
    scene: &Scene,
    policy: &Policy,
    control: &Control,
    channels: &[ChannelImages],
    together: &Together,
    parts: Option<&mut GroupSeries>,
) -> Result<Estimate> {
    let (started, which) = (Instant::now(), fitted_images(scene, channels)?);
    control.enter(Stage::Preparing, 0);
    let strong = strong(channels, together);
    let alone = Channels::new(scene, policy, control, &strong)?;
    let near = near_known(&alone, (channels, together))?;
    let task = GroupTask::new((scene, policy, control), (channels, together), near.as_ref(), started)?;
    if together.how == How::Groups {
        let mut none = GroupSeries::default();
        let series = parts.unwrap_or(&mut none);
        return task.estimate(task.fit_groups(near.as_ref().map(|(_, near)| near), together.search(), series)?);
    }
    if together.how == How::All {
        let near = near.filter(|(_, near)| !near.is_contradictory());
        let found = task.fit(&which, near.as_ref().map(|(_, near)| near), together.search())?;
        return task.estimate(task.without_foreign(&found)?.unwrap_or(found));
    }
    let near = match near {
        Some(near) => near,
        None => {
            let mut found = task.fit(&which, None, Search::First)?;
            let mut is_right = !found.group.minima.is_suspicious;
            if !is_right && task.marginalise && found.group.is_explained {
                // χ² that the step leaves of an error may be that of another minimum: other starts
                // show which.
                found = task.fit(&which, None, Search::IfNeeded)?;
                is_right = found.group.minima.in_best > 1;
            }
            if found.group.is_explained && is_right {
                return task.estimate(found);
            }
            alone.fit(None)?
        }
    };
    // What the modes leave out may explain why they differ.
    if near.1.is_contradictory() && !task.marginalise {
        return alone.estimate(near);
    }
    let found = task.fit(&which, Some(&near.1), Search::First)?;
    match task.without_foreign(&found)? {
        Some(others) => task.estimate(others),
        None if found.group.is_explained => task.estimate(found),
        None => alone.estimate(near),
    }
}

/// Fits those groups of the images of `channels` that have the numbers `part`, and the first; fits
/// of `earlier` are taken.
///
/// # Errors
/// Those of [`Sequence::fit_part`].
pub(super) fn fit_part(
    (scene, policy, control): (&Scene, &Policy, &Control),
    channels: &[ChannelImages],
    together: &Together,
    part: &[usize],
    earlier: GroupSeries,
) -> Result<GroupSeries> {
    control.enter(Stage::Preparing, 0);
    let strong = strong(channels, together);
    let near = near_known(&Channels::new(scene, policy, control, &strong)?, (channels, together))?;
    let task = GroupTask::new((scene, policy, control), (channels, together), near.as_ref(), Instant::now())?;
    let members = task.members(&all_of(channels));
    task.sequence(&members, near.as_ref().map(|(_, near)| near), together.search()).fit_part(part, earlier)
}

/// The channels that determine the wavefront by themselves.
fn strong<'a>(channels: &'a [ChannelImages<'a>], together: &Together) -> Vec<&'a ChannelImages<'a>> {
    channels.iter().zip(&together.weak).filter(|(_, is_weak)| !**is_weak).map(|(channel, _)| channel).collect()
}

/// The fits of those channels `alone`, where a fit of all images needs to begin near them: where
/// some of the `channels` are weak, or the wavelengths determine whole wavelengths.
fn near_known(
    alone: &Channels,
    (channels, together): (&[ChannelImages], &Together),
) -> Result<Option<(Vec<Fitted>, JointEstimate)>> {
    let wavelengths_nm: Vec<f64> = channels.iter().map(|channel| channel.scene.image.wavelength_nm).collect();
    let strong = together.weak.iter().filter(|is_weak| !**is_weak).count();
    let is_near_known = match strong {
        0 => false,
        all if all == channels.len() => are_determined(&wavelengths_nm),
        _ => together.how == How::All || are_determined(&wavelengths_nm),
    };
    is_near_known.then(|| alone.fit(None)).transpose()
}

/// Every image of each channel.
fn all_of(channels: &[ChannelImages]) -> Vec<Vec<bool>> {
    channels.iter().map(|channel| vec![true; channel.images.len()]).collect()
}

/// How much larger than the median the difference of an image of another wavefront is. An error of
/// the model makes all images differ alike, five real ones of a bench by up to 2.6 times their
/// median; one planted among four or five is 4.5 to 16 times beyond it.
const FOREIGN: f64 = 3.0;

/// An estimate of images that are fitted together.
struct GroupTask<'a> {
    scene: &'a Scene,
    policy: &'a Policy,
    control: &'a Control,
    channels: &'a [ChannelImages<'a>],
    /// Channel and number of the images of each group, where there are several.
    groups: &'a [Vec<[usize; 2]>],
    /// Scene and fitter of each channel.
    own: Vec<(Scene, ModalFitter)>,
    /// Whether what the modes leave out is marginalised.
    marginalise: bool,
    started: Instant,
    model_seconds: f64,
}

/// What a fit of a group finds.
struct GroupFit {
    group: GroupEstimate,
    /// Which images of each channel were fitted.
    which: Vec<Vec<bool>>,
    /// Channel and number of those that were left out because they are of another wavefront.
    foreign: Vec<[usize; 2]>,
}

impl<'a> GroupTask<'a> {
    /// The task of fitting the images of `channels`, of which those that determine the wavefront
    /// have the fits `near`.
    fn new(
        (scene, policy, control): (&'a Scene, &'a Policy, &'a Control),
        (channels, together): (&'a [ChannelImages<'a>], &'a Together),
        near: Option<&(Vec<Fitted>, JointEstimate)>,
        started: Instant,
    ) -> Result<Self> {
        let began = Instant::now();
        let mut known = near.iter().flat_map(|(fits, _)| fits).peekable();
        let own = channels.iter().zip(&together.weak).map(|(channel, is_weak)| {
            let own = channel.scene.changed(|sections| {
                sections.estimate.fit_optics.clear();
                sections.estimate.group = Grouping::Each;
                sections.estimate.fitted_images = None;
                sections.leave_out_posterior();
            })?;
            let fitter = match known.next_if(|_| !is_weak) {
                Some(fitted) => fitted.fit.0.clone(),
                None => modal::fitter_for(&own, policy.recipe(&own), &channel.cache, channel.images.cube())?,
            };
            control.check("the models were built in part, no image was fitted")?;
            Ok((own, fitter))
        });
        let own = own.collect::<Result<Vec<_>>>()?;
        let (marginalise, model_seconds) = (policy.recipe(scene).marginalise, began.elapsed().as_secs_f64());
        let groups = &together.groups;
        Ok(Self { scene, policy, control, channels, groups, own, marginalise, started, model_seconds })
    }

    /// Fits the images `which`, near a wavefront that some of them show.
    fn fit(&self, which: &[Vec<bool>], near: Option<&JointEstimate>, search: Search) -> Result<GroupFit> {
        let (members, near_nm) = (self.members(which), near.map(|near| near.modes.coefficients_nm.as_slice()));
        let group = modal::estimate_group(self.scene, members, (near_nm, search), self.marginalise, self.control)?;
        self.fitted(group, which, near)
    }

    /// Fits each group, the first near a wavefront; fits of `series` are taken.
    fn fit_groups(&self, near: Option<&JointEstimate>, search: Search, series: &mut GroupSeries) -> Result<GroupFit> {
        let which = all_of(self.channels);
        let group = self.sequence(&self.members(&which), near, search).estimate(series)?;
        self.fitted(group, &which, near)
    }

    /// The groups of all images of `channels`, the first near a wavefront.
    fn sequence<'b>(
        &'b self,
        channels: &'b [GroupChannel<'b>],
        near: Option<&'b JointEstimate>,
        search: Search,
    ) -> Sequence<'b> {
        let near_nm = near.map(|near| near.modes.coefficients_nm.as_slice());
        let &Self { scene, groups, marginalise, control, .. } = self;
        Sequence { scene, channels, groups, near_nm, search, marginalise, control }
    }

    /// The channels with their images `which`.
    fn members(&self, which: &[Vec<bool>]) -> Vec<GroupChannel<'_>> {
        let each = self.channels.iter().zip(&self.own).zip(which).map(|((channel, (_, fitter)), fitted)| {
            let name = channel.name.unwrap_or_default().to_owned();
            GroupChannel { name, fitter: fitter.clone(), cube: channel.images.cube(), fitted: fitted.clone() }
        });
        each.collect()
    }

    /// What was found of the images `which`, with the whole wavelengths of `near`.
    fn fitted(&self, mut group: GroupEstimate, which: &[Vec<bool>], near: Option<&JointEstimate>) -> Result<GroupFit> {
        group.joint.integers = near.map(|near| near.integers.clone()).unwrap_or_default();
        self.control.check("the images were fitted, nothing was written")?;
        Ok(GroupFit { group, which: which.to_vec(), foreign: Vec::new() })
    }

    /// The fit without the images of another wavefront than the others: fewer than a third of all,
    /// without which one wavefront explains the others; `None` where there are none such.
    fn without_foreign(&self, found: &GroupFit) -> Result<Option<GroupFit>> {
        if !found.group.joint.is_contradictory() || self.policy.recipe(self.scene).combine != Combine::ClippedMean {
            return Ok(None);
        }
        let most = found.group.differences.len().saturating_sub(1) / 3;
        let (mut left, mut foreign) = (None::<GroupFit>, Vec::new());
        for _ in 0..most {
            let last = left.as_ref().unwrap_or(found);
            let differences = &last.group.differences;
            let usual = median(&differences.iter().map(|(_, chi2)| *chi2).collect::<Vec<_>>());
            let Some((place, _)) = differences.first().filter(|(_, chi2)| *chi2 > FOREIGN * usual) else { break };
            let mut which = last.which.clone();
            which[place[0]][place[1]] = false;
            foreign.push(*place);
            let fit = self.fit(&which, Some(&last.group.joint), Search::IfNeeded)?;
            if !fit.group.joint.is_contradictory() {
                return Ok(Some(GroupFit { foreign, ..fit }));
            }
            left = Some(fit);
        }
        Ok(None)
    }

    /// The estimate from a fit.
    fn estimate(&self, found: GroupFit) -> Result<Estimate> {
        let GroupFit { group, which, foreign } = found;
        let GroupEstimate { joint, channels: fits, minima, differences, sequence, .. } = group;
        let (mut each, mut used, mut refused, mut compared) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let group_of = |place: [usize; 2]| self.groups.iter().position(|group| group.contains(&place)).unwrap_or(0);
        let is_used = |[channel, image]: [usize; 2]| {
            which[channel][image]
                && sequence.as_ref().is_none_or(|sequence| sequence.used.contains(&group_of([channel, image])))
        };
        for (number, (fit, fitted)) in fits.into_iter().zip(&which).enumerate() {
            let (channel, (own, _)) = (&self.channels[number], &self.own[number]);
            let fit = match fit {
                Ok(fit) => fit,
                Err(reason) => {
                    let of = channel.name.map(|name| format!("channel {name}: ")).unwrap_or_default();
                    refused.push(format!("{of}no image can be used: {reason}"));
                    continue;
                }
            };
            let scene = own.adopting(fit.0.scene())?;
            let model_seconds = if each.is_empty() { self.model_seconds } else { 0.0 };
            let (fitter, mut own_fit) = fit;
            if (0..fitted.len()).any(|place| !is_used([number, place])) {
                // That of its images has those that are left out.
                own_fit.mean_residual_chi2 = 1.0;
            }
            let fit = (fitter, own_fit);
            let fit = Fitted { fit, scene, selected: None, cause: None, changes: None, model_seconds };
            let mut own = fit.into_estimate(self.policy)?;
            if let Some(sequence) = &sequence {
                for (place, image) in own.images.iter_mut().enumerate() {
                    of_sequence(image, group_of([number, place]), sequence);
                }
            }
            let outcomes = own.images.iter_mut().zip(fitted).enumerate();
            for (place, (image, _)) in outcomes.filter(|(_, (_, is_fitted))| !**is_fitted) {
                (image.is_used, image.is_clipped) = (false, false);
                if foreign.contains(&[number, place]) {
                    image.is_clipped = true;
                    image.message = "of another wavefront than the others".into();
                } else if image.report.reduced_chi2.is_finite() {
                    compared.push(image.report.reduced_chi2);
                    let reason = if image.message.is_empty() { String::new() } else { format!("; {}", image.message) };
                    image.message = format!("compared with the wavefront of other images{reason}");
                }
            }
            each.push(own);
            used.push(channel);
        }
        let is_contradictory =
            joint.is_contradictory() || sequence.as_ref().is_some_and(|sequence| sequence.agreement.is_contradictory());
        let most_different = differences.first().filter(|_| is_contradictory);
        let has_scatter = sequence.as_ref().is_some_and(|sequence| sequence.has_scatter);
        let mut estimate = combined(self.scene, joint, names(&used), (each, has_scatter.then_some("groups")))?;
        estimate.run.seconds = self.started.elapsed().as_secs_f64() - self.model_seconds;
        estimate.warnings.splice(0..0, refused);
        if let Some((place, chi2)) = most_different {
            estimate.warnings.push(format!(
                "{} differs most from the wavefront of all: the reduced χ² of its difference is {chi2:.1}",
                self.named(*place)
            ));
        }
        if !foreign.is_empty() {
            let named: Vec<String> = foreign.iter().map(|place| self.named(*place)).collect();
            let (are, were) = if named.len() == 1 { ("is", "was") } else { ("are", "were") };
            estimate.warnings.push(format!(
                "{} {are} of another wavefront than the others, which agree with each other, and {were} left out",
                named.join(", ")
            ));
        }
        // Of an image that is left out its warning has everything.
        let is_kept = |image: &&ImageOutcome| if sequence.is_some() { image.is_used } else { !image.is_clipped };
        let kept: Vec<_> = estimate.images.iter().filter(is_kept).collect();
        let contradiction = is_contradictory.then_some(&Status::Contradictory);
        estimate.status = *Status::worst(kept.iter().map(|image| &image.report.status).chain(contradiction));
        estimate.warnings.splice(0..0, group_warnings(&kept));
        estimate.warnings.extend(warnings(&minima));
        let Some(sequence) = sequence else {
            estimate.remarks.insert(0, remark(&estimate, &compared, &minima));
            return Ok(estimate);
        };
        let is_left_out = |group: usize| !sequence.used.contains(&group);
        estimate.warnings.extend(agreement_sentence(&sequence.agreement, ("group", self.groups.len()), is_left_out));
        let unusable: Vec<usize> = (0..self.groups.len()).filter(|group| !sequence.fitted.contains(group)).collect();
        if !unusable.is_empty() {
            let named = named(&unusable, ("group", self.groups.len()));
            let reason = estimate.images.iter().find(|image| matches!(image.report.status, Status::Unusable(_)));
            let reason = reason.map(|image| format!(" ({})", image.message)).unwrap_or_default();
            estimate.warnings.push(format!("{named} cannot be used: of a group all images are needed{reason}"));
        }
        estimate.remarks.insert(
            0,
            format!(
                "{} of {} fitted, each by itself, and the estimate is the mean of {}.",
                counted(sequence.fitted.len(), "group"),
                were(self.groups[0].len(), "image"),
                sequence.used.len()
            ),
        );
        Ok(estimate)
    }

    /// The image of a channel, for a sentence.
    fn named(&self, [channel, image]: [usize; 2]) -> String {
        let of = self.channels[channel].name.map(|name| format!("channel {name}: ")).unwrap_or_default();
        of + &named(&[image], ("image", self.channels[channel].images.len()))
    }
}

/// Says of `image` of a group of `sequence` what became of the group.
fn of_sequence(image: &mut ImageOutcome, group: usize, sequence: &GroupSequence) {
    image.is_used = sequence.used.contains(&group);
    image.is_clipped = !image.is_used && sequence.fitted.contains(&group);
    if image.is_clipped {
        image.message = "of a group of another wavefront than the others".into();
    } else if !image.is_used && image.message.is_empty() {
        image.message = "another image of its group cannot be used".into();
    }
}

/// Warnings on the minima of a fit.
fn warnings(minima: &Minima) -> Vec<String> {
    let mut sentences = Vec::new();
    if minima.has_twin {
        sentences.push(
            "the turned wavefront −W(−x, −y) explains these images as well: their diversities are all even, or all odd; one more image, with a \
             diversity that is neither, decides"
                .to_owned(),
        );
    }
    // One start is near the minima of the single images.
    if minima.is_suspicious && minima.in_best < 2 && minima.starts > 1 {
        sentences.push(format!(
            "only one of {} starts of the fit ended in this minimum, and χ² is larger than noise explains: it may be a wrong one",
            minima.starts
        ));
    }
    sentences
}

/// So many, as the subject of a sentence.
fn were(count: usize, noun: &str) -> String {
    format!("{} {}", counted(count, noun), if count == 1 { "was" } else { "were" })
}

/// What a user should know of the fit, and of the images that were compared with it.
fn remark(estimate: &Estimate, compared_chi2: &[f64], minima: &Minima) -> String {
    let images = estimate.images.iter().filter(|image| image.is_used).count();
    if minima.starts == 1 && compared_chi2.is_empty() {
        return format!("{} fitted together.", were(images, "image"));
    }
    let next = match minima.next {
        Some(next) => format!("the next minimum is at Δχ² = {next:.0}"),
        None => "no other minimum was found".into(),
    };
    let compared = match compared_chi2.iter().copied().reduce(f64::max) {
        None => String::new(),
        Some(most) => format!(
            " {} predicted from their wavefront with a reduced χ² of {:.2} in the median and {most:.2} at most.",
            if compared_chi2.len() == 1 { "1 other is".into() } else { format!("{} others are", compared_chi2.len()) },
            median(compared_chi2)
        ),
    };
    format!(
        "{} fitted together; {} of {} starts ended in this minimum, and {next}.{compared}",
        were(images, "image"),
        minima.in_best,
        minima.starts
    )
}

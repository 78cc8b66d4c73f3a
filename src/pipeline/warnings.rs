//! Warnings on an estimate: one sentence each, which a user should read before using it.

use super::explain::is_mean_misfit;
use super::image_changes::CHANGING;
use super::images::{counted, in_ranges};
use super::outcome::ImageOutcome;
use super::sequence::SequenceResult;
use crate::modal::{
    self, Agreement, DiversityProjection, ImageReport, Model, ModelError, PistonInteger, RejectedPixels, Session,
    SharedFigure, Status, Verdict, WithLeftOut,
};
use crate::modes::Direction;
use crate::scene::{AoKnowledge, Optic};
use crate::statics::{ErrorSource, Iteration};

/// What a χ² that is too small means.
pub(super) const TOO_SMALL: &str = "the noise is smaller than the stated photon and read noise: is the image in electrons \
    (image.gain_e_per_adu), was it smoothed, averaged or normalised, or is the read noise too large (of images that were reduced without \
    a dark it is an upper limit)? The error bars are those of \
    the stated noise";

/// Background from which it may be a bias of the camera, electrons: that of a photon noise as of a
/// usual read noise.
const LEAST_BIAS_E: f64 = 100.0;

/// Probability from which the whole wavelengths of a piston are not flagged.
const CERTAIN: f64 = 0.99;

/// Warning on whole wavelengths of pistons that are not certain.
pub(super) fn integers_warning(integers: &[PistonInteger]) -> Option<String> {
    let doubtful: Vec<usize> = (0..integers.len()).filter(|&k| integers[k].probability < CERTAIN).collect();
    let first = doubtful.first()?;
    let least = integers.iter().map(|integer| integer.probability).fold(1.0, f64::min);
    Some(format!(
        "the whole wavelengths of {} are not certain (the least probable has {least:.2}; the first is segment {first}): see \
         PROBABILITY and RUNNER_UP_NM in the table SEGMENTS; more light, or a smaller modes.piston_range_nm, determines them",
        counted(doubtful.len(), "segment")
    ))
}

/// Images named one by one in a warning; the others are counted.
const NAMED_IMAGES: usize = 3;
/// Modes named one by one in a warning; the others are counted.
const NAMED_MODES: usize = 6;
/// Combinations of modes named one by one in a warning; the others are counted.
const NAMED_COMBINATIONS: usize = 3;

/// Warnings on images of one wavefront that were fitted together.
pub(super) fn group_warnings(images: &[&ImageOutcome]) -> Vec<String> {
    let mut sentences = Vec::new();
    let of = |word: &str| images.iter().filter(|image| image.report.status.word() == word).collect::<Vec<_>>();
    let misfits: Vec<f64> =
        ["misfit", "wrong-minimum"].iter().flat_map(|word| of(word)).map(|image| image.report.reduced_chi2).collect();
    if let Some(most) = misfits.iter().copied().reduce(f64::max) {
        let least = misfits.iter().copied().fold(f64::INFINITY, f64::min);
        sentences.push(format!(
            "{} of {} are not explained within their noise (reduced χ² {least:.2} to {most:.2}): the modes do not span the wavefront, the scene \
             differs from the instrument (plate scale, pixels, gain or read noise, the shapes of the mirror), or the images are of different \
             wavefronts; error bars are scaled up by the root of χ² of all",
            misfits.len(),
            counted(images.len(), "image")
        ));
    }
    for word in ["unusable", "not-converged"] {
        let concerned = of(word);
        sentences.extend(concerned.iter().take(NAMED_IMAGES).map(|image| image.message.clone()));
        if concerned.len() > NAMED_IMAGES {
            let more = counted(concerned.len() - NAMED_IMAGES, "more image");
            sentences.push(format!("the same holds for {more} ({word}); see table IMAGES of the output"));
        }
    }
    sentences
}

/// Warnings of a modal estimate.
pub(super) fn modal_warnings(
    fitter: &modal::ModalFitter,
    diversity: &DiversityProjection,
    found: &modal::ModalEstimate,
    changes: Option<f64>,
) -> Vec<String> {
    let model = fitter.model();
    let mut sentences: Vec<String> = found.device_failure.iter().cloned().collect();
    // Images in focus by themselves: the images of other channels determine what they do not.
    let alone = !found.is_of_group();
    sentences.extend(diversity.warning(fitter.scene().image.wavelength_nm).filter(|_| alone));
    let is_in_error_bars = |optic: Optic| {
        [Optic::DEFOCUS, Optic::DIVERSITY].contains(&optic) && fitter.scene().tolerance.defocus_fraction > 0.0
    };
    for optic in fitter.fitted_optics().iter().filter(|optic| !optic.is_identifiable()) {
        sentences.push(format!(
            "estimate.fit_optics names \"{}\", which these images do not distinguish from the modes: {} stays {}, and the \
             error bars {}",
            optic.optic.word(),
            optic.key,
            optic.value,
            if is_in_error_bars(optic.optic) { "hold the tolerance of it" } else { "do not include its error" }
        ));
    }
    // On the images of a group there is one of all.
    if alone {
        sentences.extend(image_warnings(found, changes));
        sentences.extend(agreement_warning(found));
    }
    sentences.extend(mean_residual_warning(found));
    sentences.extend(meaningful_left_out(found, changes).map(left_out_warnings).unwrap_or_default());
    sentences.extend(model_warning(model));
    let is_known = |direction: &Direction| fitter.is_global_motion(direction) || fitter.is_of_dark_segments(direction);
    let unknown = found.degeneracy.null.iter().filter(|direction| alone && !is_known(direction));
    sentences.extend(unknown_warning(&unknown.map(|direction| direction.description.as_str()).collect::<Vec<_>>()));
    sentences
}

/// What the modes of an estimate leave out, where the step that finds it has a meaning: near a
/// minimum, of images that do not change by this reduced χ² as behind adaptive optics.
pub(super) fn meaningful_left_out(found: &modal::ModalEstimate, changes: Option<f64>) -> Option<&WithLeftOut> {
    let is_static = changes.is_none_or(|chi2| chi2 < CHANGING);
    let mut of_used = found.combined.used_images.iter().map(|&image| &found.images[image].status);
    found.left_out().filter(|_| is_static && of_used.all(Status::is_near_minimum))
}

/// Warnings on errors of the optics and the camera beyond their tolerances that the images show,
/// and on a figure of the segments that may be a surface of the whole mirror.
pub(super) fn left_out_warnings(left_out: &WithLeftOut) -> Vec<String> {
    let sentence = |error: &ModelError| {
        format!(
            "these images show an error that the scene does not have: {error}: correct it in the scene, or in the reduction"
        )
    };
    let shared = left_out.shared_figure.map(|SharedFigure { rms_nm, surface_nm }| {
        format!(
            "these images show that all segments share a figure (focus or astigmatism) of {rms_nm:.2} nm RMS, or else that their pistons, \
             tips and tilts follow a smooth surface of {surface_nm:.0} nm, with as much of the opposite sign in the NCPA: the wavefront is \
             the same. The maps are those of the figure"
        )
    });
    left_out.shown_errors(true).map(sentence).chain(shared).collect()
}

/// Warning on combinations of modes that the images do not show.
fn unknown_warning(combinations: &[&str]) -> Option<String> {
    let which = match combinations {
        [] => return None,
        [one] => format!("this combination of modes, and 0 is reported for it: {one}"),
        several => {
            let count = several.len();
            let named = several[..count.min(NAMED_COMBINATIONS)].join("; ");
            let more = count.saturating_sub(NAMED_COMBINATIONS);
            let more = if more > 0 { format!("; and {more} more (--verbose lists them)") } else { String::new() };
            format!("{count} combinations of modes, and 0 is reported for them: {named}{more}")
        }
    };
    Some(format!("the images do not depend on {which}"))
}

/// Warning on modes of the scene that are not estimated.
fn model_warning(model: &Model) -> Option<String> {
    (!model.dropped.is_empty()).then(|| {
        let dropped = counted(model.dropped.len(), "mode");
        format!("{dropped} left out, because the others span them: {}", listed(&model.dropped))
    })
}

/// Warning on channels that contradict each other, from the reduced χ² of their differences and its
/// degrees of freedom.
pub(super) fn contradiction_warning((chi2, freedom): (f64, f64)) -> String {
    format!(
        "the channels contradict each other: the reduced χ² of their differences is {chi2:.1} ({freedom:.0} degrees of freedom), where \
         noise gives 1; is one of them flipped, of another wavelength or diversity than the scene says, or of another wavefront? The \
         error bars are scaled by the root of it"
    )
}

impl Session {
    /// Warnings on its devices and its models, and on groups of the last fit whose channels
    /// contradict each other: sentences that a user should read before using its results. Those on
    /// single images are in their reports.
    pub fn warnings(&self) -> Vec<String> {
        let (count, is_joint) = (self.results().len(), self.channels().len() > 1);
        let mut sentences = Vec::new();
        for channel in self.channels() {
            let about = if is_joint { format!("channel {}: ", channel.name()) } else { String::new() };
            let device = channel.device_failure().map(str::to_owned);
            let own = device.into_iter().chain(model_warning(channel.fitter().model()));
            sentences.extend(own.map(|sentence| format!("{about}{sentence}")));
        }
        for (group, result) in self.results().iter().enumerate().filter(|(_, result)| result.is_contradictory) {
            let about = if count > 1 { format!("group {} of {count}: ", group + 1) } else { String::new() };
            sentences.push(about + &contradiction_warning(result.disagreement));
        }
        sentences
    }
}

/// Warnings on single images, the worst kind first, and on a sequence as a whole.
fn image_warnings(found: &modal::ModalEstimate, changes: Option<f64>) -> Vec<String> {
    let changing = changing_warning(found, changes);
    let explains_all = changing.is_some();
    let whole = sequence_warning(found);
    let mut sentences: Vec<String> = changing.into_iter().collect();
    let count = found.images.len();
    for word in ["unusable", "not-converged", "wrong-minimum", "misfit"] {
        if explains_all && ["wrong-minimum", "misfit"].contains(&word) {
            continue;
        }
        if word == "misfit"
            && let Some(sentence) = &whole
        {
            sentences.push(sentence.clone());
            continue;
        }
        let concerned: Vec<(usize, &ImageReport)> =
            found.images.iter().enumerate().filter(|(_, image)| image.status.word() == word).collect();
        for (index, image) in concerned.iter().take(NAMED_IMAGES) {
            let which = if count > 1 { format!("image {} of {count}: ", index + 1) } else { String::new() };
            let sentence = image_warning(image, found.combined.used_images.contains(index));
            sentences.extend(sentence.map(|sentence| which + &sentence));
        }
        if concerned.len() > NAMED_IMAGES {
            let more = counted(concerned.len() - NAMED_IMAGES, "more image");
            sentences.push(format!("the same holds for {more} ({word}); see table IMAGES of the output"));
        }
    }
    sentences
}

/// Warning on images that change from one to the next, most of which the static modes do not
/// explain. `changes` is the reduced χ² of their differences.
fn changing_warning(found: &modal::ModalEstimate, changes: Option<f64>) -> Option<String> {
    let changes = changes.filter(|chi2| *chi2 >= CHANGING)?;
    let is_misfit = |image: &&ImageReport| matches!(image.status, Status::Misfit | Status::WrongMinimum);
    if 2 * found.images.iter().filter(is_misfit).count() <= found.images.len() {
        return None;
    }
    Some(format!(
        "the images change from one to the next by {:.1} times their noise, and static modes leave {:.1} times the noise in the \
         typical one: a wavefront that changes, as behind adaptive optics, which estimate.method = \"full-phase\" (--method full-phase) reads, \
         or a pupil that turns (image.pupil_turns_deg has its turn in each image); these maps include what changed and did not average out",
        changes.sqrt(),
        found.reduced_chi2().sqrt()
    ))
}

/// Warning on a sequence whose typical image misfits.
fn sequence_warning(found: &modal::ModalEstimate) -> Option<String> {
    let misfits = found.images.iter().filter(|image| image.status == Status::Misfit).count();
    if !found.is_sequence() || 2 * misfits <= found.used() {
        return None;
    }
    let chi2 = found.reduced_chi2();
    let too_small = found.images.iter().filter(|image| image.is_too_small()).count();
    if too_small > misfits / 2 {
        return Some(format!("in the typical image (median reduced χ² {}) {TOO_SMALL}", shown_chi2(chi2)));
    }
    Some(format!(
        "the residual is {:.2} times the noise in the typical image (median reduced χ² {chi2:.2}): a wavefront that \
         changes from image to image and that the modes do not span, as behind adaptive optics, or a scene that differs \
         from the instrument; error bars are from the scatter between images, and do not include what all images share",
        chi2.sqrt()
    ))
}

/// Warning on images that are not of one wavefront.
fn agreement_warning(found: &modal::ModalEstimate) -> Option<String> {
    // Said with the residual that a changing wavefront leaves.
    let is_said = found.agreement.verdict == Verdict::Changing && sequence_warning(found).is_some();
    let of = ("image", found.images.len());
    agreement_sentence(&found.agreement, of, |image| found.combined.clipped_images.contains(&image))
        .filter(|_| !is_said)
}

/// Warning on `count` images, or groups of them, that are not of one wavefront, where some are left
/// out.
pub(super) fn agreement_sentence(
    agreement: &Agreement,
    (noun, count): (&str, usize),
    is_left_out: impl Fn(usize) -> bool,
) -> Option<String> {
    let Agreement { reduced_chi2, freedom, verdict } = agreement;
    let named = |places: &[usize]| named(places, (noun, count));
    let scatter = format!(
        "the reduced χ² of the {noun}s' differences is {reduced_chi2:.*} ({freedom:.0} degrees of freedom), where noise gives 1",
        if *reduced_chi2 < 10.0 { 2 } else { 0 }
    );
    match verdict {
        Verdict::Untested | Verdict::OneWavefront => None,
        Verdict::Outliers(images) => {
            let (which, are) = (named(images), if images.len() == 1 { "is" } else { "are" });
            let is_out = images.iter().all(|image| is_left_out(*image));
            let (were, remedy) = match (images.len() == 1, is_out) {
                (true, true) => ("was", "left out"),
                (false, true) => ("were", "left out"),
                (_, false) => (are, "used as well: estimate.combine = \"clipped-mean\" leaves such ones out"),
            };
            Some(format!(
                "{which} {are} of another wavefront than the others, which agree with each other, and {were} {remedy} ({scatter})"
            ))
        }
        Verdict::SeveralWavefronts(group) => {
            let largest = if group.len() > 1 {
                format!("; the largest set that agrees is of {}", named(group))
            } else {
                "; no two agree".into()
            };
            Some(format!(
                "the {noun}s contradict each other: {scatter}{largest}. Did segments, mirror, focus or pupil move between them? Their \
                 mean is the wavefront of none, and the error bars are scaled up to their scatter: estimate the images of one \
                 wavefront alone"
            ))
        }
        Verdict::Changing => Some(format!(
            "the wavefront changes from {noun} to {noun}: {scatter}; error bars are from the scatter between {noun}s, and the maps are \
             those of the mean wavefront"
        )),
    }
}

/// Images, or groups of them, by their numbers from 1, consecutive ones as a range: `images 1 to 4
/// and 7 of 20`.
pub(super) fn named(places: &[usize], (noun, count): (&str, usize)) -> String {
    let several = if places.len() == 1 { "" } else { "s" };
    format!("{noun}{several} {} of {count}", in_ranges(places, 1))
}

/// Warning on an error of the model that only the mean of the images shows.
fn mean_residual_warning(found: &modal::ModalEstimate) -> Option<String> {
    let chi2 = found.left_out().map_or(found.mean_residual_chi2, |left_out| left_out.mean_residual_chi2);
    is_mean_misfit(found.used(), chi2).then(|| {
        format!(
            "the mean residual of the {} images is {:.1} times its noise (reduced χ² {chi2:.1}), which single images do not \
             show: the modes do not span what is there, or the scene differs from the instrument; {}",
            found.used(),
            chi2.sqrt(),
            scaled(chi2)
        )
    })
}

/// Effect of a misfit of reduced χ² `chi2` on the error bars: scaling by √χ² covers errors of the
/// model up to the noise; beyond `USELESS` standard deviations the bias is unknown.
fn scaled(chi2: f64) -> &'static str {
    /// In standard deviations of the noise.
    const USELESS: f64 = 5.0;
    if chi2 > USELESS * USELESS {
        "the estimate and its error bars are not to be used"
    } else {
        "error bars are scaled up by as much"
    }
}

fn image_warning(image: &ImageReport, is_used: bool) -> Option<String> {
    let chi2 = image.reduced_chi2;
    let [least, most] = image.explained_chi2;
    match &image.status {
        Status::Ok | Status::Contradictory => None,
        Status::Misfit if image.is_too_small() => {
            let of_bias = if image.background_e > LEAST_BIAS_E {
                format!(
                    "the {:.0} electrons of background in every pixel are expected to have photon noise, which a bias that was not subtracted \
                     does not have; or ",
                    image.background_e
                )
            } else {
                String::new()
            };
            Some(format!(
                "reduced χ² is {}, where noise explains {least:.2} or more: {of_bias}{TOO_SMALL}",
                shown_chi2(chi2)
            ))
        }
        Status::Misfit => Some(format!(
            "the residual is {:.2} times the noise (reduced χ² {chi2:.2}, where noise explains up to {most:.2}): the modes do \
             not span the wavefront, the scene differs from the instrument (plate scale, bandwidth, pixels that are squares, \
             gain or read noise), or the image has what the model does not (a companion, a non-linear detector); {}",
            chi2.sqrt(),
            scaled(chi2)
        )),
        Status::WrongMinimum => Some(format!(
            "reduced χ² is {chi2:.0}: the fit is probably in a wrong minimum, or wavelength, diversity (or its sign), rotation or orientation \
             of the scene are not the image's ('cophase check' compares them)"
        )),
        Status::NotConverged(reason) if is_used => Some(format!(
            "the fit did not converge ({reason}), and there is no better image: these maps are no estimate"
        )),
        Status::NotConverged(reason) => Some(format!("left out, the fit did not converge ({reason})")),
        Status::Unusable(reason) => Some(format!("left out, {reason}")),
    }
}

/// A χ² with two decimals, or an exponent where they would be 0.
pub(super) fn shown_chi2(chi2: f64) -> String {
    if chi2 < 0.01 { format!("{chi2:.0e}") } else { format!("{chi2:.2}") }
}

fn listed(names: &[String]) -> String {
    let first = names[..names.len().min(NAMED_MODES)].join(", ");
    if names.len() > NAMED_MODES { format!("{first} and {} more", names.len() - NAMED_MODES) } else { first }
}

/// Warnings of a MAP estimate, whose last iteration is `last`.
pub(super) fn full_phase_warnings(
    found: &SequenceResult,
    last: &Iteration,
    has_settled: bool,
    is_misfit: bool,
) -> Vec<String> {
    let mut sentences = Vec::new();
    let (all, exposures) = (found.reports.len(), found.exposures);
    let left_out = exposures - last.used_images.len();
    if left_out > 0 {
        let were = if left_out == 1 { "was" } else { "were" };
        let images = if exposures == all { "images" } else { "exposures" };
        sentences.push(format!("{left_out} of {exposures} {images} {were} left out"));
    }
    let affected = found.rejected.iter().filter(|pixels| pixels.total() > 0).count();
    if affected > 0 {
        let rejected = found.rejected.iter().map(RejectedPixels::total).sum::<usize>();
        let (pixels, were) = (counted(rejected, "outlier pixel"), if rejected == 1 { "was" } else { "were" });
        sentences.push(format!("{pixels} in {affected} of {all} images {were} rejected (cosmic rays, hot pixels)"));
    }
    sentences.extend(found.device_failure.clone());
    sentences.extend(last.diversity.warning(found.scene.image.wavelength_nm));
    sentences.extend(found.optics.warnings());
    sentences.extend(found.telemetry.iter().flat_map(|check| check.warnings.clone()));
    if is_misfit && last.reduced_chi2 < 1.0 {
        sentences.push(format!("the typical image has a reduced χ² of {}: {TOO_SMALL}", shown_chi2(last.reduced_chi2)));
    } else if is_misfit {
        sentences.push(format!(
            "the residual of the typical image is {:.1} times the noise (reduced χ² {:.1}): the scene differs from the \
             instrument, and the error bars do not include by how much",
            last.reduced_chi2.sqrt(),
            last.reduced_chi2
        ));
    }
    if let Some(tilts) = last.segment_tilts.filter(|tilts| tilts.is_significant() && !last.has_tilts()) {
        sentences.push(format!(
            "single segments seem to be tilted, by {:.0} nm RMS or more: pistons and NCPA have absorbed a part of it, which \
             their error bars do not include",
            tilts.rms_nm
        ));
    }
    // Less than the rest of the error bar is only a term of it: of a few images, turbulence alone
    // leaves 0.5 nm in each of the finest modes, which extrapolates to 1.6.
    let beyond_nm = last.error_budget.term_nm(ErrorSource::NcpaBeyondModes)[1];
    if beyond_nm > last.error_budget.total_nm[1] / std::f64::consts::SQRT_2 {
        sentences.push(format!(
            "the NCPA extend beyond the {} modes that the sensor can distinguish: about {beyond_nm:.1} nm of them are in no \
             map, and only in the error bars",
            last.errors.ncpa_nm.len()
        ));
    }
    if !has_settled {
        let [phasing_nm, ncpa_nm] = last.change_nm;
        sentences.push(format!(
            "{} iterations did not converge: the last one changed the phasing by {phasing_nm:.1} nm and the NCPA by \
             {ncpa_nm:.1} nm",
            found.iterations.len()
        ));
    }
    if found.ao_knowledge < AoKnowledge::Loop {
        sentences.push(format!(
            "with estimate.ao_knowledge = \"{}\" the loop's response to the pistons counts as NCPA: their error bars include {:.0} \
             nm for it",
            found.ao_knowledge.word(),
            last.error_budget.term_nm(ErrorSource::UnknownLoopResponse)[1]
        ));
    }
    sentences
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_unknown_combinations_are_one_warning() {
        assert_eq!(unknown_warning(&[]), None);
        assert!(unknown_warning(&["a + b"]).unwrap().ends_with("for it: a + b"));
        let names: Vec<String> = (0..84).map(|k| format!("mode-{k}")).collect();
        let sentence = unknown_warning(&names.iter().map(String::as_str).collect::<Vec<_>>()).unwrap();
        assert!(sentence.contains("84 combinations") && sentence.contains("mode-0; mode-1; mode-2; and 81 more"));
    }

    #[test]
    fn images_are_named_by_ranges() {
        assert_eq!(named(&[3], ("image", 7)), "image 4 of 7");
        assert_eq!(named(&[0, 1, 2, 4, 6, 7], ("image", 20)), "images 1 to 3, 5, 7, 8 of 20");
        let alternate: Vec<usize> = (0..40).step_by(2).collect();
        assert!(named(&alternate, ("image", 40)).ends_with("13, 15, ... of 40"));
    }

    #[test]
    fn error_bars_of_large_misfits_are_not_to_be_used() {
        assert!(scaled(4.0).contains("scaled up"));
        assert!(scaled(49.0).contains("not to be used"));
    }
}

//! Maximum a posteriori (MAP) estimate: the wavefront behind each exposure of a sequence, and the
//! static errors that all share.

use super::channels::{ChannelImages, names};
use super::estimate::{Basis, Estimate, Figures, FullPhaseSummary, MethodResult, Run};
use super::outcome::ImageOutcome;
use super::policy::Policy;
use super::sequence::{self, SequenceResult};
use super::sequence_channel::{Sequence, SequenceChannel};
use super::{remarks, warnings};
use crate::ao::{Lenslets, SlopeFormat, moved_reference, reference_slopes, sensor_pupil};
use crate::control::{Control, Stage};
use crate::modal::has_diversity;
use crate::modal::{ImageReport, Status};
use crate::modes::Group;
use crate::retrieval::{OPTICS_SEARCH_CHI2, RetrievalReport};
use crate::scene::{AoKnowledge, Scene, SensorScene, Telemetry};
use crate::statics::{ErrorTerm, Iteration, NcpaFamily, StaticsSettings};
use crate::statistics::upper_median;
use crate::telescope::{Telescope, unit_remark};
use crate::{Error, Result};
use ndarray::{Array1, Array2, Axis, concatenate};
use std::time::Instant;

/// Largest reduced χ² of images that the model explains except for turbulence finer than its
/// samples: with a bright star 1.4 to 1.6 in frozen exposures, 4.2 in exposures of 10 ms; square
/// pixels modelled as points make it 8. That is at [`EXPLAINED_AT_NM`].
const EXPLAINED: f64 = 6.0;
const EXPLAINED_AT_NM: f64 = 2168.6;
/// Largest ratio of the excess over 1 that is explained in another wavelength (3 at 1.64 µm). The
/// light that turbulence scatters grows as λ⁻², and the excess as its square: of 25 images each
/// behind Keck's loop, at one resolution, those at 2.17 µm have a χ² of 4 and those at 1.64 µm 14.
const LARGEST_RATIO: f64 = 4.0;
/// Least reduced χ² of images in electrons: over thousands of pixels it scatters by 0.02 about 1 or
/// more. Counts of 20 electrons each that are read as electrons give 0.05 to 0.1.
const LEAST_EXPLAINED: f64 = 0.8;

/// Measured slopes `[image, slope]` in mas and in the order of the scene's sensor; `None` where
/// they are given so.
fn slopes_in_mas(scene: &Scene, measured: &Array2<f64>) -> Result<Option<Array2<f64>>> {
    let Some(sensing) = &scene.wavefront_sensor else { return Ok(None) };
    let reference = reference_slopes(scene, sensing, measured.ncols())?;
    let seen = reference.map(|reference| measured + &reference);
    let measured = seen.as_ref().unwrap_or(measured);
    if sensing.slope_order.is_empty() {
        let is_plain = seen.is_none() && sensing.slope_unit_mas == 1.0;
        return Ok((!is_plain).then(|| measured * sensing.slope_unit_mas));
    }
    slope_format(scene, sensing)?.expected_mas(measured.view()).map(Some)
}

fn slope_format(scene: &Scene, sensing: &SensorScene) -> Result<SlopeFormat> {
    let pupil = sensor_pupil(scene, sensing, &Telescope::new(scene)?, 0)?;
    SlopeFormat::new(sensing, &Lenslets::new(sensing, &pupil, scene.directory())?)
}

/// By how much corrections have moved the reference slopes, mas and in the order of the scene's
/// sensor: what its file says, else what the images' file does, `given`.
fn moved_reference_mas(scene: &Scene, given: Option<&Array1<f64>>) -> Result<Option<Array1<f64>>> {
    let Some(sensing) = &scene.wavefront_sensor else { return Ok(None) };
    if given.is_none() && sensing.moved_reference_file.is_none() {
        return Ok(None);
    }
    let format = slope_format(scene, sensing)?;
    let named = moved_reference(scene, sensing, &format)?;
    let given = given.map(|row| format.expected_mas(row.view().insert_axis(Axis(0)))).transpose()?;
    Ok(named.or_else(|| given.map(|rows| rows.row(0).to_owned())))
}

/// The channels that determine the signs of the wavefront by themselves, and those in focus; the
/// first are all where none does.
fn by_diversity<'a, 'b>(channels: &'b [ChannelImages<'a>]) -> [Vec<&'b ChannelImages<'a>>; 2] {
    let (with, without): (Vec<_>, Vec<_>) = channels.iter().partition(|channel| has_diversity(&channel.scene.image));
    if with.is_empty() { [without, Vec::new()] } else { [with, without] }
}

/// Estimates the static errors behind the exposures of all `channels` of `scene`, whose slopes are
/// used where it says so.
///
/// # Errors
/// Those of [`sequence::estimate`]; [`Error::Shape`] for slopes of another number of exposures.
pub(super) fn estimate(
    scene: &Scene,
    policy: &Policy,
    control: &Control,
    channels: &[ChannelImages],
) -> Result<Estimate> {
    let [with, in_focus] = by_diversity(channels);
    let is_simultaneous = channels.len() > 1 && scene.image.simultaneous;
    let (measured, ignored) = telemetry(&with, is_simultaneous)?;
    // A level below telemetry uses no slopes, and does not check those of a file.
    let uses_telemetry = scene.estimate.ao_knowledge.is_none_or(|level| level >= AoKnowledge::Telemetry)
        && scene.estimate.telemetry != Telemetry::Ignore;
    let slopes_mas = measured.as_ref().filter(|_| uses_telemetry);
    let converted_mas = slopes_mas.map(|measured| slopes_in_mas(scene, measured)).transpose()?.flatten();
    let slopes_mas = converted_mas.as_ref().or(slopes_mas);
    // One sensor measures the slopes of all channels.
    let moved_mas = with.iter().find_map(|channel| channel.images.moved_reference_mas);
    let moved_mas = slopes_mas.map(|_| moved_reference_mas(scene, moved_mas)).transpose()?.flatten();
    let sequences: Vec<_> =
        with.iter().map(|channel| SequenceChannel { scene: &channel.scene, images: &channel.images }).collect();
    let sequence = Sequence {
        channels: &sequences,
        is_simultaneous,
        slopes_mas,
        moved_reference_mas: moved_mas.as_ref(),
        policy,
        control,
    };
    if let Some(slopes_mas) = slopes_mas.filter(|slopes_mas| slopes_mas.nrows() != sequence.exposures()) {
        return Err(Error::Shape(format!(
            "the telemetry holds {} sets of slopes for {} images: one each is needed",
            slopes_mas.nrows(),
            sequence.exposures()
        )));
    }
    control.enter(Stage::Retrieving, sequence.images());
    let started = Instant::now();
    let found = sequence::estimate(&sequence)?;
    let seconds = started.elapsed().as_secs_f64();
    control.check("the images were read, nothing was written")?;
    let Some(last) = found.iterations.last() else { return Err(Error::Internal("no iteration was made".into())) };
    let settings = StaticsSettings::default();
    let has_settled = found.iterations.len() < settings.max_iterations || !last.has_changed(settings.tolerance);
    let outcomes = outcomes(&sequence, &found, last);
    // After a search for optical parameters the limit is that of the search.
    let is_searched = !found.optics.warnings().is_empty();
    let explained = if is_searched { OPTICS_SEARCH_CHI2 } else { EXPLAINED };
    let excess = |outcome: &ImageOutcome| {
        let ratio = if is_searched { 1.0 } else { excess_ratio(sequence.channels[outcome.channel].scene) };
        (outcome.report.reduced_chi2 - 1.0) / ratio
    };
    let excess: Vec<f64> = outcomes.iter().filter(|outcome| outcome.is_used).map(excess).collect();
    let is_misfit = last.reduced_chi2 < LEAST_EXPLAINED || upper_median(&excess) > explained - 1.0;
    let why = "a full-phase estimate reads defocused images";
    let left_out = |channel: &&ChannelImages| {
        format!(
            "channel {}: it is in focus, where an image does not determine the signs of even aberrations, and was left out: {why}",
            channel.name.unwrap_or_default()
        )
    };
    let mut sentences: Vec<String> = in_focus.iter().map(left_out).collect();
    sentences.extend(ignored);
    sentences.extend(warnings::full_phase_warnings(&found, last, has_settled, is_misfit));
    if slopes_mas.is_some() && found.ao_knowledge < AoKnowledge::Telemetry {
        sentences.push(
            "the slopes that come with the images are ignored: the scene has no [wavefront_sensor] and [control]"
                .into(),
        );
    }
    sentences.extend(warnings::integers_warning(&found.integers));
    // Errors of the diversities of several channels partly cancel.
    let only = (sequence.channels.len() == 1).then_some(&found.scene);
    let mut remarks: Vec<String> =
        only.and_then(|scene| remarks::diversity_remark(&last.diversity, scene)).into_iter().collect();
    remarks.extend(remarks::segment_tilts_remarks(last));
    let telescope = Telescope::new(&found.scene)?;
    remarks.extend(remarks::averaged_pupil_remark(&found.scene, &telescope));
    remarks.extend(slopes_mas.and_then(remarks::missing_telemetry_remark));
    if !found.telemetry.as_ref().is_some_and(|check| check.excludes_flips) {
        remarks.extend(remarks::orientation_remark(&found.scene, &telescope)?);
    }
    remarks.extend(unit_remark(&found.scene)?);
    let pupil = found.pupil.clone();
    let [phasing_nm, ncpa_nm] = last.error_budget.total_nm;
    let contributes = |term: &&ErrorTerm| term.phasing_nm > 0.0 || term.ncpa_nm > 0.0;
    Ok(Estimate {
        policy: *policy,
        channels: names(&with),
        integers: found.integers.clone(),
        basis: basis(last),
        modes: last.modes(),
        figures: Figures::new(&pupil, &last.maps, [phasing_nm, ncpa_nm, phasing_nm + ncpa_nm])?,
        maps: last.maps.clone(),
        sigma_maps: last.sigma_maps.clone(),
        error_budget: last.error_budget.terms.iter().filter(contributes).cloned().collect(),
        model_errors: Vec::new(),
        without_staircases: None,
        images: outcomes,
        reduced_chi2: last.reduced_chi2,
        is_sequence: true,
        status: if is_misfit { Status::Misfit } else { Status::Ok },
        model: selected(last),
        optics: found.optics.changes.clone(),
        warnings: sentences,
        remarks,
        pupil,
        run: Run { device: found.device, precision: scene.estimate.precision().into(), seconds, model_seconds: 0.0 },
        truth: None,
        method: MethodResult::FullPhase(FullPhaseSummary {
            ao_knowledge: found.ao_knowledge,
            telemetry: found.telemetry,
            iterations: found.iterations,
            has_settled,
            retrieval_seconds: found.retrieval_seconds,
            segment_reflectivities: found.optics.segment_reflectivities,
        }),
        // One that lists its channels is that of the estimate as it was given.
        scene: if with[0].name.is_some() { scene.clone() } else { found.scene },
    })
}

/// Slopes of the exposures, where each channel has its own, and a warning where only some have any.
fn telemetry(channels: &[&ChannelImages], is_simultaneous: bool) -> Result<(Option<Array2<f64>>, Option<String>)> {
    let slopes: Vec<_> = channels.iter().filter_map(|channel| channel.images.slopes_mas).collect();
    match slopes[..] {
        [] => Ok((None, None)),
        _ if slopes.len() < channels.len() => {
            Ok((None, Some("only some channels have slopes of the wavefront sensor, and these are ignored".into())))
        }
        // One exposure, one set of slopes.
        [first, ..] if is_simultaneous => Ok((Some(first.clone()), None)),
        _ => {
            let views: Vec<_> = slopes.iter().map(|slopes| slopes.view()).collect();
            let all = concatenate(Axis(0), &views).map_err(|_| {
                Error::Shape("the slopes of the channels differ in number: each needs all of the sensor's".into())
            })?;
            Ok((Some(all), None))
        }
    }
}

/// Excess of χ² over 1 that turbulence leaves in images of `scene`, over that at
/// [`EXPLAINED_AT_NM`].
fn excess_ratio(scene: &Scene) -> f64 {
    (EXPLAINED_AT_NM / scene.image.wavelength_nm).powi(4).clamp(1.0, LARGEST_RATIO)
}

/// Outcomes of the images, channel after channel.
fn outcomes(sequence: &Sequence, found: &SequenceResult, last: &Iteration) -> Vec<ImageOutcome> {
    let mut outcomes = Vec::new();
    for (channel, images) in sequence.channels.iter().map(|channel| channel.images.len()).enumerate() {
        let before = outcomes.len();
        let of_image = |image: usize| {
            let exposure = if sequence.is_simultaneous { image } else { before + image };
            let is_used = last.used_images.contains(&exposure);
            ImageOutcome { channel, ..outcome(found, before + image, is_used) }
        };
        outcomes.extend((0..images).map(of_image).collect::<Vec<_>>());
    }
    outcomes
}

fn outcome(found: &SequenceResult, image: usize, is_used: bool) -> ImageOutcome {
    let RetrievalReport { reduced_chi2, evaluations, reason, flux_e, background_e, refusal, .. } = found.reports[image];
    let status = match refusal {
        Some(refusal) => Status::Unusable(refusal),
        None if reason.has_converged() => Status::Ok,
        None => Status::NotConverged(reason),
    };
    let how = if is_used { "used" } else { "left out, its χ² differs from the others'" };
    let message = match refusal {
        Some(refusal) => format!("left out, {refusal}"),
        None => format!("{how}; reduced χ² {reduced_chi2:.2}, {reason}"),
    };
    let rejected = found.rejected[image];
    ImageOutcome {
        report: ImageReport {
            evaluations,
            reduced_chi2,
            flux_e,
            background_e,
            rejected,
            ..ImageReport::unfitted(status)
        },
        channel: 0,
        message,
        is_used,
        is_clipped: !is_used && refusal.is_none(),
    }
}

/// Description of the modes that were selected.
fn selected(last: &Iteration) -> String {
    let modes = last.ncpa_names.len();
    let ncpa = match last.family {
        NcpaFamily::Zernike { highest_order } => format!("{modes} Zernike modes to radial order {highest_order}"),
        NcpaFamily::Mirror => format!("{modes} modes of the deformable mirror"),
    };
    if last.segment_tilts.is_some() && last.has_tilts() { ncpa + ", tip and tilt of each segment" } else { ncpa }
}

fn basis(last: &Iteration) -> Basis {
    let (segments, ncpa) = (last.errors.segment_modes(), last.ncpa_names.len());
    let groups = [vec![Group::Segment; segments], vec![Group::Ncpa; ncpa]].concat();
    Basis { names: last.mode_names(), groups }
}

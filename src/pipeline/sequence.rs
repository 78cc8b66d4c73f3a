//! Wavefronts and static errors of a sequence behind adaptive optics: maximum a posteriori (MAP)
//! retrieval of each exposure's wavefront, and the static errors that all exposures share, in turn
//! until nothing changes.

use super::absolute_pistons::{AbsolutePistons, SequenceInColours};
use super::policy::Policy;
use super::sequence_channel::{Sequence, SequenceChannel};
use super::telemetry::{self, TelemetryCheck};
use crate::ao::{Lenslets, sensor_pupil};
use crate::modal::{CleanedImages, Cube, PistonInteger, RejectedPixels, are_determined};
use crate::pupil::Pupil;
use crate::retrieval::{
    RadialPsd, RetrievalReport, RetrievalSettings, RetrievedOptics, Retriever, StaticAberrationRms, estimate_optics,
};
use crate::scene::{AoKnowledge, ModelChoice, Scene, SegmentModes, System};
use crate::statics::{
    ChannelSequence, Iteration, MAX_NCPA_MODES, SequenceRetrieval, StaticsSettings, TiltSelection, check_diversity,
    estimate_static_errors,
};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array2, ArrayView1};

/// Result of a sequence.
pub(super) struct SequenceResult {
    /// All iterations; the last one is the estimate.
    pub(super) iterations: Vec<Iteration>,
    /// Retrieval of each image in the last iteration.
    pub(super) reports: Vec<RetrievalReport>,
    /// Number of exposures: of images, or of sets of simultaneous ones.
    pub(super) exposures: usize,
    /// Outlier pixels that were rejected from each image.
    pub(super) rejected: Vec<RejectedPixels>,
    /// Whole wavelengths of each segment's piston; none where the channels have one wavelength.
    pub(super) integers: Vec<PistonInteger>,
    /// What was assumed of the adaptive optics.
    pub(super) ao_knowledge: AoKnowledge,
    /// Measured slopes against those of the retrieved wavefronts, where slopes are used.
    pub(super) telemetry: Option<TelemetryCheck>,
    /// Optical parameters that the images show to differ from the scene's.
    pub(super) optics: RetrievedOptics,
    /// Scene of the static errors and of corrections: with the optical parameters that were found,
    /// unless the sensor's subapertures contradict them.
    pub(super) scene: Scene,
    pub(super) device: String,
    pub(super) device_failure: Option<String>,
    pub(super) pupil: Pupil,
    /// Wall-clock time in retrievals, s.
    pub(super) retrieval_seconds: f64,
}

/// What is assumed of the adaptive optics of `scene` for images with or without telemetry.
///
/// # Errors
/// [`Error::Scene`] where the scene asks for more than there is.
fn ao_knowledge(scene: &Scene, telemetry: bool) -> Result<AoKnowledge> {
    let has_loop = scene.control.is_some() && scene.wavefront_sensor.is_some();
    let there = match (has_loop, telemetry) {
        (true, true) => AoKnowledge::Telemetry,
        (true, false) => AoKnowledge::Loop,
        (false, _) => AoKnowledge::Spectrum,
    };
    match scene.estimate.ao_knowledge {
        None => Ok(there),
        Some(wanted) if wanted <= there => Ok(wanted),
        Some(wanted) => Err(Error::Scene(format!(
            "estimate.ao_knowledge = \"{}\" is not accepted: the {}; up to \"{}\" is accepted",
            wanted.word(),
            if has_loop { "images come without slopes" } else { "scene has no [wavefront_sensor] and [control]" },
            there.word()
        ))),
    }
}

/// Refuses slopes that are not of `scene`'s sensor, before any image is read.
fn check_slopes(scene: &System, telescope: &Telescope, slopes_mas: &Array2<f64>) -> Result<()> {
    let Some(sensing) = &scene.wavefront_sensor else { return Ok(()) };
    let pupil = sensor_pupil(scene, sensing, telescope, 0)?;
    let subapertures = Lenslets::new(sensing, &pupil, scene.directory())?.subapertures.len();
    if slopes_mas.ncols() != 2 * subapertures {
        return Err(Error::Shape(format!(
            "{} slopes were given for each image: {} are needed, along x and then along y for each of the scene's \
             {subapertures} subapertures",
            slopes_mas.ncols(),
            2 * subapertures
        )));
    }
    let is_measured = |row: &ArrayView1<f64>| !row.iter().all(|mas| mas.is_nan());
    let measured: Vec<_> = slopes_mas.outer_iter().enumerate().filter(|(_, row)| is_measured(row)).collect();
    for (image, row) in &measured {
        if let Some((slope, mas)) = row.iter().enumerate().find(|(_, mas)| !mas.is_finite()) {
            return Err(Error::Value(format!(
                "slope {} of image {} is {mas} mas: a finite one is needed, or NaN for all slopes of an image without telemetry",
                slope + 1,
                image + 1
            )));
        }
    }
    let (count, images) = (measured.len(), slopes_mas.nrows());
    if images > 1 && count < 2 {
        let sentence = format!(
            "the telemetry holds slopes of {count} of {images} images: 2 or more are needed; estimate.telemetry = \"ignore\" does \
             without"
        );
        return Err(Error::Value(sentence));
    }
    Ok(())
}

/// Whether tips and tilts of the segments of `scene` are estimated.
///
/// # Errors
/// [`Error::Scene`] for a scene without pistons.
fn tilt_selection(scene: &Scene, policy: &Policy) -> Result<TiltSelection> {
    match scene.modes.segment {
        SegmentModes::PistonTipTilt => Ok(TiltSelection::Always),
        SegmentModes::Piston if policy.select_model && scene.estimate.model == ModelChoice::Auto => {
            Ok(TiltSelection::WhereSignificant)
        }
        SegmentModes::Piston => Ok(TiltSelection::Never),
        SegmentModes::None => Err(Error::Scene(
            "modes.segment = \"none\" is not accepted with estimate.method = \"full-phase\": \"piston\" or \"piston-tip-tilt\" \
             is needed"
                .into(),
        )),
    }
}

/// `scene` with these segment modes.
fn with_segment_modes(scene: &Scene, modes: SegmentModes) -> Result<Scene> {
    if scene.modes.segment == modes {
        Ok(scene.clone())
    } else {
        scene.changed(|sections| sections.modes.segment = modes)
    }
}

/// Prior power spectral density of the dynamic wavefront.
fn prior(scene: &Scene, ao_knowledge: AoKnowledge) -> Result<RadialPsd> {
    if ao_knowledge > AoKnowledge::Nothing {
        return RadialPsd::ao_residual(scene, StaticAberrationRms::default());
    }
    // Ordinary seeing, r0 = 16 cm at 500 nm, above the cut-off of the mirror's pitch; below it the
    // value at the cut-off. Kolmogorov: 0.0229·r0^(−5/3)·f^(−11/3) rad²·m².
    const ENTRIES: usize = 200;
    let cut_off_per_m = 0.5 / scene.mirror.pitch_m;
    let step_per_m = cut_off_per_m / 40.0;
    let nm_per_rad = 500.0 / std::f64::consts::TAU;
    let at = |k: usize| {
        let f = (step_per_m * k as f64).max(cut_off_per_m);
        0.0229 * 0.16f64.powf(-5.0 / 3.0) * f.powf(-11.0 / 3.0) * nm_per_rad * nm_per_rad
    };
    RadialPsd::new(step_per_m, (0..ENTRIES).map(at).collect())
}

/// Largest number of images that are retrieved at a finer resolution, which takes three times as
/// long: the residual phasing of the first ten images of a sequence is then 7.8 nm in place of 8.8.
const FEW_IMAGES: usize = 40;
/// Finer resolution over the usual one, in cycles across a segment.
const FEW_IMAGES_RESOLUTION: f64 = 1.25;

/// Estimates the static errors behind a sequence.
///
/// # Errors
/// Those of building the model; [`Error::Shape`] and [`Error::Value`] for frames or slopes that are
/// not the scene's; [`Error::Image`] where fewer than two images can be used;
/// [`Error::Interrupted`].
pub(super) fn estimate(sequence: &Sequence) -> Result<SequenceResult> {
    let tilts = tilt_selection(sequence.channels[0].scene, sequence.policy)?;
    // A retrieved wavefront holds the segments' tilts, so the retrieval's models need pistons
    // alone.
    let piston_scenes = sequence.channels.iter().map(|channel| with_segment_modes(channel.scene, SegmentModes::Piston));
    let piston_scenes = piston_scenes.collect::<Result<Vec<_>>>()?;
    let channels: Vec<_> = piston_scenes
        .iter()
        .zip(sequence.channels)
        .map(|(scene, channel)| SequenceChannel { scene, images: channel.images })
        .collect();
    let sequence = &Sequence { channels: &channels, ..*sequence };
    let (channels, slopes_mas, control) = (sequence.channels, sequence.slopes_mas, sequence.control);
    let scene = channels[0].scene;
    let ao_knowledge = ao_knowledge(scene, slopes_mas.is_some())?;
    let settings = StaticsSettings { ao_knowledge, tilts, ..StaticsSettings::default() };
    if let Some(&coarsest) = settings.families.first() {
        check_diversity(coarsest, scene, &Telescope::new(scene)?)?;
    }
    let used_slopes_mas = slopes_mas.filter(|_| ao_knowledge >= AoKnowledge::Telemetry);
    let prior = prior(scene, ao_knowledge)?;
    let cleaned = channels.iter().map(SequenceChannel::cleaned).collect::<Result<Vec<_>>>()?;
    let cubes: Vec<Cube> = channels.iter().zip(&cleaned).map(|(channel, cleaned)| channel.cube(cleaned)).collect();
    let has_known_turbulence = ao_knowledge > AoKnowledge::Nothing;
    let retrieval = RetrievalSettings { has_known_turbulence, ..retrieval_settings(scene, sequence.exposures()) };
    let (optics, static_scene) = optics_with_sensor(scene, used_slopes_mas, || match &cubes[..] {
        [only] => estimate_optics(scene, &prior, &retrieval, *only, control),
        // Channels could be explained by different optics, of which no wavefront is common to all.
        _ => RetrievedOptics::of(scene),
    })?;
    let scenes: Vec<System> = match channels {
        [_] => vec![optics.scene.clone()],
        _ => channels.iter().map(|channel| channel.scene.system().clone()).collect(),
    };
    let retrievers = Retriever::of_channels(&scenes, optics.telescope(), &prior, &retrieval)?;
    let modes_per_segment = if tilts == TiltSelection::Never { 1 } else { 3 };
    retrievers[0].check_images(sequence.images(), modes_per_segment, MAX_NCPA_MODES)?;
    let sequences: Vec<_> =
        retrievers.iter().zip(&cubes).map(|(retriever, &cube)| ChannelSequence { retriever, cube }).collect();
    let (start, integers) = absolute_pistons(sequence, &sequences, &prior, &settings)?
        .map(|found| (found.wavefront, found.integers))
        .unzip();
    let slopes_of_exposures = used_slopes_mas.cloned();
    let mut source = SequenceRetrieval::new(sequences, sequence.is_simultaneous, &prior, slopes_of_exposures, control)?
        .about(start)
        .with_moved_reference(sequence.moved_reference_mas.cloned());
    // The first iteration's wavefronts are retrieved without the slopes.
    let telemetry = match used_slopes_mas {
        Some(slopes_mas) => {
            let samples = retrievers[0].illuminated_samples()?;
            telemetry::check(&static_scene, &samples, source.first_wavefronts_nm()?, slopes_mas)?
        }
        None => None,
    };
    if let Some(check) = telemetry.as_ref().filter(|check| check.divided_by != 1.0) {
        source.divide_slopes(check.divided_by);
    }
    let iterations = estimate_static_errors(&static_scene, &mut source, &settings, control)?;
    let static_scene = match iterations.last() {
        Some(last) if last.has_tilts() => with_segment_modes(&static_scene, SegmentModes::PistonTipTilt)?,
        _ => static_scene,
    };
    let (device, device_failure) = retrievers[0].device();
    let rejected = |(channel, cleaned): (&SequenceChannel, &Option<CleanedImages>)| match cleaned {
        None => vec![RejectedPixels::default(); channel.images.len()],
        Some(cleaned) => cleaned.rejected.clone(),
    };
    Ok(SequenceResult {
        iterations,
        reports: std::mem::take(&mut source.reports),
        exposures: sequence.exposures(),
        retrieval_seconds: source.seconds,
        rejected: channels.iter().zip(&cleaned).flat_map(rejected).collect(),
        integers: integers.unwrap_or_default(),
        ao_knowledge,
        telemetry,
        optics,
        pupil: Telescope::new(&static_scene)?.pupil,
        scene: static_scene,
        device,
        device_failure,
    })
}

/// The optics that `search` finds, and the scene of the static errors: with these optics, unless
/// the slopes belong to the subapertures of `scene` only.
///
/// # Errors
/// Those of `search`; [`Error::Shape`] and [`Error::Value`] for slopes that belong to neither.
fn optics_with_sensor(
    scene: &Scene,
    slopes_mas: Option<&Array2<f64>>,
    search: impl FnOnce() -> Result<RetrievedOptics>,
) -> Result<(RetrievedOptics, Scene)> {
    let own_sensor = slopes_mas.map_or(Ok(()), |mas| check_slopes(scene, &Telescope::new(scene)?, mas));
    // Slopes of another number of subapertures may belong to the pupil that the search finds.
    let own_sensor = match own_sensor {
        Err(Error::Shape(_)) if scene.pupil.extent_m().is_some() => own_sensor,
        other => Ok(other?),
    };
    let optics = search()?;
    let found_sensor = slopes_mas.map_or(Ok(()), |mas| check_slopes(&optics.scene, optics.telescope(), mas));
    let static_scene = if found_sensor.is_ok() { scene.adopting(&optics.scene)? } else { scene.clone() };
    own_sensor.or_else(|own| found_sensor.map_err(|_| own))?;
    Ok((optics, static_scene))
}

/// Pistons with their whole wavelengths, where the channels have several wavelengths.
fn absolute_pistons(
    sequence: &Sequence,
    sequences: &[ChannelSequence],
    prior: &RadialPsd,
    settings: &StaticsSettings,
) -> Result<Option<AbsolutePistons>> {
    let Sequence { channels, is_simultaneous, policy, control, .. } = *sequence;
    let wavelengths_nm: Vec<f64> = channels.iter().map(|channel| channel.scene.image.wavelength_nm).collect();
    let colours = SequenceInColours { channels, sequences, prior, is_simultaneous, settings, policy, control };
    are_determined(&wavelengths_nm).then(|| colours.absolute_pistons()).transpose()
}

/// Settings of the retrieval of `exposures` exposures of `scene`.
fn retrieval_settings(scene: &Scene, exposures: usize) -> RetrievalSettings {
    let (device, precision) = (scene.estimate.device.into(), scene.estimate.precision().into());
    // Pistons as separate coefficients are nearly degenerate with wavefronts that have steep edges:
    // each image is retrieved as a wavefront alone.
    let usual = RetrievalSettings { device, precision, piston_rms_nm: 0.0, ..RetrievalSettings::default() };
    if exposures > FEW_IMAGES {
        return usual;
    }
    RetrievalSettings { cycles_across_a_segment: usual.cycles_across_a_segment * FEW_IMAGES_RESOLUTION, ..usual }
}

//! The full-phase estimate of a sequence: images in, static errors with error bars out, and their file.

use super::full_phase::FullPhase;
use crate::ao::Lenslets;
use crate::estimate::{Cube, WithoutOutliers, without_outliers};
use crate::grid::Grid;
use crate::io::{Column, FitsWriter, Pixel};
use crate::optimize::CancelFlag;
use crate::retrieval::{
    RadialPsd, RetrievalReport, RetrievalSettings, Retriever, StaticAberrationRms, estimate_optics,
};
use crate::scene::{Knows, Scene, SegmentModes};
use crate::statics::SequenceRetrieval;
use crate::statics::check_diversity;
use crate::statics::{Iteration, StaticsSettings, estimate_static_errors};
use crate::telescope::Telescope;
use crate::{Error, Result};
use ndarray::{Array2, Array3};
use std::borrow::Cow;
use std::path::Path;
use std::time::Instant;

/// A sequence behind an adaptive optics.
#[derive(Debug, Clone)]
pub struct SkyImages {
    /// Electrons, `[image, y, x]`.
    pub images_e: Array3<f64>,
    /// Bad pixels likewise.
    pub bad: Array3<bool>,
    /// Read noise of a pixel, RMS electrons; `None` takes the scene's.
    pub read_noise_e: Option<f64>,
    /// What the wavefront sensor measured meanwhile, mean over each exposure, `[image, slope]`, mas; none without telemetry.
    pub slopes_mas: Option<Array2<f64>>,
}

/// What is assumed of the adaptive optics of `scene` for images with or without telemetry.
///
/// # Errors
/// [`Error::Scene`] where the scene asks for more than there is.
pub fn knows(scene: &Scene, telemetry: bool) -> Result<Knows> {
    let has_loop = scene.control.is_some() && scene.wavefront_sensor.is_some();
    let there = match (has_loop, telemetry) {
        (true, true) => Knows::Telemetry,
        (true, false) => Knows::Loop,
        (false, _) => Knows::Spectrum,
    };
    match scene.estimate.knows {
        None => Ok(there),
        Some(wanted) if wanted <= there => Ok(wanted),
        Some(wanted) => Err(Error::Scene(format!(
            "estimate.knows = \"{}\" is more than there is: the {}, and \"{}\" is accepted",
            wanted.word(),
            if has_loop { "images come without slopes" } else { "scene has no [wavefront_sensor] and [control]" },
            there.word()
        ))),
    }
}

/// Refuses slopes that are not of `scene`'s sensor, before any image is read.
fn check_slopes(scene: &Scene, telescope: &Telescope, slopes_mas: &Array2<f64>) -> Result<()> {
    let Some(sensing) = &scene.wavefront_sensor else { return Ok(()) };
    let grid = Grid::new(sensing.lenslets_across * sensing.samples_per_lenslet, telescope.pupil.grid.width_m())?;
    let subapertures = Lenslets::of(sensing, &telescope.pupil_on(grid)?, scene.directory())?.subapertures.len();
    if slopes_mas.ncols() != 2 * subapertures {
        return Err(Error::Shape(format!(
            "{} slopes were given for each image: {} are needed, along x and then along y for each of the scene's \
             {subapertures} subapertures",
            slopes_mas.ncols(),
            2 * subapertures
        )));
    }
    match slopes_mas.indexed_iter().find(|(_, slope)| !slope.is_finite()) {
        Some(((image, slope), mas)) => Err(Error::Value(format!(
            "slope {} of image {} is {mas} mas: a finite one is needed",
            slope + 1,
            image + 1
        ))),
        None => Ok(()),
    }
}

/// The spectrum that is expected of the dynamic wavefront.
fn prior(scene: &Scene, knows: Knows) -> Result<RadialPsd> {
    if knows > Knows::Nothing {
        return RadialPsd::ao_residual(scene, StaticAberrationRms::default());
    }
    // Ordinary seeing, r0 = 16 cm at 500 nm, beyond what the mirror's pitch corrects; below, as much as there: a flat band.
    // Kolmogorov: 0.0229·r0^(−5/3)·f^(−11/3) rad²·m².
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

/// Of so few images each is looked at [`FARTHER`] than usual, which takes three times as long: the first ten of a sequence then
/// leave 7.8 nm of phasing in place of 8.8.
const FEW_IMAGES: usize = 40;
/// Cycles across a segment over the usual ones.
const FARTHER: f64 = 1.25;

/// Reads a sequence: retrieval, static errors, and again about what was found. `watch` is told how many images of a pass are
/// done.
///
/// # Errors
/// Those of building the model; [`Error::Shape`] and [`Error::Value`] for frames or slopes that are not the scene's;
/// [`Error::Image`] where fewer than two images can be used; [`Error::Interrupted`].
pub fn read(
    scene: &Scene,
    images: &SkyImages,
    cancel: Option<&CancelFlag>,
    watch: &(dyn Fn(usize) + Sync),
) -> Result<FullPhase> {
    let started = Instant::now();
    if scene.modes.segment != SegmentModes::Piston {
        return Err(Error::Scene(format!(
            "modes.segment = \"{}\" is not what the full-phase estimate seeks beside the NCPA: \"piston\" is needed",
            scene.modes.segment.word()
        )));
    }
    let recipe =
        StaticsSettings { ao_knowledge: knows(scene, images.slopes_mas.is_some())?, ..StaticsSettings::default() };
    let knows = recipe.ao_knowledge;
    if let Some(&coarsest) = recipe.families.first() {
        check_diversity(coarsest, scene, &Telescope::of(scene)?)?;
    }
    let slopes_mas = images.slopes_mas.as_ref().filter(|_| knows >= Knows::Telemetry);
    let own_sensor = slopes_mas.map_or(Ok(()), |slopes_mas| check_slopes(scene, &Telescope::of(scene)?, slopes_mas));
    // Slopes of another number of subapertures may be those behind the pupil that the images show.
    let own_sensor = match own_sensor {
        Err(Error::Shape(_)) if scene.pupil.extent_m().is_some() => own_sensor,
        other => Ok(other?),
    };
    let prior = prior(scene, knows)?;
    let (images, cut_pixels) = clean(scene, images);
    let images = &*images;
    let (device, precision) = (scene.estimate.device.into(), scene.estimate.precision.into());
    // Pistons as coefficients of their own let each image trade an edge for a field that is nearly one: the field alone
    // shows what an image says.
    let usual = RetrievalSettings { device, precision, piston_rms_nm: 0.0, ..RetrievalSettings::default() };
    let retrieval = if images.images_e.dim().0 <= FEW_IMAGES {
        RetrievalSettings { cycles_across_a_segment: usual.cycles_across_a_segment * FARTHER, ..usual }
    } else {
        usual
    };
    let cube = Cube { images_e: images.images_e.view(), bad: images.bad.view(), read_noise_e: images.read_noise_e };
    let optics = estimate_optics(scene, &prior, &retrieval, cube, cancel)?;
    let found_sensor = slopes_mas.map_or(Ok(()), |mas| check_slopes(&optics.scene, optics.telescope(), mas));
    // A shadow that was found moves no lenslet that the slopes say is there.
    let static_scene = if found_sensor.is_ok() { optics.scene.clone() } else { scene.clone() };
    own_sensor.or_else(|own| found_sensor.map_err(|_| own))?;
    let retriever = Retriever::with_telescope(&optics.scene, optics.telescope().clone(), &prior, retrieval)?;
    let mut source = SequenceRetrieval::new(&retriever, &prior, cube, images.slopes_mas.clone(), cancel, watch)?;
    let passes = estimate_static_errors(&static_scene, &mut source, &recipe, cancel)?;
    let (reports, retrieval_seconds) = (std::mem::take(&mut source.reports), source.seconds);
    let (device, device_failure) = retriever.device();
    let (pupil, seconds) = (Telescope::of(&static_scene)?.pupil, started.elapsed().as_secs_f64());
    let precision = scene.estimate.precision;
    let scene = static_scene;
    Ok(FullPhase {
        passes,
        cut_pixels,
        reports,
        knows,
        optics,
        scene,
        device,
        device_failure,
        precision,
        pupil,
        seconds,
        retrieval_seconds,
    })
}

/// `images` without single pixels that stand out, and how many did in each.
fn clean<'a>(scene: &Scene, images: &'a SkyImages) -> (Cow<'a, SkyImages>, Vec<usize>) {
    match without_outliers(scene, &images.images_e, &images.bad, images.read_noise_e) {
        None => (Cow::Borrowed(images), vec![0; images.images_e.dim().0]),
        Some(WithoutOutliers { images_e, cut_pixels }) => {
            let SkyImages { bad, read_noise_e, slopes_mas, .. } = images;
            let (bad, slopes_mas) = (bad.clone(), slopes_mas.clone());
            (Cow::Owned(SkyImages { images_e, bad, read_noise_e: *read_noise_e, slopes_mas }), cut_pixels)
        }
    }
}

/// Writes an estimate in the layout of the modal one, and the table `PASSES`; beside it the true maps (phasing, NCPA; nm), where
/// they are known. The file appears whole or not at all.
///
/// # Errors
/// [`Error::File`] where the file cannot be written.
pub fn write(path: &Path, scene: &Scene, found: &FullPhase, truth: Option<[&Array2<f64>; 2]>) -> Result<()> {
    let pass = found.result()?;
    let mut file = FitsWriter::create(path)?;
    file.card("PRIMARY", "CREATOR", concat!("cophase ", env!("CARGO_PKG_VERSION")), "program and version")?;
    file.card("PRIMARY", "METHOD", "full-phase", "estimator")?;
    file.card("PRIMARY", "KNOWS", found.knows.word(), "what it assumes of the adaptive optics")?;
    file.card("PRIMARY", "DEVICE", found.device.as_str(), "where the retrievals ran")?;
    file.card("PRIMARY", "PRECISIO", found.precision.word(), "precision of the imaging chain")?;
    file.card("PRIMARY", "ELAPSED", found.seconds, "seconds for the estimate")?;
    file.card("PRIMARY", "NIMAGES", found.reports.len() as i64, "images read")?;
    file.card("PRIMARY", "NUSED", pass.used_images.len() as i64, "images used")?;
    file.card("PRIMARY", "SCALE", found.optics.plate_scale, "pixels per lambda/D over the scene's")?;
    if let Some(metres) = found.optics.central_obscuration_m {
        file.card("PRIMARY", "OBSCUR_M", metres, "central obscuration found, m")?;
    }
    if let Some(metres) = found.optics.spider_width_m {
        file.card("PRIMARY", "SPIDER_M", metres, "width of the spider's vanes found, m")?;
    }
    file.card("PRIMARY", "CHI2", pass.reduced_chi2, "median reduced chi-square")?;
    for (name, map) in [
        ("PHASING", &pass.phasing_nm),
        ("NCPA", &pass.ncpa_nm),
        ("WAVEFRONT", &(&pass.phasing_nm + &pass.ncpa_nm)),
        ("PHASING_SIGMA", &pass.phasing_sigma_nm),
        ("NCPA_SIGMA", &pass.ncpa_sigma_nm),
    ] {
        file.image(name, map, Pixel::F64, "nm")?;
    }
    file.card("WAVEFRONT", "GRID_M", found.pupil.grid.width_m(), "side of the map, m")?;
    for (name, map) in ["TRUTH_PHASING", "TRUTH_NCPA"].into_iter().zip(truth.into_iter().flatten()) {
        file.image(name, map, Pixel::F64, "nm")?;
    }
    modes(&mut file, pass)?;
    let of = |value: &dyn Fn(&Iteration) -> f64| found.passes.iter().map(value).collect::<Vec<f64>>();
    let passes = [
        Column::f64("PHASING_CHANGE_NM", "nm", of(&|pass| pass.change_nm[0])),
        Column::f64("NCPA_CHANGE_NM", "nm", of(&|pass| pass.change_nm[1])),
        Column::f64("PHASING_EXPECTED_NM", "nm", of(&|pass| pass.error_budget.total_nm[0])),
        Column::f64("NCPA_EXPECTED_NM", "nm", of(&|pass| pass.error_budget.total_nm[1])),
        Column::f64("CHI2", "", of(&|pass| pass.reduced_chi2)),
    ];
    file.table("PASSES", &passes)?;
    let of = |value: &dyn Fn(&RetrievalReport) -> f64| found.reports.iter().map(value).collect::<Vec<f64>>();
    let status = |report: &RetrievalReport| match &report.refusal {
        Some(_) => "unusable",
        None if report.reason.converged() => "ok",
        None => "not-converged",
    };
    let images = [
        Column::text("STATUS", found.reports.iter().map(status)),
        Column::i64("EVALUATIONS", found.reports.iter().map(|report| report.evaluations as i64).collect()),
        Column::f64("CHI2", "", of(&|report| report.reduced_chi2)),
        Column::f64("FLUX_E", "electron", of(&|report| report.flux_e)),
        Column::f64("BACKGROUND_E", "electron", of(&|report| report.background_e)),
        Column::i64("CUT_PIXELS", found.cut_pixels.iter().map(|&pixels| pixels as i64).collect()),
        Column::i64("USED", (0..found.reports.len()).map(|i| i64::from(pass.used_images.contains(&i))).collect()),
    ];
    file.table("IMAGES", &images)?;
    let reflectivities = &found.optics.segment_reflectivities;
    if !reflectivities.is_empty() {
        file.table("REFLECTIVITIES", &[Column::f64("REFLECTIVITY", "", reflectivities.clone())])?;
    }
    file.text("SCENE", scene.text())?;
    file.finish()
}

fn modes(file: &mut FitsWriter, pass: &Iteration) -> Result<()> {
    let errors = &pass.errors;
    let segments = errors.pistons_nm.len();
    let groups = (0..segments + errors.ncpa_nm.len()).map(|mode| if mode < segments { "segment" } else { "ncpa" });
    let columns = [
        Column::text("NAME", pass.mode_names()),
        Column::text("GROUP", groups),
        Column::f64("ESTIMATE_NM", "nm", pass.coefficients_nm()),
        Column::f64("SIGMA_NM", "nm", pass.sigma_nm()),
    ];
    file.table("MODES", &columns)
}

//! Estimate file: FITS, in the layout of the conventions.

use super::estimate::{Estimate, FullPhaseSummary};
use super::{ErrorTerm, ImageOutcome, ModelError};
use crate::Result;
use crate::io::{Column, ELECTRON, FitsWriter, Pixel};
use crate::modes::SegmentModes;
use crate::scene::OpticalParameter;
use crate::statics::Iteration;
use crate::telescope::SegmentPlace;
use std::path::Path;

impl Estimate {
    /// Writes the estimate as FITS, whole or not at all.
    ///
    /// # Errors
    /// [`Error::File`](crate::Error::File) where the file cannot be written.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<()> {
        write(path.as_ref(), self)
    }
}

fn write(path: &Path, estimate: &Estimate) -> Result<()> {
    let mut file = FitsWriter::create(path)?;
    cards(&mut file, estimate)?;
    maps(&mut file, estimate)?;
    modes(&mut file, estimate)?;
    segments(&mut file, estimate)?;
    images(&mut file, estimate)?;
    error_budget(&mut file, &estimate.error_budget)?;
    model_errors(&mut file, &estimate.model_errors)?;
    optics(&mut file, &estimate.optics)?;
    if let Some(map) = estimate.full_phase() {
        iterations(&mut file, map)?;
    }
    if !estimate.warnings.is_empty() {
        file.table("WARNINGS", &[Column::text("SENTENCE", &estimate.warnings)])?;
    }
    if let Some(modal) = estimate.modal() {
        file.image("COEFFICIENTS", &modal.image_coefficients_nm, Pixel::F64, "nm")?;
    }
    file.text("SCENE", estimate.scene.text())?;
    file.finish()
}

fn cards(file: &mut FitsWriter, estimate: &Estimate) -> Result<()> {
    file.card("PRIMARY", "METHOD", estimate.method.word(), "estimator")?;
    file.card("PRIMARY", "POLICY", estimate.policy.name(), "policy of the estimate")?;
    file.card("PRIMARY", "DEVICE", estimate.run.device.as_str(), "where the fit ran")?;
    file.card("PRIMARY", "PRECISIO", estimate.run.precision.to_string(), "precision of the imaging chain")?;
    file.card("PRIMARY", "OPTIMIZE", estimate.scene.estimate.optimizer.word(), "optimizer")?;
    file.card("PRIMARY", "ELAPSED", estimate.run.seconds, "seconds for the estimate")?;
    file.card("PRIMARY", "STATUS", estimate.status.word(), "worst status that counts for the whole")?;
    file.card("PRIMARY", "NIMAGES", estimate.images.len() as i64, "images read")?;
    file.card("PRIMARY", "NUSED", estimate.used() as i64, "images used")?;
    file.card("PRIMARY", "NCLIPPED", estimate.clipped() as i64, "images left out as outliers")?;
    if let Some(modal) = estimate.modal() {
        file.card("PRIMARY", "COMBINE", modal.combine.word(), "how images were combined")?;
    }
    if let Some(map) = estimate.full_phase() {
        file.card("PRIMARY", "AO_KNOWL", map.ao_knowledge.word(), "what it assumes of the adaptive optics")?;
        if let Some(check) = &map.telemetry {
            file.card("PRIMARY", "TELGAIN", check.gain, "measured over predicted slopes")?;
            file.card("PRIMARY", "TELCORR", check.correlation, "correlation of both")?;
        }
    }
    file.card("PRIMARY", "CHI2", estimate.reduced_chi2, "median reduced chi-square")
}

fn maps(file: &mut FitsWriter, estimate: &Estimate) -> Result<()> {
    let grid_m = estimate.pupil.grid.width_m();
    let truth = estimate.truth.as_ref().map(|(truth, _)| truth);
    let without = estimate.without_staircases.as_ref();
    let maps = [
        ("PHASING", Some(&estimate.maps.phasing_nm)),
        ("NCPA", Some(&estimate.maps.ncpa_nm)),
        ("WAVEFRONT", Some(&estimate.maps.wavefront_nm())),
        ("PHASING_SIGMA", Some(&estimate.sigma_maps.phasing_nm)),
        ("NCPA_SIGMA", Some(&estimate.sigma_maps.ncpa_nm)),
        ("PHASING_WITHOUT_STAIRCASES", without.map(|without| &without.maps.phasing_nm)),
        ("NCPA_WITHOUT_STAIRCASES", without.map(|without| &without.maps.ncpa_nm)),
        ("PHASING_WITHOUT_STAIRCASES_SIGMA", without.map(|without| &without.sigma_maps.phasing_nm)),
        ("NCPA_WITHOUT_STAIRCASES_SIGMA", without.map(|without| &without.sigma_maps.ncpa_nm)),
        ("TRUTH_PHASING", truth.map(|truth| &truth.phasing_nm)),
        ("TRUTH_NCPA", truth.map(|truth| &truth.ncpa_nm)),
    ];
    for (name, map) in maps.into_iter().filter_map(|(name, map)| Some((name, map?))) {
        file.map(name, map, "nm", grid_m)?;
    }
    Ok(())
}

fn modes(file: &mut FitsWriter, estimate: &Estimate) -> Result<()> {
    let columns = [
        Column::text("NAME", &estimate.basis.names),
        Column::text("GROUP", estimate.basis.groups.iter().map(|group| group.name())),
        Column::f64("ESTIMATE_NM", "nm", estimate.modes.coefficients_nm.clone()),
        Column::f64("SIGMA_NM", "nm", estimate.modes.sigma_nm()),
    ];
    file.table("MODES", &columns)
}

/// The segments with their place in the mirror, so that a piston is sent to the segment that it
/// belongs to with any observatory's numbering.
fn segments(file: &mut FitsWriter, estimate: &Estimate) -> Result<()> {
    let places = SegmentPlace::all(&estimate.scene, &estimate.pupil.segments);
    if places.is_empty() {
        return Ok(());
    }
    let (sigma_nm, names) = (estimate.modes.sigma_nm(), SegmentModes::Piston.names(places.len()));
    let mode = |name: &String| estimate.basis.names.iter().position(|known| known == name);
    let piston = |values: &[f64]| -> Vec<f64> {
        names.iter().map(|name| mode(name).map_or(f64::NAN, |mode| values[mode])).collect()
    };
    let mut columns = SegmentPlace::columns(&places);
    columns.push(Column::f64("PISTON_NM", "nm", piston(&estimate.modes.coefficients_nm)));
    columns.push(Column::f64("SIGMA_NM", "nm", piston(&sigma_nm)));
    if !estimate.integers.is_empty() {
        let integers = &estimate.integers;
        columns.push(Column::i64("INTEGER", integers.iter().map(|found| found.integer).collect()));
        columns.push(Column::f64("PROBABILITY", "", integers.iter().map(|found| found.probability).collect()));
        columns.push(Column::f64("RUNNER_UP_NM", "nm", integers.iter().map(|found| found.runner_up_nm).collect()));
    }
    file.table("SEGMENTS", &columns)
}

fn images(file: &mut FitsWriter, estimate: &Estimate) -> Result<()> {
    let images = &estimate.images;
    let reals = |value: &dyn Fn(&ImageOutcome) -> f64| images.iter().map(value).collect::<Vec<f64>>();
    let integers = |value: &dyn Fn(&ImageOutcome) -> i64| images.iter().map(value).collect::<Vec<i64>>();
    let name = |image: &ImageOutcome| estimate.channels.get(image.channel).map_or("", String::as_str);
    let channel = Column::text("CHANNEL", images.iter().map(name));
    let columns = [
        Column::text("STATUS", images.iter().map(|image| image.report.status.word())),
        Column::i64("EVALUATIONS", integers(&|image| image.report.evaluations as i64)),
        Column::f64("CHI2", "", reals(&|image| image.report.reduced_chi2)),
        Column::f64("FLUX_E", ELECTRON, reals(&|image| image.report.flux_e)),
        Column::f64("BACKGROUND_E", ELECTRON, reals(&|image| image.report.background_e)),
        Column::f64("TIP_NM", "nm", reals(&|image| image.report.tip_tilt_nm[0])),
        Column::f64("TILT_NM", "nm", reals(&|image| image.report.tip_tilt_nm[1])),
        Column::i64("BAD_PIXELS", integers(&|image| image.report.bad_pixels as i64)),
        Column::i64("REJECTED_PIXELS", integers(&|image| image.report.rejected.total() as i64)),
        Column::i64("USED", integers(&|image| i64::from(image.is_used))),
    ];
    let channel = if estimate.channels.is_empty() { None } else { Some(channel) };
    file.table("IMAGES", &channel.into_iter().chain(columns).collect::<Vec<_>>())
}

fn error_budget(file: &mut FitsWriter, terms: &[ErrorTerm]) -> Result<()> {
    let columns = [
        Column::text("NAME", terms.iter().map(|term| term.name.as_str())),
        Column::f64("PHASING_NM", "nm", terms.iter().map(|term| term.phasing_nm).collect()),
        Column::f64("NCPA_NM", "nm", terms.iter().map(|term| term.ncpa_nm).collect()),
    ];
    file.table("ERROR_BUDGET", &columns)
}

fn model_errors(file: &mut FitsWriter, errors: &[ModelError]) -> Result<()> {
    if errors.is_empty() {
        return Ok(());
    }
    let reals = |value: &dyn Fn(&ModelError) -> f64| errors.iter().map(value).collect::<Vec<f64>>();
    let columns = [
        Column::text("NAME", errors.iter().map(|error| error.name.as_str())),
        Column::f64("VALUE", "", reals(&|error| error.value)),
        Column::f64("SIGMA", "", reals(&|error| error.sigma)),
        Column::f64("TOLERANCE", "", reals(&|error| error.tolerance)),
        Column::f64("SIGNIFICANCE", "", reals(&|error| error.significance)),
    ];
    file.table("MODEL_ERRORS", &columns)
}

fn optics(file: &mut FitsWriter, optics: &[OpticalParameter]) -> Result<()> {
    if optics.is_empty() {
        return Ok(());
    }
    let reals = |value: &dyn Fn(&OpticalParameter) -> f64| optics.iter().map(value).collect::<Vec<f64>>();
    let columns = [
        Column::text("KEY", optics.iter().map(|parameter| parameter.key.as_str())),
        Column::f64("SCENE", "", reals(&|parameter| parameter.scene)),
        Column::f64("VALUE", "", reals(&|parameter| parameter.value)),
        Column::f64("SIGMA", "", reals(&|parameter| parameter.sigma)),
        Column::f64("IDENTIFIABLE", "", reals(&|parameter| parameter.identifiable)),
    ];
    file.table("OPTICS", &columns)
}

fn iterations(file: &mut FitsWriter, map: &FullPhaseSummary) -> Result<()> {
    let reals = |value: &dyn Fn(&Iteration) -> f64| map.iterations.iter().map(value).collect::<Vec<f64>>();
    let columns = [
        Column::f64("PHASING_CHANGE_NM", "nm", reals(&|iteration| iteration.change_nm[0])),
        Column::f64("NCPA_CHANGE_NM", "nm", reals(&|iteration| iteration.change_nm[1])),
        Column::f64("PHASING_EXPECTED_NM", "nm", reals(&|iteration| iteration.error_budget.total_nm[0])),
        Column::f64("NCPA_EXPECTED_NM", "nm", reals(&|iteration| iteration.error_budget.total_nm[1])),
        Column::f64("CHI2", "", reals(&|iteration| iteration.reduced_chi2)),
    ];
    file.table("ITERATIONS", &columns)?;
    if let Some(check) = &map.telemetry {
        file.table("TELEMETRY", &[Column::f64("CORRELATION", "", check.image_correlations.clone())])?;
    }
    if map.segment_reflectivities.is_empty() {
        return Ok(());
    }
    file.table("REFLECTIVITIES", &[Column::f64("REFLECTIVITY", "", map.segment_reflectivities.clone())])
}

//! Writing an estimate as FITS, in the layout of the conventions.

use super::{Estimate, Estimator, FittedOptic};
use crate::Result;
use crate::io::{Column, FitsWriter, Pixel};
use ndarray::Array2;
use std::path::Path;

/// Writes `estimate` to `path`, whole or not at all; beside it the true maps (phasing, NCPA; nm), where they are known.
///
/// # Errors
/// [`crate::Error::File`] where the file cannot be written.
pub fn write(path: &Path, estimator: &Estimator, estimate: &Estimate, truth: Option<[&Array2<f64>; 2]>) -> Result<()> {
    let mut file = FitsWriter::create(path)?;
    file.card("PRIMARY", "CREATOR", concat!("cophase ", env!("CARGO_PKG_VERSION")), "program and version")?;
    file.card("PRIMARY", "DEVICE", estimate.device.as_str(), "where the fit ran")?;
    file.card("PRIMARY", "PRECISIO", estimate.precision, "precision of the imaging chain")?;
    file.card("PRIMARY", "OPTIMIZE", estimator.recipe().optimizer.word(), "optimizer")?;
    file.card("PRIMARY", "ELAPSED", estimate.seconds, "seconds for the estimate")?;
    file.card("PRIMARY", "NIMAGES", estimate.images.len() as i64, "images read")?;
    file.card("PRIMARY", "NUSED", estimate.used() as i64, "images used")?;
    file.card("PRIMARY", "NCLIPPED", estimate.clipped_images.len() as i64, "images that the clipped mean left out")?;
    file.card("PRIMARY", "COMBINE", estimate.combine.word(), "how images were combined")?;
    file.card("PRIMARY", "CHI2", estimate.reduced_chi2(), "median reduced chi-square")?;
    let wavefront = &estimate.phasing_nm + &estimate.ncpa_nm;
    for (name, map) in [
        ("PHASING", &estimate.phasing_nm),
        ("NCPA", &estimate.ncpa_nm),
        ("WAVEFRONT", &wavefront),
        ("PHASING_SIGMA", &estimate.phasing_sigma_nm),
        ("NCPA_SIGMA", &estimate.ncpa_sigma_nm),
    ] {
        file.image(name, map, Pixel::F64, "nm")?;
    }
    file.card("WAVEFRONT", "GRID_M", estimator.model().telescope.pupil.grid.width_m(), "side of the map, m")?;
    for (name, map) in ["TRUTH_PHASING", "TRUTH_NCPA"].into_iter().zip(truth.into_iter().flatten()) {
        file.image(name, map, Pixel::F64, "nm")?;
    }
    let basis = &estimator.model().basis;
    file.table(
        "MODES",
        &[
            Column::text("NAME", basis.names()),
            Column::text("GROUP", basis.groups().iter().map(|group| group.name())),
            Column::f64("ESTIMATE_NM", "nm", estimate.combined.coefficients_nm.clone()),
            Column::f64("SIGMA_NM", "nm", estimate.combined.sigma_nm()),
        ],
    )?;
    let images = &estimate.images;
    let numbers = |f: &dyn Fn(&super::ImageReport) -> f64| images.iter().map(f).collect::<Vec<f64>>();
    file.table(
        "IMAGES",
        &[
            Column::text("STATUS", images.iter().map(|image| image.status.word())),
            Column::i64("EVALUATIONS", images.iter().map(|image| image.evaluations as i64).collect()),
            Column::f64("CHI2", "", numbers(&|image| image.reduced_chi2)),
            Column::f64("FLUX_E", "electron", numbers(&|image| image.flux_e)),
            Column::f64("BACKGROUND_E", "electron", numbers(&|image| image.background_e)),
            Column::f64("TIP_NM", "nm", numbers(&|image| image.tip_tilt_nm[0])),
            Column::f64("TILT_NM", "nm", numbers(&|image| image.tip_tilt_nm[1])),
            Column::i64("BAD_PIXELS", images.iter().map(|image| image.bad_pixels as i64).collect()),
            Column::i64("CUT_PIXELS", images.iter().map(|image| image.cut_pixels as i64).collect()),
            Column::i64("USED", (0..images.len()).map(|i| i64::from(estimate.used_images.contains(&i))).collect()),
        ],
    )?;
    let optics = estimator.fitted_optics();
    if !optics.is_empty() {
        let numbers = |f: &dyn Fn(&FittedOptic) -> f64| optics.iter().map(f).collect::<Vec<f64>>();
        file.table(
            "OPTICS",
            &[
                Column::text("KEY", optics.iter().map(FittedOptic::key)),
                Column::f64("SCENE", "", numbers(&|optic| optic.scene)),
                Column::f64("VALUE", "", numbers(&|optic| optic.value)),
                Column::f64("SIGMA", "", numbers(&|optic| optic.sigma)),
                Column::f64("TOLD", "", numbers(&|optic| optic.told)),
            ],
        )?;
    }
    file.image("COEFFICIENTS", &estimate.image_coefficients_nm, Pixel::F64, "nm")?;
    file.text("SCENE", estimator.scene().text())?;
    file.finish()
}

//! FITS file of a run: images, truth, telemetry.

use super::run::{Shot, Summary};
use super::simulator::Simulator;
use crate::io::{Column, ELECTRON, FitsWriter, Pixel};
use crate::source::file;
use crate::{Error, Result};
use ndarray::{Array2, Array3, Axis};
use std::path::Path;

/// Writes the images and the telemetry of a run of `simulator`. The write is atomic.
///
/// - `IMAGES`: electrons.
/// - `TRUTH_…`: as in [`crate::source::write`].
/// - `SLOPES`: slopes at the middle of each exposure, `[image, slope]`, mas, all x then all y.
/// - `COMMANDS`: commands at the middle of each exposure, `[image, actuator]`, nm.
/// - `SLOPES_MEAN`: slopes averaged over each exposure.
/// - `SHOTS`: table of time and residual for each image.
/// - `SUBAPERTURES`, `ACTUATORS`: tables of those in use.
/// - `INTERACTION`: interaction matrix, `[slope, actuator]`, mas per nm.
///
/// # Errors
/// [`Error::Image`] for a run without any image, [`Error::File`] where the file cannot be written.
pub fn write(path: &Path, simulator: &Simulator, shots: &[Shot], summary: &Summary) -> Result<()> {
    let scene = simulator.scene();
    if shots.is_empty() {
        let reason =
            summary.divergence.map_or(String::new(), |d| format!(": the loop diverged after {:.2} s", d.time_s));
        return Err(Error::Image(format!("0 images to write: the run ended before its first image{reason}")));
    }
    let mut file = FitsWriter::create(path)?;
    let (rows, columns) = scene.image.frame_shape();
    let mut images = Array3::<f32>::zeros((shots.len(), rows, columns));
    for (mut out, shot) in images.axis_iter_mut(Axis(0)).zip(shots) {
        out.assign(&shot.image_e);
    }
    file.image("IMAGES", &images, Pixel::F32, ELECTRON)?;
    drop(images);
    file::image_cards(&mut file, "IMAGES", scene, summary.flux_e)?;
    let seed = scene.aberrations.as_ref().map_or(1, |aberrations| aberrations.seed);
    file::seed_card(&mut file, "IMAGES", "SEED", seed, "seed of the aberrations")?;
    file::seed_card(&mut file, "IMAGES", "SEED_SKY", scene.turbulence.seed, "seed of the turbulence and of the noise")?;
    for (key, value, comment) in [
        ("FRAMES", summary.frames as f64, "frames of the loop"),
        ("RATE_HZ", 1.0 / simulator.frame_s(), "frames per second of the loop"),
        ("RESID_NM", summary.residual_rms_nm, "residual wavefront after settling, nm RMS"),
        ("STREHL", summary.strehl, "of that, at WAVELEN, long exposure"),
        ("DIVERG_S", summary.divergence.map_or(-1.0, |d| d.time_s), "when the loop diverged, s; -1: it did not"),
    ] {
        file.card("IMAGES", key, value, comment)?;
    }
    file::truth(&mut file, scene, simulator.truth())?;
    telemetry(&mut file, simulator, shots)?;
    file.text("SCENE", scene.text())?;
    file.finish()
}

fn telemetry(file: &mut FitsWriter, simulator: &Simulator, shots: &[Shot]) -> Result<()> {
    let rows = |values: &dyn Fn(&Shot) -> &[f32]| {
        let flat: Vec<f32> = shots.iter().flat_map(|shot| values(shot).iter().copied()).collect();
        Array2::from_shape_vec((shots.len(), flat.len() / shots.len()), flat)
            .map_err(|error| Error::Internal(format!("telemetry of uneven length: {error}")))
    };
    file.image("SLOPES", &rows(&|shot| &shot.slopes_mas)?, Pixel::F32, "mas")?;
    file.image("SLOPES_MEAN", &rows(&|shot| &shot.mean_slopes_mas)?, Pixel::F32, "mas")?;
    file.image("COMMANDS", &rows(&|shot| &shot.commands_nm)?, Pixel::F32, "nm")?;
    let column = |value: &dyn Fn(&Shot) -> f64| shots.iter().map(value).collect();
    let shots = [
        Column::f64("TIME_S", "s", column(&|shot| shot.time_s)),
        Column::f64("RESIDUAL_NM", "nm", column(&|shot| shot.residual_rms_nm)),
    ];
    file.table("SHOTS", &shots)?;
    let lenslets = simulator.lenslets();
    let subapertures = [
        Column::i64("PLACE", lenslets.subapertures.iter().map(|&place| place as i64).collect()),
        Column::f64("LIGHT", "", lenslets.light.clone()),
        Column::i64("MASKED", simulator.mask().iter().map(|&masked| i64::from(masked)).collect()),
    ];
    file.table("SUBAPERTURES", &subapertures)?;
    let (x_m, y_m) = simulator.influence().positions_m().into_iter().unzip();
    let actuators = [
        Column::i64("PLACE", simulator.influence().indices().iter().map(|&place| place as i64).collect()),
        Column::f64("X_M", "m", x_m),
        Column::f64("Y_M", "m", y_m),
    ];
    file.table("ACTUATORS", &actuators)?;
    file.image("INTERACTION", simulator.interaction(), Pixel::F64, "mas/nm")
}

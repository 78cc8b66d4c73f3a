//! FITS file of a run: images, truth, telemetry.

use super::recorder::{Shot, Summary};
use super::sensor::{MOVED_REFERENCE, SlopeFormat};
use super::simulator::Simulator;
use crate::io::{Column, FitsWriter, Pixel};
use crate::source::file;
use crate::{Error, Result};
use ndarray::{Array2, Array3, Axis, stack};
use std::path::Path;

/// Writes the images and the telemetry of a run of `simulator`. The write is atomic.
///
/// - `IMAGES`: electrons.
/// - `TRUTH_…`: as in [`crate::source::write`].
/// - `SLOPES`: slopes at the middle of each exposure, `[image, slope]`, mas, all x then all y; in
///   the order and unit of `wavefront_sensor.slope_order` and `slope_unit_mas` where the scene has
///   these, as the rows of `INTERACTION`.
/// - `COMMANDS`: commands at the middle of each exposure, `[image, actuator]`, nm.
/// - `SLOPES_MEAN`: slopes averaged over each exposure.
/// - `MOVED_REFERENCE`: by how much corrections have moved the reference slopes, to which those of
///   the file are relative, a row; where they have.
/// - `SHOTS`: table of time and residual for each image.
/// - `SUBAPERTURES`, `ACTUATORS`: tables of those in use.
/// - `INTERACTION`: interaction matrix, `[slope, actuator]`, mas per nm.
///
/// A scene with channels has `IMAGES`, `SLOPES`, `SLOPES_MEAN`, `COMMANDS` and `SHOTS` for each
/// channel of which there are images, with `EXTVER` 1, 2, …; the cards of the loop are those of the
/// first `IMAGES`.
///
/// # Errors
/// [`Error::Image`] for a run without any image, [`Error::File`] where the file cannot be written.
pub fn write(path: &Path, scene_text: &str, simulator: &Simulator, shots: &[Shot], summary: &Summary) -> Result<()> {
    let scene = simulator.scene();
    if shots.is_empty() {
        let reason =
            summary.divergence.map_or(String::new(), |d| format!(": the loop diverged after {:.2} s", d.time_s));
        return Err(Error::Image(format!("0 images to write: the run ended before its first image{reason}")));
    }
    let of_channel = |number| shots.iter().filter(|shot| shot.channel == number).collect::<Vec<_>>();
    let channels: Vec<(usize, Vec<&Shot>)> = (0..summary.flux_e.len())
        .map(|number| (number, of_channel(number)))
        .filter(|(_, shots)| !shots.is_empty())
        .collect();
    let mut file = FitsWriter::create(path)?;
    for (number, shots) in &channels {
        let hdu = file::channel_images(&mut file, scene, *number, &images_e(shots)?, summary.flux_e[*number])?;
        let seed = scene.seed();
        file::seed_card(&mut file, &hdu, "SEED", seed, "seed of the aberrations")?;
        file::seed_card(&mut file, &hdu, "SEED_SKY", scene.turbulence.seed, "seed of the turbulence and of the noise")?;
    }
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
    let format = match &scene.wavefront_sensor {
        Some(sensing) => SlopeFormat::new(sensing, simulator.lenslets())?,
        None => return Err(Error::Internal("a loop without a sensor".into())),
    };
    channels.iter().try_for_each(|(number, shots)| telemetry(&mut file, *number, shots, &format))?;
    if let Some(moved_mas) = simulator.moved_reference_mas() {
        let row = format.measured(moved_mas.insert_axis(Axis(0)))?;
        file.image(MOVED_REFERENCE, &row, Pixel::F64, format.unit())?;
    }
    system(&mut file, simulator, &format)?;
    file.text("SCENE", scene_text)?;
    file.finish()
}

/// The images of the shots of a channel, `[image, y, x]`.
fn images_e(shots: &[&Shot]) -> Result<Array3<f32>> {
    let images: Vec<_> = shots.iter().map(|shot| shot.image_e.view()).collect();
    stack(Axis(0), &images).map_err(|error| Error::Internal(format!("images of uneven size: {error}")))
}

/// Writes the telemetry of the channel `number`.
fn telemetry(file: &mut FitsWriter, number: usize, shots: &[&Shot], format: &SlopeFormat) -> Result<()> {
    let hdu = |name: &str| file::channel_hdu(name, number);
    let rows = |values: &dyn Fn(&Shot) -> &[f32]| {
        let flat: Vec<f32> = shots.iter().flat_map(|shot| values(shot).iter().copied()).collect();
        Array2::from_shape_vec((shots.len(), flat.len() / shots.len()), flat)
            .map_err(|error| Error::Internal(format!("telemetry of uneven length: {error}")))
    };
    let slopes = |values: &dyn Fn(&Shot) -> &[f32]| format.measured(rows(values)?.mapv(f64::from).view());
    file.image(&hdu("SLOPES"), &slopes(&|shot| &shot.slopes_mas)?, Pixel::F32, format.unit())?;
    file.image(&hdu("SLOPES_MEAN"), &slopes(&|shot| &shot.mean_slopes_mas)?, Pixel::F32, format.unit())?;
    file.image(&hdu("COMMANDS"), &rows(&|shot| &shot.commands_nm)?, Pixel::F32, "nm")?;
    let column = |value: &dyn Fn(&Shot) -> f64| shots.iter().map(|shot| value(shot)).collect();
    let columns = [
        Column::f64("TIME_S", "s", column(&|shot| shot.time_s)),
        Column::f64("RESIDUAL_NM", "nm", column(&|shot| shot.residual_rms_nm)),
    ];
    file.table(&hdu("SHOTS"), &columns)
}

/// Writes subapertures, actuators and their interaction matrix.
fn system(file: &mut FitsWriter, simulator: &Simulator, format: &SlopeFormat) -> Result<()> {
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
    let interaction = format.measured(simulator.interaction().t())?.reversed_axes();
    let unit = if format.unit().is_empty() { "" } else { "mas/nm" };
    file.image("INTERACTION", &interaction.as_standard_layout().to_owned(), Pixel::F64, unit)
}

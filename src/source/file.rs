//! FITS files of simulated images with their truth.

use super::images::SourceImages;
use super::truth::Truth;
use crate::io::{CHANNEL, Column, ELECTRON, FitsWriter, Pixel};
use crate::scene::System;
use crate::{Error, Result};
use ndarray::Array3;
use std::path::Path;

/// Writes images of an artificial source, those of each channel of the scene in order: `IMAGES`
/// (electrons; of the second channel with `EXTVER` 2, and so on), `TRUTH_PHASING` and `TRUTH_NCPA`
/// (nm), tables `TRUTH` and `SCENE`. The write is atomic.
///
/// # Errors
/// [`Error::Shape`] for images of another number of channels than the scene has; [`Error::File`] if
/// the file cannot be written.
pub fn write(path: &Path, scene: &System, scene_text: &str, made: &[SourceImages]) -> Result<()> {
    let channels = scene.channels();
    let (Some(first), true) = (made.first(), made.len() == channels.len().max(1)) else {
        let (given, wanted) = (made.len(), channels.len().max(1));
        return Err(Error::Shape(format!("there are images of {given} channels, where the scene has {wanted}")));
    };
    let seed = scene.seed();
    let mut file = FitsWriter::create(path)?;
    for (number, made) in made.iter().enumerate() {
        let hdu = channel_images(&mut file, scene, number, &made.images_e, made.flux_e)?;
        seed_card(&mut file, &hdu, "SEED", seed, "seed of aberrations and noise")?;
    }
    truth(&mut file, scene, &first.truth)?;
    file.text("SCENE", scene_text)?;
    file.finish()
}

/// Writes the images `[image, y, x]`, electrons, of the channel `number` of `scene`, from 0, which
/// is also that of the images of a scene without channels; `flux_e` is the star's in each. Returns
/// the name of the HDU, which has the cards of [`image_cards`].
pub(crate) fn channel_images<A: Copy + Into<f64>>(
    file: &mut FitsWriter,
    scene: &System,
    number: usize,
    images_e: &Array3<A>,
    flux_e: f64,
) -> Result<String> {
    let (hdu, channel) = (channel_hdu("IMAGES", number), scene.channels().get(number));
    file.image(&hdu, images_e, Pixel::F32, ELECTRON)?;
    if let Some(channel) = channel {
        file.card(&hdu, CHANNEL, channel.name.as_str(), "name of the channel")?;
    }
    image_cards(file, &hdu, channel.map_or(scene, |channel| &channel.system), flux_e)?;
    Ok(hdu)
}

/// Name of the HDU `name` of a channel, by its number from 0, for [`FitsWriter`]: the EXTVER counts
/// the channels from 1.
pub(crate) fn channel_hdu(name: &str, number: usize) -> String {
    if number == 0 { name.into() } else { format!("{name},{}", number + 1) }
}

/// Side of the scene's grid, m.
pub(crate) fn grid_m(scene: &System) -> Result<f64> {
    scene.grid_m().ok_or_else(no_grid)
}

fn no_grid() -> Error {
    Error::Internal("a valid scene does not determine the width of its grid".into())
}

/// Writes the cards of the images in `hdu`: noise, flux, sampling, exposure.
pub(crate) fn image_cards(file: &mut FitsWriter, hdu: &str, scene: &System, flux_e: f64) -> Result<()> {
    let image = &scene.image;
    for (key, value, comment) in [
        ("RON_E", image.simulated_read_noise_e(), "read noise of a pixel, electrons RMS"),
        ("FLUX_E", flux_e, "electrons of the star in an image"),
        ("BACKGR_E", image.background_e, "background of a pixel, electrons"),
        ("WAVELEN", image.wavelength_nm, "wavelength, nm"),
        ("PIXSCALE", scene.pixel_mas().ok_or_else(no_grid)?, "pixel on the sky, mas"),
        ("EXPTIME", image.exposure_s, "exposure, s"),
    ] {
        file.card(hdu, key, value, comment)?;
    }
    Ok(())
}

/// Writes a seed to the header of `hdu`.
pub(crate) fn seed_card(file: &mut FitsWriter, hdu: &str, key: &str, seed: u64, comment: &str) -> Result<()> {
    // FITS integers are signed.
    file.card(hdu, key, i64::try_from(seed).unwrap_or(i64::MAX), comment)
}

/// Writes the truth: both maps, and the table of segments.
pub(crate) fn truth(file: &mut FitsWriter, scene: &System, truth: &Truth) -> Result<()> {
    file.map("TRUTH_PHASING", &truth.phasing_nm, "nm", grid_m(scene)?)?;
    file.map("TRUTH_NCPA", &truth.ncpa_nm, "nm", grid_m(scene)?)?;
    let tilt = |axis: usize| truth.tip_tilt_nm.iter().map(|tilts| tilts[axis]).collect();
    let table = [
        Column::i64("SEGMENT", (0..truth.piston_nm.len() as i64).collect()),
        Column::f64("PISTON_NM", "nm", truth.piston_nm.clone()),
        Column::f64("TIP_NM", "nm", tilt(0)),
        Column::f64("TILT_NM", "nm", tilt(1)),
    ];
    file.table("TRUTH", &table)
}

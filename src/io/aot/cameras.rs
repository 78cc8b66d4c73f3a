//! Images of the scoring cameras of a file of AOT, with their bad pixels and what the tables state
//! of the instrument.

use super::read::{image, reals, row, texts};
use super::version::check_version;
use crate::Result;
use crate::io::header::{HeaderFact, PixelUnit, Quantity};
use crate::io::image_hdu::{HduImages, read_hdu};
use crate::io::read::FitsReader;
use std::f64::consts::PI;
use std::path::Path;

/// Table of the scoring cameras.
const CAMERAS: &str = "AOT_SCORING_CAMERAS";
/// Table of the detectors.
const DETECTORS: &str = "AOT_DETECTORS";

/// Relative uncertainty of a value in a table: that of a single-precision number.
const TOLERANCE: f64 = 1e-6;

/// A radian on the sky, mas.
pub(super) const MAS_PER_RADIAN: f64 = 180.0 / PI * 3.6e6;

/// A scoring camera with images.
pub(super) struct AotCamera {
    pub(super) uid: String,
    /// Row of its detector.
    detector: usize,
    /// HDU of its images.
    pub(super) images: usize,
    wavelength_m: f64,
}

/// The scoring cameras that have images, in the order of the table.
///
/// # Errors
/// [`Error::File`](crate::Error::File), with what is missing, where none has.
pub(super) fn with_images(file: &mut FitsReader) -> Result<Vec<AotCamera>> {
    check_version(file)?;
    let uids = texts(file, CAMERAS, "UID")?;
    let references = texts(file, CAMERAS, "DETECTOR_UID")?;
    let wavelengths_m = reals(file, CAMERAS, "WAVELENGTH")?;
    let pixels = texts(file, DETECTORS, "PIXEL_INTENSITIES")?;
    let mut cameras = Vec::new();
    for (at, uid) in uids.iter().enumerate() {
        let Some(detector) = row(file, &references[at], DETECTORS)? else { continue };
        let Some(images) = image(file, &pixels[detector], "PIXEL_INTENSITIES")? else { continue };
        cameras.push(AotCamera { uid: uid.clone(), detector, images, wavelength_m: wavelengths_m[at] });
    }
    if cameras.is_empty() {
        let what = match uids.as_slice() {
            [] => format!("has no scoring camera (a row of {CAMERAS}), whose images are read"),
            _ => format!(
                "has no images of its scoring cameras ({}): PIXEL_INTENSITIES of the detector that a DETECTOR_UID names are read",
                uids.join(", ")
            ),
        };
        return Err(file.refuse(what));
    }
    Ok(cameras)
}

/// Reads the images of each scoring camera that has any, at least one, in the order of their table.
/// Bad pixels are those of `BAD_PIXEL_MAP` and of the file `mask`. The cards of an image take
/// precedence over the tables. Images without `BUNIT` are in counts, as the standard has them. The
/// name of a channel is the card `CHANNEL`, else, of several cameras, the UID.
///
/// # Errors
/// [`Error::File`](crate::Error::File), with what is missing.
pub(crate) fn cameras(file: &mut FitsReader, mask: Option<&Path>) -> Result<Vec<HduImages>> {
    let cameras = with_images(file)?;
    let maps = texts(file, DETECTORS, "BAD_PIXEL_MAP")?;
    let mut read = Vec::new();
    for (place, camera) in cameras.iter().enumerate() {
        let marks = image(file, &maps[camera.detector], "BAD_PIXEL_MAP")?;
        let mut images = read_hdu(file, (place, camera.images), marks, mask)?;
        images.version = place as i64 + 1;
        if images.unit == PixelUnit::Unstated {
            images.unit = PixelUnit::Counts;
        }
        if cameras.len() > 1 {
            images.channel.get_or_insert_with(|| camera.uid.clone());
        }
        let in_counts = images.unit == PixelUnit::Counts;
        for fact in facts(file, camera, in_counts)? {
            if !images.facts.iter().any(|known| known.quantity == fact.quantity) {
                images.facts.push(fact);
            }
        }
        images.notes.extend(calibrations(file, camera)?);
        read.push(images);
    }
    Ok(read)
}

/// What the tables state of the instrument.
fn facts(file: &mut FitsReader, camera: &AotCamera, in_counts: bool) -> Result<Vec<HeaderFact>> {
    let mut number = |column: &str| -> Result<f64> { Ok(reals(file, DETECTORS, column)?[camera.detector]) };
    let (scale_rad, exposure_s) = (number("PIXEL_SCALE")?, number("INTEGRATION_TIME")?);
    let (coadds, noise_e) = (number("COADDS")?, number("READOUT_NOISE")?);
    // A gain is of images in counts only.
    let gain = if in_counts { number("GAIN")? } else { f64::NAN };
    // An image may be the sum of its co-additions, and the integration time that of one of them.
    let exposures_s = if coadds > 1.0 { vec![exposure_s, coadds * exposure_s] } else { vec![exposure_s] };
    // The standard's unit of the read noise, electrons per second and pixel, is that of no read
    // noise: files have electrons RMS.
    let noises_e = if exposure_s > 0.0 { vec![noise_e, noise_e * exposure_s] } else { vec![noise_e] };
    let facts = [
        (Quantity::WavelengthNm, "WAVELENGTH", camera.wavelength_m, vec![camera.wavelength_m * 1e9], CAMERAS),
        (Quantity::PixelMas, "PIXEL_SCALE", scale_rad, vec![scale_rad * MAS_PER_RADIAN], DETECTORS),
        (Quantity::ExposureS, "INTEGRATION_TIME", exposure_s, exposures_s, DETECTORS),
        (Quantity::ReadNoiseE, "READOUT_NOISE", noise_e, noises_e, DETECTORS),
        (Quantity::GainEPerAdu, "GAIN", gain, vec![gain], DETECTORS),
    ];
    let known = facts.into_iter().filter(|(.., value, _, _)| value.is_finite() && *value >= 0.0);
    let fact = |(quantity, keyword, value, values, table)| HeaderFact {
        quantity,
        keyword,
        written: format!("{value} of {table}"),
        values,
        tolerance: TOLERANCE,
    };
    Ok(known.map(fact).collect())
}

/// A sentence on calibration frames in the file, which are not applied.
fn calibrations(file: &mut FitsReader, camera: &AotCamera) -> Result<Option<String>> {
    let mut there = Vec::new();
    for column in ["DARK", "FLAT_FIELD", "SKY_BACKGROUND"] {
        if !texts(file, DETECTORS, column)?[camera.detector].is_empty() {
            there.push(column);
        }
    }
    let what = there.join(", ");
    Ok((!there.is_empty())
        .then(|| format!("the {what} of the scoring camera `{}` is not applied to its images", camera.uid)))
}

/// Exposure of a camera, s: its integration time; NaN where the file does not say it.
pub(super) fn exposure_s(file: &mut FitsReader, camera: &AotCamera) -> Result<f64> {
    Ok(reals(file, DETECTORS, "INTEGRATION_TIME")?[camera.detector])
}
